"""Whether the outline of a polygon is simple, that is, whether it encloses one piece of ground."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from he3.frames import BoolArray, FloatArray, Place

FLAT = 1e-9
"""1, distance from a line, as a share of the outline's extent, within which a corner counts as lying on it."""


def outline_objection(corners_m: Sequence[Place]) -> str | None:
    """One line on why the closed outline through these corners (n >= 3) [m] is not simple; None if it is.

    An outline is simple if no two of its edges have a place in common, but for the corner of two neighbours. An area
    under an outline that crosses itself is not what one sees: its signed area can be 0, and the even-odd rule leaves
    out what is surrounded twice.
    """
    corners = np.asarray(corners_m, dtype=np.float64)
    met = _first_meeting(_without_repeats(corners))
    if met is None:
        return None
    return f"expected an outline that does not cross or touch itself, got one that meets itself near {_place(met)}"


def _place(place: FloatArray) -> str:
    return f"({place[0]:.1f}, {place[1]:.1f}) m"


def _without_repeats(corners: FloatArray) -> FloatArray:
    """The corners, each that equals the one before it left out; the first follows the last."""
    kept: FloatArray = corners[(corners != np.roll(corners, 1, axis=0)).any(axis=1)]
    return kept if len(kept) else corners[:1]


def _first_meeting(corners: FloatArray) -> FloatArray | None:
    """A place (2,) [m] where two edges meet that should not; None if there is none. Fewer than 3 corners have none."""
    n = len(corners)
    if n < 3:
        return None
    extent = float(np.ptp(corners, axis=0).max())
    start = (corners - corners.mean(axis=0)) / extent
    end = np.roll(start, -1, axis=0)
    # Sides [i, j] of edge i on which the two ends of edge j lie: -1, 0 (on its line) or 1.
    side_of_start, side_of_end = _sides(start, end, start), _sides(start, end, end)
    crossing = (side_of_start * side_of_end < 0) & (side_of_start * side_of_end < 0).T
    # Or an end of edge j lies on edge i itself.
    on_edge = ((side_of_start == 0) & _between(start, end, start)) | ((side_of_end == 0) & _between(start, end, end))
    edges = np.arange(n)
    apart = (edges[:, None] - edges[None, :]) % n
    meets = (crossing | on_edge) & (apart > 1) & (apart < n - 1)
    # Neighbours share a corner by right; they overlap where the second leads straight back.
    back = _leads_back(start, end)
    if back.any():
        found: FloatArray = corners[(int(np.argmax(back)) + 1) % n]
        return found
    if not meets.any():
        return None
    first, second = np.unravel_index(int(np.argmax(meets)), meets.shape)
    return _meeting(corners, int(first), int(second))


def _sides(start: FloatArray, end: FloatArray, places: FloatArray) -> FloatArray:
    """The side (n, k) of each of n edges on which each of k places lies: -1, 0 or 1."""
    along = end - start
    away = places[None, :, :] - start[:, None, :]
    cross = along[:, None, 0] * away[..., 1] - along[:, None, 1] * away[..., 0]
    length = np.hypot(along[:, 0], along[:, 1])[:, None]
    sides: FloatArray = np.where(np.abs(cross) <= FLAT * length, 0.0, np.sign(cross))
    return sides


def _between(start: FloatArray, end: FloatArray, places: FloatArray) -> BoolArray:
    """Whether (n, k) each of k places, known to lie on the line of an edge, lies between the edge's ends."""
    low, high = np.minimum(start, end) - FLAT, np.maximum(start, end) + FLAT
    above, below = places[None] >= low[:, None], places[None] <= high[:, None]
    inside: BoolArray = np.all(above & below, axis=-1)
    return inside


def _leads_back(start: FloatArray, end: FloatArray) -> BoolArray:
    """Whether (n,) the edge after each edge leads back along it."""
    along = end - start
    following = np.roll(along, -1, axis=0)
    cross = along[:, 0] * following[:, 1] - along[:, 1] * following[:, 0]
    lengths = np.hypot(*along.T) * np.hypot(*following.T)
    back: BoolArray = np.logical_and(np.abs(cross) <= FLAT * lengths, (along * following).sum(axis=1) < 0)
    return back


def _meeting(corners: FloatArray, first: int, second: int) -> FloatArray:
    """The place (2,) where two edges meet, or an end of the second on the first if they lie on one line."""
    a, b = corners[first], corners[(first + 1) % len(corners)]
    c, d = corners[second], corners[(second + 1) % len(corners)]
    along, other = b - a, d - c
    cross = along[0] * other[1] - along[1] * other[0]
    if abs(cross) <= FLAT * np.hypot(*along) * np.hypot(*other):
        length = np.hypot(*along)
        beyond = [abs((end - a) @ along / length - 0.5 * length) for end in (c, d)]
        nearer: FloatArray = c if beyond[0] <= beyond[1] else d
        return nearer
    share = ((c - a)[0] * other[1] - (c - a)[1] * other[0]) / cross
    met: FloatArray = a + np.clip(share, 0.0, 1.0) * along
    return met
