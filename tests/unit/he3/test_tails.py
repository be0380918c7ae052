"""Intervals follow the tails that samples show, each given the others, and are normal where the field is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr, ndtri, stdtr, stdtrit

from he3.gp import GaussianProcess, Hyperparameters
from he3.kernels import Matern32
from he3.mixture import ProcessMixture
from he3.tails import DEGREES, SCALE_FACTOR, SCALES, interval_levels, residuals
from he3.trend import UnknownConstant

ALTERNATIVES = ((0.7, Matern32(0.5, 80.0)), (0.3, Matern32(2.0, 40.0)))
SPREAD = Hyperparameters(Matern32(1.0, 60.0), 0.1, 7.0, 1.5, trend=UnknownConstant(4.0), alternatives=ALTERNATIVES)


def scores(count: int) -> np.ndarray:
    """Normal scores that follow a standard normal distribution evenly."""
    return ndtri((np.arange(count) + 0.5) / count)


def test_each_sample_is_scored_by_the_map_of_all_others() -> None:
    random = np.random.default_rng(2)
    places, values = random.uniform(0.0, 200.0, (9, 2)), random.normal(8.0, 1.5, 9)
    mixture = ProcessMixture.of(GaussianProcess(SPREAD).condition(places, values))
    found = residuals(mixture.weights, mixture.processes, 9)
    for left_out in range(9):
        others = np.arange(9) != left_out
        below = 0.0
        for weight, kernel in ALTERNATIVES:
            own = GaussianProcess(replace(SPREAD, kernel=kernel, alternatives=()))
            mean, std = own.condition(places[others], values[others]).predict(places[left_out][None])
            below += weight * float(ndtr((values[left_out] - mean[0]) / np.hypot(std[0], 0.1)))
        assert found[left_out] == pytest.approx(ndtri(below), abs=1e-6)


def test_later_samples_leave_the_scores_of_the_first_unchanged() -> None:
    random = np.random.default_rng(2)
    places, values = random.uniform(0.0, 200.0, (9, 2)), random.normal(8.0, 1.5, 9)
    first = ProcessMixture.of(GaussianProcess(SPREAD).condition(places[:6], values[:6]))
    whole = ProcessMixture.of(GaussianProcess(SPREAD).condition(places, values))
    assert np.allclose(residuals(whole.weights, whole.processes, 6), residuals(first.weights, first.processes, 6))


def test_before_the_first_sample_there_are_no_scores_and_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    mixture = ProcessMixture.of(GaussianProcess(SPREAD))
    assert residuals(mixture.weights, mixture.processes, 0).shape == (0,)
    assert capfd.readouterr() == ("", "")


def test_many_samples_of_a_normal_field_leave_the_ends_where_they_were() -> None:
    assert interval_levels(scores(2000), (1.0, 2.0)) == pytest.approx([1.0, 2.0], abs=0.03)


def test_heavy_tails_move_the_ends_of_the_middle_inwards_and_the_others_outwards() -> None:
    heavy = 0.7 * stdtrit(3.0, ndtr(scores(300)))
    one, two = interval_levels(heavy, (1.0, 2.0))
    assert one == pytest.approx(0.7 * stdtrit(3.0, ndtr(1.0)), rel=0.08)
    assert two == pytest.approx(0.7 * stdtrit(3.0, ndtr(2.0)), rel=0.08)
    assert one < 0.9
    assert two > 2.1


def test_without_samples_the_tails_may_be_heavy() -> None:
    one, two = interval_levels(np.zeros(0), (1.0, 2.0))
    prior = np.exp(-0.5 * (np.log(SCALES) / SCALE_FACTOR) ** 2)
    for end, normal in ((one, 1.0), (two, 2.0)):
        below = (stdtr(DEGREES[:, None], end / SCALES) @ prior).mean() / prior.sum()
        assert below == pytest.approx(ndtr(normal), abs=1e-9)
    assert 1.1 < one < 1.2
    assert 3.0 < two < 3.4


def test_very_heavy_tails_are_not_taken_for_lighter_ones() -> None:
    one, two = interval_levels(stdtrit(1.5, ndtr(scores(300))), (1.0, 2.0))
    assert one == pytest.approx(stdtrit(1.5, ndtr(1.0)), rel=0.08)
    assert two == pytest.approx(stdtrit(1.5, ndtr(2.0)), rel=0.12)


def test_more_samples_of_a_normal_field_need_less_caution() -> None:
    ends = np.array([interval_levels(scores(count), (1.0, 2.0)) for count in (0, 10, 40, 150, 2000)])
    assert (np.diff(ends[:, 1]) < 0.0).all()
    assert ends[-1] == pytest.approx([1.0, 2.0], abs=0.01)


def test_the_same_scores_give_the_same_ends() -> None:
    assert (interval_levels(scores(30), (1.0, 2.0)) == interval_levels(scores(30), (1.0, 2.0))).all()


def test_samples_beyond_all_belief_have_finite_ends() -> None:
    away = np.append(np.zeros(5), 6.0)
    assert np.isfinite(interval_levels(away, (1.0, 2.0))).all()
