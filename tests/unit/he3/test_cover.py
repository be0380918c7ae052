"""Covers reach their goal under every kernel, with few places, and their gradients are those of differences."""

from __future__ import annotations

import numpy as np
import pytest

from he3.certificate import Targets, blocks_of, places_of
from he3.cover import CoverProblem
from he3.errors import InvalidInput
from he3.frames import FloatArray, SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.kernels import Kernel, Matern12, Matern52, SmoothPlusRough, SquaredExponential, Stretched
from he3.local_amplitude import LocalAmplitude, LocallyScaled, modes
from he3.trend import UnknownConstant

GRID = SiteGrid(20, 30, 10.0)
EVERYWHERE = places_of(GRID, np.ones(GRID.shape, dtype=bool))
CANDIDATES = EVERYWHERE.centres_m[::3]
TAKEN = np.array([[40.0, 40.0], [120.0, 80.0], [200.0, 150.0]])
NONE = np.zeros((0, 2))


def under(kernel: Kernel, trend: bool = False) -> Hyperparameters:
    return Hyperparameters(kernel, 0.2, 8.0, 1.5, trend=UnknownConstant(2.0) if trend else None)


KERNELS = [
    SquaredExponential(1.0, 60.0),
    Matern52(1.0, 60.0),
    SmoothPlusRough(),
    Stretched(SquaredExponential(1.0, 60.0), 2.0, 30.0),
    LocallyScaled(Matern52(1.0, 60.0), LocalAmplitude(300.0, tuple(0.4 / (1 + j + k) for j, k in modes()))),
]


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda one: type(one).__name__)
@pytest.mark.parametrize("targets", [EVERYWHERE, blocks_of(GRID, 50.0)], ids=["places", "blocks"])
def test_the_excess_is_what_the_process_leaves_after_the_samples(kernel: Kernel, targets: Targets) -> None:
    fitted, places = under(kernel, trend=True), CANDIDATES[10:16]
    known = GaussianProcess(fitted).condition(TAKEN, np.full(3, 8.0)).condition_on_places(places)
    std = targets.moments(known)[1]
    excess = CoverProblem([fitted], TAKEN, targets, 0.7).excess(places)
    np.testing.assert_allclose(excess, (std / 0.7) ** 2 - 1.0, atol=1e-9)


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda one: type(one).__name__)
@pytest.mark.parametrize("targets", [EVERYWHERE, blocks_of(GRID, 50.0)], ids=["places", "blocks"])
def test_the_gradient_is_that_of_differences(kernel: Kernel, targets: Targets) -> None:
    problem = CoverProblem([under(kernel)], TAKEN, targets, 0.6)
    places = np.array([[70.0, 30.0], [150.0, 60.0], [155.0, 130.0], [260.0, 90.0]]) + 1.7
    _, _, gradient = problem.with_gradient(places)
    for i in range(len(places)):
        for k in range(2):
            aside = np.zeros_like(places)
            aside[i, k] = 1e-3
            change = problem.with_gradient(places + aside)[1] - problem.with_gradient(places - aside)[1]
            assert gradient[i, k] == pytest.approx(change / 2e-3, abs=3e-3 * np.abs(gradient).max())


def test_a_greedy_cover_holds_under_both_kernels_and_pruning_keeps_it() -> None:
    kernels = [under(SquaredExponential(1.0, 60.0)), under(Matern12(0.8, 90.0))]
    problem = CoverProblem(kernels, TAKEN, EVERYWHERE, 1.1)
    assert not problem.holds(NONE)
    greedy = problem.added(NONE, CANDIDATES, 60)
    assert problem.holds(greedy)
    spare = np.vstack((greedy, CANDIDATES[:5]))
    pruned = problem.pruned(spare)
    assert problem.holds(pruned)
    assert len(pruned) <= len(greedy)
    for one in kernels:
        assert CoverProblem([one], TAKEN, EVERYWHERE, 1.1).holds(pruned)


def test_what_is_there_already_counts_and_nothing_is_added_where_the_goal_holds() -> None:
    problem = CoverProblem([under(SquaredExponential(1.0, 60.0))], TAKEN, EVERYWHERE, 1.0)
    whole = problem.added(NONE, CANDIDATES, 60)
    again = problem.added(whole, CANDIDATES, 60)
    np.testing.assert_array_equal(again, whole)
    half = problem.added(whole[: len(whole) // 2], CANDIDATES, 60)
    assert problem.holds(half)
    np.testing.assert_array_equal(half[: len(whole) // 2], whole[: len(whole) // 2])


def test_removals_are_judged_as_if_each_place_were_left_out_by_itself() -> None:
    problem = CoverProblem([under(SquaredExponential(1.0, 60.0)), under(Matern52())], TAKEN, EVERYWHERE, 1.0)
    places: FloatArray = CANDIDATES[5:40:6]
    expected = [problem.excess(np.delete(places, i, axis=0)).max() for i in range(len(places))]
    np.testing.assert_allclose(problem.excess_without(places), expected, atol=1e-8)


def test_a_goal_beyond_the_samples_leaves_the_attempt() -> None:
    problem = CoverProblem([under(Matern12(1.0, 10.0))], NONE, EVERYWHERE, 0.3)
    attempt = problem.added(NONE, CANDIDATES, 7)
    assert len(attempt) == 7
    assert not problem.holds(attempt)


def test_places_on_top_of_each_other_with_next_to_no_noise_are_worth_one() -> None:
    quiet = Hyperparameters(SquaredExponential(1.0, 90.0), 0.0, 8.0, 1.5)
    problem = CoverProblem([quiet], NONE, EVERYWHERE, 0.5)
    once = CANDIDATES[:30]
    np.testing.assert_allclose(problem.excess(np.vstack((once, once))), problem.excess(once), atol=0.02)


def test_a_problem_without_targets_or_kernels_is_refused() -> None:
    for kernels, targets in (([], EVERYWHERE), ([under(Matern52())], Targets(np.zeros((0, 1, 2))))):
        with pytest.raises(InvalidInput, match="expected a kernel, a target and a positive goal"):
            CoverProblem(kernels, NONE, targets, 0.5)
