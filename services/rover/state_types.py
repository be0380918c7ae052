"""The types in the rover's state, beside plain values: a checkpoint may hold no others."""

from __future__ import annotations

from typing import Final

from schemas.commands import CommandReport, Telecommand
from schemas.plans import MissionPlan, PlannedSample
from schemas.telemetry import RoverMode
from services.rover.activities import Leg
from services.rover.drive import Drive
from services.rover.driving import Scan
from services.rover.energy import Battery
from services.rover.geometry import Area
from services.rover.path_scan import PathSection, ScanPattern
from services.rover.states import Hold, State

STATE_TYPES: Final[tuple[type, ...]] = (
    Area,
    Battery,
    CommandReport,
    Drive,
    Hold,
    Leg,
    MissionPlan,
    PathSection,
    PlannedSample,
    RoverMode,
    Scan,
    ScanPattern,
    State,
    Telecommand,
)
