"""Which stored rows a new row depends on, tile by tile, and the order in which they are read.

On a tile, a sum of n rows times coefficients is bounded by the sum of |coefficient| times the row's peak there. The
rows with the smallest such products are left out, as many as together stay below the tolerance of the sum. This is a
bound, not an estimate. This leaves out most samples that are far away or screened by others. The remaining time is the
time to read the rows from memory. Where most of a block is needed, the block is read in
place; scattered rows are first copied together, because a matrix product over consecutive rows is much faster.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from he3.frames import BoolArray, Float32Array, FloatArray, IntArray
    from he3.posterior.tiles import Tile

RowBlock = NDArray[np.floating]
"""Rows (k, cells) of V, float32 or float64."""

_COPIED_ROWS = 16  # rows, scattered ones summed together: 1 MB on a whole float32 tile, about one core's cache
_COPY_RATIO = 1.5  # 1, rows read for each row needed, above which the needed ones are copied first [measured]


def significant_rows(coefficients: FloatArray, peaks: Float32Array, tolerance: float) -> BoolArray:
    """Whether each of n rows is needed on each tile, (tiles, n).

    coefficients: (n,), the rows' factors in the sum. peaks: (tiles, n), the largest absolute value of each row on each
    tile. tolerance: by how much the rows left out may change any value of the sum, all together.
    """
    bound = peaks * np.abs(coefficients).astype(np.float32)
    ranked = np.sort(bound, axis=1)
    left_out = (np.cumsum(ranked, axis=1, dtype=np.float64) <= tolerance).sum(axis=1)
    # Rows of equal bounds are all kept or all left out, so the smallest bound that is kept decides.
    end = np.full((len(peaks), 1), np.inf, dtype=np.float32)
    smallest = np.take_along_axis(np.hstack((ranked, end)), left_out[:, None], axis=1)
    needed: BoolArray = bound >= smallest
    return needed


class ReadPlan:
    """The order in which the needed rows are read from blocks of ``rows_per_block`` rows."""

    def __init__(self, needed: BoolArray, rows_per_block: int) -> None:
        """needed: (tiles, n), as ``significant_rows`` returns it."""
        tiles, n = needed.shape
        blocks = -(-n // rows_per_block)
        scattered = np.zeros((tiles, blocks, rows_per_block), dtype=np.bool_)
        scattered.reshape(tiles, -1)[:, :n] = needed
        count = scattered.sum(axis=2)
        first = scattered.argmax(axis=2)
        stop = rows_per_block - scattered[:, :, ::-1].argmax(axis=2)
        in_place = (count > 0) & (stop - first <= _COPY_RATIO * count)
        scattered[in_place] = False
        self.rows_read: IntArray = np.where(in_place, stop - first, count).sum(axis=1)
        """Rows read on each tile, (tiles,), including the unneeded ones between two that are read in place."""
        self._rows_per_block = rows_per_block
        self._scattered = scattered.reshape(tiles, -1)
        self._plan = np.stack((count, first, stop, in_place), axis=2)

    def batches(self, tile: Tile, blocks: Sequence[Sequence[RowBlock]]) -> Iterator[tuple[slice | IntArray, RowBlock]]:
        """The numbers of k rows and the rows (k, cells) on the tile, batch by batch.

        blocks: by block and tile, arrays (rows, cells). A batch is valid until the next one is requested.
        """
        numbers = np.flatnonzero(self._scattered[tile.number])
        offsets = numbers % self._rows_per_block
        dtype = blocks[0][tile.number].dtype if blocks else np.dtype(np.float32)
        copied = np.empty((min(len(numbers), _COPIED_ROWS), tile.size), dtype=dtype)
        yielded = taken = 0  # of the scattered rows
        for block, (count, first, stop, in_place) in enumerate(self._plan[tile.number].tolist()):
            if in_place:
                start = block * self._rows_per_block
                yield slice(start + first, start + stop), blocks[block][tile.number][first:stop]
                continue
            last = taken + count
            while taken < last:
                filled = taken - yielded
                some = min(last - taken, _COPIED_ROWS - filled)
                target = copied[filled : filled + some]
                blocks[block][tile.number].take(offsets[taken : taken + some], axis=0, out=target, mode="clip")
                taken += some
                if taken - yielded == _COPIED_ROWS:
                    yield numbers[yielded:taken], copied
                    yielded = taken
        if taken > yielded:
            yield numbers[yielded:taken], copied[: taken - yielded]
