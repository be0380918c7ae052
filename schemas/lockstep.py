"""The messages between the time manager and the processes when mission time is virtual and exact."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from schemas.wire import Identifier, MissionTimeNs, Text, Wire

Count = Annotated[int, Field(ge=0)]

ProcessId = Identifier
"""Identifies one start of a service: its successor does not wait for what was sent to it."""


class Join(Wire):
    """A process asks to take part, or whether it still does, and says what it receives and serves."""

    term: Text
    """The term whose grants it obeys: a time manager's, until that one gives the process up. Empty at first."""
    name: Identifier
    process: ProcessId
    hears: tuple[tuple[Text, Text], ...]
    """(topic, side) of every message that reaches it."""
    serves: tuple[tuple[Text, Text], ...]
    """(topic, side) of the queries that it serves."""
    next_wake: MissionTimeNs | None
    """When it wants to act first; None: when an input reaches it."""
    now: MissionTimeNs = 0
    """Its time, from its journal or from a time manager that is gone; time does not go on from earlier."""
    step: Count = 0
    """The last step that it was granted; later steps have higher numbers."""


class Joined(Wire):
    """The time manager's answer to a process that asks to take part."""

    term: Text
    admitted: bool
    """Whether it takes part now. If not, it has to obey this term from now on, and ask again."""
    now: MissionTimeNs
    step: Count
    starts: Count
    """How many processes of that name have taken part."""


class Grant(Wire):
    """It is `at`: the process acts as soon as it has received all that was sent to it in the step before."""

    term: Text
    step: Annotated[int, Field(ge=1)]
    at: MissionTimeNs
    process: ProcessId
    """The process that acts; an earlier process of the same name must not."""
    expects: dict[str, Count]
    """How many messages, queries and replies, by sender; under its own name its queries that no process serves."""


class StepDone(Wire):
    """A process has acted in a step."""

    name: Identifier
    process: ProcessId
    step: Count
    next_wake: MissionTimeNs | None
    published: tuple[tuple[Text, Text, Count], ...] = ()
    """(topic, side, how many)."""
    asked: tuple[tuple[Text, Text], ...] = ()
    """(topic, side) of each query that it sent."""
    answered: tuple[tuple[ProcessId, Count], ...] = ()
    """Sender and step of each query that it replied to."""
    finished: Text | None = None
    """Why the process has nothing left to do; None while it has."""


class StepBusy(Wire):
    """Why a process cannot act yet."""

    name: Identifier
    process: ProcessId
    step: Count
    computing: tuple[Text, ...] = ()
    """Computations that are due and have not ended."""
    lacks: Annotated[dict[str, Count], Field(default_factory=dict)]
    """How many inputs have not arrived, by sender."""


class Poke(Wire):
    """A process has an input from outside the mission, from an operator for example: it asks for a step now."""

    name: Identifier
    process: ProcessId


class TimeControl(Wire):
    """A change of how virtual time advances; what it does not name stays."""

    paused: bool | None = None
    steps: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """Go on to this many further instants at which something happens, then pause."""
    until: MissionTimeNs | None = None
    """Go on until this mission time, then pause."""
    rate: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """No faster than this many mission seconds per wall second."""
    unlimited: bool = False
    """As fast as the machine allows."""


class TimeStatus(Wire):
    """Where virtual time stands, and what it waits for."""

    now: MissionTimeNs
    start_ns: MissionTimeNs
    step: Count
    next_at: MissionTimeNs | None
    """The next instant at which something happens; None while that is not known, or if there is none."""
    paused: bool
    rate: float | None
    until: MissionTimeNs | None
    steps_left: Count | None
    members: tuple[Text, ...]
    waits_for: tuple[Text, ...]
    """The required processes that are missing, or else those that have not finished the present step."""
    finished: dict[str, str]
    computing_s: Annotated[float, Field(ge=0)]
    """Wall time [s] for which time has stood while a process computed."""
    detail: Text = ""
    """What is wrong, in one line; empty while nothing is."""
