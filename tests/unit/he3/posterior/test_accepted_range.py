"""For all values that a scenario accepts, the map is the exact posterior.

The range: noise of 0 to 1000 ppb, fields of 1e-3 to 1e6 ppb, cells of 0.01 to 1000 m, places anywhere,
coincident ones too. The authority is scikit-learn, and for few samples the same posterior in 50 decimal digits.
"""

from dataclasses import dataclass
from decimal import Decimal, getcontext

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern

from he3.errors import InvalidInput
from he3.frames import FloatArray, SiteGrid
from he3.gp import Hyperparameters, fit_hyperparameters
from he3.kernels import KERNELS, Kernel, SmoothPlusRough
from he3.posterior import grid as grid_module
from he3.posterior.grid import GridPosterior, expect_map_fits
from he3.trend import orbital_trend

MEAN_TOLERANCE = 1e-5  # of the field's scale
VARIANCE_TOLERANCE = 1e-4  # of the prior variance
STD_TOLERANCE = 0.01  # of the standard deviation itself
NU = {"matern12": 0.5, "matern32": 1.5, "matern52": 2.5}


@dataclass(frozen=True, slots=True)
class Case:
    """A grid, samples on it, and hyperparameters for them."""

    grid: SiteGrid
    places_m: FloatArray
    values_ppb: FloatArray
    hyperparameters: Hyperparameters

    @property
    def prior_std_ppb(self) -> float:
        return float(np.sqrt(self.hyperparameters.kernel.prior_variance) * self.hyperparameters.scale_ppb)

    @property
    def field_scale_ppb(self) -> float:
        return max(float(np.abs(self.values_ppb).max()), abs(self.hyperparameters.mean_ppb), self.prior_std_ppb)


def places_on(grid: SiteGrid, count: int, layout: str, spread: float, rng: np.random.Generator) -> FloatArray:
    size = np.array([grid.width_m, grid.height_m])
    places = rng.uniform(0, 1, (count, 2)) * size
    if layout == "coincident":
        places = places[rng.integers(0, max(1, count // 5), count)]
    elif layout == "clustered":
        centres = places[rng.integers(0, max(1, count // 8), count)]
        places = np.clip(centres + rng.normal(0, spread * size.max(), (count, 2)), 0, size)
    return places


def kernel_of(name: str, length_m: float, variance: float) -> Kernel:
    if name == "smooth+rough":
        return SmoothPlusRough(0.7 * variance, 2 * length_m, 0.3 * variance, 0.5 * length_m)
    kernel: Kernel = KERNELS[name](variance, length_m)  # type: ignore[call-arg]
    return kernel


@st.composite
def cases(draw: st.DrawFn, largest: int) -> Case:
    decades = st.floats(0.0, 1.0)

    def between(low: float, high: float) -> float:
        return float(low * (high / low) ** draw(decades))

    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    grid = SiteGrid(draw(st.integers(1, 40)), draw(st.integers(1, 40)), between(0.01, 1000.0))
    width = max(grid.width_m, grid.height_m)
    count = draw(st.integers(1, largest))
    places = places_on(
        grid, count, draw(st.sampled_from(["anywhere", "clustered", "coincident"])), between(1e-4, 0.1), rng
    )
    length = width * between(0.05, 5.0)
    level = between(1e-3, 1e6)
    std = level * between(1e-3, 1.0)
    noise = draw(st.sampled_from([0.0, 1.0])) * between(1e-6, 1000.0)
    values = level + std * (np.sin(places[:, 0] / length) + np.cos(1.3 * places[:, 1] / length))
    values += noise * rng.normal(size=count)
    name = draw(st.sampled_from(sorted(KERNELS)))
    match draw(st.sampled_from(["fitted", "standardised", "in ppb"])):
        case "fitted":
            fitted = fit_hyperparameters(places, values, name, rng=rng, noise_std_ppb=noise, extent_m=width)
            return Case(grid, places, values, fitted)
        case "standardised":
            kernel = kernel_of(name, length, between(0.02, 10.0))
            return Case(grid, places, values, Hyperparameters(kernel, noise, level, std))
        case _:
            return Case(grid, places, values, Hyperparameters(kernel_of(name, length, std**2), noise, level, 1.0))


def of_scikit_learn(case: Case) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation [ppb] of every cell."""
    given = case.hyperparameters
    p = given.kernel.parameters()
    if given.kernel.name == "smooth+rough":
        kernel = ConstantKernel(p["smooth_variance"]) * RBF(p["smooth_length_scale_m"])
        kernel += ConstantKernel(p["rough_variance"]) * Matern(p["rough_length_scale_m"], nu=0.5)
    else:
        length = p["length_scale_m"]
        shape = RBF(length) if given.kernel.name == "se" else Matern(length, nu=NU[given.kernel.name])
        kernel = ConstantKernel(p["variance"]) * shape
    reference = GaussianProcessRegressor(kernel, alpha=given.noise_variance, optimizer=None)
    reference.fit(case.places_m, (case.values_ppb - given.mean_ppb) / given.scale_ppb)
    mean, std = reference.predict(case.grid.points(), return_std=True)
    return mean * given.scale_ppb + given.mean_ppb, std * given.scale_ppb


def grown(case: Case, built: int) -> GridPosterior:
    """The map built from the first samples, the others added one by one."""
    posterior = GridPosterior.build(
        case.grid, case.hyperparameters, case.places_m[:built], case.values_ppb[:built], threads=1
    )
    for place, value in zip(case.places_m[built:], case.values_ppb[built:], strict=True):
        posterior.add(place, value)
    return posterior


def assert_map_is(case: Case, posterior: GridPosterior, mean_ppb: FloatArray, std_ppb: FloatArray) -> None:
    mean, std = (values.ravel().astype(np.float64) for values in (posterior.mean_ppb, posterior.std_ppb))
    assert np.abs(mean - mean_ppb).max() <= MEAN_TOLERANCE * case.field_scale_ppb
    assert np.abs(std**2 - std_ppb**2).max() <= VARIANCE_TOLERANCE * case.prior_std_ppb**2
    assert (std > 0).all()
    # The authority is itself rounded in float64.
    rounding = 1e-12 * case.prior_std_ppb**2
    assert (np.abs(std**2 - std_ppb**2) <= 2 * STD_TOLERANCE * std_ppb**2 + rounding).all()


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(cases(largest=120), st.floats(0.0, 1.0))
def test_the_map_is_that_of_scikit_learn(case: Case, share_built: float) -> None:
    mean, std = of_scikit_learn(case)
    assert_map_is(case, grown(case, round(share_built * len(case.places_m))), mean, std)


def in_fifty_digits(kernel: Kernel, case: Case, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation [ppb] at places (k, 2) [m], by Cholesky factorisation in 50 decimal digits."""
    getcontext().prec = 50
    noise = Decimal(case.hyperparameters.noise_variance)

    def covariance(a: FloatArray, b: FloatArray) -> Decimal:
        r2 = sum((Decimal(float(p)) - Decimal(float(q))) ** 2 for p, q in zip(a, b, strict=True))
        return exact_kernel(kernel, Decimal(r2))

    places = case.places_m
    n = len(places)
    factor = [[Decimal(0)] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            rest = covariance(places[i], places[j]) + (noise if i == j else 0)
            rest -= sum(factor[i][k] * factor[j][k] for k in range(j))
            factor[i][j] = rest.sqrt() if i == j else rest / factor[j][j]

    def whitened(right: list[Decimal]) -> list[Decimal]:
        solved: list[Decimal] = []
        for i in range(n):
            solved.append((right[i] - sum(factor[i][k] * solved[k] for k in range(i))) / factor[i][i])
        return solved

    given = case.hyperparameters
    scale, level = Decimal(given.scale_ppb), Decimal(given.mean_ppb)
    residual = whitened([(Decimal(float(v)) - level) / scale for v in case.values_ppb])
    means, stds = [], []
    for point in points:
        row = whitened([covariance(place, point) for place in places])
        means.append(float(level + scale * sum(a * b for a, b in zip(row, residual, strict=True))))
        variance = exact_kernel(kernel, Decimal(0)) - sum(v * v for v in row)
        stds.append(float(scale * variance.sqrt()))
    return np.array(means), np.array(stds)


def exact_kernel(kernel: Kernel, r2: Decimal) -> Decimal:
    """The kernel at a squared distance [m^2] (Rasmussen & Williams 2006, eqs. 4.9, 4.14 to 4.17)."""
    if isinstance(kernel, SmoothPlusRough):
        return exact_kernel(kernel.smooth, r2) + exact_kernel(kernel.rough, r2)
    variance, length = (Decimal(value) for value in kernel.parameters().values())
    if kernel.name == "se":
        return variance * (-r2 / (2 * length**2)).exp()
    a = (Decimal(2 * NU[kernel.name]) * r2).sqrt() / length
    factor = {"matern12": Decimal(1), "matern32": 1 + a, "matern52": 1 + a + a * a / 3}[kernel.name]
    return variance * factor * (-a).exp()


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(cases(largest=7))
def test_the_map_of_few_samples_is_the_posterior_computed_in_fifty_digits(case: Case) -> None:
    cells = np.unique(np.linspace(0, case.grid.rows * case.grid.columns - 1, 9).astype(int))
    mean_ppb, std_ppb = in_fifty_digits(case.hyperparameters.kernel, case, case.grid.points()[cells])
    posterior = grown(case, len(case.places_m) // 2)
    mean, std = (values.ravel()[cells].astype(np.float64) for values in (posterior.mean_ppb, posterior.std_ppb))
    assert np.abs(mean - mean_ppb).max() <= MEAN_TOLERANCE * case.field_scale_ppb
    assert np.abs(std**2 - std_ppb**2).max() <= VARIANCE_TOLERANCE * case.prior_std_ppb**2
    assert (np.abs(std - std_ppb) <= STD_TOLERANCE * std_ppb).all()


@pytest.mark.parametrize("name", sorted(KERNELS))
def test_the_map_of_an_accurate_instrument_is_that_of_scikit_learn(name: str) -> None:
    grid = SiteGrid(60, 60)
    rng = np.random.default_rng(1)
    places = rng.uniform(0, 60, (150, 2))
    values = 8 + 2 * np.sin(places[:, 0] / 9) + 1.5 * np.cos(places[:, 1] / 7) + 0.001 * rng.normal(size=150)
    fitted = fit_hyperparameters(places, values, name, rng=rng, noise_std_ppb=0.001, extent_m=60)
    case = Case(grid, places, values, fitted)
    mean, std = of_scikit_learn(case)
    for built in (0, 75, 150):
        assert_map_is(case, grown(case, built), mean, std)


@settings(max_examples=30, deadline=None)
@given(cases(largest=60), st.floats(1e-3, 1e6))
def test_with_an_orbital_map_of_any_size_the_map_is_that_of_the_process(case: Case, orbital_ppb: float) -> None:
    points = case.grid.points()
    orbital = orbital_ppb * (1.0 + 0.3 * np.sin(points[:, 0] / case.grid.width_m * 4)).reshape(case.grid.shape)
    trend = orbital_trend(case.grid, orbital)
    fitted = fit_hyperparameters(
        case.places_m, case.values_ppb, "matern52", rng=np.random.default_rng(0),
        noise_std_ppb=case.hyperparameters.noise_std_ppb, trend=trend,
        extent_m=max(case.grid.width_m, case.grid.height_m),
    )  # fmt: skip
    posterior = grown(Case(case.grid, case.places_m, case.values_ppb, fitted), len(case.places_m) // 2)
    mean, std = posterior.at(points)
    scale = max(float(np.abs(case.values_ppb).max()), fitted.scale_ppb, orbital_ppb)
    np.testing.assert_allclose(posterior.mean_ppb.ravel(), mean, rtol=0, atol=2 * MEAN_TOLERANCE * scale)
    prior = fitted.prior_variance(points).max() * fitted.scale_ppb**2
    np.testing.assert_allclose(posterior.std_ppb.ravel().astype(float) ** 2, std**2, atol=VARIANCE_TOLERANCE * prior)
    assert (posterior.std_ppb > 0).all()


def test_a_map_that_would_not_fit_into_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    grid, rng = SiteGrid(20, 20), np.random.default_rng(3)
    places, values = rng.uniform(0, 20, (100, 2)), rng.normal(8.0, 1.0, 100)
    hyperparameters = Hyperparameters(KERNELS["matern52"](), 0.1, 8.0, 1.0)
    monkeypatch.setattr(grid_module, "MAX_ROW_BYTES", 99 * 400 * 4)
    with pytest.raises(InvalidInput, match="for 100 samples on 20 x 20 cells"):
        GridPosterior.build(grid, hyperparameters, places, values)
    posterior = GridPosterior.build(grid, hyperparameters, places[:49], values[:49])
    assert len(posterior) == 49
    expect_map_fits(grid, "matern52", 99)
    expect_map_fits(grid, "se", 4000)
    for name in ("matern52", "auto"):
        with pytest.raises(InvalidInput, match="for 100 samples on 20 x 20 cells"):
            expect_map_fits(grid, name, 100)
    accurate = Hyperparameters(KERNELS["matern52"](1.0, 200.0), 0.03, 8.0, 1.0)
    assert len(GridPosterior.build(grid, accurate, places[:99], values[:99])) == 99, (
        "in float64, which takes twice that"
    )


def test_more_samples_than_a_map_holds_are_refused() -> None:
    places = np.zeros((4001, 2))
    with pytest.raises(InvalidInput, match="at most 4000 samples"):
        GridPosterior.build(SiteGrid(4, 4), Hyperparameters(KERNELS["se"]()), places, np.zeros(4001))
