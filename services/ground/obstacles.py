"""Obstacles that the rover has met, closed on the ground's map of the terrain."""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from he3.frames import Place
    from schemas.telemetry import RoverEvent
    from services.ground.terrain import GroundTerrain
    from services.runtime.node import SavedState

MARGIN_M = 1.5  # radius of the disc that is closed at an obstacle: the rover sees it from one side only
SAME_OBSTACLE_M = 8.0  # obstacles met within this distance of each other are taken for one
LARGEST = 4  # times MARGIN_M, at most, for an obstacle that is met again and again


class MetObstacles:
    """Closes the ground at every obstacle that the rover reports."""

    def __init__(self, terrain: GroundTerrain) -> None:
        self._terrain = terrain
        self._met: list[Place] = []

    def close_off(self, event: RoverEvent) -> None:
        """Close a disc at the event's obstacle, twice as large each time one is met near the same place.

        An event without an obstacle, or with one outside the region, changes nothing.
        """
        obstacle = event.obstacle_m
        if obstacle is None or not self._terrain.grid.contains(np.array([obstacle]))[0]:
            return
        before = sum(hypot(x - obstacle[0], y - obstacle[1]) < SAME_OBSTACLE_M for x, y in self._met)
        self._met.append(obstacle)
        self._terrain.block(obstacle, MARGIN_M * min(2**before, LARGEST), (event.x_m, event.y_m))

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "met": list(self._met),
        }

    def restore(self, state: SavedState) -> None:
        """Restore the obstacles from this state."""
        self._met = state["met"]
