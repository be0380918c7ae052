"""Every value of an answer is the map's at the place that the answer gives for it."""

from __future__ import annotations

import base64
import io
import json
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from PIL import Image

from he3.constants import MOON_RADIUS_M
from he3.errors import InvalidInput
from he3.frames import SiteGrid
from schemas.maps import MapBoxQuery, MapFormat, MapLayer, MapLayerQuery, MapPointQuery
from schemas.topics import MAP_BOX, MAP_LAYER
from services.ground.map.geotiff import MODEL_PIXEL_SCALE, MODEL_TIE_POINT
from services.ground.map.rendering import Renderer
from services.ground.map.service import answer, point
from services.ground.map.snapshot import MapSnapshot

ON_EDGE = 1e-4
"""Places so near an edge between two cells of the map [cells] have either one's value in a raster of other numbers."""


def snapshot(rows: int, columns: int, resolution_m: float, origin: tuple[float, float] | None = None) -> MapSnapshot:
    grid = SiteGrid(rows, columns, resolution_m)
    rng = np.random.default_rng(rows * columns)
    mean = rng.permutation(rows * columns).astype(np.float32).reshape(grid.shape) / np.float32(7.0)
    return MapSnapshot(
        grid=grid, mean_ppb=mean, std_ppb=mean + 1, traversable=mean > 1, samples=(), driven_path_m=(),
        planned_path_m=(), plan_ends=None, revision=1, mission_time_ns=0, score=None, score_history=(),
        origin_deg=origin,
    )  # fmt: skip


grids = st.tuples(st.integers(1, 30), st.integers(1, 30), st.sampled_from([0.01, 0.1, 0.3, 1.0, 2.0, 7.3, 1000.0]))
formats = st.sampled_from([MapFormat.JSON, MapFormat.NPY, MapFormat.CSV])


@st.composite
def boxes(draw: st.DrawFn) -> tuple[MapSnapshot, MapBoxQuery]:
    rows, columns, cell_m = draw(grids)
    shown = snapshot(rows, columns, cell_m)
    edges = {}
    for axis, length in (("x", shown.grid.width_m), ("y", shown.grid.height_m)):
        low = draw(st.floats(0.0, 0.99)) * length
        edges[f"{axis}_min"] = low
        edges[f"{axis}_max"] = min(length, low + draw(st.floats(0.01, 1.0)) * length)
    resolution = draw(st.none() | st.floats(0.05, 60.0).map(lambda cells: cells * cell_m))
    try:
        return shown, MapBoxQuery(layer=MapLayer.MEAN, resolution_m=resolution, **edges)
    except ValueError:
        assume(False)
        raise


def cells_of(shown: MapSnapshot, request: MapLayerQuery | MapBoxQuery) -> list[tuple[float, float, float]]:
    """(x, y, value) of every cell of the answer, from the fields that a client sees."""
    topic = MAP_LAYER if isinstance(request, MapLayerQuery) else MAP_BOX
    if request.format is MapFormat.JSON:
        about = answer(topic, request, shown).model_dump()
        values = np.frombuffer(base64.b64decode(about["data_base64"]), dtype=about["dtype"])
        values = values.reshape(about["rows"], about["columns"])
    else:
        encoded = Renderer()(topic, request, shown)
        assert encoded is not None
        if request.format is MapFormat.CSV:
            lines = encoded.payload.decode().splitlines()[1:]
            return [tuple(map(float, line.split(","))) for line in lines]  # type: ignore[misc]
        about = json.loads(encoded.about)
        values = np.load(io.BytesIO(encoded.payload))
    assert values.shape == (about["rows"], about["columns"])
    x = about["x_min_m"] + (np.arange(about["columns"]) + 0.5) * about["resolution_m"]
    y = about["y_min_m"] + (np.arange(about["rows"]) + 0.5) * about["resolution_m"]
    return [(float(x[j]), float(y[i]), float(values[i, j])) for i, j in np.ndindex(values.shape)]


def assert_values_of_the_map(shown: MapSnapshot, cells: list[tuple[float, float, float]]) -> None:
    assert cells
    for x, y, value in cells:
        assert np.float32(value) == np.float32(point(MapPointQuery(x=x, y=y), shown).mean_ppb)


@given(grids, st.integers(1, 500), formats)
def test_a_layer_of_any_step_has_the_maps_value_at_every_place_it_gives(
    grid: tuple[int, int, float], step: int, form: MapFormat
) -> None:
    shown = snapshot(*grid)
    request = MapLayerQuery(layer=MapLayer.MEAN, step=step, format=form)
    assert_values_of_the_map(shown, cells_of(shown, request))


@given(boxes(), formats)
def test_a_box_of_any_edges_and_resolution_has_the_maps_value_at_every_place_it_gives(
    asked: tuple[MapSnapshot, MapBoxQuery], form: MapFormat
) -> None:
    shown, request = asked
    request = request.model_copy(update={"format": form})
    try:
        cells = cells_of(shown, request)
    except InvalidInput as refusal:
        small = min(request.x_max - request.x_min, request.y_max - request.y_min)
        crowded = "expected at most" in str(refusal)
        assert crowded or (request.resolution_m or 0.0) > 1.99 * small or small < 1e-3 * shown.grid.resolution_m
        return
    assert_values_of_the_map(shown, cells)
    for x, y, _ in cells:
        assert request.x_min <= x <= request.x_max
        assert request.y_min <= y <= request.y_max


@given(boxes(), st.none() | st.tuples(st.floats(-89.0, 89.0), st.floats(-180.0, 180.0)))
def test_a_geotiff_has_the_maps_value_at_the_centre_of_every_pixel(
    asked: tuple[MapSnapshot, MapBoxQuery], origin: tuple[float, float] | None
) -> None:
    shown, request = asked
    grid = shown.grid
    shown = snapshot(grid.rows, grid.columns, grid.resolution_m, origin)
    try:
        encoded = Renderer()(MAP_BOX, request.model_copy(update={"format": MapFormat.TIFF}), shown)
        about = json.loads(encoded.about)  # type: ignore[union-attr]
    except InvalidInput:
        assume(False)
    image = Image.open(io.BytesIO(encoded.payload))  # type: ignore[union-attr]
    values = np.asarray(image)
    scale, tie = image.tag_v2[MODEL_PIXEL_SCALE], image.tag_v2[MODEL_TIE_POINT]  # type: ignore[attr-defined]
    for i, j in np.ndindex(values.shape):
        x, y = in_the_site_frame(shown, tie[3] + (j + 0.5) * scale[0], tie[4] - (i + 0.5) * scale[1])
        assert x == pytest.approx(about["x_min_m"] + (j + 0.5) * about["resolution_m"], abs=1e-6)
        assert y == pytest.approx(about["y_min_m"] + (len(values) - i - 0.5) * about["resolution_m"], abs=1e-6)
        if all(abs(place / grid.resolution_m - round(place / grid.resolution_m)) > ON_EDGE for place in (x, y)):
            assert values[i, j] == np.float32(point(MapPointQuery(x=x, y=y), shown).mean_ppb)


def in_the_site_frame(shown: MapSnapshot, x: float, y: float) -> tuple[float, float]:
    """Metres east and north of the site's corner, from coordinates of the raster's projection."""
    if shown.origin_deg is None:
        return x, y
    lat, lon = map(math.radians, shown.origin_deg)
    middle = lat + shown.grid.height_m / 2 / MOON_RADIUS_M
    if abs(math.degrees(middle)) <= 65.0:
        return (x - MOON_RADIUS_M * lon) * math.cos(middle), y - MOON_RADIUS_M * lat
    north = math.copysign(1.0, middle)
    scale = 2 / (1 + math.sin(min(abs(middle), math.pi / 2)))
    return x / scale, (y + north * 2 * MOON_RADIUS_M * math.tan((math.pi / 2 - north * lat) / 2)) / scale


@settings(max_examples=40)
@given(boxes(), st.tuples(st.floats(-89.0, 89.0), st.floats(-180.0, 180.0)), st.data())
def test_gdal_finds_the_maps_value_in_a_geotiff_at_every_place_of_the_moon(
    asked: tuple[MapSnapshot, MapBoxQuery], origin: tuple[float, float], data: st.DataObject
) -> None:
    rasterio, pyproj = pytest.importorskip("rasterio"), pytest.importorskip("pyproj")
    shown, request = asked
    grid = shown.grid
    shown = snapshot(grid.rows, grid.columns, grid.resolution_m, origin)
    try:
        encoded = Renderer()(MAP_BOX, request.model_copy(update={"format": MapFormat.TIFF}), shown)
        about = json.loads(encoded.about)  # type: ignore[union-attr]
    except InvalidInput:
        assume(False)
    row, column = data.draw(st.integers(0, about["rows"] - 1)), data.draw(st.integers(0, about["columns"] - 1))
    x = about["x_min_m"] + (column + 0.5) * about["resolution_m"]
    y = about["y_min_m"] + (row + 0.5) * about["resolution_m"]
    with rasterio.io.MemoryFile(encoded.payload) as memory, memory.open() as raster:  # type: ignore[union-attr]
        crs = raster.crs.to_wkt()
        assert "Moon (2015) - Sphere" in crs
        to_raster = pyproj.Transformer.from_crs("IAU_2015:30100", crs, always_xy=True)
        value = next(iter(raster.sample([to_raster.transform(*degrees_of(shown, x, y))])))[0]
        values = raster.read(1)[::-1]
    assert value == values[row, column]
    if all(abs(place / grid.resolution_m - round(place / grid.resolution_m)) > ON_EDGE for place in (x, y)):
        assert value == np.float32(point(MapPointQuery(x=x, y=y), shown).mean_ppb)


def degrees_of(shown: MapSnapshot, x: float, y: float) -> tuple[float, float]:
    """Longitude and latitude [deg] of a place of the site, by the formulas of its projection written out."""
    assert shown.origin_deg is not None
    lat, lon = map(math.radians, shown.origin_deg)
    middle = lat + shown.grid.height_m / 2 / MOON_RADIUS_M
    if abs(math.degrees(middle)) <= 65.0:
        return math.degrees(lon + x / (MOON_RADIUS_M * math.cos(middle))), math.degrees(lat + y / MOON_RADIUS_M)
    sign = math.copysign(1.0, middle)
    scale = 2 / (1 + math.sin(min(abs(middle), math.pi / 2)))
    east, north = x * scale, y * scale - sign * 2 * MOON_RADIUS_M * math.tan((math.pi / 2 - sign * lat) / 2)
    colatitude = 2 * math.atan(math.hypot(east, north) / (2 * MOON_RADIUS_M))
    return math.degrees(lon + math.atan2(east, -sign * north)), sign * (90 - math.degrees(colatitude))


def test_a_box_has_as_many_cells_as_have_their_centre_in_it() -> None:
    shown = snapshot(60, 60, 1.0)
    request = MapBoxQuery(layer=MapLayer.MEAN, x_min=0.0, y_min=0.0, x_max=60.0, y_max=60.0, resolution_m=50.0)
    assert cells_of(shown, request) == [(25.0, 25.0, float(shown.mean_ppb[25, 25]))]
    with pytest.raises(InvalidInput, match="expected a resolution_m below 120, so that the box holds the centre"):
        cells_of(shown, request.model_copy(update={"resolution_m": 130.0}))


def test_a_box_within_one_cell_has_the_value_of_that_cell() -> None:
    shown = snapshot(60, 60, 1.0)
    request = MapBoxQuery(layer=MapLayer.MEAN, x_min=10.25, y_min=4.5, x_max=10.5, y_max=4.75)
    assert cells_of(shown, request) == [(10.375, 4.625, float(shown.mean_ppb[4, 10]))]


def test_a_map_of_any_region_is_answered_whole_however_long_and_narrow() -> None:
    shown = snapshot(1, 5000, 1.0)
    assert answer(MAP_LAYER, MapLayerQuery(layer=MapLayer.MEAN), shown).columns == 5000
    whole = MapBoxQuery(layer=MapLayer.MEAN, x_min=0.0, y_min=0.0, x_max=5000.0, y_max=1.0)
    assert answer(MAP_BOX, whole, shown).columns == 5000


@pytest.mark.parametrize(("lat", "north"), [(88.5, True), (-88.5, False)])
def test_a_site_beside_a_pole_is_exported_in_a_polar_stereographic_projection(lat: float, north: bool) -> None:
    shown = snapshot(60, 90, 1000.0, (lat, 10.0))
    encoded = Renderer()(MAP_LAYER, MapLayerQuery(layer=MapLayer.MEAN, format=MapFormat.TIFF), shown)
    image = Image.open(io.BytesIO(encoded.payload))  # type: ignore[union-attr]
    scale, tie = image.tag_v2[MODEL_PIXEL_SCALE], image.tag_v2[MODEL_TIE_POINT]  # type: ignore[attr-defined]
    assert scale[:2] == pytest.approx((1000.0, 1000.0), rel=1e-3)
    corner = (tie[3], tie[4] - 60 * scale[1])
    from_pole_m = 2 * MOON_RADIUS_M * math.tan(math.radians(1.5) / 2)
    assert corner == pytest.approx((0.0, -from_pole_m if north else from_pole_m), abs=1e-6)
    assert ("North Polar" if north else "South Polar") in image.tag_v2[34737]  # type: ignore[attr-defined]
