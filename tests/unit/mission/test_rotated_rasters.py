"""Rasters that are rotated against the site, as polar mosaics are: sizes of pixels, slopes, means over pixels."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from he3.frames import SiteGrid
from services.mission.region_build.projection import site_plane, transformer
from services.mission.region_build.recipe import SourceTable
from services.mission.region_build.sampling import Sampled, sample
from services.mission.region_build.sources import opened

rasterio = pytest.importorskip("rasterio")
pytest.importorskip("pyproj")

POLAR = "+proj=stere +lat_0=-90 +lon_0=0 +k_0=1 +R=1737400 +units=m"
INCLINE_DEG = 18.0


def sampled(folder: Path, longitude: float, cell_m: float, pixel_m: float) -> Sampled:
    """Heights of a plane, inclined by INCLINE_DEG to the site's north-east, read from a polar stereographic raster."""
    grid = SiteGrid(30, 30, cell_m)
    plane = site_plane(-88.0, longitude, grid)
    pixels = int(grid.width_m * 2.5 / pixel_m)
    x, y = transformer("+proj=longlat +R=1737400", POLAR).transform(longitude, -88.0)
    transform = rasterio.Affine(pixel_m, 0, x - pixels / 2 * pixel_m, 0, -pixel_m, y + pixels / 2 * pixel_m)
    columns, rows = np.meshgrid(np.arange(pixels) + 0.5, np.arange(pixels) + 0.5)
    east, north = transform.a * columns + transform.c, transform.e * rows + transform.f
    east, north = transformer(POLAR, plane.crs).transform(east, north)
    heights = math.tan(math.radians(INCLINE_DEG)) * (east - plane.x_m + north - plane.y_m) / math.sqrt(2.0)
    profile = {"height": pixels, "width": pixels, "dtype": "float32", "crs": rasterio.crs.CRS.from_string(POLAR)}
    with rasterio.open(folder / "dem.tif", "w", driver="GTiff", count=1, transform=transform, **profile) as target:
        target.write(heights.astype("float32"), 1)
    with opened("elevation_m", SourceTable(file="dem.tif", source="made"), folder) as source:
        return sample(source, plane, 1, slopes=True)


@pytest.mark.parametrize("longitude", [0.0, 20.0, 45.0, 90.0, 135.0, 222.7])
def test_slopes_of_a_rotated_rasters_pixels_are_those_of_the_ground(tmp_path: Path, longitude: float) -> None:
    found = sampled(tmp_path, longitude, cell_m=5.0, pixel_m=20.0)
    assert found.pixel_m == pytest.approx(20.0, rel=1e-3)
    assert found.source_slope_deg is not None
    assert np.abs(found.source_slope_deg - INCLINE_DEG).max() < 0.05


@pytest.mark.parametrize("longitude", [0.0, 45.0, 222.7])
def test_a_cell_is_the_mean_of_as_many_pixels_of_a_rotated_raster(tmp_path: Path, longitude: float) -> None:
    found = sampled(tmp_path, longitude, cell_m=20.0, pixel_m=4.0)
    assert found.pixel_m == pytest.approx(4.0, rel=1e-3)
    assert found.pixel_m == pytest.approx(4.0, rel=1e-3)
    step = np.diff(found.values, axis=1)  # a plane's cells rise by the same height, whatever is averaged
    assert np.abs(step / (20.0 * math.tan(math.radians(INCLINE_DEG)) / math.sqrt(2.0)) - 1.0).max() < 0.01
