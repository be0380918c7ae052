"""All rows of V = L^-1 K(samples, cells), stored, and a new row computed from the significant ones.

Reading n values a cell for a new row v = (k_n - l' V) / d takes as long as memory takes to deliver them: a gigabyte in
float32 at 1,000 samples. But on a given tile most rows are far smaller than what the precision rounds off. So the peak
of each row on each tile is stored with it, and ``he3.posterior.screening`` leaves out what together cannot change a
value by more than the screening tolerance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np

from he3.posterior.row_solving import RowCombination, fill_covariance, solve_rows
from he3.posterior.screening import ReadPlan, RowBlock, significant_rows

if TYPE_CHECKING:
    from he3.frames import Float32Array
    from he3.gp import GaussianProcess
    from he3.kernels import Kernel
    from he3.posterior.tiles import RunTasks, Tile, TiledGrid

ROWS_PER_BLOCK = 64  # rows of V allocated together: 64 MB at 500 x 500 cells in float32; V grows and is never moved
FLOAT32: np.dtype[Any] = np.dtype(np.float32)


def screening_tolerance(dtype: np.dtype[Any]) -> float:
    """How far screening may change a value of a row, in prior standard deviations.

    Four times what rounding may do to a value of that size: 2^-22 for float32, 2^-51 for float64.
    """
    return 2.0 * float(np.finfo(dtype).eps)


class StoredRows:
    """The rows, in blocks and then by tile: ``_blocks[block][tile]`` is (ROWS_PER_BLOCK, cells of the tile)."""

    def __init__(
        self, tiled: TiledGrid, kernel: Kernel, dtype: np.dtype[Any] = FLOAT32, *, screening: float | None = None
    ) -> None:
        """No rows yet. screening: tolerance in prior standard deviations; None is that of the precision."""
        self._tiled = tiled
        self._kernel = kernel
        self._dtype = dtype
        self._screening = screening_tolerance(dtype) if screening is None else screening
        self._blocks: list[list[RowBlock]] = []
        self._peaks: Float32Array = np.zeros((len(tiled.tiles), 0), dtype=np.float32)
        self._scratch: list[RowBlock] = []
        self._lock = Lock()
        self.values_read = 0

    def next_row(self, process: GaussianProcess, run_tasks: RunTasks) -> RowBlock:
        """The last of the process's n rows, (cells,) in tile order, valid until the next; all before are known."""
        return self.next_rows(process, run_tasks)[0]

    def next_rows(self, process: GaussianProcess, run_tasks: RunTasks, *others: RowCombination) -> list[RowBlock]:
        """The last of the process's rows, which is stored, and other combinations for the same place, which are not."""
        n = len(process) - 1
        own = RowCombination(process.factor[n, :n], float(process.factor[n, n]), self.tolerance(self._kernel))
        combinations = (own, *others)
        needed = [significant_rows(row.coefficients, self._peaks[:, :n], row.tolerance * row.pivot)
                  for row in combinations]  # fmt: skip
        plan = ReadPlan(np.logical_or.reduce(needed), ROWS_PER_BLOCK)
        self.values_read = sum(
            int(count) * tile.size for count, tile in zip(plan.rows_read, self._tiled.tiles, strict=True)
        )
        coefficients = [row.coefficients.astype(self._dtype) for row in combinations]
        covariance, *values = self._scratch_arrays(1 + len(combinations))

        def sum_rows(tile: Tile) -> None:
            on_tile = [explained[tile.cells] for explained in values]
            for explained in on_tile:
                explained.fill(0.0)
            for numbers, known in plan.batches(tile, self._blocks):
                for explained, factors, wanted in zip(on_tile, coefficients, needed, strict=True):
                    if not others or wanted[tile.number, numbers].any():
                        explained += factors[numbers] @ known

        # The covariance is many short steps, during which two threads would wait for the interpreter's lock.
        fill = partial(fill_covariance, self._kernel, process.places_m[n], self._tiled, covariance)
        run_tasks([fill, *(partial(sum_rows, tile) for tile in self._tiled.tiles)])
        for row, combination in zip(values, combinations, strict=True):
            np.subtract(covariance, row, out=row)
            row *= self._dtype.type(1.0 / combination.pivot)
        self._store(n, values[0])
        return values

    def tolerance(self, kernel: Kernel) -> float:
        """How far a value of a row of that kernel may be off."""
        return self._screening * float(np.sqrt(kernel.prior_variance))

    def recompute(self, process: GaussianProcess) -> Callable[[Tile], Iterator[tuple[int, RowBlock]]]:
        """All rows of a process, replacing those known, as a function of a part of a tile: see ``RowSource``."""
        n = len(process)
        self._blocks = []
        self._peaks = np.zeros((len(self._tiled.tiles), n), dtype=np.float32)
        for first in range(0, n, ROWS_PER_BLOCK):
            self._allocate_row(first)
        factor = process.factor.astype(self._dtype)

        def on_part(part: Tile) -> Iterator[tuple[int, RowBlock]]:
            start = part.cells.start - self._tiled.tiles[part.number].cells.start
            cells = slice(start, start + part.size)
            for first, rows in solve_rows(process, factor, self._tiled.grid, part):
                for begin in range(0, len(rows), ROWS_PER_BLOCK):
                    piece = rows[begin : begin + ROWS_PER_BLOCK]
                    self._blocks[(first + begin) // ROWS_PER_BLOCK][part.number][: len(piece), cells] = piece
                peaks = self._peaks[part.number, first : first + len(rows)]
                largest = np.abs(rows).max(axis=1)
                with self._lock:  # another thread may work on another part of the same tile
                    np.maximum(peaks, largest, out=peaks)
                yield first, rows

        return on_part

    def _scratch_arrays(self, count: int) -> list[RowBlock]:
        """Arrays (cells,), the same at each call, because allocation takes longer than filling."""
        while len(self._scratch) < count:
            self._scratch.append(np.empty(self._tiled.cells, dtype=self._dtype))
        return self._scratch[:count]

    def _store(self, n: int, row: RowBlock) -> None:
        self._allocate_row(n)
        block, offset = divmod(n, ROWS_PER_BLOCK)
        for tile in self._tiled.tiles:
            self._blocks[block][tile.number][offset] = row[tile.cells]
        starts = [tile.cells.start for tile in self._tiled.tiles]
        self._peaks[:, n] = np.maximum.reduceat(np.abs(row), starts)

    def _allocate_row(self, n: int) -> None:
        """Make room for row n: a block and its peaks, where it begins one."""
        if n // ROWS_PER_BLOCK == len(self._blocks):
            self._blocks.append(self._new_block())
        if n >= self._peaks.shape[1]:
            more = np.zeros((len(self._tiled.tiles), ROWS_PER_BLOCK), dtype=np.float32)
            self._peaks = np.hstack((self._peaks, more))

    def _new_block(self) -> list[RowBlock]:
        flat = np.empty(ROWS_PER_BLOCK * self._tiled.cells, dtype=self._dtype)
        return [
            flat[ROWS_PER_BLOCK * tile.cells.start : ROWS_PER_BLOCK * tile.cells.stop].reshape(
                ROWS_PER_BLOCK, tile.size
            )
            for tile in self._tiled.tiles
        ]
