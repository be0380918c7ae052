"""What the samples showed of the instrument's noise and of a field's two lengths, for the report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from he3.kernels import BEARING, STRETCH
from schemas.report import LearnedReport

if TYPE_CHECKING:
    from schemas.ground import KernelParameters


def learned(kernel: KernelParameters | None, stated_noise_std_ppb: float) -> LearnedReport | None:
    """The account of the kernel in use and its alternatives; None where nothing was learned beside its lengths."""
    if kernel is None:
        return None
    stretched = [each for each in kernel.alternatives or () if STRETCH in each.parameters]
    if not stretched and kernel.noise_std_ppb <= stated_noise_std_ppb:
        return None
    heaviest = max(stretched, key=lambda each: each.weight).parameters if stretched else {}
    return LearnedReport(
        noise_std_ppb=kernel.noise_std_ppb,
        stated_noise_std_ppb=stated_noise_std_ppb,
        stretched_weight=min(1.0, sum(each.weight for each in stretched)),
        stretch=heaviest.get(STRETCH),
        bearing_deg=heaviest.get(BEARING),
    )


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
