"""Regolith chemistry: titanium and helium-3 from iron and maturity, which orbiters measure.

Sources:
  FA-JIN   Fa and Jin: helium-3 increases with TiO2 (ilmenite retains it), with the solar wind received and with
           maturity (OMAT decreases as a soil matures).
  PAPER    the publication whose system this project rebuilds: its coefficients are the defaults.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from he3 import constants
from he3.errors import InvalidInput

if TYPE_CHECKING:
    from he3.frames import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class RegolithModel:
    """The coefficients of the chemistry. Measured soils scatter about this relation by several wt % of TiO2."""

    titanium_slope: float = constants.TITANIUM_SLOPE
    titanium_intercept: float = constants.TITANIUM_INTERCEPT
    helium3_gain_ppb: float = constants.HELIUM3_GAIN_PPB
    helium3_offset_ppb: float = constants.HELIUM3_OFFSET_PPB

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not math.isfinite(getattr(self, name)):
                raise InvalidInput(f"expected a finite {name}, got {getattr(self, name)}")
        if not self.helium3_gain_ppb > 0:
            raise InvalidInput(f"expected a positive helium3_gain_ppb, got {self.helium3_gain_ppb}")

    def titanium_wt(self, iron_wt: FloatArray) -> FloatArray:
        """TiO2 [wt %] of soils with the given FeO [wt %], of the same shape.

        TiO2 = 10^(0.06 FeO - 0.54) with the default coefficients (PAPER). Raises InvalidInput outside 0..100 wt %.
        """
        iron = np.asarray(iron_wt, dtype=np.float64)
        if not bool(np.all((iron >= 0) & (iron <= 100))):
            raise InvalidInput(f"expected FeO within 0..100 wt %, got {_extremes(iron)}")
        titanium: FloatArray = np.power(10.0, self.titanium_slope * iron + self.titanium_intercept)
        return titanium

    def helium3_ppb(self, titanium_wt: FloatArray, maturity: FloatArray, flux: float) -> FloatArray:
        """Helium-3 [ppb] of soils with the given TiO2 [wt %] and OMAT, under a relative solar-wind flux.

        He-3 = 0.56 TiO2 F / OMAT + 1.62 with the default coefficients (FA-JIN). Raises InvalidInput for a flux outside
        0..1, and for an OMAT below 0.05, where the relation does not hold.
        """
        titanium = np.asarray(titanium_wt, dtype=np.float64)
        omat = np.asarray(maturity, dtype=np.float64)
        if not 0 < flux <= 1:
            raise InvalidInput(f"expected a solar-wind flux within 0..1, got {flux}")
        if not bool(np.all(omat >= constants.OMAT_MIN)):
            raise InvalidInput(f"expected OMAT of at least {constants.OMAT_MIN}, got {_extremes(omat)}")
        return self.helium3_gain_ppb * titanium * flux / omat + self.helium3_offset_ppb


def solar_wind_flux(
    latitude_deg: float, longitude_deg: float, half_angle_deg: float = constants.MAGNETOTAIL_HALF_ANGLE_DEG
) -> float:
    """Solar-wind flux at a near-side place over a lunation, relative to normal incidence without shielding.

    F = cos(lat) (1 - cos(lon) sin d): a parallel wind, and none while the Moon crosses the magnetotail, within an angle
    d of its orbit around full Moon. Raises InvalidInput for places on the far side.
    """
    if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 90):
        raise InvalidInput(
            f"expected a near-side place, latitude and longitude within -90..90 deg, "
            f"got ({latitude_deg}, {longitude_deg})"
        )
    if not 0 <= half_angle_deg <= 90:
        raise InvalidInput(f"expected a magnetotail half angle within 0..90 deg, got {half_angle_deg}")
    latitude, longitude, half_angle = (math.radians(v) for v in (latitude_deg, longitude_deg, half_angle_deg))
    return math.cos(latitude) * (1.0 - math.cos(longitude) * math.sin(half_angle))


def _extremes(values: FloatArray) -> str:
    if values.size == 0 or not bool(np.isfinite(values).all()):
        return "no values" if values.size == 0 else "values that are not finite"
    return f"{values.min():.4g} to {values.max():.4g}"
