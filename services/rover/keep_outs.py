"""The keep-outs: closed areas, by name, from which the rover's footprint keeps clear."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from services.rover.geometry import Area

if TYPE_CHECKING:
    from he3.frames import Place
    from services.runtime.node import SavedState


class KeepOuts:
    """Named areas, and the distance [m] that the vehicle's centre keeps from each."""

    def __init__(self, margin_m: float, polygons_m: Mapping[str, Sequence[Place]]) -> None:
        self._margin_m = margin_m
        self._areas = {name: Area.of(polygon_m) for name, polygon_m in polygons_m.items()}

    def __len__(self) -> int:
        return len(self._areas)

    def __contains__(self, name: object) -> bool:
        return name in self._areas

    def close(self, name: str, polygon_m: Sequence[Place]) -> None:
        """Closes the area of that polygon, in place of an earlier one of the same name."""
        self.open(name)
        self._areas[name] = Area.of(polygon_m)

    def open(self, name: str) -> None:
        """Removes the keep-out of that name, if there is one."""
        self._areas.pop(name, None)

    def around(self, place_m: Place) -> set[str]:
        """Names of the keep-outs that the place lies in, or too near to."""
        return {name for name, area in self._areas.items() if area.is_near(place_m, place_m, self._margin_m)}

    def first_entered(self, path_m: Sequence[Place], exempt: set[str]) -> tuple[str, Place] | None:
        """The first keep-out that the path enters, and where; None if it enters none but those exempt."""
        for name, area in self._areas.items():
            if name not in exempt:
                place = area.first_near(path_m, self._margin_m)
                if place is not None:
                    return name, place
        return None

    def objection(self, path_m: Sequence[Place]) -> str | None:
        """One line on the first keep-out that the path enters or ends in; None if it keeps clear of all.

        A keep-out that the path begins in does not count until the path has left it: so the rover can get out.
        """
        margin = self._margin_m
        for name, area in self._areas.items():
            leaving = area.is_near(path_m[0], path_m[0], margin)
            for a, b in itertools.pairwise(path_m):
                near = area.is_near(a, b, margin)
                if near and not leaving:
                    return f"the way from ({a[0]:.2f}, {a[1]:.2f}) to ({b[0]:.2f}, {b[1]:.2f}) enters keep-out {name}"
                leaving = leaving and area.is_near(b, b, margin)
            if leaving and len(path_m) > 1:
                return f"the way ends within keep-out {name}"
        return None

    def checkpoint(self) -> SavedState:
        """The areas, as a named part."""
        return {"areas": dict(self._areas)}

    def restore(self, state: SavedState) -> None:
        """Restore the keep-outs from this state."""
        self._areas = state["areas"]
