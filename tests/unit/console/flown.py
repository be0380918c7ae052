"""A mission that was flown with faults, its recording, and what a client saw of it live at ten instants."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.fault_schedules import Fault, FaultKind
from benchmarks.faults import World
from he3.errors import NotReady
from schemas.codec import decode, encode
from schemas.commands import CommandKind, Telecommand
from schemas.ground import InterestChange
from schemas.maps import CrossValidationQuery, MapLayer, MapLayerQuery, MapPointQuery, MapTrackQuery, RealisationsQuery
from schemas.topics import (
    ISSUE_COMMAND,
    MAP_CROSS_VALIDATION,
    MAP_LAYER,
    MAP_POINT,
    MAP_REALISATIONS,
    SET_INTEREST,
    TRACK,
    Side,
    Topic,
)
from schemas.wire import Header, Wire
from services.console.client.clock import MissionClock
from services.console.client.mission_client import MissionClient
from services.console.client.mission_state import MissionState
from services.console.replay.session import LOOK_EVERY_NS
from services.console.web.hub import Hub
from services.ground.map.service import answer
from services.mission.mission_time import SECOND
from services.recorder.about import about
from services.recorder.writer import RecordingWriter
from services.runtime.scheduler import InlineExecutor
from services.runtime.transport.client import Client

HOUR_S = 3600.0
SEED = 5
FAULTS = (
    Fault(FaultKind.LOSS, 0.2 * HOUR_S, 3 * HOUR_S),
    Fault(FaultKind.REORDERING, 0.3 * HOUR_S, 5 * HOUR_S),
    Fault(FaultKind.DUPLICATION, 0.4 * HOUR_S, 5 * HOUR_S),
    Fault(FaultKind.KILL, 1.0 * HOUR_S, 300.0, "ground"),
    Fault(FaultKind.KILL, 2.0 * HOUR_S, 600.0, "rover"),
    Fault(FaultKind.CRASH, 2.5 * HOUR_S, 900.0, "ground", torn=True),
    Fault(FaultKind.CORRUPTION, 3.0 * HOUR_S, HOUR_S),
    Fault(FaultKind.BLACKOUT, 4.0 * HOUR_S, HOUR_S),
)
INSTANTS_S = tuple(0.07 * HOUR_S + 0.28 * HOUR_S * number for number in range(10))
PLACE = MapPointQuery(x=40.5, y=33.5, threshold=8.0)
AREA = ((80.0, 80.0), (110.0, 80.0), (110.0, 110.0))


@dataclass(frozen=True)
class Seen:
    """What a client sees of a mission at an instant."""

    page: Mapping[str, Any]
    """What the page has from its server."""
    point: Wire | None
    """The posterior at a place; None without a map."""
    std: Wire | None
    track: Wire | None
    drawn: Wire | None
    """Two realisations of the field."""
    checked: Wire | None
    """The cross-validation; None without samples."""


@dataclass(frozen=True)
class Flown:
    """The recording of a mission, and what was seen of it live, by seconds since its beginning."""

    path: Path
    live: dict[float, Seen]


class _Session(Client):
    """A session with a mission in this process: it hears what is published on Earth."""

    def __init__(self) -> None:
        self._listeners: list[tuple[Topic, Callable[[Header, Any], None]]] = []

    def subscribe(self, topic: Topic, on_message: Callable[[Header, Any], None]) -> Callable[[], None]:
        self._listeners.append((topic, on_message))
        return lambda: None

    def latest(self, topic: Topic, timeout_s: float = 0.0) -> tuple[Header, Any]:
        raise NotReady(topic.name)

    def query(self, topic: Topic, request: Wire, timeout_s: float = 0.0) -> Any:
        raise NotReady(topic.name)

    def hear(self, topic: Topic, header: Header, body: Any) -> None:
        for wanted, listener in self._listeners:
            if wanted is topic:
                listener(header, body)


class _Clock(MissionClock):
    """Mission time as the simulation has it, or as it is while nothing happens there."""

    def __init__(self, world: World) -> None:
        super().__init__(world.scenario.start_ns)
        self._simulation = world.simulation
        self.at = 0

    def now(self) -> int:
        return max(self._simulation.now, self.at)


class _State(MissionState):
    def __init__(self, session: Client, on_change: Any, world: World) -> None:
        self._world = world
        super().__init__(session, on_change)

    def _clock_of(self, start_ns: int | None) -> MissionClock:
        return _Clock(self._world)


class _Live(MissionClient):
    def __init__(self, session: _Session, world: World) -> None:
        self._session = session
        self._world = world
        self.earth, self.mission = "", "faults"

    def state(self, on_change: Any = None, start_ns: int | None = None, *, follow: bool = True) -> MissionState:
        return _State(self._session, on_change, self._world)


def fly(path: Path) -> Flown:
    """Fly the mission with killed processes and a link that loses, doubles and damages; record it, and look at it."""
    world = World(SEED, InlineExecutor(), planner="informative")
    start_ns, simulation = world.scenario.start_ns, world.simulation
    session = _Session()
    hub = Hub(_Live(session, world))
    hub._state.follow()
    clock = hub._state.time
    assert isinstance(clock, _Clock)
    due, live = list(INSTANTS_S), {}
    orders = {
        0.5 * HOUR_S: (SET_INTEREST, InterestChange(area_id="look-here", polygon_m=AREA, weight=5.0)),
        1.6 * HOUR_S: (ISSUE_COMMAND, Telecommand(command_id="c1", kind=CommandKind.PAUSE)),
        1.8 * HOUR_S: (ISSUE_COMMAND, Telecommand(command_id="c2", kind=CommandKind.RESUME)),
        2.2 * HOUR_S: (
            ISSUE_COMMAND, Telecommand(command_id="c3", kind=CommandKind.SET_KEEP_OUT, area_id="no", polygon_m=AREA)
        ),
    }  # fmt: skip
    handle = simulation._handle

    def look_until(instant: int) -> None:
        for at in (*range(max(simulation.now, clock.at), instant, LOOK_EVERY_NS), instant):
            clock.at = at
            hub._time_passes()

    def watched(instant: int) -> None:
        """What a display looks at until that instant, and what an operator does before it; then what happens at it."""
        while due and start_ns + due[0] * SECOND < instant:
            look_until(start_ns + round(due[0] * SECOND))
            live[due[0]] = seen(hub, simulation.snapshots.get("ground"))
            due.pop(0)
        look_until(instant)
        ordered = [at_s for at_s in orders if start_ns + at_s * SECOND < instant]
        for at_s in ordered:
            simulation.ask(*orders.pop(at_s))
        if not ordered:  # else something may happen sooner
            handle(instant)

    simulation._handle = watched  # type: ignore[method-assign]
    with path.open("wb") as stream, RecordingWriter(stream, "faults", about=about(world.scenario)) as writer:

        def record(topic: Topic, side: Side, payload: bytes, now: int) -> None:
            if side is Side.EARTH and topic.recorded:
                try:
                    header, body = decode(topic, payload, "faults")
                except ValueError:
                    return  # damaged on the link, as the fault schedule asks
                writer.write(topic, encode(header, body), now, header.made_at, header.sequence)
                session.hear(topic, header, body)

        simulation.tap(record)
        world.suffer(FAULTS)
        world.mission.run(world.revive)
    return Flown(path, live)


def seen(hub: Hub, snapshot: Any) -> Seen:
    """What the page has, and what the ground answers from that snapshot."""
    page = hub._document()
    asked = (
        (MAP_POINT, PLACE),
        (MAP_LAYER, MapLayerQuery(layer=MapLayer.STD, step=7)),
        (TRACK, MapTrackQuery()),
        (MAP_REALISATIONS, RealisationsQuery(count=2)),
    )
    answers = [None if snapshot is None else answer(topic, request, snapshot) for topic, request in asked]
    checked = answer(MAP_CROSS_VALIDATION, CrossValidationQuery(), snapshot) if snapshot and snapshot.samples else None
    return Seen(page, *answers, checked=checked)
