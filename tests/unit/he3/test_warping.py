"""A warped process has, in ppb, the moments, quantiles and draws of its distribution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from he3.certificate import Targets, blocks_of, likely_distance, places_of
from he3.cover import CoverProblem
from he3.errors import InvalidInput
from he3.frames import FloatArray, SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.hyperdraws import redrawn
from he3.intervals import NORMAL_ENDS, mixture_ends
from he3.kernels import Matern12, Matern32
from he3.mixture import ProcessMixture, heaviest_of, mixture_moments
from he3.mixture_posterior import MixturePosterior
from he3.posterior.grid import GridPosterior
from he3.resource import area_mean, drawn_fields, share_above
from he3.trend import UnknownConstant
from he3.warped_intervals import warped_ends
from he3.warping import LEAST_SLOPE, Warp

UP, DOWN, STRONG = (Warp(8.0, 2.0, shift, strength, 0.1) for shift, strength in ((1.0, 0.3), (-1.0, 0.3), (2.0, 0.5)))
WARPS = pytest.mark.parametrize("warp", [UP, DOWN, STRONG], ids=["up", "down", "strong"])
GRID = SiteGrid(20, 30, 10.0)
TREND = UnknownConstant(4.0)
NODES, NODE_WEIGHTS = np.polynomial.hermite_e.hermegauss(80)
SHARES = NODE_WEIGHTS / NODE_WEIGHTS.sum()


def warped(warp: Warp | None, std_ppb: float = 0.1) -> Hyperparameters:
    return Hyperparameters(Matern32(1.2, 70.0), std_ppb, 7.5, 1.7, trend=TREND, warp=warp)


def samples(count: int) -> tuple[FloatArray, FloatArray]:
    random = np.random.default_rng(4)
    places = random.uniform((0.0, 0.0), (GRID.width_m, GRID.height_m), (count, 2))
    return places, 8.0 + 2.0 * np.sin(places[:, 0] / 40.0) + random.normal(0.0, 0.1, count)


def known(warp: Warp | None, count: int = 12) -> GaussianProcess:
    return GaussianProcess(warped(warp)).condition(*samples(count))


def mixed() -> Hyperparameters:
    """Three processes, of which two have a warp."""
    kernels = Matern32(1.0, 60.0), Matern12(0.8, 90.0), Matern32(1.4, 50.0)
    return replace(
        warped(None),
        alternatives=tuple(zip((0.5, 0.3, 0.2), kernels, strict=True)),
        noises_ppb=(0.1, 0.2, 0.1),
        warps=(None, UP, STRONG),
    )


@WARPS
def test_a_warp_and_its_inverse_are_one_and_its_slope_is_that_of_differences(warp: Warp) -> None:
    latent = np.linspace(-1.0, 20.0, 43)
    field = warp.field(latent)
    assert (np.diff(field) > 0).all()
    np.testing.assert_allclose(warp.latent(field), latent, atol=1e-9)
    difference = (warp.latent(field + 1e-5) - warp.latent(field - 1e-5)) / 2e-5
    np.testing.assert_allclose(warp.slope(field), difference, rtol=1e-6)
    assert float(warp.field(np.array(warp.centre_ppb))) == pytest.approx(warp.centre_ppb)
    assert float(warp.slope(np.array(warp.centre_ppb))) == pytest.approx(1.0)


def test_a_shift_upwards_makes_the_upper_tail_the_longer_one() -> None:
    for warp, sign in ((UP, 1.0), (DOWN, -1.0), (STRONG, 1.0)):
        field = warp.field(8.0 + 2.0 * np.random.default_rng(2).standard_normal(20_000))
        assert sign * ((field - field.mean()) ** 3).mean() > 0.3 * field.std() ** 3


@WARPS
def test_moments_are_those_by_quadrature(warp: Warp) -> None:
    means, stds = np.array([3.0, 8.0, 12.0]), np.array([0.05, 1.0, 2.5])
    at = warp.field(means[:, None] + stds[:, None] * NODES)
    expected = at @ SHARES
    mean, variance = warp.moments(means, stds**2)
    np.testing.assert_allclose(mean, expected, rtol=1e-9)
    np.testing.assert_allclose(warp.mean(means, stds**2), expected, rtol=1e-9)
    np.testing.assert_allclose(variance, (at - expected[:, None]) ** 2 @ SHARES, rtol=1e-7)


@WARPS
@pytest.mark.parametrize("correlation", [-0.7, 0.0, 0.6, 0.999])
def test_a_covariance_is_that_by_quadrature_in_two_dimensions(warp: Warp, correlation: float) -> None:
    means, stds = np.array([7.0, 10.0]), np.array([1.0, 2.0])
    a = warp.field(means[0] + stds[0] * NODES)[:, None]
    b = warp.field(means[1] + stds[1] * (correlation * NODES[:, None] + np.sqrt(1.0 - correlation**2) * NODES))
    both = SHARES[:, None] * SHARES
    expected = (both * a * b).sum() - (both * a).sum() * (both * b).sum()
    variances = np.square(stds)
    found = warp.covariance(means[0], variances[0], means[1], variances[1], correlation * stds.prod())
    assert float(found) == pytest.approx(float(expected), rel=1e-7, abs=1e-9)


@pytest.mark.parametrize(
    "wrong", [{"width_ppb": 0.0}, {"strength": 0.0}, {"strength": 9.0}, {"shift": 30.0}, {"noise_std_ppb": -1.0},
              {"centre_ppb": float("nan")}],
)  # fmt: skip
def test_a_warp_that_is_none_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InvalidInput, match="expected"):
        Warp(**{"centre_ppb": 8.0, "width_ppb": 2.0, "shift": 1.0, "strength": 0.3, **wrong})


def test_there_is_a_warp_for_each_alternative_or_none_at_all() -> None:
    with pytest.raises(InvalidInput, match="expected a warp for each of 3, got 1"):
        replace(mixed(), warps=(UP,))


@WARPS
def test_noise_in_ppb_is_the_slope_times_as_much_in_the_latent_field_and_none_is_lost_in_the_tail(warp: Warp) -> None:
    own = warped(warp, 0.3)  # of which 0.1 ppb are the instrument's
    values = np.array([4.0, 8.0, 11.0, 60.0])
    slope = np.maximum(warp.slope(values), LEAST_SLOPE)
    expected = (0.3**2 - 0.1**2 + (0.1 * slope) ** 2) / own.scale_ppb**2
    np.testing.assert_allclose(own.noise_variances(values), expected)
    assert own.least_noise_variance <= float(expected.min()) * (1.0 + 1e-12)
    assert (np.sqrt(own.noise_variances(values)) * own.scale_ppb / warp.slope(values) >= 0.1).all()


@WARPS
def test_a_process_predicts_the_moments_of_its_latent_field_through_the_warp(warp: Warp) -> None:
    process, places = known(warp), GRID.points()[::17]
    latent = GaussianProcess(warped(None)).condition(samples(12)[0], warp.latent(samples(12)[1]))
    latent_mean, latent_std = process.predict_latent(places)
    # The latent process differs from one without a warp in the noise of its samples alone.
    np.testing.assert_allclose(latent_mean, latent.predict(places)[0], atol=0.1)
    mean, std = process.predict(places)
    at = warp.field(latent_mean[:, None] + latent_std[:, None] * NODES)
    np.testing.assert_allclose(mean, at @ SHARES, rtol=1e-8)
    np.testing.assert_allclose(std, np.sqrt((at - mean[:, None]) ** 2 @ SHARES), rtol=1e-6)
    covariance = process.posterior_covariance(places)
    np.testing.assert_allclose(np.sqrt(covariance.diagonal()), std, rtol=1e-5)
    np.testing.assert_allclose(process.posterior_covariance(places[:4], places), covariance[:4], atol=1e-9)


@WARPS
def test_a_process_under_another_warp_has_the_same_observations(warp: Warp) -> None:
    places, values = samples(12)
    again = known(None).under(warped(warp))
    np.testing.assert_allclose(again.whitened, known(warp).whitened, atol=1e-8)
    np.testing.assert_allclose(again.under(warped(None)).whitened, known(None).whitened, atol=1e-8)
    added = GaussianProcess(warped(warp)).condition(places[:5], values[:5]).condition(places[5:], values[5:])
    np.testing.assert_allclose(added.factor, known(warp).factor, atol=1e-9)


def test_a_planned_sample_leaves_the_latent_mean_and_lowers_the_variance() -> None:
    process, place = known(STRONG), np.array([[150.0, 100.0]])
    planned = process.condition_on_places(place)
    assert planned.predict_latent(place)[0] == pytest.approx(process.predict_latent(place)[0])
    assert float(planned.predict(place)[1][0]) < float(process.predict(place)[1][0])


def test_draws_one_after_another_have_the_joint_moments() -> None:
    random = np.random.default_rng(5)
    places = np.array([[150.0, 100.0], [170.0, 110.0]])
    process, drawn = known(STRONG, 4), []
    for _ in range(4000):
        belief, values = process, []
        for place in places:
            value, belief = belief.drawn(place, lambda m, s: float(STRONG.field(np.array(random.normal(m, s)))))
            values.append(value)
        drawn.append(values)
    of_draws = np.array(drawn)
    mean, _ = process.predict(places)
    covariance = process.posterior_covariance(places)
    np.testing.assert_allclose(of_draws.mean(axis=0), mean, atol=4.0 * np.sqrt(covariance.diagonal().max() / 4000))
    np.testing.assert_allclose(np.cov(of_draws.T), covariance, rtol=0.15)


def test_the_ends_of_intervals_are_quantiles_of_the_mixture() -> None:
    weights, warps = np.array([0.5, 0.3, 0.2]), (None, UP, STRONG)
    means, stds = np.array([[7.0, 9.0], [7.5, 10.0], [6.5, 9.5]]), np.array([[0.8, 2.0], [1.2, 1.5], [1.0, 2.5]])
    levels = np.array(NORMAL_ENDS)
    ends = warped_ends(weights, means, stds, warps, levels)
    random = np.random.default_rng(9)
    parts = [
        mean[:, None] + std[:, None] * random.standard_normal((2, 400_000)) if warp is None
        else warp.field(mean[:, None] + std[:, None] * random.standard_normal((2, 400_000)))
        for mean, std, warp in zip(means, stds, warps, strict=True)
    ]  # fmt: skip
    draws = np.hstack([part[:, : int(weight * 400_000)] for part, weight in zip(parts, weights, strict=True)])
    expected = np.quantile(draws, norm.cdf(levels), axis=1)
    scaled = (expected - draws.mean(axis=1)) / draws.std(axis=1)
    np.testing.assert_allclose(ends, scaled, atol=0.03)
    assert (ends[3] > -ends[0]).all()  # the upper tail is the longer one


def test_without_a_warp_the_ends_are_those_of_normal_parts() -> None:
    weights, means = np.array([0.7, 0.3]), np.array([[7.0, 9.0], [7.5, 10.0]])
    stds, levels = np.array([[0.8, 2.0], [1.2, 1.5]]), np.array(NORMAL_ENDS)
    ends = warped_ends(weights, means, stds, (None, None), levels)
    np.testing.assert_allclose(ends, mixture_ends(weights, means, stds, levels), atol=2e-3)


def test_the_map_of_a_mixture_has_the_moments_and_the_quantiles_of_its_processes() -> None:
    places, values = samples(12)
    posterior = MixturePosterior(GRID, mixed(), lambda on, of: GridPosterior.build(on, of, places, values))
    posterior.add(np.array([60.0, 60.0]), 9.0)
    places, values = np.vstack((places, [[60.0, 60.0]])), np.append(values, 9.0)
    mixture = ProcessMixture.of(GaussianProcess(mixed()).condition(places, values))
    mean, std = mixture.predict(GRID.points())
    np.testing.assert_allclose(posterior.snapshot().mean_ppb.ravel(), mean, atol=2e-3)
    np.testing.assert_allclose(posterior.snapshot().std_ppb.ravel(), std, rtol=2e-3)
    intervals = posterior.intervals()
    assert intervals is not None
    low, high = (mean + std * intervals.ends[number].ravel() for number in (1, 2))
    for end, side in ((low, 0), (high, 1)):
        below = sum(
            weight * norm.cdf(((end if (warp := one.hyperparameters.warp) is None else warp.latent(end)) - m) / s)
            for weight, one, (m, s) in zip(
                mixture.weights, mixture.processes, (p.predict_latent(GRID.points()) for p in mixture.processes),
                strict=True,
            )
        )  # fmt: skip
        # The samples' own tails move all levels by the same, at all places.
        assert np.ptp(norm.ppf(below)) < 0.05
        assert (norm.ppf(below) < 0).all() if side == 0 else (norm.ppf(below) > 0).all()


def test_alternatives_without_a_warp_are_to_the_byte_those_of_hyperparameters_that_know_none() -> None:
    places, values = samples(12)
    none = replace(mixed(), warps=())
    maps = [
        MixturePosterior(GRID, each, lambda on, of: GridPosterior.build(on, of, places, values))
        for each in (none, replace(none, warps=(None, None, None)))
    ]
    np.testing.assert_array_equal(maps[0].snapshot().mean_ppb, maps[1].snapshot().mean_ppb)
    np.testing.assert_array_equal(maps[0].snapshot().std_ppb, maps[1].snapshot().std_ppb)
    ends = [each.intervals() for each in maps]
    assert ends[0] is not None
    assert ends[1] is not None
    np.testing.assert_array_equal(ends[0].ends, ends[1].ends)


def test_planners_are_guided_by_the_latent_field() -> None:
    assert heaviest_of(replace(mixed(), alternatives=mixed().alternatives[1:], noises_ppb=(), warps=(UP, STRONG))) == (
        replace(warped(None), kernel=Matern12(0.8, 90.0))
    )


def test_a_redrawn_belief_may_have_a_warp() -> None:
    belief = GaussianProcess(mixed()).condition(*samples(12))
    seen = {redrawn(belief, np.random.default_rng(seed)).hyperparameters.warp for seed in range(30)}
    assert seen == {None, UP, STRONG}


def test_an_area_is_as_uncertain_as_the_joint_distribution_of_its_cells() -> None:
    process = GaussianProcess(mixed()).condition(*samples(12))
    area = np.zeros(GRID.shape, dtype=np.bool_)
    area[3:12, 8:25] = True
    cells = GRID.points()[area.ravel()]
    mixture = ProcessMixture.of(process)
    mean_ppb = mixture.predict(GRID.points())[0].reshape(GRID.shape)
    found = area_mean(process, GRID, mean_ppb, area)
    means = np.array([each.predict(cells)[0].mean() for each in mixture.processes])
    stds = np.sqrt([each.posterior_covariance(cells).mean() for each in mixture.processes])
    mean, std = mixture_moments(mixture.weights, means, stds)
    assert found.mean_ppb == pytest.approx(float(mean))
    assert found.std_ppb == pytest.approx(float(std), rel=1e-6)
    assert found.std_error_ppb < 0.05 * found.std_ppb
    fields, weights = drawn_fields(process, GRID, area, np.random.default_rng(3), 6000)
    of_draws = fields @ weights
    assert float(of_draws.mean()) == pytest.approx(found.mean_ppb, abs=4.0 * found.std_ppb / np.sqrt(6000))
    assert float(of_draws.std()) == pytest.approx(found.std_ppb, rel=0.06)


def test_the_share_above_a_cut_off_counts_the_skew() -> None:
    process = GaussianProcess(mixed()).condition(*samples(12))
    area = np.ones(GRID.shape, dtype=np.bool_)
    mixture = ProcessMixture.of(process)
    cells = GRID.points()
    cut_off = np.array(12.0)
    expected = sum(
        weight * norm.sf(((cut_off if (warp := one.hyperparameters.warp) is None else warp.latent(cut_off)) - m) / s)
        for weight, one, (m, s) in zip(
            mixture.weights, mixture.processes, (p.predict_latent(cells) for p in mixture.processes), strict=True
        )
    )  # fmt: skip
    shares = share_above(process, GRID, area, float(cut_off), np.random.default_rng(3), 4000)
    assert float(shares.mean()) == pytest.approx(float(np.mean(expected)), rel=0.1)


def test_a_block_has_the_moments_of_draws_of_its_points() -> None:
    process, blocks = known(STRONG), blocks_of(GRID, 60.0)
    mean, std = blocks.moments(process)
    for number in (0, 7, 19):
        points = blocks.points_m[number]
        assert mean[number] == pytest.approx(process.predict(points)[0].mean())
        assert std[number] == pytest.approx(np.sqrt(process.posterior_covariance(points).mean()))
    few = blocks.only(np.arange(len(blocks)) % 4 == 0)
    count = few.points_m.shape[0] * few.points_m.shape[1]
    drawn = few.drawn(process, STRONG, np.random.default_rng(1).standard_normal((20_000, count)))
    np.testing.assert_allclose(drawn.mean(axis=0), few.moments(process)[0], atol=0.03)
    np.testing.assert_allclose(drawn.std(axis=0), few.moments(process)[1], rtol=0.05)


def test_places_have_the_moments_that_a_warped_process_predicts() -> None:
    targets, process = places_of(GRID, np.ones(GRID.shape, dtype=bool)), known(STRONG)
    mean, std = process.predict(targets.centres_m)
    np.testing.assert_allclose(targets.moments(process)[0], mean)
    np.testing.assert_allclose(targets.moments(process)[1], std)
    normal = ProcessMixture(np.ones(1), (known(None),))
    skewed = ProcessMixture(np.ones(1), (process,))
    assert likely_distance(skewed, targets, 0.95) > likely_distance(normal, targets, 0.95)


def test_a_cover_needs_more_where_a_skewed_field_is_high() -> None:
    places = np.array([[100.0, 50.0], [200.0, 150.0]])
    targets = Targets(np.array([[[60.0, 60.0]], [[250.0, 100.0]]]), np.array([8.0, 12.0]))
    sampled = samples(6)[0]
    latent = GaussianProcess(warped(None)).condition_on_places(np.vstack((sampled, places)))
    std = latent.predict(targets.centres_m)[1] / STRONG.slope(np.array([8.0, 12.0]))
    problem = CoverProblem([warped(STRONG)], sampled, targets, 0.7)
    np.testing.assert_allclose(problem.excess(places), (std / 0.7) ** 2 - 1.0, atol=1e-9)
    everywhere = places_of(GRID, np.ones(GRID.shape, dtype=bool))
    level = np.where(everywhere.centres_m[:, 0] > 150.0, 12.0, 6.0)
    cover = CoverProblem([warped(STRONG)], sampled, Targets(everywhere.points_m, level), 1.5)
    found = cover.pruned(cover.added(np.zeros((0, 2)), everywhere.centres_m[::2], 200))
    assert cover.holds(found)
    assert (found[:, 0] > 150.0).sum() > 2 * (found[:, 0] <= 150.0).sum()
