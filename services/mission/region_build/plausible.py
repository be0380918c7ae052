"""Refusal of numbers that no soil and no ground has, in the pixels of a raster, before they are resampled.

Cubic splines smear a hole that is marked by -999 over its surroundings, into values that look possible. A raster in
another unit gives a region that looks possible, too, once its values are clipped to those of soils.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from he3 import constants
from he3.errors import InvalidInput
from he3.frames import BoolArray, FloatArray
from he3.nodata import cells_where, undeclared

ROCKS_BEYOND: Final = 0.2  # 1, how far cubic splines may lead beyond 0 and 1 beside a step
_RANGES: Final = {
    "elevation_m": (constants.ELEVATION_MIN_M, constants.ELEVATION_MAX_M, " m"),
    "iron_wt": (0.0, constants.IRON_MAX_WT, " wt %"),
    "titanium_wt": (-constants.ABUNDANCE_ERROR, constants.TITANIUM_MAX_WT, " wt %"),
    "maturity": (0.0, constants.OMAT_MAX, ""),
    "he3_ppb": (-constants.ABUNDANCE_ERROR, constants.HELIUM3_MAX_PPB, " ppb"),
    "rock_abundance": (-ROCKS_BEYOND, 1.0 + ROCKS_BEYOND, ""),
}
_RADII_KM: Final = tuple(
    (constants.MOON_RADIUS_M + height) / 1000.0 for height in (constants.ELEVATION_MIN_M, constants.ELEVATION_MAX_M)
)


def expect_no_marks(name: str, layer: str, raw: NDArray[Any], missing: BoolArray) -> None:
    """Raises InvalidInput if numbers of the file (rows, columns) mark missing values and nothing says so."""
    found = undeclared(raw, ~missing)
    if found is not None:
        others = raw[~missing & ~found.where]
        raise InvalidInput(
            f"{name}: layer {layer}: expected values as the others, {others.min():g} to {others.max():g}, got "
            f"{found.number:g}, which marks missing values, in {cells_where(found.where)} of the window; "
            f"no_data = [{found.number:g}] says so"
        )


def expect_plausible(name: str, layer: str, values: FloatArray, unit: str) -> None:
    """Raises InvalidInput if values (rows, columns) in the layer's unit, NaN where missing, are not possible there.

    unit: that of the recipe or the file; without one, FeO as a fraction, helium-3 in ppm and radii in km are refused.
    """
    known = np.isfinite(values)
    if not known.any():
        return
    lowest, highest = float(values[known].min()), float(values[known].max())
    low, high, of = _RANGES[layer]
    off = known & ((values < low) | (values > high))
    if off.any():
        raise InvalidInput(
            f"{name}: layer {layer}: expected {low:g} to {high:g}{of}, got {float(values[off][0]):g} in "
            f"{cells_where(off)} of the window; unit and scale convert it, no_data marks it as missing"
        )
    if layer == "iron_wt" and not unit and highest <= constants.IRON_MAX_WT / 100.0:
        raise InvalidInput(
            f'{name}: layer {layer}: expected FeO in wt %, got at most {highest:.4g}: give unit = "fraction" or "wt%"'
        )
    if layer == "he3_ppb" and not unit and 0.0 < highest < constants.HELIUM3_LEAST_PPB:
        raise InvalidInput(
            f'{name}: layer {layer}: expected helium-3 in ppb, got at most {highest:.4g}: give unit = "ppm" or "ppb"'
        )
    if layer == "elevation_m" and not unit and _RADII_KM[0] <= lowest and highest <= _RADII_KM[1]:
        raise InvalidInput(
            f"{name}: layer {layer}: expected heights in m, got {lowest:.6g} to {highest:.6g}, as radii in km: give "
            'unit = "km" or "m"'
        )
