"""Follows the execution of rounds in the rover's reports, and derives the changes for planning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from schemas.telemetry import EventKind, RoverEvent, RoverMode, RoverState, SampleReport
from schemas.topics import EVENT, SAMPLE
from services.ground.obstacles import MetObstacles
from services.ground.rover_position import RoverPosition
from services.ground.samples import Refused, Repeated, SampleIntake, Taken, Unplanned
from services.runtime.node import Cause, Level, LogRecord

if TYPE_CHECKING:
    from he3.frames import Place
    from schemas.topics import Topic
    from services.ground.round_log import RoundLog
    from services.ground.round_record import RoundRecord
    from services.ground.terrain import GroundTerrain
    from services.mission.mission_time import MissionTime
    from services.runtime.node import SavedState

_UNOCCUPIED = frozenset({RoverMode.IDLE, RoverMode.PARKED, RoverMode.SAFE})


@dataclass(frozen=True, slots=True)
class Outcome:
    """The changes for planning that follow from a report."""

    changed: bool = False
    """Whether anything has changed, so that the next step may be due."""
    notes: tuple[LogRecord, ...] = ()
    begun_outdated: bool = False
    """Whether the rover has begun a replaced version of a round; the next round must then begin at its end."""
    take_back: bool = False
    """The rounds that have not begun are to be planned again, from `start_m` on."""
    start_m: Place | None = None


class ExecutionMonitor:
    """Follows the rover: its position, its rounds, the samples that arrive and the obstacles that it meets."""

    def __init__(self, terrain: GroundTerrain, round_log: RoundLog, samples: SampleIntake, start_m: Place) -> None:
        self._grid = terrain.grid
        self._round_log = round_log
        self._samples = samples
        self._rover = RoverPosition(start_m)
        self._obstacles = MetObstacles(terrain)
        self.detail = ""
        """A note on the rover for the operator; may be empty."""
        self._silent: tuple[MissionTime, float] | None = None
        """When an instrument fell silent, and the odometer then; None if none is known to be silent."""
        self._answered_at: MissionTime = -1
        """Latest time at which the instruments are known to have answered."""

    @property
    def place_m(self) -> Place:
        """Where the rover was last heard from (x, y) [m]."""
        return self._rover.place_m

    @property
    def driven_m(self) -> float:
        """Odometer of the rover, as last heard [m]."""
        return self._rover.driven_m

    def sent_to(self, place_m: Place) -> None:
        """Note that the rover has arrived where the operator sent it."""
        self._rover.sent_to(place_m)

    def heard(self, place_m: Place, driven_m: float, made_at: MissionTime) -> bool:
        """Note a reported place; returns whether the message, made at that time, is the newest so far."""
        newest = self._rover.heard(place_m, driven_m, made_at)
        if self._silent is not None and driven_m > self._silent[1]:
            self._answered(made_at)  # without terrain it does not move
        if newest:
            self._round_log.note_place(place_m)
        return newest

    def rounds_dropped(self, state: RoverState, revision: int) -> list[RoundRecord]:
        """The rounds that a rover with that newest state no longer has on board; revision: of the plan sent last."""
        waiting = self._round_log.not_begun
        idle = state.mode in _UNOCCUPIED and state.rounds_on_board == 0 and state.plan_revision == revision
        return waiting if idle and waiting and state.round < waiting[0].number else []

    def sample(self, report: SampleReport) -> Outcome:
        """The outcome of a measurement; a repeated or unplanned one changes nothing."""
        self._answered(report.measured_at)
        match self._samples.take(report):
            case Repeated():
                return Outcome()
            case Unplanned(why):
                return Outcome(notes=(_ignored(SAMPLE, why),))
            case Refused(record, why):
                outdated, notes = self._begun(record)
                return Outcome(True, (_warning(why), *notes), outdated)
            case Taken(record):
                self._rover.drove(report.driven_m)
                outdated, notes = self._begun(record)
                record.note_place((report.x_m, report.y_m))
                return Outcome(True, notes, outdated)

    def objection(self, event: RoverEvent) -> LogRecord | None:
        """A warning if the event's place is outside the region."""
        if self._grid.has((event.x_m, event.y_m)):
            return None
        where = f"({event.x_m:g}, {event.y_m:g})"
        return _ignored(EVENT, f"event {event.kind.value}: expected a place in the region, got {where}")

    def event(self, event: RoverEvent, revision: int) -> Outcome:
        """The outcome of a rover's event that is not about a plan; revision: of the plan sent last."""
        match event.kind:
            case EventKind.BLOCKED if event.round == 0:  # on a move that the operator commanded
                self._obstacles.close_off(event)
                return Outcome(True)
            case EventKind.INSTRUMENT_SILENT if event.at < self._answered_at:
                return Outcome()  # overtaken by what was measured since
            case EventKind.SAFE_MODE_ENTERED | EventKind.LOW_ENERGY | EventKind.INSTRUMENT_SILENT:
                silent = event.kind is EventKind.INSTRUMENT_SILENT
                self._silent = (event.at, event.driven_m) if silent else None
                self.detail = f"{event.kind.value.replace('_', ' ')}: {event.detail}"[:400]
                return Outcome()
            case EventKind.SAFE_MODE_LEFT | EventKind.CHARGED | EventKind.RESUMED:
                self.detail, self._silent = "", None
                return Outcome()
            case (
                EventKind.ROUND_STARTED
                | EventKind.ROUND_COMPLETED
                | EventKind.ROUND_ABORTED
                | EventKind.BLOCKED
                | EventKind.SAMPLE_SKIPPED
            ):
                return self._of_a_round(event, revision)
            case _:
                return Outcome()

    def _of_a_round(self, event: RoverEvent, revision: int) -> Outcome:
        record = self._round_log.version(event.round, event.plan_revision or revision)
        if event.sample_id is not None and (known := self._round_log.of_sample(event.sample_id)) is not None:
            record = known[0]
        if record is None:
            text = f"event {event.kind.value}: expected a round that was planned, got {event.round}"
            return Outcome(notes=(_ignored(EVENT, text),))
        outdated, notes = self._begun(record)
        if event.kind is EventKind.ROUND_STARTED:
            record.start(event.at)
        record.done.update(event.samples_done)
        if event.kind is EventKind.SAMPLE_SKIPPED and event.sample_id is not None:
            if record.settle(event.sample_id):
                self._silent = None
                self.detail = f"sample {event.sample_id} was skipped: {event.detail or 'no reason given'}"[:400]
        elif event.kind is EventKind.ROUND_COMPLETED:
            record.complete()
        elif event.kind in (EventKind.ROUND_ABORTED, EventKind.BLOCKED):
            ended = self._ended_early(record, event)
            return Outcome(True, (*notes, *ended.notes), outdated, ended.take_back, ended.start_m)
        return Outcome(True, notes, outdated)

    def _answered(self, at: MissionTime) -> None:
        """Note that the instruments answered at that time: the note on a silent one is over."""
        self._answered_at = max(at, self._answered_at)
        if self._silent is not None and at > self._silent[0]:
            self.detail, self._silent = "", None

    def _begun(self, record: RoundRecord) -> tuple[bool, tuple[LogRecord, ...]]:
        """Whether the round that has begun had been replaced, with a note on it."""
        if not self._round_log.begin(record):
            return False, ()
        text = f"round {record.number} of revision {record.introduced} had begun; planning continues from it"
        return True, (LogRecord(Level.INFO, text),)

    def _ended_early(self, record: RoundRecord, event: RoverEvent) -> Outcome:
        first_report = not record.ended
        blocked = event.kind is EventKind.BLOCKED
        if blocked:
            self._obstacles.close_off(event)
        if not first_report and not blocked:
            return Outcome()
        record.break_off(event.at)
        self._silent = None
        self.detail = f"round {record.number} ended early: {event.detail or event.kind.value}"[:400]
        place = (event.x_m, event.y_m)
        note = LogRecord(Level.WARNING, self.detail, {"round": record.number, "x_m": place[0], "y_m": place[1]})
        if self._round_log.goes_on_after(record):
            return Outcome(True, (note,))
        return Outcome(True, (note,), take_back=True, start_m=place)

    def checkpoint(self) -> SavedState:
        """The state of each part by its name, and the detail."""
        return {
            "samples": self._samples.checkpoint(),
            "rover": self._rover.checkpoint(),
            "obstacles": self._obstacles.checkpoint(),
            "detail": self.detail,
            "silent": self._silent,
            "answered_at": self._answered_at,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the monitor from this state."""
        self._samples.restore(state["samples"])
        self._rover.restore(state["rover"])
        self._obstacles.restore(state["obstacles"])
        self.detail, self._silent = state["detail"], state["silent"]
        self._answered_at = state["answered_at"]


def _warning(text: str) -> LogRecord:
    return LogRecord(Level.WARNING, text)


def _ignored(topic: Topic, text: str) -> LogRecord:
    """The warning of a message whose content counts for nothing."""
    return LogRecord(Level.WARNING, text, cause=Cause(f"{topic.name}: ignored", "rover"))
