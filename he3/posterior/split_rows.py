"""Rows of V for the sum of a smooth kernel S and a rough one R, of which only the rough part's rows are stored.

In the smooth part every sample has influence everywhere, so screening could leave out nothing of V = L^-1 K. But the
two parts can be separated: with w = L^-T l, and M the Cholesky factor of the rough covariance plus noise,

    (k_n - w' K) / d = (s_n - w' S) / d + (r_n - (M' w)' U) / d,      U = M^-1 R(samples, cells)

The first term is separable (``he3.posterior.separable_rows``), the second needs the rows U of a process with the rough
kernel alone, which are local (``he3.posterior.stored_rows``). It is as stable as V itself: M M' <= K plus noise = L L',
so |M' w| <= |L' w| = |l|.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from he3.posterior.row_solving import RowCombination, row_weights

if TYPE_CHECKING:
    from he3.frames import FloatArray
    from he3.gp import GaussianProcess
    from he3.kernels import SmoothPlusRough
    from he3.posterior.screening import RowBlock
    from he3.posterior.separable_rows import SeparableRows
    from he3.posterior.stored_rows import StoredRows
    from he3.posterior.tiles import RunTasks, Tile


class SplitRows:
    """The smooth part's factors and the rough part's rows at the samples."""

    def __init__(
        self,
        kernel: SmoothPlusRough,
        smooth: SeparableRows,
        rough: StoredRows,
        rough_process: GaussianProcess,
    ) -> None:
        """No rows yet.

        smooth, rough: sources of rows for the kernel's two parts. rough_process: of the rough part alone, empty.
        """
        self._kernel = kernel
        self._smooth = smooth
        self._rough = rough
        self._rough_prior = self._rough_process = rough_process

    @property
    def values_read(self) -> int:
        """How many values of stored rows the last row was computed from."""
        return self._rough.values_read

    def next_row(self, process: GaussianProcess, run_tasks: RunTasks) -> FloatArray:
        """The last of the process's n rows, (cells,) in tile order; all before are known."""
        weights = row_weights(process)
        pivot = float(process.factor[-1, -1])
        coefficients = self._rough_process.factor.T @ (-pivot * weights[:-1])
        self._rough_process = self._rough_process.with_room().condition_on_places(process.places_m[-1:])
        rough = RowCombination(coefficients, pivot, self._rough.tolerance(self._kernel))
        row = self._smooth.weighted_sum(process.places_m, weights, run_tasks)
        row += self._rough.next_rows(self._rough_process, run_tasks, rough)[1]
        return row

    def recompute(self, process: GaussianProcess) -> Callable[[Tile], Iterator[tuple[int, RowBlock]]]:
        """All rows of a process, replacing those known, as a function of a part of a tile: see ``RowSource``."""
        self._rough_process = self._rough_prior.condition_on_places(process.places_m)
        all_on = self._smooth.recompute(process)
        rough_on = self._rough.recompute(self._rough_process)  # stored; mean and variance need the whole kernel's rows

        def on_part(part: Tile) -> Iterator[tuple[int, RowBlock]]:
            for _ in rough_on(part):
                pass
            yield from all_on(part)

        return on_part
