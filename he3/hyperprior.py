"""What is known of a field before landing, as priors of the hyperparameters in ppb and metres, never from the samples.

Standard deviations and length scales are log-normal, the constant mean is normal, and the noise is the instrument's:

- **mean**: the means of six landing sites lie at 1.4 to 15.1 ppb, so 7.5 +- 4 ppb. Samples that lie more than one and a
  half of that away widen it by the excess, and the field's standard deviation in the same proportion, so that a field
  in another unit is not drawn towards that of helium-3;
- **standard deviation**: the two regions of 500 m have 0.6 and 1.0 ppb, the six sites differ by 4.5. So 1.7 ppb within
  a factor of 2.5 (68 %) and 6 (95 %), whatever the width of the site. With an orbital map as trend, the map's own
  spread takes the place of 1.7 ppb for what remains;
- **length scales**: in proportion to the width of the site. Of a sum, the smooth part's is about a quarter of the width
  and the rough part's a sixteenth; a single part's lies in between.

The ratio of a log-normal's 84 % quantile to its median is its *factor*.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from he3.errors import InvalidInput
from he3.kernels import KERNELS

if TYPE_CHECKING:
    from he3.frames import FloatArray

MEAN_PPB = 7.5  # ppb, middle of the means of six landing sites, 1.4 to 15.1 [assumed]
MEAN_STD_PPB = 4.0  # ppb, standard deviation of those means [assumed]
FIELD_STD_PPB = 1.7  # ppb, between the spreads of 500 m (0.6, 1.0) and of the six sites (4.5) [assumed]
FIELD_STD_FACTOR = 2.5  # 1
# 1, shares of the field's standard deviation in the parts of a sum: a smooth part and a rough one, as 0.7 and 0.3 of
# the variance, which are the parts' default
PART_STD_SHARES = {"smooth_variance": 0.84, "rough_variance": 0.55, "variance": 1.0}
# 1, median of a length scale in widths of the site, and its factor [assumed]
LENGTH_SCALES = {
    "smooth_length_scale_m": (0.25, 2.5),
    "rough_length_scale_m": (0.06, 2.5),
    "length_scale_m": (0.15, 2.5),
}
UNREMARKABLE = 0.5
"""How far beyond one standard deviation the samples' mean may lie before the unit is doubted, in such deviations."""
REACH = 10.0
"""Bounds of the search, in logarithms of the factor on either side of the median: for fields in other units."""


@dataclass(frozen=True, slots=True)
class Hyperprior:
    """The priors of one site: mean [ppb], median of the field's standard deviation [ppb], and the site's width [m].

    Raises InvalidInput unless standard deviations and width are positive and finite.
    """

    extent_m: float
    mean_ppb: float = MEAN_PPB
    mean_std_ppb: float = MEAN_STD_PPB
    field_std_ppb: float = FIELD_STD_PPB

    def __post_init__(self) -> None:
        for name, value in (
            ("width of the site", self.extent_m),
            ("standard deviation of the mean", self.mean_std_ppb),
            ("standard deviation of the field", self.field_std_ppb),
        ):
            if not (math.isfinite(value) and value > 0):
                raise InvalidInput(f"expected a positive {name}, got {value!r}")

    @property
    def least_field_std_ppb(self) -> float:
        """Standard deviation of the field [ppb] that one in forty fields does not reach."""
        return self.field_std_ppb / FIELD_STD_FACTOR**2

    def log_normal(self, kernel_name: str) -> tuple[FloatArray, FloatArray]:
        """Medians (p,) and factors (p,) of the kernel's parameters, both as logarithms.

        Variances are in units of ``field_std_ppb`` squared, and lengths in metres.
        """
        medians, factors = [], []
        for name in KERNELS[kernel_name]().parameters():
            if name in PART_STD_SHARES:
                medians.append(2.0 * math.log(PART_STD_SHARES[name]))
                factors.append(2.0 * math.log(FIELD_STD_FACTOR))
            else:
                share, factor = LENGTH_SCALES[name]
                medians.append(math.log(share * self.extent_m))
                factors.append(math.log(factor))
        return np.array(medians), np.array(factors)
