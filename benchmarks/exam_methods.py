"""The methods of the exam: how places are chosen, how the map is made of the samples, and both from other software.

A method has two halves, which its name tells: `tour` alone is our planner with our map, `tour+sklearn` are the same
samples with scikit-learn's best Gaussian process, `sgptools+ours` are the peers' samples with our map. A survey is
compared with others of the same samples, seed, noise and start.

SGP-Tools has the metres of `tour` as its budget, and does not use them all. `tour-matched` is `tour`, flown again with
the metres that SGP-Tools drove as its budget. So the two are compared at no more metres of ours.
"""

from __future__ import annotations

import dataclasses
import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import Any

import numpy as np

from benchmarks.exam_fields import ExamField
from benchmarks.exam_patterns import at_random, boustrophedon, hexagonal, moved_onto
from benchmarks.flights import planner_for
from benchmarks.missions import FOOTPRINT_RADIUS_M, SAMPLES_A_ROUND, run_mission, start_of
from benchmarks.peer_environments import PYPOLO, SGPTOOLS, PeerEnvironment
from benchmarks.pypolo_peer import survey_with_pypolo
from benchmarks.sgptools_peer import belief_of, map_of_sgptools, noise_of, path_through, plan_with_sgptools
from he3.errors import He3Error
from he3.frames import BoolArray, FloatArray, SiteGrid, path_length
from services.ground.terrain import GroundTerrain

PAPER_KERNEL = "se"
SMOOTH_AND_ROUGH = "smooth+rough"
"""Kernel of the covariance that SGP-Tools is given; it plans with sums of kernels, too."""
SKLEARN_RESTARTS = 2


@dataclass(frozen=True, slots=True)
class Settings:
    """What all surveys of one exam share."""

    samples: int
    kernel: str
    """Of our planners and our map."""
    likeliest: bool
    """Hyperparameters of maximum likelihood in our map; else under priors."""
    budget_m: float = inf
    start_m: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """The samples of a method, the metres that they cost, and the map made of them."""

    places_m: FloatArray
    values_ppb: FloatArray
    metres: float
    mean_ppb: FloatArray
    std_ppb: FloatArray
    seconds: float
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """One survey to fly: field, settings and seed, and the surveys of the methods that come before it, by their names.

    A survey from before may lack its map, and that of a peer its samples too; it always has its metres.
    """

    field: ExamField
    settings: Settings
    seed: int
    before: Mapping[str, Survey] = dataclasses.field(default_factory=dict)

    @property
    def start_m(self) -> tuple[float, float]:
        return self.settings.start_m or start_of(self.field.region)


Fly = Callable[[Asked], Survey]


@dataclass(frozen=True, slots=True)
class Method:
    """A method by its function; after: the method whose survey it needs; peer: the software that it runs."""

    fly: Fly
    after: str | None = None
    peer: PeerEnvironment | None = None
    open_ground: bool = False
    """It knows no obstacles."""


def _planner(asked: Asked, name: str, kernel: str | None = None, budget_m: float = inf) -> Survey:
    """One of our planners, sample by sample. kernel: with the paper's maximum likelihood; None for our own belief.

    budget_m: holds beside that of the settings.
    """
    settings, field = asked.settings, asked.field
    mission = run_mission(
        field.region, planner_for(name), kernel or settings.kernel, asked.seed,
        rounds=settings.samples // SAMPLES_A_ROUND, budget_m=min(budget_m, settings.budget_m),
        noise_std_ppb=field.noise_std_ppb, likeliest=settings.likeliest if kernel is None else True,
        start_m=asked.start_m,
    )  # fmt: skip
    return Survey(
        mission.samples_m, mission.values_ppb, mission.row["path_length_m"], mission.mean_ppb.astype(np.float64),
        mission.std_ppb.astype(np.float64), mission.row["wall_time_s"], mission.ended,
    )  # fmt: skip


def _tour_matched(asked: Asked) -> Survey:
    """`tour` with the metres that SGP-Tools drove, on the same field with the same seed, as its budget.

    Raises He3Error if it drives more than that.
    """
    metres = asked.before["sgptools"].metres
    survey = _planner(asked, "tour", budget_m=metres)
    if survey.metres > metres:
        raise He3Error(f"expected at most the {metres:g} m of sgptools, got {survey.metres:g} m")
    return survey


def _cover(asked: Asked, pattern: Callable[[Asked, BoolArray], FloatArray]) -> Survey:
    """Places of a pattern, driven in their order around obstacles within the budget, and our map of them."""
    began = time.perf_counter()
    region, start_m = asked.field.region, asked.start_m
    ground = GroundTerrain(region.grid, region.traversable, FOOTPRINT_RADIUS_M).for_legs()
    reached = ground.connected_to(start_m)
    places = moved_onto(pattern(asked, reached), region.grid, reached)
    path = path_through(ground, start_m, places)[0]
    while len(places) > 1 and path_length(path) > asked.settings.budget_m:
        places = places[:-1]
        path = path_through(ground, start_m, places)[0]
    return _mapped(asked, places, path_length(path), time.perf_counter() - began)


def _rows(asked: Asked, _open: BoolArray) -> FloatArray:
    return boustrophedon(asked.settings.samples, asked.field.region.grid.width_m, asked.field.region.grid.height_m)


def _lattice(asked: Asked, _open: BoolArray) -> FloatArray:
    return hexagonal(asked.settings.samples, asked.field.region.grid.width_m, asked.field.region.grid.height_m)


def _chance(asked: Asked, reached: BoolArray) -> FloatArray:
    return at_random(asked.settings.samples, asked.field.region.grid, reached, asked.start_m, asked.seed)


def _mapped(asked: Asked, places: FloatArray, metres: float, seconds: float) -> Survey:
    """The survey of these places with our map."""
    field, settings = asked.field, asked.settings
    noise = noise_of(asked.seed, len(places), field.noise_std_ppb)
    values = field.region.he3_ppb[field.region.grid.cells_of(places)] + noise
    began = time.perf_counter()
    belief = belief_of(field.region, places, values, settings.kernel, asked.seed, field.noise_std_ppb,
                       likeliest=settings.likeliest)  # fmt: skip
    mean, std = (array.astype(np.float64) for array in (belief.map.mean_ppb, belief.map.std_ppb))
    return Survey(places, values, metres, mean, std, seconds + time.perf_counter() - began)


def _sklearn_of(asked: Asked, name: str) -> Survey:
    """The samples of that method under scikit-learn's best Gaussian process."""
    return _with_sklearn(asked, asked.before[name])


def _sklearn_of_cover(asked: Asked, pattern: Callable[[Asked, BoolArray], FloatArray]) -> Survey:
    """The samples of a cover under scikit-learn's best Gaussian process."""
    return _with_sklearn(asked, _cover(asked, pattern))


def _with_sklearn(asked: Asked, survey: Survey) -> Survey:
    began = time.perf_counter()
    field = asked.field
    mean, std, kernel = sklearn_map(
        field.region.grid, survey.places_m, survey.values_ppb, field.noise_std_ppb, asked.seed
    )
    return replace(survey, mean_ppb=mean, std_ppb=std, seconds=time.perf_counter() - began, note=kernel)


def sklearn_map(
    grid: SiteGrid,
    places: FloatArray,
    values: FloatArray,
    noise_std_ppb: float,
    seed: int,
    restarts: int = SKLEARN_RESTARTS,
) -> tuple[FloatArray, FloatArray, str]:
    """Mean and std [ppb] on all cells by scikit-learn's likeliest Gaussian process, and its kernel.

    Kernels: squared exponential, Matern of all three orders, rational quadratic, a smooth part and a rough one, and the
    same with a length for each axis where it has one; each with a constant, and noise learned from the instrument's on.
    """
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, RationalQuadratic, WhiteKernel

    unit = max(grid.width_m, grid.height_m)
    scale = float(values.std()) or 1.0
    noise = max((noise_std_ppb / scale) ** 2, 1e-8)
    reach = (0.005, 5.0)
    both = np.array([0.15, 0.15])
    shapes: list[Any] = [
        RBF(0.15, reach), RBF(both, reach), RationalQuadratic(0.15, 1.0, reach, (1e-2, 1e3)),
        *(Matern(length, reach, nu) for nu in (0.5, 1.5, 2.5) for length in (0.15, both)),
    ]  # fmt: skip
    kernels = [ConstantKernel(1.0, (1e-2, 1e2)) * shape for shape in shapes]
    kernels.append(ConstantKernel(0.7, (1e-3, 1e2)) * RBF(0.25, reach) + ConstantKernel(0.3, (1e-3, 1e2))
                   * Matern(0.06, reach, 0.5))  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        fitted = [
            GaussianProcessRegressor(
                kernel + WhiteKernel(noise, (noise, max(1.0, 10 * noise))), n_restarts_optimizer=restarts,
                normalize_y=True, random_state=seed,
            ).fit(places / unit, values)
            for kernel in kernels
        ]  # fmt: skip
    best = max(fitted, key=lambda process: process.log_marginal_likelihood_value_)
    learned = best.kernel_.k2.noise_level
    parts = [best.predict(part / unit, return_std=True) for part in np.array_split(grid.points(), 50)]
    mean, std = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    # What is asked for is the field, without the noise that `predict` counts in.
    std = np.sqrt(np.maximum(std**2 - learned * scale**2, 1e-12 * scale**2))
    return mean.reshape(grid.shape), std.reshape(grid.shape), str(best.kernel_)


def _sgptools(asked: Asked, *, online: bool) -> Survey:
    """SGP-Tools' places within the metres of `tour`, and its own map. Offline it is given a covariance to plan with."""
    field, region, seed, tour = asked.field, asked.field.region, asked.seed, asked.before["tour"]
    noise = noise_of(seed, asked.settings.samples, field.noise_std_ppb)
    learned = None
    if not online:  # what 150 samples of the very field teach favours it
        learned = belief_of(region, tour.places_m, tour.values_ppb, SMOOTH_AND_ROUGH, seed, field.noise_std_ppb)
    plan = plan_with_sgptools(
        region, asked.settings.samples, tour.metres, seed, asked.start_m,
        learned.hyperparameters if learned is not None else None, noise,
    )  # fmt: skip
    values = region.he3_ppb[region.grid.cells_of(plan.places_m)] + noise[: len(plan.places_m)]
    mean, std = map_of_sgptools(region, plan.places_m, values)
    return Survey(plan.places_m, values, path_length(plan.path_m), mean, std, plan.seconds)


def _pypolo(asked: Asked, strategy: str) -> Survey:
    field = asked.field
    noise = noise_of(asked.seed, asked.settings.samples, field.noise_std_ppb)
    found = survey_with_pypolo(field.region, strategy, asked.start_m, field.noise_std_ppb, noise, asked.seed)
    return Survey(found.places_m, found.values_ppb, path_length(found.path_m), found.mean_ppb, found.std_ppb,
                  found.seconds)  # fmt: skip


def with_our_map(asked: Asked, survey: Survey) -> Survey:
    """The same samples under our map."""
    return _mapped(asked, survey.places_m, survey.metres, survey.seconds)


METHODS = {
    "tour": Method(partial(_planner, name="tour")),
    "tour+sklearn": Method(partial(_sklearn_of, name="tour"), after="tour"),
    "informative": Method(partial(_planner, name="informative")),
    "rrtstar": Method(partial(_planner, name="rrtstar", kernel=PAPER_KERNEL)),
    "rrtstar-own-kernel": Method(partial(_planner, name="rrtstar")),
    "boustrophedon": Method(partial(_cover, pattern=_rows)),
    "hexagonal": Method(partial(_cover, pattern=_lattice)),
    "random": Method(partial(_cover, pattern=_chance)),
    "hexagonal+sklearn": Method(partial(_sklearn_of_cover, pattern=_lattice)),
    "random+sklearn": Method(partial(_sklearn_of_cover, pattern=_chance)),
    "sgptools": Method(partial(_sgptools, online=False), after="tour", peer=SGPTOOLS),
    "tour-matched": Method(_tour_matched, after="sgptools"),
    "tour-matched+sklearn": Method(partial(_sklearn_of, name="tour-matched"), after="tour-matched"),
    "sgptools-online": Method(partial(_sgptools, online=True), after="tour", peer=SGPTOOLS),
    "pypolo-myopic": Method(partial(_pypolo, strategy="myopic"), peer=PYPOLO, open_ground=True),
    "pypolo-active": Method(partial(_pypolo, strategy="active"), peer=PYPOLO, open_ground=True),
}
"""Every method by its name, behind the one that it needs. Peers' samples are scored with our map too: `NAME+ours`."""


def with_needed(names: Iterable[str]) -> tuple[str, ...]:
    """These methods and those that they need, in the order of ``METHODS``."""
    needed: set[str] = set()
    for name in names:
        while name not in needed:
            needed.add(name)
            name = METHODS[name].after or name
    return tuple(name for name in METHODS if name in needed)
