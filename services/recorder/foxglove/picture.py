"""A small picture of the mean of the map, for programs that draw no grids."""

from __future__ import annotations

import importlib
import io
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from he3.colour_maps import table

if TYPE_CHECKING:
    from he3.frames import BoolArray, Float32Array

MIN_PIXELS: Final = 256  # on the longer side: a cell of the overview is several pixels
_CLOSED: Final = 255  # index of the colour of closed ground
_CLOSED_COLOUR: Final = (40, 24, 24)


def picture(mean_ppb: Float32Array, traversable: BoolArray) -> bytes | None:
    """A PNG, north up, from the lowest to the highest mean; closed ground is dark. None without Pillow."""
    try:
        images: Any = importlib.import_module("PIL.Image")
    except ImportError:  # it comes with the extra of the ground, which a recorder elsewhere need not have
        return None
    low, high = float(mean_ppb.min()), float(mean_ppb.max())
    shades = ((mean_ppb - low) * (254.0 / (high - low) if high > low else 0.0)).astype(np.uint8)
    shades[~traversable] = _CLOSED
    each = -(-MIN_PIXELS // max(shades.shape))
    image = images.fromarray(np.kron(shades[::-1], np.ones((each, each), dtype=np.uint8)))
    image.putpalette([*table("viridis")[:_CLOSED].ravel().tolist(), *_CLOSED_COLOUR])
    written = io.BytesIO()
    image.save(written, "PNG")
    return written.getvalue()
