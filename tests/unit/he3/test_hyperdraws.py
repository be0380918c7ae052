"""Draws of the hyperparameters: about the fitted ones, narrower the more samples there are, with the same samples."""

from __future__ import annotations

import numpy as np
import pytest

from he3.gp import GaussianProcess
from he3.hyperdraws import VAGUE_STD, redrawn
from he3.hyperparameters import Hyperparameters
from he3.kernels import kernel_from


def belief(count: int) -> GaussianProcess:
    random = np.random.default_rng(5)
    process = GaussianProcess(Hyperparameters(kernel_from("matern52"), 0.1, 8.0, 1.5))
    for place in random.uniform(0, 500, (count, 2)):
        mean, std = process.predict([place])
        process = process.condition([place], random.normal(mean, np.hypot(std, 0.1)))
    return process


def spread(count: int) -> float:
    """Standard deviation of the drawn logarithms of the length scale."""
    known = belief(count)
    random = np.random.default_rng(1)
    lengths = [list(redrawn(known, random).hyperparameters.kernel.parameters().values())[-1] for _ in range(100)]
    return float(np.log(lengths).std())


def test_more_samples_narrow_the_draws_and_none_leave_the_prior() -> None:
    assert spread(100) < 0.6 * spread(8) < 0.6 * 1.2 * VAGUE_STD


def test_the_observations_stay_the_same() -> None:
    known = belief(20)
    drawn = redrawn(known, np.random.default_rng(2))
    assert drawn.places_m == pytest.approx(known.places_m)
    assert drawn.factor @ drawn.whitened == pytest.approx(known.factor @ known.whitened)
    assert drawn.hyperparameters.kernel != known.hyperparameters.kernel


def test_without_observations_nothing_is_drawn() -> None:
    known = belief(0)
    assert redrawn(known, np.random.default_rng(3)) is known
