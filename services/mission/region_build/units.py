"""Units of rasters: the factor from the unit that a file or a recipe names to the unit of the layer.

A unit that the layer cannot have is refused. Without this, helium-3 in ppm would pass for ppb.
"""

from __future__ import annotations

import re
from typing import Final

from he3.errors import InvalidInput
from services.mission.region_build.recipe import SourceTable

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
_OXIDE: Final = dict.fromkeys(_PERCENT, 1.0) | dict.fromkeys(_PPM, 1e-4) | {"fraction": 100.0}
_FACTORS: Final = {
    "elevation_m": _LENGTH,
    "iron_wt": _OXIDE,
    "titanium_wt": _OXIDE,
    "maturity": {"1": 1.0, "omat": 1.0},
    "rock_abundance": {"1": 1.0, "fraction": 1.0, "percent": 0.01, "%": 0.01, "pct": 0.01},
    "he3_ppb": dict.fromkeys(_PPB, 1.0) | dict.fromkeys(_PPM, 1000.0),
}
_SAYS: Final = {
    "elevation_m": '"m" or "km"', "iron_wt": '"wt%", "ppm" or "fraction"', "titanium_wt": '"wt%", "ppm" or "fraction"',
    "maturity": '"1"', "rock_abundance": '"1" or "fraction"', "he3_ppb": '"ppb" or "ppm"',
}  # fmt: skip
_NOT_SAID: Final = ("", "n/a", "na", "none", "null", "unk", "unknown", "unitless", "dimensionless")


def factor_of(name: str, layer: str, table: SourceTable, own: str = "") -> tuple[float, str]:
    """The factor to the unit of the layer, and the unit as it is named; without one, 1 and an empty text.

    own: the unit that the file names, which the recipe's overrides. Raises InvalidInput for a unit that the layer
    cannot have, and where the recipe scales numbers and the file names a unit that asks for another conversion.
    """
    said = table.unit or own
    word = _word(said)
    if word in _NOT_SAID:
        return 1.0, ""
    factors = _FACTORS[layer]
    if word not in factors:
        raise InvalidInput(
            f"{name}: layer {layer}: expected unit {_SAYS[layer]}, got {said!r}; unit in the recipe overrides it"
        )
    factor = factors[word]
    if factor != 1.0 and table.unit is None and (table.scale is not None or table.offset is not None):
        raise InvalidInput(
            f"{name}: layer {layer}: expected key unit, that of the values after scale and offset, as the file's own "
            f"unit is {said!r}: give unit = {_SAYS[layer]}"
        )
    return factor, said


def _word(unit: str) -> str:
    """A unit in one spelling: lower case, without spaces, dots, underscores, quotes and brackets."""
    return re.sub(r"[\s._<>'\"()\[\]]", "", unit.lower().replace("\u00b5", "u").replace("\u03bc", "u"))
