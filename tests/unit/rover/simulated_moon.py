"""A rover on a small simulated Moon, for the tests of this folder."""

from __future__ import annotations

import heapq
import itertools
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np

from he3.frames import SiteGrid
from he3.reference import Region
from schemas.commands import CommandKind, CommandReport, Telecommand
from schemas.plans import MissionPlan, PlannedSample, RoundPlan
from schemas.telemetry import RoverEvent, RoverState, SampleReport
from schemas.topics import COMMAND, COMMAND_REPORT, EVENT, PLAN, SAMPLE, STATE, Topic
from schemas.wire import Header
from services.field.node import FieldNode
from services.mission.mission_time import seconds
from services.mission.scenario import FieldConfig, RoverConfig
from services.rover.node import RoverNode
from services.runtime.node import (
    Effect,
    Event,
    Finish,
    NoReply,
    QueryFailed,
    QueryReceived,
    Received,
    RefuseQuery,
    ReplyReceived,
    Send,
    SendQuery,
    SendReply,
    SetTimer,
    Started,
    TimerFired,
)

GRID = SiteGrid(60, 60)
START = (5.5, 5.5)
BITE_S, ANALYSIS_S = 360.0, 300.0
SAMPLE_S = BITE_S + ANALYSIS_S  # one bite of 0.1 m, and its analysis
DAY_S = 86_400.0

Closed = Callable[[float, float], bool]


def region(closed: Closed = lambda x, y: False) -> Region:
    """A flat region of 1 m cells, closed where the function says so of a cell's centre, with 5 + x/10 ppb."""
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    flat = np.zeros(GRID.shape)
    return Region(
        name="plain",
        title="plain",
        provenance="made for tests",
        grid=GRID,
        he3_ppb=5.0 + x / 10,
        orbital_ppb=flat.copy(),
        elevation_m=flat.copy(),
        slope_deg=flat.copy(),
        traversable=~np.vectorize(closed)(x, y).astype(np.bool_),
    )


class Moon:
    """A rover and a field in simulated time. Instruments can be made to refuse or to stay silent."""

    def __init__(self, closed: Closed = lambda x, y: False, land: Region | None = None, **config: Any) -> None:
        self.config = RoverConfig.model_validate({"state_period_s": 1e6} | config)
        self.field = FieldNode(land or region(closed), FieldConfig(), 1, START)
        self.rover = RoverNode(self.config, GRID, START, 0)
        self.now = 0
        self.sent: defaultdict[Topic, list[Any]] = defaultdict(list)
        """What the rover has sent, by topic."""
        self.events: list[RoverEvent] = self.sent[EVENT]
        self.samples: list[SampleReport] = self.sent[SAMPLE]
        self.states: list[RoverState] = self.sent[STATE]
        self.reports: list[CommandReport] = self.sent[COMMAND_REPORT]
        self.finished: list[Finish] = []
        self.asked: list[SendQuery] = []
        self.refuses: dict[Topic, tuple[NoReply, str]] = {}
        """Instruments that do not reply, and why."""
        self.history: list[tuple[int, Event]] = []
        self._heap: list[tuple[int, int, Event]] = []
        self._order = itertools.count()
        self._timers: dict[str, int] = {}
        self.put(0.0, Started(1))

    def put(self, at_s: float, event: Event) -> None:
        heapq.heappush(self._heap, (seconds(at_s), next(self._order), event))

    def plan(self, plan: MissionPlan, at_s: float = 0.0) -> None:
        self.put(at_s, Received(PLAN, header(seconds(at_s)), plan))

    def command(
        self, kind: str, at_s: float, command_id: str | None = None, made_s: float | None = None, **fields: Any
    ) -> str:
        command_id = command_id or f"{kind}-{next(self._order)}"
        if "expires_s" in fields:
            fields["expires_at"] = seconds(fields.pop("expires_s"))
        body = Telecommand(command_id=command_id, kind=CommandKind(kind), **fields)
        self.put(at_s, Received(COMMAND, header(seconds(at_s if made_s is None else made_s)), body))
        return command_id

    def run(self, until_s: float = DAY_S) -> Moon:
        while self._heap and self._heap[0][0] <= seconds(until_s):
            self.now, _, event = heapq.heappop(self._heap)
            if isinstance(event, TimerFired):
                if self._timers.get(event.timer) != self.now:
                    continue
                del self._timers[event.timer]
            self.history.append((self.now, event))
            for effect in self.rover.handle(event, self.now):
                self._perform(effect)
        return self

    def _perform(self, effect: Effect) -> None:
        match effect:
            case Send(topic, body):
                self.sent[topic].append(body)
            case SendQuery():
                self.asked.append(effect)
                heapq.heappush(self._heap, (self.now, next(self._order), self._reply(effect)))
            case SetTimer(timer, None):
                self._timers.pop(timer, None)
            case SetTimer(timer, at):
                assert at is not None
                self._timers[timer] = at
                heapq.heappush(self._heap, (at, next(self._order), TimerFired(timer)))
            case Finish():
                self.finished.append(effect)

    def _reply(self, ask: SendQuery) -> Event:
        if ask.topic in self.refuses:
            why, detail = self.refuses[ask.topic]
            return QueryFailed(ask.topic, ask.query, why, detail)
        (effect,) = self.field.handle(QueryReceived(ask.topic, ask.request, 0), self.now)
        if isinstance(effect, RefuseQuery):
            return QueryFailed(ask.topic, ask.query, NoReply.REFUSED, effect.why)
        assert isinstance(effect, SendReply)
        return ReplyReceived(ask.topic, ask.query, effect.reply)

    # --- results

    def kinds(self, *wanted: str) -> list[str]:
        return [event.kind.value for event in self.events if not wanted or event.kind.value in wanted]

    def event(self, kind: str) -> RoverEvent:
        (found,) = [event for event in self.events if event.kind.value == kind]
        return found

    def stages(self, command_id: str) -> list[str]:
        return [report.stage.value for report in self.reports if report.command_id == command_id]

    def why(self, command_id: str) -> str:
        return [report.why for report in self.reports if report.command_id == command_id][-1]

    def modes(self) -> list[str]:
        return [mode for mode, _ in itertools.groupby(state.mode.value for state in self.states)]

    @property
    def state(self) -> RoverState:
        """The state that the rover reports now; a restart makes it report."""
        effects = self.rover.handle(Started(2), self.now)
        (state,) = (each.body for each in effects if isinstance(each, Send) and each.topic is STATE)
        assert isinstance(state, RoverState)
        return state

    @property
    def place(self) -> tuple[float, float]:
        return self.state.x_m, self.state.y_m


def header(made_at: int) -> Header:
    return Header(mission="m", source="ground", incarnation=1, sequence=made_at % 1000, made_at=made_at)


def round_plan(number: int, path: list[tuple[float, float]], *samples: tuple[float, float], depth=0.1) -> RoundPlan:
    return RoundPlan(
        round=number,
        path_m=tuple(path),
        samples=tuple(
            PlannedSample(sample_id=f"r{number}s{k}", x_m=x, y_m=y, depth_m=depth)
            for k, (x, y) in enumerate(samples, 1)
        ),
        information_nats=0.0,
    )


def plan_of(revision: int, *rounds: RoundPlan, last: bool = False) -> MissionPlan:
    return MissionPlan(revision=revision, rounds=rounds, last=last, samples_known=0, planned_at=0)


def east(number: int, begin: float, end: float, y: float = 5.5) -> RoundPlan:
    """A round straight east, with a sample at its end."""
    return round_plan(number, [(begin, y), (end, y)], (end, y))


STAGED = ["received", "accepted", "started", "completed"]


PIT = ((20.0, 0.0), (30.0, 0.0), (30.0, 20.0), (20.0, 20.0))
"""Corners [m] of a keep-out across the path of a round to the east."""
WEAK_BATTERY: dict[str, Any] = {"solar_w": 225.0, "capacity_wh": 100.0, "reserve": 0.5, "resume_charge": 0.9}
"""Settings of a rover that has to charge often."""


def wall(x: float, y: float) -> bool:
    """Closed terrain across the path of a round to the east."""
    return 20 <= x < 22 and y < 40


def moon_with_plan(depth: float = 0.5, **config: Any) -> Moon:
    """A rover that drives 20 m and drills half a metre: driving to 200 s, drilling to 2000 s, analysing to 2300 s."""
    moon = Moon(**config)
    moon.plan(plan_of(1, round_plan(1, [START, (25.5, 5.5)], (25.5, 5.5), depth=depth), east(2, 25.5, 35.5)))
    return moon
