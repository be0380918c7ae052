"""The exact Gaussian process agrees with scikit-learn and with closed forms, and behaves as a belief must."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern

from he3.errors import InvalidInput
from he3.gp import GaussianProcess, Hyperparameters
from he3.kernels import Kernel, Matern12, Matern32, Matern52, SmoothPlusRough, SquaredExponential

CASES = [
    (SquaredExponential(1.3, 40.0), ConstantKernel(1.3) * RBF(40.0)),
    (Matern12(0.6, 25.0), ConstantKernel(0.6) * Matern(25.0, nu=0.5)),
    (Matern32(2.0, 33.0), ConstantKernel(2.0) * Matern(33.0, nu=1.5)),
    (Matern52(0.9, 55.0), ConstantKernel(0.9) * Matern(55.0, nu=2.5)),
    (
        SmoothPlusRough(0.8, 130.0, 0.3, 20.0),
        ConstantKernel(0.8) * RBF(130.0) + ConstantKernel(0.3) * Matern(20.0, nu=0.5),
    ),
]
PRIOR = Hyperparameters(SquaredExponential(1.2, 50.0), noise_std_ppb=0.1, mean_ppb=8.0, scale_ppb=1.5)
places_on_site = st.integers(1, 12).flatmap(
    lambda n: arrays(np.float64, (n, 2), elements=st.floats(0, 500, allow_subnormal=False))
)


def samples(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(0, 500, (count, 2)), rng.normal(8.0, 1.5, count)


@pytest.mark.parametrize(("kernel", "authority"), CASES, ids=[kernel.name for kernel, _ in CASES])
@pytest.mark.parametrize("noise_std_ppb", [0.1, 0.002])
def test_mean_deviation_and_covariance_are_those_of_scikit_learn(
    kernel: Kernel, authority: ConstantKernel, noise_std_ppb: float
) -> None:
    hyperparameters = Hyperparameters(kernel, noise_std_ppb, mean_ppb=8.0, scale_ppb=1.5)
    places, values = samples(80, seed=1)
    belief = GaussianProcess(hyperparameters).condition(places, values)
    reference = GaussianProcessRegressor(authority, alpha=(noise_std_ppb / 1.5) ** 2, optimizer=None)
    reference.fit(places, (values - 8.0) / 1.5)
    points, _ = samples(50, seed=2)
    mean, deviation = reference.predict(points, return_std=True)
    ours, spread = belief.predict(points)
    np.testing.assert_allclose(ours, 8.0 + 1.5 * mean, rtol=1e-7)
    np.testing.assert_allclose(spread, 1.5 * deviation, rtol=1e-6, atol=1e-7)
    _, covariance = reference.predict(points, return_cov=True)
    np.testing.assert_allclose(belief.posterior_covariance(points), 2.25 * covariance, atol=1e-8)
    others, _ = samples(7, seed=3)
    _, joint = reference.predict(np.vstack((points, others)), return_cov=True)
    np.testing.assert_allclose(belief.posterior_covariance(points, others), 2.25 * joint[:50, 50:], atol=1e-8)


def test_a_drawn_observation_comes_from_the_prediction_and_is_then_known() -> None:
    places, values = samples(30, seed=4)
    belief = GaussianProcess(PRIOR).condition(places, values)
    place = np.array([120.0, 310.0])
    told: list[float] = []
    value, after = belief.drawn(place, lambda mean, std: told.extend((mean, std)) or mean + 2.0 * std)
    (mean,), (std,) = belief.predict([place])
    assert told == pytest.approx([mean, std], rel=1e-9)
    assert value == pytest.approx(mean + 2.0 * std)
    np.testing.assert_allclose(after.predict(places), belief.condition([place], [value]).predict(places), rtol=1e-9)


def test_one_sample_has_its_closed_form() -> None:
    belief = GaussianProcess(PRIOR).condition([[100.0, 200.0]], [9.5])
    mean, deviation = belief.predict([[130.0, 240.0]])
    covariance = 1.2 * np.exp(-(50.0**2) / (2 * 50.0**2))
    total = 1.2 + (0.1 / 1.5) ** 2
    assert mean[0] == pytest.approx(8.0 + 1.5 * covariance / total * (1.5 / 1.5), rel=1e-12)
    assert deviation[0] == pytest.approx(1.5 * np.sqrt(1.2 - covariance**2 / total), rel=1e-12)


def test_without_samples_the_belief_is_the_prior() -> None:
    mean, deviation = GaussianProcess(PRIOR).predict([[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_allclose(mean, 8.0)
    np.testing.assert_allclose(deviation, 1.5 * np.sqrt(1.2))


def test_conditioning_returns_a_new_belief_and_leaves_the_old_one() -> None:
    places, values = samples(20, seed=4)
    before = GaussianProcess(PRIOR).condition(places[:10], values[:10])
    expected = before.predict(places)
    after = before.condition(places[10:], values[10:])
    np.testing.assert_array_equal(before.predict(places), expected)
    assert (len(before), len(after)) == (10, 20)


@settings(max_examples=60)
@given(places_on_site, st.integers(0, 2**32 - 1))
def test_one_by_one_or_all_at_once_or_in_another_order_is_the_same_belief(places: np.ndarray, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(8.0, 1.5, len(places))
    points = rng.uniform(0, 500, (9, 2))
    at_once = GaussianProcess(PRIOR).condition(places, values)
    order = rng.permutation(len(places))
    one_by_one = GaussianProcess(PRIOR)
    for index in order:
        one_by_one = one_by_one.condition(places[index : index + 1], values[index : index + 1])
    for ours, theirs in zip(at_once.predict(points), one_by_one.predict(points), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-7)


@settings(max_examples=60)
@given(places_on_site, places_on_site)
def test_variance_never_grows_with_data_and_never_turns_negative(first: np.ndarray, second: np.ndarray) -> None:
    points = np.vstack((first, second, [[250.0, 250.0]]))
    before = GaussianProcess(PRIOR).condition_on_places(first)
    after = before.condition_on_places(np.vstack((second, second)))
    assert (after.predict(points)[1] <= before.predict(points)[1] + 1e-9).all()
    assert (after.predict(points)[1] >= 0).all()


def test_a_place_measured_many_times_is_known_as_well_as_their_average() -> None:
    place = np.tile([[40.0, 60.0]], (400, 1))
    values = np.full(400, 9.0)
    mean, deviation = GaussianProcess(PRIOR).condition(place, values).predict(place[:1])
    averaged = PRIOR.noise_variance / 400
    assert deviation[0] == pytest.approx(1.5 * np.sqrt(1.2 * averaged / (1.2 + averaged)), rel=1e-6)
    assert mean[0] == pytest.approx(9.0, abs=1e-3)


@pytest.mark.parametrize("noise_std_ppb", [0.0, 1e-9])
def test_a_thousand_samples_without_noise_at_crowded_and_repeated_places_stay_finite(noise_std_ppb: float) -> None:
    rng = np.random.default_rng(0)
    places = np.round(rng.uniform(0, 20, (1000, 2)))  # 441 different places at most
    values = 8.0 + np.sin(places[:, 0] / 60.0)
    hyperparameters = Hyperparameters(SquaredExponential(1.0, 100.0), noise_std_ppb, 8.0, 1.0)
    belief = GaussianProcess(hyperparameters)
    for start in range(0, 1000, 100):
        belief = belief.condition(places[start : start + 100], values[start : start + 100])
    mean, deviation = belief.predict(places)
    assert np.isfinite(mean).all()
    assert (deviation >= 0).all()
    assert np.abs(mean - values).max() < 1e-3


def test_places_without_values_lower_the_variance_and_keep_the_mean() -> None:
    places, values = samples(15, seed=5)
    belief = GaussianProcess(PRIOR).condition(places, values)
    planned, _ = samples(5, seed=6)
    points, _ = samples(30, seed=7)
    ahead = belief.condition_on_places(planned)
    with_any_values = belief.condition(planned, np.arange(5.0))
    np.testing.assert_allclose(ahead.predict(points)[0], belief.predict(points)[0], rtol=1e-12)
    np.testing.assert_allclose(ahead.predict(points)[1], with_any_values.predict(points)[1], rtol=1e-12)
    assert ahead.predict(planned)[1].max() < belief.predict(planned)[1].max()


def test_a_batch_of_sets_has_the_covariances_of_each_set_alone() -> None:
    places, values = samples(15, seed=8)
    sets = np.random.default_rng(9).uniform(0, 500, (11, 4, 2))
    for belief in (GaussianProcess(PRIOR), GaussianProcess(PRIOR).condition(places, values)):
        batch = belief.posterior_covariances(sets)
        for one, points in zip(batch, sets, strict=True):
            np.testing.assert_allclose(one, belief.posterior_covariance(points), atol=1e-12)


def test_bad_places_and_values_are_refused() -> None:
    belief = GaussianProcess(PRIOR)
    with pytest.raises(InvalidInput, match=r"expected places of shape \(N, 2\)"):
        belief.condition([1.0, 2.0], [3.0])
    with pytest.raises(InvalidInput, match="expected 1 finite values"):
        belief.condition([[1.0, 2.0]], [np.inf])
