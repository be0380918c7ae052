"""The size of cells of a raster that a user brings to the exam."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.exam_fields import load_field
from he3.errors import InvalidInput

rasterio = pytest.importorskip("rasterio")
pytest.importorskip("pyproj")

Affine = rasterio.Affine
EQUIRECTANGULAR = "+proj=eqc +R=1737400 +units=m"
AT_60_DEG = Affine.translation(0.0, 60.0 * 30_323.35)


def cell_m(folder: Path, crs: str | None, transform: Any) -> float:
    """The side of a cell of the field of a raster of 80 x 100 pixels."""
    values = np.add.outer(np.arange(80.0), np.arange(100.0)).astype(np.float32)
    place: dict[str, Any] = {"height": 80, "width": 100, "crs": crs, "transform": transform, "dtype": "float32"}
    with rasterio.open(folder / "own.tif", "w", driver="GTiff", count=1, **place) as target:
        target.write(values, 1)
    return float(load_field("own.tif", folder).region.grid.resolution_m)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize(
    ("crs", "transform", "wanted"),
    [
        (EQUIRECTANGULAR, Affine.scale(10, -10), 10.0),
        (EQUIRECTANGULAR, Affine.rotation(30) @ Affine.scale(10, -10), 10.0),
        (EQUIRECTANGULAR, Affine.rotation(90) @ Affine.scale(10, -10), 10.0),
        ("+proj=eqc +R=1737400 +units=km", Affine.scale(0.01, -0.01), 10.0),
        ("+proj=longlat +R=1737400", Affine.scale(0.001, -0.001), 30.323),
        (EQUIRECTANGULAR, AT_60_DEG @ Affine.scale(20, -10), 10.0),
        (
            "+proj=stere +lat_0=-90 +k_0=0.5 +R=1737400 +units=m",
            Affine.translation(-200, 200) @ Affine.scale(5, -5),
            10.0,
        ),
        (None, Affine.scale(3, -3), 3.0),
        (None, Affine.identity(), 1.0),
    ],
)
def test_cells_are_as_large_as_pixels_are_on_the_ground(
    tmp_path: Path, crs: str | None, transform: Any, wanted: float
) -> None:
    assert cell_m(tmp_path, crs, transform) == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize(
    ("crs", "transform"),
    [
        (EQUIRECTANGULAR, Affine.scale(10, -20)),
        (EQUIRECTANGULAR, AT_60_DEG @ Affine.scale(10, -10)),
        ("+proj=longlat +R=1737400", Affine.translation(30, 60) @ Affine.scale(0.01, -0.01)),
        (EQUIRECTANGULAR, Affine.shear(30) @ Affine.scale(10, -10)),
    ],
)
def test_pixels_that_are_no_squares_on_the_ground_are_refused(tmp_path: Path, crs: str, transform: Any) -> None:
    with pytest.raises(InvalidInput, match=r"own\.tif: expected square pixels on the ground, got "):
        cell_m(tmp_path, crs, transform)
