"""Information in nats: closed forms, chain rule, submodularity; and the RMSE of a map."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from he3.errors import InvalidInput, NumericalFailure
from he3.gp import GaussianProcess, Hyperparameters
from he3.information import information_gain, information_gains, rmse
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


def test_of_each_measurement_counts_its_share_of_what_it_adds_to_those_before_it() -> None:
    sets = np.random.default_rng(5).uniform(0, 200, (6, 4, 2))
    stack = GaussianProcess(PRIOR).condition_on_places(places(10, 4)).posterior_covariances(sets)
    of_first = np.array([[information_gain(each[:k, :k], NOISE) for k in range(5)] for each in stack])
    shares = np.random.default_rng(6).uniform(0, 1, (6, 4))
    counted = (shares * np.diff(of_first, axis=1)).sum(axis=1)
    np.testing.assert_allclose(information_gains(stack, NOISE, shares), counted, rtol=1e-9)
    np.testing.assert_array_equal(information_gains(stack, NOISE, np.ones((6, 4))), information_gains(stack, NOISE))
    assert not information_gains(stack, NOISE, np.zeros((6, 4))).any()


def test_what_is_not_a_covariance_is_refused() -> None:
    with pytest.raises(InvalidInput, match="expected one covariance"):
        information_gain(np.zeros(3), 0.1)
    with pytest.raises(InvalidInput, match="expected covariances"):
        information_gains(np.zeros((2, 3)), 0.1)
    with pytest.raises(InvalidInput, match="expected a positive noise variance"):
        information_gain(np.eye(2), 0.0)
    with pytest.raises(InvalidInput, match=r"expected shares \(2, 3\) of the measurements' information, got \(3,\)"):
        information_gains(np.stack((np.eye(3), np.eye(3))), 0.1, np.ones(3))
    with pytest.raises(NumericalFailure, match="not positive definite"):
        information_gain(-np.eye(2), 0.1)


def test_rmse_of_a_constant_error_is_that_error() -> None:
    truth = np.random.default_rng(7).normal(size=(10, 12)).astype(np.float32)
    assert rmse(truth, truth + np.float32(0.25)) == pytest.approx(0.25, rel=1e-6)
    with pytest.raises(InvalidInput, match="expected arrays of one shape"):
        rmse(truth, truth.T)
