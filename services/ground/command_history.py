"""The command history: every telecommand of the mission, with each stage that it is known to have passed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from he3.errors import InvalidInput
from schemas.commands import CommandKind, CommandReport, CommandStage, CommandStatus, Telecommand
from schemas.topics import COMMAND
from services.ground.terrain import keep_out_objection
from services.mission.mission_time import SECOND, MissionTime, seconds

if TYPE_CHECKING:
    from he3.frames import SiteGrid
    from schemas.link import LinkStatus
    from services.runtime.node import SavedState

MAX_UNDER_WAY = 200  # commands that have not ended; more than an operator can follow
MAX_LISTED = 300  # commands in a list, the newest; with the largest polygons they still fit into a reply
LOOK_AGAIN_S = 30.0  # between looks at the link for a command that has not left yet
LOST_AFTER_S = 60.0  # past its expiry and a round trip, before silence means that a command is lost

_ORDER = {stage: number for number, stage in enumerate(CommandStage)}

_NEVER_CARRIED_OUT = frozenset({CommandStage.REJECTED, CommandStage.FAILED, CommandStage.EXPIRED})
_HOLDS = frozenset({CommandKind.PAUSE, CommandKind.SAFE})
_RELEASES = frozenset({CommandKind.RESUME, CommandKind.GO_TO, CommandKind.RETURN_TO_START})
Polygon = tuple[tuple[float, float], ...]


@dataclass(slots=True)
class CommandHistory:
    """All telecommands of the mission, in the order in which they were issued."""

    grid: SiteGrid
    round_trip_s: float = 0.0
    """Round-trip light time of the scenario [s]."""
    _statuses: dict[str, CommandStatus] = field(default_factory=dict)
    _sent: list[str] = field(default_factory=list)

    def restarted(self) -> None:
        """Note a start of the process: its messages are numbered from 0 again."""
        self._sent = []

    def knows(self, command: Telecommand) -> bool:
        """Whether that very command was issued before: asking again changes nothing."""
        known = self._statuses.get(command.command_id)
        return known is not None and known.command.order == command.order

    def issue(self, command: Telecommand, now: MissionTime) -> tuple[CommandStatus, bool]:
        """The command's status, and whether it is new and must be sent; the same command again changes nothing.

        Raises InvalidInput, in one line and without a change, for a command that could not be carried out.
        """
        known = self._statuses.get(command.command_id)
        if known is not None:
            if known.command.order != command.order:
                raise InvalidInput(f"command {command.command_id}: expected a new id, got that of another command")
            return known, False
        self.expect_sound(command, now)
        stages = tuple(
            CommandReport(command_id=command.command_id, stage=stage, at=now)
            for stage in (CommandStage.QUEUED, CommandStage.RELEASED)
        )
        status = CommandStatus(command=command, stages=stages)
        self._statuses[command.command_id] = status
        self._sent.append(command.command_id)
        return status, True

    def expect_sound(self, command: Telecommand, now: MissionTime) -> None:
        """Raise InvalidInput, in one line, for a new command that could not be carried out."""
        if command.expires_at is not None and command.expires_at <= now:
            late = (now - command.expires_at) / SECOND
            raise InvalidInput(f"command {command.command_id}: expected an expiry ahead, got one {late:g} s ago")
        target = command.target_m
        if target is not None and not self.grid.contains(np.array([target]))[0]:
            raise InvalidInput(
                f"command {command.command_id}: expected a target within 0..{self.grid.width_m:g} m east and "
                f"0..{self.grid.height_m:g} m north, got ({target[0]:g}, {target[1]:g})"
            )
        if command.polygon_m is not None and (why := keep_out_objection(self.grid, command.polygon_m)) is not None:
            raise InvalidInput(f"command {command.command_id}: polygon_m: {why}")
        under_way = sum(status.end is None for status in self._statuses.values())
        if under_way >= MAX_UNDER_WAY:
            raise InvalidInput(f"expected at most {MAX_UNDER_WAY} commands under way, got one more")

    def report(self, report: CommandReport) -> CommandStatus | None:
        """The command's status after a report on it; None if the report is not new or the command is unknown."""
        known = self._statuses.get(report.command_id)
        if known is None or any(passed.stage is report.stage for passed in known.stages):
            return None
        stages = tuple(sorted((*known.stages, report), key=lambda passed: (passed.at, _ORDER[passed.stage])))
        status = CommandStatus(command=known.command, stages=stages)
        self._statuses[report.command_id] = status
        return status

    def leaving(self) -> list[str]:
        """Commands sent since the start that are not known to have left the Earth."""
        return [
            name
            for name in self._sent
            if all(_ORDER[passed.stage] < _ORDER[CommandStage.RADIATED] for passed in self._statuses[name].stages)
        ]

    def _not_radiated(self) -> list[str]:
        """Commands sent since the start without a report that they left the Earth."""
        return [
            name
            for name in self._sent
            if all(passed.stage is not CommandStage.RADIATED for passed in self._statuses[name].stages)
        ]

    def seen_on_link(self, link: LinkStatus, source: str, now: MissionTime) -> tuple[list[CommandStatus], MissionTime]:
        """Commands that the link's status shows to have left the Earth, and when to look again for the others.

        A message is identified by its sequence, which is its index among the commands sent since the start.
        """
        departures = {
            (flight.sequence, flight.offered_at): flight.departs_at
            for flight in (*link.in_flight, *link.commands_arrived)
            if flight.topic == COMMAND.name and flight.source == source
        }
        left: list[CommandStatus] = []
        again = now + seconds(LOOK_AGAIN_S)
        if link.contact_changes_at is not None and link.contact_changes_at > now:
            again = min(again, link.contact_changes_at)
        for name in self._not_radiated():
            sequence, sent_at = self._sent.index(name), self._statuses[name].stages[0].at
            for (number, offered_at), departs_at in departures.items():
                if number != sequence or offered_at < sent_at or departs_at is None:
                    continue
                if departs_at > now:
                    again = min(again, departs_at)
                    continue
                radiated = CommandReport(command_id=name, stage=CommandStage.RADIATED, at=departs_at)
                status = self.report(radiated)
                if status is not None:
                    left.append(status)
        return left, again

    def overdue_at(self, command: Telecommand) -> MissionTime | None:
        """When a command without a report counts as lost; None if it does not expire."""
        if command.expires_at is None:
            return None
        return command.expires_at + round((self.round_trip_s + LOST_AFTER_S) * SECOND)

    def give_up(self, command_id: str, now: MissionTime) -> CommandStatus | None:
        """The status of a command that has expired without a report from the rover; None if there was a report."""
        known = self._statuses.get(command_id)
        if known is None or any(_ORDER[passed.stage] >= _ORDER[CommandStage.RECEIVED] for passed in known.stages):
            return None
        why = "it has expired without a report from the rover"
        return self.report(CommandReport(command_id=command_id, stage=CommandStage.LOST, at=now, why=why))

    def closed_by(self, area_id: str, at_first: Sequence[Polygon] = ()) -> list[Polygon]:
        """The polygons that the rover may have in force under that id, and the one that the operator set last.

        at_first: those in force before any command. A polygon is dropped when the rover has carried out a later command
        on the area. The polygon of a rejected or expired command is dropped when another command is issued.
        """
        issued = [status for status in self._statuses.values() if status.command.area_id == area_id]
        closed = list(at_first)
        for status in issued:
            passed = {report.stage for report in status.stages}
            if CommandStage.COMPLETED in passed:
                closed = []
            polygon = status.command.polygon_m
            if polygon is not None and (status is issued[-1] or not passed & _NEVER_CARRIED_OUT):
                closed.append(polygon)
        return closed

    @property
    def holds_rover(self) -> bool:
        """Whether a command holds the rover still, according to its reports."""
        done = [
            (report.at, status.command.kind)
            for status in self._statuses.values()
            if status.command.kind in _HOLDS | _RELEASES
            for report in status.stages
            if report.stage in (CommandStage.STARTED, CommandStage.COMPLETED)
        ]
        return bool(done) and max(done)[1] in _HOLDS

    def find(self, command_id: str) -> CommandStatus | None:
        """The status of that command; None for one that was not issued here."""
        return self._statuses.get(command_id)

    def listed(self) -> tuple[CommandStatus, ...]:
        """The newest commands with their stages, in the order in which they were issued."""
        return tuple(self._statuses.values())[-MAX_LISTED:]

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "statuses": dict(self._statuses),
            "sent": list(self._sent),
        }

    def restore(self, state: SavedState) -> None:
        """Restore the history from this state."""
        self._statuses = state["statuses"]
        self._sent = state["sent"]
