"""The rover's telemetry: samples, events, state."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from schemas.wire import MAX_COUNT, Count, Identifier, MissionTimeNs, PositionM, Text, Wire

Metres = Annotated[float, Field(ge=0)]


class RoverMode(StrEnum):
    IDLE = "idle"
    DRIVING = "driving"
    DRILLING = "drilling"
    ANALYSING = "analysing"
    CHARGING = "charging"
    PAUSED = "paused"
    PARKED = "parked"
    SAFE = "safe"


class SampleReport(Wire):
    """One finished measurement."""

    sample_id: Identifier
    round: Annotated[int, Field(ge=1, lt=MAX_COUNT)]
    plan_revision: Annotated[int, Field(ge=1, lt=MAX_COUNT)]
    x_m: PositionM
    y_m: PositionM
    depth_m: Annotated[float, Field(gt=0, le=3)]
    helium3_ppb: float
    noise_std_ppb: Annotated[float, Field(ge=0)]
    measured_at: MissionTimeNs
    driven_m: Metres
    """Distance driven when it measured [m]."""


class EventKind(StrEnum):
    PLAN_ACCEPTED = "plan_accepted"
    PLAN_REJECTED = "plan_rejected"
    ROUND_STARTED = "round_started"
    ROUND_COMPLETED = "round_completed"
    ROUND_ABORTED = "round_aborted"
    SAMPLE_SKIPPED = "sample_skipped"
    BLOCKED = "blocked"
    SAFE_MODE_ENTERED = "safe_mode_entered"
    SAFE_MODE_LEFT = "safe_mode_left"
    PAUSED = "paused"
    RESUMED = "resumed"
    PARKED = "parked"
    LOW_ENERGY = "low_energy"
    CHARGED = "charged"
    INSTRUMENT_SILENT = "instrument_silent"
    MISSION_COMPLETED = "mission_completed"


class RoverEvent(Wire):
    """An event on board, delivered exactly once."""

    kind: EventKind
    at: MissionTimeNs
    x_m: PositionM
    y_m: PositionM
    round: Count = 0
    plan_revision: Count = 0
    sample_id: Identifier | None = None
    driven_m: Metres = 0.0
    obstacle_m: tuple[PositionM, PositionM] | None = None
    """Nearest place on the path ahead that the rover may not enter (`blocked` only); x_m and y_m are its own place."""
    samples_done: Annotated[tuple[Identifier, ...], Field(max_length=256)] = ()
    """Samples of the round that are measured (`round_completed`, `round_aborted` and `blocked`): they will arrive."""
    detail: Text = ""


class RoverState(Wire):
    """The present state of the rover; a newer one supersedes it."""

    mode: RoverMode
    x_m: PositionM
    y_m: PositionM
    heading_deg: Annotated[float, Field(ge=0, lt=360)]
    """Clockwise from north."""
    energy_wh: Annotated[float, Field(ge=0)]
    capacity_wh: Annotated[float, Field(gt=0)]
    driven_m: Metres
    drilled_m: Metres
    round: Count
    """The round in execution, or the last one; 0 before the first."""
    plan_revision: Count
    rounds_on_board: Count
    """Rounds accepted and not yet begun."""
    samples_done: Count
    queue_depth: Count
    """Messages without the ground's acknowledgement."""
