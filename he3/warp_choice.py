"""Which warps of the field (``he3.warping``) are looked at beside none, and how much each counts.

A few warps are enough, since the mixture weighs them: mild skews of both signs, and a strong one upwards, as of ore
grades and of slopes of ground, which is nearly log-normal. Their centre and width are the samples' mean and standard
deviation. The posterior of the kernel's parameters is inferred in each of them anew.

Whether a warp is the field's is judged as families of kernels are (``he3.kernel_families``): by the normal density in
ppb that each sample has given the others, with the mean and the variance of the field there. So no derivative of the
warp enters, and what is judged is what a map has. A warp's weight is its prior odds times that density, for its best
family, to the power of ``WARP_POWER``, over the same without a warp.

Ten of thirteen parts of the weight are without a warp before any sample, and a few samples hardly change that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from he3.warping import Warp

if TYPE_CHECKING:
    from collections.abc import Sequence

    from he3.frames import FloatArray

SHAPES = ((1.0, 0.3), (-1.0, 0.3), (2.0, 0.5))
"""Shift and strength [1] of each [chosen on the fields of the exam]."""
WARP_ODDS = 0.1  # 1, of each against none [chosen on the fields of the exam]
WARP_POWER = 0.15
"""1, of the samples' densities; below that of families, since a warp that fits the samples but not what lies between
them costs more [chosen on the fields of the exam]."""
LEAST_SAMPLES = 12  # below it, samples tell next to nothing of the field's distribution
LEAST_STD_IN_NOISE = 2.0  # 1, samples that vary by less show the noise's distribution rather than the field's
MOST_LOG_VARIANCE = 1.0
"""1, greatest variance of the argument of a warp at a place of the site. A kernel that leaves more says nothing of the
field's moments in ppb, which its farthest tail decides."""


def warps_to_try(values_ppb: FloatArray, noise_std_ppb: float) -> list[Warp]:
    """The warps for observations (n,) [ppb] with that noise; none for too few, or where they hardly vary."""
    if len(values_ppb) < LEAST_SAMPLES:
        return []
    centre, width = float(values_ppb.mean()), float(values_ppb.std())
    if not width > max(LEAST_STD_IN_NOISE * noise_std_ppb, 1e-9 * abs(centre)):
        return []
    return [Warp(centre, width, shift, strength, noise_std_ppb) for shift, strength in SHAPES]


def log_warp_weight(predictive: Sequence[float], plain: Sequence[float]) -> float:
    """Logarithm of a warp's weight over that of none.

    predictive, plain: log densities (F,) of the samples under each family of kernels, with the warp and without one.
    """
    return float(np.log(WARP_ODDS)) + WARP_POWER * (max(predictive) - max(plain))
