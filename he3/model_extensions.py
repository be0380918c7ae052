"""Which further parameters samples speak for: unstated noise, a stretch, or both, with their priors.

A field is taken for isotropic and the noise for the stated one unless the samples say otherwise. Each extension is a
model of its own beside the plain one, with prior odds below one and a prior of its parameters; its weight in the
mixture follows from its evidence. That of more parameters has to pay for them, so an extension that explains nothing
ends with less than its prior odds.

Only the kernels of rough fields learn noise. A kernel of smooth fields takes a rough field's own variation for noise,
and the map of what is left is too certain: with Matern 5/2 on 11 fields of the exam, 150 samples each, 63 % of the
cells lay within 68 % intervals, 68 % without.

Most fields need none, and shall not pay for the question. So an extension is fitted only if some of a few settings of
its parameters, with the kernel as it is, are likelier than the plain model by ``LEAST_GAIN``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from he3.extended_likelihood import Extended
from he3.hyperparameters import LikelihoodProblem
from he3.kernels import Matern12, SmoothPlusRough

if TYPE_CHECKING:
    from he3.frames import FloatArray

NOISE_ODDS = 0.1  # 1, prior odds of unstated noise: nine of ten sheets state an instrument's noise rightly [assumed]
NOISE_SHARE = 0.1  # 1, median of unstated noise in the field's standard deviations, or the stated one if larger
NOISE_FACTOR = 2.5  # 1, of that median [assumed]
STRETCH_ODDS = 0.1  # 1, prior odds of two lengths instead of one: with 0.3, maps of real fields were worse [measured]
STRETCH_STD = 0.7  # 1, of both parameters of the metric: half of all ratios of lengths are above 2.3, 5 % above 5.5
LEAST_GAIN = 3.0  # 1, logarithm of a ratio of densities from which an extension is fitted
LEAST_SAMPLES = 12  # below it, samples tell next to nothing of either
_TRIED_NOISES = (-0.75, 0.0, 0.75, 1.5, 2.25)  # standard deviations of the prior, from its median
_TRIED_STRETCHES = (0.9, 1.8)  # standard deviations of the prior
_TRIED_BEARINGS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Extension:
    """A likelihood with further parameters, the normal priors of all of them, a start, and the odds of its model.

    medians, factors, start: (p,), those of the kernel first. start is in standard deviations from the medians.
    """

    likelihood: Extended
    medians: FloatArray
    factors: FloatArray
    start: FloatArray
    log_odds: float


def extensions(
    plain: LikelihoodProblem, medians: FloatArray, factors: FloatArray, mode: FloatArray, xy: FloatArray
) -> list[Extension]:
    """The extensions that the samples at ``xy`` (n, 2) [m] speak for, none of most fields.

    medians, factors, mode: (p,), priors of the plain model's logarithms, and its most probable parameters in standard
    deviations from the medians.
    """
    if len(plain.z) < LEAST_SAMPLES:
        return []
    found: dict[tuple[bool, bool], FloatArray] = {}
    least = plain.cost(medians + factors * mode)[0] - LEAST_GAIN
    tried = {(False, True): _stretches()}
    if isinstance(plain.default, Matern12 | SmoothPlusRough):
        tried[True, False] = [np.array([u]) for u in _TRIED_NOISES]
    for what, settings in tried.items():
        extension = _extension(plain, medians, factors, xy, what, mode, settings[0])
        costs = [_cost(extension, np.concatenate((mode, setting))) for setting in settings]
        best = int(np.argmin(costs))
        if costs[best] < least:
            found[what] = settings[best]
    if len(found) == 2:
        found[True, True] = np.concatenate((found[True, False], found[False, True]))
    return [_extension(plain, medians, factors, xy, what, mode, further) for what, further in found.items()]


def _stretches() -> list[FloatArray]:
    angles = 2.0 * np.pi * np.arange(_TRIED_BEARINGS) / _TRIED_BEARINGS
    return [size * np.array([math.cos(angle), math.sin(angle)]) for size in _TRIED_STRETCHES for angle in angles]


def _cost(extension: Extension, u: FloatArray) -> float:
    """Minus the log likelihood and the log prior of the further parameters."""
    further = u[len(extension.likelihood.default.parameters()) :]
    return extension.likelihood.value(extension.medians + extension.factors * u) + 0.5 * float(further @ further)


def _extension(
    plain: LikelihoodProblem,
    medians: FloatArray,
    factors: FloatArray,
    xy: FloatArray,
    what: tuple[bool, bool],
    mode: FloatArray,
    further: FloatArray,
) -> Extension:
    noise, stretch = what
    of_noise = math.log(max(NOISE_SHARE, math.sqrt(plain.noise)))
    more: Sequence[tuple[float, float]] = [(of_noise, math.log(NOISE_FACTOR))] * noise + [(0.0, STRETCH_STD)] * (
        2 * stretch
    )
    more_medians, more_factors = np.array(more).T
    likelihood = Extended(
        plain.default, plain.r2, plain.z, plain.trend_covariance, plain.noise, plain.bounds, xy, noise, stretch
    )
    log_odds = noise * math.log(NOISE_ODDS) + stretch * math.log(STRETCH_ODDS)
    return Extension(
        likelihood,
        np.concatenate((medians, more_medians)),
        np.concatenate((factors, more_factors)),
        np.concatenate((mode, further)),
        log_odds,
    )
