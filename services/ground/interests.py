"""Areas of interest, with more or less weight than the rest: from the scenario, and from changes of the operator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from he3.frames import BoolArray, Place, SiteGrid
from schemas.ground import InterestArea, InterestChange, InterestList
from services.ground.terrain import interest_area_objection, interest_objection, interest_weights

if TYPE_CHECKING:
    from services.mission.scenario import InterestRegion
    from services.runtime.node import SavedState

MAX_AREAS = 100

_Areas = dict[str, tuple[Sequence[Place], float]]


class InterestAreas:
    """Corners and weight of each area, by its id, and the weight of each cell that follows from them."""

    def __init__(self, grid: SiteGrid, areas: Mapping[str, InterestRegion]) -> None:
        self._grid = grid
        self._areas: _Areas
        self._weights: NDArray[np.float32] | None
        self._listed: InterestList
        self._set({area_id: (area.polygon_m, area.weight) for area_id, area in areas.items()})

    @property
    def weights(self) -> NDArray[np.float32] | None:
        """(rows, columns) weight of each cell's uncertainty; None where every cell has weight 1."""
        return self._weights

    def listed(self) -> InterestList:
        """The areas as an operator sees them; the same object until they change."""
        return self._listed

    def objection(self, change: InterestChange, open_cells: BoolArray) -> str | None:
        """One line on why that change cannot be made; None if it can. open_cells: (rows, columns)."""
        grid = self._grid
        if change.polygon_m is not None:
            if not grid.contains(np.array(change.polygon_m)).all():
                return (
                    f"interest: expected corners within 0..{grid.width_m:g} m east and "
                    f"0..{grid.height_m:g} m north, got one outside"
                )
            if (why := interest_area_objection(grid, change.polygon_m)) is not None:
                return f"interest: polygon_m: {why}"
        if change.area_id is None:
            return None
        if change.area_id not in self._areas and len(self._areas) >= MAX_AREAS:
            return f"interest: expected at most {MAX_AREAS} areas, got one more"
        if (why := interest_objection(self._weights_of(self._changed(change)), open_cells)) is not None:
            return f"interest: weight: {why}"
        return None

    def change(self, change: InterestChange) -> bool:
        """Set an area, or remove it if there is no polygon; returns whether anything changed."""
        if change.area_id is None or (change.polygon_m is None and change.area_id not in self._areas):
            return False
        self._set(self._changed(change))
        return True

    def _set(self, areas: _Areas) -> None:
        self._areas, self._weights = areas, self._weights_of(areas)
        self._listed = InterestList(
            areas=tuple(
                InterestArea(area_id=area_id, polygon_m=tuple(polygon), weight=weight)
                for area_id, (polygon, weight) in areas.items()
            )
        )

    def _changed(self, change: InterestChange) -> _Areas:
        areas = dict(self._areas)
        if change.area_id is not None:
            if change.polygon_m is None:
                areas.pop(change.area_id, None)
            else:
                areas[change.area_id] = (change.polygon_m, change.weight)
        return areas

    def _weights_of(self, areas: _Areas) -> NDArray[np.float32] | None:
        return interest_weights(self._grid, list(areas.values()))

    def checkpoint(self) -> SavedState:
        """The areas, as a named part."""
        return {"areas": self._areas}

    def restore(self, state: SavedState) -> None:
        """Restore the areas from this state."""
        self._set(state["areas"])
