"""The orbital map as prior mean: interpolated, corrected by the samples, its uncertainty counted."""

import numpy as np
import pytest
from scipy import ndimage

from he3.errors import InvalidInput
from he3.frames import SiteGrid
from he3.gp import GaussianProcess, Hyperparameters, fit_hyperparameters
from he3.kernels import Matern12, SquaredExponential
from he3.posterior.grid import GridPosterior
from he3.randomfield import unit_fields
from he3.trend import WEIGHT_SHARE, CovariateTrend, covariate_trend, orbital_trend, split_by_scale

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


def layers(count: int, seed: int = 3) -> np.ndarray:
    """Independent rough layers (count, rows, columns) in units of their own."""
    fields = unit_fields(count, GRID.shape, (10.0, 10.0), 60.0, np.random.default_rng(seed))
    return fields * np.array([3.0, 200.0, 0.01, 1.0])[:count, None, None] + 50.0


def standardised(values: np.ndarray) -> np.ndarray:
    return (values - values.mean(axis=(1, 2), keepdims=True)) / values.std(axis=(1, 2), keepdims=True)


def test_any_number_of_layers_is_co_kriging_by_brute_force() -> None:
    """Direct formula: the joint normal distribution of weights, offset, remainder and samples, conditioned."""
    three = layers(3)
    trend = CovariateTrend(GRID, three, np.array([0.5, 0.0, 0.0]), np.array([0.3, 0.8, np.nan]), 8.0, 2.0)
    kernel = SquaredExponential(0.8, 60.0)
    hyperparameters = Hyperparameters(kernel, 0.1, mean_ppb=0.3, scale_ppb=0.7, trend=trend)
    rng = np.random.default_rng(2)
    cells = rng.choice(GRID.rows * GRID.columns, 35, replace=False)
    everything, z = GRID.points()[cells], standardised(three).reshape(3, -1)[:, cells].T
    values = rng.normal(8.0, 1.0, 20)
    prior = 8.3 + 0.5 * z[:, 0]
    covariance = 0.49 * kernel.covariance(everything, everything) + 4.0
    covariance += z @ np.diag([0.3**2, 0.8**2, (WEIGHT_SHARE * 0.7) ** 2]) @ z.T
    noisy = covariance[:20, :20] + 0.01 * np.eye(20)
    gain = np.linalg.solve(noisy, covariance[:20, 20:])
    belief = GaussianProcess(hyperparameters).condition(everything[:20], values)
    mean, deviation = belief.predict(everything[20:])
    np.testing.assert_allclose(mean, prior[20:] + gain.T @ (values - prior[:20]), rtol=1e-9)
    expected = covariance[20:, 20:] - covariance[20:, :20] @ gain
    np.testing.assert_allclose(deviation**2, expected.diagonal(), rtol=1e-7)
    grid = GridPosterior.build(GRID, hyperparameters, everything[:20], values)
    np.testing.assert_allclose(grid.mean_ppb.ravel()[cells[20:]], mean, rtol=1e-5)
    np.testing.assert_allclose(grid.std_ppb.ravel()[cells[20:]], deviation, rtol=1e-4)


def test_the_orbital_map_is_the_case_of_one_layer() -> None:
    one = orbital_trend(GRID, hilly(), gain_std=0.4)
    spread = hilly().std()
    same = CovariateTrend(GRID, hilly()[None], np.array([spread]), np.array([0.4 * spread]), hilly().mean())
    places = np.random.default_rng(5).uniform(0, 400, (30, 2))
    np.testing.assert_array_equal(one.at(places), same.at(places))
    np.testing.assert_array_equal(one.basis(places, 1.3), same.basis(places, 1.3))
    assert one.spread_ppb == pytest.approx(spread)


def test_unit_sign_and_offset_of_a_layer_do_not_matter() -> None:
    (layer,) = layers(1)
    places = np.random.default_rng(5).uniform(0, 400, (30, 2))
    basis = covariate_trend(GRID, layer[None], 7.5, 4.0).basis(places, 1.0)
    other = covariate_trend(GRID, -1e7 * layer[None] + 4e8, 7.5, 4.0).basis(places, 1.0)
    np.testing.assert_allclose(basis @ basis.T, other @ other.T, rtol=1e-6)


def test_a_trend_made_of_another_s_fields_is_the_same_to_the_byte() -> None:
    trend = orbital_trend(GRID, hilly(), covariates=layers(2))
    priors = (trend.expected_ppb, trend.weight_std_ppb, trend.level_ppb, trend.offset_std_ppb)
    again = CovariateTrend(GRID, trend.layers, *priors)
    assert again.basis(GRID.points(), 1.1).tobytes() == trend.basis(GRID.points(), 1.1).tobytes()


def test_a_layer_that_does_not_vary_says_nothing() -> None:
    flat = covariate_trend(GRID, np.full((1, *GRID.shape), 3.0), 7.5, 4.0)
    assert (flat.basis(GRID.points(), 1.0)[:, 0] == 0.0).all()
    assert flat.spread_ppb == 0.0


def rmse_with(given: np.ndarray, truth: np.ndarray, seed: int) -> float:
    """RMSE of the map of 80 samples with these layers, for a remainder of one standard deviation over 60 m."""
    rng = np.random.default_rng(seed)
    cells = rng.choice(truth.size, 80, replace=False)
    values = truth.ravel()[cells] + 0.1 * rng.normal(size=80)
    fitted = Hyperparameters(Matern12(1.0, 60.0), 0.1, trend=covariate_trend(GRID, given, 7.5, 4.0))
    belief = GaussianProcess(fitted).condition(GRID.points()[cells], values)
    return float(np.sqrt(np.mean((belief.predict(GRID.points())[0] - truth.ravel()) ** 2)))


def test_layers_that_tell_help_and_layers_that_do_not_cost_next_to_nothing() -> None:
    ratios: dict[str, list[float]] = {}
    for seed in range(12):
        a, b, other, rest = standardised(layers(4, seed))
        truth = 8.0 + a - 0.8 * b + 0.5 * rest
        without = rmse_with(np.empty((0, *GRID.shape)), truth, seed)
        moved = np.roll(a, (2, 2), (0, 1))
        for name, given in {
            "both": [a, b], "one, biased": [3.0 * a + 40.0], "irrelevant": [other], "moved": [moved],
            "one among others": [a, other, moved],
        }.items():  # fmt: skip
            ratios.setdefault(name, []).append(rmse_with(np.stack(given), truth, seed) / without)
    mean = {name: float(np.mean(found)) for name, found in ratios.items()}
    assert mean["both"] < 0.5
    assert mean["one, biased"] < 0.8
    assert mean["one among others"] < 0.8
    assert mean["irrelevant"] < 1.01
    assert mean["moved"] < 1.01


def test_a_layer_is_the_sum_of_its_two_scales_and_the_wide_one_has_none_of_the_detail() -> None:
    given = layers(2)
    parts = split_by_scale(given, GRID, 50)
    assert parts.shape == (4, *GRID.shape)
    np.testing.assert_allclose(parts[0::2] + parts[1::2], given, rtol=1e-12)
    apart = 2  # cells, less than the samples' spacing of 6
    for wide, detail in zip(parts[0::2], parts[1::2], strict=True):
        changes = [np.abs(part[:, apart:] - part[:, :-apart]).mean() / part.std() for part in (wide, detail)]
        assert changes[0] < 0.5 * changes[1]


def test_a_layer_of_noise_has_no_wide_features() -> None:
    noise = np.random.default_rng(3).standard_normal(GRID.shape)
    wide, detail = split_by_scale(noise[None], GRID, 20)
    assert not wide.any()
    assert np.array_equal(detail, noise)


def test_a_layer_whose_detail_is_noise_costs_nothing_where_its_wide_features_tell() -> None:
    once, twice = [], []
    for seed in range(8):
        wide, rough, rest = standardised(layers(4, seed))[:3]
        wide = standardised(ndimage.gaussian_filter(wide, 4.0, mode="nearest")[None])[0]
        truth = 8.0 + 1.5 * wide + 0.5 * rest
        noisy = (wide + 1.0 * rough)[None]
        without = rmse_with(np.empty((0, *GRID.shape)), truth, seed)
        once.append(rmse_with(noisy, truth, seed) / without)
        twice.append(rmse_with(split_by_scale(noisy, GRID, 80), truth, seed) / without)
    assert np.mean(twice) < 1.01
    assert np.mean(twice) < np.mean(once)


def test_layers_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InvalidInput, match=r"layers of shape \(k, 40, 50\)"):
        covariate_trend(GRID, np.zeros((2, 50, 40)), 7.5, 4.0)
    with pytest.raises(InvalidInput, match="a prior for each of 2 layers"):
        CovariateTrend(GRID, layers(2), np.zeros(1), np.zeros(2))
    with pytest.raises(InvalidInput, match="finite"):
        covariate_trend(GRID, np.full((1, *GRID.shape), np.inf), 7.5, 4.0)
