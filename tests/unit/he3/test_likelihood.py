"""The log marginal likelihood and its gradient agree with scikit-learn, closed forms and finite differences."""

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern

from he3.kernels import (
    Kernel,
    Matern12,
    Matern32,
    Matern52,
    SmoothPlusRough,
    SquaredExponential,
    squared_distances,
    with_log_parameters,
)
from he3.likelihood import log_marginal_likelihood

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


@pytest.mark.parametrize(("kernel", "authority"), CASES, ids=[kernel.name for kernel, _ in CASES])
@pytest.mark.parametrize("noise_variance", [0.01, 1e-5])
def test_value_and_gradient_are_those_of_scikit_learn(
    kernel: Kernel, authority: ConstantKernel, noise_variance: float
) -> None:
    rng = np.random.default_rng(4)
    places, z = rng.uniform(0, 500, (60, 2)), rng.normal(size=60)
    reference = GaussianProcessRegressor(authority, alpha=noise_variance, optimizer=None).fit(places, z)
    expected, expected_gradient = reference.log_marginal_likelihood(authority.theta, eval_gradient=True)
    value, gradient = log_marginal_likelihood(kernel, noise_variance, squared_distances(places, places), z)
    assert value == pytest.approx(expected, rel=1e-10)
    np.testing.assert_allclose(gradient[:-1], expected_gradient, rtol=1e-6, atol=1e-8 * abs(expected_gradient).max())


@pytest.mark.parametrize("kernel", [kernel for kernel, _ in CASES], ids=lambda kernel: kernel.name)
def test_the_gradient_is_that_of_finite_differences_noise_and_trend_included(kernel: Kernel) -> None:
    rng = np.random.default_rng(5)
    places, z = rng.uniform(0, 300, (30, 2)), rng.normal(size=30)
    r2 = squared_distances(places, places)
    basis = rng.normal(size=(30, 2))
    trend = basis @ basis.T
    theta = np.log([*kernel.parameters().values(), 0.02])
    _, gradient = log_marginal_likelihood(kernel, 0.02, r2, z, trend)

    def value(at: np.ndarray) -> float:
        shifted = with_log_parameters(kernel, at[:-1])
        return log_marginal_likelihood(shifted, float(np.exp(at[-1])), r2, z, trend)[0]

    step = 1e-5
    numeric = [(value(theta + step * e) - value(theta - step * e)) / (2 * step) for e in np.eye(len(theta))]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-5, atol=1e-6)


def test_one_observation_has_the_density_of_a_normal_variable() -> None:
    value, gradient = log_marginal_likelihood(SquaredExponential(1.5, 10.0), 0.5, np.zeros((1, 1)), np.array([0.7]))
    assert value == pytest.approx(-0.5 * 0.49 / 2.0 - 0.5 * np.log(2.0 * np.pi * 2.0), rel=1e-14)
    by_total_variance = 0.5 * 0.49 / 4.0 - 0.5 / 2.0
    np.testing.assert_allclose(gradient, [1.5 * by_total_variance, 0.0, 0.5 * by_total_variance], atol=1e-15)
