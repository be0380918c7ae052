"""Information in nats: closed forms, chain rule, submodularity; and the measures of how good a map is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from he3.errors import InvalidInput, NumericalFailure
from he3.gp import GaussianProcess, Hyperparameters
from he3.information import (
    calibration,
    coverage,
    differential_entropy,
    information_gain,
    information_gains,
    rmse,
    single_place_gain,
)
from he3.kernels import Matern32

PRIOR = Hyperparameters(Matern32(1.0, 40.0), 0.1, 8.0, 1.0)
NOISE = PRIOR.noise_variance_ppb2


def places(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 200, (count, 2))


def test_one_place_and_independent_places_have_closed_forms() -> None:
    assert information_gain(np.array([[3.0]]), 0.5) == pytest.approx(0.5 * np.log(7.0), rel=1e-14)
    assert information_gain(np.diag([1.0, 2.0]), 0.1) == pytest.approx(0.5 * np.log(11.0 * 21.0), rel=1e-14)
    assert information_gain(np.zeros((2, 2)), 0.1) == 0.0
    assert information_gain(np.zeros((0, 0)), 0.1) == 0.0
    np.testing.assert_allclose(single_place_gain(np.array([3.0]), 0.5), [0.5 * np.log(7.0)])


def test_the_same_place_twice_is_one_measurement_with_half_the_noise() -> None:
    assert information_gain(np.full((2, 2), 3.0), 0.5) == pytest.approx(information_gain(np.array([[3.0]]), 0.25))


@settings(max_examples=40)
@given(st.integers(1, 8), st.integers(1, 8), st.integers(0, 10**6))
def test_information_adds_up_by_the_chain_rule_and_never_helps_twice(first: int, second: int, seed: int) -> None:
    a, b = places(first, seed), places(second, seed + 1)
    belief = GaussianProcess(PRIOR)
    both = information_gain(belief.posterior_covariance(np.vstack((a, b))), NOISE)
    of_a = information_gain(belief.posterior_covariance(a), NOISE)
    of_b = information_gain(belief.posterior_covariance(b), NOISE)
    of_b_after_a = information_gain(belief.condition_on_places(a).posterior_covariance(b), NOISE)
    assert both == pytest.approx(of_a + of_b_after_a, rel=1e-8)
    assert 0.0 <= of_b_after_a <= of_b + 1e-9


def test_a_stack_has_the_information_of_each_of_its_members() -> None:
    sets = np.random.default_rng(3).uniform(0, 200, (6, 5, 4, 2))
    belief = GaussianProcess(PRIOR).condition_on_places(places(10, 4))
    stack = belief.posterior_covariances(sets.reshape(30, 4, 2)).reshape(6, 5, 4, 4)
    gains = information_gains(stack, NOISE)
    assert gains.shape == (6, 5)
    for index in np.ndindex(6, 5):
        assert gains[index] == pytest.approx(information_gain(stack[index], NOISE), rel=1e-12)


def test_the_papers_entropy_differs_by_a_constant_per_sample_when_noise_is_small_and_can_be_negative() -> None:
    covariance = GaussianProcess(PRIOR).posterior_covariance(places(5, 5))
    tiny = 1e-9
    constant = 0.5 * 5 * np.log(2.0 * np.pi * np.e * tiny)
    assert differential_entropy(covariance) - constant == pytest.approx(information_gain(covariance, tiny), rel=1e-5)
    assert differential_entropy(1e-3 * covariance) < 0 < information_gain(1e-3 * covariance, 0.01)


def test_what_is_not_a_covariance_is_refused() -> None:
    with pytest.raises(InvalidInput, match="expected one covariance"):
        information_gain(np.zeros(3), 0.1)
    with pytest.raises(InvalidInput, match="expected covariances"):
        information_gains(np.zeros((2, 3)), 0.1)
    with pytest.raises(InvalidInput, match="expected a positive noise variance"):
        information_gain(np.eye(2), 0.0)
    with pytest.raises(NumericalFailure, match="not positive definite"):
        information_gain(-np.eye(2), 0.1)
    with pytest.raises(NumericalFailure, match="entropy of a singular covariance"):
        differential_entropy(np.ones((2, 2)))


def test_an_honest_belief_covers_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(6)
    truth, sigma = np.zeros((200, 200)), rng.uniform(0.1, 2.0, (200, 200))
    mean = sigma * rng.normal(size=truth.shape)
    within = calibration(truth, mean, sigma)
    assert within.within_1_sigma == pytest.approx(0.6827, abs=0.01)
    assert within.within_2_sigma == pytest.approx(0.9545, abs=0.01)
    assert coverage(truth, mean, sigma, 0.9) == pytest.approx(0.9, abs=0.01)
    assert calibration(truth, mean, 0.5 * sigma).within_1_sigma < 0.45


def test_rmse_of_a_constant_error_is_that_error() -> None:
    truth = np.random.default_rng(7).normal(size=(10, 12)).astype(np.float32)
    assert rmse(truth, truth + np.float32(0.25)) == pytest.approx(0.25, rel=1e-6)
    with pytest.raises(InvalidInput, match="expected arrays of one shape"):
        rmse(truth, truth.T)
