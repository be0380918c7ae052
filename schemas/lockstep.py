"""What the time keeper and the processes say to each other when mission time is virtual and exact."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from schemas.wire import Identifier, MissionTimeNs, Text, Wire

Count = Annotated[int, Field(ge=0)]


class Join(Wire):
    """A process takes part: what it hears and serves, so that every message can be accounted for."""

    name: Identifier
    process: Text
    """Tells one start of it from another, so that a join asked twice is taken once."""
    hears: tuple[tuple[Text, Text], ...]
    """(topic, side) of every message that reaches it."""
    serves: tuple[Text, ...]
    """Topics of the questions that it answers."""
    next_wake: MissionTimeNs | None
    """When it wants to act first; None: when something reaches it."""


class Joined(Wire):
    """The time keeper has taken a process in."""

    now: MissionTimeNs
    step: Count


class Grant(Wire):
    """It is `at`: those named act once everything sent to them in earlier steps has reached them."""

    step: Annotated[int, Field(ge=1)]
    at: MissionTimeNs
    expects: dict[str, int]
    """How many messages each of those who act now has to take in."""


class StepDone(Wire):
    """A process has acted in a step."""

    name: Identifier
    step: Count
    next_wake: MissionTimeNs | None
    published: tuple[tuple[Text, Text, Count], ...] = ()
    """(topic, side, how many)."""
    asked: tuple[Text, ...] = ()
    """Topic of each question put."""
    answered: tuple[Text, ...] = ()
    """Who asked, for each question answered."""
    finished: Text | None = None
    """Why the process has nothing left to do, once it says so."""
    ok: bool = True


class StepBusy(Wire):
    """A process cannot finish a step until its computations end."""

    name: Identifier
    step: Count
    computing: tuple[Text, ...]


class Poke(Wire):
    """Somebody from outside, an operator say, has put something to a process: let it act now."""

    name: Identifier


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
    step: Count
    paused: bool
    rate: float | None
    until: MissionTimeNs | None
    members: tuple[Text, ...]
    waits_for: tuple[Text, ...]
    finished: dict[str, str]
    detail: Text = ""
