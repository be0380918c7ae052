"""SGP-Tools beside our planners: the same field, start, samples and noise; its places and order, measured as ours.

It runs in a separate environment (benchmarks/peers/requirements.txt). It is given the kernel that a Gaussian
process learned from 150 samples of the very field, which favours it. Its places are moved to the nearest open ground,
its path is measured along legs that avoid obstacles, and its samples are scored on all cells: with the Gaussian
process that scores ours, and with its own.
"""

from __future__ import annotations

import base64
import json
import os
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.missions import FOOTPRINT_RADIUS_M, Mission, start_of
from he3.errors import He3Error, InvalidInput
from he3.frames import FloatArray, path_length
from he3.measurement import sample_noise
from he3.reference import Region
from services.ground.belief import Belief
from services.ground.fitting import fit
from services.ground.observation import Observation
from services.ground.planners.tour.paths import shortest_path
from services.ground.planners.traversability import OpenGround
from services.ground.scoring import Scorer
from services.ground.terrain import GroundTerrain

SCRIPT = Path(__file__).parent / "peers" / "place_with_sgptools.py"
VARIABLE = "HE3_PEERS_PYTHON"
DEFAULT = Path(__file__).parent.parent / ".venv-peers" / "bin" / "python"
GROUND_POINTS = 2000
STEPS = 500
NOISE_STD_PPB = 0.1
TIMEOUT_S = 900

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


def peer_python() -> Path:
    """The interpreter of the peers' environment; raises InvalidInput, with instructions, if there is none."""
    path = Path(os.environ.get(VARIABLE, DEFAULT))
    if not path.is_file():
        raise InvalidInput(
            f"SGP-Tools needs a separate environment, expected its interpreter at {path}, found none; make it with "
            f"'python3 -m venv .venv-peers && .venv-peers/bin/pip install -r benchmarks/peers/requirements.txt' or "
            f"name one in {VARIABLE}"
        )
    return path


def fly_sgptools(region: Region, like: Mission, kernel: str, seed: int, budget_m: float) -> PeerResult:
    """SGP-Tools' places under that budget, measured as our missions are.

    like: a mission of ours over the same field, from whose samples the kernel is learned that SGP-Tools is given.
    """
    began = time.perf_counter()
    ground = OpenGround(region.grid, GroundTerrain(region.grid, region.traversable, FOOTPRINT_RADIUS_M).traversable)
    learned = _belief(region, like.samples_m, like.values_ppb, kernel, seed).hyperparameters
    parameters = learned.kernel.parameters()
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x5697]))
    rows, columns = np.nonzero(ground.open)
    chosen = rng.choice(len(rows), min(GROUND_POINTS, len(rows)), replace=False)
    cells_m = np.column_stack((columns + 0.5, rows + 0.5)) * region.grid.resolution_m
    request = {
        "task": "place",
        "open_m": cells_m[chosen].tolist(),
        "start_m": list(start_of(region)),
        "samples": len(like.samples_m),
        "kernel": {"name": learned.kernel.name, **parameters},
        "noise_variance": learned.noise_variance,
        "steps": STEPS,
        "seed": seed,
    }
    asked_m, seconds = budget_m, 0.0
    for _ in range(MAX_ASKINGS):
        answer = _asked({**request, "budget_m": asked_m})
        seconds += answer["seconds"]
        places = np.clip(np.array(answer["places_m"]), 0, [region.grid.width_m, region.grid.height_m])
        closed = ~ground.is_open(places)
        if closed.any():
            places[closed] = cells_m[cKDTree(cells_m).query(places[closed])[1]]
        path, blocked = _path(ground, start_of(region), places)
        if path_length(path) <= budget_m * (1 + TOLERANCE):
            break
        # Round obstacles it is longer, and the library's own budget is not exact: it is asked for less, as much less.
        asked_m *= budget_m / path_length(path)
    noise = [sample_noise(seed, f"r{k // 5 + 1:03d}s{k % 5 + 1:02d}", NOISE_STD_PPB) for k in range(len(places))]
    where = region.grid.cells_of(places)
    values = region.he3_ppb[where] + np.array(noise)
    belief = _belief(region, places, values, kernel, seed)
    score = Scorer(region.he3_ppb).score(belief.map.mean_ppb, belief.map.std_ppb, len(places), len(places), 0)
    own = _own_map(region, places, values)
    row = {
        "region": region.name,
        "planner": "sgptools",
        "kernel": kernel,
        "prior": None,
        "budget_m": budget_m,
        "seed": seed,
        "samples": len(places),
        "rmse_ppb": score.rmse_ppb,
        "rmse_own_gp_ppb": float(np.sqrt(np.mean((own - region.he3_ppb) ** 2))),
        "path_length_m": path_length(path),
        "blocked_legs": blocked,
        "coverage_68": score.coverage_68,
        "coverage_95": score.coverage_95,
        "plan_time_s": seconds,
        "wall_time_s": time.perf_counter() - began,
    }
    return PeerResult(places, path, blocked, row)


def own_gp_rmse(region: Region, mission: Mission) -> float:
    """RMSE [ppb] over all cells of our samples under the peers' Gaussian process, fitted their way."""
    field = _own_map(region, mission.samples_m, mission.values_ppb)
    return float(np.sqrt(np.mean((field - region.he3_ppb) ** 2)))


def _belief(region: Region, places: FloatArray, values: FloatArray, kernel: str, seed: int) -> Belief:
    """The belief from all samples at once, hyperparameters fitted to them."""
    belief = Belief(region.grid, kernel, NOISE_STD_PPB, likeliest=True)
    for k, (place, value) in enumerate(zip(places, values, strict=True)):
        at = (float(place[0]), float(place[1]))
        belief.add(f"s{k}", Observation((1, 1, k + 1), at, float(value)))
    request = belief.fit_request(1, (seed, 1, 1))
    if request is not None:
        belief.adopt(fit(request))
    return belief


def _path(ground: OpenGround, start_m: tuple[float, float], places: FloatArray) -> tuple[FloatArray, int]:
    corners = [np.array(start_m)]
    batches, blocked = [np.array([start_m])], 0
    for place in places:
        way = shortest_path(ground, corners[-1], place)
        blocked += len(way) > 2
        batches.append(way[1:])
        corners.append(place)
    return np.vstack(batches), blocked


def _own_map(region: Region, places: FloatArray, values: FloatArray) -> FloatArray:
    grid = region.grid
    answer = _asked(
        {
            "task": "map",
            "places_m": places.tolist(),
            "values_ppb": values.tolist(),
            "rows": grid.rows,
            "columns": grid.columns,
            "resolution_m": grid.resolution_m,
        }
    )
    return np.frombuffer(base64.b64decode(answer["mean_ppb"]), dtype="<f4").reshape(grid.shape).astype(np.float64)


def _asked(request: dict[str, Any]) -> Any:
    done = subprocess.run(
        [peer_python(), SCRIPT],
        input=json.dumps(request),
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["nothing"])[-1]
        raise He3Error(f"SGP-Tools ended with {done.returncode}, saying: {last}")
    return json.loads(done.stdout)
