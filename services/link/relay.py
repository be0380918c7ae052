"""The relay: both directions of the link, the contact that they share, and the status that operators see."""

from __future__ import annotations

from collections import deque
from random import Random
from typing import TYPE_CHECKING, Final

from pydantic import ValidationError

from he3.errors import InvalidInput
from schemas.link import (
    MAX_LINK_EVENTS,
    AtEdge,
    Direction,
    DirectionConditions,
    Dropped,
    InFlight,
    LinkChange,
    LinkConditions,
    LinkEvent,
    LinkStatus,
)
from schemas.topics import COMMAND, Topic
from schemas.validation import one_line
from services.link.channel import Channel, Drop, Flight, Limits
from services.link.contact import Contact
from services.link.packet import Packet, packet_of

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime

SHOWN_IN_FLIGHT = 200
SHOWN_DROPPED = 50
SHOWN_COMMANDS = 10


class Relay:
    """Accepts packets on one side and releases them on the other when they arrive."""

    def __init__(self, conditions: LinkConditions, start: MissionTime, seed: int, limits: Limits | None = None) -> None:
        self._conditions = conditions
        self._start = start
        self._seed = seed
        self._forced: bool | None = None
        self._events: deque[LinkEvent] = deque(maxlen=MAX_LINK_EVENTS)
        self._contact = Contact.of(conditions, start)
        self._order = 0
        self._dropped: deque[Dropped] = deque(maxlen=SHOWN_DROPPED)
        self._commands_arrived: deque[InFlight] = deque(maxlen=SHOWN_COMMANDS)
        self._channels = {
            direction: Channel(
                _of(conditions, direction), self._contact, self._generator(direction, 0), conditions.at_edge, limits
            )
            for direction in Direction
        }

    def resume(self, conditions: LinkConditions, contact_forced: bool | None) -> None:
        """Take these conditions, which an earlier start of the link had in the end. No packet is in flight yet."""
        self._conditions, self._forced = conditions, contact_forced
        self._apply(self._start)

    def restarted(self, incarnation: int) -> None:
        """Reseeds the draws, so that a restarted link does not repeat the losses of its previous start."""
        for direction, channel in self._channels.items():
            channel.reseed(self._generator(direction, incarnation))

    def offer(self, topic: Topic, payload: bytes, now: MissionTime) -> None:
        """Accepts a packet; raises InvalidInput if the topic does not cross the link."""
        direction = topic.direction
        if direction is None:
            raise InvalidInput(f"expected a topic that crosses the link, got {topic.name}")
        self._order += 1
        self._channels[direction].offer(packet_of(topic, payload, now, self._order), now)

    def arrived(self, now: MissionTime) -> list[tuple[Direction, Flight]]:
        """Removes and returns the packets that have arrived on either side, by time of arrival, then of offering."""
        arrived = []
        for direction, channel in self._channels.items():
            if flights := channel.arrived(now):
                arrived += [(direction, flight) for flight in flights]
        if not arrived:
            return arrived
        arrived.sort(key=lambda pair: (pair[1].arrives_at, pair[1].packet.order))
        self._commands_arrived.extend(
            _shown_flight(direction, flight) for direction, flight in arrived if flight.packet.topic is COMMAND
        )
        return arrived

    def next_event(self) -> MissionTime | None:
        """When a packet arrives or may begin to be sent next."""
        earliest = None
        for channel in self._channels.values():
            time = channel.next_event()
            if time is not None and (earliest is None or time < earliest):
                earliest = time
        return earliest

    def drops(self) -> list[tuple[Direction, Drop]]:
        """Removes and returns the drops since the last call."""
        drops = []
        for direction, channel in self._channels.items():
            if dropped := channel.drops():
                drops += [(direction, drop) for drop in dropped]
        self._dropped.extend(_shown_dropped(direction, drop) for direction, drop in drops)
        return drops

    def change(self, change: LinkChange, now: MissionTime) -> None:
        """Applies the change; raises InvalidInput, and changes nothing, if the result is invalid."""
        conditions = apply_change(self._conditions, change)
        if change.contact is not None or change.contact_as_scheduled:
            self._forced = change.contact
        elif change.conditions is not None:
            self._forced = None
        self._conditions = conditions
        self._apply(now)

    def _apply(self, now: MissionTime) -> None:
        conditions = self._conditions
        self._contact = Contact.of(conditions, self._start, self._forced)
        for direction, channel in self._channels.items():
            channel.change(_of(conditions, direction), self._contact, conditions.at_edge, now)

    def note(self, now: MissionTime, change: LinkChange | None = None) -> None:
        """Keep for the status what a person has changed, or that contact began or ended by the schedule."""
        contact = self.in_contact(now)
        if change is None:
            if not self._events or self._events[-1].contact is not contact:
                self._events.append(LinkEvent(at=now, contact=contact))
            return
        self._events.append(LinkEvent(at=now, contact=contact, what=described(change), by=change.by or ""))

    def in_contact(self, now: MissionTime) -> bool:
        """Whether there is contact."""
        return self._contact.open_at(now)

    def contact_changes_at(self, now: MissionTime) -> MissionTime | None:
        """When contact begins or ends next."""
        return self._contact.changes_at(now)

    @property
    def conditions(self) -> LinkConditions:
        """The conditions now."""
        return self._conditions

    @property
    def contact_forced(self) -> bool | None:
        """Contact as set by an operator; None: as scheduled."""
        return self._forced

    @property
    def busy(self) -> bool:
        """Whether a packet waits or is in flight."""
        return not all(channel.idle for channel in self._channels.values())

    @property
    def in_flight(self) -> int:
        """Packets in flight, in both directions together."""
        return sum(channel.in_flight for channel in self._channels.values())

    def status(self, now: MissionTime, incarnation: int) -> LinkStatus:
        """The link's status now."""
        shown = [
            entry
            for direction, channel in self._channels.items()
            for entry in (
                *(_shown_flight(direction, flight) for flight in channel.flights()[:SHOWN_IN_FLIGHT]),
                *(_shown_waiting(direction, packet) for packet in channel.waiting()[:SHOWN_IN_FLIGHT]),
            )
        ]
        shown.sort(key=lambda entry: (entry.arrives_at is None, entry.arrives_at or entry.offered_at))
        return LinkStatus(
            conditions=self._conditions,
            contact=self.in_contact(now),
            contact_changes_at=self.contact_changes_at(now),
            up=self._channels[Direction.UP].counts,
            down=self._channels[Direction.DOWN].counts,
            in_flight=tuple(shown[:SHOWN_IN_FLIGHT]),
            dropped=tuple(self._dropped),
            commands_arrived=tuple(self._commands_arrived),
            contact_forced=self._forced,
            events=tuple(self._events),
            incarnation=incarnation,
        )

    def _generator(self, direction: Direction, incarnation: int) -> Random:
        return Random(f"link/{self._seed}/{direction.value}/{incarnation}")  # a text seeds the same on every machine


NAMES: Final = {
    "one_way_light_time_s": "light time {:g} s",
    "jitter_s": "jitter {:g} s",
    "rate_bit_s": "data rate {:,.15g} bit/s",
    "loss": "loss {:g}",
    "duplicate": "duplicate {:g}",
    "reorder": "reorder {:g}",
    "corrupt": "corrupt {:g}",
}
"""Words for the figures of a change."""
_CONTACT: Final = {True: "contact on", False: "contact off (black-out)"}


def described(change: LinkChange) -> str:
    """The change in words, such as ``up: loss 0.1, contact off``."""
    parts = [] if change.conditions is None else [f"all conditions replaced ({in_words(change.conditions)})"]
    parts += [text.format(value) for name, text in NAMES.items() if (value := getattr(change, name)) is not None]
    if change.unlimited_rate:
        parts.append("data rate unlimited")
    if change.contact is not None:
        parts.append(_CONTACT[change.contact])
    if change.contact_as_scheduled:
        parts.append("contact as scheduled")
    if change.at_edge is not None:
        parts.append(f"messages without contact: {change.at_edge.value}")
    way = "" if change.direction is None else f"{change.direction.value}: "
    return way + (", ".join(parts) or "nothing changed")


def in_words(conditions: LinkConditions, contact_forced: bool | None = None) -> str:
    """The conditions in words: the light time, and what is not as on a perfect link with contact always.

    contact_forced: contact as set by an operator; None: as scheduled.
    """
    up, down = (", ".join(_figures(each)) for each in (conditions.up, conditions.down))
    words = [up] if up == down else [f"up: {up}", f"down: {down}"]
    if conditions.windows:
        words.append(f"contact in {len(conditions.windows)} windows")
    if (cycle := conditions.duty_cycle) is not None:
        words.append(f"contact {cycle.contact_s:,.15g} s of every {cycle.period_s:,.15g} s")
    if conditions.at_edge is not AtEdge.HOLD:
        words.append(f"messages without contact: {conditions.at_edge.value}")
    if contact_forced is not None:
        words.append(_CONTACT[contact_forced])
    return "; ".join(words)


def _figures(conditions: DirectionConditions) -> list[str]:
    always = "one_way_light_time_s"
    return [
        text.format(value)
        for name, text in NAMES.items()
        if (value := getattr(conditions, name)) is not None and (value or name == always)
    ]


def apply_change(conditions: LinkConditions, change: LinkChange) -> LinkConditions:
    """The conditions with the change applied; raises InvalidInput if the result is invalid."""
    conditions = change.conditions or conditions
    values = {
        name: value
        for name in ("one_way_light_time_s", "jitter_s", "rate_bit_s", "loss", "duplicate", "reorder", "corrupt")
        if (value := getattr(change, name)) is not None
    }
    if change.unlimited_rate:
        values["rate_bit_s"] = None
    directions = tuple(Direction) if change.direction is None else (change.direction,)
    changed_directions = {each.value: _of(conditions, each).model_copy(update=values) for each in directions}
    at_edge: AtEdge = change.at_edge or conditions.at_edge
    try:
        whole = conditions.model_copy(update={**changed_directions, "at_edge": at_edge}).model_dump()
        return LinkConditions.model_validate(whole)
    except ValidationError as error:
        raise InvalidInput(one_line(error)) from None


def _of(conditions: LinkConditions, direction: Direction) -> DirectionConditions:
    return conditions.up if direction is Direction.UP else conditions.down


def _shown_flight(direction: Direction, flight: Flight) -> InFlight:
    packet = flight.packet
    return InFlight(
        topic=packet.topic.name,
        source=packet.source,
        sequence=packet.sequence,
        direction=direction,
        size_bytes=len(packet.payload),
        offered_at=packet.offered_at,
        departs_at=flight.departs_at,
        arrives_at=flight.arrives_at,
    )


def _shown_waiting(direction: Direction, packet: Packet) -> InFlight:
    return InFlight(
        topic=packet.topic.name,
        source=packet.source,
        sequence=packet.sequence,
        direction=direction,
        size_bytes=len(packet.payload),
        offered_at=packet.offered_at,
        departs_at=None,
        arrives_at=None,
    )


def _shown_dropped(direction: Direction, drop: Drop) -> Dropped:
    return Dropped(
        topic=drop.packet.topic.name,
        source=drop.packet.source,
        sequence=drop.packet.sequence,
        direction=direction,
        why=drop.reason.value,
        at=drop.at,
    )
