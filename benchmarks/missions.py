"""A whole mission in one process, without services: the same belief and planners, sample by sample, as fast as they go.

What the services add (light time, drilling, telemetry) changes when a sample is in the map, but not the map; so
planners are compared without them. A round is planned with all earlier samples in the map and hyperparameters refitted
to them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import inf, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from he3.errors import InvalidInput, NoRoute
from he3.frames import FloatArray
from he3.hyperparameters import DEFAULT_NOISE_STD_PPB
from he3.measurement import sample_noise
from he3.reference import Region
from he3.trend import GAIN_STD, UNSURE_GAIN_STD, orbital_trend
from services.ground.belief import Belief
from services.ground.fitting import due, fit
from services.ground.observation import Observation
from services.ground.planners import planner_named
from services.ground.planners.interface import Planner, PlannerOptions, PlanningRequest
from services.ground.planners.traversability import OpenGround
from services.ground.scoring import Scorer
from services.ground.terrain import GroundTerrain

START_M = (25.0, 25.0)
ROUNDS, SAMPLES_A_ROUND = 30, 5
FOOTPRINT_RADIUS_M = 0.8
_FIT, _PLAN = 1, 2  # what a seed is for

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Mission:
    """One mission: its row of figures, its path and its samples."""

    row: Row
    path_m: FloatArray
    """(K, 2) path driven [m]."""
    samples_m: FloatArray
    """(n, 2) places of the samples [m]."""
    values_ppb: FloatArray
    """(n,) measured values [ppb]."""
    rmse_history: tuple[float, ...]
    """RMSE [ppb] after each sample, under the hyperparameters of its round; empty if it was not asked for."""
    mean_ppb: NDArray[np.float32]
    std_ppb: NDArray[np.float32]
    traversable: NDArray[np.bool_]
    ended: str = ""
    """Why the mission ended before its last round; empty if it did not."""


@dataclass(slots=True)
class _Log:
    path: list[FloatArray] = field(default_factory=list)
    places: list[tuple[float, float]] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    rmse: list[float] = field(default_factory=list)
    driven_m: float = 0.0
    plan_s: float = 0.0
    ended: str = ""
    outlook: FloatArray | None = None


def run_mission(
    region: Region,
    planner: str | Planner,
    kernel: str,
    seed: int,
    *,
    rounds: int = ROUNDS,
    samples: int = SAMPLES_A_ROUND,
    budget_m: float = inf,
    prior: str | None = None,
    likeliest: bool = True,
    noise_std_ppb: float = DEFAULT_NOISE_STD_PPB,
    start_m: tuple[float, float] | None = None,
    interest: NDArray[np.float32] | None = None,
    options: PlannerOptions | None = None,
    orbital_ppb: FloatArray | None = None,
    progress: Callable[[int, int], None] | None = None,
    history: bool = True,
) -> Mission:
    """A mission with this planner over the region, with its row of figures.

    prior: None or "orbital", a trend learned from the region's orbital map or from ``orbital_ppb`` in its place.
    likeliest: hyperparameters of maximum likelihood, else all that the samples leave possible. start_m: where the
    rover stands at first, ``start_of`` the region if None. progress is called with the number of samples taken and
    the total. history: whether the RMSE after each sample is computed, which takes a third of a short mission's time.
    Raises InvalidInput for names that are not known.
    """
    begun = time.perf_counter()
    if prior not in (None, "orbital"):
        raise InvalidInput(f"expected a prior of None or 'orbital', got {prior!r}")
    function = planner_named(planner) if isinstance(planner, str) else planner
    terrain = GroundTerrain(region.grid, region.traversable, FOOTPRINT_RADIUS_M)
    orbital = region.orbital_ppb if orbital_ppb is None else orbital_ppb
    gain_std = GAIN_STD if likeliest else UNSURE_GAIN_STD
    trend = orbital_trend(region.grid, orbital, gain_std) if prior == "orbital" else None
    belief = Belief(region.grid, kernel, noise_std_ppb, trend, likeliest=likeliest)
    scorer = Scorer(region.he3_ppb, region.known)
    start_m = start_of(region, terrain) if start_m is None else start_m
    log, here, inferred_from = _Log(), start_m, 0
    for number in range(1, rounds + 1):
        left_m = budget_m - log.driven_m
        seeds = np.random.SeedSequence((seed, _PLAN, number, 1, 0))
        request = PlanningRequest(
            grid=region.grid,
            traversable=terrain.traversable,
            start_m=here,
            observed_m=np.array(log.places, dtype=np.float64).reshape(-1, 2),
            std_ppb=belief.map.std_ppb,
            hyperparameters=belief.hyperparameters,
            samples=samples,
            samples_left=(rounds - number + 1) * samples,
            budget_m=left_m,
            seed=int(seeds.generate_state(1)[0]),
            interest=interest,
            options=options or PlannerOptions().on_site(region.grid),
            outlook_m=log.outlook,
            margin_m=terrain.margin_m,
        )
        asked = time.perf_counter()
        try:
            planned = function(request)
        except NoRoute as error:
            log.ended = str(error)
            break
        finally:
            log.plan_s += time.perf_counter() - asked
        log.path.append(planned.path_m)
        for k, place in enumerate(planned.samples_m):
            at = (float(place[0]), float(place[1]))
            row, column = region.grid.cells_of(place[None])
            sample_id = f"r{number:03d}s{k + 1:02d}"
            value = float(region.he3_ppb[row[0], column[0]]) + sample_noise(seed, sample_id, noise_std_ppb)
            belief.add(sample_id, Observation((number, 1, k + 1), at, value))
            log.places.append(at)
            log.values.append(value)
            if history:
                log.rmse.append(_score(scorer, belief, len(log.places))[0])
        log.driven_m += planned.length_m
        log.outlook = planned.outlook_m
        here = (float(planned.path_m[-1, 0]), float(planned.path_m[-1, 1]))
        fitting = belief.fit_request(number, (seed, _FIT, number))
        if fitting is not None:
            known = len(fitting.values_ppb)
            whole = due(known, inferred_from, rounds * samples)
            inferred_from = known if whole else inferred_from
            belief.adopt(fit(replace(fitting, whole=whole)))
        if progress is not None:
            progress(len(log.places), rounds * samples)
    rmse, coverage_68, coverage_95 = _score(scorer, belief, len(log.places))
    if log.rmse:
        log.rmse[-1] = rmse  # after the last refit
    row_of_figures: Row = {
        "region": region.name,
        "planner": planner if isinstance(planner, str) else getattr(planner, "__name__", str(planner)),
        "kernel": kernel,
        "prior": prior,
        "budget_m": budget_m if isfinite(budget_m) else None,
        "seed": seed,
        "samples": len(log.places),
        "rmse_ppb": rmse,
        "path_length_m": log.driven_m,
        "coverage_68": coverage_68,
        "coverage_95": coverage_95,
        "plan_time_s": log.plan_s,
        "wall_time_s": time.perf_counter() - begun,
    }
    path = np.vstack((np.array([start_m]), *(piece[1:] for piece in log.path)))
    return Mission(
        row=row_of_figures,
        path_m=path,
        samples_m=np.array(log.places, dtype=np.float64).reshape(-1, 2),
        values_ppb=np.array(log.values),
        rmse_history=tuple(log.rmse),
        mean_ppb=belief.map.mean_ppb,
        std_ppb=belief.map.std_ppb,
        traversable=terrain.traversable,
        ended=log.ended,
    )


def start_of(region: Region, terrain: GroundTerrain | None = None) -> tuple[float, float]:
    """The start [m] of a mission without a stated one: in the largest connected part of the open ground.

    It is START_M if that lies in this part, else the centre of the part's cell that is nearest to it. Raises
    InvalidInput without open ground.
    """
    return _nearest(region, _largest_part(region, terrain))


def drawn_start(region: Region, random: np.random.Generator) -> tuple[float, float]:
    """The centre [m] of a cell drawn from the largest connected part of the open ground.

    Raises InvalidInput without open ground.
    """
    cells = np.argwhere(_largest_part(region, None))
    row, column = cells[random.integers(len(cells))]
    return (float(column) + 0.5) * region.grid.resolution_m, (float(row) + 0.5) * region.grid.resolution_m


def corner_of(region: Region, terrain: GroundTerrain | None = None) -> tuple[float, float]:
    """START_M, or where that is closed or outside the region, the centre [m] of the open cell that is nearest to it.

    Closed ground may part it from nearly all of the region. Raises InvalidInput without open ground.
    """
    return _nearest(region, _open_cells(region, terrain))


def _open_cells(region: Region, terrain: GroundTerrain | None) -> NDArray[np.bool_]:
    found = (terrain or GroundTerrain(region.grid, region.traversable, FOOTPRINT_RADIUS_M)).traversable
    if not found.any():
        raise InvalidInput(f"{region.name}: expected some traversable ground, got none")
    return found


def _largest_part(region: Region, terrain: GroundTerrain | None) -> NDArray[np.bool_]:
    labels, _ = ndimage.label(_open_cells(region, terrain))
    found: NDArray[np.bool_] = labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    return found


def _nearest(region: Region, cells: NDArray[np.bool_]) -> tuple[float, float]:
    """START_M if it lies on one of the cells (rows, columns), else the centre [m] of the cell nearest to it."""
    wanted = np.array([START_M])
    if region.grid.contains(wanted).all() and OpenGround(region.grid, cells).is_open(wanted).all():
        return START_M
    places = (np.argwhere(cells)[:, ::-1] + 0.5) * region.grid.resolution_m
    nearest = places[int(np.argmin(np.hypot(*(places - wanted).T)))]
    return float(nearest[0]), float(nearest[1])


def _score(scorer: Scorer, belief: Belief, samples: int) -> tuple[float, float, float]:
    score = scorer.score(belief.map.mean_ppb, belief.map.std_ppb, samples, samples, 0, belief.interval_ends())
    return score.rmse_ppb, score.coverage_68, score.coverage_95
