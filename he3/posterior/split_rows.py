"""Rows of V for the sum of a smooth kernel S and a rough one R, of which only the rough part's are kept.

The smooth part makes every sample matter everywhere, and so nothing of V = L^-1 K could be left out. But the two can be
told apart: with w = L^-T l, and M the Cholesky factor of the rough covariance plus noise,

    (k_n - w' K) / d = (s_n - w' S) / d + (r_n - (M' w)' U) / d,      U = M^-1 R(samples, cells)

The first term is separable (``he3.posterior.separable_rows``), the second needs the rows U of a process that is rough
alone, which are local (``he3.posterior.stored_rows``). It is as safe as V itself: M M' <= K plus noise = L L', so
|M' w| <= |L' w| = |l|.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from he3.frames import Float32Array, FloatArray
from he3.gp import GaussianProcess
from he3.hyperparameters import Hyperparameters
from he3.kernels import SmoothPlusRough
from he3.posterior.separable_rows import SeparableRows, row_weights
from he3.posterior.stored_rows import SCREENED, StoredRows, Tied
from he3.posterior.tiles import ShareOut, Tile, TiledGrid


class SplitRows:
    """The smooth part's factors and the rough part's rows at the samples."""

    def __init__(
        self,
        tiled: TiledGrid,
        kernel: SmoothPlusRough,
        hyperparameters: Hyperparameters,
        *,
        screened: float = SCREENED,
    ) -> None:
        """No rows yet. kernel: that of the hyperparameters."""
        self._tiled = tiled
        self._kernel = kernel
        self._smooth = SeparableRows(tiled, kernel.smooth)
        self._rough = StoredRows(tiled, kernel.rough, screened=screened)
        self._rough_alone = GaussianProcess(replace(hyperparameters, kernel=kernel.rough))

    @property
    def values_read(self) -> int:
        return self._rough.values_read

    def next_row(self, process: GaussianProcess, share_out: ShareOut) -> FloatArray:
        """The last of the process's n rows, (cells,) in tile order; all before are known."""
        weights = row_weights(process)
        pivot = float(process.factor[-1, -1])
        tie = self._rough_alone.factor.T @ (-pivot * weights[:-1])
        self._rough_alone = self._rough_alone.condition_on_places(process.places_m[-1:])
        rough = Tied(tie, pivot, self._rough.allowed(self._kernel))
        row = self._smooth.next_sum(process.places_m, weights, share_out)
        row += self._rough.next_rows(self._rough_alone, share_out, rough)[1]
        return row

    def rows_anew(self, process: GaussianProcess) -> Callable[[Tile], Iterator[tuple[int, Float32Array]]]:
        """All rows of a process, in place of those known, as a function of a part of a tile: see ``RowsOnGrid``."""
        self._rough_alone = GaussianProcess(self._rough_alone.hyperparameters).condition_on_places(process.places_m)
        all_on = self._smooth.rows_anew(process)
        rough_on = self._rough.rows_anew(self._rough_alone)  # those to keep; mean and variance need all of the kernel's

        def on_part(part: Tile) -> Iterator[tuple[int, Float32Array]]:
            for _ in rough_on(part):
                pass
            yield from all_on(part)

        return on_part

    def fork(self) -> SplitRows:
        """An independent copy, sharing what neither will change."""
        copy: SplitRows = object.__new__(SplitRows)
        copy.__dict__.update(self.__dict__)
        copy._smooth, copy._rough = self._smooth.fork(), self._rough.fork()
        return copy
