"""Kernels agree with scikit-learn, with finite differences and with their own fast form."""

import numpy as np
import pytest
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern

from he3.errors import InvalidInput
from he3.kernels import (
    KERNELS,
    Kernel,
    Matern12,
    Matern32,
    Matern52,
    SmoothPlusRough,
    SquaredExponential,
    kernel_from,
    squared_distances,
    with_log_parameters,
)

EXAMPLES: dict[str, tuple[Kernel, object]] = {
    "se": (SquaredExponential(1.3, 40.0), ConstantKernel(1.3) * RBF(40.0)),
    "matern12": (Matern12(0.6, 25.0), ConstantKernel(0.6) * Matern(25.0, nu=0.5)),
    "matern32": (Matern32(2.0, 33.0), ConstantKernel(2.0) * Matern(33.0, nu=1.5)),
    "matern52": (Matern52(0.9, 55.0), ConstantKernel(0.9) * Matern(55.0, nu=2.5)),
    "smooth+rough": (
        SmoothPlusRough(0.8, 130.0, 0.3, 20.0),
        ConstantKernel(0.8) * RBF(130.0) + ConstantKernel(0.3) * Matern(20.0, nu=0.5),
    ),
}
every_kernel = pytest.mark.parametrize("name", list(KERNELS))


@every_kernel
def test_covariances_are_those_of_scikit_learn(name: str) -> None:
    kernel, authority = EXAMPLES[name]
    rng = np.random.default_rng(1)
    a, b = rng.uniform(0, 500, (40, 2)), rng.uniform(0, 500, (30, 2))
    np.testing.assert_allclose(kernel.covariance(a, b), authority(a, b), rtol=1e-9, atol=1e-14)


@every_kernel
def test_derivatives_are_those_of_scikit_learn_and_of_finite_differences(name: str) -> None:
    kernel, authority = EXAMPLES[name]
    places = np.random.default_rng(2).uniform(0, 200, (25, 2))
    r2 = squared_distances(places, places)
    value, derivatives = kernel.with_log_gradients(r2)
    np.testing.assert_allclose(value, kernel.of_squared_distance(r2), rtol=1e-14)
    np.testing.assert_allclose(np.stack(derivatives, axis=-1), authority(places, eval_gradient=True)[1], atol=1e-12)
    theta = np.log(list(kernel.parameters().values()))
    step = 1e-6
    for index, derivative in enumerate(derivatives):
        shift = np.eye(len(theta))[index] * step
        ahead = with_log_parameters(kernel, theta + shift).of_squared_distance(r2)
        behind = with_log_parameters(kernel, theta - shift).of_squared_distance(r2)
        np.testing.assert_allclose(derivative, (ahead - behind) / (2 * step), atol=1e-8)


@every_kernel
def test_the_fast_float32_form_differs_from_the_direct_one_by_rounding_only(name: str) -> None:
    kernel, _ = EXAMPLES[name]
    r2 = np.random.default_rng(3).uniform(0, 700.0**2, (50, 60))
    out = np.empty(r2.shape, dtype=np.float32)
    kernel.fill(r2.astype(np.float32), out)
    np.testing.assert_allclose(out, kernel.of_squared_distance(r2), rtol=0, atol=2e-6 * kernel.prior_variance)


@every_kernel
def test_a_place_with_itself_has_the_prior_variance_and_covariance_falls_with_distance(name: str) -> None:
    kernel, _ = EXAMPLES[name]
    values = kernel.of_squared_distance(np.linspace(0.0, 600.0, 200) ** 2)
    assert values[0] == pytest.approx(kernel.prior_variance, rel=1e-14)
    assert (np.diff(values) <= 0).all()
    assert (values >= 0).all()


@every_kernel
def test_the_correlation_is_a_half_at_the_distance_that_the_kernel_states(name: str) -> None:
    kernel = EXAMPLES[name][0]
    if isinstance(kernel, SmoothPlusRough):
        kernel = kernel.rough
    distance_m = KERNELS[name].half_correlation_scales * kernel.parameters()["length_scale_m"]
    assert kernel.of_squared_distance(np.array([distance_m**2]))[0] == pytest.approx(
        0.5 * kernel.prior_variance, rel=1e-3
    )


@every_kernel
def test_a_kernel_survives_the_wire(name: str) -> None:
    kernel, _ = EXAMPLES[name]
    assert kernel_from(kernel.name, kernel.parameters()) == kernel
    assert isinstance(kernel_from(name), KERNELS[name])


def test_an_unknown_kernel_is_refused_with_the_names_that_exist() -> None:
    with pytest.raises(InvalidInput, match=r"expected a kernel among se, .*, got 'rbf'"):
        kernel_from("rbf")
    with pytest.raises(InvalidInput, match="expected parameters variance, length_scale_m, got variance"):
        kernel_from("se", {"variance": 1.0})


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf")])
def test_a_parameter_that_is_not_positive_and_finite_is_refused(bad: float) -> None:
    with pytest.raises(InvalidInput, match="expected a positive length_scale_m"):
        SquaredExponential(1.0, bad)
