"""The covariates of a scenario: layers of its region, and rasters of its cells."""

import math
from dataclasses import replace

import numpy as np
import pytest

from he3.errors import InvalidInput
from he3.reference import METRES_PER_DEGREE
from services.ground.map.geotiff import MODEL_PIXEL_SCALE, MODEL_TIE_POINT, tags
from services.mission.covariates import covariates, trend_of
from services.mission.regions import load_region
from services.mission.scenario import checked_scenario

HILLS = np.add.outer(np.arange(125), np.arange(125)) / 3.0


@pytest.fixture(scope="module")
def region(quarter_of_t1):
    return load_region(quarter_of_t1)


def scenario(quarter, **ground):
    return checked_scenario({"name": "trial", "region": str(quarter), "ground": ground}, "trial")


def test_layers_of_the_region_and_rasters_become_one_trend(region, quarter_of_t1, tmp_path):
    region = replace(region, elevation_m=HILLS.copy())
    raster = np.arange(region.he3_ppb.size, dtype=np.int16).reshape(region.grid.shape)
    np.save(tmp_path / "ramp.npy", raster)
    names = ["elevation_m", str(tmp_path / "ramp.npy")]
    layers = covariates(names, region)
    assert (layers[0] == region.elevation_m).all()
    assert (layers[1] == raster).all()
    trend = trend_of(scenario(quarter_of_t1, covariates=names), region)
    assert trend.layers.shape == (4, *region.grid.shape)
    with_map = trend_of(scenario(quarter_of_t1, covariates=names, prior="orbital"), region)
    assert with_map.layers.shape == (5, *region.grid.shape)
    assert with_map.spread_ppb == pytest.approx(region.orbital_ppb.std())
    assert trend_of(scenario(quarter_of_t1), region) is None


@pytest.mark.parametrize(("hyperparameters", "share"), [("ml", 0.5), ("bayes", 0.8)])
def test_the_gain_of_the_orbital_map_is_known_to_within_a_half_in_the_published_protocol_and_worse_else(
    hyperparameters, share, region, quarter_of_t1
):
    trend = trend_of(scenario(quarter_of_t1, prior="orbital", hyperparameters=hyperparameters), region)
    assert trend is not None
    assert trend.weight_std_ppb == pytest.approx(share * region.orbital_ppb.std())


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("he3_ppb", None, "expected orbital_ppb, elevation_m, slope_deg, or a file"),
        ("none.npy", None, "found none"),
        ("small.npy", np.zeros((3, 3)), r"numbers of shape \(125, 125\)"),
        ("holes.npy", np.full((125, 125), np.nan), "a value on every cell"),
        (
            "marks.npy",
            np.where(np.eye(125) > 0, -9999.0, HILLS),
            "a value on every cell, got -9999, which marks missing",
        ),
        ("ends.npy", np.where(np.eye(125) > 0, 255, HILLS).astype(np.uint8), "got 255, which marks missing values"),
        (
            "hot.npy",
            np.where(np.add.outer(np.arange(125), 1000 * np.arange(125)) == 4003, 1e6, HILLS),
            "as the others, 0 to 82.6667, got 1e\\+06 in 1 cell, at row 3, column 4: such values hide",
        ),
        ("cold.npy", np.where(np.add.outer(np.arange(125), HILLS[0]) < 1.5, -5e4, HILLS), "got -50000 in 7 cells"),
        ("text.npy", b"no array", "an array that NumPy reads"),
        ("text.tif", b"no raster", "expected a TIFF file"),
    ],
)
def test_what_is_no_covariate_is_refused_in_one_line(name, content, why, region, tmp_path):
    path = tmp_path / name
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        np.save(path, content)
    with pytest.raises(InvalidInput, match=why) as refusal:
        covariates([name if name == "he3_ppb" else str(path)], region)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("number", [-1.0, 7.5, -3.4028226550889045e38])
def test_a_raster_with_cells_of_its_own_no_data_value_is_no_covariate(number, region, tmp_path):
    rasterio = pytest.importorskip("rasterio")
    values = HILLS.copy()
    values[3, 4] = number
    path = tmp_path / "hills.tif"
    with rasterio.open(
        path, "w", driver="GTiff", height=125, width=125, count=1, dtype="float32", nodata=number,
        transform=rasterio.Affine(4.0, 0.0, 0.0, 0.0, -4.0, 500.0),
    ) as target:  # fmt: skip
        target.write(values.astype("float32"), 1)
    with pytest.raises(InvalidInput, match=r"got none \(the raster's no-data value, .*\) in 1 cell"):
        covariates([str(path)], region)


@pytest.mark.parametrize("inside", [True, False])
def test_a_raster_whose_mask_hides_cells_is_no_covariate(inside, region, tmp_path):
    rasterio = pytest.importorskip("rasterio")
    path = tmp_path / "hills.tif"
    cell = region.grid.resolution_m
    place = {"height": 125, "width": 125, "transform": rasterio.Affine(cell, 0.0, 0.0, 0.0, -cell, 125 * cell)}
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=inside),
        rasterio.open(path, "w", driver="GTiff", count=1, dtype="float32", **place) as target,
    ):
        target.write(HILLS.astype("float32"), 1)
        target.build_overviews([2, 4])
        target.write_mask(HILLS > 3)
    with pytest.raises(InvalidInput, match="a value on every cell, got a raster with a mask"):
        covariates([str(path)], region)
    with rasterio.open(path, "w", driver="GTiff", count=1, dtype="float32", **place) as target:
        target.write(HILLS.astype("float32"), 1)
        target.build_overviews([2, 4])
    path.with_name("hills.tif.msk").unlink(missing_ok=True)
    assert covariates([str(path)], region)[0] == pytest.approx(HILLS[::-1])


def test_a_mask_of_0_and_255_is_a_covariate(region, tmp_path):
    mask = np.where(HILLS > 40, 255, 0).astype(np.uint8)
    np.save(tmp_path / "mask.npy", mask)
    assert (covariates([str(tmp_path / "mask.npy")], region)[0] == mask).all()


def test_a_raster_of_rare_high_places_is_a_covariate(region, tmp_path):
    rare = np.where(HILLS > 82, 5.0 * HILLS, HILLS)  # 4 cells of 15,625, at five times the highest of the others
    np.save(tmp_path / "rare.npy", rare)
    assert (covariates([str(tmp_path / "rare.npy")], region)[0] == rare).all()


@pytest.mark.parametrize("point", [False, True])
def test_a_raster_that_lies_elsewhere_is_no_covariate_of_a_region_with_a_projection(point, region, tmp_path):
    rasterio = pytest.importorskip("rasterio")
    cell, north = region.grid.resolution_m, 600_000.0 + region.grid.height_m
    placed = replace(region, crs="+proj=eqc +R=1737400", origin_x_m=-50.0, origin_y_m=600_000.0)

    def written(name, transform, crs=None):
        shape = {"height": 125, "width": 125, "count": 1, "dtype": "float32"}
        with rasterio.open(tmp_path / name, "w", driver="GTiff", crs=crs, transform=transform, **shape) as target:
            target.update_tags(AREA_OR_POINT="Point" if point else "Area")
            target.write(HILLS.astype("float32"), 1)
        return str(tmp_path / name)

    def raster(name, cell_m, west_m, north_m):
        return written(name, rasterio.Affine(cell_m, 0.0, west_m, 0.0, -cell_m, north_m), placed.crs)

    for number, (cell_m, west_m, north_m) in enumerate(
        [(cell, -50.0 + cell, north), (cell, -50.0, north - 100.0), (2.0 * cell, -50.0, north)]
    ):
        with pytest.raises(InvalidInput, match=r"expected the region's own cells, of .* got "):
            covariates([raster(f"{number}.tif", cell_m, west_m, north_m)], placed)
    here = raster("here.tif", cell, -50.0, north)
    assert covariates([here], placed)[0] == pytest.approx(HILLS[::-1])
    assert covariates([raster("far.tif", cell, 0.0, 0.0)], region)[0] == pytest.approx(HILLS[::-1])
    for transform in (rasterio.Affine(4.0, 0.0, 0.0, 0.0, 4.0, 0.0), rasterio.Affine.rotation(30.0)):
        with pytest.raises(InvalidInput, match="expected a raster with row 0 in the north"):
            covariates([written("up.tif", transform)], region)


@pytest.mark.parametrize("place", [(60.0, 30.0), (-80.0, 200.0), None])
def test_a_raster_with_cells_of_another_size_is_no_covariate_of_a_region_without_a_projection(place, region, tmp_path):
    rasterio = pytest.importorskip("rasterio")
    latitude, longitude = place or (None, None)
    placed = replace(region, origin_lat_deg=latitude, origin_lon_deg=longitude)
    cell, size = region.grid.resolution_m, region.grid.height_m

    def read(width_m, height_m, west, north, degrees=False):
        crs = "+proj=longlat +R=1737400" if degrees else "+proj=eqc +R=1737400"
        shape = {"height": 125, "width": 125, "count": 1, "dtype": "float32", "crs": crs}
        transform = rasterio.Affine(width_m, 0.0, west, 0.0, -height_m, north)
        with rasterio.open(tmp_path / "one.tif", "w", driver="GTiff", transform=transform, **shape) as target:
            target.write(HILLS.astype("float32"), 1)
        return covariates([str(tmp_path / "one.tif")], placed)[0]

    assert read(cell, cell, 5.0, 700.0) == pytest.approx(HILLS[::-1])
    for width_m, height_m in ((2.0 * cell, 2.0 * cell), (cell, 1.1 * cell), (1.0, 1.0)):
        with pytest.raises(InvalidInput, match=rf"region's own cells, of {cell:g} m, got cells of "):
            read(width_m, height_m, 5.0, 700.0)
    if place is None:
        return
    middle = math.radians(latitude + size / 2 / METRES_PER_DEGREE)
    high = cell / METRES_PER_DEGREE
    wide, north = high / math.cos(middle), latitude + size / METRES_PER_DEGREE
    assert read(wide, high, longitude, north, degrees=True) == pytest.approx(HILLS[::-1])
    assert read(wide, high, longitude - 360.0, north, degrees=True) == pytest.approx(HILLS[::-1])
    for west, top in ((longitude + wide, north), (longitude, north + high), (-longitude, north)):
        with pytest.raises(InvalidInput, match=r"expected a raster whose north-west corner lies at "):
            read(wide, high, west, top, degrees=True)
    with pytest.raises(InvalidInput, match=rf"region's own cells, of {cell:g} m, got cells of "):
        read(1 / 512, 1 / 512, longitude, north, degrees=True)


@pytest.mark.parametrize("place", [(60.0, 30.0), (-80.0, 200.0), None])
def test_a_layer_that_was_saved_from_the_map_is_a_covariate(place, region, tmp_path):
    rasterio = pytest.importorskip("rasterio")
    latitude, longitude = place or (None, None)
    placed = replace(region, origin_lat_deg=latitude, origin_lon_deg=longitude)
    saved = tags(place, region.grid.height_m, 0.0, region.grid.height_m, region.grid.resolution_m)
    (width, height, _), (_, _, _, west, north, _) = saved[MODEL_PIXEL_SCALE][1], saved[MODEL_TIE_POINT][1]
    shape = {"height": 125, "width": 125, "count": 1, "dtype": "float32", "crs": "+proj=eqc +R=1737400"}
    transform = rasterio.Affine(width, 0.0, west, 0.0, -height, north)
    with rasterio.open(tmp_path / "saved.tif", "w", driver="GTiff", transform=transform, **shape) as target:
        target.write(HILLS.astype("float32"), 1)
    assert covariates([str(tmp_path / "saved.tif")], placed)[0] == pytest.approx(HILLS[::-1])


def test_a_layer_with_one_value_everywhere_is_no_covariate(region, tmp_path):
    level = np.zeros(region.grid.shape)
    np.save(tmp_path / "level.npy", level + 3.0)
    flat = replace(region, elevation_m=level, slope_deg=level.copy())
    for name, value in ((str(tmp_path / "level.npy"), 3), ("elevation_m", 0), ("slope_deg", 0)):
        with pytest.raises(InvalidInput, match=rf"expected values that differ from cell to cell, got {value} on all"):
            covariates([name], flat)
