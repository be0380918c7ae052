"""All rows of V = L^-1 K(samples, cells), kept in float32, and a new one from those that matter where it is computed.

To read n float32 values a cell for a new row v = (k_n - l' V) / d takes as long as memory takes to deliver them: a
gigabyte, at 1,000 samples. But of most rows a tile sees far less than float32 rounds off. So the peak of each row on
each tile is kept with it, and ``he3.posterior.screening`` leaves out what together cannot change a value by
``SCREENED``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from threading import Lock

import numpy as np

from he3.frames import Float32Array, FloatArray
from he3.gp import GaussianProcess
from he3.kernels import Kernel
from he3.posterior.row_solving import fill_covariance, solve_rows
from he3.posterior.screening import Reading, rows_that_matter
from he3.posterior.tiles import ShareOut, Tile, TiledGrid

ROWS_A_BLOCK = 64  # rows of V allocated together: 64 MB at 500 x 500 cells; V grows by blocks and is never moved
SCREENED = 2.0**-22  # of the prior standard deviation: four times what float32 may round off a value as large (2^-24)


@dataclass(frozen=True, slots=True)
class Tied:
    """A row (k_n - tie' V) / pivot, tied to the n rows known, and by how much each of its values may be off."""

    tie: FloatArray
    pivot: float
    allowed: float


class StoredRows:
    """The rows in blocks, and in those tile by tile: ``_blocks[block][tile]`` is (ROWS_A_BLOCK, cells of the tile)."""

    def __init__(self, tiled: TiledGrid, kernel: Kernel, *, screened: float = SCREENED) -> None:
        """No rows yet. screened: by how much a row may be off, in prior standard deviations, for what it leaves out."""
        self._tiled = tiled
        self._kernel = kernel
        self._screened = screened
        self._blocks: list[list[Float32Array]] = []
        self._peaks: Float32Array = np.zeros((len(tiled.tiles), 0), dtype=np.float32)
        self._tail_is_shared = False
        self._scratch: list[Float32Array] = []
        self._lock = Lock()
        self.values_read = 0

    def next_row(self, process: GaussianProcess, share_out: ShareOut) -> Float32Array:
        """The last of the process's n rows, (cells,) in tile order, good until the next; all before are known."""
        return self.next_rows(process, share_out)[0]

    def next_rows(self, process: GaussianProcess, share_out: ShareOut, *others: Tied) -> list[Float32Array]:
        """The last of the process's rows, which is kept, and others for the same place, which are not."""
        n = len(process) - 1
        tied = (Tied(process.factor[n, :n], float(process.factor[n, n]), self.allowed(self._kernel)), *others)
        matter = [rows_that_matter(row.tie, self._peaks[:, :n], row.allowed * row.pivot) for row in tied]
        reading = Reading(np.logical_or.reduce(matter), ROWS_A_BLOCK)
        self.values_read = sum(
            int(count) * tile.size for count, tile in zip(reading.rows_read, self._tiled.tiles, strict=True)
        )
        ties = [row.tie.astype(np.float32) for row in tied]
        covariance, *values = self._scratch_for(1 + len(tied))

        def explain(tile: Tile) -> None:
            on_tile = [explained[tile.cells] for explained in values]
            for explained in on_tile:
                explained.fill(0.0)
            for numbers, known in reading.pieces(tile, self._blocks):
                for explained, tie, needed in zip(on_tile, ties, matter, strict=True):
                    if not others or needed[tile.number, numbers].any():
                        explained += tie[numbers] @ known

        # The covariance is many short steps, which two threads at once would spend waiting for the interpreter's lock.
        fill = partial(fill_covariance, self._kernel, process.places_m[n], self._tiled, covariance)
        share_out([fill, *(partial(explain, tile) for tile in self._tiled.tiles)])
        for row, way in zip(values, tied, strict=True):
            np.subtract(covariance, row, out=row)
            row *= np.float32(1.0 / way.pivot)
        self._keep(n, values[0])
        return values

    def _scratch_for(self, count: int) -> list[Float32Array]:
        """Arrays (cells,), the same at each call: memory that is new takes longer to get than to fill."""
        while len(self._scratch) < count:
            self._scratch.append(np.empty(self._tiled.cells, dtype=np.float32))
        return self._scratch[:count]

    def _keep(self, n: int, row: Float32Array) -> None:
        self._make_room_for(n)
        block, offset = divmod(n, ROWS_A_BLOCK)
        for tile in self._tiled.tiles:
            self._blocks[block][tile.number][offset] = row[tile.cells]
        starts = [tile.cells.start for tile in self._tiled.tiles]
        self._peaks[:, n] = np.maximum.reduceat(np.abs(row), starts)

    def allowed(self, kernel: Kernel) -> float:
        """By how much a row of that kernel may be off."""
        return self._screened * float(np.sqrt(kernel.prior_variance))

    def rows_anew(self, process: GaussianProcess) -> Callable[[Tile], Iterator[tuple[int, Float32Array]]]:
        """All rows of a process, in place of those known, as a function of a part of a tile: see ``RowsOnGrid``."""
        n = len(process)
        self._blocks = []
        self._tail_is_shared = False
        self._peaks = np.zeros((len(self._tiled.tiles), n), dtype=np.float32)
        for first in range(0, n, ROWS_A_BLOCK):
            self._make_room_for(first)
        factor = process.factor.astype(np.float32)

        def on_part(part: Tile) -> Iterator[tuple[int, Float32Array]]:
            start = part.cells.start - self._tiled.tiles[part.number].cells.start
            cells = slice(start, start + part.size)
            for first, rows in solve_rows(process, factor, self._tiled.grid, part):
                for begin in range(0, len(rows), ROWS_A_BLOCK):
                    piece = rows[begin : begin + ROWS_A_BLOCK]
                    self._blocks[(first + begin) // ROWS_A_BLOCK][part.number][: len(piece), cells] = piece
                peaks = self._peaks[part.number, first : first + len(rows)]
                largest = np.abs(rows).max(axis=1)
                with self._lock:  # another thread may be at another part of the same tile
                    np.maximum(peaks, largest, out=peaks)
                yield first, rows

        return on_part

    def fork(self) -> StoredRows:
        """An independent copy, sharing what neither will change."""
        copy = StoredRows(self._tiled, self._kernel, screened=self._screened)
        copy._blocks = list(self._blocks)
        copy._peaks = self._peaks.copy()
        copy._tail_is_shared = self._tail_is_shared = True
        copy.values_read = self.values_read
        return copy

    def _make_room_for(self, n: int) -> None:
        """See to it that row n can be written. The last block may be another fork's too, and is then copied first."""
        block, offset = divmod(n, ROWS_A_BLOCK)
        if block == len(self._blocks):
            self._blocks.append(self._new_block())
        elif self._tail_is_shared:
            tail = self._new_block()
            for mine, shared in zip(tail, self._blocks[block], strict=True):
                mine[:offset] = shared[:offset]
            self._blocks[block] = tail
        self._tail_is_shared = False
        if n >= self._peaks.shape[1]:
            more = np.zeros((len(self._tiled.tiles), ROWS_A_BLOCK), dtype=np.float32)
            self._peaks = np.hstack((self._peaks, more))

    def _new_block(self) -> list[Float32Array]:
        flat = np.empty(ROWS_A_BLOCK * self._tiled.cells, dtype=np.float32)
        return [
            flat[ROWS_A_BLOCK * tile.cells.start : ROWS_A_BLOCK * tile.cells.stop].reshape(ROWS_A_BLOCK, tile.size)
            for tile in self._tiled.tiles
        ]
