"""The messages between the time manager and the processes when mission time is virtual and exact."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from schemas.wire import MAX_COUNT, Count, Identifier, MissionTimeNs, Text, Wire

ProcessId = Identifier
"""Identifies one start of a service; a later start does not wait for messages to an earlier one."""


class Join(Wire):
    """A process asks to take part, or whether it still does; it names the topics that it receives and serves."""

    term: Text
    """The term whose grants the process obeys, until the time manager gives the process up. Empty at first."""
    name: Identifier
    process: ProcessId
    hears: tuple[tuple[Text, Text], ...]
    """(topic, side) of every message that reaches it."""
    serves: tuple[tuple[Text, Text], ...]
    """(topic, side) of the queries that it serves."""
    next_wake: MissionTimeNs | None
    """When it wants to act first; None: when an input reaches it."""
    now: MissionTimeNs = 0
    """The process's time, from its journal or an ended time manager; mission time does not continue from earlier."""
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
    """How many processes of that name have taken part so far."""


class Grant(Wire):
    """A step at mission time `at`: the process acts once it has received all inputs sent to it in the step before."""

    term: Text
    step: Annotated[int, Field(ge=1, lt=MAX_COUNT)]
    at: MissionTimeNs
    process: ProcessId
    """The process that acts; an earlier process of the same name must not."""
    expects: dict[str, Count]
    """Number of inputs by sender; under the process's own name, its queries that no process serves."""


class StepDone(Wire):
    """A process has acted in a step."""

    name: Identifier
    process: ProcessId
    step: Count
    next_wake: MissionTimeNs | None
    published: tuple[tuple[Text, Text, Count], ...] = ()
    """(topic, side, count) of the messages that it sent."""
    asked: tuple[tuple[Text, Text], ...] = ()
    """(topic, side) of each query that it sent."""
    answered: tuple[tuple[ProcessId, Count], ...] = ()
    """Sender and step of each query that it replied to."""
    finished: Text | None = None
    """Why the process has finished; None if it has not."""


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
    """A process asks for a step now, because an input from outside the mission, such as a query, waits for it."""

    name: Identifier
    process: ProcessId


class TimeControl(Wire):
    """A change of the pace of virtual time; fields that are None change nothing."""

    paused: bool | None = None
    steps: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """Run for this many further instants at which something happens, then pause."""
    until: MissionTimeNs | None = None
    """Run until this mission time, then pause."""
    rate: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """No faster than this many mission seconds per wall second."""
    unlimited: bool = False
    """Run as fast as the machine allows."""


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
    """One line on what is wrong; empty if nothing is."""
