"""Hyperparameters are found by maximum likelihood, within bounds, and never get worse."""

import numpy as np
import pytest

from he3.errors import InvalidInput
from he3.frames import FloatArray
from he3.gp import GaussianProcess
from he3.hyperparameters import (
    CAUTIOUS_FIRST,
    MIN_SAMPLES,
    VERY_STRONG_EVIDENCE,
    Hyperparameters,
    fit_hyperparameters,
    information_criterion,
    parameter_bounds,
    typical_spacing_m,
)
from he3.kernels import AUTO, KERNELS, Kernel, Matern12, SmoothPlusRough, SquaredExponential, squared_distances
from he3.likelihood import log_marginal_likelihood
from services.mission.regions import load_region


def drawn_from(kernel: Kernel, count: int, seed: int, noise: float = 0.1) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, 500, (count, 2))
    factor = np.linalg.cholesky(kernel.covariance(places, places) + 1e-9 * np.eye(count))
    return places, 8.0 + factor @ rng.normal(size=count) + noise * rng.normal(size=count)


def likelihood_of(fitted: Hyperparameters, places: FloatArray, values: FloatArray) -> float:
    z = fitted.standardise(places, values)
    value, _ = log_marginal_likelihood(fitted.kernel, fitted.noise_variance, squared_distances(places, places), z)
    return value - len(z) * float(np.log(fitted.scale_ppb))


@pytest.mark.parametrize("name", list(KERNELS))
def test_the_fit_is_a_maximum_within_bounds_and_at_least_as_likely_as_the_truth(name: str) -> None:
    truth = SmoothPlusRough(1.0, 120.0, 0.3, 25.0) if name == "smooth+rough" else KERNELS[name](1.2, 50.0)
    places, values = drawn_from(truth, 120, seed=11)
    fitted = fit_hyperparameters(places, values, name, rng=np.random.default_rng(0))
    assert fitted.log_likelihood == pytest.approx(likelihood_of(fitted, places, values), rel=1e-9)
    z = fitted.standardise(places, values)
    r2 = squared_distances(places, places)
    value, gradient = log_marginal_likelihood(fitted.kernel, fitted.noise_variance, r2, z)
    in_units = {k: v / fitted.scale_ppb**2 if k.endswith("variance") else v for k, v in truth.parameters().items()}
    of_truth, _ = log_marginal_likelihood(type(truth)(**in_units), fitted.noise_variance, r2, z)
    assert value >= of_truth
    for parameter, slope, (low, high) in zip(
        fitted.kernel.parameters().values(), gradient, parameter_bounds(fitted.kernel), strict=False
    ):
        assert low * (1 - 1e-9) <= parameter <= high * (1 + 1e-9)
        inside = low * 1.001 < parameter < high * 0.999
        assert not inside or abs(slope) < 0.02


def test_the_length_scale_of_a_long_enough_record_is_recovered() -> None:
    places, values = drawn_from(SquaredExponential(1.0, 45.0), 300, seed=3)
    fitted = fit_hyperparameters(places, values, "se", rng=np.random.default_rng(1))
    assert fitted.kernel.parameters()["length_scale_m"] == pytest.approx(45.0, rel=0.1)


@pytest.mark.parametrize("name", ["se", "matern52", "smooth+rough"])
def test_a_length_scale_of_kilometres_is_recovered_on_a_region_of_10_km(name: str) -> None:
    rng = np.random.default_rng(17)
    places, truth = rng.uniform(0, 10_000, (150, 2)), KERNELS["se" if name == "smooth+rough" else name](1.0, 3000.0)
    factor = np.linalg.cholesky(truth.covariance(places, places) + 1e-8 * np.eye(150))
    values = 8.0 + factor @ rng.normal(size=150) + 0.1 * rng.normal(size=150)
    previous = None
    for count in (5, 10, 30, 150):  # as in a mission, where each refit starts from the one before
        previous = fit_hyperparameters(
            places[:count], values[:count], name, rng=np.random.default_rng(count), previous=previous, extent_m=10_000.0
        )
    cold = fit_hyperparameters(places, values, name, rng=np.random.default_rng(0), extent_m=10_000.0)
    for fitted in (previous, cold):
        assert fitted is not None
        found = next(scale for key, scale in fitted.kernel.parameters().items() if key.endswith("length_scale_m"))
        assert 1500 < found < 6000


def test_on_a_region_of_half_a_kilometre_or_less_the_bounds_are_those_of_half_a_kilometre() -> None:
    for kernel in (Matern12(), SquaredExponential(), SmoothPlusRough()):
        assert parameter_bounds(kernel, 30.0) == parameter_bounds(kernel, 30.0, 500.0)
        assert parameter_bounds(kernel, 30.0) == parameter_bounds(kernel, 30.0, 40.0)
    with pytest.raises(InvalidInput, match="positive width"):
        parameter_bounds(Matern12(), extent_m=0.0)


@pytest.mark.parametrize("name", [*KERNELS, AUTO])
def test_a_refit_is_never_less_likely_than_the_hyperparameters_before_it(name: str) -> None:
    places, values = drawn_from(Matern12(1.0, 30.0), 60, seed=21)
    previous = None
    for count in range(5, 61, 5):
        fitted = fit_hyperparameters(
            places[:count], values[:count], name, rng=np.random.default_rng(count), previous=previous
        )
        if previous is not None and previous.kernel.name == fitted.kernel.name:
            ratio = (previous.scale_ppb / fitted.scale_ppb) ** 2
            bounds = parameter_bounds(previous.kernel)
            before = type(previous.kernel)(
                **{
                    key: float(np.clip(value * ratio if key.endswith("variance") else value, low, high))
                    for (key, value), (low, high) in zip(previous.kernel.parameters().items(), bounds, strict=True)
                }
            )
            z = fitted.standardise(places[:count], values[:count])
            r2 = squared_distances(places[:count], places[:count])
            then, _ = log_marginal_likelihood(before, fitted.noise_variance, r2, z)
            now, _ = log_marginal_likelihood(fitted.kernel, fitted.noise_variance, r2, z)
            assert now >= then - 1e-9
        previous = fitted


@pytest.mark.parametrize("truth", [SquaredExponential(1.0, 60.0), Matern12(1.0, 60.0)], ids=lambda kernel: kernel.name)
def test_auto_takes_the_most_cautious_kernel_that_the_evidence_allows(truth: Kernel) -> None:
    places, values = drawn_from(truth, 150, seed=8, noise=0.05)
    evidence = {}
    for name in KERNELS:
        fitted = fit_hyperparameters(places, values, name, rng=np.random.default_rng(2), noise_std_ppb=0.05)
        evidence[name] = information_criterion(fitted)
    assert set(CAUTIOUS_FIRST) == set(KERNELS)
    allowed = [name for name in CAUTIOUS_FIRST if evidence[name] >= max(evidence.values()) - VERY_STRONG_EVIDENCE]
    chosen = fit_hyperparameters(places, values, "auto", rng=np.random.default_rng(2), noise_std_ppb=0.05).kernel
    assert chosen.name == allowed[0]
    near = chosen.of_squared_distance(np.array([0.0, 4.0]))
    smooth = bool(1.0 - near[1] / near[0] < 0.01)
    assert smooth is (truth.name == "se"), "the samples tell a rough field from a smooth one"


def test_on_an_even_lattice_auto_is_not_led_to_intervals_that_are_too_narrow() -> None:
    region = load_region("t1", 103)
    at = (np.arange(12) + 0.5) * 500 / 12
    places = np.column_stack([axis.ravel() for axis in np.meshgrid(at, at)])
    rows, columns = region.grid.cells_of(places)
    values = region.he3_ppb[rows, columns] + np.random.default_rng(0).normal(0.0, 0.1, len(places))
    cells = np.random.default_rng(1).choice(region.he3_ppb.size, 4000, replace=False)
    covered, likelihood = {}, {}
    for name in ("se", "matern12", "auto"):
        fitted = fit_hyperparameters(places, values, name, rng=np.random.default_rng(2))
        mean, std = GaussianProcess(fitted).condition(places, values).predict(region.grid.points()[cells])
        covered[name] = float(np.mean(np.abs(region.he3_ppb.ravel()[cells] - mean) < std))
        likelihood[name] = fitted.log_likelihood
    assert likelihood["se"] > likelihood["matern12"], "the samples are too far apart to see how rough the field is"
    assert covered["se"] < 0.55
    assert covered["auto"] == pytest.approx(0.68, abs=0.1)


def test_a_refit_with_a_few_more_samples_finds_the_same_kernel_from_the_one_before_it_alone() -> None:
    places, values = drawn_from(SmoothPlusRough(1.0, 120.0, 0.3, 25.0), 100, seed=5)
    before = fit_hyperparameters(places[:95], values[:95], "smooth+rough", rng=np.random.default_rng(0))
    searched, nearby = (
        fit_hyperparameters(
            places, values, "smooth+rough", rng=np.random.default_rng(1), previous=before, nearby=nearby
        )
        for nearby in (False, True)
    )
    assert nearby.log_likelihood == pytest.approx(searched.log_likelihood, abs=1e-4)
    assert list(nearby.kernel.parameters().values()) == pytest.approx(
        list(searched.kernel.parameters().values()), rel=0.02
    )


def test_the_same_seed_gives_the_same_hyperparameters_to_the_bit() -> None:
    places, values = drawn_from(Matern12(), 40, seed=5)
    first, second = (fit_hyperparameters(places, values, "auto", rng=np.random.default_rng(9)) for _ in range(2))
    assert first == second


def test_the_noise_is_that_of_the_instrument_whatever_the_samples_suggest() -> None:
    places, values = drawn_from(SquaredExponential(1.0, 80.0), 200, seed=6, noise=0.3)
    rng = np.random.default_rng(0)
    assert fit_hyperparameters(places, values, "se", rng=rng).noise_std_ppb == 0.1


@pytest.mark.parametrize("count", range(MIN_SAMPLES))
@pytest.mark.parametrize("name", ["se", "auto"])
def test_with_few_samples_the_kernel_stays_at_its_default_and_the_scale_is_fitted(count: int, name: str) -> None:
    places, values = drawn_from(Matern12(), 10, seed=5)
    fitted = fit_hyperparameters(places[:count], values[:count], name, rng=np.random.default_rng(9))
    assert fitted.kernel.name == "se"
    assert fitted.kernel.parameters()["length_scale_m"] == pytest.approx(60.0)
    assert np.isfinite([fitted.mean_ppb, fitted.scale_ppb]).all()


def test_equal_values_do_not_divide_by_zero() -> None:
    places = np.random.default_rng(0).uniform(0, 500, (20, 2))
    fitted = fit_hyperparameters(places, np.full(20, 7.0), "se", rng=np.random.default_rng(0))
    assert fitted.mean_ppb == pytest.approx(7.0)
    assert fitted.scale_ppb > 0


def test_values_that_do_not_match_the_places_or_are_not_finite_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InvalidInput, match="expected 2 finite values"):
        fit_hyperparameters(np.zeros((2, 2)), np.zeros(3), "se", rng=rng)
    with pytest.raises(InvalidInput, match="expected 2 finite values"):
        fit_hyperparameters(np.zeros((2, 2)), np.array([1.0, np.nan]), "se", rng=rng)


@pytest.mark.parametrize("name", ["matern12", "smooth+rough"])
def test_an_exponential_covariance_is_not_fitted_shorter_than_the_samples_lie_apart(name: str) -> None:
    x, y = np.meshgrid(np.arange(6) * 30.0, np.arange(6) * 30.0)
    places = np.column_stack((x.ravel(), y.ravel()))
    values = 8.0 + np.random.default_rng(2).normal(size=36)  # white: the likelihood would have it as short as can be
    fitted = fit_hyperparameters(places, values, name, rng=np.random.default_rng(0))
    shortest = [value for key, value in fitted.kernel.parameters().items() if key.endswith("length_scale_m")][-1]
    assert typical_spacing_m(places) == 30.0
    assert shortest >= 30.0 * (1 - 1e-9)


def test_samples_at_one_place_have_no_spacing() -> None:
    assert typical_spacing_m(np.array([[3.0, 4.0]])) == 0.0
    assert typical_spacing_m(np.array([[3.0, 4.0], [3.0, 4.0], [3.0, 4.0]])) == 0.0
    assert typical_spacing_m(np.array([[3.0, 4.0], [3.0, 4.0], [3.0, 9.0]])) == 5.0


@pytest.mark.parametrize("unit", [1e-6, 1e-3, 1.0, 1e3, 1e5])
def test_hyperparameters_do_not_depend_on_the_unit_of_the_field(unit: float) -> None:
    places, values = drawn_from(Matern12(1.0, 60.0), 60, seed=7)
    here = fit_hyperparameters(places, values, "matern52", rng=np.random.default_rng(0), noise_std_ppb=0.0)
    there = fit_hyperparameters(places, values * unit, "matern52", rng=np.random.default_rng(0), noise_std_ppb=0.0)
    assert there.scale_ppb == pytest.approx(here.scale_ppb * unit)
    assert there.kernel.parameters() == pytest.approx(here.kernel.parameters(), rel=1e-3)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_few_samples_of_an_accurate_instrument_do_not_make_the_field_look_known(count: int) -> None:
    places = np.random.default_rng(0).uniform(0, 500, (count, 2))
    fitted = fit_hyperparameters(places, np.full(count, 8.0), "se", rng=np.random.default_rng(0), noise_std_ppb=0.0)
    _, std = GaussianProcess(fitted).condition(places, np.full(count, 8.0)).predict([[900.0, 900.0]])
    assert std[0] > 0.2


def test_the_gradient_counts_the_noise_that_the_floor_adds() -> None:
    places, values = drawn_from(SquaredExponential(1.0, 200.0), 80, seed=3, noise=0.0)
    fitted = fit_hyperparameters(places, values, "se", rng=np.random.default_rng(0), noise_std_ppb=0.0)
    for parameter, factor in ((0, 1.02), (0, 0.98), (1, 1.02), (1, 0.98)):
        changed = list(fitted.kernel.parameters().values())
        changed[parameter] *= factor
        other = Hyperparameters(SquaredExponential(*changed), 0.0, fitted.mean_ppb, fitted.scale_ppb)
        low, high = parameter_bounds(fitted.kernel)[parameter]
        assert (
            not low <= changed[parameter] <= high
            or likelihood_of(other, places, values) <= fitted.log_likelihood + 1e-3
        )
