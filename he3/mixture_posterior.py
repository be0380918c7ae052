"""The posterior on every cell of the site under a mixture of kernels: the law of total variance, cell by cell.

One kernel, the hyperparameters' own, has its exact posterior on every cell. The kernels of the mixture have theirs,
exact too, on a coarser grid of at most ``MOST_CELLS`` cells over the same site. There the mixture's mean differs from
that of the one kernel, and its standard deviation is in some ratio to that of the one kernel. Both change from sample
to sample rather than from cell to cell, but for the few cells at a sample itself (docs/uncertainty.md has figures). So
they are interpolated bilinearly on the cells, and correct the one kernel's map:

    mean = mean_one + (mean_mixture - mean_one),      std = std_one (std_mixture / std_one)

On a site of no more cells than that, nothing is interpolated and the moments are exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from he3.coarse_grid import coarser, on_cells
from he3.frames import SiteGrid
from he3.intervals import NORMAL_ENDS, Intervals
from he3.mixture import alone, alternatives_of, mixture_moments
from he3.tails import interval_levels, residuals
from he3.warped_intervals import warped_intervals

if TYPE_CHECKING:
    from he3.frames import FloatArray
    from he3.gp import GaussianProcess
    from he3.hyperparameters import Hyperparameters
    from he3.posterior.grid import GridPosterior, PosteriorMap


class MixturePosterior:
    """The belief on every cell, as ``GridPosterior``; where the kernel is certain, it is that, to the byte."""

    def __init__(
        self,
        grid: SiteGrid,
        hyperparameters: Hyperparameters,
        posterior: Callable[[SiteGrid, Hyperparameters], GridPosterior],
    ) -> None:
        """posterior: makes the posterior of one kernel on a grid, from the same samples each time."""
        self._one = posterior(grid, hyperparameters)
        self._coarse_one = self._one
        self._weights = np.empty(0)
        self._parts: list[GridPosterior] = []
        self._map: PosteriorMap | None = None
        self._levels: FloatArray | None = None
        self._made_from = len(self._one)
        if hyperparameters.alternatives:
            coarse = coarser(grid)
            weights, each = zip(*alternatives_of(hyperparameters), strict=True)
            self._weights = np.array(weights)
            self._parts = [posterior(coarse, one) for one in each]
            if coarse != grid:
                self._coarse_one = posterior(coarse, alone(hyperparameters))

    def __len__(self) -> int:
        """Number of samples."""
        return len(self._one)

    @property
    def process(self) -> GaussianProcess:
        """The belief as an immutable process under the one kernel; ``ProcessMixture.of`` gives that of the mixture."""
        return self._one.process

    def add(self, xy_m: ArrayLike, value_ppb: float) -> None:
        """Add one observation [ppb] at the place (2,) [m]; raises, and changes nothing, as ``GridPosterior.add``."""
        self._one.add(xy_m, value_ppb)
        self._map = None
        for other in (self._coarse_one, *self._parts):
            if other is not self._one:
                other.add(xy_m, value_ppb)

    def snapshot(self) -> PosteriorMap:
        """The present map, safe to pass to other threads: its arrays never change."""
        one = self._one.snapshot()
        if not self._parts:
            return one
        if self._map is None:
            coarse = self._coarse_one.snapshot()
            mean, std = mixture_moments(self._weights, *self._moments())
            grids = self._one.grid, self._coarse_one.grid
            mean_ppb = one.mean_ppb + on_cells(mean - coarse.mean_ppb, *grids)
            std_ppb = one.std_ppb * on_cells(std / coarse.std_ppb, *grids)
            for values in (mean_ppb, std_ppb):
                values.setflags(write=False)
            self._map = replace(one, mean_ppb=mean_ppb, std_ppb=std_ppb)
        return self._map

    def intervals(self) -> Intervals | None:
        """The central intervals of the field; None where the kernel is certain, and every cell is normal.

        What the samples tell of the field's tails is learned from those that it was made from, not from those added.
        """
        if not self._parts:
            return None
        if self._levels is None:
            scores = residuals(self._weights, [part.process for part in self._parts], self._made_from)
            two, one = interval_levels(scores, NORMAL_ENDS[:1:-1])
            self._levels = np.array([-two, -one, one, two])
        grid, warps = self._coarse_one.grid, [part.hyperparameters.warp for part in self._parts]
        if any(warps):
            return warped_intervals(grid, self._weights, *self._latent_moments(), warps, self._levels)
        return Intervals.of(grid, self._weights, *self._latent_moments(), self._levels)

    def _latent_moments(self) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Means and standard deviations (K, rows, columns) of the parts on the coarser grid, of their latent fields."""
        maps = [part.snapshot() for part in self._parts]
        return np.stack([part.mean_ppb for part in maps]), np.stack([part.std_ppb for part in maps])

    def _moments(self) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Means and standard deviations (K, rows, columns) [ppb] of the parts on the coarser grid."""
        means, stds = self._latent_moments()
        for number, part in enumerate(self._parts):
            if (warp := part.hyperparameters.warp) is not None:
                mean, variance = warp.moments(means[number].astype(np.float64), stds[number].astype(np.float64) ** 2)
                means[number], stds[number] = mean, np.sqrt(variance)
        return means, stds
