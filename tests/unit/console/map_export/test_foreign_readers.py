"""Exported maps, read by the libraries of others: position, values, statistics, units, attributes as they are meant."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from he3.constants import MOON_RADIUS_M as R
from he3.frames import SiteGrid
from schemas.ground import InterestArea, KeepOutArea, MissionTrack
from schemas.maps import MapLayer, MapRegion, RegionLayer
from schemas.telemetry import SampleReport
from services.console.map_export.catalogue import tags_of
from services.console.map_export.contents import MapContents, RasterLayer, belief_layer
from services.console.map_export.folder import Exported, export_folder
from services.console.map_export.placement import placed
from services.console.map_export.rasters import geotiff

rasterio = pytest.importorskip("rasterio")
pyproj = pytest.importorskip("pyproj")
pyogrio = pytest.importorskip("pyogrio")
pystac = pytest.importorskip("pystac")

GEOGRAPHIC = "IAU_2015:30100"
ORIGIN = (20.19, 30.772)
NS = 10**9


def region(rows: int, columns: int, cell_m: float, **place: Any) -> MapRegion:
    document: dict[str, Any] = {
        "name": "place", "title": "A place", "location": "/nowhere", "field_seed": None,
        "provenance": "REAL elevation_m; ASSUMED maturity", "rows": rows, "columns": columns, "resolution_m": cell_m,
        "origin_lat_deg": None, "origin_lon_deg": None, "crs": "", "origin_x_m": None, "origin_y_m": None,
        "layers": (RegionLayer(layer="elevation_m", kind="real", source="LROC NAC", product_id="NAC_DTM_X"),),
    }  # fmt: skip
    return MapRegion(**document | place)


def sample(number: int, x: float, y: float) -> SampleReport:
    return SampleReport(
        sample_id=f"s-{number}", round=1, plan_revision=1, x_m=x, y_m=y, depth_m=0.1, helium3_ppb=8.0 + number,
        noise_std_ppb=0.1, measured_at=1_893_456_000 * NS + number, driven_m=12.5,
    )  # fmt: skip


def contents(account: MapRegion, **changes: Any) -> MapContents:
    """A map whose every cell has another value."""
    cells = account.rows * account.columns
    values = np.random.default_rng(cells).permutation(cells).astype(np.float32).reshape(account.rows, account.columns)
    width, height = account.columns * account.resolution_m, account.rows * account.resolution_m
    layers: list[RasterLayer] = []
    for layer, array, unit in (
        (MapLayer.MEAN, values, "ppb"),
        (MapLayer.TRAVERSABLE, (values > 1).astype(np.uint8), "1"),
    ):
        layers.append(belief_layer(layer, array, unit, 2, account, None))
    corner = ((0.2 * width, 0.2 * height), (0.6 * width, 0.2 * height), (0.4 * width, 0.7 * height))
    track = MissionTrack(
        samples=(sample(1, 0.25 * width, 0.5 * height), sample(2, 0.75 * width, 0.125 * height)),
        driven_path_m=((0.0, 0.0), (0.5 * width, 0.5 * height), (width, height)), planned_path_m=(), score_history=(),
        keep_outs=(KeepOutArea(area_id="steep", polygon_m=corner),),
        interests=(InterestArea(area_id="rich", polygon_m=corner, weight=2.5),),
    )  # fmt: skip
    document: dict[str, Any] = {
        "mission": "t1", "region": account, "revision": 17, "mission_time_ns": 1_893_456_000 * NS,
        "layers": tuple(layers), "track": track,
    }  # fmt: skip
    return MapContents(**document | changes)


def exported(what: MapContents, folder: Path, **options: Any) -> Exported:
    with export_folder(folder) as target:
        return target.write(what, **options)


def degrees_of(account: MapRegion, x: float, y: float) -> tuple[float, float]:
    """Longitude and latitude [deg] of a place of a region that has an origin, by the formulas written out."""
    assert account.origin_lat_deg is not None
    assert account.origin_lon_deg is not None
    lat, lon = math.radians(account.origin_lat_deg), math.radians(account.origin_lon_deg)
    middle = lat + account.rows * account.resolution_m / 2 / R
    if abs(math.degrees(middle)) <= 65:
        return math.degrees(lon + x / (R * math.cos(middle))), math.degrees(lat + y / R)
    sign = math.copysign(1.0, middle)
    scale = 2 / (1 + math.sin(min(abs(middle), math.pi / 2)))
    east, north = x * scale, y * scale - sign * 2 * R * math.tan((math.pi / 2 - sign * lat) / 2)
    colatitude = 2 * math.atan(math.hypot(east, north) / (2 * R))
    return math.degrees(lon + math.atan2(east, -sign * north)), sign * (90 - math.degrees(colatitude))


def values_at(raster: Any, longitude: float, latitude: float) -> Any:
    """The raster's value at that place of the Moon, as GDAL and PROJ find it."""
    to_raster = pyproj.Transformer.from_crs(GEOGRAPHIC, raster.crs.to_wkt(), always_xy=True)
    return next(iter(raster.sample([to_raster.transform(longitude, latitude)])))[0]


sites = st.tuples(st.integers(1, 40), st.integers(1, 40), st.sampled_from([0.01, 0.1, 0.3, 1.0, 7.3, 1000.0]))
origins = st.tuples(st.floats(-89.0, 89.0), st.floats(-180.0, 180.0))


@settings(max_examples=25)
@given(sites, origins, st.data())
def test_every_raster_has_the_maps_value_at_every_place_of_the_moon(
    site: tuple[int, int, float], origin: tuple[float, float], data: st.DataObject
) -> None:
    account = region(*site, origin_lat_deg=origin[0], origin_lon_deg=origin[1])
    what = contents(account)
    row, column = data.draw(st.integers(0, account.rows - 1)), data.draw(st.integers(0, account.columns - 1))
    # Anywhere in the cell but at its very edge: half a pixel off would be another cell.
    share = data.draw(st.tuples(*[st.floats(0.02, 0.98)] * 2))
    place = (column + share[0]) * account.resolution_m, (row + share[1]) * account.resolution_m
    for layer in what.layers:
        written = geotiff(layer, placed(account), what.grid, tags_of(what, layer))
        with rasterio.io.MemoryFile(written) as memory, memory.open() as raster:
            assert values_at(raster, *degrees_of(account, *place)) == layer.values[row, column]
            assert raster.read(1)[account.rows - 1 - row, column] == layer.values[row, column]


@pytest.mark.parametrize(
    "crs",
    [
        "+proj=eqc +lat_ts=20.2 +lat_0=0 +lon_0=30.78 +R=1737400 +units=m",
        "+proj=stere +lat_0=-90 +lon_0=12 +k_0=0.997 +x_0=0 +y_0=0 +R=1737400 +units=m",
        "+proj=tmerc +lat_0=26 +lon_0=3.5 +R=1737400 +units=m",
        "IAU_2015:30135",
    ],
)
def test_a_region_with_a_projection_of_its_own_is_exported_in_it(crs: str, tmp_path: Path) -> None:
    own = pyproj.CRS.from_user_input(crs)
    x0, y0 = pyproj.Transformer.from_crs(GEOGRAPHIC, own, always_xy=True).transform(
        *{"s": (14.0, -88.0), "e": ORIGIN[::-1], "t": (3.7, 26.1), "I": (14.0, -88.0)}[crs.removeprefix("+proj=")[0]]
    )
    what = contents(region(30, 40, 2.0, crs=crs, origin_x_m=x0, origin_y_m=y0))
    exported(what, tmp_path / "out")
    with rasterio.open(tmp_path / "out" / "mean.tif") as raster:
        assert raster.transform.almost_equals(rasterio.Affine(2.0, 0, x0, 0, -2.0, y0 + 60.0))
        found = pyproj.CRS.from_user_input(raster.crs)
        assert found.geodetic_crs.name == pyproj.CRS.from_user_input(GEOGRAPHIC).name
        assert (found.ellipsoid.semi_major_metre, found.ellipsoid.inverse_flattening) == (R, 0.0)
        back = pyproj.Transformer.from_crs(own, GEOGRAPHIC, always_xy=True)
        for row, column in ((0, 0), (29, 39), (3, 30)):
            where = back.transform(x0 + (column + 0.5) * 2.0, y0 + (row + 0.5) * 2.0)
            assert values_at(raster, *where) == what.layers[0].values[row, column]


@pytest.mark.parametrize("site", [(12, 9, 1.0), (500, 500, 1.0), (257, 700, 2.0)])
def test_every_raster_is_a_valid_cloud_optimised_geotiff_with_overviews(
    site: tuple[int, int, float], tmp_path: Path
) -> None:
    cogeo = pytest.importorskip("rio_cogeo")
    what = contents(region(*site, origin_lat_deg=ORIGIN[0], origin_lon_deg=ORIGIN[1]))
    exported(what, tmp_path / "out")
    rasters = sorted((tmp_path / "out").glob("*.tif"))
    assert len(rasters) == len(what.layers)
    for path in rasters:
        assert cogeo.cog_validate(path, strict=True) == (True, [], [])
        with rasterio.open(path) as raster:
            assert bool(raster.overviews(1)) == (max(site[:2]) > 256)


def test_a_raster_says_what_it_is_and_where_it_comes_from(tmp_path: Path) -> None:
    what = contents(region(30, 40, 2.0, origin_lat_deg=ORIGIN[0], origin_lon_deg=ORIGIN[1]), simulated=True)
    exported(what, tmp_path / "out")
    mean = what.layers[0].values.astype(np.float64)
    with rasterio.open(tmp_path / "out" / "mean.tif") as raster:
        assert (raster.units, raster.descriptions) == (("ppb",), ("helium-3, posterior mean",))
        assert (raster.dtypes, raster.nodata) == (("float32",), -3.4028226550889045e38)
        band, tags = raster.tags(1), raster.tags()
        found = [float(band[f"STATISTICS_{name}"]) for name in ("MINIMUM", "MAXIMUM", "MEAN", "STDDEV")]
        assert found == pytest.approx([mean.min(), mean.max(), mean.mean(), mean.std()])
        assert (tags["MISSION"], tags["REVISION"], tags["SAMPLES"]) == ("t1", "17", "2")
        assert tags["MISSION_TIME"] == "2030-01-01T00:00:00Z"
        assert tags["MEASUREMENTS"] == "All measurements are simulated."
        assert (tags["PROVENANCE_KIND"], tags["REGION_LAYER_ELEVATION_M"]) == ("derived", "real: LROC NAC")
        assert tags["PROVENANCE"].startswith("Gaussian process over 2 samples")
    with rasterio.open(tmp_path / "out" / "traversable.tif") as raster:
        assert (raster.nodata, raster.tags(1)["CLASSES"]) == (None, "0: closed; 1: open")
        colours = raster.colormap(1)
        assert (colours[0], colours[1]) == ((0x5B, 0x2C, 0x2C, 255), (0xD9, 0xD4, 0xC7, 255))


def printed_by(*command: str | Path) -> str:
    return subprocess.run(list(map(str, command)), capture_output=True, text=True, check=True, timeout=120).stdout


def test_gdals_own_programs_read_what_is_meant(tmp_path: Path) -> None:
    if shutil.which("gdalinfo") is None:
        pytest.skip("gdalinfo is not installed (Debian: gdal-bin)")
    account = region(30, 40, 2.0, origin_lat_deg=ORIGIN[0], origin_lon_deg=ORIGIN[1])
    what = contents(account)
    exported(what, tmp_path / "out")
    mean = what.layers[0].values.astype(np.float64)
    found = json.loads(printed_by("gdalinfo", "-json", tmp_path / "out" / "mean.tif"))
    band = found["bands"][0]
    assert (found["size"], band["unit"], band["noDataValue"]) == (
        [40, 30],
        "ppb",
        pytest.approx(-3.4028226550889045e38),
    )
    statistics = [float(band["metadata"][""][f"STATISTICS_{name}"]) for name in ("MINIMUM", "MAXIMUM", "MEAN")]
    assert statistics == pytest.approx([mean.min(), mean.max(), mean.mean()])
    (x0, width, _, y0, _, height) = found["geoTransform"]
    assert (width, height) == (2.0, -2.0)
    assert "1737400" in found["coordinateSystem"]["wkt"]
    value = printed_by("gdallocationinfo", "-valonly", "-geoloc", tmp_path / "out" / "mean.tif", x0 + 21.0, y0 - 51.0)
    assert float(value) == mean[4, 10]
    layers = printed_by("ogrinfo", "-so", "-al", tmp_path / "out" / "map.gpkg")
    assert "Layer name: samples" in layers
    assert "Feature Count: 2" in layers


def test_qgis_reads_what_is_meant(tmp_path: Path) -> None:
    """By QGIS's own library, in an interpreter that has it."""
    python = os.environ.get("HE3_QGIS_PYTHON", "/usr/bin/python3")
    try:
        printed_by(python, "-c", "import qgis.core")
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("QGIS is not installed (Debian: qgis; HE3_QGIS_PYTHON names an interpreter that has it)")
    account = region(30, 40, 2.0, origin_lat_deg=ORIGIN[0], origin_lon_deg=ORIGIN[1])
    what = contents(account)
    exported(what, tmp_path / "out")
    place = degrees_of(account, 21.0, 9.0)
    found = json.loads(printed_by(python, Path(__file__).with_name("qgis_reader.py"), tmp_path / "out", *place))
    for layer in what.layers:
        raster, values = found["rasters"][layer.name], layer.values.astype(np.float64)
        assert raster["valid"]
        assert raster["size"] == [30, 40]
        assert raster["extent_m"][2] - raster["extent_m"][0] == pytest.approx(80.0)
        assert raster["value"] == values[4, 10]
        assert raster["statistics"] == pytest.approx(
            [values.min(), values.max(), values.mean(), values.std()], rel=1e-3
        )
        assert raster["style"]
    assert found["rasters"]["mean"]["renderer"] == "singlebandpseudocolor"
    samples = found["vectors"]["samples"]
    assert all(each["valid"] for each in found["vectors"].values())
    assert samples["fields"]["helium3_ppb"] == [9.0, 10.0]
    for index, report in enumerate(what.track.samples):
        where = degrees_of(account, report.x_m, report.y_m)
        assert samples["first_vertices_deg"][index] == pytest.approx(where, abs=1e-9)


def test_a_geopackage_has_samples_paths_and_areas_in_the_projection_of_the_rasters(tmp_path: Path) -> None:
    account = region(30, 40, 2.0, origin_lat_deg=ORIGIN[0], origin_lon_deg=ORIGIN[1])
    what = contents(account)
    exported(what, tmp_path / "out")
    package = tmp_path / "out" / "map.gpkg"
    shapes = {"samples": ("Point", 2), "driven_path": ("LineString", 1), "planned_path": ("LineString", 0),
              "keep_outs": ("Polygon", 1), "interest_areas": ("Polygon", 1), "site": ("Polygon", 1)}  # fmt: skip
    assert dict(pyogrio.list_layers(package)) == {name: shape for name, (shape, _) in shapes.items()}
    with rasterio.open(tmp_path / "out" / "mean.tif") as raster:
        raster_crs = pyproj.CRS.from_user_input(raster.crs)
    for name, (shape, count) in shapes.items():
        found = pyogrio.read_info(package, layer=name)
        assert (found["geometry_type"], found["features"]) == (shape, count), name
        assert pyproj.CRS.from_user_input(found["crs"]) == raster_crs
    meta, _, geometry, columns = pyogrio.raw.read(package, layer="samples")
    table = dict(zip(meta["fields"], columns, strict=True))
    assert table["sample_id"].tolist() == ["s-1", "s-2"]
    assert table["helium3_ppb"].tolist() == [9.0, 10.0]
    assert table["measured_at_ns"].tolist() == [each.measured_at for each in what.track.samples]
    back = pyproj.Transformer.from_crs(meta["crs"], GEOGRAPHIC, always_xy=True)
    for index, report in enumerate(what.track.samples):
        where = degrees_of(account, report.x_m, report.y_m)
        assert (table["lon_deg"][index], table["lat_deg"][index]) == pytest.approx(where, abs=1e-9)
        assert back.transform(*np.frombuffer(geometry[index], "<f8", offset=5)) == pytest.approx(where, abs=1e-9)
        assert (table["x_m"][index], table["y_m"][index]) == (report.x_m, report.y_m)
    meta, _, geometry, columns = pyogrio.raw.read(package, layer="interest_areas")
    table = dict(zip(meta["fields"], columns, strict=True))
    assert (table["area_id"][0], table["weight"][0], table["site_m"][0]) == ("rich", 2.5, "16 12, 48 12, 32 42")
    ring = np.frombuffer(geometry[0], "<f8", offset=13).reshape(-1, 2)
    assert ring[0].tolist() == ring[-1].tolist()
    assert len(ring) == 4


def test_geojson_is_read_in_longitude_and_latitude_of_the_moon(tmp_path: Path) -> None:
    account = region(30, 40, 2.0, origin_lat_deg=ORIGIN[0], origin_lon_deg=ORIGIN[1])
    exported(contents(account), tmp_path / "out")
    files = {path.stem: path for path in (tmp_path / "out").glob("*.geojson")}
    assert set(files) == {"samples", "driven_path", "planned_path", "keep_outs", "interest_areas", "site"}
    for path in files.values():
        found = pyproj.CRS.from_user_input(pyogrio.read_info(path)["crs"])
        assert (found.name, found.ellipsoid.semi_major_metre) == ("Moon (2015) - Sphere / Ocentric", R)
    meta, _, geometry, columns = pyogrio.raw.read(files["samples"])
    table = dict(zip(meta["fields"], columns, strict=True))
    assert np.frombuffer(geometry[1], "<f8", offset=5) == pytest.approx(degrees_of(account, 60.0, 7.5), abs=1e-9)
    assert (table["x_m"][1], table["y_m"][1], table["helium3_ppb"][1]) == (60.0, 7.5, 10.0)
    rows = list(csv.DictReader((tmp_path / "out" / "samples.csv").read_text(encoding="utf-8").splitlines()))
    assert [(row["sample_id"], float(row["x_m"]), row["measured_at"]) for row in rows] == [
        ("s-1", 20.0, "2030-01-01T00:00:00.000Z"), ("s-2", 60.0, "2030-01-01T00:00:00.000Z"),
    ]  # fmt: skip


def test_the_stac_item_names_every_file_with_its_checksum_and_the_provenance_of_every_layer(tmp_path: Path) -> None:
    account = region(30, 40, 2.0, origin_lat_deg=ORIGIN[0], origin_lon_deg=ORIGIN[1])
    what = contents(account, simulated=True)
    done = exported(what, tmp_path / "out", pds4=True)
    item = pystac.Item.from_file(str(tmp_path / "out" / "item.json"))
    assert item.id == "t1-17"
    assert item.datetime.isoformat() == "2030-01-01T00:00:00+00:00"
    assert item.bbox == pytest.approx([*degrees_of(account, 0, 0), *degrees_of(account, 80.0, 60.0)], abs=1e-9)
    assert item.properties["ssys:targets"] == ["Moon"]
    assert item.properties["he3:region_layers"][0] == {
        "layer": "elevation_m", "kind": "real", "source": "LROC NAC", "product_id": "NAC_DTM_X",
    }  # fmt: skip
    assert pyproj.CRS.from_json_dict(item.properties["proj:projjson"]).is_projected
    present = {str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert {asset.href.removeprefix("./") for asset in item.assets.values()} == present - {"item.json"}
    assert set(done.files) == present
    for asset in item.assets.values():
        content = (tmp_path / "out" / asset.href).read_bytes()
        assert asset.extra_fields["file:checksum"] == "1220" + hashlib.sha256(content).hexdigest()
        assert asset.extra_fields["file:size"] == len(content)
    band = item.assets["mean-tif"].to_dict()["bands"][0]
    assert (band["unit"], band["statistics"]["maximum"]) == ("ppb", 1199.0)
    assert item.assets["mean-tif"].extra_fields["he3:provenance"]["kind"] == "derived"


PLACES = {
    "a site of the near side": {"origin_lat_deg": ORIGIN[0], "origin_lon_deg": ORIGIN[1]},
    "across the antimeridian": {"origin_lat_deg": 5.0, "origin_lon_deg": 179.9999},
    "over the pole": {"crs": "IAU_2015:30135", "origin_x_m": -40.0, "origin_y_m": -30.0},
    "nowhere": {},
}


@pytest.mark.parametrize("place", PLACES)
def test_stacs_own_schema_accepts_the_item(place: str, tmp_path: Path) -> None:
    pytest.importorskip("jsonschema", reason="pystac validates with jsonschema, which is not installed")
    from pystac.validation.stac_validator import JsonSchemaSTACValidator

    exported(contents(region(30, 40, 2.0, **PLACES[place])), tmp_path / "out")
    item = json.loads((tmp_path / "out" / "item.json").read_text(encoding="utf-8"))
    # The schemas of extensions are on the network; those of the core are in the package.
    JsonSchemaSTACValidator().validate_core(item, pystac.STACObjectType.ITEM, item["stac_version"])
    with pytest.raises(pystac.errors.STACValidationError):
        JsonSchemaSTACValidator().validate_core({**item, "assets": 3}, pystac.STACObjectType.ITEM, item["stac_version"])


def test_the_box_of_a_site_over_a_pole_or_the_antimeridian_is_that_of_the_standard(tmp_path: Path) -> None:
    boxes = {}
    for place, where in PLACES.items():
        exported(contents(region(30, 40, 2.0, **where)), tmp_path / place)
        item = pystac.Item.from_file(str(tmp_path / place / "item.json"))
        boxes[place] = item.bbox
        assert (item.geometry is None) == (place == "nowhere")
    west, _, east, _ = boxes["across the antimeridian"]
    assert west == pytest.approx(179.9999)
    assert -180.0 < east < -179.99
    assert (boxes["over the pole"][0], *boxes["over the pole"][1:3]) == (-180.0, -90.0, 180.0)
    assert boxes["nowhere"] is None


def test_a_pds4_label_is_read_with_its_raster(tmp_path: Path) -> None:
    account = region(30, 40, 2.0, origin_lat_deg=ORIGIN[0], origin_lon_deg=ORIGIN[1])
    what = contents(account)
    exported(what, tmp_path / "out", pds4=True)
    for layer in what.layers:
        label = tmp_path / "out" / "pds4" / f"{layer.name}.xml"
        with rasterio.open(label) as raster:
            assert raster.driver == "PDS4"
            assert raster.units == (layer.unit,)
            assert np.array_equal(raster.read(1), layer.values[::-1])
            assert values_at(raster, *degrees_of(account, 21.0, 9.0)) == layer.values[4, 10]
        text = label.read_text(encoding="utf-8")
        assert f"<logical_identifier>urn:nasa:pds:he3_seeker:maps:t1_17_{layer.name}</logical_identifier>" in text
        assert "<name>Moon</name>" in text
        assert "@" not in text


def test_a_region_without_a_place_is_exported_in_metres_of_the_site(tmp_path: Path) -> None:
    what = contents(region(30, 40, 2.0))
    done = exported(what, tmp_path / "out")
    assert done.frame == "site frame"
    assert done.notes == (
        "the region has no place on the Moon: rasters and GeoPackage are in metres of the site, without GeoJSON",
    )
    assert not list((tmp_path / "out").glob("*.geojson"))
    with rasterio.open(tmp_path / "out" / "mean.tif") as raster:
        assert raster.transform == rasterio.Affine(2.0, 0, 0.0, 0, -2.0, 60.0)
        assert "site frame" in raster.crs.to_wkt()
        assert next(iter(raster.sample([(21.0, 9.0)])))[0] == what.layers[0].values[4, 10]
    _, _, geometry, _ = pyogrio.raw.read(tmp_path / "out" / "map.gpkg", layer="samples")
    assert np.frombuffer(geometry[1], "<f8", offset=5).tolist() == [60.0, 7.5]


def test_a_reference_that_is_not_known_is_no_data_and_in_no_statistics(tmp_path: Path) -> None:
    from he3.reference import Region
    from services.console.map_export.region_layers import region_layers

    account = region(30, 40, 2.0, origin_lat_deg=ORIGIN[0], origin_lon_deg=ORIGIN[1])
    grid = SiteGrid(30, 40, 2.0)
    field, known, flat = (
        5.0 + np.random.default_rng(3).random(grid.shape),
        np.ones(grid.shape, bool),
        np.zeros(grid.shape),
    )
    known[:3], field[:3] = False, 99.0
    truth = Region(
        name="place", title="A place", provenance=account.provenance, grid=grid, he3_ppb=field, orbital_ppb=field,
        elevation_m=flat, slope_deg=flat, traversable=known, known=known,
    )  # fmt: skip
    layers = tuple(region_layers(truth, account, np.full(grid.shape, 6.0, np.float32), simulated=True))
    exported(contents(account, layers=layers, simulated=True), tmp_path / "out", pds4=True)
    item = pystac.Item.from_file(str(tmp_path / "out" / "item.json"))
    for name, values in (("simulation_reference", field[3:]), ("simulation_error", 6.0 - field[3:])):
        for path in (tmp_path / "out" / f"{name}.tif", tmp_path / "out" / "pds4" / f"{name}.xml"):
            with rasterio.open(path) as raster:
                read = raster.read(1, masked=True)[::-1]
            assert (np.ma.getmaskarray(read) == ~known).all()
            assert read.compressed() == pytest.approx(values.ravel(), abs=1e-6)
        found = item.assets[f"{name}-tif"].extra_fields["bands"][0]["statistics"]
        assert found["valid_percent"] == 90.0
        assert found["maximum"] == pytest.approx(values.max())


def test_a_layer_of_the_simulation_alone_says_so_everywhere(tmp_path: Path) -> None:
    account = region(30, 40, 2.0, origin_lat_deg=ORIGIN[0], origin_lon_deg=ORIGIN[1])
    grid = SiteGrid(30, 40, 2.0)
    from he3.reference import Region
    from services.console.map_export.region_layers import region_layers

    rng = np.random.default_rng(3)
    truth = Region(
        name="place", title="A place", provenance=account.provenance, grid=grid, he3_ppb=rng.random(grid.shape),
        orbital_ppb=rng.random(grid.shape), elevation_m=rng.random(grid.shape), slope_deg=rng.random(grid.shape),
        traversable=np.ones(grid.shape, bool),
    )  # fmt: skip
    mean = np.ones(grid.shape, np.float32)
    assert {layer.name for layer in region_layers(truth, account, mean, simulated=False)} == {
        "elevation", "slope", "orbital",
    }  # fmt: skip
    layers = tuple(region_layers(truth, account, mean, simulated=True))
    done = exported(contents(account, layers=layers, simulated=True), tmp_path / "out")
    simulated = [name for name in done.files if name.startswith("simulation_") and name.endswith(".tif")]
    assert simulated == ["simulation_reference.tif", "simulation_error.tif"]
    item = pystac.Item.from_file(str(tmp_path / "out" / "item.json"))
    for name in simulated:
        with rasterio.open(tmp_path / "out" / name) as raster:
            assert raster.tags()["LABEL"] == "simulation only"
            assert raster.descriptions[0].endswith("(simulation only)")
        assert item.assets[name.replace(".", "-")].extra_fields["he3:label"] == "simulation only"
    with rasterio.open(tmp_path / "out" / "simulation_error.tif") as raster:
        assert np.allclose(raster.read(1)[::-1], 1.0 - truth.he3_ppb, atol=1e-6)
    with rasterio.open(tmp_path / "out" / "elevation.tif") as raster:
        assert raster.tags()["PROVENANCE"] == "LROC NAC, product NAC_DTM_X"
        assert raster.units == ("m",)
