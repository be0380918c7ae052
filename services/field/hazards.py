"""Hidden hazards: seeded circles of closed terrain, such as boulders, that the orbital map does not show."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from he3.errors import InvalidInput

if TYPE_CHECKING:
    from he3.frames import BoolArray, SiteGrid

START_CLEARANCE_M: Final = 10.0  # m around the landing place without hazards: the landing place was chosen for that
_STREAM: Final = 0x48415A  # separates this use of the mission's seed from all others
_MAX_DRAWS: Final = 200  # for each hazard; only a region little larger than the clearance needs many


def hazard_places(
    grid: SiteGrid, count: int, radius_m: float, seed: int, start_m: tuple[float, float]
) -> tuple[tuple[float, float], ...]:
    """Centres (x, y) [m] of `count` hazards, uniform over the region outside the start's clearance. Seeded.

    Raises InvalidInput if the region has no room outside the clearance.
    """
    stream = np.random.default_rng([seed, _STREAM])
    clear_m = radius_m + START_CLEARANCE_M
    places: list[tuple[float, float]] = []
    for _ in range(_MAX_DRAWS * max(count, 1)):
        if len(places) == count:
            return tuple(places)
        x, y = float(stream.uniform(0, grid.width_m)), float(stream.uniform(0, grid.height_m))
        if (x - start_m[0]) ** 2 + (y - start_m[1]) ** 2 > clear_m**2:
            places.append((x, y))
    if len(places) == count:
        return tuple(places)
    raise InvalidInput(
        f"expected room for {count} hidden hazards at least {clear_m:g} m from the start, "
        f"got a region of {grid.width_m:g} x {grid.height_m:g} m"
    )


def covered(grid: SiteGrid, places_m: tuple[tuple[float, float], ...], radius_m: float) -> BoolArray:
    """Cells (rows, columns) whose centre lies within that radius [m] of a place, and the cell of each place."""
    hidden = np.zeros(grid.shape, dtype=np.bool_)
    for x, y in places_m:
        hidden |= np.add.outer((grid.y_m - y) ** 2, (grid.x_m - x) ** 2) <= radius_m**2
        rows, columns = grid.cells_of(np.array([[x, y]]))
        hidden[rows[0], columns[0]] = True
    return hidden
