"""Warps: a field that is skewed in ppb as a Gaussian process seen through a monotone map.

A member of the mixture (``he3.mixture``) with a warp has a *latent* field u, a Gaussian process, and the field is

    y = T(u) = c + s (sinh(a + b x) - sinh a) / (b cosh a),      x = (u - c) / s

with the centre c, width s, shift a and strength b. At the centre T has the slope 1 and the value c, so u is in ppb,
too, and what is known of the field in ppb before any sample is known of u. With a positive shift the field varies more
where it is high: it has a long upper tail, and is nearly log-normal far above the centre. A negative shift is its
mirror image (sinh-arcsinh transformations: Jones & Pewsey 2009; warped Gaussian processes: Snelson, Rasmussen &
Ghahramani 2004).

All moments are closed forms. With A and B jointly normal, of means m_A and m_B, variances v_A and v_B, covariance c,

    E sinh A = sinh(m_A) exp(v_A / 2)
    E sinh A sinh B = (cosh(m_A + m_B) exp((v_A + v_B + 2 c) / 2) - cosh(m_A - m_B) exp((v_A + v_B - 2 c) / 2)) / 2

so means, standard deviations and covariances in ppb, and from these those of means over areas, need no quadrature. As T
is monotone, the distribution in ppb is that of u at T^-1, and a quantile is T of that of u.

The instrument's noise is added in ppb. To first order it is the slope of T^-1 at the sample times as much in u, sample
by sample.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from he3.errors import InvalidInput

if TYPE_CHECKING:
    from he3.frames import FloatArray

MOST_SHIFT, MOST_STRENGTH = 4.0, 2.0
"""Bounds of a warp's parameters; beyond them moments overflow within a few standard deviations."""
LEAST_SLOPE = 0.2
"""Of the inverse where noise is concerned: in the upper tail, noise in ppb is taken for more than it is, not less."""
MOST_EXPONENT = 200.0
"""Of a moment, so that none is infinite, even for a kernel whose variance is far from that of the samples."""


@dataclass(frozen=True, slots=True)
class Warp:
    """A monotone map between the latent field and the field, both in ppb.

    shift, strength: a and b, 1. noise_std_ppb: of the instrument, stated. Raises InvalidInput for a width or a strength
    that is not positive, a noise below 0, or a parameter beyond its bound.
    """

    centre_ppb: float
    width_ppb: float
    shift: float
    strength: float
    noise_std_ppb: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.centre_ppb) and math.isfinite(self.width_ppb) and self.width_ppb > 0):
            raise InvalidInput(
                f"expected a warp's finite centre and positive width, got {self.centre_ppb} and {self.width_ppb} ppb"
            )
        if not (0 < self.strength <= MOST_STRENGTH and abs(self.shift) <= MOST_SHIFT):
            raise InvalidInput(
                f"expected a warp's strength up to {MOST_STRENGTH:g} and a shift up to {MOST_SHIFT:g} either way, "
                f"got {self.strength} and {self.shift}"
            )
        if not (math.isfinite(self.noise_std_ppb) and self.noise_std_ppb >= 0):
            raise InvalidInput(f"expected a noise standard deviation of 0 or more, got {self.noise_std_ppb!r} ppb")

    @property
    def _unit_ppb(self) -> float:
        """What a change of sinh by one comes to [ppb]."""
        return self.width_ppb / (self.strength * math.cosh(self.shift))

    def _argument(self, latent_ppb: FloatArray) -> FloatArray:
        """a + b x."""
        return self.shift + self.strength / self.width_ppb * (latent_ppb - self.centre_ppb)

    def log_variance(self, variance_ppb2: FloatArray) -> FloatArray:
        """Variance (...,) [1] of the argument of sinh where the latent field has that variance [ppb^2].

        Far above the centre, it is that of the field's logarithm.
        """
        return self._share(variance_ppb2)

    def _share(self, covariance_ppb2: FloatArray) -> FloatArray:
        """The covariance of arguments, of covariances of the latent field [ppb^2]."""
        return (self.strength / self.width_ppb) ** 2 * covariance_ppb2

    def field(self, latent_ppb: FloatArray) -> FloatArray:
        """The field (...,) [ppb] where the latent field is that [ppb]."""
        return self.centre_ppb + self._unit_ppb * (np.sinh(self._argument(latent_ppb)) - math.sinh(self.shift))

    def latent(self, field_ppb: FloatArray) -> FloatArray:
        """The latent field (...,) [ppb] where the field is that [ppb]: the inverse of ``field``."""
        argument = np.arcsinh(self._of_field(field_ppb))
        return self.centre_ppb + self.width_ppb / self.strength * (argument - self.shift)

    def slope(self, field_ppb: FloatArray) -> FloatArray:
        """Derivative (...,) of ``latent`` where the field is that [ppb]: 1 at the centre, and always positive."""
        return math.cosh(self.shift) / np.hypot(1.0, self._of_field(field_ppb))

    def noise_slope(self, field_ppb: FloatArray) -> FloatArray:
        """The slope by which noise at a value of the field [ppb] is multiplied: not below ``LEAST_SLOPE``."""
        return np.maximum(self.slope(field_ppb), LEAST_SLOPE)

    def _of_field(self, field_ppb: FloatArray) -> FloatArray:
        return math.sinh(self.shift) + (field_ppb - self.centre_ppb) / self._unit_ppb

    def mean(self, mean_ppb: FloatArray, variance_ppb2: FloatArray) -> FloatArray:
        """Mean (...,) of the field [ppb] where the latent field has that mean [ppb] and variance [ppb^2]."""
        argument, variance = self._argument(mean_ppb), self._share(variance_ppb2)
        expected = _half_exp(argument, 0.5 * variance) - _half_exp(-argument, 0.5 * variance)
        return self.centre_ppb + self._unit_ppb * (expected - math.sinh(self.shift))

    def moments(self, mean_ppb: FloatArray, variance_ppb2: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean (...,) [ppb] and variance (...,) [ppb^2] of the field where the latent field has those."""
        covariance = self.covariance(mean_ppb, variance_ppb2, mean_ppb, variance_ppb2, variance_ppb2)
        return self.mean(mean_ppb, variance_ppb2), covariance

    def covariance(
        self,
        mean_ppb: FloatArray,
        variance_ppb2: FloatArray,
        other_mean_ppb: FloatArray,
        other_variance_ppb2: FloatArray,
        covariance_ppb2: FloatArray,
    ) -> FloatArray:
        """Covariance (...,) [ppb^2] of the field between places where the latent field has those means and variances.

        covariance_ppb2: of the latent field between them. All arguments are broadcast.
        """
        a, b = self._argument(mean_ppb), self._argument(other_mean_ppb)
        half = 0.5 * (self._share(variance_ppb2) + self._share(other_variance_ppb2))
        between = self._share(covariance_ppb2)
        # E sinh A sinh B - E sinh A E sinh B, with the difference taken where it is exact: 1 - exp(+-c).
        same = _half_exp(a + b, half) + _half_exp(-a - b, half)
        apart = _half_exp(a - b, half) + _half_exp(b - a, half)
        product = 0.5 * (same * _expm1(between) - apart * _expm1(-between))
        return self._unit_ppb**2 * product


def _half_exp(argument: FloatArray, more: FloatArray) -> FloatArray:
    """exp(argument + more) / 2."""
    return 0.5 * np.exp(np.minimum(argument + more, MOST_EXPONENT))


def _expm1(argument: FloatArray) -> FloatArray:
    return np.expm1(np.minimum(argument, MOST_EXPONENT))
