"""A certificate says that the map is good enough where it is, and only there."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, norm

from he3.certificate import UNLIKE, Targets, blocks_of, certify, likely_distance, places_of
from he3.errors import InvalidInput
from he3.frames import SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.kernels import Matern12, SquaredExponential
from he3.mixture import ProcessMixture
from he3.trend import UnknownConstant

GRID = SiteGrid(20, 30, 10.0)
PLACES = np.array([[40.0, 40.0], [120.0, 80.0], [200.0, 150.0], [260.0, 30.0]])
VALUES = np.array([7.0, 8.5, 6.0, 9.0])
SMOOTH, ROUGH = SquaredExponential(1.0, 80.0), Matern12(1.0, 40.0)


def mixture(shares: tuple[float, float] = (0.9, 0.1), trend: bool = True) -> ProcessMixture:
    """Two kernels of which the second is the rougher, after four samples."""
    fitted = Hyperparameters(
        SMOOTH, 0.1, 7.5, 1.5, trend=UnknownConstant(2.0) if trend else None,
        alternatives=((shares[0], SMOOTH), (shares[1], ROUGH)),
    )  # fmt: skip
    return ProcessMixture.of(GaussianProcess(fitted).condition(PLACES, VALUES))


def test_places_have_the_moments_that_the_process_predicts() -> None:
    targets = places_of(GRID, np.ones(GRID.shape, dtype=bool))
    for process in mixture().processes:
        mean, std = process.predict(targets.centres_m)
        found = targets.moments(process)
        np.testing.assert_allclose(found[0], mean, atol=1e-10)
        np.testing.assert_allclose(found[1], std, atol=1e-10)


@pytest.mark.parametrize("shape", [(400, 10), (10, 400), (372, 11), (60, 60), (64, 64), (90, 100)])
def test_thinned_targets_are_spread_over_both_sides_of_the_site(shape: tuple[int, int]) -> None:
    targets = places_of(SiteGrid(*shape), np.ones(shape, dtype=bool))
    thinned = targets.thinned(400)
    assert 200 <= len(thinned) <= 400
    for axis in (0, 1):
        whole, few = (np.unique(each.centres_m[:, axis]) for each in (targets, thinned))
        assert np.diff(few, prepend=whole[0], append=whole[-1]).max() <= 0.1 * np.ptp(whole) + 1.0


def test_a_long_narrow_site_is_drawn_at_all_of_its_columns() -> None:
    grid = SiteGrid(400, 10, 10.0)
    along = np.column_stack((np.full(41, 5.0), np.linspace(0.0, 4000.0, 41)))  # the west edge is known well
    process = GaussianProcess(Hyperparameters(SquaredExponential(1.0, 60.0), 0.1, 7.5, 1.5))
    known = ProcessMixture.of(process.condition(along, np.full(41, 7.0)))
    targets = places_of(grid, np.ones(grid.shape, dtype=bool))
    west = Targets(targets.points_m[targets.centres_m[:, 0] < 10.0])
    assert likely_distance(known, targets, 0.95) > 1.2 * likely_distance(known, west, 0.95)


def test_a_block_has_the_moments_of_the_average_of_its_points() -> None:
    blocks = blocks_of(GRID, 60.0)
    assert len(blocks) == 5 * 4
    for process in mixture().processes:
        mean, std = blocks.moments(process)
        for number in (0, 7, 19):
            points = blocks.points_m[number]
            assert mean[number] == pytest.approx(process.predict(points)[0].mean())
            assert std[number] == pytest.approx(np.sqrt(process.posterior_covariance(points).mean()))


def test_the_blocks_together_are_the_site() -> None:
    blocks = blocks_of(GRID, 70.0)  # neither side is a multiple
    points = blocks.points_m.reshape(-1, 2)
    assert points.min() > 0
    assert (points < [GRID.width_m, GRID.height_m]).all()
    sizes = np.array([np.ptp(block, axis=0) for block in blocks.points_m]) * 4 / 3
    assert sizes.prod(axis=1).sum() == pytest.approx(GRID.width_m * GRID.height_m)


def test_the_goal_holds_from_the_worst_standard_deviation_on_and_not_below_it() -> None:
    targets, known = Targets(PLACES[:, None] + 12.0), mixture((1.0, 1e-12))
    worst = certify(known, targets, 1.0, 0.95, GRID.extent_m).worst_ppb
    at_worst = certify(known, targets, worst, 0.5, GRID.extent_m)
    assert at_worst.holds
    below = certify(known, targets, 0.99 * worst, 0.5, GRID.extent_m)
    assert not below.holds
    assert 0.0 < below.share < 1.0


def test_kernels_under_which_the_goal_fails_count_with_their_weight() -> None:
    near = Targets(PLACES[:1, None] + 12.0)  # where the rough kernel knows less
    for rough, holds in ((0.04, True), (0.06, False)):
        known = mixture((1.0 - rough, rough))
        smooth_std, rough_std = (near.moments(process)[1].max() for process in known.processes)
        goal = 0.5 * (smooth_std + rough_std)
        found = certify(known, near, goal, 0.95, GRID.extent_m)
        assert found.worst_ppb < goal  # the mixture alone would be content
        assert found.weight == pytest.approx(1.0 - rough)
        assert bool(found.holds) is holds


def test_the_stated_standard_deviation_is_the_mixtures() -> None:
    targets, known = places_of(GRID, np.ones(GRID.shape, dtype=bool)), mixture((0.5, 0.5))
    found = certify(known, targets, 1.0, 0.5, GRID.extent_m)
    assert found.worst_ppb == pytest.approx(known.predict(targets.centres_m)[1].max())


def test_the_promise_is_the_normal_interval_of_the_probability() -> None:
    found = certify(mixture(), places_of(GRID, np.ones(GRID.shape, dtype=bool)), 0.5, 0.95, GRID.extent_m)
    assert found.within_ppb == pytest.approx(1.959964 * 0.5)


def test_the_likely_distance_of_one_place_is_its_normal_interval() -> None:
    one = Targets(np.array([[[150.0, 100.0]]]))
    known = mixture((1.0, 1e-12))
    std = one.moments(known.processes[0])[1][0]
    assert likely_distance(known, one, 0.95) == pytest.approx(UNLIKE * 1.96 * std, rel=0.06)


def test_the_likely_distance_of_places_that_tell_nothing_of_each_other_is_binomial() -> None:
    far = Targets(np.stack(np.meshgrid(np.arange(5) * 1e4, np.arange(4) * 1e4), axis=-1).reshape(20, 1, 2) + 1e5)
    known = mixture((1.0, 1e-12), trend=False)
    std = far.moments(known.processes[0])[1][0]
    within = likely_distance(known, far, 0.9) / std / UNLIKE
    assert binom.sf(17, 20, 2.0 * norm.cdf(within) - 1.0) == pytest.approx(0.9, abs=0.03)


def test_targets_that_miss_together_take_a_stricter_aim_than_the_goal() -> None:
    far = Targets(np.array([[[1e5, 0.0]], [[2e5, 0.0]], [[3e5, 0.0]], [[4e5, 0.0]]]))
    found = certify(mixture((1.0, 1e-12)), far, 9.0, 0.9, 1e6)
    assert found.likely_ppb > 1.645 * found.worst_ppb
    assert found.aim_ppb == pytest.approx(9.0 * 1.645 * found.worst_ppb / found.likely_ppb, rel=1e-3)
    assert certify(mixture((1.0, 1e-12)), Targets(PLACES[:, None]), 0.5, 0.95, 300.0).aim_ppb <= 0.5


def test_an_area_in_which_the_rover_has_been_in_one_corner_is_not_certified_whatever_it_found() -> None:
    targets = places_of(GRID, np.ones(GRID.shape, dtype=bool))
    known = Hyperparameters(SquaredExponential(1e-4, 900.0), 0.1, 7.5, 1.5)
    lattice = np.stack(np.meshgrid((np.arange(6) + 0.5) * 50.0, (np.arange(4) + 0.5) * 50.0), axis=-1).reshape(-1, 2)
    for places, holds in ((lattice, True), (lattice / 3.0, False)):
        belief = ProcessMixture.of(GaussianProcess(known).condition(places, np.full(len(places), 7.5)))
        found = certify(belief, targets, 0.5, 0.95, GRID.extent_m)
        assert found.worst_ppb < 0.1
        assert found.likely_ppb < 0.1
        assert (found.unseen <= found.most_unseen) is holds
        assert bool(found.holds) is holds


def test_many_cells_are_thinned_evenly_and_an_area_keeps_its_own() -> None:
    grid = SiteGrid(300, 300, 1.0)
    everywhere = places_of(grid, np.ones(grid.shape, dtype=bool))
    assert 1500 <= len(everywhere) <= 4096
    strip = np.zeros(grid.shape, dtype=bool)
    strip[7, 40:90] = True
    centres = places_of(grid, strip).centres_m
    assert len(centres)
    assert (centres[:, 1] == 7.5).all()


@pytest.mark.parametrize("side_m", [5.0, 301.0])
def test_blocks_smaller_than_a_cell_or_larger_than_the_site_are_refused(side_m: float) -> None:
    with pytest.raises(InvalidInput, match="expected blocks from a cell of 10 m to the site's 300 m"):
        blocks_of(GRID, side_m)


def test_too_many_blocks_are_refused_with_the_least_side() -> None:
    with pytest.raises(InvalidInput, match=r"expected at most 1024 blocks, of 15\.6 m or more, got 2500"):
        blocks_of(SiteGrid(500, 500, 1.0), 10.0)
