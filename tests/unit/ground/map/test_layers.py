"""Each layer of the map has its unit, its colours and its words wherever layers are shown."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from he3.colour_maps import OF_LAYER, stops
from schemas.maps import RASTERS, TABLES, MapLayer, MapLayerQuery
from services.console.__main__ import main
from services.console.report.pictures import LAYER_LABELS
from services.ground.map.layers import UNITS, whole_layer
from tests.unit.ground.map.test_service import GRID, snapshot

ROOT = Path(__file__).parents[4]
STATIC = ROOT / "services" / "console" / "web" / "static"
every_raster = pytest.mark.parametrize("layer", RASTERS, ids=lambda layer: layer.value)


def test_every_layer_is_a_raster_or_a_table() -> None:
    assert set(RASTERS) | set(TABLES) == set(MapLayer)
    assert not set(RASTERS) & set(TABLES)


@every_raster
def test_a_raster_has_a_value_in_every_cell_a_unit_a_colour_map_and_a_label(layer: MapLayer) -> None:
    threshold = 8.0 if layer is MapLayer.EXCEEDANCE else None
    cells = whole_layer(MapLayerQuery(layer=layer, threshold=threshold), snapshot())
    assert cells.values.shape == GRID.shape
    assert np.isfinite(cells.values).all()
    assert cells.unit == UNITS[layer]
    assert stops(OF_LAYER[layer.value])
    assert LAYER_LABELS[layer]


@every_raster
def test_the_page_offers_a_raster_and_names_it(layer: MapLayer) -> None:
    assert f'name="layer" value="{layer.value}"' in (STATIC / "index.html").read_text()
    names = re.search(r"const NAMES = {(.*?)};", (STATIC / "layers.js").read_text())
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
