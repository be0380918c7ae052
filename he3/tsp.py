"""Short open tours (the path version of the travelling-salesman problem), given the distances between places.

The tour begins at place 0; its end is free. Moves are the reversal of a stretch (2-opt, Croes 1958) and the transfer of
up to three consecutive places in either direction (Or-opt, Or 1976); each step takes the best of all moves, by
whole-matrix arithmetic. Local double-bridge kicks (Martin, Otto and Felten 1991) then lead out of the local optimum.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from he3.errors import InvalidInput

if TYPE_CHECKING:
    from he3.frames import FloatArray, IntArray

MAX_TRANSFER = 3
"""Longest stretch that an Or-opt move transfers; longer ones rarely shorten a tour."""
MIN_GAIN = 1e-9
"""Least share of the tour by which a move shortens it; below it, rounding could make the search cycle."""


def short_tour(distances: FloatArray, first_guess: IntArray | None = None, kicks: int = 0, seed: int = 0) -> IntArray:
    """Order (n,) in which to visit n places, beginning with place 0, that no single move makes shorter.

    distances: (n, n), symmetric, not negative [m]. first_guess: an order to improve; without one, the better of the
    nearest-neighbour and the farthest-insertion tour. kicks: how often to disturb the tour and repair it, keeping the
    shorter one; the seed determines which places are disturbed. Raises InvalidInput for distances of another kind.
    """
    d = _with_open_end(distances)
    if len(d) <= 3:
        return np.arange(len(d) - 1, dtype=np.intp)
    if first_guess is None:
        guesses = [_nearest_neighbour(distances), _farthest_insertion(distances)]
    else:
        guesses = [np.asarray(first_guess, dtype=np.intp)]
    orders = [_improved(d, np.append(guess, len(d) - 1)) for guess in guesses]
    best = min(orders, key=lambda order: _length(d, order))
    if kicks:
        best = _kicked(d, best, kicks, np.random.default_rng(seed))
    return best[:-1]


def _with_open_end(distances: FloatArray) -> FloatArray:
    """The distances (n + 1, n + 1) with one more place, at distance 0 from all others: the tour's end."""
    d = np.asarray(distances, dtype=np.float64)
    if d.ndim != 2 or d.shape[0] != d.shape[1] or not len(d):
        raise InvalidInput(f"expected distances of shape (n, n) with n >= 1, got {d.shape}")
    if np.isnan(d).any() or (d < 0).any():
        raise InvalidInput("expected distances that are numbers and not negative")
    return np.pad(d, ((0, 1), (0, 1)))


def _length(d: FloatArray, order: IntArray) -> float:
    return float(d[order[:-1], order[1:]].sum())


def _nearest_neighbour(distances: FloatArray) -> IntArray:
    n = len(distances)
    left = np.ones(n, dtype=bool)
    order = np.zeros(n, dtype=np.intp)
    left[0] = False
    for position in range(1, n):
        order[position] = np.argmin(np.where(left, distances[order[position - 1]], np.inf))
        left[order[position]] = False
    return order


def _farthest_insertion(distances: FloatArray) -> IntArray:
    """Order (n,) by farthest insertion: the place farthest from the tour is inserted next, where it costs least."""
    n = len(distances)
    order = [0]
    apart = np.array(distances[0], dtype=np.float64)
    apart[0] = -np.inf
    for _ in range(1, n):
        place = int(np.argmax(apart))
        at = np.array(order)
        cost = distances[at, place].copy()
        cost[:-1] += distances[place, at[1:]] - distances[at[:-1], at[1:]]
        order.insert(int(np.argmin(cost)) + 1, place)
        apart = np.minimum(apart, distances[place])
        apart[place] = -np.inf
    return np.array(order, dtype=np.intp)


def _improved(d: FloatArray, order: IntArray) -> IntArray:
    """The order after best moves, until no move shortens it or a bound on their number is reached."""
    tolerance = MIN_GAIN * max(_length(d, order), 1.0)
    for _ in range(20 * len(order)):
        moved = _best_move(d[np.ix_(order, order)], tolerance)
        if moved is None:
            break
        order = order[moved]
    return order


def _best_move(d: FloatArray, tolerance: float) -> IntArray | None:
    """The permutation (n,) of positions that shortens the tour most; None if none shortens it by the tolerance.

    d: distances (n, n) in the order of the tour.
    """
    n = len(d)
    step = d[np.arange(n - 1), np.arange(1, n)]
    # 2-opt: reverse the stretch i + 1 .. j, so that i is followed by j, and i + 1 by j + 1; 0 <= i < j <= n - 2.
    work = step[:, None] + step[None, :]
    work -= d[:-1, :-1]
    work -= d[1:, 1:]
    np.fill_diagonal(work, -np.inf)
    gain = work
    flat = int(np.argmax(gain))
    best, (i, j) = float(gain.flat[flat]), divmod(flat, n - 1)
    i, j = min(i, j), max(i, j)
    move = np.r_[0 : i + 1, j:i:-1, j + 1 : n]
    for length in range(1, min(MAX_TRANSFER, n - 3) + 1):
        # Or-opt: move the stretch s .. s + length - 1 between p and p + 1, with p outside it; 1 <= s < n - length.
        count = n - length - 1
        freed = step[:count] + step[length:] - d.diagonal(length + 1)
        for turned in (False, True):
            head, tail = d[1 : count + 1], d[length : count + length]
            if turned:
                head, tail = tail, head
            np.add(head[:, :-1], tail[:, 1:], out=work[:count])
            gain = work[:count]
            gain -= step
            np.subtract(freed[:, None], gain, out=gain)
            for p in range(length + 1):  # s - 1 .. s + length - 1
                gain.reshape(-1)[p::n][:count] = -np.inf
            flat = int(np.argmax(gain))
            if gain.flat[flat] > best:
                best = float(gain.flat[flat])
                a, at = divmod(flat, n - 1)
                s, e = a + 1, a + length
                stretch = np.arange(s, e + 1)[:: -1 if turned else 1]
                if at < s:
                    move = np.r_[0 : at + 1, stretch, at + 1 : s, e + 1 : n]
                else:
                    move = np.r_[0:s, e + 1 : at + 1, stretch, at + 1 : n]
    return move if best > tolerance else None


def _kicked(d: FloatArray, order: IntArray, kicks: int, generator: np.random.Generator) -> IntArray:
    """The shortest order found by that number of kicks, each followed by best moves."""
    n = len(order)
    if n < 8:
        return order
    length = _length(d, order)
    for _ in range(kicks):
        # A local double bridge: three cuts close together exchange two short neighbouring stretches.
        span = min(n - 2, 30)
        first = int(generator.integers(0, n - span))
        a, b, c = np.sort(generator.choice(np.arange(1, span), 3, replace=False)) + first
        other = _improved(d, np.r_[order[:a], order[b:c], order[a:b], order[c:]])
        other_length = _length(d, other)
        if other_length < length:
            order, length = other, other_length
    return order
