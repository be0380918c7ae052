"""The unit of a raster: the recipe's, or else the file's.

A unit that the layer cannot have is refused. Without this, helium-3 in ppm would pass for ppb.
"""

from __future__ import annotations

import math

from he3.errors import InvalidInput
from services.mission.layer_units import UNITS_OF_LAYERS, unit_factor
from services.mission.region_build.recipe import SourceTable


def factor_of(name: str, layer: str, table: SourceTable, own: str = "") -> tuple[float, str]:
    """The factor to the unit of the layer, and the unit as it is named; without one, 1 and an empty text.

    own: the unit that the file names, which the recipe's overrides. Raises InvalidInput for a unit that the layer
    cannot have, and where the recipe scales numbers and the file names a unit that asks for another conversion.
    """
    said = table.unit or own
    factor = unit_factor(layer, said)
    if factor is None:
        return 1.0, ""
    if math.isnan(factor):
        raise InvalidInput(
            f"{name}: layer {layer}: expected unit {UNITS_OF_LAYERS[layer]}, got {said!r}; unit in the recipe "
            "overrides that of the file"
        )
    if factor != 1.0 and table.unit is None and (table.scale is not None or table.offset is not None):
        raise InvalidInput(
            f"{name}: layer {layer}: expected key unit, that of the values after scale and offset, as the file's own "
            f"unit is {said!r}: give unit = {UNITS_OF_LAYERS[layer]}"
        )
    return factor, said
