"""Two small services for a test: a ground that sends thirty plans of 100 kB, and a rover that counts them.

Run as ``python large_plans.py ground|rover SCENARIO ...``, with the flags of every service.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable

from schemas.plans import MissionPlan, RoundPlan
from schemas.topics import PLAN, Side
from services.mission.mission_time import SECOND
from services.runtime.entry import leave, prepare_process
from services.runtime.node import (
    Effect,
    Event,
    Finish,
    Interface,
    Level,
    LogRecord,
    Node,
    Received,
    Send,
    SetTimer,
    TimerFired,
)
from services.runtime.options import Options
from services.runtime.process import serve
from services.runtime.service import Service

PLANS = 30
BYTES = 100_000


def big_plan(number: int, now: int) -> MissionPlan:
    """A plan that takes about 100 kB on the wire; its places tell which one it is."""
    path = tuple((round(number + index * 0.001, 3), 123.4567890123) for index in range(4096))
    return MissionPlan(
        revision=number,
        rounds=(RoundPlan(round=1, path_m=path, samples=(), information_nats=0.0),),
        samples_known=0,
        planned_at=now,
    )


class Sender:
    """Sends everything at once, a second after its start."""

    interface = Interface("ground", (Side.EARTH,))

    def handle(self, event: Event, now: int) -> Iterable[Effect]:
        if isinstance(event, TimerFired):
            return [Send(PLAN, big_plan(number, now)) for number in range(1, PLANS + 1)]
        return [SetTimer("begin", now + SECOND)]


class Receiver:
    """Notes each plan, and finishes when all have arrived."""

    interface = Interface("rover", (Side.MOON,), subscribes=(PLAN,))

    def __init__(self) -> None:
        self.came: list[int] = []

    def handle(self, event: Event, now: int) -> Iterable[Effect]:
        if not isinstance(event, Received):
            return
        plan: MissionPlan = event.body
        whole = plan == big_plan(plan.revision, plan.planned_at)
        self.came.append(plan.revision)
        yield LogRecord(Level.INFO, "a plan arrived", {"number": plan.revision, "whole": whole})
        if len(self.came) == PLANS:
            yield Finish(whole, f"plans {self.came}")


def build(options: Options) -> Node:
    return Receiver() if sys.argv[0].endswith("rover") else Sender()


if __name__ == "__main__":
    prepare_process()
    name = sys.argv.pop(1)
    sys.argv[0] = name
    leave(serve(Service(name, build), sys.argv[1:]))
