"""What the time keeper and the processes say to each other when mission time is virtual and exact."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from schemas.wire import Identifier, MissionTimeNs, Text, Wire

Count = Annotated[int, Field(ge=0)]

ProcessId = Identifier
"""Tells one start of a service from every other: what a process that is gone was owed, its successor does not wait
for."""


class Join(Wire):
    """A process takes part, or asks whether it still does: what it hears and serves, so that every message counts."""

    term: Text
    """Which grants it obeys: one time keeper's, until that one gives it up. Empty at first."""
    name: Identifier
    process: ProcessId
    hears: tuple[tuple[Text, Text], ...]
    """(topic, side) of every message that reaches it."""
    serves: tuple[tuple[Text, Text], ...]
    """(topic, side) of the questions that it answers."""
    next_wake: MissionTimeNs | None
    """When it wants to act first; None: when something reaches it."""
    now: MissionTimeNs = 0
    """Where it stands, from its journal or from a time keeper that is gone; time goes on from no earlier."""
    step: Count = 0
    """The last step that it has heard of; steps are numbered on from there, so that no two are confused."""


class Joined(Wire):
    """What the time keeper says to a process that wants to take part."""

    term: Text
    admitted: bool
    """Whether it takes part now; else it is to obey the grants of this term first, and none before, and ask again."""
    now: MissionTimeNs
    step: Count
    starts: Count
    """How many processes of that name have taken part."""


class Grant(Wire):
    """It is `at`: the one whom this is for acts once all that was sent to it in the step before has reached it."""

    term: Text
    step: Annotated[int, Field(ge=1)]
    at: MissionTimeNs
    process: ProcessId
    """Who acts; an earlier process of the same name must not."""
    expects: dict[str, Count]
    """How many messages, questions and answers, by sender; one's own name for questions that nobody answers."""


class StepDone(Wire):
    """A process has acted in a step."""

    name: Identifier
    process: ProcessId
    step: Count
    next_wake: MissionTimeNs | None
    published: tuple[tuple[Text, Text, Count], ...] = ()
    """(topic, side, how many)."""
    asked: tuple[tuple[Text, Text], ...] = ()
    """(topic, side) of each question put."""
    answered: tuple[tuple[ProcessId, Count], ...] = ()
    """Who asked, and in which step, for each question answered."""
    finished: Text | None = None
    """Why the process has nothing left to do, once it says so."""


class StepBusy(Wire):
    """A process cannot act yet, and why."""

    name: Identifier
    process: ProcessId
    step: Count
    computing: tuple[Text, ...] = ()
    """Computations whose end has come and that are still at work."""
    lacks: Annotated[dict[str, Count], Field(default_factory=dict)]
    """How many inputs have not come, by sender."""


class Poke(Wire):
    """Somebody from outside, an operator say, has put something to a process: let it act now."""

    name: Identifier
    process: ProcessId


class TimeControl(Wire):
    """How virtual time goes on; what is not named stays."""

    paused: bool | None = None
    steps: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """Go on to this many further instants at which something happens, then pause."""
    until: MissionTimeNs | None = None
    """Go on until this mission time, then pause."""
    rate: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """No faster than this many mission seconds a wall second."""
    unlimited: bool = False
    """As fast as the machine allows again."""


class TimeStatus(Wire):
    """Where virtual time stands, and who or what it waits for."""

    now: MissionTimeNs
    start_ns: MissionTimeNs
    step: Count
    next_at: MissionTimeNs | None
    """The next instant at which something happens; None while that is not known, or when nothing ever will."""
    paused: bool
    rate: float | None
    until: MissionTimeNs | None
    steps_left: Count | None
    members: tuple[Text, ...]
    waits_for: tuple[Text, ...]
    """Who is missing, or else who has not finished the present step."""
    finished: dict[str, str]
    computing_s: Annotated[float, Field(ge=0)]
    """Wall time [s] for which time has stood because somebody was computing."""
    detail: Text = ""
    """What is wrong, in one line; empty while nothing is."""
