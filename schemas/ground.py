"""The ground station's messages to operators."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from schemas.maps import MapScore
from schemas.plans import Waypoint
from schemas.telemetry import RoverState, SampleReport
from schemas.wire import Count, Identifier, MissionTimeNs, Text, Wire


class MissionPhase(StrEnum):
    WAITING = "waiting"
    """No message of the rover has arrived yet."""
    PLANNING = "planning"
    EXECUTING = "executing"
    COMPLETED = "completed"
    FAILED = "failed"


class KernelParameters(Wire):
    """The covariance function in use, in standardised units, with the scale of those units in ppb."""

    name: Text
    parameters: dict[str, float]
    noise_std_ppb: float
    mean_ppb: float
    scale_ppb: float


class GroundStatus(Wire):
    """The state of the mission on the ground."""

    phase: MissionPhase
    planner: Text
    round: Count
    """Rounds completed."""
    rounds: Count
    """Rounds of the whole mission."""
    samples: Count
    """Measurements in the map."""
    samples_total: Count
    driven_m: Annotated[float, Field(ge=0)]
    budget_m: float | None
    plan_revision: Count
    plans_in_work: Count
    map_revision: Count
    mean_std_ppb: float | None
    kernel: KernelParameters | None
    score: MapScore | None
    """Score against the reference field, if a simulated Moon provides one. Belief and planners do not use it."""
    rover: RoverState | None
    rover_made_at: MissionTimeNs | None
    """Mission time at which the rover reported its last state; None if it has reported none."""
    detail: Text = ""

    @property
    def is_over(self) -> bool:
        """Whether the mission has completed or failed."""
        return self.phase in (MissionPhase.COMPLETED, MissionPhase.FAILED)


class KeepOutArea(Wire):
    """A part of the site that the rover may not enter. An area that is being changed has several outlines."""

    area_id: Identifier
    polygon_m: Annotated[tuple[Waypoint, ...], Field(min_length=3, max_length=256)]


class MissionTrack(Wire):
    """Samples, driven path, planned path, keep-out areas and scores, for pictures of the mission."""

    samples: tuple[SampleReport, ...]
    driven_path_m: tuple[Waypoint, ...]
    planned_path_m: tuple[Waypoint, ...]
    score_history: tuple[MapScore, ...]
    plan_ends: MissionTimeNs | None = None
    keep_outs: tuple[KeepOutArea, ...] = ()
    """The areas in force for planning."""


class InterestArea(Wire):
    """A part of the site whose uncertainty counts `weight` times in planning."""

    area_id: Identifier
    polygon_m: Annotated[tuple[Waypoint, ...], Field(min_length=3, max_length=256)]
    weight: Annotated[float, Field(ge=0, le=1000)]


class InterestChange(Wire):
    """Sets or removes an area of interest; without an area it is a query for the list of areas."""

    area_id: Identifier | None = None
    polygon_m: Annotated[tuple[Waypoint, ...], Field(min_length=3, max_length=256)] | None = None
    """Corners [m]; None removes the area."""
    weight: Annotated[float, Field(ge=0, le=1000)] = 2.0


class InterestList(Wire):
    areas: tuple[InterestArea, ...]


class Presence(Wire):
    """Heartbeat of a process, sent every few seconds of wall time."""

    name: Identifier
    side: Text
    incarnation: Count
    software: Text
    pid: Count
    host: Text
    refused: Count
    """Messages refused since the process started."""
    events: Count
    defects: Count = 0
    """Messages set aside since the process started, because the program failed upon them."""
    insecure: bool = False
    """Whether it uses an endpoint off loopback without TLS."""
