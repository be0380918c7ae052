"""A copy of the mission as its ground knows it, from which a rehearsal begins."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from schemas.plans import MissionPlan, Waypoint
from schemas.telemetry import RoverState
from schemas.wire import Identifier, MissionTimeNs, Wire


class MissionFork(Wire):
    """The ground station's state, and what it knows of the rover."""

    at: MissionTimeNs
    """Mission time of the copy."""
    scenario_json: Annotated[str, Field(max_length=1_000_000)]
    """The scenario that the ground runs."""
    state_base64: Annotated[str, Field(max_length=32_000_000)]
    """Its state, as a checkpoint has it, without the map and what is published of it: both follow from the rest."""
    rover: RoverState | None
    """The rover as it was last heard of."""
    plan: MissionPlan | None
    """The rounds that the rover has still to do, that under way first, from where the rover is; None: no round."""
    measured: tuple[Identifier, ...]
    """Samples that are in the map."""
    keep_outs_m: dict[Identifier, Annotated[tuple[Waypoint, ...], Field(min_length=3, max_length=256)]]
    """Corners of the keep-outs in force, by their ids."""
