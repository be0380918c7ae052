"""Scores of a map with standard deviations against the true field: pure functions of arrays.

Errors and standard deviations are in units of the field's own standard deviation over its cells, so that fields of any
unit compare: a map that is the field's mean everywhere has a normalised RMSE of 1. On each cell the map is a normal
distribution. Its negative log predictive density and its continuous ranked probability score (Gneiting & Raftery 2007,
eq. 21) are proper: no map can lower their expectation by claiming another standard deviation than it believes in.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri, stdtrit

from he3.errors import InvalidInput
from he3.frames import BoolArray, FloatArray

PROBABILITIES = (0.50, 0.68, 0.95)


@dataclass(frozen=True, slots=True)
class Scores:
    """The scores of one map, means over all cells that are known."""

    nrmse: float
    """RMSE, as a share of the field's standard deviation."""
    nlpd: float
    """Negative log predictive density [nats] of the field in units of its standard deviation."""
    crps: float
    """Continuous ranked probability score, as a share of the field's standard deviation."""
    coverage_50: float
    coverage_68: float
    coverage_95: float
    """Shares of the cells within the central intervals of these probabilities."""


def scores(truth: FloatArray, mean: FloatArray, std: FloatArray, known: BoolArray | None = None) -> Scores:
    """The scores of a map (mean and std, in the field's unit) of the truth, all of one shape.

    known: the cells that count, all if None. Raises InvalidInput for shapes that differ, a standard deviation that is
    not positive, a value that is not finite, or a field that does not vary.
    """
    shape = truth.shape
    if mean.shape != shape or std.shape != shape or (known is not None and known.shape != shape):
        raise InvalidInput(f"scores: expected maps of shape {shape}, got {mean.shape} and {std.shape}")
    chosen = np.ones(shape, dtype=np.bool_) if known is None else known
    true, expected, spread = (np.asarray(array, dtype=np.float64)[chosen] for array in (truth, mean, std))
    if not (np.isfinite(expected).all() and np.isfinite(spread).all() and (spread > 0).all()):
        raise InvalidInput("scores: expected finite means and positive standard deviations on every cell")
    unit = float(true.std()) if true.size else 0.0
    if not unit > 0:
        raise InvalidInput("scores: expected a field that varies over its known cells")
    error, spread = (true - expected) / unit, spread / unit
    shares = [coverage(error, spread, probability) for probability in PROBABILITIES]
    return Scores(
        float(np.sqrt(np.mean(error**2))), float(gaussian_nlpd(error, spread).mean()),
        float(gaussian_crps(error, spread).mean()), *shares,
    )  # fmt: skip


def gaussian_nlpd(error: FloatArray, std: FloatArray) -> FloatArray:
    """Minus the log density of N(0, std^2) at the errors [nats]."""
    density: FloatArray = 0.5 * np.log(2.0 * np.pi * std**2) + 0.5 * (error / std) ** 2
    return density


def gaussian_crps(error: FloatArray, std: FloatArray) -> FloatArray:
    """The continuous ranked probability score of N(0, std^2) at the errors, in their unit."""
    z = error / std
    density = np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
    score: FloatArray = std * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density - 1.0 / math.sqrt(math.pi))
    return score


def coverage(error: FloatArray, std: FloatArray, probability: float) -> float:
    """Share of the errors within the central interval of N(0, std^2) that holds this probability."""
    return float(np.mean(np.abs(error) <= ndtri(0.5 + 0.5 * probability) * std))


def mean_and_interval(values: Sequence[float]) -> tuple[float, float]:
    """Mean, and half the width of its 95 % interval by Student's t; NaN for the latter with a single value."""
    array = np.array(values, dtype=np.float64)
    if len(array) < 2:
        return float(array.mean()), math.nan
    return float(array.mean()), float(stdtrit(len(array) - 1, 0.975) * array.std(ddof=1) / math.sqrt(len(array)))
