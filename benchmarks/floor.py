"""The floor under every planner: the best design that can be found with the field's true covariance known, offline.

The covariance is fitted to many noiseless cells of the reference field, which no mission ever sees. Designs of all
samples then descend the average posterior variance from several beginnings, without a limit on metres, or within a
budget. The error of one design on one field is partly chance: equally good designs differ by some per cent. So the RMSE
is the mean over all designs whose expected RMSE is within ``ALIKE`` of the best one's, and over several draws of the
sensor's noise; the length is that of the shortest tour found through the best design.

    python -m benchmarks.floor --region t1 --region t2 [--budget M] [--json FILE]
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from math import inf, sqrt
from pathlib import Path

import numpy as np

from benchmarks.missions import FOOTPRINT_RADIUS_M, ROUNDS, SAMPLES_A_ROUND, start_of
from he3.frames import FloatArray
from he3.gp import Hyperparameters, fit_hyperparameters
from he3.hyperparameters import DEFAULT_NOISE_STD_PPB
from he3.i_optimal_design import AverageVariance, field_nodes
from he3.information import rmse
from he3.measurement import sample_noise
from he3.posterior.grid import GridPosterior
from he3.reference import Region
from services.ground.planners.tour.design import initial_design, objective, optimise_places
from services.ground.planners.tour.route import route_through
from services.ground.planners.tour.site import reachable_site
from services.ground.terrain import GroundTerrain
from services.mission.regions import load_region

KERNEL = "smooth+rough"
CELLS = 900
"""Cells of the reference field that the covariance is fitted to."""
FIT_NOISE_PPB = 0.02
DESIGNS = 6
STEPS = 200
FIRST_STEP_M = 5.0
KICKS = 400
NODES = 10_000
"""Nodes on which designs are compared: finer than those on which they descend."""
ALIKE = 1.003
NOISE_SEEDS = 5


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
    progress: Callable[[int, int], None] | None = None,
) -> Floor:
    """The floor of a region for a number of samples, within a budget of metres if one is given."""
    begun = time.perf_counter()
    truth = true_covariance(region, noise_std_ppb, seed, cells)
    traversable = GroundTerrain(region.grid, region.traversable, FOOTPRINT_RADIUS_M).traversable
    site = reachable_site(region.grid, traversable, start_of(region), field_nodes(region.grid, None))
    none = np.zeros((0, 2))
    coarse = AverageVariance(truth.kernel.of_squared_distance, truth.noise_variance, site.nodes, none)
    nodes = field_nodes(region.grid, None, NODES)
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
    return Floor(
        region=region.name,
        samples=samples,
        budget_m=budget_m if budget_m < inf else None,
        rmse_ppb=float(np.mean(achieved)),
        expected_rmse_ppb=expected,
        length_m=float(route.at_m[-1]),
        designs=len(alike),
        seconds=time.perf_counter() - begun,
    )


def true_covariance(
    region: Region, noise_std_ppb: float = DEFAULT_NOISE_STD_PPB, seed: int = 0, cells: int = CELLS
) -> Hyperparameters:
    """The maximum-likelihood covariance of the reference field, for a belief with the given noise."""
    rng = np.random.default_rng(seed)
    seen = rng.choice(region.he3_ppb.size, min(cells, region.he3_ppb.size), replace=False)
    values = region.he3_ppb.ravel()[seen]
    fitted = fit_hyperparameters(region.grid.points()[seen], values, KERNEL, rng=rng, noise_std_ppb=FIT_NOISE_PPB)
    return replace(fitted, noise_std_ppb=noise_std_ppb)


def _rmse(region: Region, truth: Hyperparameters, places: FloatArray, noise_std_ppb: float, seed: int) -> float:
    rows, columns = region.grid.cells_of(places)
    noise = [sample_noise(seed, f"floor{k}", noise_std_ppb) for k in range(len(places))]
    belief = GridPosterior.build(region.grid, truth, places, region.he3_ppb[rows, columns] + np.array(noise))
    return rmse(region.he3_ppb, belief.mean_ppb)


def main() -> None:
    parser = argparse.ArgumentParser(description="The floor under every planner's RMSE and metres.")
    parser.add_argument("--region", action="append", help="t1, t2 or an .npz file; may be repeated")
    parser.add_argument("--budget", type=float, default=inf, help="budget in metres (default: no limit)")
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
        )
        floors.append(asdict(result))
        print(
            f"{result.region}: floor {result.rmse_ppb:.4f} ppb (expected {result.expected_rmse_ppb:.4f}) with "
            f"{result.samples} samples on a tour of {result.length_m:.0f} m  [{result.seconds:.0f} s]",
            flush=True,
        )
    if arguments.json:
        arguments.json.write_text(json.dumps({"rows": floors}, indent=1) + "\n")


if __name__ == "__main__":
    main()
