"""The colour maps of all pictures: a few stops each, interpolated linearly.

viridis and magma are by Smith and van der Walt, dedicated to the public domain (CC0). They are perceptually uniform, so
that they read the same in grey and to the colour-blind. "difference" is blue below and red above the middle, after
Brewer's RdBu.
"""

from __future__ import annotations

from functools import cache
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

_STOPS: Final = MappingProxyType(
    {
        "viridis": "44015448186a472d7b4240863b528b33638d2c728e26828e21918c"
        "1fa08828ae803fbc735ec96284d44baddc30d8e219fde725",
        "magma": "0000040a08221d114736106b51127c6a1c818326819c2e7fb73779"
        "d0416fe75263f56b5cfc8961fea772fec488fde2a3fcfdbf",
        "grey": "000000ffffff",
        "difference": "2166acf7f7f7b2182b",
        "open": "5b2c2c5b2c2c5b2c2c5b2c2c5b2c2c5b2c2c5b2c2c5b2c2cd9d4c7"
        "d9d4c7d9d4c7d9d4c7d9d4c7d9d4c7d9d4c7d9d4c7d9d4c7",
    }
)

OF_LAYER: Final = MappingProxyType(
    {
        "mean": "viridis",
        "std": "magma",
        "information": "magma",
        "exceedance": "viridis",
        "traversable": "open",
        "elevation": "grey",
        "slope": "magma",
        "shade": "grey",
        "reference": "viridis",
        "error": "difference",
    }
)
"""Name of the colour map of each layer."""


def stops(name: str) -> list[str]:
    """The stops of a colour map, lowest first, as '#rrggbb'."""
    packed = _STOPS[name]
    return ["#" + packed[start : start + 6] for start in range(0, len(packed), 6)]


@cache
def table(name: str) -> NDArray[np.uint8]:
    """The colour map as 256 colours (256, 3), lowest first."""
    fixed = np.array([[int(stop[i : i + 2], 16) for i in (1, 3, 5)] for stop in stops(name)], dtype=np.float64)
    places = np.linspace(0, len(fixed) - 1, 256)
    colours = np.stack([np.interp(places, np.arange(len(fixed)), fixed[:, channel]) for channel in range(3)], axis=1)
    return colours.round().astype(np.uint8)


def shaded(values: NDArray[np.floating], low: float, high: float, name: str) -> NDArray[np.uint8]:
    """Colours (rows, columns, 3) of the values (rows, columns): up to `low` the first, from `high` on the last."""
    span = high - low if high > low else 1.0
    shades = np.clip((values - low) * (255.0 / span), 0, 255).astype(np.uint8)
    coloured: NDArray[np.uint8] = table(name)[shades]
    return coloured
