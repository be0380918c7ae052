"""The average posterior variance that designs descend: against its definition, and against finite differences."""

import numpy as np
import pytest

from he3.errors import InvalidInput
from he3.frames import SiteGrid
from he3.i_optimal_design import AverageVariance, field_nodes
from he3.kernels import KERNELS, Matern12, squared_distances

GRID = SiteGrid(60, 80)
NOISE = 0.02
RNG = np.random.default_rng(8)
FREE = RNG.uniform(5, 55, (7, 2))
TAKEN = RNG.uniform(5, 55, (5, 2))


def kernel_of(name):
    kernel = KERNELS[name]()
    return type(kernel)(**{k: 25.0 if k.endswith("length_scale_m") else v for k, v in kernel.parameters().items()})


def directly(kernel, nodes, places):
    """The definition, with a dense inverse, as a share of the prior variance."""
    k_pp = kernel.covariance(places, places) + NOISE * np.eye(len(places))
    k_pg = kernel.of_squared_distance(squared_distances(places, nodes.places_m) + nodes.spacing_m**2 / 6)
    left = kernel.prior_variance - (k_pg * np.linalg.solve(k_pp, k_pg)).sum(axis=0)
    return float(nodes.weights @ left) / kernel.prior_variance


@pytest.mark.parametrize("name", sorted(KERNELS))
def test_the_criterion_is_the_posterior_variance_averaged_over_the_field(name):
    kernel, nodes = kernel_of(name), field_nodes(GRID, None, most=600)
    variance = AverageVariance(kernel.of_squared_distance, NOISE, nodes, TAKEN)
    assert variance(FREE) == pytest.approx(directly(kernel, nodes, np.vstack((TAKEN, FREE))), rel=5e-3)
    assert variance.without == pytest.approx(directly(kernel, nodes, TAKEN), rel=5e-3)


@pytest.mark.parametrize("name", sorted(KERNELS))
def test_its_gradient_is_that_of_its_definition(name):
    kernel, nodes = kernel_of(name), field_nodes(GRID, None, most=600)
    _, gradient = AverageVariance(kernel.of_squared_distance, NOISE, nodes, TAKEN).with_gradient(FREE)
    for i, axis in ((0, 0), (3, 1), (6, 0)):
        step = np.zeros_like(FREE)
        step[i, axis] = 0.2
        ahead = directly(kernel, nodes, np.vstack((TAKEN, FREE + step)))
        behind = directly(kernel, nodes, np.vstack((TAKEN, FREE - step)))
        assert gradient[i, axis] == pytest.approx((ahead - behind) / 0.4, rel=0.08, abs=0.02 * np.abs(gradient).max())


def test_samples_taken_and_samples_to_come_count_alike():
    nodes = field_nodes(GRID, None)
    k = Matern12(2.0, 20.0).of_squared_distance
    together = AverageVariance(k, NOISE, nodes, np.zeros((0, 2)))(np.vstack((TAKEN, FREE)))
    assert AverageVariance(k, NOISE, nodes, TAKEN)(FREE) == pytest.approx(together, abs=1e-4)


def test_more_samples_never_leave_more_variance():
    variance = AverageVariance(Matern12(1.0, 20.0).of_squared_distance, NOISE, field_nodes(GRID, None), TAKEN)
    values = [variance(FREE[:n]) for n in range(1, 8)]
    assert values[0] < variance.without
    assert (np.diff(values) < 0).all()


def test_a_repeated_place_and_no_noise_leave_the_algebra_standing():
    variance = AverageVariance(Matern12(1.0, 20.0).of_squared_distance, 0.0, field_nodes(GRID, None), TAKEN)
    value, gradient = variance.with_gradient(np.vstack((FREE, FREE, TAKEN)))
    assert 0 < value < 1
    assert np.isfinite(gradient).all()


def test_nodes_carry_the_interest_of_all_their_cells():
    interest = np.zeros(GRID.shape)
    interest[:, :40] = 3.0
    nodes = field_nodes(GRID, interest, most=48)
    assert nodes.weights.sum() == pytest.approx(1.0)
    assert nodes.places_m[:, 0].max() < 40
    whole = field_nodes(GRID, None, most=48)
    assert len(whole.weights) == 48
    assert np.average(whole.places_m, axis=0, weights=whole.weights) == pytest.approx([40.0, 30.0])


@pytest.mark.parametrize("interest", [np.zeros(GRID.shape), np.full(GRID.shape, -1.0), np.full(GRID.shape, np.nan)])
def test_interest_that_is_nowhere_is_refused(interest):
    with pytest.raises(InvalidInput):
        field_nodes(GRID, interest)
