"""What the samples showed of the instrument's noise, and of a field's two lengths, skew and uneven parts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Literal

from he3.kernels import BEARING, STRETCH
from he3.local_amplitude import AMPLITUDE_EXTENT
from schemas.report import LearnedReport

if TYPE_CHECKING:
    from schemas.ground import KernelParameters

LEAST_SKEWED = 0.5  # 1, weight of the kernels of a skewed field from which it is told; before any sample it is 0.23
LEAST_UNEVEN = 1.0 / 3.0  # 1, the same of uneven parts, which have two thirds of the weight at most
SIDES: Final[tuple[tuple[Literal["high", "low"], int], ...]] = (("high", 1), ("low", -1))


def learned(kernel: KernelParameters | None, stated_noise_std_ppb: float) -> LearnedReport | None:
    """The account of the kernel in use and its alternatives; None where nothing was learned beside its lengths."""
    if kernel is None:
        return None
    stretched = [each for each in kernel.alternatives or () if STRETCH in each.parameters]
    where, skewed_weight = _skewed(kernel)
    uneven = sum(each.weight for each in kernel.alternatives or () if AMPLITUDE_EXTENT in each.parameters)
    uneven_weight = min(1.0, uneven) if uneven >= LEAST_UNEVEN else None
    quiet = kernel.noise_std_ppb <= stated_noise_std_ppb
    if not stretched and where is None and uneven_weight is None and quiet:
        return None
    heaviest = max(stretched, key=lambda each: each.weight).parameters if stretched else {}
    return LearnedReport(
        noise_std_ppb=kernel.noise_std_ppb,
        stated_noise_std_ppb=stated_noise_std_ppb,
        stretched_weight=min(1.0, sum(each.weight for each in stretched)),
        stretch=heaviest.get(STRETCH),
        bearing_deg=heaviest.get(BEARING),
        varies_more_where=where,
        skewed_weight=skewed_weight,
        uneven_weight=uneven_weight,
    )


def _skewed(kernel: KernelParameters) -> tuple[Literal["high", "low"] | None, float | None]:
    """Where the field varies more, and the weight of that; None where it has less than half of the weight."""
    for where, sign in SIDES:
        weight = sum(each.weight for each in kernel.alternatives or () if each.warp and sign * each.warp.shift > 0)
        if weight >= LEAST_SKEWED:
            return where, min(1.0, weight)
    return None, None


def kernel_weights(kernel: KernelParameters | None) -> dict[str, float] | None:
    """The weight of each kernel in the mixture, by name, the heaviest first; None where all have one name."""
    if kernel is None:
        return None
    weights: dict[str, float] = {}
    for each in kernel.alternatives or ():
        name = each.name or kernel.name
        weights[name] = weights.get(name, 0.0) + each.weight
    if len(weights) < 2:
        return None
    return dict(sorted(weights.items(), key=lambda one: -one[1]))
