"""What the GeoTIFFs of a region's folder say of themselves: scales, units, no-data values, and where they lie."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from he3.errors import InvalidInput
from services.mission.regions import load_region, load_window

rasterio = pytest.importorskip("rasterio")

HELIUM3 = np.add.outer(np.arange(40) * 0.1, np.arange(50) * 0.05) + 3.0  # row 0 south
EQC = "+proj=eqc +lat_ts=20 +R=1737400 +units=m"


def layer(
    path: Path, values: Any, *, cell: Any = (2.0, -2.0), crs: str = EQC, north: float = 680.0, **facts: Any
) -> None:
    """Write an array with row 0 south as a GeoTIFF, north up, its west edge at 100 m and its south edge at 600 m."""
    data = np.flipud(values)
    profile = {"driver": "GTiff", "count": 1, "height": 40, "width": 50, "dtype": data.dtype.name, "crs": crs}
    transform = rasterio.Affine(cell[0], 0.0, 100.0, 0.0, cell[1], north)
    with rasterio.open(path, "w", **profile, transform=transform, nodata=facts.pop("nodata", None)) as target:
        target.write(data, 1)
        for key, value in facts.items():
            setattr(target, key, (value,))


def region(folder: Path, **keys: Any) -> Any:
    """Write the document of a folder with the layers he3_ppb and traversable, and load it."""
    words = {"resolution_m": 2.0} | keys
    lines = [f"{key} = {value!r}" for key, value in words.items()]
    (folder / "region.toml").write_text(
        'format = "he3-region"\nversion = 1\nkind = "site"\nname = "own"\ntitle = "own"\nprovenance = "own"\n'
        + "\n".join(lines)
        + '\n[layers.he3_ppb]\nkind = "real"\nsource = "own"\nfile = "he3.tif"\n'
        '[layers.traversable]\nkind = "real"\nsource = "own"\nfile = "open.tif"\n'
    )
    return load_region(folder)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    layer(tmp_path / "he3.tif", HELIUM3)
    layer(tmp_path / "open.tif", np.ones(HELIUM3.shape, dtype=np.uint8))
    return tmp_path


def test_rasters_on_the_documents_cells_are_read(folder: Path) -> None:
    for keys in ({}, {"crs": EQC, "origin_x_m": 100.0, "origin_y_m": 600.0}):
        assert np.allclose(region(folder, **keys).he3_ppb, HELIUM3)


@pytest.mark.parametrize(
    ("facts", "said"),
    [
        ({"scales": 0.1}, "expected values, got numbers with scale 0.1 and offset 0"),
        ({"offsets": 2.0}, "expected values, got numbers with scale 1 and offset 2"),
        ({"units": "ppm"}, "expected values in the unit of the layer, got 'ppm'"),
        ({"cell": (2.0, 2.0), "north": 600.0}, "expected a raster with row 0 in the north"),
        ({"cell": (1.0, -1.0)}, "expected cells of resolution_m, 2 m, got 1 m"),
        ({"cell": (1e-4, -1e-4), "crs": "IAU_2015:30100", "north": 20.0}, "2 m, got 3.03234 m"),
    ],
)
def test_a_raster_whose_file_says_that_it_is_something_else_is_refused(
    folder: Path, facts: dict[str, Any], said: str
) -> None:
    layer(folder / "he3.tif", HELIUM3, **facts)
    with pytest.raises(InvalidInput, match=rf"he3\.tif: layer he3_ppb: .*{said}"):
        region(folder)


@pytest.mark.parametrize("moved", [{"origin_x_m": 120.0}, {"origin_y_m": 590.0}])
def test_a_raster_that_does_not_lie_where_the_document_says_is_refused(folder: Path, moved: dict[str, float]) -> None:
    with pytest.raises(InvalidInput, match=r"expected square cells from \(\d+, \d+\) m on"):
        region(folder, **({"crs": EQC, "origin_x_m": 100.0, "origin_y_m": 600.0} | moved))


@pytest.mark.parametrize(("dtype", "nodata"), [("float32", -3.4028226550889045e38), ("int16", 0), ("uint8", 255)])
def test_cells_of_the_files_no_data_value_are_unknown_and_closed(folder: Path, dtype: str, nodata: float) -> None:
    values = np.rint(HELIUM3).astype(dtype)
    values[3:6, 7:9] = nodata
    layer(folder / "he3.tif", values, nodata=nodata)
    found = region(folder)
    assert found.known is not None
    assert (~found.known).sum() == 6
    assert not found.known[3:6, 7:9].any()
    assert not found.traversable[3:6, 7:9].any()
    assert found.he3_ppb.min() >= 3.0


def test_a_layer_that_has_to_be_whole_is_refused_with_no_data_cells(folder: Path) -> None:
    orbital = HELIUM3.astype(np.int16)
    orbital[0, 0] = 0
    layer(folder / "orbital.tif", orbital, nodata=0)
    region(folder)
    document = (folder / "region.toml").read_text()
    more = '[layers.orbital_ppb]\nkind = "real"\nsource = "own"\nfile = "orbital.tif"\n'
    (folder / "region.toml").write_text(document + more)
    with pytest.raises(InvalidInput, match="orbital_ppb"):
        load_region(folder)


def test_the_embedded_regions_are_read_as_before() -> None:
    for name in ("t1", "t2"):
        assert np.isfinite(load_window(name).iron_wt).all()


@pytest.mark.parametrize("steers", [r"\u001b[2J", r"\u009b2J", r"\u202e", r"\u2066", r"\n"])
def test_a_text_that_would_steer_a_terminal_is_refused(folder: Path, steers: str) -> None:
    region(folder)
    document = folder / "region.toml"
    document.write_text(document.read_text().replace('title = "own"', f'title = "{steers}"'))
    with pytest.raises(InvalidInput, match="title") as refusal:
        load_region(folder)
    assert str(refusal.value).isprintable()
