"""Exact posterior mean and variance on every cell of the site, updated one sample at a time.

With L the Cholesky factor of n samples, let V = L^-1 K(samples, cells). A new sample adds one row v to V
(``he3.posterior.rows``), and with its whitened residual b

    v = (k(new, cells) - l' V) / d,      mean += b v,      variance -= v^2

which is the Cholesky factor extended by one row, seen from the cells: nothing is refitted and nothing approximated. The
small factor, l, d and b, and the sums of mean and variance, are in float64. Rows are in float32 where that suffices:
the mean is then off by less than 1e-5 of the field's scale and the variance by less than 1e-4 of the prior variance,
which ``he3.posterior.probes`` verifies after every change. Where it does not suffice, as with an instrument whose noise
is far below the field's own variation, all rows are recomputed in float64 and stay so.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from he3.constants import MAX_SAMPLES
from he3.errors import InvalidInput
from he3.frames import Float32Array, FloatArray, SiteGrid, as_points
from he3.gp import GaussianProcess
from he3.kernels import SquaredExponential
from he3.posterior.probes import LEAST_VARIANCE, Probes
from he3.posterior.row_solving import solve_rows
from he3.posterior.rows import row_source
from he3.posterior.sums import PosteriorSums
from he3.posterior.tiles import Task, Tile, TiledGrid

if TYPE_CHECKING:
    from he3.hyperparameters import Hyperparameters

MAX_ROW_BYTES = 4 * 1024**3  # bytes of stored rows in float32: 4000 samples on 500 x 500 cells; twice that in float64
_CELLS_PER_PART = 4096  # cells whose rows are solved for together: what is worked on stays in cache


@dataclass(frozen=True, slots=True, eq=False)
class PosteriorMap:
    """The map after n samples: read-only (rows, columns) float32 arrays [ppb] that no later sample changes."""

    samples: int
    mean_ppb: Float32Array
    std_ppb: Float32Array


class GridPosterior:
    """The belief on every cell of a grid. ``add`` changes it in place; a ``snapshot`` does not change."""

    def __init__(self, grid: SiteGrid, hyperparameters: Hyperparameters, *, threads: int = 1) -> None:
        """The prior: no samples yet. Several threads share the cells; the results do not depend on their number."""
        if threads < 1:
            raise InvalidInput(f"expected one thread or more, got {threads}")
        self.grid = grid
        self._threads = threads
        # All that is computed on the cells needs the process without the trend; the one with it is made when asked for.
        self._without_trend = GaussianProcess(replace(hyperparameters, trend=None))
        self._process = GaussianProcess(hyperparameters)
        self._not_in_process: list[tuple[FloatArray, FloatArray]] = []
        # Everything kept about the cells is in tile order; a snapshot is in the grid's.
        self._tiled = TiledGrid(grid)
        # Near a sample, the variance is at most that of the noise.
        noise_share = hyperparameters.noise_variance / hyperparameters.kernel.prior_variance
        self._dtype = np.dtype(np.float64 if noise_share < LEAST_VARIANCE else np.float32)
        self._sums = self._prior_sums()
        self._prior_mean_ppb: FloatArray | float = hyperparameters.mean_ppb
        if hyperparameters.trend is not None:
            self._prior_mean_ppb = hyperparameters.prior_mean_ppb(self._points())
        self._rows = row_source(self._tiled, self._without_trend.hyperparameters, self._dtype)
        self._rows_known = True
        self._probes = Probes(self._tiled, hyperparameters)
        self._snapshot: PosteriorMap | None = None

    @classmethod
    def build(
        cls,
        grid: SiteGrid,
        hyperparameters: Hyperparameters,
        xy_m: ArrayLike,
        values_ppb: ArrayLike,
        *,
        threads: int = 1,
        followed: bool = True,
    ) -> GridPosterior:
        """The posterior given observations (n,) [ppb] at places (n, 2) [m], all at once.

        followed: whether samples will be added; if not, what they need is not stored, and the first one takes longer.
        Raises InvalidInput for shapes that do not fit, values that are not finite, or more samples than a map holds.
        """
        posterior = cls(grid, hyperparameters, threads=threads)
        posterior._rows_known = followed
        posterior._take(*posterior._conditioned(as_points(np.asarray(xy_m, dtype=np.float64)), values_ppb))
        posterior._catch_up()  # many samples at once may be too much for a factor: that is said here
        posterior._recompute()
        posterior._ensure_precision(slice(None))
        return posterior

    def __len__(self) -> int:
        """Number of samples."""
        return len(self._without_trend)

    @property
    def hyperparameters(self) -> Hyperparameters:
        return self._process.hyperparameters

    @property
    def process(self) -> GaussianProcess:
        """The belief as an immutable process, which predicts at any place and does not change with later samples."""
        self._catch_up()
        return self._process

    @property
    def values_read(self) -> int:
        """How many stored values the last sample's row was computed from; for the benchmark."""
        return self._rows.values_read

    def add(self, xy_m: ArrayLike, value_ppb: float) -> None:
        """Add one observation [ppb] at the place (2,) [m]. Raises InvalidInput, and changes nothing, as ``build``."""
        place = np.asarray(xy_m, dtype=np.float64)
        if place.shape != (2,):
            raise InvalidInput(f"expected one place (2,) [m], got shape {place.shape}")
        self._without_trend = self._without_trend.with_room()
        without_trend, xy, values = self._conditioned(as_points(place[None, :]), [value_ppb])
        if not self._rows_known:
            self._know_rows()
        n = len(self)
        row = self._rows.next_row(without_trend, self._run_tasks)
        self._take(without_trend, xy, values)
        residual = float(without_trend.whitened[n])
        for tile in self._tiled.tiles:
            self._sums.add_row(n, row[tile.cells], residual, tile.cells)
        self._ensure_precision(self._tiled.tile_near(place).cells)

    def at(self, points_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Posterior mean (k,) and standard deviation (k,) [ppb] at arbitrary places (k, 2) [m], exact."""
        return self.process.predict(points_m)

    @property
    def mean_ppb(self) -> Float32Array:
        """Posterior mean (rows, columns) [ppb], read-only."""
        return self.snapshot().mean_ppb

    @property
    def std_ppb(self) -> Float32Array:
        """Posterior standard deviation of the field (rows, columns) [ppb], noise excluded, read-only."""
        return self.snapshot().std_ppb

    def snapshot(self) -> PosteriorMap:
        """The present map, safe to pass to other threads: its arrays never change."""
        if self._snapshot is None:
            scale = self.hyperparameters.scale_ppb
            least = self._without_trend.least_variance()
            mean, variance = self._sums.posterior(self._without_trend.whitened, least)
            maps = [
                self._tiled.on_grid(values.astype(np.float32))
                for values in (mean * scale + self._prior_mean_ppb, np.sqrt(variance) * scale)
            ]
            for values in maps:
                values.setflags(write=False)
            self._snapshot = PosteriorMap(len(self), *maps)
        return self._snapshot

    def _points(self) -> FloatArray:
        """Centres of the cells (cells, 2) [m], in tile order."""
        return self._tiled.in_tile_order(self.grid.points())

    def _prior_sums(self) -> PosteriorSums:
        points = self._points() if PosteriorSums.needs_points(self.hyperparameters) else None
        return PosteriorSums.prior(self.hyperparameters, points, self._tiled.cells)

    def _catch_up(self) -> None:
        """Take the samples into the process with the trend that it has not yet."""
        if self.hyperparameters.trend is None and self._not_in_process:
            self._process = self._without_trend.without_room()
        else:
            for places, values in self._not_in_process:
                self._process = self._process.condition(places, values)
        self._not_in_process = []

    def _conditioned(self, xy: FloatArray, values_ppb: ArrayLike) -> tuple[GaussianProcess, FloatArray, FloatArray]:
        """The process without the trend with more samples, and their places and values [ppb]."""
        expect_map_fits(self.grid, self.hyperparameters.kernel.name, len(self) + len(xy))
        values = np.asarray(values_ppb, dtype=np.float64)
        trend = self.hyperparameters.trend
        detrended = values if trend is None else values - trend.at(xy)
        return self._without_trend.condition(xy, detrended), xy, values

    def _take(self, without_trend: GaussianProcess, xy: FloatArray, values: FloatArray) -> None:
        first = len(self)
        self._without_trend, self._snapshot = without_trend, None
        self._not_in_process.append((xy, values))
        if self._sums.trend is not None:
            basis = self.hyperparameters.trend_basis(xy)
            assert basis is not None
            self._sums.trend = self._sums.trend.extended(without_trend.factor[first:], basis)

    def _recompute(self) -> None:
        """Compute mean, variance and rows from all samples at once, beginning from the prior's sums."""
        process = self._without_trend
        if self._rows_known:
            self._rows = row_source(self._tiled, process.hyperparameters, self._dtype, len(process))
            rows_on = self._rows.recompute(process)
        else:
            rows_on = partial(solve_rows, process, process.factor.astype(self._dtype), self.grid)
        whitened = process.whitened.astype(self._dtype)

        def fill(part: Tile) -> None:
            for first, rows in rows_on(part):
                self._sums.add_rows(first, rows, whitened[first : first + len(rows)], part.cells)

        self._on_parts(fill)

    def _know_rows(self) -> None:
        """Compute the rows of all samples again, to store what the next row depends on."""
        process = self._without_trend
        self._rows = row_source(self._tiled, process.hyperparameters, self._dtype, len(process))
        rows_on = self._rows.recompute(process)

        def store(part: Tile) -> None:
            for _ in rows_on(part):
                pass

        self._on_parts(store)
        self._rows_known = True

    def _on_parts(self, work: Callable[[Tile], None]) -> None:
        """Do some work on each part of the grid."""
        parts = (part for tile in self._tiled.tiles for part in tile.parts(_CELLS_PER_PART))
        self._run_tasks(partial(work, part) for part in parts)

    def _ensure_precision(self, changed: slice) -> None:
        """Recompute everything in float64 if float32 rows do not suffice for the samples so far.

        changed: the cells whose variance has fallen most.
        """
        if self._dtype == np.float64:
            return
        trend = self._sums.trend
        self._probes.extend(self._without_trend, None if trend is None else trend.whitened)
        if self._probes.agree_with(self._sums, self._without_trend.whitened, changed):
            return
        self._dtype = np.dtype(np.float64)
        self._sums = self._prior_sums()
        if trend is not None and self._sums.trend is not None:
            self._sums.trend = replace(self._sums.trend, whitened=trend.whitened)
        self._recompute()

    def _run_tasks(self, tasks: Iterable[Task]) -> None:
        """Run all tasks, on this thread and the others; the results do not depend on the assignment."""
        waiting = deque(tasks)

        def run_waiting() -> None:
            while True:
                try:
                    task = waiting.popleft()
                except IndexError:
                    return
                task()

        helpers = min(self._threads, len(waiting)) - 1
        others = [_pool(self._threads - 1).submit(run_waiting) for _ in range(helpers)]
        run_waiting()
        for other in others:
            if not other.cancel():  # one that has not begun is no longer needed
                other.result()


def expect_map_fits(grid: SiteGrid, kernel_name: str, samples: int) -> None:
    """Raises InvalidInput if the map of that many samples, with that kernel or "auto", would take too much memory.

    Neither does a map hold more than ``MAX_SAMPLES``.

    The rows are counted in float32. In float64 they may take twice as much: a map that is accepted here is never
    refused when its samples turn out to need that.
    """
    if samples > MAX_SAMPLES:
        raise InvalidInput(f"expected at most {MAX_SAMPLES} samples on a grid, got {samples}")
    separable = kernel_name == SquaredExponential.name
    size = 0 if separable else samples * grid.rows * grid.columns * np.dtype(np.float32).itemsize
    if size > MAX_ROW_BYTES:
        raise InvalidInput(
            f"expected a map that takes at most {MAX_ROW_BYTES / 1024**3:.0f} GiB, got {size / 1024**3:.1f} GiB for "
            f"{samples} samples on {grid.rows} x {grid.columns} cells: use fewer samples, larger cells or kernel se"
        )


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="map")
