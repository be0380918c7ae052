"""Room in which a Cholesky factor grows by rows, without a copy for each new sample.

A factor of n samples takes 8 n^2 bytes, and a longer one is the same with rows below. So the rows are written into an
array with room for more, which continues as the identity:

    [ L  0 ]
    [ 0  I ]

A right-hand side that continues with zeros has, under this array, the solution of L in its first n places. That stays
so when rows are written where the identity was: a factor that was taken before is still what it was.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from he3.frames import FloatArray

MORE_ROWS = 64  # that an array has room for beyond those it is made with; then it is copied to a longer one


class FactorRoom:
    """A lower Cholesky factor (rows, rows) with room for more rows. Not to be shared between threads."""

    def __init__(self, factor: FloatArray, more: int = 1) -> None:
        """factor: (n, n), copied. more: rows that are about to be appended."""
        n = len(factor)
        self.rows = n
        self._array = np.eye(n + max(more, MORE_ROWS))
        self._array[:n, :n] = factor

    def factor(self, rows: int) -> FloatArray:
        """The factor of the first samples (rows, rows), which later rows do not change; not contiguous."""
        return self._array[:rows, :rows]

    def extended(self, cross: NDArray[np.floating], corner: NDArray[np.floating]) -> FactorRoom:
        """The room with k rows more: itself, or a longer copy if it is full, or if rows after ``cross`` are taken.

        cross: (k, n), left of the corner. corner: (k, k), lower.
        """
        k, n = cross.shape
        room = self
        if n != self.rows or n + k > len(self._array):
            room = FactorRoom(self.factor(n), k)
        room._array[n : n + k, :n] = cross
        room._array[n : n + k, n : n + k] = corner
        room.rows = n + k
        return room

    def solve(self, right: FloatArray, transposed: bool = False) -> FloatArray:
        """The solution (n,) or (n, k) for the factor of the first n samples, or for its transpose."""
        n = len(right)
        longer = np.zeros((len(self._array), *right.shape[1:]))
        longer[:n] = right
        solution: FloatArray = solve_triangular(
            self._array, longer, lower=True, trans=int(transposed), overwrite_b=True, check_finite=False
        )
        return solution[:n]
