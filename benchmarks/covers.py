"""Designs that reach the same certificate on one field: ours, a greedy cover, and SGP-Tools' coverage planners.

All have the same squared exponential, learned from 150 samples of a hexagonal cover of the very field, the same noise,
start, obstacles and targets. The certificate is that the joint posterior variance is at most a share of the kernel's at
every target. SGP-Tools' planners ask more than that, namely that one sample alone suffices for each target. So they are
run twice: with the threshold as their documentation has it, and `loosened`, with the laxest one after which the
certificate holds. Their places are moved to the nearest open ground; if the certificate then fails, the threshold is
made stricter. Every tour is the shorter of the planner's own order and ours, measured around obstacles.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from benchmarks.exam_fields import ExamField
from benchmarks.exam_patterns import hexagonal, moved_onto
from benchmarks.missions import FOOTPRINT_RADIUS_M, start_of
from benchmarks.peer_environments import SGPTOOLS_COVERS
from benchmarks.sgptools_peer import noise_of, path_through
from he3.certificate import places_of
from he3.cover import CoverProblem
from he3.errors import NoRoute
from he3.frames import BoolArray, FloatArray, path_length
from he3.gp import fit_hyperparameters
from he3.hyperparameters import EXTENT_M, Hyperparameters
from he3.i_optimal_design import field_nodes
from he3.kernels import SquaredExponential
from services.ground.planners.interface import PlanningGoal
from services.ground.planners.tour.covering import cover
from services.ground.planners.tour.route import route_through
from services.ground.planners.tour.site import Site, reachable_site
from services.ground.terrain import GroundTerrain

TRAINING = 150
KERNEL = "se"
TARGETS = 1600
MOST = 1000
"""Places of a design."""
KICKS = 20
PEERS = ("HexCover", "GreedyCover", "GCBCover")
STRICTER = (1.0, 0.97, 0.93, 0.88, 0.8, 0.7)
"""Thresholds that are tried one after the other, in shares of the certificate's."""
LAXER = (0.75, 0.5, 0.3, 0.15)
"""Thresholds of the loosened planners, the laxest last: what is left of the way to the prior variance."""

Row = dict[str, Any]


@dataclass(frozen=True, eq=False)
class CoverTask:
    """One field with its start, and what is known of it."""

    field: ExamField
    seed: int = 1

    @cached_property
    def start_m(self) -> tuple[float, float]:
        return start_of(self.field.region)

    @cached_property
    def site(self) -> Site:
        region = self.field.region
        terrain = GroundTerrain(region.grid, region.traversable, FOOTPRINT_RADIUS_M)
        nodes = field_nodes(region.grid, None)
        return reachable_site(region.grid, terrain.traversable, terrain.margin_m, self.start_m, nodes)

    @cached_property
    def reached(self) -> BoolArray:
        """(rows, columns) cells that the rover can get to."""
        return self.site.ground.connected_to(self.start_m)

    @cached_property
    def learned(self) -> Hyperparameters:
        """The covariance that all planners are given, without an uncertain mean."""
        region = self.field.region
        places = moved_onto(hexagonal(TRAINING, region.grid.width_m, region.grid.height_m), region.grid, self.reached)
        values = region.he3_ppb[region.grid.cells_of(places)] + noise_of(self.seed, TRAINING, self.field.noise_std_ppb)
        # On a site of the width for which the search's bounds and starts are made.
        scale = max(region.grid.width_m, region.grid.height_m) / EXTENT_M
        fitted = fit_hyperparameters(
            places / scale, values, KERNEL, rng=np.random.default_rng(self.seed),
            noise_std_ppb=self.field.noise_std_ppb,
        )  # fmt: skip
        learned = fitted.kernel.parameters()
        return replace(
            fitted, kernel=SquaredExponential(learned["variance"], scale * learned["length_scale_m"]),
            log_likelihood=float("nan"),
        )  # fmt: skip

    @cached_property
    def targets_m(self) -> FloatArray:
        """(T, 2) [m]: cells with a value, evenly spread over the site."""
        return places_of(self.field.region.grid, self.field.known, TARGETS).centres_m

    def goal(self, ratio: float) -> PlanningGoal:
        """The goal that the variance is at most that share of the kernel's at every target."""
        targets = places_of(self.field.region.grid, self.field.known, TARGETS)
        return PlanningGoal(targets, float(np.sqrt(ratio)) * self.learned.field_std_ppb, 0.95)

    def metres(self, places_m: FloatArray) -> float:
        """Length [m] of the shorter of two tours around obstacles: in the order of the places, and in ours."""
        own = path_length(path_through(self.site.ground, self.start_m, places_m)[0])
        return min(own, path_length(route_through(self.site, places_m, KICKS, self.seed).path_m))

    def problem(self, ratio: float) -> CoverProblem:
        """The certificate as a problem."""
        goal = self.goal(ratio)
        return CoverProblem([self.learned], np.zeros((0, 2)), goal.targets, goal.std_ppb)


def rows_of(task: CoverTask, ratios: Sequence[float], peers: Sequence[str]) -> list[Row]:
    """A row for each ratio and planner."""
    rows = [_row(task, ratio, "tour", _ours) for ratio in ratios]
    rows += [_row(task, ratio, "greedy", _greedy) for ratio in ratios]
    return rows + (_peer_rows(task, ratios, peers) if peers else [])


def _row(task: CoverTask, ratio: float, name: str, design: Callable[[CoverTask, float], FloatArray]) -> Row:
    began = time.process_time()
    places = design(task, ratio)
    return _judged(task, ratio, name, places, time.process_time() - began)


def _judged(task: CoverTask, ratio: float, name: str, places: FloatArray | None, seconds: float, note: str = "") -> Row:
    """The row of a design; places None: there is none."""
    row: Row = {
        "field": task.field.name, "ratio": ratio, "method": name, "seed": task.seed, "holds": False, "samples": None,
        "metres": None, "seconds": seconds, "note": note, "width_m": task.field.region.grid.width_m,
        "length_scale_m": task.learned.kernel.parameters()["length_scale_m"],
    }  # fmt: skip
    if places is None or not len(places):
        return row
    row |= {"samples": len(places), "holds": task.problem(ratio).holds(places)}
    try:
        return row | {"metres": task.metres(places)}
    except NoRoute as error:
        return row | {"note": str(error)}


def _ours(task: CoverTask, ratio: float) -> FloatArray:
    return cover([task.learned], task.goal(ratio), task.site, np.zeros((0, 2)), MOST, None)[0]


def _greedy(task: CoverTask, ratio: float) -> FloatArray:
    """The joint posterior's own greedy cover, out of all targets that can be reached; no pruning, no moves."""
    places = moved_onto(task.targets_m, task.field.region.grid, task.reached)
    candidates = np.unique(places, axis=0)
    return task.problem(ratio).added(np.zeros((0, 2)), candidates, MOST)


def _peer_rows(task: CoverTask, ratios: Sequence[float], peers: Sequence[str]) -> list[Row]:
    """Rows of SGP-Tools' planners, with their own thresholds and with loosened ones."""
    wanted: list[tuple[str, float, str, float]] = []
    for ratio in ratios:
        for peer in peers:
            wanted.append((peer, ratio, peer, ratio))
            if peer != "GCBCover":  # which takes minutes for each threshold
                wanted += [(f"{peer} loosened", ratio, peer, 1.0 - left * (1.0 - ratio)) for left in LAXER]
    found = _asked(task, [(peer, threshold) for _, _, peer, threshold in wanted])
    best: dict[tuple[str, float], Row] = {}
    for (name, ratio, _, _), answer in zip(wanted, found, strict=True):
        row = _answered(task, ratio, name, answer)
        kept = best.get((name, ratio))
        if kept is None or _order(row) < _order(kept):
            best[name, ratio] = row
    for share in STRICTER[1:]:
        failed = [key for key, row in best.items() if not row["holds"] and "loosened" not in key[0]]
        if not failed:
            break
        again = _asked(task, [(peer, share * ratio) for peer, ratio in failed])
        for (peer, ratio), answer in zip(failed, again, strict=True):
            best[peer, ratio] = _answered(task, ratio, peer, answer) | {"note": f"threshold {share:g} of its own"}
    return list(best.values())


def _order(row: Row) -> tuple[bool, float]:
    """Designs whose certificate holds and which have a way come first, the shortest ahead."""
    metres = row["metres"] if row["holds"] else None
    return metres is None, metres or 0.0


def _asked(task: CoverTask, designs: Sequence[tuple[str, float]]) -> list[Any]:
    kernel = task.learned.kernel.parameters()
    return list(SGPTOOLS_COVERS.ask({
        "objective_m": task.targets_m.tolist(), "start_m": list(task.start_m), "variance": kernel["variance"],
        "length_scale_m": kernel["length_scale_m"], "noise_variance": task.learned.noise_variance,
        "designs": [{"method": peer, "threshold": share * kernel["variance"]} for peer, share in designs],
    }))  # fmt: skip


def _answered(task: CoverTask, ratio: float, name: str, answer: Any) -> Row:
    if "why" in answer:
        return _judged(task, ratio, name, None, 0.0, answer["why"])
    places = moved_onto(np.array(answer["places_m"]).reshape(-1, 2), task.field.region.grid, task.reached)
    _, first = np.unique(places, axis=0, return_index=True)  # several may have been moved to one place
    return _judged(task, ratio, name, places[np.sort(first)], answer["seconds"])
