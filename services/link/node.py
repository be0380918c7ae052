"""The link's node: the only path between Moon and Earth.

It forwards raw payloads when they arrive, reports the link's status, and lets operators change the conditions.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from he3.errors import InvalidInput
from schemas.link import Direction, LinkChange
from schemas.topics import LINK_SET, LINK_SHOW, LINK_STATUS, Side, crossing
from schemas.wire import values_set
from services.link.counts import DropReason
from services.link.kept_conditions import KeptConditions
from services.link.relay import Relay, in_words
from services.mission.mission_time import SECOND, MissionTime
from services.runtime.node import (
    Cause,
    Effect,
    Event,
    Forward,
    Interface,
    Keep,
    Level,
    LogRecord,
    QueryReceived,
    ReceivedRaw,
    RefuseQuery,
    SendIfHeard,
    SendReply,
    SetTimer,
    Started,
    TimerFired,
)

if TYPE_CHECKING:
    from services.link.channel import Drop
    from services.mission.scenario import Scenario

STATUS_INTERVAL_MIN: MissionTime = 1 * SECOND
"""Shortest interval between two reports while packets are offered [ns]."""
STATUS_INTERVAL_BUSY: MissionTime = 10 * SECOND
"""Interval between two reports while packets wait or are in flight [ns]."""
STATUS_INTERVAL_IDLE: MissionTime = 60 * SECOND
"""Interval between two reports while the link is idle [ns]."""

_TIMERS = "traffic", "contact", "status"
_ARRIVES_ON = {Direction.UP: Side.MOON, Direction.DOWN: Side.EARTH}


class LinkNode:
    """Carries packets between the sides, and reports its status to operators."""

    def __init__(self, relay: Relay, reports: bool = True, kept: KeptConditions | None = None) -> None:
        """reports: whether it reports its status. kept: what is kept of the relay's conditions; None: nothing is."""
        self._relay = relay
        self._kept = kept
        self._reports = reports
        self._interface = Interface(
            name="link",
            sides=(Side.MOON, Side.EARTH),
            receives_raw=(*crossing(Direction.UP), *crossing(Direction.DOWN)),
            serves=(LINK_SET, LINK_SHOW),
            custody=False,
        )
        self._incarnation = 0
        self._reported_at: MissionTime | None = None
        self._report_due: MissionTime | None = None
        self._timers: dict[str, MissionTime | None] = {}
        self._in_contact: bool | None = None

    @property
    def interface(self) -> Interface:
        return self._interface

    @property
    def in_flight(self) -> int:
        """Packets in flight, in both directions together."""
        return self._relay.in_flight

    def handle(self, event: Event, now: MissionTime) -> Iterator[Effect]:
        """Effects of the event, in order."""
        match event:
            case Started(incarnation=incarnation):
                self._incarnation = incarnation
                self._timers.clear()
                self._in_contact = self._relay.in_contact(now)
                self._relay.restarted(incarnation)
                self._relay.note(now)
                yield LogRecord(Level.INFO, "link up", {"incarnation": incarnation, "contact": self._in_contact})
                if self._kept is not None and self._kept.changed:
                    words = in_words(self._relay.conditions, self._relay.contact_forced)
                    yield LogRecord(Level.INFO, f"the conditions are those that were set before this start: {words}")
                self._report_due = now
            case ReceivedRaw(topic=topic, payload=payload):
                if topic.direction is not None:
                    self._relay.offer(topic, payload, now)
                    self._report_soon(now)
            case QueryReceived(topic=topic, request=LinkChange() as change, token=token):
                yield from self._change(change, token, now)
            case QueryReceived(topic=topic, token=token) if topic == LINK_SHOW:
                yield SendReply(token, self._relay.status(now, self._incarnation))
            case QueryReceived(topic=topic, token=token):
                yield RefuseQuery(token, f"expected a query on {LINK_SET.name} or {LINK_SHOW.name}, got {topic.name}")
            case TimerFired(timer=timer):
                self._timers.pop(timer, None)
        yield from self._advance(now)

    def _change(self, change: LinkChange, token: int, now: MissionTime) -> Iterator[Effect]:
        try:
            self._relay.change(change, now)
        except InvalidInput as error:
            yield RefuseQuery(token, str(error))
            return
        changes = values_set(change)
        if changes.keys() - {"by"}:
            self._relay.note(now, change)
            yield from self._keep()
            yield LogRecord(Level.INFO, "link changed", changes)
            self._report_due = now
        yield SendReply(token, self._relay.status(now, self._incarnation))

    def _keep(self) -> Iterator[Effect]:
        """Keep the conditions for the next start, before a reply promises them."""
        if self._kept is not None:
            relay = self._relay
            now = {"conditions": relay.conditions, "contact_forced": relay.contact_forced}
            self._kept = self._kept.model_copy(update=now)
            yield Keep(self._kept)

    def _advance(self, now: MissionTime) -> Iterator[Effect]:
        """Arrivals, drops, changes of contact, reports and timers that are due after any event."""
        for direction, flight in self._relay.arrived(now):
            yield Forward(flight.packet.topic, flight.payload, _ARRIVES_ON[direction])
        for direction, drop in self._relay.drops():
            yield from _dropped(direction, drop)
        contact = self._relay.in_contact(now)
        if contact is not self._in_contact:
            self._in_contact = contact
            self._relay.note(now)
            self._report_due = now
            yield LogRecord(Level.INFO, "contact regained" if contact else "contact lost", self._until(now))
        if self._reports and self._report_due is not None and self._report_due <= now:
            yield SendIfHeard(LINK_STATUS, lambda: self._relay.status(now, self._incarnation))
            self._reported_at = now
            self._report_due = now + (STATUS_INTERVAL_BUSY if self._relay.busy else STATUS_INTERVAL_IDLE)
        due = (self._relay.next_event(), self._relay.contact_changes_at(now), self._report_due)
        for timer, at in zip(_TIMERS if self._reports else _TIMERS[:-1], due, strict=False):
            if self._timers.get(timer) != at:
                self._timers[timer] = at
                yield SetTimer(timer, at)

    def _report_soon(self, now: MissionTime) -> None:
        soon = now if self._reported_at is None else max(now, self._reported_at + STATUS_INTERVAL_MIN)
        self._report_due = soon if self._report_due is None else min(soon, self._report_due)

    def _until(self, now: MissionTime) -> dict[str, MissionTime]:
        changes_at = self._relay.contact_changes_at(now)
        return {} if changes_at is None else {"until": changes_at}


def _dropped(direction: Direction, drop: Drop) -> Iterator[Effect]:
    """The log record of a drop; a packet that a newer one replaced is not a loss."""
    if drop.reason is DropReason.SUPERSEDED:
        return
    packet = drop.packet
    lost = drop.reason is DropReason.LOST
    cause = None if lost else Cause(f"{packet.topic.name}: {drop.reason.value}", packet.source)
    fields = {
        "why": drop.reason.value,
        "direction": direction.value,
        "topic": packet.topic.name,
        "source": packet.source,
        "sequence": packet.sequence,
        "at": drop.at,
    }
    yield LogRecord(Level.DEBUG if lost else Level.WARNING, "packet dropped", fields, cause)


def build_node(scenario: Scenario, *, reports: bool = True, kept: KeptConditions | None = None) -> LinkNode:
    """The link of that scenario, with no packet in flight.

    reports: whether it reports its status. kept: the conditions that an earlier start had in the end; None: the
    scenario's.
    """
    relay = Relay(scenario.link, scenario.start_ns, scenario.seed)
    if kept is None:
        kept = KeptConditions(mission=scenario.name, of_scenario=scenario.link, conditions=scenario.link)
    else:
        relay.resume(kept.conditions, kept.contact_forced)
    return LinkNode(relay, reports, kept)
