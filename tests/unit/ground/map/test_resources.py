"""Helium-3 in an area: closed forms, dense algebra, and the coverage of intervals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import fftconvolve

from he3.errors import InvalidInput, OutsideRegion
from he3.frames import SiteGrid
from he3.gp import GaussianProcess, Hyperparameters, fit_hyperparameters
from he3.kernels import kernel_from
from he3.posterior.grid import GridPosterior
from he3.resource import area_mean, drawn_fields, share_above
from he3.trend import covariate_trend, orbital_trend
from schemas.maps import ResourceQuery
from services.ground.map.resources import corners_of, estimate
from services.ground.map.snapshot import MapSnapshot
from services.mission.regions import load_region

GRID = SiteGrid(24, 30, 5.0)
NOISE_STD_PPB = 0.1


def belief(kernel: str = "matern52", samples: int = 12, trend: bool = False) -> GaussianProcess:
    rng = np.random.default_rng(3)
    orbital = orbital_trend(GRID, rng.normal(8, 1, GRID.shape)) if trend else None
    hyperparameters = Hyperparameters(kernel_from(kernel), NOISE_STD_PPB, 0.0 if trend else 8.0, 1.5, trend=orbital)
    places = rng.uniform(0, (GRID.width_m, GRID.height_m), (samples, 2))
    return GaussianProcess(hyperparameters).condition(places, rng.normal(8, 1, samples))


def area() -> np.ndarray:
    covered = np.zeros(GRID.shape, dtype=np.bool_)
    covered[3:15, 5:20] = True
    covered[6:9, 7:12] = False
    return covered


def dense_spread(process: GaussianProcess, points: np.ndarray) -> float:
    """Standard deviation by dense algebra [ppb]: without a trend the constant is an unknown with a wide prior."""
    hyperparameters = process.hyperparameters
    vague = 0.0 if hyperparameters.trend is not None else 1e4
    samples = process.places_m
    of_samples = hyperparameters.covariance(samples, samples) + vague
    of_samples += np.eye(len(samples)) * hyperparameters.noise_variance
    crossing = hyperparameters.covariance(samples, points) + vague
    posterior = hyperparameters.covariance(points, points) + vague - crossing.T @ np.linalg.solve(of_samples, crossing)
    return float(np.sqrt(posterior.mean()) * hyperparameters.scale_ppb)


@pytest.mark.parametrize("kernel", ["se", "matern12", "matern52", "smooth+rough"])
@pytest.mark.parametrize("trend", [False, True])
def test_the_spread_of_an_area_mean_is_that_of_the_whole_joint_covariance(kernel: str, trend: bool) -> None:
    process = belief(kernel, trend=trend)
    points = GRID.points()[area().ravel()]
    mean, _ = process.predict(points)
    got = area_mean(process, GRID, process.predict(GRID.points())[0].reshape(GRID.shape), area())
    assert got.cells == len(points)
    assert got.mean_ppb == pytest.approx(mean.mean(), rel=1e-9)
    assert got.std_ppb == pytest.approx(dense_spread(process, points), rel=1e-4)


def test_one_cell_has_the_spread_of_its_cell() -> None:
    process = belief()
    mean, std = process.predict(GRID.points())
    only = np.zeros(GRID.shape, dtype=np.bool_)
    only[4, 7] = True
    got = area_mean(process, GRID, mean.reshape(GRID.shape), only)
    assert got.std_ppb == pytest.approx(dense_spread(process, GRID.points()[only.ravel()]), rel=1e-4)
    # The map takes the constant as known.
    assert got.std_ppb >= float(std.reshape(GRID.shape)[4, 7])


@pytest.mark.parametrize(
    ("kernel", "length_m", "samples"),
    [("se", 150.0, 150), ("se", 300.0, 150), ("se", 60.0, 150), ("matern52", 150.0, 150), ("matern32", 240.0, 40),
     ("matern12", 100.0, 150)],
)  # fmt: skip
@pytest.mark.parametrize("whole", [True, False])
def test_an_area_that_the_samples_know_well_keeps_its_spread(
    kernel: str, length_m: float, samples: int, whole: bool
) -> None:
    """The samples leave a millionth of the prior variance, of which coarse blocks left nothing: a spread of 0."""
    site = SiteGrid(500, 500, 1.0)
    rng = np.random.default_rng(5)
    parameters = {"variance": 1.0, "length_scale_m": length_m}
    process = GaussianProcess(
        Hyperparameters(kernel_from(kernel, parameters), NOISE_STD_PPB, 8.0, 1.5)
    ).condition(rng.uniform(0, 500, (samples, 2)), rng.normal(8, 1, samples))  # fmt: skip
    covered = np.ones(site.shape, dtype=np.bool_) if whole else np.add.outer(np.arange(500), np.arange(500)) < 400
    got = area_mean(process, site, np.full(site.shape, 8.0), covered)
    assert got.spacing_m > 1.0
    assert got.std_ppb == pytest.approx(spread_by_cells(process, site, covered), rel=0.03)


@pytest.mark.parametrize("kernel", ["se", "matern32"])
def test_a_covariate_that_differs_from_cell_to_cell_counts_with_its_average_over_the_area(kernel: str) -> None:
    site, rng = SiteGrid(400, 400, 1.0), np.random.default_rng(7)
    trend = covariate_trend(site, rng.normal(size=(1, *site.shape)), 8.0, 4.0)
    parameters = {"variance": 1.0, "length_scale_m": 100.0}
    process = GaussianProcess(
        Hyperparameters(kernel_from(kernel, parameters), NOISE_STD_PPB, 8.0, 1.5, trend=trend)
    ).condition(rng.uniform(0, 400, (100, 2)), rng.normal(8, 1, 100))  # fmt: skip
    covered = np.add.outer(np.arange(400), np.arange(400)) < 400
    got = area_mean(process, site, np.full(site.shape, 8.0), covered)
    assert got.spacing_m > 1.0
    assert got.std_ppb == pytest.approx(spread_by_cells(process, site, covered), rel=0.02)


def spread_by_cells(process: GaussianProcess, grid: SiteGrid, covered: np.ndarray) -> float:
    """Standard deviation [ppb] of the mean over the cells, each one of them counted; the constant is unknown."""
    own, cells = process.hyperparameters, grid.points()[covered.ravel()]
    crossing = np.sum(
        [own.covariance(process.places_m, part).sum(axis=1) for part in np.array_split(cells, 50)], axis=0
    )
    whitened, ones = process.solve(crossing / len(cells)), process.solve(np.ones(len(process)))
    pairs = fftconvolve(covered.astype(float), covered[::-1, ::-1].astype(float))
    east, north = np.meshgrid(*((np.arange(2 * count - 1) - count + 1) for count in reversed(covered.shape)))
    lags = own.kernel.covariance(np.zeros((1, 2)), np.column_stack((east.ravel(), north.ravel())) * grid.resolution_m)
    prior = float((pairs.ravel() * lags[0]).sum()) / len(cells) ** 2
    basis = own.trend_basis(cells)
    unknown = float(1.0 - ones @ whitened) ** 2 / float(ones @ ones) if basis is None else 0.0
    prior += 0.0 if basis is None else float((basis.mean(axis=0) ** 2).sum())
    variance = prior - float(whitened @ whitened) + unknown
    return float(np.sqrt(variance)) * own.scale_ppb


def test_a_coarse_integration_states_its_error() -> None:
    fine = SiteGrid(300, 300, 1.0)
    rng = np.random.default_rng(5)
    places = rng.uniform(0, 300, (40, 2))
    process = GaussianProcess(Hyperparameters(kernel_from("matern12"), NOISE_STD_PPB, 8.0, 1.0)).condition(
        places, rng.normal(8, 1, 40)
    )
    whole = np.ones(fine.shape, dtype=np.bool_)
    got = area_mean(process, fine, np.full(fine.shape, 8.0), whole)
    assert got.spacing_m > 1
    assert got.std_error_ppb > 0.0
    # The error is added, so the spread lies at most twice of it above that over all cells.
    assert abs(got.std_ppb - spread_by_cells(process, fine, whole)) <= 2.0 * got.std_error_ppb


def test_joint_draws_have_the_expectation_of_the_cells() -> None:
    process = belief()
    shares = share_above(process, GRID, area(), 8.0, np.random.default_rng(1), 4000)
    points = GRID.points()[area().ravel()]
    mean, _ = process.predict(points)
    from scipy.stats import norm

    std = np.array([dense_spread(process, point[None, :]) for point in points])
    expected = norm.sf(8.0, mean, std).mean()
    assert shares.mean() == pytest.approx(expected, abs=4 * shares.std() / 4000**0.5 + 0.01)
    assert 0 <= shares.min() <= shares.max() <= 1


@pytest.mark.parametrize("trend", [False, True])
@pytest.mark.parametrize("samples", [0, 3, 12])
def test_the_mean_of_an_area_varies_among_the_draws_as_much_as_the_area_mean_says(trend: bool, samples: int) -> None:
    process = belief(samples=samples, trend=trend)
    said = area_mean(process, GRID, process.predict(GRID.points())[0].reshape(GRID.shape), area())
    fields, weights = drawn_fields(process, GRID, area(), np.random.default_rng(1), 4000)
    means = fields @ weights
    assert means.mean() == pytest.approx(said.mean_ppb, abs=4 * said.std_ppb / 4000**0.5 + 1e-9)
    assert means.std() == pytest.approx(said.std_ppb, rel=0.05)  # 4000 draws: a standard error of 1.1 %


def shown(process: GaussianProcess, grid: SiteGrid) -> MapSnapshot:
    mean, std = (values.reshape(grid.shape).astype(np.float32) for values in process.predict(grid.points()))
    return MapSnapshot(
        grid=grid, mean_ppb=mean, std_ppb=std, traversable=np.ones(grid.shape, dtype=np.bool_), samples=(),
        driven_path_m=(), planned_path_m=(), plan_ends=None, revision=3, mission_time_ns=5, score=None,
        score_history=(), process=process,
    )  # fmt: skip


def test_mass_is_abundance_times_density_times_area() -> None:
    reply = estimate(ResourceQuery(polygon="0,0,50,0,50,20,0,20"), shown(belief(), GRID))
    assert reply.area_m2 == 1000.0
    assert reply.mass_kg_per_m.expected == pytest.approx(reply.mean_ppb.expected * 1e-9 * 1660.0 * 1000.0)
    assert reply.mean_ppb.low < reply.mean_ppb.expected < reply.mean_ppb.high
    assert reply.area_above_m2.low <= reply.area_above_m2.expected <= reply.area_above_m2.high <= reply.area_m2
    assert reply == estimate(ResourceQuery(polygon="0,0,50,0,50,20,0,20"), shown(belief(), GRID))


def test_a_wider_probability_has_a_wider_interval() -> None:
    map_ = shown(belief(), GRID)
    narrow, wide = (estimate(ResourceQuery(probability=p), map_).mean_ppb for p in (0.5, 0.95))
    assert wide.high - wide.low > 2.5 * (narrow.high - narrow.low)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("1,2,3,4", "3 to 256 corners"),
        ("1,2,3,4,5", "3 to 256 corners"),
        ("1,2,3,4,5,1e999", "3 to 256 corners"),
        ("1,2,e,4,5,6", "expected numbers"),
    ],
)
def test_text_that_is_no_polygon_is_refused(text: str, why: str) -> None:
    with pytest.raises(InvalidInput, match=why):
        corners_of(text)


def test_polygons_outside_or_between_the_cells_are_refused() -> None:
    map_ = shown(belief(), GRID)
    with pytest.raises(OutsideRegion, match=r"got \(900, 0\)"):
        estimate(ResourceQuery(polygon="0,0,900,0,50,20"), map_)
    with pytest.raises(InvalidInput, match="centre of a cell"):
        estimate(ResourceQuery(polygon="0,0,1,0,0,1"), map_)


@pytest.mark.parametrize(("size", "samples"), [(200, 60), pytest.param(500, 150, marks=pytest.mark.exhaustive)])
def test_the_90_percent_interval_of_the_regions_mean_holds_the_truth_in_16_of_20_seeds(size: int, samples: int) -> None:
    grid, held = SiteGrid(size, size, 1.0), 0
    for seed in range(20):
        truth = load_region("t1", seed).he3_ppb[:size, :size]
        rng = np.random.default_rng(1000 + seed)
        places = rng.uniform(0, size, (samples, 2))
        values = truth[grid.cells_of(places)] + rng.normal(0, NOISE_STD_PPB, samples)
        fitted = fit_hyperparameters(places, values, "matern52", rng=rng)
        posterior = GridPosterior.build(grid, fitted, places, values)
        whole = np.ones(grid.shape, dtype=np.bool_)
        got = area_mean(posterior.process, grid, posterior.mean_ppb, whole)
        held += abs(got.mean_ppb - truth.mean()) <= 1.6449 * got.std_ppb
    assert held >= 16
