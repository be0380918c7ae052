"""The log that the ground station keeps for operators: what the rover did, what was planned, what people changed."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Final

from pydantic import Field, model_validator

from schemas.telemetry import RoverEvent, RoverMode
from schemas.wire import Count, MissionTimeNs, PersonName, Text, Wire, is_none

MAX_EVENTS: Final = 1000
"""Newest events of the rover that the log keeps: a mission of 30 rounds has about 200."""
MAX_MODES: Final = 4000
"""Newest changes of the rover's mode that the log keeps: a sample takes about three."""
MAX_ENTRIES: Final = 1000
"""Newest entries that the log keeps."""


class AlarmKind(StrEnum):
    """What an alarm is about; at most one alarm of a kind is active."""

    STALE = "stale"
    LOW_ENERGY = "low_energy"
    BLOCKED = "blocked"
    SAFE_MODE = "safe_mode"
    NO_CONTACT = "no_contact"
    MISSION_FAILED = "mission_failed"
    DEFECT = "defect"


class AlarmAction(StrEnum):
    ACKNOWLEDGE = "acknowledge"
    """It was seen; it stays until its cause is gone."""
    SHELVE = "shelve"
    """It is known and needs no attention until a time; then it counts again if its cause lasts."""
    UNSHELVE = "unshelve"


class AlarmMark(Wire):
    """What a person has done about the alarm of a kind. It concerns what was raised before."""

    kind: AlarmKind
    action: AlarmAction
    by: PersonName
    """In a mission with keys, the signer of the request."""
    until: MissionTimeNs | None = Field(default=None, exclude_if=is_none)
    """End of the shelving (`shelve` only)."""
    why: Text = ""

    @model_validator(mode="after")
    def _has_an_end_where_it_is_shelved(self) -> AlarmMark:
        if (self.action is AlarmAction.SHELVE) != (self.until is not None):
            raise ValueError(f"expected until with shelve and only there, got {self.action.value}")
        return self


class LogKind(StrEnum):
    PLAN = "plan"
    """A round was planned and sent."""
    DECISION = "decision"
    """An operator decided on a plan that waited for approval."""
    INTEREST = "interest"
    """An area of interest was set or removed."""
    AUTHORITY = "authority"
    """Command authority changed hands."""
    GOAL = "goal"
    """The goal holds, or was found to be out of reach."""
    ALARM = "alarm"
    """An alarm was acknowledged, shelved or unshelved."""


class LogEntry(Wire):
    """One entry of the ground's log."""

    number: Count
    """From 0; every entry has another."""
    at: MissionTimeNs
    kind: LogKind
    text: Text
    by: Text = ""
    """The person who did it; empty where the ground did it by itself, and where no name was given."""
    round: Count | None = Field(default=None, exclude_if=is_none)
    begins_at: MissionTimeNs | None = Field(default=None, exclude_if=is_none)
    """When that round was expected to begin (`plan` only)."""
    ends_at: MissionTimeNs | None = Field(default=None, exclude_if=is_none)
    """When that round was expected to end (`plan` only); None: the sun never charges the rover enough."""
    mark: AlarmMark | None = Field(default=None, exclude_if=is_none)
    """What was done about an alarm (`alarm` only)."""


class HeardEvent(Wire):
    """An event of the rover, and when it reached the ground."""

    event: RoverEvent
    received_at: MissionTimeNs


SILENCE_S: Final = 300.0
"""Time between two reports of the rover from which on it is not known what it did between them."""


class ModeChange(Wire):
    """The rover reported a mode other than the one before, or any mode after `SILENCE_S` without a report."""

    mode: RoverMode
    made_at: MissionTimeNs
    """When the rover made the first report of it that reached the ground."""
    before_at: MissionTimeNs | None = Field(default=None, exclude_if=is_none)
    """When it made the report before, if that was longer than `SILENCE_S` before."""
    received_at: MissionTimeNs


class MissionLog(Wire):
    """All that the ground's log keeps, oldest first."""

    entries: Annotated[tuple[LogEntry, ...], Field(max_length=MAX_ENTRIES)] = ()
    events: Annotated[tuple[HeardEvent, ...], Field(max_length=MAX_EVENTS)] = ()
    modes: Annotated[tuple[ModeChange, ...], Field(max_length=MAX_MODES)] = ()


def mode_change(
    last: ModeChange | None, reported_at: int | None, mode: RoverMode, made_at: int, received_at: int
) -> ModeChange | None:
    """The change that a report of the rover's mode makes known; None if it tells nothing new, or was overtaken.

    last: the change before; reported_at: when the newest report so far was made.
    """
    if reported_at is not None and made_at <= reported_at:
        return None
    silent = reported_at is not None and made_at - reported_at > SILENCE_S * 1e9
    if last is not None and mode is last.mode and not silent:
        return None
    return ModeChange(mode=mode, made_at=made_at, received_at=received_at, before_at=reported_at if silent else None)
