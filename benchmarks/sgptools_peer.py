"""SGP-Tools beside our planners: the same field, start, samples and noise; its places and order, measured as ours.

It runs in a separate environment (benchmarks/peers/requirements.txt). It is given the kernel that a Gaussian
process learned from 150 samples of the very field, which favours it. Its places are moved to the nearest open ground,
its path is measured along legs that avoid obstacles, and its samples are scored on all cells: with the Gaussian
process that scores ours, and with its own.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.missions import FOOTPRINT_RADIUS_M, Mission, start_of
from benchmarks.peer_environments import SGPTOOLS, packed, unpacked
from he3.frames import FloatArray, path_length
from he3.hyperparameters import DEFAULT_NOISE_STD_PPB, Hyperparameters
from he3.information import rmse
from he3.measurement import sample_noise
from he3.reference import Region
from services.ground.belief import Belief
from services.ground.fitting import fit
from services.ground.observation import Observation
from services.ground.planners.tour.paths import shortest_path
from services.ground.planners.traversability import OpenGround
from services.ground.scoring import Scorer
from services.ground.terrain import GroundTerrain

GROUND_POINTS = 2000
STEPS = 500
FIRST_LENGTH = 0.06
"""Length scale before any sample, as a share of the site's longer side."""
LEARN_EVERY = 30
"""Samples after which the online planner learns its hyperparameters anew."""

MAX_ASKINGS = 3
TOLERANCE = 0.01
"""Share of the budget by which its path around obstacles may exceed the budget; else it is run again."""


@dataclass(frozen=True, slots=True)
class PeerResult:
    """The result of SGP-Tools on one field with one budget."""

    places_m: FloatArray
    path_m: FloatArray
    blocked_legs: int
    """Straight legs of its path that cross obstacles, before the detours."""
    row: dict[str, Any]


@dataclass(frozen=True, slots=True)
class PeerPlan:
    """Places (n, 2) [m] of SGP-Tools on open ground, and the path around obstacles that leads through them."""

    places_m: FloatArray
    path_m: FloatArray
    blocked_legs: int
    seconds: float


def plan_with_sgptools(
    region: Region,
    samples: int,
    budget_m: float,
    seed: int,
    start_m: tuple[float, float],
    learned: Hyperparameters | None,
    noise_ppb: FloatArray,
) -> PeerPlan:
    """SGP-Tools' places for that number of samples within that budget.

    learned: the covariance that it is given; None lets it learn one as it goes, from the samples with this noise (n,).
    """
    ground = GroundTerrain(region.grid, region.traversable, FOOTPRINT_RADIUS_M).for_legs()
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x5697]))
    reached = ground.connected_to(start_m)
    rows, columns = np.nonzero(reached)
    chosen = rng.choice(len(rows), min(GROUND_POINTS, len(rows)), replace=False)
    cells_m = np.column_stack((columns + 0.5, rows + 0.5)) * region.grid.resolution_m
    request: dict[str, Any] = {
        "open_m": cells_m[chosen].tolist(),
        "start_m": list(start_m),
        "samples": samples,
        "steps": STEPS,
        "seed": seed,
    }
    if learned is not None:
        kernel = {"name": learned.kernel.name, **learned.kernel.parameters()}
        request |= {"task": "place", "kernel": kernel, "noise_variance": learned.noise_variance}
    else:
        request |= {"task": "explore", "every": LEARN_EVERY, "noise_ppb": noise_ppb.tolist(), **_site(region)}
        request["field_ppb"] = packed(region.he3_ppb)
    asked_m, seconds = budget_m, 0.0
    for _ in range(MAX_ASKINGS):
        answer = SGPTOOLS.ask({**request, "budget_m": asked_m})
        seconds += answer["seconds"]
        places = np.clip(np.array(answer["places_m"]), 0, [region.grid.width_m, region.grid.height_m])
        inside = np.minimum((places / region.grid.resolution_m).astype(int), [n - 1 for n in region.grid.shape[::-1]])
        closed = ~reached[inside[:, 1], inside[:, 0]]
        if closed.any():
            places[closed] = cells_m[cKDTree(cells_m).query(places[closed])[1]]
        path, blocked = path_through(ground, start_m, places)
        if path_length(path) <= budget_m * (1 + TOLERANCE):
            break
        # Round obstacles it is longer, and the library's own budget is not exact: it is asked for less, as much less.
        asked_m *= budget_m / path_length(path)
    return PeerPlan(places, path, blocked, seconds)


def _site(region: Region) -> dict[str, Any]:
    grid = region.grid
    length_m = FIRST_LENGTH * max(grid.width_m, grid.height_m)
    return {"rows": grid.rows, "columns": grid.columns, "resolution_m": grid.resolution_m, "length_scale_m": length_m}


def fly_sgptools(
    region: Region,
    like: Mission,
    kernel: str,
    seed: int,
    budget_m: float,
    noise_std_ppb: float = DEFAULT_NOISE_STD_PPB,
    start_m: tuple[float, float] | None = None,
) -> PeerResult:
    """SGP-Tools' places under that budget, measured as our missions are.

    like: a mission of ours over the same field, from whose samples the kernel is learned that SGP-Tools is given.
    start_m: ``start_of`` the region if None.
    """
    began = time.perf_counter()
    learned = belief_of(region, like.samples_m, like.values_ppb, kernel, seed, noise_std_ppb).hyperparameters
    count = len(like.samples_m)
    noise = noise_of(seed, count, noise_std_ppb)
    planned = plan_with_sgptools(region, count, budget_m, seed, start_m or start_of(region), learned, noise)
    places, path, blocked = planned.places_m, planned.path_m, planned.blocked_legs
    values = region.he3_ppb[region.grid.cells_of(places)] + noise[: len(places)]
    belief = belief_of(region, places, values, kernel, seed, noise_std_ppb)
    shown, count = belief.map, len(places)
    score = Scorer(region.he3_ppb, region.known).score(
        shown.mean_ppb, shown.std_ppb, count, count, 0, belief.interval_ends()
    )
    own, _ = map_of_sgptools(region, places, values)
    row = {
        "region": region.name,
        "planner": "sgptools",
        "kernel": kernel,
        "prior": None,
        "budget_m": budget_m,
        "seed": seed,
        "samples": len(places),
        "rmse_ppb": score.rmse_ppb,
        "rmse_own_gp_ppb": _rmse(region, own),
        "path_length_m": path_length(path),
        "blocked_legs": blocked,
        "coverage_68": score.coverage_68,
        "coverage_95": score.coverage_95,
        "plan_time_s": planned.seconds,
        "wall_time_s": time.perf_counter() - began,
    }
    return PeerResult(places, path, blocked, row)


def own_gp_rmse(region: Region, mission: Mission) -> float:
    """RMSE [ppb] over all known cells of our samples under the peers' Gaussian process, fitted their way."""
    field, _ = map_of_sgptools(region, mission.samples_m, mission.values_ppb)
    return _rmse(region, field)


def _rmse(region: Region, map_ppb: FloatArray) -> float:
    """RMSE [ppb] of a map (rows, columns) over the cells whose reference is known."""
    return rmse(region.of_known(region.he3_ppb), region.of_known(map_ppb))


def noise_of(seed: int, samples: int, std_ppb: float) -> FloatArray:
    """The noise (samples,) [ppb] of a mission's samples with that seed, in rounds of five."""
    return np.array([sample_noise(seed, f"r{k // 5 + 1:03d}s{k % 5 + 1:02d}", std_ppb) for k in range(samples)])


def belief_of(
    region: Region,
    places: FloatArray,
    values: FloatArray,
    kernel: str,
    seed: int,
    noise_std_ppb: float = DEFAULT_NOISE_STD_PPB,
    *,
    likeliest: bool = True,
) -> Belief:
    """The belief from all samples at once, hyperparameters fitted to them."""
    belief = Belief(region.grid, kernel, noise_std_ppb, likeliest=likeliest)
    for k, (place, value) in enumerate(zip(places, values, strict=True)):
        at = (float(place[0]), float(place[1]))
        belief.add(f"s{k}", Observation((1, 1, k + 1), at, float(value)))
    request = belief.fit_request(1, (seed, 1, 1))
    if request is not None:
        belief.adopt(fit(request))
    return belief


def path_through(ground: OpenGround, start_m: tuple[float, float], places: FloatArray) -> tuple[FloatArray, int]:
    """The path (K, 2) [m] around obstacles through the places in order, and how many straight legs are blocked."""
    corners = [np.array(start_m)]
    batches, blocked = [np.array([start_m])], 0
    for place in places:
        way = shortest_path(ground, corners[-1], place)
        blocked += len(way) > 2
        batches.append(way[1:])
        corners.append(place)
    return np.vstack(batches), blocked


def map_of_sgptools(region: Region, places: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation [ppb] on all cells, by the peers' Gaussian process fitted their way."""
    answer = SGPTOOLS.ask({"task": "map", "places_m": places.tolist(), "values_ppb": values.tolist(), **_site(region)})
    shape = region.grid.shape
    return unpacked(answer["mean_ppb"], shape), unpacked(answer["std_ppb"], shape)
