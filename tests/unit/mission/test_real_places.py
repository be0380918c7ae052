"""Regions of real rasters: they stay out of the project; HE3_REAL_DATA names their folder (docs/regions.md)."""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from he3.errors import InvalidInput
from services.mission.region_build.build import build_region
from services.mission.region_build.projection import MOON_SPHERE, transformer
from services.mission.region_build.recipe import Recipe, SourceTable
from services.mission.region_build.sources import opened
from services.mission.region_folder import checked
from services.mission.regions import load_region

pytest.importorskip("rasterio")
pytest.importorskip("pyproj")

DATA = Path(os.environ.get("HE3_REAL_DATA", ""))
pytestmark = pytest.mark.skipif(
    not os.environ.get("HE3_REAL_DATA"), reason="HE3_REAL_DATA names no folder of real rasters (docs/regions.md)"
)
PLANNER = "real/leggedrobotics+lunar_planner/user_data/map_data"
GLD100 = "real/derived/gld100_{}_256ppd.tif"


def recipe(lat: float, lon: float, terrain: dict[str, Any], **changes: Any) -> Recipe:
    document: dict[str, Any] = {
        "format": "he3-region-recipe", "version": 1, "name": "place", "title": "A place", "centre_lat_deg": lat,
        "centre_lon_deg": lon, "rows": 100, "columns": 100, "resolution_m": 5.0, "slope_limit_deg": 30.0,
        "chemistry": {"lay_over": "t1", "solar_wind_flux": 0.5}, "layers": {"elevation_m": terrain | {"source": "x"}},
    }  # fmt: skip
    return checked(Recipe, document | changes, Path("recipe"))


def test_the_apollo_17_terrain_has_the_relief_and_the_slopes_that_were_measured_on_it(tmp_path: Path) -> None:
    """Central 500 m: relief 31 m, median slope 3.0 deg, maximum 17.7, 1.3 % over 15 deg."""
    grid = {"centre_lat_deg": 20.19113, "centre_lon_deg": 30.77229, "resolution_m": 5.0}
    build_region(recipe(20.19113, 30.77229, {"file": "apollo17_lm_dem_5m.npy", "grid": grid}), DATA, tmp_path)
    region = load_region(tmp_path)
    assert np.ptp(region.elevation_m) == pytest.approx(31, abs=1)
    assert np.median(region.slope_deg) == pytest.approx(3.0, abs=0.2)
    assert region.slope_deg.max() == pytest.approx(17.7, abs=0.3)
    assert (region.slope_deg > 15).mean() == pytest.approx(0.013, abs=0.003)


@pytest.mark.parametrize(("name", "lat", "lon"), [("taurus_littrow", 20.19, 30.772), ("hadley", 26.132, 3.633)])
def test_gld100_heights_lie_where_their_pixels_are(tmp_path: Path, name: str, lat: float, lon: float) -> None:
    """At the centres of pixels a spline has the raster's own numbers; this window is read without this code."""
    import rasterio

    with rasterio.open(DATA / GLD100.format(name)) as raster:
        left, top, pixel = raster.transform.c, raster.transform.f, raster.transform.a
        row, column = int((top - lat) / pixel), int((lon - left) / pixel)
        west, north = left + (column + 0.5) * pixel, top - (row + 0.5) * pixel
        height = float(raster.read(1)[row, column])
    odd = {"rows": 101, "columns": 101}
    build_region(recipe(north, west, {"file": GLD100.format(name)}, **odd), DATA, tmp_path)
    assert load_region(tmp_path).elevation_m[50, 50] == pytest.approx(height, abs=0.01)


def test_mons_herodotus_rises_where_the_iau_has_it(tmp_path: Path) -> None:
    with (DATA / "real/jaanga+moon/moon-iau-nomenclature.csv").open(encoding="utf-8") as stream:
        lat, lon = next((float(row[2]), float(row[3])) for row in csv.reader(stream) if row[0] == "Mons Herodotus")
    terrain = {"file": f"{PLANNER}/Herodutus_Mons/hsr.tif", "band": "qts_demstack"}
    build_region(recipe(27.4895, -52.957, terrain, rows=170, columns=230, resolution_m=53.634071), DATA, tmp_path)
    region = load_region(tmp_path)
    x, y = transformer(MOON_SPHERE, region.crs).transform(lon, lat)
    assert region.origin_x_m is not None
    assert region.origin_y_m is not None
    here = np.array([x - region.origin_x_m, y - region.origin_y_m])
    rows, columns = np.nonzero(region.elevation_m > np.quantile(region.elevation_m, 0.98))
    summit = np.array([columns.mean(), rows.mean()]) * region.grid.resolution_m
    assert np.hypot(*(summit - here)) < 1500  # of a mountain of 6.8 km


def test_of_several_bands_one_must_be_named(tmp_path: Path) -> None:
    terrain = {"file": f"{PLANNER}/Herodutus_Mons/hsr.tif"}
    with pytest.raises(
        InvalidInput, match="expected key band, as there are 3: qts_demstack_slope, qts_demstack, dlre_ra"
    ):
        build_region(recipe(27.4895, -52.957, terrain), DATA, tmp_path)


def test_lola_radii_of_the_pds3_label_become_heights() -> None:
    """LDEM_4: half metres above 1737.4 km, or radii, by its label; the Moon's heights are within -9.1 and 10.8 km."""
    table = checked(SourceTable, {"file": "real/rp3gregorio+Lunar-Clean/LDEM_4.IMG", "source": "x"}, Path("x"))
    with opened("elevation_m", table, DATA) as source:
        values = source.read(0, 0, source.rows, source.columns)
        assert source.is_global
        assert source.product_id == "LDEM_4"
    assert -9200 < values.min() < -8000
    assert 9000 < values.max() < 10900
