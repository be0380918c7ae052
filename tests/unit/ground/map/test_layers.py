"""Each layer of the map has its unit, its colours and its words wherever layers are shown."""

from __future__ import annotations

import io
import math
import re
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from he3.colour_maps import OF_LAYER, stops
from he3.errors import NotFound
from schemas.maps import (
    RASTERS,
    SIMULATED,
    TABLES,
    MapAbout,
    MapBoxQuery,
    MapFormat,
    MapLayer,
    MapLayerQuery,
    MapRegion,
    MapScore,
)
from services.console.__main__ import main
from services.console.report.pictures import LAYER_LABELS
from services.ground.map.layers import UNITS, box, whole_layer
from services.ground.map.rendering import NO_DATA, rendered
from services.ground.map.snapshot import MapSnapshot
from services.ground.scoring import Scorer
from services.mission.region_folder import file_sha256
from services.mission.regions import load_region
from tests.unit.ground.map.test_service import GRID, REGION, snapshot

ROOT = Path(__file__).parents[4]
STATIC = ROOT / "services" / "console" / "web" / "static"
every_raster = pytest.mark.parametrize("layer", RASTERS, ids=lambda layer: layer.value)


def test_every_layer_is_a_raster_or_a_table() -> None:
    assert set(RASTERS) | set(TABLES) == set(MapLayer)
    assert not set(RASTERS) & set(TABLES)


SCORE = MapScore(
    rmse_ppb=1.0, coverage_68=0.5, coverage_95=0.9, mean_std_ppb=0.5, revision=7, samples=0, mission_time_ns=123
)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> MapSnapshot:
    """A map of a simulated Moon: a slope of 10 % towards the east, and 9 ppb everywhere."""
    path = tmp_path_factory.mktemp("region") / "region.npz"
    elevation = np.broadcast_to(-0.1 * GRID.x_m, GRID.shape) + 100.0
    he3 = np.full(GRID.shape, 9.0)
    np.savez(path, he3_ppb=he3, resolution_m=2.0, elevation_m=elevation, traversable=np.ones(GRID.shape, dtype=bool))
    return replace(snapshot(SCORE), region=account_of(path))


def account_of(path: Path) -> MapRegion:
    """The account of the region in that file."""
    region = load_region(path)
    return REGION.model_copy(update={
        "location": str(path), "name": region.name, "title": region.title, "provenance": region.provenance,
        "rows": region.grid.rows, "columns": region.grid.columns, "resolution_m": region.grid.resolution_m,
        "origin_lat_deg": region.origin_lat_deg, "origin_lon_deg": region.origin_lon_deg, "crs": region.crs,
        "origin_x_m": region.origin_x_m, "origin_y_m": region.origin_y_m, "layers": (),
        "file_sha256": file_sha256(path),
    })  # fmt: skip


@every_raster
def test_a_raster_has_a_value_in_every_cell_a_unit_a_colour_map_and_a_label(
    layer: MapLayer, simulated: MapSnapshot
) -> None:
    threshold = 8.0 if layer is MapLayer.EXCEEDANCE else None
    cells = whole_layer(MapLayerQuery(layer=layer, threshold=threshold), simulated)
    assert cells.values.shape == GRID.shape
    assert np.isfinite(cells.values).all()
    assert cells.unit == UNITS[layer]
    assert stops(OF_LAYER[layer.value])
    assert LAYER_LABELS[layer]


def values(layer: MapLayer, shown: MapSnapshot) -> NDArray[Any]:
    return whole_layer(MapLayerQuery(layer=layer), shown).values


def test_terrain_and_error_are_those_of_the_region(simulated: MapSnapshot) -> None:
    assert values(MapLayer.ELEVATION, simulated)[7, 3] == np.float32(100.0 - 0.7)
    np.testing.assert_allclose(values(MapLayer.SLOPE, simulated), math.degrees(math.atan(0.1)), rtol=1e-4)
    # The ground falls to the east; its normal leans 10 % away from a light that comes from the north-west.
    towards = (1.0 - 0.1 * math.sin(math.radians(45.0))) * math.sin(math.radians(45.0)) / math.hypot(1.0, 0.1)
    np.testing.assert_allclose(values(MapLayer.SHADE, simulated), towards, rtol=1e-4)
    np.testing.assert_array_equal(values(MapLayer.REFERENCE, simulated), np.float32(9.0))
    np.testing.assert_array_equal(values(MapLayer.ERROR, simulated), simulated.mean_ppb - np.float32(9.0))


def test_a_mission_without_a_reference_field_tells_neither_reference_nor_error(simulated: MapSnapshot) -> None:
    for layer in SIMULATED:
        with pytest.raises(NotFound, match=f"no layer {layer.value}: this mission has no reference field"):
            values(layer, replace(simulated, score=None))


def test_a_region_that_is_not_the_missions_any_more_is_not_shown(simulated: MapSnapshot) -> None:
    with pytest.raises(NotFound, match=r"expected the mission's region 'place' at t1, got one that was built anew"):
        values(MapLayer.SLOPE, snapshot())


def test_a_region_that_was_built_anew_since_is_not_shown_although_it_has_as_many_cells(tmp_path: Path) -> None:
    arrays = {"resolution_m": 2.0, "traversable": np.ones(GRID.shape, dtype=bool)}
    np.savez(tmp_path / "region.npz", he3_ppb=np.full(GRID.shape, 9.0), **arrays)
    shown = replace(snapshot(SCORE), region=account_of(tmp_path / "region.npz"))
    np.savez(tmp_path / "region.npz", he3_ppb=np.full(GRID.shape, 8.0), **arrays)
    with pytest.raises(NotFound, match=r"expected the mission's region .* got one that was built anew or changed"):
        values(MapLayer.REFERENCE, shown)


def test_files_of_reference_and_error_have_no_value_where_the_reference_has_none(tmp_path: Path) -> None:
    field, nothing = np.full(GRID.shape, 9.0), np.zeros(GRID.shape, dtype=bool)
    field[:3, 5:] = np.nan
    nothing[:3, 5:] = True
    np.savez(tmp_path / "region.npz", he3_ppb=field, resolution_m=2.0, traversable=np.ones(GRID.shape, dtype=bool))
    shown = replace(snapshot(SCORE), region=account_of(tmp_path / "region.npz"))
    for layer in SIMULATED:
        cells = whole_layer(MapLayerQuery(layer=layer), shown)
        assert np.isfinite(cells.values).all()
        read = np.load(io.BytesIO(rendered(cells, MapFormat.NPY, shown).payload))
        np.testing.assert_array_equal(np.isnan(read), nothing)
        np.testing.assert_array_equal(read[~nothing], cells.values[~nothing])
        with Image.open(io.BytesIO(rendered(cells, MapFormat.TIFF, shown).payload)) as tiff:
            np.testing.assert_array_equal(np.isnan(np.asarray(tiff))[::-1], nothing)
            assert tiff.tag_v2[NO_DATA] == "nan"
        table = rendered(cells, MapFormat.CSV, shown).payload.decode().splitlines()[1:]
        assert [line.endswith(",nan") for line in table] == nothing.ravel().tolist()
        about = MapAbout.model_validate_json(rendered(cells, MapFormat.CSV, shown).about)
        assert (about.low, about.high) == (cells.values[~nothing].min(), cells.values[~nothing].max())
    score = read[~nothing].astype(np.float64)
    assert np.sqrt(np.mean(score**2)) == pytest.approx(Scorer(field, ~nothing).score(
        shown.mean_ppb, shown.std_ppb, 0, 0, 0, None
    ).rmse_ppb)  # fmt: skip
    corner = box(MapBoxQuery(layer=MapLayer.ERROR, x_min=12, y_min=0, x_max=16, y_max=4), shown)
    assert np.isnan(np.load(io.BytesIO(rendered(corner, MapFormat.NPY, shown).payload))).all()
    mean = rendered(whole_layer(MapLayerQuery(layer=MapLayer.MEAN), shown), MapFormat.NPY, shown)
    assert np.isfinite(np.load(io.BytesIO(mean.payload))).all()


def unpacked(payload: bytes, about: MapAbout) -> NDArray[Any]:
    """The values of packed bytes, read as the module on packing says."""
    planes = np.frombuffer(zlib.decompress(payload), dtype=np.uint8).reshape(2, about.rows, about.columns)
    folded = (planes[0].astype(np.uint16) << 8) | planes[1]
    signed = (folded >> 1) ^ (np.uint16(0) - (folded & 1))
    steps = np.cumsum(np.cumsum(signed, axis=1, dtype=np.uint16), axis=0, dtype=np.uint16)
    return np.asarray(about.low + (about.high - about.low) / 65535 * steps.astype(np.float64))


def test_packed_values_are_the_maps_to_half_a_step(simulated: MapSnapshot) -> None:
    for layer in (MapLayer.MEAN, MapLayer.TRAVERSABLE, MapLayer.REFERENCE):
        cells = whole_layer(MapLayerQuery(layer=layer), simulated)
        made = rendered(cells, MapFormat.PACKED, simulated)
        about = MapAbout.model_validate_json(made.about)
        found = unpacked(made.payload, about)
        half_a_step = (about.high - about.low) / 65535 / 2
        np.testing.assert_allclose(found, cells.values, atol=half_a_step * 1.01 + 1e-6, rtol=0.0)


@every_raster
def test_the_page_offers_a_raster_and_names_it(layer: MapLayer) -> None:
    assert f'name="layer" value="{layer.value}"' in (STATIC / "index.html").read_text()
    names = re.search(r"const NAMES = {(.*?)};", (STATIC / "layers.js").read_text(), re.DOTALL)
    assert names is not None
    assert layer.value in re.findall(r"(\w+): \"", names[1])


@every_raster
def test_the_help_and_the_page_on_queries_name_a_raster(layer: MapLayer, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["map", "show", "--help"]) == 0
    argument = capsys.readouterr().out.partition("Arguments:")[2].partition("Options:")[0]
    assert layer.value in re.findall(r"\w+", argument)
    paragraph = re.search(r"\*\*Layers\.\*\*.*?\n\n", (ROOT / "docs" / "map-queries.md").read_text(), re.DOTALL)
    assert paragraph is not None
    assert f"`{layer.value}`" in paragraph[0]
