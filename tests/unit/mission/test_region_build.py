"""Regions built from rasters with analytic fields, at the grids, datums and no-data values of the real products."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from he3.errors import He3Error, InvalidInput
from he3.reference import Region
from he3.terrain import slope_deg
from services.mission.region_build.build import build_region
from services.mission.region_build.recipe import Recipe
from services.mission.region_build.sampling import source_slopes
from services.mission.region_build.templates import TEMPLATES
from services.mission.region_folder import checked, load_toml, read_document
from services.mission.regions import load_region

rasterio = pytest.importorskip("rasterio")
pytest.importorskip("pyproj")

Array = NDArray[np.float64]
R = 1_737_400.0
NO_DATA = -3.4028226550889045e38
LAT, LON = 20.19, 30.772


def heights(latitude_deg: Array, longitude_deg: Array) -> Array:
    """An analytic field on the sphere [m], smooth everywhere, the poles and the antimeridian included."""
    lat, lon = np.radians(latitude_deg), np.radians(longitude_deg)
    x, y, z = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)
    k = 2 * math.pi * R / 900.0
    return -1500 + 8 * np.sin(k * x) + 9 * np.cos(k * y + 1) + 7 * np.sin(k * z + 2)


def recipe(lat: float, lon: float, **changes: Any) -> dict[str, Any]:
    document: dict[str, Any] = {
        "format": "he3-region-recipe", "version": 1, "name": "place", "title": "A place", "centre_lat_deg": lat,
        "centre_lon_deg": lon, "rows": 60, "columns": 70, "resolution_m": 6.0, "slope_limit_deg": 30.0,
        "chemistry": {"lay_over": "t1", "solar_wind_flux": 0.5},
        "layers": {"elevation_m": {"file": "dem.tif", "source": "analytic"}},
    }  # fmt: skip
    return document | changes


def build(document: dict[str, Any], folder: Path) -> Region:
    build_region(checked(Recipe, document, folder / "recipe.toml"), folder, folder / "out")
    return load_region(folder / "out")


def geotiff(path: Path, values: Array, crs: str, transform: Any, **options: Any) -> None:
    with rasterio.open(
        path, "w", driver=options.pop("driver", "GTiff"), height=values.shape[0], width=values.shape[1], count=1,
        dtype="float32", crs=rasterio.crs.CRS.from_string(crs), transform=transform, **options,
    ) as target:  # fmt: skip
        target.write(values.astype("float32"), 1)


def from_origin(west: float, north: float, width: float, height: float) -> Any:
    """The transform of a raster with that outer north-west corner."""
    return rasterio.Affine(width, 0.0, west, 0.0, -height, north)


def degrees_grid(lat: float, lon: float, per_degree: int, pixels: int = 48) -> tuple[Array, Array, float, float]:
    """(latitudes, longitudes) of pixel centres on the product's own lattice, and its north and west edge [deg]."""
    north = (math.floor(lat * per_degree) + pixels // 2) / per_degree
    west = (math.floor(lon * per_degree) - pixels // 2) / per_degree
    steps = (np.arange(pixels) + 0.5) / per_degree
    lats, lons = np.meshgrid(north - steps, west + steps, indexing="ij")
    return lats, lons, north, west


def expected(region: Region, lat: float) -> Array:
    """The field at the cells, by the local equirectangular projection, written out."""
    assert region.origin_lat_deg is not None
    assert region.origin_lon_deg is not None
    lats = region.origin_lat_deg + np.degrees(region.grid.y_m / R)
    lons = region.origin_lon_deg + np.degrees(region.grid.x_m / (R * math.cos(math.radians(lat))))
    return heights(*np.meshgrid(lats, lons, indexing="ij"))


def expect_agreement(region: Region, truth: Array, tolerance_m: float) -> None:
    """Heights within the interpolation error, and registration within 0.1 m, fitted to the slopes of the field."""
    error = region.elevation_m - truth
    north, east = np.gradient(truth, region.grid.resolution_m)
    design = np.column_stack((east.ravel(), north.ravel(), np.ones(truth.size)))
    shift = np.linalg.lstsq(design, error.ravel(), rcond=None)[0]
    assert np.abs(shift[:2]).max() < 0.1
    assert np.abs(error).max() < tolerance_m


def pds3(folder: Path, sample_type: str, dtype: str, words: str, values: Array, projection: str) -> None:
    """An image with its detached label; the image begins after two records of other bytes."""
    rows, columns = values.shape
    record = columns * np.dtype(dtype).itemsize
    (folder / "DEM.IMG").write_bytes(b"\x7f" * 2 * record + values.astype(dtype).tobytes())
    (folder / "DEM.LBL").write_text(
        f"""PDS_VERSION_ID = "PDS3"
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = {record}
FILE_RECORDS = {rows + 2}
^IMAGE = ("DEM.IMG", 3)
PRODUCT_ID = "ANALYTIC_512"
TARGET_NAME = MOON
OBJECT = IMAGE
  LINES = {rows}
  LINE_SAMPLES = {columns}
  SAMPLE_TYPE = {sample_type}
  SAMPLE_BITS = {np.dtype(dtype).itemsize * 8}
{words}
END_OBJECT = IMAGE
OBJECT = IMAGE_MAP_PROJECTION
  A_AXIS_RADIUS = 1737.4 <km>
  B_AXIS_RADIUS = 1737.4 <km>
  C_AXIS_RADIUS = 1737.4 <km>
  COORDINATE_SYSTEM_NAME = "MEAN EARTH/POLAR AXIS OF DE421"
  POSITIVE_LONGITUDE_DIRECTION = "EAST"
{projection}
END_OBJECT = IMAGE_MAP_PROJECTION
END
"""
    )


def cylindrical(north: float, west: float, pixels: int) -> str:
    """The projection of a PDS3 label of 512 pixels a degree, as SLDEM2015's; a square of that many pixels."""
    return f"""  MAP_PROJECTION_TYPE = "SIMPLE CYLINDRICAL"
  MAP_RESOLUTION = 512 <pix/deg>
  CENTER_LATITUDE = 0 <deg>
  CENTER_LONGITUDE = 180 <deg>
  MAP_SCALE = {math.radians(1) * 1737.4 / 512!r} <km/pix>
  MAXIMUM_LATITUDE = {north!r} <deg>
  MINIMUM_LATITUDE = {north - pixels / 512!r} <deg>
  WESTERNMOST_LONGITUDE = {west!r} <deg>
  EASTERNMOST_LONGITUDE = {west + pixels / 512!r} <deg>
  LINE_PROJECTION_OFFSET = {north * 512 - 0.5!r} <pix>
  SAMPLE_PROJECTION_OFFSET = {(180 - west) * 512 - 0.5!r} <pix>"""


def polar(x0: float, y0: float, cell: float) -> str:
    """The projection of a PDS3 label of the south pole, as LOLA's, for that outer north-west corner [m]."""
    return f"""  MAP_PROJECTION_TYPE = "POLAR STEREOGRAPHIC"
  MAP_RESOLUTION = {math.radians(1) * R / cell!r} <pix/deg>
  CENTER_LATITUDE = -90 <deg>
  CENTER_LONGITUDE = 0 <deg>
  MAP_SCALE = {cell!r} <m/pix>
  MAXIMUM_LATITUDE = -80 <deg>
  MINIMUM_LATITUDE = -90 <deg>
  WESTERNMOST_LONGITUDE = 0 <deg>
  EASTERNMOST_LONGITUDE = 360 <deg>
  LINE_PROJECTION_OFFSET = {y0 / cell - 0.5!r} <pix>
  SAMPLE_PROJECTION_OFFSET = {-x0 / cell - 0.5!r} <pix>"""


RADII = "  UNIT = METER\n  SCALING_FACTOR = 0.01\n  OFFSET = 1735900"


@pytest.mark.parametrize(
    ("sample_type", "dtype", "words", "encode"),
    [
        ("PC_REAL", "<f4", "  UNIT = KILOMETER", lambda h: h / 1000),
        ("PC_REAL", "<f4", "  UNIT = KILOMETER\n  SCALING_FACTOR = 1\n  OFFSET = 1737.4", lambda h: h / 1000),
        ("IEEE_REAL", ">f4", "  UNIT = METER", lambda h: h),
        ("LSB_INTEGER", "<i2", RADII, lambda h: np.rint((h + 1500) * 100)),
        ("MSB_INTEGER", ">i2", RADII, lambda h: np.rint((h + 1500) * 100)),
    ],
)
def test_a_pds3_image_is_read_by_its_label_in_its_byte_order_unit_and_place(
    tmp_path: Path, sample_type: str, dtype: str, words: str, encode: Callable[[Array], Array]
) -> None:
    lats, lons, north, west = degrees_grid(LAT, LON, 512)
    pds3(tmp_path, sample_type, dtype, words, encode(heights(lats, lons)), cylindrical(north, west, len(lats)))
    layer = {"elevation_m": {"file": "DEM.IMG", "source": "analytic"}}
    region = build(recipe(LAT, LON, layers=layer), tmp_path)
    expect_agreement(region, expected(region, LAT), 0.03)
    assert region.layers[0].product_id == "ANALYTIC_512"


def test_a_pds3_label_whose_offsets_and_bounds_disagree_is_refused(tmp_path: Path) -> None:
    lats, lons, north, west = degrees_grid(LAT, LON, 512)
    pds3(tmp_path, "PC_REAL", "<f4", "  UNIT = METER", heights(lats, lons), cylindrical(north, west, len(lats)))
    label = tmp_path / "DEM.LBL"
    label.write_text(label.read_text().replace(f"= {north * 512 - 0.5!r} <pix>", f"= {north * 512 + 1.5!r} <pix>"))
    with pytest.raises(InvalidInput, match=r"DEM\.LBL: expected offsets that agree with MAXIMUM_LATITUDE"):
        build(recipe(LAT, LON, layers={"elevation_m": {"file": "DEM.IMG", "source": "x"}}), tmp_path)


@pytest.mark.parametrize("in_the_archives_way", [False, True])
def test_a_pds4_label_leads_to_its_image(tmp_path: Path, in_the_archives_way: bool) -> None:
    """Also to one of the other byte order, behind a header, in scaled integers of kilometres."""
    lats, lons, north, west = degrees_grid(LAT, LON, 512)
    transform, moon = from_origin(west, north, 1 / 512, 1 / 512), "+proj=longlat +R=1737400 +no_defs"
    geotiff(tmp_path / "dem.xml", heights(lats, lons), moon, transform, driver="PDS4", nodata=NO_DATA)
    if in_the_archives_way:
        numbers = np.rint((heights(lats, lons) + 1500) * 100).astype(">i2")
        (tmp_path / "dem.img").write_bytes(b"\x7f" * 100 + numbers.tobytes())
        label = (tmp_path / "dem.xml").read_text()
        for old, new in (
            ('<offset unit="byte">0<', '<offset unit="byte">100<'),
            ("<data_type>IEEE754LSBSingle</data_type>",
             "<data_type>SignedMSB2</data_type><unit>km</unit><scaling_factor>1e-5</scaling_factor>"
             "<value_offset>-1.5</value_offset>"),
            ("<missing_constant>-3.4028226550889045e+38<", "<missing_constant>-32768<"),
        ):  # fmt: skip
            assert old in label
            label = label.replace(old, new)
        (tmp_path / "dem.xml").write_text(label)
    region = build(recipe(LAT, LON, layers={"elevation_m": {"file": "dem.xml", "source": "x"}}), tmp_path)
    expect_agreement(region, expected(region, LAT), 0.03)


@pytest.mark.parametrize(("lon", "raster_lon"), [(LON, LON), (LON - 360, LON), (LON, LON - 360)])
def test_longitudes_of_0_to_360_and_of_minus_180_to_180_are_the_same_places(
    tmp_path: Path, lon: float, raster_lon: float
) -> None:
    lats, lons, north, west = degrees_grid(LAT, raster_lon, 512)
    transform = from_origin(west, north, 1 / 512, 1 / 512)
    geotiff(tmp_path / "dem.tif", heights(lats, lons), "IAU_2015:30100", transform, nodata=NO_DATA)
    region = build(recipe(LAT, lon), tmp_path)
    expect_agreement(region, expected(region, LAT), 0.02)


@pytest.mark.parametrize(("parallel", "south_up"), [(0.0, False), (20.0, False), (20.0, True)])
def test_an_equirectangular_raster_with_a_standard_parallel_is_placed_north_up_or_south_up(
    tmp_path: Path, parallel: float, south_up: bool
) -> None:
    cell, stretch = 20.0, math.cos(math.radians(parallel))
    x0 = math.radians(LON - 180) * R * stretch - 1000 + 3.7
    y0 = math.radians(LAT) * R + 1000 + 8.3
    x, y = x0 + (np.arange(100) + 0.5) * cell, y0 - (np.arange(100) + 0.5) * cell
    lats, lons = np.meshgrid(np.degrees(y / R), 180 + np.degrees(x / (R * stretch)), indexing="ij")
    transform, values = from_origin(x0, y0, cell, cell), heights(lats, lons)
    if south_up:
        transform, values = rasterio.Affine(cell, 0, x0, 0, cell, y0 - 100 * cell), values[::-1]
    crs = f"+proj=eqc +lat_ts={parallel} +lon_0=180 +R=1737400 +units=m"
    geotiff(tmp_path / "dem.tif", values, crs, transform, nodata=NO_DATA)
    region = build(recipe(LAT, LON), tmp_path)
    expect_agreement(region, expected(region, LAT), 0.01)


def polar_truth(region: Region, pole: float) -> Array:
    """The field at the cells, by the polar stereographic projection of the document, inverted as in Snyder (21)."""
    words = dict(part.lstrip("+").split("=") for part in region.crs.split() if "=" in part)
    assert region.origin_x_m is not None
    assert region.origin_y_m is not None
    x, y = np.meshgrid(region.origin_x_m + region.grid.x_m, region.origin_y_m + region.grid.y_m)
    lats = pole * (90 - 2 * np.degrees(np.arctan(np.hypot(x, y) / (2 * R * float(words["k_0"])))))
    return heights(lats, float(words["lon_0"]) + np.degrees(np.arctan2(x, -pole * y)))


@pytest.mark.parametrize(
    ("lat", "lon", "pole"), [(-89.45, 222.7, -1.0), (-88.0, -179.99, -1.0), (-90.0, 0.0, -1.0), (89.999, 12.0, 1.0)]
)
def test_a_polar_stereographic_raster_is_placed_near_its_pole_and_over_it(
    tmp_path: Path, lat: float, lon: float, pole: float
) -> None:
    rho = 2 * R * math.tan(math.radians(90 - abs(lat)) / 2)
    cell = 20.0
    x0 = math.floor(rho * math.sin(math.radians(lon)) / cell) * cell - 50 * cell
    y0 = math.floor(-pole * rho * math.cos(math.radians(lon)) / cell) * cell + 50 * cell
    x, y = np.meshgrid(x0 + (np.arange(100) + 0.5) * cell, y0 - (np.arange(100) + 0.5) * cell)
    lats = pole * (90 - 2 * np.degrees(np.arctan(np.hypot(x, y) / (2 * R))))
    values = heights(lats, np.degrees(np.arctan2(x, -pole * y)))
    crs = f"+proj=stere +lat_0={90 * pole} +lon_0=0 +k=1 +R=1737400 +units=m"
    geotiff(tmp_path / "dem.tif", values, crs, from_origin(x0, y0, cell, cell), nodata=NO_DATA)
    region = build(recipe(lat, lon), tmp_path)
    expect_agreement(region, polar_truth(region, pole), 0.01)
    across = abs(lat) > 89.99
    assert (region.origin_lat_deg is None) == across
    if not across:  # the corner's meridian is the site's north
        assert region.origin_x_m == pytest.approx(0.0, abs=1e-3)


def test_a_pds3_image_of_the_south_pole_in_scaled_radii_is_placed_by_its_label(tmp_path: Path) -> None:
    """As LOLA's LDEM_80S_20M: 16 bits, polar stereographic, heights as radii; in finer steps, so that a shift shows."""
    lat, lon, cell = -88.7, 123.4, 20.0
    rho = 2 * R * math.tan(math.radians(90 + lat) / 2)
    x0 = math.floor(rho * math.sin(math.radians(lon)) / cell) * cell - 50 * cell
    y0 = math.floor(rho * math.cos(math.radians(lon)) / cell) * cell + 50 * cell
    x, y = np.meshgrid(x0 + (np.arange(100) + 0.5) * cell, y0 - (np.arange(100) + 0.5) * cell)
    lats = -90 + 2 * np.degrees(np.arctan(np.hypot(x, y) / (2 * R)))
    values = np.rint(heights(lats, np.degrees(np.arctan2(x, y))) / 0.05)
    words = "  UNIT = METER\n  SCALING_FACTOR = 0.05\n  OFFSET = 1737400"
    pds3(tmp_path, "LSB_INTEGER", "<i2", words, values, polar(x0, y0, cell))
    region = build(recipe(lat, lon, layers={"elevation_m": {"file": "DEM.IMG", "source": "analytic"}}), tmp_path)
    expect_agreement(region, polar_truth(region, -1.0), 0.06)


def test_iron_and_maturity_at_the_grid_of_their_mosaics_agree_with_their_fields(tmp_path: Path) -> None:
    """Of 512 pixels a degree, as Kaguya's, below terrain of 20 m; varied by nothing, so that the field is known."""
    plain(tmp_path)
    lats, lons, _, _ = degrees_grid(LAT, LON, 512, 96)
    iron, maturity = 15 + 0.05 * (heights(lats, lons) + 1500), 0.2 + 0.001 * (heights(lats, lons) + 1500)
    plain(tmp_path, iron, 512, name="iron.tif", nodata=NO_DATA)
    plain(tmp_path, maturity, 512, name="maturity.tif", nodata=NO_DATA)
    layers = {"elevation_m": {"file": "dem.tif", "source": "x"}, "iron_wt": {"file": "iron.tif", "source": "FeO"},
              "maturity": {"file": "maturity.tif", "source": "OMAT"}}  # fmt: skip
    chemistry = {"perturbation": 0.0, "solar_wind_flux": 0.5}
    region = build(recipe(LAT, LON, layers=layers, chemistry=chemistry), tmp_path)
    truth = expected(region, LAT) + 1500
    titanium = 10 ** (0.06 * (15 + 0.05 * truth) - 0.54)
    assert np.abs(region.he3_ppb - (0.56 * titanium * 0.5 / (0.2 + 0.001 * truth) + 1.62)).max() < 0.005
    assert {origin.layer: origin.kind for origin in region.layers}["maturity"] == "real"


@pytest.mark.parametrize("lon", [180.0, -179.999])
def test_a_site_on_the_antimeridian_is_read_from_both_ends_of_a_global_mosaic(tmp_path: Path, lon: float) -> None:
    """The grid of the Kaguya mosaics, 512 pixels a degree, of which only the blocks at both ends exist."""
    columns, rows, north = 360 * 512, 64, 10.0
    lat = north - 32.3 / 512
    lats = np.repeat((north - (np.arange(rows) + 0.5) / 512)[:, None], 256, axis=1)
    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", height=rows, width=columns, count=1, dtype="float32", nodata=NO_DATA,
        crs="IAU_2015:30100", transform=from_origin(-180, north, 1 / 512, 1 / 512), tiled=True, blockxsize=64,
        blockysize=64, sparse_ok=True,
    ) as target:  # fmt: skip
        for first in (0, columns - 256):
            lons = np.repeat((-180 + (first + np.arange(256) + 0.5) / 512)[None, :], rows, axis=0)
            window = rasterio.windows.Window(first, 0, 256, rows)
            target.write(heights(lats, lons).astype("float32"), 1, window=window)
    region = build(recipe(lat, lon), tmp_path)
    expect_agreement(region, expected(region, lat), 0.02)


def plain(folder: Path, values: Array | None = None, per_degree: int = 1516, **options: Any) -> Array:
    """Write a raster around (LAT, LON), with pixels of about 20 m by default; return its values."""
    lats, lons, north, west = degrees_grid(LAT, LON, per_degree, 96)
    values = heights(lats, lons) if values is None else values
    transform = from_origin(west, north, 1 / per_degree, 1 / per_degree)
    geotiff(folder / options.pop("name", "dem.tif"), values, "IAU_2015:30100", transform, **options)
    return values


def test_ground_under_many_rocks_is_closed_and_the_rule_says_so(tmp_path: Path) -> None:
    plain(tmp_path)
    rocks = np.full((96, 96), 0.004)
    rocks[:, :48] = 0.2
    plain(tmp_path, rocks, name="rocks.tif")
    document = recipe(LAT, LON)
    document["layers"]["rock_abundance"] = {"file": "rocks.tif", "source": "made"}
    region = build(document, tmp_path)
    open_share = region.traversable.mean(axis=0)
    assert open_share[0] == 0.0
    assert open_share[-1] == 1.0
    rule = next(origin.source for origin in region.layers if origin.layer == "traversable")
    assert "rock abundance of at most 0.05 (" in rule
    assert build(document | {"rock_limit": 0.5}, tmp_path).traversable.all()
    plain(tmp_path, 50.0 * rocks, name="rocks.tif")
    with pytest.raises(InvalidInput, match=r"layer rock_abundance: expected -0\.2 to 1\.2, got"):
        build(document, tmp_path)


def test_the_rule_of_the_paper_can_be_asked_for(tmp_path: Path) -> None:
    plain(tmp_path)
    region = build(recipe(LAT, LON, terrain_rule="paper"), tmp_path)
    rule = next(origin.source for origin in region.layers if origin.layer == "traversable")
    assert rule == "slope of at most 30 deg in the site and in its raster, and relief"
    assert region.traversable.sum() < build(recipe(LAT, LON), tmp_path).traversable.sum()


@pytest.mark.parametrize("missing", [NO_DATA, math.nan, -math.inf, -32768.0, 0.0])
def test_a_hole_is_refused_with_its_place_or_filled_and_marked(tmp_path: Path, missing: float) -> None:
    values = plain(tmp_path, nodata=NO_DATA)
    values[46:49, 47:50] = missing
    plain(tmp_path, values, nodata=NO_DATA)
    layer: dict[str, Any] = {"file": "dem.tif", "source": "x", "no_data": [-32768.0], "zero_is_missing": True}
    with pytest.raises(InvalidInput, match=r"dem\.tif: layer elevation_m: expected values everywhere in the site"):
        build(recipe(LAT, LON, layers={"elevation_m": layer}), tmp_path)
    region = build(recipe(LAT, LON, layers={"elevation_m": layer | {"fill_holes": True}}), tmp_path)
    assert np.abs(region.elevation_m - expected(region, LAT)).max() < 10
    document = read_document(tmp_path / "out")
    assert "filled" in document.layers
    assert "of it filled" in document.layers["elevation_m"].source


def test_a_hole_that_is_masked_has_no_reference_is_closed_and_says_so(tmp_path: Path) -> None:
    plain(tmp_path)
    field = np.full((96, 96), 8.0) + 0.01 * np.arange(96)
    field[46:49, 47:50] = np.nan
    plain(tmp_path, field, name="field.tif")
    rocks = np.full((96, 96), 0.004)
    rocks[:, :48] = np.nan
    plain(tmp_path, rocks, name="rocks.tif")
    document = recipe(LAT, LON)
    document["layers"] |= {
        name: {"file": f"{file}.tif", "source": "made", "mask_holes": True}
        for name, file in (("he3_ppb", "field"), ("rock_abundance", "rocks"))
    }
    region = build(document, tmp_path)
    assert region.known is not None
    assert 0.01 < 1.0 - region.known.mean() < 0.1
    assert np.array_equal(region.traversable, region.known)
    assert np.isfinite(region.orbital_ppb).all()
    layers = read_document(tmp_path / "out").layers
    assert "of it not known" in layers["he3_ppb"].source
    assert "filled" not in layers
    document["layers"]["elevation_m"] = document["layers"]["elevation_m"] | {"mask_holes": True}
    with pytest.raises(InvalidInput, match="expected heights everywhere, got mask_holes of layer elevation_m"):
        build(document, tmp_path)


@pytest.mark.parametrize(
    ("layer", "level", "wrong", "said"),
    [
        (
            "he3_ppb",
            5.0,
            -999.0,
            r"expected values as the others, .* got -999, which marks missing values, in 25 cells",
        ),
        ("he3_ppb", 5.0, -7.0, r"expected -1 to 1e\+06 ppb, got -7 in 25 cells"),
        ("titanium_wt", 3.0, -99.0, r"expected values as the others, .* got -99, which marks missing values"),
        ("titanium_wt", 3.0, 255.0, r"expected -1 to 35 wt %, got 255 in 25 cells"),
        ("iron_wt", 14.0, 255.0, r"expected 0 to 40 wt %, got 255 in 25 cells"),
        ("maturity", 0.2, 255.0, r"expected 0 to 2, got 255 in 25 cells"),
        ("elevation_m", -2600.0, -999.0, r"expected values as the others, .* got -999, which marks missing values"),
        ("elevation_m", -2600.0, 20000.0, r"expected -9500 to 11000 m, got 20000 in 25 cells"),
    ],
)
@pytest.mark.parametrize("cell_m", [1.0, 20.0])
def test_a_number_that_no_ground_has_is_refused_as_the_raster_has_it_and_not_smeared_by_resampling(
    tmp_path: Path, cell_m: float, layer: str, level: float, wrong: float, said: str
) -> None:
    document = chemistry_of_levels(tmp_path, resolution_m=cell_m)
    values = level * (1.0 + 0.001 * np.arange(96)) + np.zeros((96, 1))
    values[46:51, 46:51] = wrong
    plain(tmp_path, values, name=f"{layer}.tif")
    document["layers"] = measured_with(document["layers"], layer)
    with pytest.raises(InvalidInput, match=rf"{layer}\.tif: layer {layer}: {said}") as refusal:
        build(document, tmp_path)
    assert "no_data" in str(refusal.value)
    document["layers"][layer] |= {"no_data": [wrong], "fill_holes": True}
    assert build(document, tmp_path).he3_ppb.min() > 0.0


@pytest.mark.parametrize(
    ("layer", "factor", "unit", "said"),
    [
        ("iron_wt", 100.0, None, r"expected 0 to 40 wt %, got 1[34]\d\d"),
        ("iron_wt", 1.0, "fraction", r"expected 0 to 40 wt %, got 1[34]\d\d"),
        ("iron_wt", 0.01, None, r'expected FeO in wt %, got at most 0\.14: give unit = "fraction" or "wt%"'),
        ("titanium_wt", 100.0, None, r"expected -1 to 35 wt %, got 3\d\d"),
        ("he3_ppb", 0.001, None, r'expected helium-3 in ppb, got at most 0\.005: give unit = "ppm" or "ppb"'),
        ("maturity", 100.0, None, r"expected 0 to 2, got 2\d"),
        (
            "radius_km",
            1.0,
            None,
            r'expected heights in m, got 1734\.\d+ to 1734\.\d+, as radii in km: give unit = "km"',
        ),
    ],
)
def test_values_in_another_unit_are_refused(
    tmp_path: Path, layer: str, factor: float, unit: str | None, said: str
) -> None:
    document = chemistry_of_levels(tmp_path)
    levels = {"iron_wt": 14.0, "titanium_wt": 3.0, "maturity": 0.2, "he3_ppb": 5.0, "radius_km": 1734.8}
    values = levels[layer] * (1.0 + 1e-6 * np.arange(96)) + np.zeros((96, 1))
    layer = {"radius_km": "elevation_m"}.get(layer, layer)
    plain(tmp_path, factor * values, name=f"{layer}.tif")
    document["layers"] = measured_with(document["layers"], layer)
    document["layers"][layer] |= {} if unit is None else {"unit": unit}
    with pytest.raises(InvalidInput, match=rf"{layer}\.tif: layer {layer}: {said}"):
        build(document, tmp_path)


def chemistry_of_levels(folder: Path, **changes: Any) -> dict[str, Any]:
    """A recipe with rasters of FeO, TiO2, OMAT, helium-3 and height that hardly vary."""
    levels = {"iron_wt": 14.0, "titanium_wt": 3.0, "maturity": 0.2, "he3_ppb": 5.0, "elevation_m": -2600.0}
    for name, level in levels.items():
        plain(folder, level * (1.0 + 0.001 * np.arange(96)) + np.zeros((96, 1)), name=f"{name}.tif")
    layers = {name: {"file": f"{name}.tif", "source": "made"} for name in levels}
    return recipe(LAT, LON, layers=layers, chemistry={"solar_wind_flux": 0.5}, slope_limit_deg=45.0) | changes


def measured_with(layers: dict[str, Any], layer: str) -> dict[str, Any]:
    """Those of the layers that a region with that one is computed from."""
    chosen = {"elevation_m", layer} | ({"maturity", "iron_wt"} if layer != "he3_ppb" else set())
    return {name: dict(table) for name, table in layers.items() if name in chosen}


@pytest.mark.parametrize("how", ["inside", "beside", "alpha"])
def test_pixels_that_a_mask_or_an_alpha_band_hides_are_missing(tmp_path: Path, how: str) -> None:
    document = chemistry_of_levels(tmp_path)
    document["layers"] = measured_with(document["layers"], "he3_ppb")
    shown = np.full((96, 96), 255, dtype=np.uint8)
    shown[46:49, 47:50] = 0
    with rasterio.open(tmp_path / "he3_ppb.tif") as whole:
        values, profile = whole.read(1), whole.profile
    values[shown == 0] = 0.0
    if how == "alpha":
        profile |= {"count": 2, "alpha": "yes"}
        document["layers"]["he3_ppb"]["band"] = 1
    (tmp_path / "he3_ppb.tif").unlink()
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=how == "inside"),
        rasterio.open(tmp_path / "he3_ppb.tif", "w", **profile) as target,
    ):
        target.write(values, 1)
        if how == "alpha":
            target.write(shown.astype("float32"), 2)
        else:
            target.write_mask(shown)
    assert (tmp_path / "he3_ppb.tif.msk").exists() == (how == "beside")
    with pytest.raises(InvalidInput, match=r"layer he3_ppb: expected values everywhere in the site, got missing ones"):
        build(document, tmp_path)
    document["layers"]["he3_ppb"]["fill_holes"] = True
    assert build(document, tmp_path).he3_ppb.min() > 4.9


@pytest.mark.parametrize("offset", [(60, 0), (0, 60), (-60, 0), (0, -60)])
def test_ground_beyond_the_edge_of_a_raster_is_not_invented(tmp_path: Path, offset: tuple[int, int]) -> None:
    plain(tmp_path)
    lat, lon = LAT + offset[0] / 1516, LON + offset[1] / 1516
    with pytest.raises(InvalidInput, match="expected a raster that surrounds the site"):
        build(recipe(lat, lon), tmp_path)


def test_cells_larger_than_pixels_are_means_of_them(tmp_path: Path) -> None:
    values = plain(tmp_path, per_degree=6064)
    plain(tmp_path, values + np.where(np.indices(values.shape).sum(axis=0) % 2 == 0, 3.0, -3.0), per_degree=6064)
    region = build(recipe(LAT, LON, rows=10, columns=10, resolution_m=10.0, slope_limit_deg=45.0), tmp_path)
    assert np.abs(region.elevation_m - expected(region, LAT)).max() < 0.05


def test_ground_that_is_steep_in_the_raster_is_closed_although_the_site_is_smooth(tmp_path: Path) -> None:
    """A single high pixel: averaged cells do not show it, the raster's own slope does."""
    values = np.zeros((96, 96))
    values[48, 48] = 6.0
    plain(tmp_path, values, per_degree=6064)
    region = build(recipe(LAT, LON, rows=12, columns=12, resolution_m=10.0, slope_limit_deg=15.0), tmp_path)
    assert region.slope_deg.max() < 10.0
    assert 1 <= (~region.traversable).sum() <= 9


def test_chemistry_of_another_resolution_is_measured_where_it_can_be_and_named_where_it_is_assumed(
    tmp_path: Path,
) -> None:
    plain(tmp_path)
    iron = plain(tmp_path, np.linspace(12, 18, 96 * 96).reshape(96, 96), 512, name="iron.tif", nodata=NO_DATA)
    layers = {"elevation_m": {"file": "dem.tif", "source": "x"}, "iron_wt": {"file": "iron.tif", "source": "FeO"}}
    chemistry = {"assumed_maturity": 0.2, "perturbation": 0.0, "solar_wind_flux": 0.5}
    region = build(recipe(LAT, LON, layers=layers, chemistry=chemistry), tmp_path)
    middle = 0.56 * 10 ** (0.06 * iron[48, 48] - 0.54) * 0.5 / 0.2 + 1.62
    assert region.he3_ppb.mean() == pytest.approx(middle, rel=0.01)
    assert "ASSUMED maturity (OMAT 0.2 everywhere, not measured here)" in region.provenance
    other = chemistry | {"titanium": "apollo-17-soils"}
    assert build(recipe(LAT, LON, layers=layers, chemistry=other), tmp_path).he3_ppb.mean() > 1.5 * middle
    measured = layers | {"titanium_wt": {"file": "iron.tif", "source": "TiO2", "scale": 0.1}}
    region = build(recipe(LAT, LON, layers=measured, chemistry=chemistry), tmp_path)
    assert region.he3_ppb.mean() == pytest.approx(0.56 * 0.1 * iron[48, 48] * 0.5 / 0.2 + 1.62, rel=0.01)


@pytest.mark.parametrize("cell", [0.3, 1.0, 1.3, 2.7])
@pytest.mark.parametrize("shift", [0.0, 0.5, -0.2])
def test_the_slope_of_a_cell_is_the_steepest_of_all_pixels_that_it_touches(cell: float, shift: float) -> None:
    """Cells of that many pixels, their centres shifted against those of the pixels; compared one by one."""
    heights = np.random.default_rng(0).uniform(0, 3, (40, 40))
    slopes = slope_deg(heights, 5.0)
    centres = np.arange(int(24 / cell)) * cell + 8 + shift
    touched = [
        slice(math.floor(at - cell / 2 + 0.5 + 1e-5), math.ceil(at + cell / 2 - 0.5 - 1e-5) + 1) for at in centres
    ]
    expected = [[slopes[down, across].max() for across in touched] for down in touched]
    rows, columns = np.meshgrid(centres, centres, indexing="ij")
    assert np.array_equal(source_slopes(heights, (5.0, 5.0), rows, columns), expected)


def test_the_map_from_orbit_does_not_hold_the_field_that_a_rover_is_to_find(tmp_path: Path) -> None:
    """A field given as finished values, and FeO in pixels as small as the cells: rough ones, which an orbiter blurs."""
    plain(tmp_path)
    plain(tmp_path, np.random.default_rng(4).uniform(12, 18, (96, 96)), name="rough.tif")
    terrain, given = {"file": "dem.tif", "source": "x"}, {"file": "rough.tif", "source": "x"}
    chemistry = {"assumed_maturity": 0.2, "solar_wind_flux": 0.5}
    for layer, table in (("he3_ppb", {}), ("iron_wt", chemistry)):
        layers = {"elevation_m": terrain, layer: given}
        region = build(
            recipe(LAT, LON, layers=layers, chemistry=table, resolution_m=20.0, rows=40, columns=40), tmp_path
        )
        assert np.corrcoef(region.orbital_ppb.ravel(), region.he3_ppb.ravel())[0, 1] < 0.6
        assert {origin.layer: origin.source for origin in region.layers}["orbital_ppb"].startswith("he3_ppb in means")


def test_a_stand_ins_chemistry_is_named_as_one(tmp_path: Path) -> None:
    plain(tmp_path)
    region = build(recipe(LAT, LON), tmp_path)
    assert "SYNTHETIC iron_wt (of the stand-in t1, laid over this place, not measured here)" in region.provenance
    assert {origin.layer: origin.kind for origin in region.layers}["elevation_m"] == "real"


@pytest.mark.parametrize("kind", TEMPLATES)
def test_every_template_is_a_valid_recipe(tmp_path: Path, kind: str) -> None:
    (tmp_path / "r.toml").write_text(TEMPLATES[kind])
    assert checked(Recipe, load_toml(tmp_path / "r.toml"), tmp_path).layers


def source(**changes: Any) -> dict[str, Any]:
    return {"layers": {"elevation_m": {"file": "dem.tif", "source": "b"} | changes}}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"version": 2}, "version"),
        ({"colour": "red"}, "colour"),
        ({"centre_lat_deg": 91.0}, "centre_lat_deg"),
        ({"rows": 2001, "columns": 2000}, "expected at most 4000000 cells, got 2001 x 2000"),
        ({"resolution_m": 1000.0, "rows": 101}, "expected a site of at most 100 km on a side, got 101 km"),
        ({"layers": {"iron_wt": {"file": "a", "source": "b"}}}, "expected a layer elevation_m"),
        ({"chemistry": {}}, "chemistry.lay_over"),
        (source(file="none.tif"), "none.tif: expected a raster, got no such file"),
        (source(band="x"), "expected one band named 'x'"),
        (source(band=2), "expected a band of 1 to 1, got 2"),
        (source(unit="ppb"), 'expected unit "m" or "km", got \'ppb\''),
        ({"projection": "nonsense"}, "expected a projection, got 'nonsense'"),
        ({"projection": "IAU_2015:30110"}, "expected metres of the ground"),
        ({"slope_limit_deg": 0.001}, "got none by the rule: slope of at most 0.001 deg"),
    ],
)
def test_a_wrong_recipe_is_refused_in_one_line_and_nothing_is_written(
    tmp_path: Path, changes: dict[str, Any], said: str
) -> None:
    plain(tmp_path)
    with pytest.raises(InvalidInput) as caught:
        build(recipe(LAT, LON) | changes, tmp_path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_region_that_cannot_be_written_leaves_the_earlier_one_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from services.mission.region_build import writing

    plain(tmp_path)
    build(recipe(LAT, LON, rows=20, columns=20), tmp_path)
    (tmp_path / "out" / "notes.txt").write_text("mine")
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    written = writing.write_raster

    def full_after_the_first(path: Path, *arguments: Any) -> None:
        if path.name != "he3_ppb.tif":
            raise OSError(28, "No space left on device")
        written(path, *arguments)

    monkeypatch.setattr(writing, "write_raster", full_after_the_first)
    with pytest.raises(He3Error, match="out: cannot write the region: No space left on device"):
        build(recipe(LAT, LON, rows=20, columns=30), tmp_path)
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_a_raster_of_another_planet_is_refused(tmp_path: Path) -> None:
    lats, lons, north, west = degrees_grid(LAT, LON, 1516, 96)
    transform, mars = from_origin(west, north, 1 / 1516, 1 / 1516), "+proj=longlat +R=3396190 +no_defs"
    geotiff(tmp_path / "dem.tif", heights(lats, lons), mars, transform)
    with pytest.raises(InvalidInput, match="expected a raster of the Moon"):
        build(recipe(LAT, LON), tmp_path)


def test_a_raster_on_an_ellipsoid_is_refused_and_one_on_another_lunar_sphere_is_taken(tmp_path: Path) -> None:
    """PROJ takes its latitudes for those of the sphere, 2 km off at 45 deg."""
    lats, lons, north, west = degrees_grid(LAT, LON, 1516, 96)
    transform = from_origin(west, north, 1 / 1516, 1 / 1516)
    geotiff(tmp_path / "dem.tif", heights(lats, lons), "+proj=longlat +a=1738100 +b=1736000 +no_defs", transform)
    with pytest.raises(
        InvalidInput, match=r"expected latitudes on a sphere, .* got an ellipsoid of 1738100 x 1736000 m"
    ):
        build(recipe(LAT, LON), tmp_path)
    geotiff(tmp_path / "dem.tif", heights(lats, lons), "+proj=longlat +R=1738100 +no_defs", transform)
    region = build(recipe(LAT, LON), tmp_path)
    expect_agreement(region, expected(region, LAT), 0.5)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("version = 1", "version = 3", "version"),
        ('kind = "site"', 'kind = "globe"', "kind"),
        ('file = "he3_ppb.tif"', 'file = "../he3_ppb.tif"', "he3_ppb"),
        (
            'file = "he3_ppb.tif"',
            'file = "other.tif"',
            "other.tif: layer he3_ppb: expected a GeoTIFF, got no such file",
        ),
        ('file = "he3_ppb.tif"', 'file = "elevation_m.tif"', "expected the sha256 of region.toml"),
    ],
)
def test_a_wrong_folder_is_refused_in_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    plain(tmp_path)
    build(recipe(LAT, LON, rows=20, columns=20), tmp_path)
    document = tmp_path / "out" / "region.toml"
    document.write_text(document.read_text().replace(old, new))
    with pytest.raises(InvalidInput) as caught:
        load_region(tmp_path / "out")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_without_the_extra_a_region_is_read_and_building_one_names_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain(tmp_path)
    built = build(recipe(LAT, LON), tmp_path)
    for name in ("rasterio", "pyproj"):
        monkeypatch.setitem(sys.modules, name, None)  # an import of it fails, as if it were not installed
    assert np.array_equal(load_region(tmp_path / "out").he3_ppb, built.he3_ppb)
    assert load_region("t1").layers[0].kind == "synthetic"
    with pytest.raises(He3Error, match=r"^expected pyproj, which is not installed: pip install he3-seeker\[geo\]$"):
        build(recipe(LAT, LON), tmp_path)


@pytest.mark.exhaustive
def test_a_window_of_1_km_of_a_sparse_mosaic_of_3_gb_is_built_in_seconds_with_little_memory() -> None:
    """In a process of its own; held to processor time here, as other processes share the machine of a test."""
    from benchmarks.mosaic import run

    row = run(say=lambda line: None)
    assert row["mosaic_bytes"] > 3e9
    assert row["largest_error_m"] < 0.02
    assert row["peak_mb"] < 500
    assert row["processor_s"] < 5
