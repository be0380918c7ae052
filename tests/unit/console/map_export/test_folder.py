"""The folder of an export: whole or not at all, one at a time, and never among other files."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from he3.errors import He3Error, InvalidInput
from schemas.ground import MissionTrack
from schemas.maps import MapLayer, MapRegion
from services.console.map_export.contents import MapContents, belief_layer
from services.console.map_export.folder import earlier_files, export_folder

REGION = MapRegion(
    name="place", title="A place", location="/nowhere", field_seed=None, provenance="", rows=5, columns=6,
    resolution_m=1.0, origin_lat_deg=None, origin_lon_deg=None, crs="", origin_x_m=None, origin_y_m=None, layers=(),
)  # fmt: skip
LAYER = belief_layer(MapLayer.MEAN, np.ones((5, 6), np.float32), "ppb", 0, REGION, None)
CONTENTS = MapContents(
    mission="t1", region=REGION, revision=1, mission_time_ns=0, layers=(LAYER,),
    track=MissionTrack(samples=(), driven_path_m=(), planned_path_m=(), score_history=()),
)  # fmt: skip
with_the_extra = pytest.mark.skipif(
    any(find_spec(name) is None for name in ("rasterio", "pyogrio", "pystac")),
    reason="the extra geo is not installed",
)


def write(folder: Path, contents: MapContents = CONTENTS, pds4: bool = False) -> None:
    with export_folder(folder) as target:
        target.write(contents, pds4=pds4)


@with_the_extra
def test_a_map_takes_the_place_of_an_earlier_one_and_nothing_of_that_is_left(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    write(folder, replace(CONTENTS, layers=(LAYER, replace(LAYER, name="old"))), pds4=True)
    assert (folder / "old.tif").is_file()
    (folder / "mine.qgz").write_text("a project of the user")
    (folder / "mean.tif.aux.xml").write_text("statistics that a reader kept")
    write(folder, replace(CONTENTS, revision=2))
    left = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert left == {"mean.tif", "mean.qml", "map.gpkg", "samples.csv", "item.json", "mine.qgz"}
    assert json.loads((folder / "item.json").read_text())["id"] == "t1-2"


@with_the_extra
def test_an_export_that_fails_leaves_the_earlier_one_whole(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    write(folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(He3Error, match="expected a projection"):
        write(folder, replace(CONTENTS, region=REGION.model_copy(
            update={"crs": "+proj=gold", "origin_x_m": 0.0, "origin_y_m": 0.0}
        )))  # fmt: skip
    with pytest.raises(He3Error):
        write(folder, replace(CONTENTS, layers=(replace(LAYER, values=np.ones((7, 7), np.float32)),)))
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@with_the_extra
def test_a_folder_with_other_files_a_file_and_one_in_use_are_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(
        InvalidInput, match=r"expected an empty folder or that of an earlier export, got one with notes"
    ):
        write(tmp_path)
    with pytest.raises(InvalidInput, match="expected a folder, got a file"):
        write(tmp_path / "notes.txt")
    with pytest.raises(He3Error, match="cannot make the folder: Not a directory"):
        write(tmp_path / "notes.txt" / "out")
    with (
        export_folder(tmp_path / "out"),
        pytest.raises(
            InvalidInput, match="expected a folder that no other export writes to, got one in use by process"
        ),
        export_folder(tmp_path / "out"),
    ):
        pass
    assert not (tmp_path / "out").exists()


@with_the_extra
def test_an_item_that_names_files_elsewhere_removes_none(tmp_path: Path) -> None:
    outside = tmp_path / "precious.tif"
    outside.write_text("not of this export")
    folder = tmp_path / "out"
    folder.mkdir()
    hrefs = ("../precious.tif", str(outside), "pds4/../../precious.tif", "./old.tif")
    assets = {str(number): {"href": href} for number, href in enumerate(hrefs)}
    (folder / "item.json").write_text(json.dumps({"properties": {"he3:mission": "t1"}, "assets": assets}))
    assert earlier_files(folder) == ("old.tif",)
    write(folder)
    assert outside.is_file()


def test_without_the_extra_one_line_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("rasterio", "pyproj", "pyogrio", "pystac"):
        with monkeypatch.context() as missing:
            missing.setitem(sys.modules, name, None)
            with pytest.raises(
                He3Error, match=r"^expected \w+, which is not installed: pip install he3-seeker\[geo\]$"
            ):
                write(tmp_path / "out")
            assert not (tmp_path / "out").exists()
