"""The scores of the exam, against closed forms and quadrature."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ndtr

from benchmarks.exam_scores import coverage, gaussian_crps, gaussian_nlpd, mean_and_interval, scores
from he3.errors import InvalidInput


@pytest.mark.parametrize(("error", "std"), [(0.0, 1.0), (0.7, 0.4), (-2.5, 1.3)])
def test_the_crps_of_a_gaussian_is_the_integral_that_defines_it(error, std):
    below, _ = quad(lambda x: ndtr(x / std) ** 2, -12 * std, error)
    above, _ = quad(lambda x: (1 - ndtr(x / std)) ** 2, error, 12 * std)
    assert gaussian_crps(np.array([error]), np.array([std]))[0] == pytest.approx(below + above, rel=1e-6)


def test_the_crps_of_a_perfect_mean_is_the_known_constant():
    assert gaussian_crps(np.zeros(1), np.full(1, 3.0))[0] == pytest.approx(
        3.0 * (math.sqrt(2) - 1) / math.sqrt(math.pi)
    )


def test_the_expected_scores_of_an_honest_map_are_the_closed_forms_and_any_other_std_is_worse():
    error = np.random.default_rng(1).normal(0.0, 0.5, 400_000)
    honest, narrow, wide = (np.full(error.shape, std) for std in (0.5, 0.4, 0.6))
    entropy = 0.5 * math.log(2 * math.pi * math.e * 0.25)
    assert gaussian_nlpd(error, honest).mean() == pytest.approx(entropy, abs=0.01)
    assert gaussian_crps(error, honest).mean() == pytest.approx(0.5 / math.sqrt(math.pi), rel=0.01)
    for score in (gaussian_nlpd, gaussian_crps):
        assert score(error, honest).mean() < min(score(error, narrow).mean(), score(error, wide).mean())
    for probability in (0.5, 0.68, 0.95):
        assert coverage(error, honest, probability) == pytest.approx(probability, abs=0.005)


def test_the_field_s_own_mean_and_spread_score_one_whatever_the_unit():
    field = 1e4 + 250.0 * np.random.default_rng(2).normal(size=(40, 30))
    flat = np.full(field.shape, field.mean())
    found = scores(field, flat, np.full(field.shape, field.std()))
    assert found.nrmse == pytest.approx(1.0)
    assert found.nlpd == pytest.approx(0.5 * math.log(2 * math.pi) + 0.5)
    again = scores(field / 250.0, flat / 250.0, np.full(field.shape, field.std() / 250.0))
    assert again.crps == pytest.approx(found.crps)


def test_unknown_cells_do_not_count():
    field = np.random.default_rng(3).normal(size=(20, 20))
    known = np.ones(field.shape, dtype=bool)
    known[:5] = False
    spoilt = field.copy()
    spoilt[:5] = 1e6
    mean, std = np.zeros(field.shape), np.ones(field.shape)
    assert scores(spoilt, mean, std, known) == scores(field, mean, std, known)


@pytest.mark.parametrize(
    ("truth", "mean", "std", "why"),
    [
        (np.ones((3, 3)), np.ones((3, 3)), np.ones((3, 3)), "a field that varies"),
        (np.eye(3), np.ones((3, 4)), np.ones((3, 3)), "maps of shape"),
        (np.eye(3), np.ones((3, 3)), np.zeros((3, 3)), "positive standard deviations"),
        (np.eye(3), np.full((3, 3), np.nan), np.ones((3, 3)), "finite means"),
    ],
)
def test_maps_that_cannot_be_scored_are_refused(truth, mean, std, why):
    with pytest.raises(InvalidInput, match=why):
        scores(truth, mean, std)


def test_an_interval_over_seeds_is_student_s():
    mean, half = mean_and_interval([1.0, 2.0, 3.0])
    assert mean == 2.0
    assert half == pytest.approx(4.302653 / math.sqrt(3))
    assert math.isnan(mean_and_interval([5.0])[1])
