"""What the ground station tells operators about the mission."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from schemas.maps import MapScore
from schemas.plans import Waypoint
from schemas.telemetry import RoverState, SampleReport
from schemas.wire import Identifier, MissionTimeNs, Text, Wire

Count = Annotated[int, Field(ge=0)]


class MissionPhase(StrEnum):
    WAITING = "waiting"
    """The rover has not been heard of yet."""
    PLANNING = "planning"
    EXECUTING = "executing"
    COMPLETED = "completed"
    FAILED = "failed"


class KernelParameters(Wire):
    """The covariance function in use, in standardised units, with its scale in ppb."""

    name: Text
    parameters: dict[str, float]
    noise_std_ppb: float
    mean_ppb: float
    scale_ppb: float


class GroundStatus(Wire):
    """The mission as the ground sees it."""

    phase: MissionPhase
    planner: Text
    round: Count
    """Rounds completed."""
    rounds: Count
    """Rounds in the whole mission."""
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
    """Against the reference field, where a simulated Moon provides one. Belief and planners never see it."""
    rover: RoverState | None
    rover_made_at: MissionTimeNs | None
    """When the rover was as shown: compare with now."""
    detail: Text = ""

    @property
    def is_over(self) -> bool:
        """Whether the mission has completed or failed."""
        return self.phase in (MissionPhase.COMPLETED, MissionPhase.FAILED)


class MissionTrack(Wire):
    """Everything a picture of the mission needs: what was measured, driven and planned."""

    samples: tuple[SampleReport, ...]
    driven_path_m: tuple[Waypoint, ...]
    planned_path_m: tuple[Waypoint, ...]
    score_history: tuple[MapScore, ...]
    plan_ends: MissionTimeNs | None = None


class InterestArea(Wire):
    """A part of the site whose uncertainty counts `weight` times as much as elsewhere when rounds are planned."""

    area_id: Identifier
    polygon_m: Annotated[tuple[Waypoint, ...], Field(min_length=3, max_length=256)]
    weight: Annotated[float, Field(ge=0, le=1000)]


class InterestChange(Wire):
    """Sets an area of interest, or takes it back; without an area it only asks which there are."""

    area_id: Identifier | None = None
    polygon_m: Annotated[tuple[Waypoint, ...], Field(min_length=3, max_length=256)] | None = None
    """Corners [m]; none takes the area back."""
    weight: Annotated[float, Field(ge=0, le=1000)] = 2.0


class InterestList(Wire):
    areas: tuple[InterestArea, ...]


class Presence(Wire):
    """A process is alive; sent every few seconds of wall time."""

    name: Identifier
    side: Text
    incarnation: Count
    software: Text
    pid: Count
    host: Text
    refused: Count
    """Messages that were refused since it started."""
    events: Count
