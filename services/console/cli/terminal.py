"""A layer drawn in a terminal: two cells a character in colour, or one cell as a letter of growing weight."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from schemas.maps import MapRaster

RAMP = " .:-=+*#%@"


def drawn(values: NDArray[Any], raster: MapRaster, width: int, colours: bool | None = None) -> list[str]:
    """The layer as lines of text, north at the top, with its scale; in colour if standard output shows colours."""
    if colours is None:
        colours = sys.stdout.isatty() and "NO_COLOR" not in os.environ
    rows, columns = values.shape
    # A character is about twice as high as it is wide: in colour it shows two cells, one above the other.
    height = max(2, round(width * rows / columns / 2)) * (2 if colours else 1)
    shrunk = np.flipud(_block_means(values.astype(np.float64), min(height, rows), min(width, columns)))
    low, high = float(values.min()), float(values.max())
    unit = np.zeros_like(shrunk) if high <= low else np.clip((shrunk - low) / (high - low), 0.0, 1.0)
    lines = _coloured(unit, raster.layer.value == "std") if colours else _lettered(unit)
    extent = f"{columns * raster.resolution_m:g} x {rows * raster.resolution_m:g} m, north up"
    unit_name = "" if raster.unit == "1" else f" {raster.unit}"
    closed_or_open = raster.layer.value == "traversable"
    scale = "dark: closed, light: open" if closed_or_open else f"{low:.3g} to {high:.3g}{unit_name}"
    return [*lines, f"{raster.layer.value}: {scale}; {extent}; revision {raster.revision}, {raster.samples} samples"]


def _block_means(values: NDArray[np.float64], rows: int, columns: int) -> NDArray[np.float64]:
    """The raster shrunk to (rows, columns): means over blocks of nearly equal size."""
    row_edges = np.linspace(0, values.shape[0], rows + 1).round().astype(int)
    column_edges = np.linspace(0, values.shape[1], columns + 1).round().astype(int)
    sums = np.add.reduceat(np.add.reduceat(values, row_edges[:-1], axis=0), column_edges[:-1], axis=1)
    sizes = np.outer(np.diff(row_edges), np.diff(column_edges))
    means: NDArray[np.float64] = sums / sizes
    return means


def _lettered(unit: NDArray[np.float64]) -> list[str]:
    indices = np.minimum((unit * len(RAMP)).astype(int), len(RAMP) - 1)
    return ["".join(RAMP[index] for index in row) for row in indices]


def _coloured(unit: NDArray[np.float64], uncertainty: bool) -> list[str]:
    from matplotlib import colormaps

    shades = (colormaps["magma" if uncertainty else "viridis"](unit)[..., :3] * 255).round().astype(int)
    if len(shades) % 2:
        shades = np.concatenate([shades, shades[-1:]])
    lines = []
    for upper, lower in zip(shades[::2], shades[1::2], strict=True):
        cells = (
            f"\x1b[38;2;{a[0]};{a[1]};{a[2]}m\x1b[48;2;{b[0]};{b[1]};{b[2]}m▀"
            for a, b in zip(upper, lower, strict=True)
        )
        lines.append("".join(cells) + "\x1b[0m")
    return lines
