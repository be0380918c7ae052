"""Nodes that send, query, reply, compute and wait at random: any two drivers of virtual time must agree on them.

A node's actions follow from its seed and from the order and time of its inputs, so the smallest difference between two
drivers changes the whole history. Also a program, for a chatter in its own process:
``python chatter.py NAME SEED SCENARIO [options of a service]``.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from random import Random
from time import sleep
from typing import NoReturn

from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import Query, Side, Topic
from services.mission.mission_time import SECOND
from services.runtime.node import (
    Compute,
    Effect,
    Event,
    Finish,
    Interface,
    QueryReceived,
    RefuseQuery,
    Send,
    SendQuery,
    SendReply,
    SetTimer,
    Started,
    TimerFired,
)

NEWS = {side: tuple(Topic(f"{side.value}/test/news{i}", RoverEvent) for i in range(3)) for side in Side}
QUESTIONS = {
    side: tuple(
        Topic(f"{side.value}/test/question{i}", RoverEvent, service=Query(), reply=RoverEvent) for i in range(3)
    )
    for side in Side
}
NAMES = {"link": tuple(Side), "ground": (Side.EARTH,), "rover": (Side.MOON,), "field": (Side.MOON,)}
"""The processes that may join, each with its sides. In separate processes the link keeps the time."""


def said(number: int) -> RoverEvent:
    return RoverEvent(kind=EventKind.PARKED, at=0, x_m=0.0, y_m=0.0, round=number)


def cubed(number: int) -> int:
    return number**3


class Chatter:
    """A node that reacts to everything at random, until its budget of effects is spent."""

    def __init__(self, interface: Interface, seed: str, budget: int) -> None:
        self.interface = interface
        self.history: list[tuple[int, str]] = []
        self._random = Random(seed)
        self._left = budget
        self._open: list[int] = []
        self._names = 0

    def handle(self, event: Event, now: int) -> Iterable[Effect]:
        self.history.append((now, type(event).__name__))
        if isinstance(event, QueryReceived):
            self._open.append(event.token)
        if isinstance(event, Started):
            yield SetTimer("again", now + self._delay())
        for _ in range(self._random.choice((0, 1, 1, 2, 3))):
            if self._left > 0:
                self._left -= 1
                yield self._effect(now)
        if isinstance(event, TimerFired) and event.timer == "again" and self._left > 0:
            yield SetTimer("again", now + self._delay())
        if (
            isinstance(event, TimerFired) or self._random.random() < 0.5
        ):  # else answered later, or at the end of the budget
            yield from self._answers()
        if self._left <= 0:
            yield Finish(True, f"said all after {len(self.history)}")

    def _effect(self, now: int) -> Effect:
        dice = self._random
        side = dice.choice(self.interface.sides)
        self._names += 1
        match dice.randrange(10):
            case 0 | 1 | 2 | 3:
                return Send(dice.choice(NEWS[side]), said(dice.randrange(1000)))
            case 4 | 5:
                return SendQuery(dice.choice(QUESTIONS[side]), said(dice.randrange(1000)), f"question{self._names}")
            case 6:
                takes_s = dice.choice((0.0, 1e-9, 0.5, 7.0))
                return Compute(f"job{self._names}", cubed, (dice.randrange(99),), takes_s)
            case 7:
                return SetTimer(f"timer{dice.randrange(3)}", None)
            case _:
                return SetTimer(f"timer{dice.randrange(3)}", now + self._delay())

    def _delay(self) -> int:
        return self._random.choice((-5, 0, 1, SECOND // 3, SECOND, SECOND, 7 * SECOND))

    def _answers(self) -> Iterable[Effect]:
        for token in self._open:
            number = self._random.randrange(1000)
            yield RefuseQuery(token, "not today") if number % 4 == 0 else SendReply(token, said(number))
        self._open.clear()


def interfaces(seed: int) -> list[Interface]:
    """Which nodes there are, and what each receives and serves, at random: a query is served by one node or by none."""
    dice = Random(f"interfaces/{seed}")
    server = {topic: dice.choice((*NAMES, "nobody")) for topics in QUESTIONS.values() for topic in topics}
    return [
        Interface(
            name,
            NAMES[name],
            subscribes=tuple(t for side in NAMES[name] for t in NEWS[side] if dice.random() < 0.6),
            serves=tuple(topic for topic, who in server.items() if who == name),
            custody=False,
        )
        for name in tuple(NAMES)[: dice.randint(2, len(NAMES))]
    ]


def chatters(seed: int, budget: int = 40) -> list[Chatter]:
    """The same nodes, each in its first state, every time."""
    return [Chatter(interface, f"{seed}/{interface.name}", budget) for interface in interfaces(seed)]


class DawdlingExecutor:
    """Computes in other threads, with random delays."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(2)

    def submit(self, function: object, /, *arguments: object) -> Future[object]:
        def late() -> object:
            sleep(0.02)
            return function(*arguments)  # type: ignore[operator]

        return self._pool.submit(late)

    def close(self) -> None:
        self._pool.shutdown(cancel_futures=True)


def main(name: str, seed: str, *arguments: str) -> NoReturn:
    """One chatter in this process."""
    from services.link.lockstep_driver import TimeManagerDriver
    from services.link.routers import router_on
    from services.runtime.entry import leave, prepare_process
    from services.runtime.lockstep.driver import LockstepDriver
    from services.runtime.process import connect_side, serve
    from services.runtime.service import Service

    prepare_process()

    node = next(each for each in chatters(int(seed)) if each.interface.name == name)
    service = Service(name, lambda options: node, executor=DawdlingExecutor, journals=False)
    is_link = name == "link"
    leave(
        serve(
            service,
            arguments,
            in_lockstep=TimeManagerDriver if is_link else LockstepDriver,
            open_side=router_on if is_link else connect_side,
        )
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
