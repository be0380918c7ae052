"""The floor under every planner: the best design that can be found with the field's true covariance known, offline.

The covariance is fitted to many noiseless cells of the reference field, which no mission ever sees. Designs of all
samples then descend the average posterior variance from several beginnings, without a limit on metres, or within a
budget. The error of one design on one field is partly chance: equally good designs differ by some per cent. So the RMSE
is the mean over all designs whose expected RMSE is within ``ALIKE`` of the best one's, and over several draws of the
sensor's noise; the length is that of the shortest tour found through the best design.

A floor is one for missions from the same start, as the designs keep to the ground that can be reached from there. The
covariance is the likeliest of all kernels, with length scales up to the width of the site. A field may still be no draw
of any stationary covariance: plateaus between slopes, say. Then the posterior variance says little about the error, and
a mission may come out below. A floor is left out, with the reason in ``Floor.why_not``, if the designs' own error is
far from what is expected of it or below the bound, or if the start is in a pocket of the ground. The bound is one for
every planner, adaptive ones too: n measurements leave at least the variance beyond the n largest principal components.

    python -m benchmarks.floor --region t1 --region t2 [--start X,Y] [--budget M] [--json FILE]
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import argparse
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from math import inf, sqrt
from pathlib import Path

import numpy as np

from benchmarks import kept
from benchmarks.missions import FOOTPRINT_RADIUS_M, ROUNDS, SAMPLES_A_ROUND, START_M, start_of
from he3.frames import FloatArray
from he3.gp import Hyperparameters, fit_hyperparameters
from he3.hyperparameters import DEFAULT_NOISE_STD_PPB
from he3.i_optimal_design import AverageVariance, FieldNodes, field_nodes
from he3.information import rmse
from he3.kernels import KERNELS, squared_distances
from he3.measurement import sample_noise
from he3.posterior.grid import GridPosterior
from he3.reference import Region
from services.ground.planners.tour.design import initial_design, objective, optimise_places
from services.ground.planners.tour.route import route_through
from services.ground.planners.tour.site import reachable_site
from services.ground.terrain import GroundTerrain
from services.mission.regions import load_region

CELLS = 900
"""Cells of the reference field that the covariance is fitted to."""
TRIAL_CELLS = 300
"""Cells by which the kernel is chosen."""
FIT_NOISE_PPB = 0.02
DESIGNS = 6
STEPS = 200
FIRST_STEP_M = 5.0
KICKS = 400
NODES = 10_000
"""Nodes on which designs are compared: finer than those on which they descend."""
BOUND_NODES = 1600
"""Nodes of the bound; fewer only lower it."""
ALIKE = 1.003
NOISE_SEEDS = 5
LEAST_REACHED = 0.5
"""Least share of the open ground that can be reached from the start of a floor."""
TYPICAL = 1.3
"""Largest ratio between achieved and expected error, either way, on a field that its covariance describes."""


@dataclass(frozen=True, slots=True)
class Floor:
    """The error and length on one region that no planner can go far below."""

    region: str
    samples: int
    budget_m: float | None
    rmse_ppb: float
    """RMSE on the reference field, mean over designs and noise."""
    expected_rmse_ppb: float
    """Expected RMSE from the best design's posterior variance."""
    length_m: float
    """Length of the tour through the best design, around obstacles, from the start."""
    designs: int
    """Number of designs in the mean."""
    seconds: float
    kernel: str = ""
    """Kernel of the covariance."""
    bound_ppb: float = 0.0
    """Expected RMSE that no set of places and no map can go below, on fields of this covariance; not attainable."""
    start_m: tuple[float, float] = START_M
    """Where the designs' tours begin."""
    why_not: str = ""
    """Why this is no floor for planners; empty if it is one."""


def floor(
    region: Region,
    *,
    samples: int = ROUNDS * SAMPLES_A_ROUND,
    budget_m: float = inf,
    designs: int = DESIGNS,
    steps: int = STEPS,
    cells: int = CELLS,
    noise_std_ppb: float = DEFAULT_NOISE_STD_PPB,
    seed: int = 0,
    start_m: tuple[float, float] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Floor:
    """The floor of a region for a number of samples, within a budget of metres if one is given.

    Errors are over the cells whose reference is known, as those of missions; designs are for all cells.
    start_m: where the missions begin that it is compared with; ``start_of`` the region if None.
    """
    begun = time.perf_counter()
    start_m = start_of(region) if start_m is None else start_m
    truth = true_covariance(region, noise_std_ppb, seed, cells)
    terrain = GroundTerrain(region.grid, region.traversable, FOOTPRINT_RADIUS_M)
    site = reachable_site(region.grid, terrain.traversable, terrain.margin_m, start_m, field_nodes(region.grid, None))
    none = np.zeros((0, 2))
    coarse = AverageVariance(truth.kernel.of_squared_distance, truth.noise_variance, site.nodes, none)
    scored = None if region.known is None else region.known.astype(np.float64)
    nodes = field_nodes(region.grid, scored, NODES)
    fine = AverageVariance(truth.kernel.of_squared_distance, truth.noise_variance, nodes, none)
    rng = np.random.default_rng(seed)
    found: list[tuple[float, FloatArray]] = []
    for number in range(designs):
        places = initial_design(site, none, samples, budget_m, int(rng.integers(len(site.nodes.weights))))
        places = site.snap_to_cell_centres(optimise_places(site, coarse, places, 0.0, budget_m, steps, FIRST_STEP_M))
        found.append((objective(site, fine, places, 0.0, budget_m), places))
        if progress is not None:
            progress(number + 1, designs)
    found.sort(key=lambda design: design[0])
    least, best = found[0]
    route = route_through(site, best, KICKS, seed)
    if route.at_m[-1] > budget_m:
        route = route.truncated(budget_m)
    alike = [places for value, places in found if sqrt(value / least) <= ALIKE]
    achieved = [_rmse(region, truth, places, noise_std_ppb, s) for places in alike for s in range(NOISE_SEEDS)]
    expected = truth.scale_ppb * sqrt(truth.kernel.prior_variance * fine(best))
    bound = lowest_rmse(truth, field_nodes(region.grid, scored, BOUND_NODES), samples)
    rmse_ppb = float(np.mean(achieved))
    return Floor(
        region=region.name,
        samples=samples,
        budget_m=budget_m if budget_m < inf else None,
        rmse_ppb=rmse_ppb,
        expected_rmse_ppb=expected,
        length_m=float(route.at_m[-1]),
        designs=len(alike),
        seconds=time.perf_counter() - begun,
        kernel=truth.kernel.name,
        bound_ppb=bound,
        start_m=start_m,
        why_not=why_not(
            rmse_ppb, expected, bound, float(site.ground.connected_to(start_m).sum() / terrain.traversable.sum())
        ),
    )


def true_covariance(
    region: Region, noise_std_ppb: float = DEFAULT_NOISE_STD_PPB, seed: int = 0, cells: int = CELLS
) -> Hyperparameters:
    """The maximum-likelihood covariance of the reference field, for a belief with the given noise."""
    rng = np.random.default_rng(seed)
    known = region.of_known(np.arange(region.he3_ppb.size).reshape(region.grid.shape))
    seen = known[rng.choice(known.size, min(cells, known.size), replace=False)]
    places, values = region.grid.points()[seen], region.he3_ppb.ravel()[seen]
    extent_m = max(region.grid.width_m, region.grid.height_m)

    def fitted(kernel: str, count: int) -> Hyperparameters:
        return fit_hyperparameters(places[:count], values[:count], kernel, rng=np.random.default_rng(seed),
                                   noise_std_ppb=FIT_NOISE_PPB, extent_m=extent_m)  # fmt: skip

    likeliest = max(KERNELS, key=lambda kernel: fitted(kernel, min(TRIAL_CELLS, cells)).log_likelihood)
    return replace(fitted(likeliest, cells), noise_std_ppb=noise_std_ppb)


def lowest_rmse(truth: Hyperparameters, nodes: FieldNodes, samples: int) -> float:
    """The expected RMSE [ppb] below which no measurements of that number can bring a map of the field.

    Measurements lower the field's covariance by a matrix of their number as rank, wherever they are taken and however
    the places are chosen. What is left is at least the sum of the other eigenvalues (Weyl's inequality). Nodes are
    coarser than cells, which makes the largest eigenvalues larger, and so the bound lower.
    """
    root = np.sqrt(nodes.weights)
    covariance = truth.kernel.of_squared_distance(squared_distances(nodes.places_m, nodes.places_m))
    eigenvalues = np.linalg.eigvalsh(root[:, None] * covariance * root)
    left = float(eigenvalues[: max(0, len(eigenvalues) - samples)].clip(min=0.0).sum())
    return truth.scale_ppb * sqrt(left)


def why_not(rmse_ppb: float, expected_ppb: float, bound_ppb: float, reached: float) -> str:
    """Why the designs' error [ppb] is no floor, beside the expected one and the bound; empty if it is one.

    reached: share of the open ground that can be reached from the start.
    """
    if reached < LEAST_REACHED:
        return (
            f"only {reached:.1%} of the open ground can be reached from the start; from elsewhere more can be measured"
        )
    if not 1.0 / TYPICAL <= rmse_ppb / expected_ppb <= TYPICAL:
        return (
            f"no stationary covariance describes the field: {rmse_ppb:.3f} ppb where {expected_ppb:.3f} ppb is expected"
        )
    if rmse_ppb < bound_ppb:
        return f"the field is smoother than its covariance: {rmse_ppb:.3f} ppb, below the bound of {bound_ppb:.3f} ppb"
    return ""


def _rmse(region: Region, truth: Hyperparameters, places: FloatArray, noise_std_ppb: float, seed: int) -> float:
    rows, columns = region.grid.cells_of(places)
    noise = [sample_noise(seed, f"floor{k}", noise_std_ppb) for k in range(len(places))]
    belief = GridPosterior.build(region.grid, truth, places, region.he3_ppb[rows, columns] + np.array(noise))
    return rmse(region.of_known(region.he3_ppb), region.of_known(belief.mean_ppb))


def _place(text: str) -> tuple[float, float]:
    x, y = (float(part) for part in text.split(","))
    return x, y


def main() -> None:
    parser = argparse.ArgumentParser(description="The floor under every planner's RMSE and metres.")
    parser.add_argument("--region", action="append", help="t1, t2 or an .npz file; may be repeated")
    parser.add_argument("--budget", type=float, default=inf, help="budget in metres (default: no limit)")
    parser.add_argument("--start", type=_place, help="X,Y: where the rover stands at first [m]")
    parser.add_argument("--designs", type=int, default=DESIGNS, help="number of designs")
    parser.add_argument("--steps", type=int, default=STEPS, help="steps of each design's descent")
    parser.add_argument("--cells", type=int, default=CELLS, help="cells to which the covariance is fitted")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parser.parse_args()
    floors = []
    for name in arguments.region or ["t1", "t2"]:
        result = floor(
            load_region(name),
            budget_m=arguments.budget,
            designs=arguments.designs,
            steps=arguments.steps,
            cells=arguments.cells,
            start_m=arguments.start,
        )
        floors.append(asdict(result))
        print(
            f"{result.region}: floor {result.rmse_ppb:.4f} ppb (expected {result.expected_rmse_ppb:.4f}) with "
            f"{result.samples} samples on a tour of {result.length_m:.0f} m; {result.kernel}, bound "
            f"{result.bound_ppb:.4f} ppb  [{result.seconds:.0f} s]",
            flush=True,
        )
        if result.why_not:
            print(f"{result.region}: left out as a floor: {result.why_not}", flush=True)
    kept.write_whole(arguments.json, {"rows": floors})


if __name__ == "__main__":
    main()
