"""The fields of the exam: rasters as they come, and rasters that are none."""

import os
from pathlib import Path

import numpy as np
import pytest

from benchmarks.exam_fields import MOST_CELLS, NOISE_SHARE, SOURCES, SPAN_PPB, coarser, load_field, names_in
from he3.errors import InvalidInput

SLOPE = np.add.outer(np.arange(20.0), np.zeros(30))


def test_a_raster_of_a_user_becomes_a_field_of_twenty_ppb(tmp_path):
    np.save(tmp_path / "slope.npy", 100.0 + 3.0 * SLOPE)
    assert names_in(tmp_path)[-1] == "slope.npy"
    field = load_field("slope.npy", tmp_path)
    assert (field.region.he3_ppb.min(), field.region.he3_ppb.max()) == (0.0, SPAN_PPB)
    assert field.region.grid.shape == (20, 30)
    assert field.noise_std_ppb == pytest.approx(NOISE_SHARE * field.region.he3_ppb.std())
    assert load_field("slope.npy", tmp_path, 0.2).noise_std_ppb == pytest.approx(4 * field.noise_std_ppb)
    assert field.region.traversable.all()


def test_cells_without_a_value_are_closed_and_do_not_count(tmp_path):
    values = SLOPE.copy()
    values[:3, :4], values[10, 10] = np.nan, -np.inf
    np.save(tmp_path / "holes.npy", values)
    field = load_field("holes.npy", tmp_path)
    assert (~field.known).sum() == 13
    assert (field.region.traversable == field.known).all()
    assert np.isfinite(field.region.he3_ppb).all()


def test_a_region_of_a_user_keeps_its_obstacles(tmp_path):
    walled = np.ones(SLOPE.shape, dtype=np.bool_)
    walled[:12, 7] = False
    unknown = SLOPE.copy()
    unknown[15, 20] = np.nan
    np.savez(tmp_path / "wall.npz", he3_ppb=unknown, traversable=walled, resolution_m=2.0)
    field = load_field("wall.npz", tmp_path)
    assert (field.region.traversable == (walled & field.known)).all()
    assert (~field.known).sum() == 1
    assert field.region.grid.resolution_m == 2.0


def test_a_block_of_a_large_region_is_closed_where_half_of_its_cells_are(tmp_path):
    values = np.add.outer(np.arange(MOST_CELLS + 2.0), np.zeros(40))
    walled = np.ones(values.shape, dtype=np.bool_)
    walled[4, 6:8] = walled[10:12, 20] = walled[20, 30] = False
    np.savez(tmp_path / "large.npz", he3_ppb=values, traversable=walled, resolution_m=2.0)
    region = load_field("large.npz", tmp_path).region
    assert region.grid.resolution_m == 4.0
    assert np.argwhere(~region.traversable).tolist() == [[2, 3], [5, 10]]


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_pixels_that_an_alpha_band_hides_have_no_value(dtype, tmp_path):
    rasterio = pytest.importorskip("rasterio")
    shown = np.ones((20, 30))
    shown[:3, :4] = 0
    place = {"height": 20, "width": 30, "transform": rasterio.Affine(2.0, 0.0, 0.0, 0.0, -2.0, 40.0)}
    with rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", count=2, dtype=dtype, alpha="yes", **place) as target:
        target.write(np.stack([SLOPE, shown]).astype(dtype))
    field = load_field("a.tif", tmp_path)
    assert (~field.known).sum() == 12
    assert field.region.grid.resolution_m == 2.0


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("row_0", ["north", "south", "not said"])
def test_the_south_of_a_raster_is_that_of_its_field_whichever_row_comes_first(row_0, tmp_path):
    rasterio = pytest.importorskip("rasterio")
    transforms = {"north": rasterio.Affine(2.0, 0.0, 0.0, 0.0, -2.0, 40.0), "south": rasterio.Affine.scale(2.0)}
    place = {"height": 20, "width": 30, "count": 1, "dtype": "float32"}
    if row_0 in transforms:
        place |= {"transform": transforms[row_0], "crs": "+proj=eqc +R=1737400"}
    with rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", **place) as target:
        target.write((SLOPE if row_0 == "south" else SLOPE[::-1]).astype("float32"), 1)
    field = load_field("a.tif", tmp_path).region.he3_ppb
    assert (field[0] == 0.0).all()
    assert (field[-1] == SPAN_PPB).all()


def test_a_large_raster_is_averaged_over_blocks_and_keeps_its_size_in_metres():
    values = np.add.outer(np.arange(2.0 * MOST_CELLS + 1), np.zeros(10))
    values[0, 0] = np.nan
    coarse, cell_m = coarser(values, 5.0)
    assert coarse.shape == (267, 3)
    assert cell_m == 15.0
    assert coarse[0, 0] == pytest.approx((2 * 0 + 3 * 1 + 3 * 2) / 8)
    assert coarse[5, 2] == pytest.approx(16.0)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (np.zeros((20, 20)), "a field that varies"),
        (np.zeros(50), "rows and columns"),
        (np.array([["a"] * 20] * 20), "expected numbers"),
        (np.eye(8), "at least 16 x 16 cells"),
        (np.where(np.eye(20) > 0, 1.0, np.nan), "cells with a value"),
        (np.where(np.eye(30)[:20] > 0, -9999.0, SLOPE), "-9999, which marks missing values, in 20 cells"),
        (np.where(np.eye(30)[:20] > 0, -32768, SLOPE).astype(np.int16), "-32768, which marks missing values"),
    ],
)
def test_what_is_no_field_is_refused_in_one_line_that_names_the_file(content, why, tmp_path):
    np.save(tmp_path / "bad.npy", content)
    with pytest.raises(InvalidInput, match=why) as refusal:
        load_field("bad.npy", tmp_path)
    assert "bad.npy" in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", ["text.npy", "text.npz", "text.tif"])
def test_a_damaged_file_is_refused(name, tmp_path):
    if name.endswith("tif"):
        pytest.importorskip("rasterio")
    (tmp_path / name).write_text("no raster\n")
    with pytest.raises(InvalidInput, match=name):
        load_field(name, tmp_path)


def test_names_that_there_are_not_are_refused_with_those_that_there_are(tmp_path):
    with pytest.raises(InvalidInput, match="expected fields out of t1, t2; got 'walker-u'"):
        load_field("walker-u", tmp_path)
    with pytest.raises(InvalidInput, match="expected --data DIR"):
        names_in(tmp_path / "nothing")


@pytest.mark.parametrize("name", SOURCES)
def test_the_published_fields_are_read_with_their_own_spread(name):
    data = os.environ.get("HE3_REAL_DATA")
    if not data:
        pytest.skip("HE3_REAL_DATA names no folder of real data")
    if not SOURCES[name].file.endswith(("npy", "csv")):
        pytest.importorskip("rasterio")
    field = load_field(name, Path(data))
    assert field.known.mean() > 0.9
    assert 0 < field.noise_std_ppb < 0.1 * field.region.he3_ppb[field.known].std()
