"""Missions on real places: terrain and chemistry of orbital products, at their own resolution and resampled to 1 m.

The data stay outside of the project; docs/regions.md tells where they come from. Where a place has no chemistry, that
of a stand-in is laid over it; where it has FeO alone, OMAT is assumed; each report says so. A mission is flown whole in
one process: field, rover, link and ground. Its path is then held against the slopes of the original raster. They are
computed here with rasterio and NumPy alone, and the path is placed on the raster by the region's corner and formulas
of its own: nothing of the code that builds regions takes part. RMSE is against the region that was built, as the true
field is not known: over all cells, and over the ground that the rover can reach, where samples can come from.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite, sqrt
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks import kept
from benchmarks.data_folder import expect_rasters
from benchmarks.flights import Conditions, conditions, expect_open
from benchmarks.tasks import Tasks, progress
from he3.constants import MOON_RADIUS_M
from he3.errors import He3Error, InvalidInput
from he3.frames import FloatArray
from he3.hyperparameters import DEFAULT_NOISE_STD_PPB
from he3.reference import Region
from he3.terrain import reachable
from services.ground.terrain import GroundTerrain
from services.mission.region_build.build import build_region
from services.mission.region_build.recipe import Recipe
from services.mission.region_folder import checked
from services.mission.regions import load_region
from services.mission.scenario import RoverConfig, checked_scenario

if TYPE_CHECKING:
    from schemas.report import MissionReport

Row = dict[str, Any]

_PLANNER: Final = "real/leggedrobotics+lunar_planner/user_data/map_data"
_PERIOD_S: Final = 60.0  # s, between reports over cells of 1 m; a site of many kilometres takes weeks
_LONGEST_PERIOD_S: Final = 600.0  # s
_CLEAR_M: Final = 3.0  # m of open ground around the start
_LIMIT_DEG: Final = 15.0  # the rover's limit, by which the regions' ground is closed


@dataclass(frozen=True, slots=True)
class Place:
    """A real place: its terrain, its chemistry, and the part that is flown at the raster's own resolution."""

    title: str
    terrain: dict[str, Any]
    chemistry: dict[str, Any]
    further: dict[str, dict[str, Any]]
    """Layers of measured chemistry."""
    centre_deg: tuple[float, float]
    """Of the whole, at the raster's own resolution."""
    detail_deg: tuple[float, float]
    """Of the windows of 500 m and 1 km: ground that is not all too steep."""
    own: tuple[int, int, float]
    """Rows, columns and cell [m] at the raster's own resolution."""


PLACES: Final = {
    "apollo-17": Place(
        "Apollo 17, LROC NAC terrain",
        {"file": "apollo17_lm_dem_5m.npy", "source": "LROC NAC DTM of Apollo 17", "citation": "NASA/GSFC/ASU",
         "grid": {"centre_lat_deg": 20.19113, "centre_lon_deg": 30.77229, "resolution_m": 5.0}},
        {"lay_over": "t1"}, {}, (20.19113, 30.77229), (20.19113, 30.77229), (370, 370, 5.0),
    ),
    "herodotus": Place(
        "Mons Herodotus, QuickMap terrain and Kaguya FeO",
        {"file": f"{_PLANNER}/Herodutus_Mons/hsr.tif", "band": "qts_demstack", "source": "QuickMap DEM stack"},
        {"assumed_maturity": 0.2},
        {"iron_wt": {"file": f"{_PLANNER}/Herodutus_Mons/clino_feo_tio_plagio.tif", "band": "lk_feo",
                     "source": "FeO of Kaguya MI"}},
        (27.4895, -52.957), (27.40, -52.957), (176, 240, 53.634071),
    ),
    "aristarchus-imp": Place(
        "Aristarchus, irregular mare patch",
        {"file": f"{_PLANNER}/Aristarchus_IMP/hsr.tif", "band": "qts_demstack", "source": "QuickMap DEM stack"},
        {"lay_over": "t1"}, {}, (25.047646, -46.76548), (25.047646, -46.76548), (206, 226, 4.764721),
    ),
    "aristarchus-cp": Place(
        "Aristarchus, central peak",
        {"file": f"{_PLANNER}/Aristarchus_CP/data.tif", "band": "qts_demstack", "source": "QuickMap DEM stack"},
        {"lay_over": "t1"}, {}, (23.80, -47.23), (23.80, -47.23), (228, 240, 214.023094),
    ),
}  # fmt: skip
SIZES: Final = ("own", "500m", "1km")


def run(
    data: Path | None = None,
    places: Sequence[str] = tuple(PLACES),
    sizes: Sequence[str] = SIZES,
    planners: Sequence[str] = ("rrtstar", "tour"),
    rounds: int = 30,
    seed: int = 1,
    noise: float = DEFAULT_NOISE_STD_PPB,
    start: Sequence[float] = (),
    budget: float | None = None,
    jobs: int = 2,
    out: Path | None = None,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """One row a mission; the table printed, rows written to `json`, reports and pictures to folders in `out`.

    data: folder with the rasters. noise: standard deviation [ppb]; start: X,Y [m], of every place; budget: metres.
    Raises InvalidInput for names that are not known, numbers that do not fit and rasters that are missing; He3Error,
    after the table, if a mission missed samples or a path led over a pixel that is too steep.
    """
    for given, known in ((places, tuple(PLACES)), (sizes, SIZES)):
        for name in given:
            if name not in known:
                raise InvalidInput(f"expected names out of {', '.join(known)}, got {name!r}")
    data = expect_rasters(data, "docs/regions.md", files_of(places))
    shared = conditions(noise, start, budget)
    rows: list[Row] = []
    failures: list[str] = []
    with TemporaryDirectory() as scratch:
        root = Path(scratch) if out is None else out
        flights = [
            (data, root, place, size, planner, rounds, seed, shared)
            for place in places
            for size in sizes
            for planner in planners
        ]
        with Tasks(jobs) as pool:
            for flight, outcome in pool.results(_outcome, flights):
                name = f"{flight[2]} {flight[3]} {flight[4]}"
                if isinstance(outcome, str):
                    failures.append(f"{name}: {outcome}")
                    progress(f"  {name}: failed: {outcome}")
                    continue
                rows.append(outcome)
                if outcome["problem"]:
                    failures.append(f"{name}: {outcome['problem']}")
                kept.write_whole(json, rows)  # what is flown is kept, whatever happens to the rest
                progress(f"  {len(rows):>3}/{len(flights)}  {name}  {outcome['wall_time_s']:.0f} s")
    order = {name: index for index, name in enumerate(places)}
    rows.sort(key=lambda row: (order[row["place"]], SIZES.index(row["size"]), row["planner"]))
    for line in (*table(rows), "", *sources(rows)):
        say(line)
    kept.write_whole(json, rows)
    if failures:
        raise He3Error(f"{len(failures)} of the missions failed, the first: {failures[0]}")
    return rows


def files_of(places: Sequence[str]) -> list[str]:
    """The files of those places, relative to the folder of data."""
    layers = [layer for name in places for layer in (PLACES[name].terrain, *PLACES[name].further.values())]
    return [layer["file"] for layer in layers]


def recipe_of(place: Place, size: str, name: str) -> Recipe:
    """The recipe of a place at one of the sizes."""
    rows, columns, cell = place.own if size == "own" else (500, 500, 1.0) if size == "500m" else (1000, 1000, 1.0)
    centre = place.centre_deg if size == "own" else place.detail_deg
    return checked(Recipe, {
        "format": "he3-region-recipe", "version": 1, "name": f"{name}-{size}", "title": f"{place.title}, {size}",
        "centre_lat_deg": centre[0], "centre_lon_deg": centre[1], "rows": rows, "columns": columns,
        "resolution_m": cell, "chemistry": place.chemistry, "layers": {"elevation_m": place.terrain, **place.further},
    }, Path(name))  # fmt: skip


def _outcome(flight: tuple[Path, Path, str, str, str, int, int, Conditions]) -> Row | str:
    try:
        return fly(*flight)
    except He3Error as error:
        return str(error)


def fly(
    data: Path, root: Path, name: str, size: str, planner: str, rounds: int, seed: int, shared: Conditions,
    cost: str = "distance", hyperparameters: str = "", kernel: str = "",
) -> Row:  # fmt: skip
    """Build the region, fly one mission over it, and return its row.

    cost, hyperparameters, kernel: of the ground; empty for its default.
    """
    from services.console.launch.in_process import run_in_process
    from services.console.report.outputs import outputs
    from services.console.report.progress import SilentProgress

    place = PLACES[name]
    folder = root / (f"{name}-{size}-{planner}" + ("" if cost == "distance" else f"-{cost}"))
    build_region(recipe_of(place, size, name), data, folder / "region")
    region = load_region(folder / "region")
    expect_open(region, shared.start_m)
    period_s = min(_LONGEST_PERIOD_S, _PERIOD_S * max(1.0, region.grid.resolution_m))
    scenario = checked_scenario({
        "name": f"{name}-{size}", "region": str(folder / "region"), "seed": seed, "rounds": rounds,
        "start_m": shared.start_m or start_of(region),
        "field": {"noise_std_ppb": shared.noise_std_ppb},
        "ground": {"planner": planner, "status_period_s": period_s, "cost": cost,
                   **({"hyperparameters": hyperparameters} if hyperparameters else {}),
                   **({"kernel": kernel} if kernel else {}),
                   **({"budget_m": shared.budget_m} if isfinite(shared.budget_m) else {})},
        "rover": {"state_period_s": period_s},
    }, "places")  # fmt: skip
    began = time.monotonic()
    report = run_in_process(scenario, outputs(folder / "run", folder / "run" / "report.json"), SilentProgress()).report
    steepest = steepest_deg(place, data, region, np.array(report.path_m, dtype=np.float64))
    problem = ""
    if not report.completed or report.samples < report.samples_wanted:
        problem = f"ended with {report.samples} of {report.samples_wanted} samples: {report.detail}"
    elif not steepest <= _LIMIT_DEG:
        problem = f"expected a path over at most {_LIMIT_DEG:g} deg of the original raster, got {steepest:.2f} deg"
    return {
        "cost": cost, "driving": None if report.driving is None else report.driving.model_dump(),
        "place": name, "size": size, "planner": planner, "cells": region.grid.columns * region.grid.rows,
        "width_m": region.grid.width_m, "samples": report.samples, "rmse_ppb": report.rmse_ppb,
        "std_ppb": float(region.of_known(region.he3_ppb).std()), "path_length_m": report.path_length_m,
        "coverage_68": report.coverage_68, "coverage_95": report.coverage_95, "steepest_deg": steepest,
        "closed": region.untraversable_fraction, "reached": reached_share(region, scenario.start_m),
        "mission_time_h": report.mission_time_s / 3600.0, "wall_time_s": time.monotonic() - began,
        "provenance": region.provenance, "problem": problem, **_within_reach(region, scenario.start_m, report),
    }  # fmt: skip


def _ground(region: Region) -> NDArray[np.bool_]:
    """Where the centre of a rover of the usual footprint may be."""
    return GroundTerrain(region.grid, region.traversable, RoverConfig().footprint_radius_m).traversable


def reached_share(region: Region, start_m: tuple[float, float]) -> float:
    """Share of the ground on which the rover may be that it can reach from its start [m]."""
    ground = _ground(region)
    return float(reachable(ground, region.grid, start_m).sum() / ground.sum())


def _within_reach(region: Region, start_m: tuple[float, float], report: MissionReport) -> Row:
    """RMSE within and out of the rover's reach from its start [m], and the field's standard deviation there [ppb].

    The error out of reach follows from that over all cells; None where every cell is within reach.
    """
    score, rmse_ppb, beyond_ppb = report.within_reach, report.rmse_ppb, None
    if score is not None and report.rmse_ppb is not None:
        rmse_ppb = score.rmse_ppb
        beyond_ppb = sqrt(max(0.0, report.rmse_ppb**2 - score.share * score.rmse_ppb**2) / (1.0 - score.share))
    reached = reachable(_ground(region), region.grid, start_m)
    return {
        "rmse_within_reach_ppb": rmse_ppb,
        "rmse_out_of_reach_ppb": beyond_ppb,
        "std_within_reach_ppb": float(region.he3_ppb[reached].std()),
    }


def start_of(region: Region) -> tuple[float, float]:
    """A place near the south-west corner of the largest connected ground for a rover, with room around it [m]."""
    cell = region.grid.resolution_m
    room = max(0, round(_CLEAR_M / cell))
    labels, count = ndimage.label(_ground(region))
    largest = labels == 1 + int(np.argmax(np.bincount(labels.ravel(), minlength=count + 1)[1:]))
    size = 2 * max(room, 1) + 1
    clear = ndimage.binary_erosion(largest, np.ones((size, size)))
    rows, columns = np.nonzero(clear if clear.any() else largest)
    nearest = int(np.argmin(rows + columns))
    return float((columns[nearest] + 0.5) * cell), float((rows[nearest] + 0.5) * cell)


@dataclass(frozen=True, slots=True)
class Original:
    """A raster as it came: its slopes [deg], row 0 north, infinite where a value is missing, and where a place lies."""

    slopes_deg: FloatArray
    pixel_of: Callable[[FloatArray, FloatArray], tuple[Any, Any]]
    """Longitudes and latitudes [deg] -> rows and columns of their pixels."""


def original(terrain: dict[str, Any], data: Path) -> Original:
    """The raster of a terrain's table, opened with rasterio or NumPy alone; slopes are central differences."""
    path = data / terrain["file"]
    if "grid" in terrain:
        grid, heights = terrain["grid"], np.load(path).astype(np.float64)
        pixel_m, centre = grid["resolution_m"], (grid["centre_lat_deg"], grid["centre_lon_deg"])
        degree_m = np.radians(1.0) * MOON_RADIUS_M

        def in_array(longitude: FloatArray, latitude: FloatArray) -> tuple[Any, Any]:
            east = (longitude - centre[1]) * degree_m * np.cos(np.radians(centre[0]))
            north = (latitude - centre[0]) * degree_m
            rows, columns = heights.shape[0] / 2 - north / pixel_m, heights.shape[1] / 2 + east / pixel_m
            return np.floor(rows).astype(np.intp), np.floor(columns).astype(np.intp)

        return Original(_slopes(heights, pixel_m), in_array)
    import pyproj
    import rasterio

    with rasterio.open(path) as raster:
        number = 1 + raster.descriptions.index(terrain["band"])
        heights = raster.read(number, masked=True).astype(np.float64).filled(np.nan)
        heights[~np.isfinite(heights) | (heights < -1e30)] = np.nan
        place, (pixel_m, _) = raster.transform, raster.res
        moon = f"+proj=longlat +R={MOON_RADIUS_M:.0f} +no_defs"
        there = pyproj.Transformer.from_crs(moon, pyproj.CRS.from_wkt(raster.crs.to_wkt()), always_xy=True)

    def in_raster(longitude: FloatArray, latitude: FloatArray) -> tuple[Any, Any]:
        rows, columns = rasterio.transform.rowcol(place, *there.transform(longitude, latitude))
        return np.asarray(rows), np.asarray(columns)

    return Original(_slopes(heights, pixel_m), in_raster)


def _slopes(heights: FloatArray, pixel_m: float) -> FloatArray:
    """Slopes [deg] by central differences; infinite at the edge and beside missing values."""
    north = (heights[:-2, 1:-1] - heights[2:, 1:-1]) / (2 * pixel_m)
    east = (heights[1:-1, 2:] - heights[1:-1, :-2]) / (2 * pixel_m)
    slopes = np.full(heights.shape, np.inf)
    slopes[1:-1, 1:-1] = np.degrees(np.arctan(np.hypot(north, east)))
    slopes[np.isnan(slopes)] = np.inf
    return slopes


def steepest_deg(place: Place, data: Path, region: Region, path_m: FloatArray) -> float:
    """The steepest pixel [deg] of the original raster below a path (K, 2) on the site [m], followed in small steps."""
    raster = original(place.terrain, data)
    step = min(0.25, region.grid.resolution_m / 4)
    points = [path_m[:1]]
    for first, second in pairwise(path_m):
        count = max(1, int(np.hypot(*(second - first)) / step))
        points.append(first + (second - first) * (np.arange(1, count + 1)[:, None] / count))
    x, y = np.concatenate(points).T
    assert region.origin_lat_deg is not None  # these places have corners
    assert region.origin_lon_deg is not None
    middle = np.radians(region.origin_lat_deg) + region.grid.height_m / 2 / MOON_RADIUS_M
    latitude = region.origin_lat_deg + np.degrees(y / MOON_RADIUS_M)
    longitude = region.origin_lon_deg + np.degrees(x / (MOON_RADIUS_M * np.cos(middle)))
    return float(raster.slopes_deg[raster.pixel_of(longitude, latitude)].max())


def table(rows: Sequence[Row]) -> list[str]:
    """The rows as aligned lines."""
    head = (
        f"{'place':<16} {'size':<5} {'planner':<8} {'width':>8} {'samples':>7} {'RMSE ppb':>9} {'of std':>6} "
        f"{'in reach':>8} {'of std':>6} {'driven m':>9} {'68 %':>6} {'95 %':>6} {'steepest':>9} {'closed':>7} "
        f"{'reached':>8}"
    )
    return [head, "-" * len(head), *map(_line, rows)]


def _line(row: Row) -> str:
    return (
        f"{row['place']:<16} {row['size']:<5} {row['planner']:<8} {row['width_m']:>7.0f}m {row['samples']:>7} "
        f"{_number(row['rmse_ppb'], '9.4f')} {_share(row['rmse_ppb'], row['std_ppb'])} "
        f"{_number(row['rmse_within_reach_ppb'], '8.4f')} "
        f"{_share(row['rmse_within_reach_ppb'], row['std_within_reach_ppb'])} {row['path_length_m']:>9.0f} "
        f"{_number(row['coverage_68'], '6.1%')} {_number(row['coverage_95'], '6.1%')} {row['steepest_deg']:>8.2f}° "
        f"{row['closed']:>7.1%} {row['reached']:>8.1%}"
    )


def _number(value: float | None, form: str) -> str:
    """The number in that form, or a dash of its width."""
    return format(value, f">{form}") if value is not None else "-".rjust(int(form.split(".")[0]))


def _share(error: float | None, std: float) -> str:
    """The error in standard deviations of the field, in the width of its column."""
    return _number(None if error is None else error / std, "6.2f")


def sources(rows: Sequence[Row]) -> list[str]:
    """What the maps of each place rest on, a line a place: measured, assumed, or laid over from a stand-in."""
    found = {row["place"]: row["provenance"] for row in rows}
    return [f"{place}: {provenance}" for place, provenance in found.items()]
