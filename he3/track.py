"""The rover's own track, and the return path over it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from he3.frames import FloatArray, Place

_SAME_PLACE_M: Final = 1e-6


def return_path(track_m: list[Place]) -> tuple[Place, ...]:
    """Vertices [m] of the path from the track's end back to its beginning, over ground already driven, without loops.

    Where the track meets itself, the loop between is left out, so the path crosses itself nowhere.
    """
    simple: FloatArray = np.empty((2 * len(track_m) + 1, 2))
    simple[0] = track_m[0]
    count = 1
    for vertex in np.array(track_m[1:]).reshape(-1, 2):
        here = simple[count - 1]
        if count > 1:
            met = _first_crossing(simple[:count], here, vertex)
            if met is not None:
                index, place = met
                simple[index + 1] = place
                count = index + 2
        simple[count] = vertex
        count += 1
        touched = _first_touched(simple[: count - 1], vertex)
        if touched is not None:
            simple[touched + 1] = vertex
            count = touched + 2
    home = simple[:count][::-1]
    moved = np.ones(count, dtype=np.bool_)
    moved[1:] = np.any(home[1:] != home[:-1], axis=1)
    return tuple((float(x), float(y)) for x, y in home[moved][1:])


def _first_crossing(line: FloatArray, a: FloatArray, b: FloatArray) -> tuple[int, FloatArray] | None:
    """The first segment of the polyline that the segment from a to b crosses, and where; None if it crosses none.

    Parallel segments do not count: overlapping ones are found where one of them ends.
    """
    starts, steps = line[:-1], np.diff(line, axis=0)
    along = b - a
    across = steps[:, 0] * along[1] - steps[:, 1] * along[0]
    parallel = across == 0
    divisor = np.where(parallel, 1.0, across)
    to_a = a - starts
    on_line = (to_a[:, 0] * along[1] - to_a[:, 1] * along[0]) / divisor
    on_new = (to_a[:, 0] * steps[:, 1] - to_a[:, 1] * steps[:, 0]) / divisor
    meets = ~parallel & (on_line >= 0) & (on_line <= 1) & (on_new >= 0) & (on_new <= 1)
    if not meets.any():
        return None
    index = int(np.argmax(meets))
    return index, starts[index] + on_line[index] * steps[index]


def _first_touched(line: FloatArray, place: FloatArray) -> int | None:
    """The first segment of the polyline on which the place lies; None if it lies on none."""
    if len(line) < 2:
        return None
    starts, steps = line[:-1], np.diff(line, axis=0)
    squared = np.maximum((steps**2).sum(axis=1), np.finfo(np.float64).tiny)
    share = np.clip(((place - starts) * steps).sum(axis=1) / squared, 0.0, 1.0)
    gap = np.hypot(*(starts + share[:, None] * steps - place).T)
    touches = gap <= _SAME_PLACE_M
    return int(np.argmax(touches)) if touches.any() else None
