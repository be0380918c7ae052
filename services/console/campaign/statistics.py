"""Statistics over rows: quantiles, differences of pairs with bootstrap intervals, shares of the variance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from he3.frames import FloatArray
from services.console.campaign.task import canonical

QUANTILES: Final = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
LEVEL: Final = 0.95
RESAMPLES: Final = 4000
_MOST_RESAMPLED: Final = 2000
"""Of more pairs than that, the means of as many random groups are resampled: the mean's variance is the same."""
_AT_ONCE: Final = 100
FEW: Final = 30
"""Of fewer pairs than that, intervals follow from Student's t: those of a bootstrap are too narrow."""
_SEED: Final = 0xB007


@dataclass(frozen=True, slots=True)
class Summary:
    """A figure over many missions."""

    count: int
    mean: float
    std: float
    """Sample standard deviation."""
    quantiles: tuple[float, ...]
    """At QUANTILES."""


def summary_of(values: FloatArray) -> Summary:
    """The summary of (n,) values; those that are NaN do not count. Raises ValueError without any."""
    there = values[~np.isnan(values)]
    if not len(there):
        raise ValueError("expected one value at least, got none")
    std = float(there.std(ddof=1)) if len(there) > 1 else 0.0
    return Summary(len(there), float(there.mean()), std, tuple(float(q) for q in np.quantile(there, QUANTILES)))


@dataclass(frozen=True, slots=True)
class Paired:
    """The difference of a figure, first minus second, over pairs that differ in nothing else."""

    first: str
    second: str
    pairs: int
    seeds: int
    """Seeds of the pairs, each counted once: as many as there are pairs if that is not known."""
    difference: float
    """Mean over the pairs."""
    low: float
    high: float
    """Interval of the mean difference, at LEVEL: by a bootstrap, of few seeds by Student's t."""
    ratio: float
    """Mean of the first over mean of the second."""
    ratio_low: float
    ratio_high: float
    first_lower: float
    """Share of the pairs in which the first is lower."""
    equal: float
    """Share of the pairs in which both are the same."""


def paired(
    first: FloatArray,
    second: FloatArray,
    names: tuple[str, str],
    seeds: Sequence[Any] | None = None,
    draws: Sequence[Any] | None = None,
) -> Paired:
    """The comparison of (n,) values with (n,) values, pair by pair. Raises ValueError for less than two pairs.

    seeds, draws: of the n pairs. Pairs of one seed have the same field, noise and choices, and pairs of one draw the
    same parameters, so they are not independent. The intervals are those over seeds and over draws, with both the
    root of the sum of squares. Where no two pairs share one, or all do, they are those over pairs.
    """
    both = ~(np.isnan(first) | np.isnan(second))
    one, other = first[both], second[both]
    if len(one) < 2:
        raise ValueError(f"expected two pairs at least, got {len(one)}")
    difference, ratio = float((one - other).mean()), float(one.mean() / other.mean()) if other.mean() else float("nan")
    by_seed, by_draw = (_groups(labels, both) for labels in (seeds, draws))
    shared = [groups for groups in (by_seed, by_draw) if 1 < groups.max() + 1 < len(one)] or [np.arange(len(one))]
    ends = np.array([_intervals(one, other, groups) for groups in shared])
    if len(ends) > 1:
        middle = np.array([difference, difference, ratio, ratio])
        ends = (middle + np.array([-1, 1, -1, 1]) * np.linalg.norm(ends - middle, axis=0))[np.newaxis]
    low, high, ratio_low, ratio_high = ends[0].tolist()
    return Paired(*names, len(one), int(by_seed.max()) + 1, difference, low, high, ratio, ratio_low, ratio_high,
                  float((one < other).mean()), float((one == other).mean()))  # fmt: skip


def _groups(labels: Sequence[Any] | None, there: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(n,) number of the label of each pair that is there, by first appearance; one for each pair without labels."""
    if labels is None:
        return np.arange(np.count_nonzero(there))
    numbers: dict[Any, int] = {}
    kept = [distinct(label) for label, ok in zip(labels, there, strict=True) if ok]
    return np.array([numbers.setdefault(label, len(numbers)) for label in kept], dtype=np.int64)


def _intervals(one: FloatArray, other: FloatArray, groups: NDArray[np.int64]) -> tuple[float, float, float, float]:
    """The intervals at LEVEL of the mean difference and of the ratio of the means of (n,) values, over those groups."""
    count = np.bincount(groups).astype(np.float64)
    if len(count) < FEW:
        difference, ratio = (
            float((one - other).mean()),
            float(one.mean() / other.mean()) if other.mean() else float("nan"),
        )
        # The ratio's error, to the first order: that of (one - ratio x other) / mean of the other.
        error = (one - ratio * other) / other.mean() if other.mean() else one + ratio
        sums = [np.bincount(groups, values - values.mean()) * len(count) / len(one) for values in (one - other, error)]
        return (*_around(difference, sums[0]), *_around(ratio, sums[1]))
    totals = np.stack((np.bincount(groups, one), np.bincount(groups, other), count)).astype(np.float64)
    resampled = _resampled_means(totals)
    means, tails = resampled[:2] / resampled[2], ((1 - LEVEL) / 2, (1 + LEVEL) / 2)
    low, high = np.quantile(means[0] - means[1], tails)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = means[0] / means[1]
    ratio_low, ratio_high = np.quantile(ratios, tails) if np.isfinite(ratios).all() else (float("nan"),) * 2
    return float(low), float(high), float(ratio_low), float(ratio_high)


def _around(estimate: float, errors: FloatArray) -> tuple[float, float]:
    """The interval at LEVEL of an estimate, a mean with those (n,) errors of single values, by Student's t."""
    reach = float(stdtrit(len(errors) - 1, (1 + LEVEL) / 2) * errors.std(ddof=1) / np.sqrt(len(errors)))
    return estimate - reach, estimate + reach


def _resampled_means(values: FloatArray) -> FloatArray:
    """(k, RESAMPLES) means of (k, n) values over resamples of the n, the same resample for all k."""
    rng = np.random.default_rng(_SEED)
    if values.shape[1] > _MOST_RESAMPLED:
        shuffled = values[:, rng.permutation(values.shape[1])]
        values = np.stack([group.mean(axis=1) for group in np.array_split(shuffled, _MOST_RESAMPLED, axis=1)], axis=1)
    count = values.shape[1]
    pieces = [values[:, rng.integers(count, size=(_AT_ONCE, count))].mean(axis=2) for _ in range(RESAMPLES // _AT_ONCE)]
    return np.concatenate(pieces, axis=1)


def distinct(value: Any) -> Any:
    """What tells a label's value from others, and can be hashed."""
    return value if isinstance(value, (str, int, float)) else canonical(value)


@dataclass(frozen=True, slots=True)
class Share:
    """How much of a figure's variance one parameter explains."""

    parameter: str
    share: float
    """First-order share of the variance, without the bias of the bins; 0 to 1."""
    noise: float
    """The share that a parameter without any effect stays below in 95 of 100 studies of this size."""
    rank_correlation: float | None
    """Spearman's, for a number."""

    @property
    def counts(self) -> bool:
        """Whether the share is more than chance."""
        return self.share > self.noise


MOST_LISTED: Final = 12
"""A number with more values than that counts as drawn from a range, one with fewer as a list of values."""


def is_drawn(values: Sequence[Any]) -> bool:
    """Whether a label with those values is taken for one that was drawn from a range."""
    kinds = {distinct(value): value for value in values}
    numbers = all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in kinds.values())
    return numbers and len(kinds) > MOST_LISTED


def bins_of(values: Sequence[Any]) -> tuple[NDArray[np.int64], list[Any]]:
    """(n,) number of the bin of each value, and what each bin stands for: a value, or the median of its values.

    Numbers with many values are binned by rank, into bins of equal counts; others by value.
    """
    kinds = {distinct(value): value for value in values}
    numbers = all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in kinds.values())
    if not is_drawn(values):
        ordered = sorted(kinds.values()) if numbers else [kinds[text] for text in sorted(kinds, key=str)]
        place = {distinct(value): number for number, value in enumerate(ordered)}
        return np.array([place[distinct(value)] for value in values]), ordered
    array = np.array(values, dtype=np.float64)
    count = int(np.clip(len(array) // 25, 4, 20))
    edges = np.unique(np.quantile(array, np.linspace(0, 1, count + 1)[1:-1]))
    found = np.searchsorted(edges, array, side="right")
    _, found = np.unique(found, return_inverse=True)
    return found, [float(np.median(array[found == number])) for number in range(int(found.max()) + 1)]


def variance_share(name: str, values: Sequence[Any], figure: FloatArray) -> Share | None:
    """How much of the variance of (n,) figures the parameter explains; None where there is nothing to explain."""
    from scipy.stats import beta, rankdata

    there = ~np.isnan(figure)
    chosen, numbers = [value for value, ok in zip(values, there, strict=True) if ok], figure[there]
    if len(numbers) < 8 or not np.ptp(numbers) > 0:
        return None
    bins, kinds = bins_of(chosen)
    count, groups = len(numbers), len(kinds)
    if groups < 2 or count <= 2 * groups:
        return None
    sizes = np.bincount(bins, minlength=groups)
    means = np.bincount(bins, numbers, minlength=groups) / sizes
    raw = float((sizes * (means - numbers.mean()) ** 2).sum() / ((numbers - numbers.mean()) ** 2).sum())
    # Epsilon squared takes off what bins explain by chance; without an effect the raw share has a beta distribution.
    unbiased = 1 - (count - 1) / (count - groups)
    slope = (count - 1) / (count - groups)
    by_chance = float(beta.ppf(0.95, (groups - 1) / 2, (count - groups) / 2))
    correlation = None
    if all(isinstance(kind, (int, float)) and not isinstance(kind, bool) for kind in kinds):
        ranks = rankdata(np.array(chosen, dtype=np.float64)), rankdata(numbers)
        correlation = float(np.corrcoef(*ranks)[0, 1])
    return Share(name, max(0.0, unbiased + slope * raw), max(0.0, unbiased + slope * by_chance), correlation)
