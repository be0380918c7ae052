"""The belief about the field: every sample is added as it arrives, the hyperparameters are refitted once a round.

The map depends on the history of events alone. Samples are added in the order in which they arrive; after each refit
the whole map is rebuilt with the samples in the order in which they were planned. The fit of round k sees exactly the
samples of rounds 1 to k, and the fit before it. So once all samples are in the map, it is the same to the byte for any
order and any delays of their arrival.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from he3.coarse_grid import coarser, on_cells
from he3.constants import HELIUM3_MAX_PPB
from he3.errors import InvalidInput
from he3.gp import GaussianProcess, Hyperparameters
from he3.hyperparameters import CAUTIOUS_FIRST
from he3.hyperprior import MEAN_PPB, Hyperprior
from he3.kernels import AUTO, kernel_from
from he3.mixture_posterior import MixturePosterior
from he3.posterior.grid import GridPosterior, PosteriorMap, expect_map_fits
from services.ground.fitting import FitRequest, fit

if TYPE_CHECKING:
    from he3.frames import Float32Array, FloatArray, SiteGrid
    from he3.intervals import Intervals
    from he3.trend import CovariateTrend
    from services.ground.observation import Observation
    from services.runtime.node import SavedState

# The map before the first sample, where hyperparameters are the likeliest ones, which no sample determines yet.
PRIOR_SCALE_PPB = 4.0
PRIOR_KERNEL = "matern52"  # where the kernel is chosen by the evidence alone, and there is none yet
BELOW_ZERO_PPB = 1e3  # an instrument may read so far below zero, or beyond what a soil can hold
MIN_ORBITAL_STD_PPB = 0.05  # spread of an orbital map below which it is uniform [assumed]
NOISE_STDS = 10.0  # or this many standard deviations of its noise, so that no valid reading is refused


MAP_THREADS = 2
"""Threads among which the map's cells are divided; the map does not depend on their number."""


class Belief:
    """The map and the samples that it is computed from; changed by `add` and `adopt` alone."""

    def __init__(
        self,
        grid: SiteGrid,
        kernel: str,
        noise_std_ppb: float,
        trend: CovariateTrend | None = None,
        *,
        likeliest: bool = False,
        most_cells: int | None = None,
        followed: bool = True,
    ) -> None:
        """likeliest: take the hyperparameters of maximum likelihood for certain, as the paper does.

        most_cells: the map is computed on a coarser grid of so many cells at most, and interpolated between them.
        followed: whether map and process are read after each sample; else they take it in when they are read.
        """
        self.grid = grid
        self._coarse = grid if most_cells is None else coarser(grid, most_cells)
        self._followed = followed
        self._kernel = kernel
        self._noise_std_ppb = noise_std_ppb
        self._trend = trend
        self._prior = None if likeliest else hyperprior(grid, trend)
        self._observations: dict[str, Observation] = {}
        self._posterior: MixturePosterior | None = None
        self._map: PosteriorMap | None = None
        self._intervals: Intervals | None = None  # follows from the rest, as the posterior does
        self._process = GaussianProcess(self._first())
        self._to_take_in: list[tuple[str, ...]] = []  # samples of which the process does not know yet, batch by batch
        self._fits = 0
        self._built: tuple[str, ...] = ()  # the samples that the map was last built from; the others were added since

    def _first(self) -> Hyperparameters:
        """The hyperparameters before the first sample."""
        of_auto = PRIOR_KERNEL if self._prior is None else CAUTIOUS_FIRST[0]
        kernel = of_auto if self._kernel == AUTO else self._kernel
        if self._trend is not None:
            likeliest = Hyperparameters(kernel_from(kernel), self._noise_std_ppb, trend=self._trend)
        else:
            likeliest = Hyperparameters(kernel_from(kernel), self._noise_std_ppb, MEAN_PPB, PRIOR_SCALE_PPB)
        if self._prior is not None:
            request = FitRequest(
                xy_m=np.empty((0, 2)), values_ppb=np.empty(0), kernel=self._kernel, noise_std_ppb=self._noise_std_ppb,
                previous=None, trend=self._trend, seed=(), extent_m=self._extent_m, prior=self._prior,
            )  # fmt: skip
            return self._with_trend(fit(request).with_kernel_of(likeliest))
        return likeliest

    def _with_trend(self, fitted: Hyperparameters) -> Hyperparameters:
        return fitted if self._trend is None else replace(fitted, trend=self._trend)

    @property
    def _extent_m(self) -> float:
        """The site's longer side [m]."""
        return self.grid.extent_m

    def __len__(self) -> int:
        """Number of measurements in the map."""
        return len(self._observations)

    def __contains__(self, sample_id: object) -> bool:
        return sample_id in self._observations

    @property
    def hyperparameters(self) -> Hyperparameters:
        return self._process.hyperparameters

    @property
    def fits(self) -> int:
        """How often the map was rebuilt with new hyperparameters."""
        return self._fits

    @property
    def process(self) -> GaussianProcess:
        """The belief as an immutable Gaussian process under the most probable kernel.

        ``ProcessMixture.of`` gives those under its alternatives, whose moments the map has.
        """
        for names in self._to_take_in:
            self._process = self._process.condition(*self._samples(names))
        self._to_take_in.clear()
        return self._process

    @property
    def changes(self) -> int:
        """Counts the changes of the map."""
        return self._fits + len(self._observations)

    @property
    def map(self) -> PosteriorMap:
        """Mean and standard deviation on every cell [ppb]: arrays that no later sample touches.

        Computed when it is asked for; it does not depend on how often that is.
        """
        if self._map is None:
            self._map = self._shown(self._standing())
        return self._map

    @property
    def intervals(self) -> Intervals | None:
        """The central intervals of the map, computed when they are asked for; None where every cell is normal."""
        if self.hyperparameters.alternatives and self._intervals is None:
            self._intervals = self._standing().intervals()
        return self._intervals

    def interval_ends(self) -> Float32Array | None:
        """Ends of the intervals (4, rows, columns) on the cells, in standard deviations; None where all are normal."""
        return None if self.intervals is None else self.intervals.on(self.grid)

    @property
    def places_m(self) -> FloatArray:
        """(n, 2) [m], in the order in which the samples were planned."""
        return np.array([observed.place_m for observed in self._in_order()], dtype=np.float64).reshape(-1, 2)

    def add(self, sample_id: str, observation: Observation) -> bool:
        """Add a measurement; False, and nothing changes, if it was there already.

        Raises OutsideRegion or InvalidInput, without a change, for an impossible place or value.
        """
        if sample_id in self._observations:
            return False
        margin = max(BELOW_ZERO_PPB, NOISE_STDS * self._noise_std_ppb)
        low, high = -margin, HELIUM3_MAX_PPB + margin
        if not (isfinite(observation.value_ppb) and low <= observation.value_ppb <= high):
            raise InvalidInput(f"sample {sample_id}: expected {low:g} to {high:g} ppb, got {observation.value_ppb:g}")
        places = np.array([observation.place_m], dtype=np.float64)
        self.grid.cells_of(places)
        expect_map_fits(self.grid, self.hyperparameters.kernel.name, len(self) + 1)
        if self._followed:
            self._process = self._process.condition(places, [observation.value_ppb])
        else:
            self._to_take_in.append((sample_id,))
        self._observations[sample_id], self._map, self._intervals = observation, None, None
        return True

    def fit_request(self, up_to_round: int, seed: tuple[int, ...]) -> FitRequest | None:
        """The input of the refit after that round; None without a sample."""
        known = [observed for observed in self._in_order() if observed.planned[0] <= up_to_round]
        if not known:
            return None
        return FitRequest(
            xy_m=np.array([observed.place_m for observed in known], dtype=np.float64),
            values_ppb=np.array([observed.value_ppb for observed in known], dtype=np.float64),
            kernel=self._kernel,
            noise_std_ppb=self._noise_std_ppb,
            previous=self.hyperparameters,
            trend=self._trend,
            seed=seed,
            extent_m=self._extent_m,
            prior=self._prior,
        )

    def adopt(self, fitted: Hyperparameters) -> None:
        """Rebuild the map with new hyperparameters, from all samples in the order in which they were planned."""
        self._fits += 1
        planned = {name: observed.planned for name, observed in self._observations.items()}
        self._built = tuple(sorted(planned, key=planned.__getitem__))
        self._process = GaussianProcess(self._with_trend(fitted))
        self._to_take_in = [self._built] if self._built else []
        if self._followed:
            self._process = self.process
        self._posterior = self._map = self._intervals = None

    def begin_with(self, observations: Mapping[str, Observation], fitted: Hyperparameters) -> None:
        """Take in these samples at once, as if they had been added and these hyperparameters then adopted."""
        self._observations.update(observations)
        self.adopt(fitted)

    def _rebuilt(self, hyperparameters: Hyperparameters) -> MixturePosterior:
        """The map of the last refit, without the samples added since."""
        if not self._built:
            return MixturePosterior(self._coarse, hyperparameters, self._empty)
        places, values = self._samples(self._built)

        def posterior(grid: SiteGrid, of: Hyperparameters) -> GridPosterior:
            return GridPosterior.build(grid, of, places, values, threads=MAP_THREADS, followed=self._followed)

        return MixturePosterior(self._coarse, hyperparameters, posterior)

    def _shown(self, posterior: MixturePosterior) -> PosteriorMap:
        """The map on the site's cells."""
        known = posterior.snapshot()
        if self._coarse is self.grid:
            return known
        layers = [on_cells(layer, self.grid, self._coarse) for layer in (known.mean_ppb, known.std_ppb)]
        return PosteriorMap(known.samples, *layers)

    @staticmethod
    def _empty(grid: SiteGrid, hyperparameters: Hyperparameters) -> GridPosterior:
        """The posterior of one kernel before any sample."""
        return GridPosterior(grid, hyperparameters, threads=MAP_THREADS)

    def _standing(self) -> MixturePosterior:
        """The present posterior: that of the last refit, to which the samples since are added one by one."""
        if self._posterior is None:
            self._posterior = self._rebuilt(self.hyperparameters)
        for observed in list(self._observations.values())[len(self._posterior) :]:
            self._posterior.add(observed.place_m, observed.value_ppb)
        return self._posterior

    def _samples(self, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """Places (n, 2) [m] and values (n,) [ppb] of the samples of those names."""
        observed = [self._observations[name] for name in names]
        places = np.array([each.place_m for each in observed], dtype=np.float64).reshape(-1, 2)
        return places, np.array([each.value_ppb for each in observed], dtype=np.float64)

    def _in_order(self) -> list[Observation]:
        return sorted(self._observations.values(), key=lambda observed: observed.planned)

    # --- checkpoints ------------------------------------------------------------------------------------------------

    def checkpoint(self) -> SavedState:
        """The whole state but the posterior, as named parts. The posterior takes up to 1 GB and is recomputed."""
        return {
            "observations": dict(self._observations),
            "map": self._map,
            "process": self.process,
            "built": self._built,
            "fits": self._fits,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the belief from this state."""
        self._observations, self._built, self._fits = state["observations"], state["built"], state["fits"]
        self._process, self._posterior, self._intervals = state["process"], None, None
        self._to_take_in.clear()
        self._map = state["map"]  # None: it follows from the rest


def hyperprior(grid: SiteGrid, trend: CovariateTrend | None) -> Hyperprior:
    """What is known of the site's hyperparameters before landing."""
    extent_m = grid.extent_m
    spread_ppb = 0.0 if trend is None else trend.spread_ppb
    # A map that shows no contrast says nothing of what it does not resolve.
    return Hyperprior(extent_m) if spread_ppb < MIN_ORBITAL_STD_PPB else Hyperprior(extent_m, field_std_ppb=spread_ppb)
