"""Alarms: raised by conditions and events, kept until the cause is gone and an operator has acknowledged them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

from schemas.ground import GroundStatus, MissionPhase
from schemas.telemetry import EventKind, RoverEvent, RoverMode
from services.console.client.staleness import STATE_PERIOD_S, stale_after_s
from services.console.client.time_format import duration
from services.mission.mission_time import SECOND, MissionTime

if TYPE_CHECKING:
    from schemas.link import LinkStatus

LOW_ENERGY_SHARE = 0.25
"""Battery alarm limit, as a share of the capacity: above the reserve (0.2 by default), at which safe mode begins."""


class AlarmKind(StrEnum):
    STALE = "stale"
    LOW_ENERGY = "low_energy"
    BLOCKED = "blocked"
    SAFE_MODE = "safe_mode"
    NO_CONTACT = "no_contact"
    MISSION_FAILED = "mission_failed"
    DEFECT = "defect"


_ABOUT = {
    EventKind.BLOCKED: AlarmKind.BLOCKED,
    EventKind.ROUND_STARTED: AlarmKind.BLOCKED,
    EventKind.ROUND_COMPLETED: AlarmKind.BLOCKED,
    EventKind.SAFE_MODE_ENTERED: AlarmKind.SAFE_MODE,
    EventKind.SAFE_MODE_LEFT: AlarmKind.SAFE_MODE,
    EventKind.LOW_ENERGY: AlarmKind.LOW_ENERGY,
}
"""The alarm that an event of the rover raises or ends."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm; `active` while its cause lasts."""

    alarm_id: str
    kind: AlarmKind
    raised_at: MissionTime
    text: str
    active: bool = True
    acknowledged: bool = False
    times: int = 1
    """How often it was raised since it was last acknowledged."""

    def document(self) -> dict[str, object]:
        """The alarm as a JSON document for the page."""
        return {
            "id": self.alarm_id,
            "kind": self.kind.value,
            "raised_at": self.raised_at,
            "text": self.text,
            "active": self.active,
            "acknowledged": self.acknowledged,
            "times": self.times,
        }


class Alarms:
    """All alarms that are active or not acknowledged, at most one per kind."""

    def __init__(self) -> None:
        self._alarms: dict[str, Alarm] = {}
        self._counter = 0
        self._known_at: dict[AlarmKind, MissionTime] = {}
        """When the newest word on a condition of the rover was made: states and events overtake each other."""

    @property
    def current(self) -> tuple[Alarm, ...]:
        """Oldest first."""
        return tuple(self._alarms.values())

    def look(
        self,
        status: GroundStatus | None,
        link: LinkStatus | None,
        now: MissionTime,
        rate: float = 1.0,
        defects: str = "",
        state_period_s: float = STATE_PERIOD_S,
    ) -> bool:
        """Check all conditions against the mission's state; returns whether an alarm has changed.

        rate and state_period_s: see `stale_after_s`. defects: one line on processes that have failed upon messages;
        empty if there are none.
        """
        found = self._conditions(status, link, now, stale_after_s(state_period_s, link, rate))
        if defects:  # it stays true for as long as the process runs
            found[AlarmKind.DEFECT] = defects
        changes = [self._set(kind, text, now) for kind, text in found.items()]
        return any(changes)

    def happened(self, event: RoverEvent) -> bool:
        """Handle an event of the rover; returns whether an alarm has changed."""
        kind = _ABOUT.get(event.kind)
        if kind is None or not self._is_news(kind, event.at):
            return False
        where = f"at ({event.x_m:.0f}, {event.y_m:.0f}) m"
        about = f": {event.detail}" if event.detail else ""
        if event.kind is EventKind.BLOCKED:
            return self._set(AlarmKind.BLOCKED, f"the rover is blocked {where}{about}", event.at)
        if event.kind in (EventKind.ROUND_STARTED, EventKind.ROUND_COMPLETED):
            return self._set(AlarmKind.BLOCKED, None, event.at)
        if event.kind is EventKind.SAFE_MODE_ENTERED:
            return self._set(AlarmKind.SAFE_MODE, f"the rover entered safe mode {where}{about}", event.at)
        if event.kind is EventKind.SAFE_MODE_LEFT:
            return self._set(AlarmKind.SAFE_MODE, None, event.at)
        if event.kind is EventKind.LOW_ENERGY:
            return self._set(AlarmKind.LOW_ENERGY, f"the rover is low on energy{about}", event.at)
        return False

    def acknowledge(self, alarm_id: str) -> bool:
        """Acknowledge an alarm; returns whether there was one to acknowledge."""
        alarm = self._alarms.get(alarm_id)
        if alarm is None or alarm.acknowledged:
            return False
        self._keep(replace(alarm, acknowledged=True))
        return True

    def _conditions(
        self, status: GroundStatus | None, link: LinkStatus | None, now: MissionTime, stale_s: float
    ) -> dict[AlarmKind, str | None]:
        found: dict[AlarmKind, str | None] = {}
        over = status is not None and status.is_over
        if status is not None and status.rover is not None and status.rover_made_at is not None:
            rover, age_s = status.rover, (now - status.rover_made_at) / SECOND
            stale = age_s > stale_s and not over
            found[AlarmKind.STALE] = f"no report of the rover for {duration(age_s)}" if stale else None
            share = rover.energy_wh / rover.capacity_wh
            if self._is_news(AlarmKind.LOW_ENERGY, status.rover_made_at):
                low = f"the rover's battery is at {share:.0%}" if share < LOW_ENERGY_SHARE else None
                found[AlarmKind.LOW_ENERGY] = low
            # The state says it too: the event may still be in flight.
            if self._is_news(AlarmKind.SAFE_MODE, status.rover_made_at):
                safe = rover.mode is RoverMode.SAFE
                found[AlarmKind.SAFE_MODE] = "the rover is in safe mode" if safe else None
        if link is not None:
            found[AlarmKind.NO_CONTACT] = None if link.contact or over else "no contact with the Moon"
        if status is not None:
            failed = status.phase is MissionPhase.FAILED
            found[AlarmKind.MISSION_FAILED] = f"the mission failed: {status.detail}" if failed else None
        return found

    def _is_news(self, kind: AlarmKind, made_at: MissionTime) -> bool:
        """Whether no later word on that condition is known; if so, this is the newest from now on."""
        if made_at < self._known_at.get(kind, made_at):
            return False
        self._known_at[kind] = made_at
        return True

    def _set(self, kind: AlarmKind, text: str | None, at: MissionTime) -> bool:
        active = next((alarm for alarm in self._alarms.values() if alarm.kind is kind and alarm.active), None)
        if text is None:
            if active is not None:
                self._keep(replace(active, active=False))
            return active is not None
        if active is not None:
            return False
        before = next((alarm for alarm in self._alarms.values() if alarm.kind is kind), None)
        if before is not None:  # its cause is gone, and it is not acknowledged
            self._keep(replace(before, raised_at=at, text=text, active=True, times=before.times + 1))
            return True
        self._counter += 1
        self._keep(Alarm(f"{kind.value}-{self._counter}", kind, at, text))
        return True

    def _keep(self, alarm: Alarm) -> None:
        if alarm.acknowledged and not alarm.active:
            self._alarms.pop(alarm.alarm_id, None)
        else:
            self._alarms[alarm.alarm_id] = alarm


def documents(alarms: Iterable[Alarm]) -> list[dict[str, object]]:
    """Alarms as the page reads them."""
    return [alarm.document() for alarm in alarms]
