"""Which of the rows known a new one needs, tile by tile, and how to read them fast.

A sum of n rows, each times a number, is as large on a tile as the sum of |number| times the row's peak there at most.
So the rows with the smallest such products can be left out, as many as together stay below what the sum may be off by:
a bound, not an estimate. Samples that are far away, or hidden behind others, fall out by the hundred.

What is left costs the time that memory takes to deliver it. Where most of a block is needed it is read as it lies;
scattered rows are first copied together, since a sum over rows that follow one another is much the fastest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from he3.frames import Float32Array, FloatArray
from he3.posterior.tiles import Tile

_COPIED_ROWS = 16  # scattered rows summed together: 1 MB on a whole tile, about what a core's cache holds
_WORTH_COPYING = 1.5  # rows to read for one that is needed, above which the needed ones are copied first [measured]


def rows_that_matter(tie: FloatArray, peaks: Float32Array, allowed: float) -> NDArray[np.bool_]:
    """Whether each of n rows is needed on each of the tiles, (tiles, n).

    tie: (n,), what the rows are multiplied by in the sum. peaks: (tiles, n), the largest absolute value of each row on
    each tile. allowed: by how much the rows left out may change a value of the sum, all together.
    """
    share = peaks * np.abs(tie).astype(np.float32)
    ranked = np.sort(share, axis=1)
    left_out = (np.cumsum(ranked, axis=1, dtype=np.float64) <= allowed).sum(axis=1)
    # Of equal shares all are kept or all left out, so the smallest one that is kept decides.
    none = np.full((len(peaks), 1), np.inf, dtype=np.float32)
    smallest = np.take_along_axis(np.hstack((ranked, none)), left_out[:, None], axis=1)
    matter: NDArray[np.bool_] = share >= smallest
    return matter


class Reading:
    """The order in which the rows that matter are read from blocks of ``rows_a_block`` of them."""

    def __init__(self, matter: NDArray[np.bool_], rows_a_block: int) -> None:
        """matter: (tiles, n), as ``rows_that_matter`` says."""
        tiles, n = matter.shape
        blocks = -(-n // rows_a_block)
        scattered = np.zeros((tiles, blocks, rows_a_block), dtype=np.bool_)
        scattered.reshape(tiles, -1)[:, :n] = matter
        count = scattered.sum(axis=2)
        first = scattered.argmax(axis=2)
        stop = rows_a_block - scattered[:, :, ::-1].argmax(axis=2)
        as_they_lie = (count > 0) & (stop - first <= _WORTH_COPYING * count)
        scattered[as_they_lie] = False
        self.rows_read: NDArray[np.intp] = np.where(as_they_lie, stop - first, count).sum(axis=1)
        """How many on each tile, (tiles,): those between two that matter count where they are read too."""
        self._rows_a_block = rows_a_block
        self._scattered = scattered.reshape(tiles, -1)
        self._plan = np.stack((count, first, stop, as_they_lie), axis=2)

    def pieces(
        self, tile: Tile, blocks: Sequence[Sequence[Float32Array]]
    ) -> Iterator[tuple[slice | NDArray[np.intp], Float32Array]]:
        """What to sum up on that tile: the numbers of k rows, and the rows (k, cells).

        blocks: by block and tile, arrays (rows, cells). The rows must be used before the next ones are asked for.
        """
        numbers = np.flatnonzero(self._scattered[tile.number])
        offsets = numbers % self._rows_a_block
        copied = np.empty((min(len(numbers), _COPIED_ROWS), tile.size), dtype=np.float32)
        summed = taken = 0  # of the scattered ones
        for block, (count, first, stop, as_they_lie) in enumerate(self._plan[tile.number].tolist()):
            if as_they_lie:
                start = block * self._rows_a_block
                yield slice(start + first, start + stop), blocks[block][tile.number][first:stop]
                continue
            last = taken + count
            while taken < last:
                here = taken - summed
                some = min(last - taken, _COPIED_ROWS - here)
                place = copied[here : here + some]
                blocks[block][tile.number].take(offsets[taken : taken + some], axis=0, out=place, mode="clip")
                taken += some
                if taken - summed == _COPIED_ROWS:
                    yield numbers[summed:taken], copied
                    summed = taken
        if taken > summed:
            yield numbers[summed:taken], copied[: taken - summed]
