"""The orbital map as prior mean: interpolated, corrected by the samples, its uncertainty counted."""

import numpy as np
import pytest

from he3.errors import InvalidInput
from he3.frames import SiteGrid
from he3.gp import GaussianProcess, Hyperparameters, fit_hyperparameters
from he3.kernels import SquaredExponential
from he3.trend import orbital_trend

GRID = SiteGrid(40, 50, 10.0)


def hilly() -> np.ndarray:
    y, x = np.meshgrid(GRID.y_m, GRID.x_m, indexing="ij")
    return 8.0 + np.sin(x / 90.0) + np.cos(y / 70.0)


def test_at_cell_centres_the_map_is_itself_and_between_them_linear() -> None:
    orbital = hilly()
    trend = orbital_trend(GRID, orbital)
    np.testing.assert_allclose(trend.at(GRID.points()), orbital.ravel(), rtol=1e-14)
    assert trend.at([[10.0, 5.0]])[0] == pytest.approx(0.5 * (orbital[0, 0] + orbital[0, 1]))
    assert trend.at([[0.0, 0.0]])[0] == pytest.approx(orbital[0, 0], rel=1e-14)
    assert trend.at([[500.0, 400.0]])[0] == pytest.approx(orbital[-1, -1], rel=1e-14)


@pytest.mark.parametrize(("gain", "offset_ppb"), [(1.0, 0.0), (1.3, 1.0), (0.7, -2.0)])
def test_a_map_that_is_off_by_gain_and_offset_is_corrected_by_the_samples(gain: float, offset_ppb: float) -> None:
    truth = hilly()
    seen = gain * truth + offset_ppb
    trend = orbital_trend(GRID, seen)
    rng = np.random.default_rng(1)
    cells = rng.integers(0, [GRID.rows, GRID.columns], (60, 2))
    places = np.column_stack((GRID.x_m[cells[:, 1]], GRID.y_m[cells[:, 0]]))
    values = truth[cells[:, 0], cells[:, 1]] + 0.1 * rng.normal(size=60)
    fitted = fit_hyperparameters(places, values, "se", rng=rng, trend=trend)
    belief = GaussianProcess(fitted).condition(places, values)
    estimate, deviation = belief.predict(GRID.points())
    assert np.sqrt(np.mean((estimate - truth.ravel()) ** 2)) < 0.1
    assert np.mean(np.abs(estimate - truth.ravel()) <= 2.0 * deviation) > 0.85


def test_the_belief_is_that_of_generalised_least_squares_with_a_gaussian_prior() -> None:
    """Direct formula: prior covariance of everything, conditioned by brute force."""
    trend = orbital_trend(GRID, hilly(), gain_std=0.4, offset_std_ppb=2.0)
    hyperparameters = Hyperparameters(SquaredExponential(0.8, 60.0), 0.1, mean_ppb=0.3, scale_ppb=0.7, trend=trend)
    rng = np.random.default_rng(2)
    places, points = rng.uniform(0, 400, (20, 2)), rng.uniform(0, 400, (15, 2))
    values = rng.normal(8.0, 1.0, 20)
    everything = np.vstack((places, points))
    contrast = trend.at(everything) - hilly().mean()
    covariance = 0.49 * SquaredExponential(0.8, 60.0).covariance(everything, everything)
    covariance += 0.16 * np.outer(contrast, contrast) + 4.0
    prior = trend.at(everything) + 0.3
    noisy = covariance[:20, :20] + 0.01 * np.eye(20)
    weights = np.linalg.solve(noisy, covariance[:20, 20:])
    belief = GaussianProcess(hyperparameters).condition(places, values)
    mean, deviation = belief.predict(points)
    np.testing.assert_allclose(mean, prior[20:] + weights.T @ (values - prior[:20]), rtol=1e-9)
    expected = covariance[20:, 20:] - covariance[20:, :20] @ weights
    np.testing.assert_allclose(deviation**2, expected.diagonal(), rtol=1e-7)
    np.testing.assert_allclose(belief.posterior_covariance(points), expected, atol=1e-9)
    np.testing.assert_allclose(belief.posterior_covariances(points.reshape(5, 3, 2))[0], expected[:3, :3], atol=1e-9)


def test_before_any_sample_the_uncertainty_of_gain_and_offset_is_in_the_variance() -> None:
    trend = orbital_trend(GRID, hilly())
    belief = GaussianProcess(Hyperparameters(SquaredExponential(), trend=trend))
    assert belief.predict([[250.0, 200.0]])[1][0] > trend.offset_std_ppb


def test_a_map_that_does_not_fit_the_grid_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"expected an orbital map of shape \(40, 50\), got \(50, 40\)"):
        orbital_trend(GRID, hilly().T)
    holed = hilly()
    holed[3, 3] = np.nan
    with pytest.raises(InvalidInput, match="finite"):
        orbital_trend(GRID, holed)
