"""The map is the exact posterior on every cell, built or updated, over a thousand samples."""

from collections.abc import Iterable

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern

from he3.errors import InvalidInput
from he3.frames import SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.kernels import Kernel, Matern12, Matern32, Matern52, SmoothPlusRough, SquaredExponential
from he3.posterior.grid import GridPosterior
from he3.posterior.rows import SPLIT_FROM
from he3.posterior.separable_rows import SeparableRows
from he3.posterior.stored_rows import ROWS_PER_BLOCK, StoredRows
from he3.posterior.tiles import TILE_EDGE, Task, TiledGrid
from he3.trend import orbital_trend

GRID = SiteGrid(45, 60, 5.0)
KERNELS = [
    SquaredExponential(1.2, 40.0),
    Matern12(0.8, 30.0),
    Matern32(1.0, 30.0),
    Matern52(1.1, 35.0),
    SmoothPlusRough(0.8, 90.0, 0.3, 20.0),
]
every_kernel = pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.name)


def samples(count: int, seed: int, grid: SiteGrid = GRID) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, 1, (count, 2)) * [grid.width_m, grid.height_m]
    return places, 8.0 + np.sin(places[:, 0] / 30.0) + 0.1 * rng.normal(size=count)


def one_by_one(works: Iterable[Task]) -> None:
    for work in works:
        work()


def assert_exact(posterior: GridPosterior) -> None:
    mean, deviation = posterior.at(posterior.grid.points())
    scale = posterior.hyperparameters.scale_ppb
    prior = posterior.hyperparameters.kernel.prior_variance * scale**2
    np.testing.assert_allclose(posterior.mean_ppb.ravel(), mean, rtol=1e-5)
    np.testing.assert_allclose(posterior.std_ppb.ravel().astype(float) ** 2, deviation**2, atol=1e-4 * prior)


@every_kernel
def test_built_at_once_or_sample_by_sample_the_map_is_the_exact_posterior(kernel: Kernel) -> None:
    hyperparameters = Hyperparameters(kernel, 0.1, 8.0, 0.9)
    places, values = samples(ROWS_PER_BLOCK + 20, seed=1)
    built = GridPosterior.build(GRID, hyperparameters, places, values)
    grown = GridPosterior(GRID, hyperparameters)
    for place, value in zip(places, values, strict=True):
        grown.add(place, value)
    for posterior in (built, grown):
        assert len(posterior) == len(places)
        assert_exact(posterior)


@every_kernel
@pytest.mark.parametrize("shape", [(TILE_EDGE + 1, 2 * TILE_EDGE + 3), (3, TILE_EDGE), (1, 1)])
def test_a_map_of_any_shape_is_the_exact_posterior(kernel: Kernel, shape: tuple[int, int]) -> None:
    grid = SiteGrid(*shape, 2.0)
    places, values = samples(24, seed=14, grid=grid)
    posterior = GridPosterior.build(grid, Hyperparameters(kernel, 0.1, 8.0, 0.9), places[:20], values[:20], threads=2)
    for place, value in zip(places[20:], values[20:], strict=True):
        posterior.add(place, value)
    assert posterior.mean_ppb.shape == shape
    assert_exact(posterior)


@pytest.mark.parametrize(
    ("kernel", "most"), [(Matern52(1.0, 20.0), 0.5), (SmoothPlusRough(0.8, 150.0, 0.3, 15.0), 0.7)], ids=["m52", "s+r"]
)
def test_a_map_of_many_samples_is_updated_from_few_of_their_rows(kernel: Kernel, most: float) -> None:
    grid = SiteGrid(2 * TILE_EDGE, 2 * TILE_EDGE, 2.0)
    places, values = samples(SPLIT_FROM + 3, seed=15, grid=grid)
    hyperparameters = Hyperparameters(kernel, 0.1, 8.0, 0.9)
    posterior = GridPosterior.build(grid, hyperparameters, places[:-3], values[:-3])
    for place, value in zip(places[-3:], values[-3:], strict=True):
        known = len(posterior)
        posterior.add(place, value)
        assert 0 < posterior.values_read < most * known * grid.rows * grid.columns
    assert_exact(posterior)


@every_kernel
def test_a_map_that_was_not_to_be_followed_is_the_same_to_the_byte_and_takes_samples_all_the_same(
    kernel: Kernel,
) -> None:
    hyperparameters = Hyperparameters(kernel, 0.1, 8.0, 0.9)
    places, values = samples(ROWS_PER_BLOCK + 20, seed=1)
    followed, not_followed = (
        GridPosterior.build(GRID, hyperparameters, places, values, followed=followed) for followed in (True, False)
    )
    for place in (None, (20.0, 31.0), (120.0, 7.0)):
        if place is not None:
            followed.add(place, 8.4)
            not_followed.add(place, 8.4)
        np.testing.assert_array_equal(not_followed.mean_ppb, followed.mean_ppb)
        np.testing.assert_array_equal(not_followed.std_ppb, followed.std_ppb)


def test_the_prior_map_is_flat() -> None:
    posterior = GridPosterior(GRID, Hyperparameters(SquaredExponential(4.0, 40.0), 0.1, 7.5, 0.5))
    assert posterior.mean_ppb.shape == GRID.shape
    assert (posterior.mean_ppb == 7.5).all()
    assert (posterior.std_ppb == 1.0).all()


@pytest.mark.parametrize(
    ("kernel", "authority"),
    [
        (SquaredExponential(1.0, 30.0), ConstantKernel(1.0) * RBF(30.0)),
        (Matern12(1.0, 40.0), ConstantKernel(1.0) * Matern(40.0, nu=0.5)),
        (Matern52(1.0, 40.0), ConstantKernel(1.0) * Matern(40.0, nu=2.5)),
        (
            SmoothPlusRough(0.7, 120.0, 0.3, 20.0),
            ConstantKernel(0.7) * RBF(120.0) + ConstantKernel(0.3) * Matern(20.0, nu=0.5),
        ),
    ],
    ids=["se", "matern12", "matern52", "smooth+rough"],
)
def test_after_a_thousand_updates_the_map_is_that_of_scikit_learn(kernel: Kernel, authority: ConstantKernel) -> None:
    grid = SiteGrid(50, 50, 10.0)
    places, values = samples(1000, seed=3, grid=grid)
    places[500:520] = places[100]  # a place visited again and again
    posterior = GridPosterior(grid, Hyperparameters(kernel, 0.1, 8.0, 1.0))
    for place, value in zip(places, values, strict=True):
        posterior.add(place, value)
    reference = GaussianProcessRegressor(authority, alpha=0.01, optimizer=None).fit(places, values - 8.0)
    mean, deviation = reference.predict(grid.points(), return_std=True)
    np.testing.assert_allclose(posterior.mean_ppb.ravel(), 8.0 + mean, rtol=1e-5)
    np.testing.assert_allclose(posterior.std_ppb.ravel().astype(float) ** 2, deviation**2, atol=1e-4)


@every_kernel
def test_without_noise_crowded_and_repeated_places_keep_the_map_finite_and_its_variance_falling(kernel: Kernel) -> None:
    rng = np.random.default_rng(5)
    posterior = GridPosterior(GRID, Hyperparameters(kernel, 0.0, 8.0, 1.0))
    places = np.round(rng.uniform(100, 130, (150, 2)))
    before = posterior.std_ppb
    for place in np.vstack((places, places[:50])):
        posterior.add(place, 8.0 + float(np.sin(place[0] / 30.0)))
        after = posterior.std_ppb
        assert (after <= before).all()
        before = after
    assert np.isfinite(posterior.mean_ppb).all()
    assert (posterior.std_ppb > 0).all()
    mean, deviation = posterior.at(GRID.points())
    np.testing.assert_allclose(posterior.mean_ppb.ravel(), mean, rtol=1e-5)
    np.testing.assert_allclose(posterior.std_ppb.ravel(), deviation, rtol=1e-3)


def test_rows_of_a_separable_kernel_are_those_that_are_stored() -> None:
    kernel = SquaredExponential(1.2, 40.0)
    places, values = samples(90, seed=10)
    tiled = TiledGrid(GRID)
    stored, separable = StoredRows(tiled, kernel), SeparableRows(tiled, kernel, np.dtype(np.float64))
    process = GaussianProcess(Hyperparameters(kernel, 0.1, 8.0, 1.0))
    for place, value in zip(places, values, strict=True):
        process = process.condition(place[None, :], [value])
        np.testing.assert_allclose(
            stored.next_row(process, one_by_one), separable.next_row(process, one_by_one), atol=1e-5
        )


def test_a_snapshot_cannot_be_written_and_is_not_touched_by_later_samples() -> None:
    posterior = GridPosterior(GRID, Hyperparameters(SquaredExponential(), 0.1, 8.0, 1.0))
    snapshot = posterior.snapshot()
    copies = snapshot.mean_ppb.copy(), snapshot.std_ppb.copy()
    posterior.add([50.0, 50.0], 9.0)
    np.testing.assert_array_equal(snapshot.mean_ppb, copies[0])
    np.testing.assert_array_equal(snapshot.std_ppb, copies[1])
    assert (snapshot.samples, posterior.snapshot().samples) == (0, 1)
    with pytest.raises(ValueError, match="read-only"):
        snapshot.mean_ppb[0, 0] = 1.0


@pytest.mark.parametrize(
    ("kernel", "built"),
    [(SquaredExponential(1.0, 60.0), 66), (Matern12(1.0, 60.0), 66), (SmoothPlusRough(), 0), (SmoothPlusRough(), 66)],
)
def test_the_number_of_threads_changes_no_bit(kernel: Kernel, built: int) -> None:
    grid = SiteGrid(300, 300, 1.0)
    places, values = samples(built + 4, seed=8, grid=grid)
    hyperparameters = Hyperparameters(kernel, 0.1, 8.0, 1.0)
    maps = []
    for threads in (1, 2, 3):
        posterior = GridPosterior.build(grid, hyperparameters, places[:built], values[:built], threads=threads)
        for place, value in zip(places[built:], values[built:], strict=True):
            posterior.add(place, value)
        maps.append((posterior.mean_ppb.tobytes(), posterior.std_ppb.tobytes()))
    assert maps[0] == maps[1] == maps[2]


@every_kernel
@pytest.mark.parametrize("count", [ROWS_PER_BLOCK + 5, 600])
def test_a_map_with_an_orbital_prior_is_the_exact_posterior(kernel: Kernel, count: int) -> None:
    orbital = 7.0 + np.add.outer(np.linspace(0, 2, GRID.rows), np.linspace(0, 1, GRID.columns))
    hyperparameters = Hyperparameters(kernel, 0.1, 0.4, 0.9, trend=orbital_trend(GRID, orbital))
    places, values = samples(count, seed=9)
    built = GridPosterior.build(GRID, hyperparameters, places[:-3], values[:-3])
    for place, value in zip(places[-3:], values[-3:], strict=True):
        built.add(place, value)
    assert_exact(built)


def test_bad_input_is_refused_and_changes_nothing() -> None:
    posterior = GridPosterior(GRID, Hyperparameters(SquaredExponential()))
    with pytest.raises(InvalidInput, match=r"expected one place \(2,\)"):
        posterior.add([[1.0, 2.0]], 3.0)  # type: ignore[list-item]
    with pytest.raises(InvalidInput, match="finite"):
        posterior.add([1.0, 2.0], float("nan"))
    with pytest.raises(InvalidInput, match="expected one thread or more"):
        GridPosterior(GRID, Hyperparameters(SquaredExponential()), threads=0)
    assert len(posterior) == 0


@pytest.mark.parametrize("with_trend", [False, True])
def test_the_process_of_a_map_is_that_of_its_samples_and_is_not_touched_by_later_ones(with_trend: bool) -> None:
    trend = orbital_trend(GRID, np.add.outer(np.linspace(7, 9, GRID.rows), np.zeros(GRID.columns)))
    hyperparameters = Hyperparameters(Matern32(1.0, 30.0), 0.1, 0.4, 0.9, trend=trend if with_trend else None)
    places, values = samples(30, seed=3)
    posterior = GridPosterior.build(GRID, hyperparameters, places[:10], values[:10])
    for count in range(10, 30, 4):
        process = posterior.process
        exact = GaussianProcess(hyperparameters).condition(places[:count], values[:count])
        assert len(process) == len(posterior) == count
        np.testing.assert_allclose(process.factor, exact.factor, atol=1e-10)
        for place, value in zip(places[count : count + 4], values[count : count + 4], strict=True):
            posterior.add(place, value)
        np.testing.assert_allclose(process.factor, exact.factor, atol=1e-10)
        np.testing.assert_allclose(process.predict(places), exact.predict(places), rtol=1e-6, atol=1e-8)
    assert posterior.process is posterior.process
