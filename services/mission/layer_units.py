"""Units of a region's layers: the factor from a unit that a raster names to the unit of its layer."""

from __future__ import annotations

import math
import re
from typing import Final

_LENGTH: Final = {
    "kilometer": 1000.0, "kilometre": 1000.0, "kilometers": 1000.0, "kilometres": 1000.0, "km": 1000.0,
    "meter": 1.0, "metre": 1.0, "meters": 1.0, "metres": 1.0, "m": 1.0,
}  # fmt: skip
_PERCENT: Final = (
    "wt%", "%wt", "%", "percent", "pct", "weight%", "weightpercent", "wtpercent", "percentweight", "percentbyweight",
    "mass%", "masspercent", "w%", "%w", "g/100g",
)  # fmt: skip
_PPM: Final = ("ppm", "ppmw", "ug/g", "mg/kg", "g/t")
_PPB: Final = ("ppb", "ppbw", "ng/g", "ug/kg", "mg/t")
_HELIUM3: Final = dict.fromkeys(_PPB, 1.0) | dict.fromkeys(_PPM, 1000.0)
_OXIDE: Final = dict.fromkeys(_PERCENT, 1.0) | dict.fromkeys(_PPM, 1e-4) | {"fraction": 100.0}
_FACTORS: Final = {
    "elevation_m": _LENGTH,
    "iron_wt": _OXIDE,
    "titanium_wt": _OXIDE,
    "maturity": {"1": 1.0, "omat": 1.0},
    "rock_abundance": {"1": 1.0, "fraction": 1.0, "percent": 0.01, "%": 0.01, "pct": 0.01},
    "he3_ppb": _HELIUM3,
    "orbital_ppb": _HELIUM3,
}
UNITS_OF_LAYERS: Final = {
    "elevation_m": '"m" or "km"', "iron_wt": '"wt%", "ppm" or "fraction"', "titanium_wt": '"wt%", "ppm" or "fraction"',
    "maturity": '"1"', "rock_abundance": '"1" or "fraction"', "he3_ppb": '"ppb" or "ppm"',
    "orbital_ppb": '"ppb" or "ppm"',
}  # fmt: skip
_NOT_SAID: Final = ("", "n/a", "na", "none", "null", "unk", "unknown", "unitless", "dimensionless")


def unit_factor(layer: str, unit: str) -> float | None:
    """The factor from a unit to that of the layer: NaN for a unit that it cannot have, None where none is said.

    Of a layer that the project computes nothing from, every unit is its own.
    """
    word = re.sub(r"[\s._<>'\"()\[\]]", "", unit.lower().replace("\u00b5", "u").replace("\u03bc", "u"))
    if word in _NOT_SAID:
        return None
    return _FACTORS[layer].get(word, math.nan) if layer in _FACTORS else 1.0
