"""The benchmark on real places: where a mission begins, and how steep the original raster is below its path."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import places
from benchmarks.places import PLACES, run, start_of, steepest_deg
from he3.errors import InvalidInput
from he3.terrain import reachable
from schemas.maps import ReachScore
from services.mission.region_build.build import build_region
from services.mission.region_build.recipe import Recipe
from services.mission.region_folder import checked
from services.mission.regions import load_region

pytest.importorskip("rasterio")
pytest.importorskip("pyproj")

GRID = {"centre_lat_deg": 20.0, "centre_lon_deg": 30.0, "resolution_m": 5.0}


def test_a_path_is_held_against_the_slopes_of_the_original_raster(tmp_path: Path) -> None:
    """Ground that rises eastward by 5 deg, and by 30 deg in a band of 50 m: x from 75 to 125 m of the site."""
    x = (np.arange(120) - 59.5) * 5.0
    slope = np.where(np.abs(x) < 25, 30.0, 5.0)
    heights = np.cumsum(np.tan(np.radians(slope)) * 5.0)
    np.save(tmp_path / "dem.npy", np.tile(heights, (120, 1)).astype(np.float32))
    terrain = {"file": "dem.npy", "source": "made", "grid": GRID}
    recipe = checked(Recipe, {
        "format": "he3-region-recipe", "version": 1, "name": "band", "title": "Band", "centre_lat_deg": 20.0,
        "centre_lon_deg": 30.0, "rows": 40, "columns": 40, "resolution_m": 5.0, "chemistry": {"lay_over": "t1"},
        "layers": {"elevation_m": terrain},
    }, tmp_path)  # fmt: skip
    build_region(recipe, tmp_path, tmp_path / "region")
    region = load_region(tmp_path / "region")
    place = replace(PLACES["apollo-17"], terrain=terrain)
    assert steepest_deg(place, tmp_path, region, np.array([(10.0, 10.0), (10.0, 190.0)])) == pytest.approx(
        5.0, abs=0.01
    )
    crossing = steepest_deg(place, tmp_path, region, np.array([(10.0, 10.0), (190.0, 10.0)]))
    assert crossing == pytest.approx(30.0, abs=0.01)
    assert not region.traversable[:, 16:24].any()
    assert region.traversable[20, 2]
    rows, columns = region.grid.cells_of(np.array([start_of(region)]))
    assert region.traversable[rows[0], columns[0]]


def test_the_error_out_of_reach_is_that_of_the_other_cells() -> None:
    region = load_region("t1")
    reached = reachable(places._ground(region), region.grid, (25.0, 25.0))
    errors = np.random.default_rng(7).normal(0.0, np.where(reached, 0.5, 1.5))
    score = ReachScore(
        share=float(reached.mean()), rmse_ppb=float(np.sqrt(np.mean(errors[reached] ** 2))), coverage_68=0.7,
        coverage_95=0.95,
    )  # fmt: skip
    report = SimpleNamespace(rmse_ppb=float(np.sqrt(np.mean(errors**2))), within_reach=score)
    row = places._within_reach(region, (25.0, 25.0), report)
    assert row["rmse_within_reach_ppb"] == score.rmse_ppb
    assert row["rmse_out_of_reach_ppb"] == pytest.approx(float(np.sqrt(np.mean(errors[~reached] ** 2))))
    everywhere = places._within_reach(region, (25.0, 25.0), SimpleNamespace(rmse_ppb=0.6, within_reach=None))
    assert (everywhere["rmse_within_reach_ppb"], everywhere["rmse_out_of_reach_ppb"]) == (0.6, None)


def test_without_data_or_with_unknown_names_it_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="expected --data DIR with the rasters"):
        run()
    with pytest.raises(InvalidInput, match=r"expected names out of .*, got 'tycho'"):
        run(tmp_path, places=("tycho",))
