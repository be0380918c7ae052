"""The average posterior variance that designs descend: against its definition, and against finite differences."""

import numpy as np
import pytest

from he3.errors import InvalidInput
from he3.frames import SiteGrid
from he3.i_optimal_design import MIN_NOISE, AverageVariance, field_nodes
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
    gradient = AverageVariance(kernel.of_squared_distance, NOISE, nodes, TAKEN).gradient(FREE)
    for i, axis in ((0, 0), (3, 1), (6, 0)):
        step = np.zeros_like(FREE)
        step[i, axis] = 0.2
        ahead = directly(kernel, nodes, np.vstack((TAKEN, FREE + step)))
        behind = directly(kernel, nodes, np.vstack((TAKEN, FREE - step)))
        assert gradient[i, axis] == pytest.approx((ahead - behind) / 0.4, rel=0.08, abs=0.02 * np.abs(gradient).max())


def test_places_sampled_and_places_free_count_alike():
    nodes = field_nodes(GRID, None)
    k = Matern12(2.0, 20.0).of_squared_distance
    together = AverageVariance(k, NOISE, nodes, np.zeros((0, 2)))(np.vstack((TAKEN, FREE)))
    assert AverageVariance(k, NOISE, nodes, TAKEN)(FREE) == pytest.approx(together, abs=1e-4)


def test_more_samples_never_leave_more_variance():
    variance = AverageVariance(Matern12(1.0, 20.0).of_squared_distance, NOISE, field_nodes(GRID, None), TAKEN)
    values = [variance(FREE[:n]) for n in range(1, 8)]
    assert values[0] < variance.without
    assert (np.diff(values) < 0).all()


def test_a_repeated_place_and_no_noise_give_a_finite_gradient():
    variance = AverageVariance(Matern12(1.0, 20.0).of_squared_distance, 0.0, field_nodes(GRID, None), TAKEN)
    places = np.vstack((FREE, FREE, TAKEN))
    assert 0 < variance(places) < 1
    assert np.isfinite(variance.gradient(places)).all()


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
def test_interest_that_is_zero_negative_or_nan_is_refused(interest):
    with pytest.raises(InvalidInput):
        field_nodes(GRID, interest)


@pytest.mark.parametrize("name", sorted(KERNELS))
@pytest.mark.parametrize("noise", [0.0, 1e-6, 4e-4])
def test_crowded_places_and_little_noise_leave_the_criterion_exact(name, noise):
    kernel, nodes = kernel_of(name), field_nodes(GRID, None, most=600)
    rng = np.random.default_rng(2)
    sampled, free = rng.normal(30, 1.0, (60, 2)), rng.normal(33, 0.5, (45, 2))
    variance = AverageVariance(kernel.of_squared_distance, noise, nodes, sampled)
    value, gradient = variance(free), variance.gradient(free)
    places = np.vstack((sampled, free))
    k_pp = kernel.covariance(places, places) + max(noise, MIN_NOISE) * np.eye(len(places))
    k_pg = kernel.of_squared_distance(squared_distances(places, nodes.places_m) + nodes.spacing_m**2 / 6)
    left = kernel.prior_variance - (k_pg * np.linalg.solve(k_pp, k_pg)).sum(axis=0)
    assert value == pytest.approx(float(nodes.weights @ left) / kernel.prior_variance, rel=1e-6)
    assert np.isfinite(gradient).all()


@pytest.mark.parametrize("resolution_m", [0.01, 1.0, 1000.0])
def test_the_criterion_does_not_depend_on_the_size_of_the_site(resolution_m):
    grid = SiteGrid(60, 80, resolution_m)
    nodes = field_nodes(grid, None, most=600)
    kernel = Matern12(1.0, 20.0 * resolution_m)
    variance = AverageVariance(kernel.of_squared_distance, NOISE, nodes, TAKEN * resolution_m)
    expected = AverageVariance(Matern12(1.0, 20.0).of_squared_distance, NOISE, field_nodes(GRID, None, most=600), TAKEN)
    assert variance(FREE * resolution_m) == pytest.approx(expected(FREE), rel=1e-3)


def test_the_average_variance_is_never_zero_or_below():
    nodes = field_nodes(SiteGrid(5, 5), None)
    places = np.random.default_rng(1).uniform(0, 5, (300, 2))
    variance = AverageVariance(KERNELS["se"](1.0, 500.0).of_squared_distance, 0.0, nodes, places[:200])
    assert variance.without > 0
    assert variance(places[200:]) > 0
