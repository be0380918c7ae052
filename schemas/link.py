"""Conditions of the link between Earth and Moon, its traffic, and mission time."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field, model_validator

from schemas.wire import Count, Identifier, MissionTimeNs, PersonName, Text, Wire, is_none

Fraction = Annotated[float, Field(ge=0, le=1)]
Seconds = Annotated[float, Field(ge=0, le=86_400)]


MAX_SCHEDULE_S = 1e9
"""Longest time for which contacts can be scheduled: 31 years, which keeps times within int64 nanoseconds."""
MIN_PERIOD_S = 1.0
"""Shortest period of a duty cycle: in a shorter one, contact would change within one message."""


class Direction(StrEnum):
    UP = "up"
    """Earth to Moon: telecommands."""
    DOWN = "down"
    """Moon to Earth: telemetry."""


class DirectionConditions(Wire):
    """Conditions of one direction of the link."""

    one_way_light_time_s: Seconds = 1.282
    jitter_s: Seconds = 0.0
    """Half width of a uniform addition to the light time; order is kept unless `reorder` is set."""
    rate_bit_s: Annotated[float, Field(ge=1, le=1e12)] | None = None
    """Data rate; None: transmission takes no time."""
    loss: Fraction = 0.0
    duplicate: Fraction = 0.0
    reorder: Fraction = 0.0
    """Share of the messages that are delayed by up to one further light time."""
    corrupt: Fraction = 0.0


class AtEdge(StrEnum):
    HOLD = "hold"
    """A message offered out of contact waits for the next contact."""
    DROP = "drop"
    """A message offered out of contact is lost."""


class Window(Wire):
    """Contact from `opens_s` until `closes_s`, in seconds of mission since its start."""

    opens_s: Annotated[float, Field(ge=0, le=MAX_SCHEDULE_S)]
    closes_s: Annotated[float, Field(gt=0, le=MAX_SCHEDULE_S)]

    @model_validator(mode="after")
    def _closes_after_it_opens(self) -> Window:
        if self.closes_s <= self.opens_s:
            raise ValueError(f"expected closes_s after opens_s, got {self.opens_s} and {self.closes_s}")
        return self


class DutyCycle(Wire):
    """Contact during the first `contact_s` of every `period_s`, shifted by `offset_s`."""

    period_s: Annotated[float, Field(ge=MIN_PERIOD_S, le=MAX_SCHEDULE_S)]
    contact_s: Annotated[float, Field(ge=0.001, le=MAX_SCHEDULE_S)]
    offset_s: Annotated[float, Field(ge=0, le=MAX_SCHEDULE_S)] = 0.0

    @model_validator(mode="after")
    def _contact_fits_into_the_period(self) -> DutyCycle:
        if self.contact_s > self.period_s:
            raise ValueError(f"expected contact_s within period_s, got {self.contact_s} of {self.period_s}")
        return self


class LinkConditions(Wire):
    """Conditions of the whole link. Without windows and duty cycle there is always contact."""

    up: DirectionConditions = DirectionConditions()
    down: DirectionConditions = DirectionConditions()
    windows: Annotated[tuple[Window, ...], Field(max_length=1000)] = ()
    duty_cycle: DutyCycle | None = None
    at_edge: AtEdge = AtEdge.HOLD

    @model_validator(mode="after")
    def _one_kind_of_contact(self) -> LinkConditions:
        if self.windows and self.duty_cycle is not None:
            raise ValueError("expected windows or a duty_cycle, got both")
        for earlier, later in zip(self.windows, self.windows[1:], strict=False):
            if later.opens_s < earlier.closes_s:
                raise ValueError("expected windows in order that do not overlap")
        return self


class LinkChange(Wire):
    """New values for the fields that are set; the others stay. They hold for messages sent from now on."""

    conditions: LinkConditions | None = None
    """Conditions that replace all present ones, before the other fields are applied."""
    direction: Direction | None = None
    """The direction that the figures apply to; None: both."""
    one_way_light_time_s: Seconds | None = None
    jitter_s: Seconds | None = None
    rate_bit_s: Annotated[float, Field(ge=1, le=1e12)] | None = None
    unlimited_rate: bool = False
    loss: Fraction | None = None
    duplicate: Fraction | None = None
    reorder: Fraction | None = None
    corrupt: Fraction | None = None
    contact: bool | None = None
    """False: black-out from now on; True: contact from now on, against the schedule; None: no change."""
    contact_as_scheduled: bool = False
    """Return to windows or duty cycle after `contact` overrode them."""
    at_edge: AtEdge | None = None
    by: PersonName | None = Field(default=None, exclude_if=is_none)
    """Who changes it; in a mission with keys, the signer of the request."""

    @model_validator(mode="after")
    def _says_one_thing(self) -> LinkChange:
        if self.contact is not None and self.contact_as_scheduled:
            raise ValueError("expected contact or contact_as_scheduled, got both")
        if self.rate_bit_s is not None and self.unlimited_rate:
            raise ValueError("expected rate_bit_s or unlimited_rate, got both")
        return self


class LinkEvent(Wire):
    """A change of the link's conditions by a person, or a begin or an end of contact."""

    at: MissionTimeNs
    contact: bool
    """Whether there was contact from then on."""
    what: Text = ""
    """What a person changed, in words; empty where contact began or ended by the schedule."""
    by: Text = ""


MAX_LINK_EVENTS = 24
"""Newest events that the link's status shows."""


class InFlight(Wire):
    """A message on the link, or waiting to depart."""

    topic: Text
    source: Text
    sequence: Count
    direction: Direction
    size_bytes: Count
    offered_at: MissionTimeNs
    departs_at: MissionTimeNs | None
    """When its first bit departs; None while it waits for contact."""
    arrives_at: MissionTimeNs | None
    """When its last bit arrives; None while it waits for contact."""


class Dropped(Wire):
    """A message that will not arrive, with the reason."""

    topic: Text
    source: Text
    sequence: Count
    direction: Direction
    why: Text
    at: MissionTimeNs


class DirectionCounts(Wire):
    """Counts of one direction's messages since the start.

    offered + duplicated = delivered + lost + dropped + superseded + waiting + in flight.
    """

    offered: Count = 0
    repeated: Count = 0
    """Offered messages that are repetitions under custody."""
    delivered: Count = 0
    lost: Count = 0
    dropped_out_of_contact: Count = 0
    dropped_queue_full: Count = 0
    superseded: Count = 0
    """Replaced by a newer message while they waited to depart."""
    duplicated: Count = 0
    corrupted: Count = 0
    waiting: Count = 0
    in_flight: Count = 0
    bytes_delivered: Count = 0


class LinkStatus(Wire):
    """The present state of the link."""

    conditions: LinkConditions
    contact: bool
    contact_changes_at: MissionTimeNs | None
    up: DirectionCounts
    down: DirectionCounts
    in_flight: Annotated[tuple[InFlight, ...], Field(max_length=200)]
    """The next 200 to arrive."""
    dropped: Annotated[tuple[Dropped, ...], Field(max_length=50)] = ()
    """The last 50 that will not arrive."""
    commands_arrived: Annotated[tuple[InFlight, ...], Field(max_length=10)] = ()
    """The last 10 telecommands that arrived, so that an infrequent reader misses none."""
    contact_forced: bool | None = None
    """Contact as set by an operator; None: as scheduled."""
    events: Annotated[tuple[LinkEvent, ...], Field(max_length=MAX_LINK_EVENTS)] = ()
    """The newest changes, oldest first; the first one is the state in which this start of the link began."""
    incarnation: Count


class ClockMode(StrEnum):
    WALL = "wall"
    """Mission time is the wall clock times a rate."""
    LOCKSTEP = "lockstep"
    """Mission time jumps from event to event."""


LATEST_CLOCK_NS = 8_204_803_200 * 10**9
"""2230-01-01: after the latest start of a scenario, and what is scheduled `MAX_SCHEDULE_S` later fits into int64."""

ClockTimeNs = Annotated[int, Field(ge=0, lt=LATEST_CLOCK_NS)]
"""A time that a clock shows [ns]."""


class ClockState(Wire):
    """Mission time as an anchor and a rate: at wall time `anchor_wall_ns` it was `anchor_mission_ns`."""

    mode: ClockMode = ClockMode.WALL
    epoch: Count = 0
    """Identifies the clock: a mission that is started anew has another one. 0 in lockstep."""
    revision: Count = 0
    """Counts the changes of the clock: of two states of one epoch, that of the higher revision is newer."""
    rate: Annotated[float, Field(ge=0, le=1e6)]
    """Mission seconds per wall second; 0 while the mission is paused."""
    anchor_wall_ns: ClockTimeNs
    anchor_mission_ns: ClockTimeNs
    start_ns: ClockTimeNs
    """Mission time at which the mission began."""
    boot_id: Text = ""
    """The boot of the machine that set the anchor; empty if it is not known."""
    anchor_monotonic_ns: ClockTimeNs = 0
    """That machine's monotonic clock at the anchor: what other processes of the same boot count from."""


MAX_GAPS = 64
"""Runs of missing messages that one acknowledgement may list."""


class Acknowledgement(Wire):
    """The messages that a receiver under custody has received: all below `next_sequence` except the gaps."""

    stream: Text
    """Topic name of the messages acknowledged."""
    source: Identifier
    incarnation: Count
    next_sequence: Count
    """One more than the highest sequence received."""
    gaps: Annotated[tuple[tuple[Count, Count], ...], Field(max_length=MAX_GAPS)] = ()
    """First and last sequence of each missing run below `next_sequence`."""
    last_sequence: Count | None = None
    """The sequence of the message received last."""
    last_repetition: Count = 0
    """Repetition of that message, as in its header."""
    last_received_at: MissionTimeNs | None = None
    """Mission time at which that message was received."""

    @model_validator(mode="after")
    def _gaps_lie_below_in_order(self) -> Acknowledgement:
        end = -1
        for first, last in self.gaps:
            if not end < first <= last < self.next_sequence:
                raise ValueError(f"expected gaps in order below {self.next_sequence}, got {first} to {last}")
            end = last
        return self


class ClockChange(Wire):
    """A change of the rate of mission time; 0 stops it."""

    rate: Annotated[float, Field(ge=0, le=100_000)]
