"""Operators' queries: read from selectors or messages, answered from snapshots in threads."""

from __future__ import annotations

import json
import queue
import threading
from dataclasses import dataclass
from typing import Any

import pytest

from he3.errors import InvalidInput, OutsideRegion
from schemas.codec import decode_reply, encode
from schemas.commands import CommandKind
from schemas.link import Direction
from schemas.maps import MapPoint, MapPointQuery, MapScore
from schemas.refusal import Refusal, RefusalCode
from schemas.topics import (
    CLOCK_SET,
    ISSUE_COMMAND,
    LINK_SET,
    LIST_COMMANDS,
    MAP_LAYER,
    MAP_POINT,
    MAP_SCORE,
    TIME_CONTROL,
)
from schemas.wire import Header
from services.runtime.queries.server import QueryServer, QueryService
from services.runtime.transport.request import request_from_selector
from tests.waiting import PATIENCE_S

SCORE = MapScore(
    rmse_ppb=1.0, coverage_68=0.7, coverage_95=0.95, mean_std_ppb=1.0, revision=1, samples=3, mission_time_ns=5
)
INVALID, OUTSIDE, INTERNAL = RefusalCode.INVALID_INPUT, RefusalCode.OUTSIDE_REGION, RefusalCode.INTERNAL


def point(request: MapPointQuery, revision: int) -> MapPoint:
    if request.x > 500:
        raise OutsideRegion("map: expected a place within 0..500 m")
    if request.y == 13:
        raise ZeroDivisionError("of thirteen")
    return MapPoint(
        x_m=request.x, y_m=request.y, mean_ppb=8.0, std_ppb=1.0, traversable=True, revision=revision, samples=0,
        mission_time_ns=5,
    )  # fmt: skip


@dataclass(frozen=True)
class Shown:
    """A snapshot."""

    revision: int
    mission_time_ns: int = 7


class FakeQuery:
    """A query as Zenoh delivers it; a test can wait for its end."""

    def __init__(self, payload: bytes | None = None, **parameters: str) -> None:
        self.payload = payload
        self.parameters = parameters
        self.end: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()

    def reply(self, payload: bytes, *_: Any) -> None:
        self.end.put(("answered", payload))

    def refuse(self, refusal: Refusal) -> None:
        self.end.put(("refused", refusal))


class OneTopicBus:
    """Passes queries to the registered server."""

    def serve(self, _topic: Any, on_query: Any) -> None:
        self.ask = on_query


@pytest.fixture
def server() -> QueryServer:
    service = QueryService((MAP_POINT,), lambda _topic, request, snapshot: point(request, snapshot.revision))
    return QueryServer(service, "ground", "short")


@pytest.fixture
def ask(server):
    session = OneTopicBus()
    server.serve(MAP_POINT, session)

    def ask(query: FakeQuery) -> tuple[str, Any]:
        session.ask(query)
        return query.end.get(timeout=PATIENCE_S)

    return ask


def message(**body: Any) -> bytes:
    header = Header(mission="short", source="operator", incarnation=0, sequence=0, made_at=0)
    return encode(header, MapPointQuery(**body))


def test_before_there_is_a_map_a_question_is_refused_and_not_kept_waiting(ask):
    refusal = Refusal("there is no map yet; ask again in a moment", RefusalCode.NOT_READY)
    assert ask(FakeQuery(x="1", y="2")) == ("refused", refusal)


def test_parameters_are_answered_with_the_plain_body_and_a_message_with_a_message(server, ask):
    server.show(Shown(3))
    how, plain = ask(FakeQuery(x="1", y="2"))
    assert how == "answered"
    body = json.loads(plain)
    assert (body["x_m"], body["y_m"], body["revision"]) == (1.0, 2.0, 3)
    how, enveloped = ask(FakeQuery(message(x=1.0, y=2.0)))
    assert how == "answered"
    header, reply = decode_reply(MAP_POINT, enveloped, "short")
    assert (header.source, header.made_at) == ("ground", 7)
    assert reply == MapPoint.model_validate(body)


def test_the_newest_snapshot_answers(server, ask):
    for revision in (1, 2, 9):
        server.show(Shown(revision))
        assert json.loads(ask(FakeQuery(x="1", y="2"))[1])["revision"] == revision


@pytest.mark.parametrize(
    ("query", "code", "expected"),
    [
        (FakeQuery(), INVALID, "earth/map/point: x: field required"),
        (FakeQuery(x="1", y="much"), INVALID, "earth/map/point: y: input should be a valid number"),
        (FakeQuery(x="1", y="nan"), INVALID, "earth/map/point: y: input should be"),
        (FakeQuery(x="1", y="2", z="3"), INVALID, "earth/map/point: z: extra inputs are not permitted"),
        (FakeQuery(x="900", y="2"), OUTSIDE, "map: expected a place within 0..500 m"),
        (FakeQuery(x="1", y="13"), INTERNAL, "earth/map/point: defect: ZeroDivisionError: of thirteen"),
        (FakeQuery(b""), INVALID, "he3/short/earth/map/point: invalid JSON"),
        (FakeQuery(b"{}"), INVALID, "he3/short/earth/map/point: header: field required"),
        (FakeQuery(message(x=1.0, y=2.0).replace(b"short", b"other")), INVALID, "damaged"),
    ],
)
def test_bad_questions_are_refused_in_one_line_and_the_next_is_answered(server, ask, query, code, expected):
    server.show(Shown(1))
    how, refusal = ask(query)
    assert how == "refused"
    assert refusal.code is code
    assert expected in refusal.error
    assert "\n" not in refusal.error
    assert ask(FakeQuery(x="1", y="2"))[0] == "answered"


def test_a_hundred_questions_at_once_are_each_answered_once(server):
    session = OneTopicBus()
    server.serve(MAP_POINT, session)
    server.show(Shown(1))
    queries = [FakeQuery(x=str(number), y="2") for number in range(100)]
    for query in queries:
        session.ask(query)
    for number, query in enumerate(queries):
        how, answer = query.end.get(timeout=PATIENCE_S)
        assert how == "answered"
        assert json.loads(answer)["x_m"] == number
        assert query.end.empty()


def test_an_answer_that_takes_long_delays_slow_queries_alone():
    begun, go_on = threading.Semaphore(0), threading.Event()

    def answer(topic, request, snapshot):
        if topic is MAP_SCORE:
            begun.release()
            assert go_on.wait(PATIENCE_S)
        return point(request, snapshot.revision) if topic is MAP_POINT else SCORE

    server = QueryServer(QueryService((MAP_POINT, MAP_SCORE), answer, slow=(MAP_SCORE,)), "ground", "short")
    server.show(Shown(1))
    quick, slow = OneTopicBus(), OneTopicBus()
    server.serve(MAP_POINT, quick)
    server.serve(MAP_SCORE, slow)
    waiting = [FakeQuery() for _ in range(9)]
    for query in waiting:
        slow.ask(query)
    assert begun.acquire(timeout=PATIENCE_S), "the first of them is being answered"
    for number in range(20):
        query = FakeQuery(x=str(number), y="2")
        quick.ask(query)
        assert query.end.get(timeout=PATIENCE_S)[0] == "answered"
    assert all(query.end.empty() for query in waiting)
    assert not begun.acquire(blocking=False), "and no other of them"
    go_on.set()
    assert [query.end.get(timeout=PATIENCE_S)[0] for query in waiting] == ["answered"] * 9


def test_selectors_can_say_all_that_operators_change():
    change = request_from_selector(LINK_SET, {"direction": "down", "loss": "0.3", "rate_bit_s": "2000"})
    assert (change.direction, change.loss, change.rate_bit_s) == (Direction.DOWN, 0.3, 2000.0)
    assert change.one_way_light_time_s is None
    assert request_from_selector(LINK_SET, {"contact": "false"}).contact is False
    assert request_from_selector(LINK_SET, {}).model_dump(exclude_defaults=True) == {}
    assert request_from_selector(CLOCK_SET, {"rate": "10"}).rate == 10.0
    assert request_from_selector(MAP_LAYER, {"layer": "std", "step": "5"}).step == 5
    assert request_from_selector(TIME_CONTROL, {"paused": "true", "steps": "3"}).steps == 3
    command = request_from_selector(ISSUE_COMMAND, {"command_id": "mine-1", "kind": "pause"})
    assert command.kind is CommandKind.PAUSE
    request_from_selector(LIST_COMMANDS, {})


@pytest.mark.parametrize(
    ("topic", "parameters"),
    [
        (LINK_SET, {"loss": "2"}),
        (LINK_SET, {"loss": "some"}),
        (LINK_SET, {"one_way_light_time_s": "-1"}),
        (LINK_SET, {"one_way_light_time_s": "1e6"}),
        (LINK_SET, {"direction": "sideways"}),
        (LINK_SET, {"contact": "perhaps"}),
        (LINK_SET, {"contact": "true", "contact_as_scheduled": "true"}),
        (LINK_SET, {"rate_bit_s": "1", "unlimited_rate": "true"}),
        (LINK_SET, {"at_edge": "wait"}),
        (CLOCK_SET, {}),
        (CLOCK_SET, {"rate": "-1"}),
        (CLOCK_SET, {"rate": "1e6"}),
        (MAP_LAYER, {}),
        (MAP_LAYER, {"layer": "gold"}),
        (MAP_LAYER, {"layer": "mean", "step": "0"}),
        (MAP_LAYER, {"layer": "mean", "step": "1.5"}),
        (ISSUE_COMMAND, {"command_id": "a b", "kind": "pause"}),
        (ISSUE_COMMAND, {"command_id": "a", "kind": "fly"}),
        (ISSUE_COMMAND, {"command_id": "a", "kind": "go_to"}),
        (LIST_COMMANDS, {"all": "true"}),
        (TIME_CONTROL, {"steps": "0"}),
        (TIME_CONTROL, {"rate": "0"}),
    ],
)
def test_selectors_that_say_nonsense_are_refused_in_one_line(topic, parameters):
    with pytest.raises(InvalidInput) as refused:
        request_from_selector(topic, parameters)
    assert str(refused.value).startswith(f"{topic.name}: ")
    assert "\n" not in str(refused.value)


def test_a_malformed_message_is_invalid_input(server):
    server.show(Shown(1))
    with pytest.raises(InvalidInput):
        server.reply(MAP_POINT, FakeQuery(b"\xff"))
