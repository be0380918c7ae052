"""A few of many weighted distributions whose mixture has the same moments at all places.

The moments of a mixture are linear in its weights: at each place, sum w m and sum w (v + m^2). So weights on one
distribution more than there are moments, or fewer, keep all of them (Tchakaloff 1957); and as means and variances vary
smoothly over places and distributions, far fewer keep them almost. They are chosen one by one, each time the one that
explains most of what is still missing, and the weights of all are then the non-negative least squares solution
(orthogonal matching pursuit with weights that cannot be negative: Bruckstein, Elad & Zibulevsky 2008).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from he3.errors import InvalidInput

if TYPE_CHECKING:
    from collections.abc import Sequence

    from he3.frames import BoolArray, FloatArray, IntArray

_SUM_OF_WEIGHTS = 3.0  # 1, how much the sum of the weights counts beside a moment at a place
_WEIGHT_OF_KIND = 1.0  # 1, the same of the sum of the weights of one kind
_NO_WEIGHT = 1e-6  # 1, below it a distribution is left out
_NOTHING_MISSING = 1e-9  # 1, of a moment: no more than rounding
_FARTHEST = 1e60  # mean or variance from which on the squares of moments overflow, as those of a warp's may


def condensed(
    weights: FloatArray, means: FloatArray, variances: FloatArray, most: int, kinds: Sequence[object] = ()
) -> tuple[IntArray, FloatArray]:
    """At most ``most`` of N distributions: their numbers (k,) and weights (k,), whose sum is 1, the heaviest first.

    weights: (N,), not negative and not all 0. means and variances: (N, P) at P places, variances positive. kinds: (N,),
    where they are of several, whose total weights are to be kept, too, as their moments do not tell them apart. Raises
    InvalidInput for shapes that do not fit.
    """
    from scipy.optimize import nnls  # a tenth of a second, in processes that never fit

    if means.shape != variances.shape or weights.shape != means.shape[:1] or most < 1:
        raise InvalidInput(f"expected N weights and N x P moments, got {weights.shape}, {means.shape}, {most}")
    near: BoolArray = np.all((np.abs(means) < _FARTHEST) & (variances < _FARTHEST), axis=1)
    weights = np.where(near, weights, 0.0)
    means, variances = np.where(near[:, None], means, 0.0), np.where(near[:, None], variances, 1.0)
    weights = weights / weights.sum()
    mean = weights @ means
    apart = means - mean
    second = apart * apart + variances
    variance = weights @ second
    moments = np.hstack((apart / np.sqrt(variance), second / variance, np.full((len(weights), 1), _SUM_OF_WEIGHTS)))
    if len(distinct := list(dict.fromkeys(kinds))) > 1:
        of_kind = np.array([[kind == each for each in distinct] for kind in kinds], dtype=np.float64)
        moments = np.hstack((moments, _WEIGHT_OF_KIND * of_kind))
    wanted = weights @ moments
    directions = moments / np.linalg.norm(moments, axis=1)[:, None]
    chosen: list[int] = []
    # One far from all others may point best, and yet have no weight.
    refused: list[int] = np.flatnonzero(~near).tolist()
    found = np.empty(0)
    tried = 0
    while tried < most:
        missing = wanted - found @ moments[chosen]
        gain = directions @ missing
        gain[chosen + refused] = -np.inf
        best = int(np.argmax(gain))
        if not gain[best] > 0.0 or (refused and np.abs(missing).max() < _NOTHING_MISSING):
            break
        chosen.append(best)
        found, _ = nnls(moments[chosen].T, wanted)
        kept = found > _NO_WEIGHT
        if kept[-1]:
            tried += 1
        else:
            refused.append(best)
        chosen, found = [number for number, keep in zip(chosen, kept, strict=True) if keep], found[kept]
    order = np.argsort(-found, kind="stable")
    return np.array(chosen, dtype=np.intp)[order], found[order] / found.sum()
