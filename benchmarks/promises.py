"""Missions that end with a certificate, and whether what it promises is true of the field.

Each mission surveys a piece of a third-party field, or a variation of an embedded one: 500 m of open ground in 50 x 50
cells, brought to 7.5 +- 1.7 ppb, what is known of soils before landing. The goal is a share of that spread, everywhere
or for blocks. It is flown whole, by the services' own nodes in one process. Promised is that of the area at least a
share of `probability` lies within z std of the map.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from benchmarks.exam_fields import load_field
from he3.errors import He3Error, InvalidInput
from he3.frames import FloatArray, SiteGrid
from he3.reference import Region
from services.ground.node import GroundNode
from services.mission.embedded_regions import EMBEDDED
from services.mission.in_process import GROUND, InProcessMission, build_nodes
from services.mission.regions import load_region
from services.mission.scenario import Blocks, Scenario, checked_scenario

CELLS = 50
GRID = SiteGrid(CELLS, CELLS, 10.0)
MEAN_PPB, STD_PPB = 7.5, 1.7
DRAWS = 200
_PIECE = 17  # tells the seeds of pieces from all others

_IDENTITY = ("field", "seed", "planner", "share", "blocks_m", "probability", "rounds")

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Promise:
    """One mission to fly."""

    data: Path | None
    field: str
    seed: int
    planner: str
    share: float
    """The goal's standard deviation, in those of the field."""
    blocks_m: float | None
    probability: float
    rounds: int

    @property
    def identity(self) -> tuple[Any, ...]:
        """What its row is known by; see `identity`."""
        return tuple(getattr(self, name) for name in _IDENTITY)


def identity(row: Row) -> tuple[Any, ...]:
    """What tells a row's mission from all others; None for what an older row does not tell."""
    return tuple(row.get(name) for name in _IDENTITY)


def piece(field: str, data: Path | None, seed: int) -> Region:
    """A piece of that field, which the seed draws; of an embedded region another variation of its whole field."""
    if field in EMBEDDED:
        values = load_region(field, seed).he3_ppb
        known = np.ones(values.shape, dtype=np.bool_)
        least = min(values.shape) // CELLS
    else:
        loaded = load_field(field, data)
        values, known, least = loaded.region.he3_ppb, loaded.known, 1
    rng = np.random.default_rng((_PIECE, seed))
    most = min(values.shape) // CELLS
    if most < 1:
        raise InvalidInput(f"{field}: expected {CELLS} cells on a side at least, got {values.shape}")
    for _ in range(DRAWS):
        block = int(rng.integers(least, most + 1))
        corner = [int(rng.integers(0, size - block * CELLS + 1)) for size in values.shape]
        window = tuple(slice(low, low + block * CELLS) for low in corner)
        if known[window].all():
            break
    else:
        raise InvalidInput(f"{field}: expected a square of {CELLS} cells with values, found none")
    part = values[window].reshape(CELLS, block, CELLS, block).mean(axis=(1, 3))
    part = MEAN_PPB + STD_PPB * (part - part.mean()) / part.std()
    level = np.zeros(GRID.shape)
    return Region(
        name=field, title=f"a piece of {field}", provenance="made by the benchmark", grid=GRID, he3_ppb=part,
        orbital_ppb=ndimage.uniform_filter(part, 5), elevation_m=level, slope_deg=level.copy(),
        traversable=np.ones(GRID.shape, dtype=np.bool_),
    )  # fmt: skip


def scenario_of(promise: Promise) -> Scenario:
    """The scenario of that mission."""
    goal: dict[str, Any] = {"std_ppb": promise.share * STD_PPB, "probability": promise.probability}
    if promise.blocks_m is not None:
        goal["area"] = {"blocks_m": promise.blocks_m}
    document = {
        "name": "promise", "region": "piece.npz", "seed": promise.seed, "rounds": promise.rounds,
        "samples_per_round": 5, "ground": {"planner": promise.planner, "kernel": "smooth+rough", "goal": goal},
    }  # fmt: skip
    return checked_scenario(document, "promise")


def fly(promise: Promise) -> Row:
    """The row of that mission: whether it reached its goal, and the share of the area that lies as near as promised."""
    began = time.process_time()
    region, scenario = piece(promise.field, promise.data, promise.seed), scenario_of(promise)
    nodes = build_nodes(scenario, region)
    mission = InProcessMission(scenario, nodes=nodes)
    mission.run()
    ground = next(node for node in nodes if isinstance(node, GroundNode) and node.interface.name == GROUND)
    goal, snapshot = ground.status.goal, ground.snapshot
    if goal is None or snapshot is None:
        raise He3Error(f"{promise.field}, seed {promise.seed}: the mission ended without a map")
    missed = errors_of(region, snapshot.mean_ppb.astype(np.float64), scenario)
    within = None if goal.within_ppb is None else float(np.mean(missed <= goal.within_ppb))
    return {
        "field": promise.field, "seed": promise.seed, "planner": promise.planner, "share": promise.share,
        "blocks_m": promise.blocks_m, "probability": promise.probability, "rounds": promise.rounds,
        "reached": goal.holds, "samples": ground.status.samples, "metres": ground.status.driven_m,
        "worst_ppb": goal.worst_ppb, "weight": goal.weight, "likely_ppb": goal.likely_ppb,
        "unseen": goal.unseen, "within": within,
        "kept": within is not None and within >= promise.probability,
        "seconds": time.process_time() - began,
    }  # fmt: skip


def errors_of(region: Region, mean_ppb: FloatArray, scenario: Scenario) -> FloatArray:
    """What the map (rows, columns) [ppb] is off by: at each cell, or of the mean of each block."""
    goal = scenario.ground.goal
    missed = mean_ppb - region.he3_ppb
    if goal is None or not isinstance(goal.area, Blocks):
        return np.abs(missed)
    side = goal.area.blocks_m
    across = (region.grid.x_m // side).astype(int)
    along = (region.grid.y_m // side).astype(int)
    number = along[:, None] * (int(across.max()) + 1) + across[None, :]
    # A block at the far edge that is narrower than a cell may have no cell of its own.
    mean: FloatArray = np.asarray(ndimage.mean(missed, number, np.unique(number)))
    return np.abs(mean)
