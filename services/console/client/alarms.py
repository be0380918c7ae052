"""Alarms: raised by conditions and events, kept until the cause is gone and a person has acknowledged them.

Every display computes them for itself from the mission's messages; what people did about them is in the ground's log.
An alarm's time is that of its cause, not that at which a display saw it, so displays agree on which marks concern it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from schemas.ground import GroundStatus, MissionPhase
from schemas.mission_log import AlarmAction, AlarmKind, LogEntry, MissionLog
from schemas.telemetry import EventKind, RoverEvent, RoverMode
from services.console.client.staleness import STATE_PERIOD_S, stale_after_s
from services.console.client.time_format import utc
from services.mission.mission_time import SECOND, MissionTime, seconds

if TYPE_CHECKING:
    from schemas.link import LinkStatus
    from schemas.mission_log import AlarmMark

LOW_ENERGY_SHARE = 0.25
"""Battery alarm limit, as a share of the capacity: above the reserve (0.2 by default), at which safe mode begins."""
MAX_HISTORY = 300
"""Newest alarms whose cause is gone that are kept."""


class Severity(StrEnum):
    """How urgent an alarm is, the least urgent first."""

    ADVISORY = "advisory"
    """To be known; the mission goes on as planned."""
    WARNING = "warning"
    """The mission goes on, but not as planned."""
    CRITICAL = "critical"
    """The mission does not go on by itself."""


SEVERITIES = {
    AlarmKind.STALE: Severity.WARNING,
    AlarmKind.LOW_ENERGY: Severity.WARNING,
    AlarmKind.BLOCKED: Severity.WARNING,
    AlarmKind.SAFE_MODE: Severity.CRITICAL,
    AlarmKind.NO_CONTACT: Severity.ADVISORY,
    AlarmKind.MISSION_FAILED: Severity.CRITICAL,
    AlarmKind.DEFECT: Severity.WARNING,
}
"""Severity of each kind; without contact that no schedule foresees, `NO_CONTACT` is a warning."""

NO_CONTACT_TEXT = "no contact with the Moon"

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

    kind: AlarmKind
    severity: Severity
    raised_at: MissionTime
    text: str
    active: bool = True
    ended_at: MissionTime | None = None
    times: int = 1
    """How often it was raised since it was last acknowledged."""
    acknowledged_at: MissionTime | None = None
    acknowledged_by: str = ""
    shelved_until: MissionTime | None = None
    shelved_by: str = ""

    @property
    def acknowledged(self) -> bool:
        return self.acknowledged_at is not None

    @property
    def shelved(self) -> bool:
        return self.shelved_until is not None

    @property
    def wants_attention(self) -> bool:
        """Whether no person has seen to it yet."""
        return not (self.acknowledged or self.shelved)

    @property
    def rank(self) -> tuple[bool, bool, int, MissionTime]:
        """Its place in a list, the most urgent first: what wants attention, then what is active, then by severity."""
        return not self.wants_attention, not self.active, -_RANKS[self.severity], -self.raised_at

    def document(self) -> dict[str, Any]:
        """The alarm as JSON values."""
        return {**asdict(self), "acknowledged": self.acknowledged}


_RENEWED = (AlarmKind.STALE, AlarmKind.NO_CONTACT, AlarmKind.DEFECT)
"""Kinds whose text and severity follow the mission's state while they are active."""

_RANKS = {severity: number for number, severity in enumerate(Severity)}


class Alarms:
    """All alarms that are active or not acknowledged, at most one per kind, and those that are over."""

    def __init__(self) -> None:
        self._alarms: dict[AlarmKind, Alarm] = {}
        self._history: list[Alarm] = []
        self._seen: dict[AlarmKind, tuple[MissionTime, str]] = {}
        """When the alarms of a kind were last acknowledged, and by whom."""
        self._shelved: dict[AlarmKind, tuple[MissionTime, str]] = {}
        """Until when a kind is shelved, and by whom."""
        self._known_at: dict[AlarmKind, MissionTime] = {}
        """When the newest word on a condition of the rover was made: states and events overtake each other."""
        self._entries: set[int] = set()
        self._looked = False

    @property
    def current(self) -> tuple[Alarm, ...]:
        """The alarms that are active or not acknowledged, the most urgent first."""
        return tuple(sorted(self._alarms.values(), key=lambda alarm: alarm.rank))

    @property
    def history(self) -> tuple[Alarm, ...]:
        """The alarms that are over and acknowledged or raised anew since, in the order of their end."""
        return tuple(self._history)

    @property
    def shelved(self) -> dict[AlarmKind, tuple[MissionTime, str]]:
        """Until when each shelved kind is shelved, and by whom, whether or not there is an alarm of that kind."""
        return dict(self._shelved)

    def past(self, log: MissionLog) -> None:
        """Take in what the ground has logged before this display joined."""
        for heard in log.events:
            self.happened(heard.event)
        for entry in log.entries:
            self.logged(entry)

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
        if not self._looked and link is not None and not (status is not None and status.is_over):
            self._past_contact(link)
        found = self._conditions(status, link, now, stale_after_s(state_period_s, link, rate))
        found[AlarmKind.DEFECT] = (defects or None), now
        changes = [self._set(kind, text, at, _severity(kind, link)) for kind, (text, at) in found.items()]
        self._looked = True
        changes += [self._unshelve(kind) for kind, (until, _) in list(self._shelved.items()) if until <= now]
        return any(changes)

    def _past_contact(self, link: LinkStatus) -> None:
        """Raise and end the alarms of the changes of contact that the link remembers, before this display joined."""
        contact = True
        for event in link.events:
            if event.contact is not contact:
                severity = Severity.WARNING if event.by else Severity.ADVISORY
                text = None if event.contact else NO_CONTACT_TEXT
                self._set(AlarmKind.NO_CONTACT, text, event.at, severity, dated=True)
            contact = event.contact

    def happened(self, event: RoverEvent) -> bool:
        """Handle an event of the rover; returns whether an alarm has changed."""
        kind = _ABOUT.get(event.kind)
        if kind is None or not self._is_news(kind, event.at):
            return False
        where = f"at ({event.x_m:.0f}, {event.y_m:.0f}) m"
        about = f": {event.detail}" if event.detail else ""
        if event.kind is EventKind.BLOCKED:
            return self._set(kind, f"the rover is blocked {where}{about}", event.at)
        if event.kind is EventKind.SAFE_MODE_ENTERED:
            return self._set(kind, f"the rover entered safe mode {where}{about}", event.at)
        if event.kind is EventKind.LOW_ENERGY:
            return self._set(kind, f"the rover is low on energy{about}", event.at)
        return self._set(kind, None, event.at)

    def logged(self, entry: LogEntry) -> bool:
        """Handle an entry of the ground's log; returns whether an alarm has changed."""
        if entry.mark is None or entry.number in self._entries:
            return False
        self._entries.add(entry.number)
        return self._marked(entry.mark, entry.at)

    def _marked(self, mark: AlarmMark, at: MissionTime) -> bool:
        alarm = self._alarms.get(mark.kind)
        if mark.action is AlarmAction.ACKNOWLEDGE:
            if at < self._seen.get(mark.kind, (at, ""))[0]:
                return False
            self._seen[mark.kind] = at, mark.by
            if alarm is None or alarm.raised_at > at:
                return False
            self._keep(replace(alarm, acknowledged_at=at, acknowledged_by=mark.by))
            return True
        if mark.action is AlarmAction.UNSHELVE:
            return self._unshelve(mark.kind)
        assert mark.until is not None, "the schema wants an end"
        self._shelved[mark.kind] = mark.until, mark.by
        if alarm is not None:
            self._keep(replace(alarm, shelved_until=mark.until, shelved_by=mark.by))
        return alarm is not None

    def _unshelve(self, kind: AlarmKind) -> bool:
        alarm = self._alarms.get(kind)
        if self._shelved.pop(kind, None) is None or alarm is None:
            return False
        self._keep(replace(alarm, shelved_until=None, shelved_by=""))
        return True

    def _conditions(
        self, status: GroundStatus | None, link: LinkStatus | None, now: MissionTime, stale_s: float
    ) -> dict[AlarmKind, tuple[str | None, MissionTime]]:
        """Text of each condition that is known, None where it does not hold, and since when.

        A text stands in the log under the time at which its alarm was raised, so it has no figure that grows older.
        """
        found: dict[AlarmKind, tuple[str | None, MissionTime]] = {}
        over = status is not None and status.is_over
        if status is not None and status.rover is not None and status.rover_made_at is not None:
            rover, made_at = status.rover, status.rover_made_at
            age_s = (now - made_at) / SECOND
            stale = age_s > stale_s and not over
            text = f"no report of the rover since {utc(made_at, 0)}" if stale else None
            found[AlarmKind.STALE] = text, (made_at + seconds(stale_s) if stale else made_at)
            share = rover.energy_wh / rover.capacity_wh
            if self._is_news(AlarmKind.LOW_ENERGY, made_at):
                low = f"the rover's battery is below {LOW_ENERGY_SHARE:.0%}" if share < LOW_ENERGY_SHARE else None
                found[AlarmKind.LOW_ENERGY] = low, made_at
            # The state says it too: the event may still be in flight.
            if self._is_news(AlarmKind.SAFE_MODE, made_at):
                safe = rover.mode is RoverMode.SAFE
                found[AlarmKind.SAFE_MODE] = ("the rover is in safe mode" if safe else None), made_at
        if link is not None:
            none = not link.contact and not over
            found[AlarmKind.NO_CONTACT] = (NO_CONTACT_TEXT if none else None), _since(link, now)
        if status is not None:
            failed = status.phase is MissionPhase.FAILED
            found[AlarmKind.MISSION_FAILED] = (f"the mission failed: {status.detail}" if failed else None), now
        return found

    def _is_news(self, kind: AlarmKind, made_at: MissionTime) -> bool:
        """Whether no later word on that condition is known; if so, this is the newest from now on."""
        if made_at < self._known_at.get(kind, made_at):
            return False
        self._known_at[kind] = made_at
        return True

    def _set(
        self,
        kind: AlarmKind,
        text: str | None,
        at: MissionTime,
        severity: Severity | None = None,
        *,
        dated: bool = False,
    ) -> bool:
        """Raise, renew or end the alarm of that kind; returns whether it has changed.

        dated: `at` is when it began, also before this display joined; else it may have begun earlier.
        """
        before = self._alarms.get(kind)
        if before is not None and before.active:
            if text is not None:
                return self._renew(before, text, severity)
            self._keep(replace(before, active=False, ended_at=max(at, before.raised_at)))
            return True
        if text is None:
            return False
        times = 1
        if before is not None:  # its cause is gone, and it is not acknowledged
            self._remember(before)
            times = before.times + 1
        seen = self._seen.get(kind)
        # What held already when this display joined may have begun, and been acknowledged, before.
        known = seen is not None and (at <= seen[0] or not (self._looked or dated))
        until, by = self._shelved.get(kind, (None, ""))
        self._alarms[kind] = Alarm(
            kind,
            severity or SEVERITIES[kind],
            at,
            text,
            times=times,
            acknowledged_at=seen[0] if seen is not None and known else None,
            acknowledged_by=seen[1] if seen is not None and known else "",
            shelved_until=until,
            shelved_by=by,
        )
        return True

    def _renew(self, alarm: Alarm, text: str, severity: Severity | None) -> bool:
        """Give an active alarm the text and the severity of now; returns whether one is another.

        What an event has said of the rover stays: it knows the place and the cause, which the rover's state does not.
        """
        if alarm.kind not in _RENEWED:
            return False
        renewed = replace(alarm, text=text, severity=severity or alarm.severity)
        self._alarms[alarm.kind] = renewed
        return renewed != alarm

    def _keep(self, alarm: Alarm) -> None:
        if alarm.acknowledged and not alarm.active:
            self._alarms.pop(alarm.kind, None)
            self._remember(alarm)
        else:
            self._alarms[alarm.kind] = alarm

    def _remember(self, alarm: Alarm) -> None:
        self._history.append(alarm)
        del self._history[:-MAX_HISTORY]


def _severity(kind: AlarmKind, link: LinkStatus | None) -> Severity:
    unforeseen = kind is AlarmKind.NO_CONTACT and link is not None and link.contact_forced is False
    return Severity.WARNING if unforeseen else SEVERITIES[kind]


def _since(link: LinkStatus, now: MissionTime) -> MissionTime:
    """Since when contact has been as it is, by the link's own account; now where it gives none."""
    since = now
    for event in reversed(link.events):
        if event.contact is not link.contact:
            break
        since = event.at
    return since


def documents(alarms: Iterable[Alarm]) -> list[dict[str, Any]]:
    """Alarms as JSON values."""
    return [alarm.document() for alarm in alarms]
