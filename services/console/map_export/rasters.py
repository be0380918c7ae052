"""Rasters as Cloud-Optimised GeoTIFFs: north up, tiled, with overviews, statistics, units, descriptions and tags."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from he3.errors import He3Error, InvalidInput
from services.console.map_export.styles import class_colours
from services.mission.region_build.geo import rasterio

if TYPE_CHECKING:
    from he3.frames import SiteGrid
    from services.console.map_export.contents import RasterLayer
    from services.console.map_export.placement import Placement

NO_DATA: Final = -3.4028226550889045e38  # of float32 layers, as in the products of LROC
TILE: Final = 256  # pixels on a side; the first overview of a site of 500 x 500 cells is one tile


def geotiff(layer: RasterLayer, placement: Placement, grid: SiteGrid, tags: Mapping[str, str]) -> bytes:
    """The layer as a Cloud-Optimised GeoTIFF. tags: metadata of the file, by name."""
    library = rasterio()
    with opened(layer, placement, grid, tags) as source, library.io.MemoryFile() as target:
        library.shutil.copy(
            source, target.name, driver="COG", BLOCKSIZE=TILE, COMPRESS="DEFLATE", STATISTICS="YES",
            OVERVIEW_RESAMPLING="MODE" if layer.classes else "AVERAGE",
            PREDICTOR="NO" if layer.classes else "FLOATING_POINT",
        )  # fmt: skip
        content: bytes = target.read()
        return content


@contextmanager
def opened(layer: RasterLayer, placement: Placement, grid: SiteGrid, tags: Mapping[str, str]) -> Iterator[Any]:
    """The layer as an open raster of rasterio, in memory; an error of the library is a He3Error with one line."""
    library = rasterio()
    if layer.values.shape != grid.shape:  # rasterio would stretch them
        raise InvalidInput(f"{layer.name}: expected a raster of {grid.shape} cells, got {layer.values.shape}")
    data = np.ascontiguousarray(np.flipud(layer.values))
    cell = grid.resolution_m
    options: dict[str, Any] = {
        "driver": "GTiff", "height": grid.rows, "width": grid.columns, "count": 1, "dtype": data.dtype.name,
        "crs": placement.wkt,
        "transform": library.Affine(cell, 0.0, placement.x_m, 0.0, -cell, placement.y_m + grid.height_m),
    }  # fmt: skip
    if not layer.classes:
        options["nodata"] = NO_DATA
        data = np.where(np.isnan(data), np.float32(NO_DATA), data)
    try:
        with library.io.MemoryFile() as memory:
            with memory.open(**options) as source:
                source.write(data, 1)
                source.set_band_description(1, layer.title)
                source.units = (layer.unit,)
                source.update_tags(**tags)
                if layer.classes:
                    source.write_colormap(1, class_colours(layer))
                    source.update_tags(
                        1, CLASSES="; ".join(f"{value}: {name}" for value, name in layer.classes.items())
                    )
            with memory.open() as source:
                yield source
    except library.errors.RasterioError as error:
        raise He3Error(f"{layer.name}: cannot write the raster: {error}") from None


def statistics(layer: RasterLayer) -> dict[str, float]:
    """Minimum, maximum, mean and standard deviation of the values, as the file has them, and the share of cells with
    one.
    """
    known = ~np.isnan(layer.values)
    values = layer.values[known].astype(np.float64)
    return {
        "minimum": float(values.min()), "maximum": float(values.max()), "mean": float(values.mean()),
        "stddev": float(values.std()), "valid_percent": float(100.0 * known.mean()),
    }  # fmt: skip
