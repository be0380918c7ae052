"""A flood neither fills the memory of a process nor keeps its main loop from its other work."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from schemas.codec import Refused
from schemas.refusal import RefusalCode
from schemas.topics import EARTH_CLOCK, EVENT, LINK_SHOW, STATE, Topic
from services.runtime.backlog import Backlog
from services.runtime.context import ProcessContext
from services.runtime.drivers.wall_clock import WallClockDriver
from services.runtime.inbox import Inbox


def test_what_exceeds_the_bound_of_its_topic_is_turned_away_and_counted() -> None:
    backlog = Backlog(max_messages=3)
    assert [backlog.enter(STATE, 1) for _ in range(5)] == [True, True, True, False, False]
    assert backlog.enter(EVENT, 1), "a flood on one topic takes no room from another"
    assert backlog.turned_away() == [(STATE, 2)]
    assert backlog.turned_away() == []
    backlog.leave(STATE, 1)
    assert [backlog.enter(STATE, 1), backlog.enter(STATE, 1)] == [True, False]


def test_few_large_messages_are_bounded_by_their_bytes() -> None:
    backlog = Backlog(max_bytes=100)
    assert [backlog.enter(STATE, 60), backlog.enter(STATE, 60), backlog.enter(STATE, 40)] == [True, False, True]
    backlog.leave(STATE, 60)
    assert backlog.enter(STATE, 60)


class Loop:
    """A driver on the wall clock, with a node that does nothing; its inbox is stopped at the third heartbeat."""

    def __init__(self, backlog: Backlog | None = None) -> None:
        self.inbox = Inbox()
        self.beats = 0
        self.put: list[Any] = []
        scheduler = SimpleNamespace(
            put=lambda order, given: self.put.append(given),
            run=lambda now, wait: [],
            next_wake=lambda wait: None,
            waiting=0,
        )
        clock = SimpleNamespace(
            now=lambda: 0, advance=lambda now: now, latest=0, in_lockstep=False, wait_s=lambda wake: None
        )
        context: Any = SimpleNamespace(
            inbox=self.inbox, clock=clock, scheduler=scheduler, incarnation=1, resume=[], beat=self._beat,
            backlog=backlog or Backlog(), open_queries=SimpleNamespace(next_token=lambda: 1, add=lambda *_: None),
        )  # fmt: skip
        time_source: Any = SimpleNamespace(tend=lambda now_s: None, begin=lambda: True)
        self.driver = WallClockDriver(context, time_source)

    def _beat(self, monotonic_s: float) -> None:
        self.beats += 1
        if self.beats == 3:
            self.inbox.stop()


def test_a_flood_without_end_does_not_keep_the_main_loop_from_its_heartbeat() -> None:
    loop = Loop()

    def again() -> None:
        loop.inbox.put(again)

    loop.inbox.put(again)
    loop.driver.run()
    assert loop.beats == 3


def test_messages_that_are_turned_away_are_counted_as_refused_and_the_rest_is_handled() -> None:
    loop = Loop(backlog := Backlog(max_messages=2))
    for _ in range(7):
        loop.driver.on_message(STATE, b"junk", b"")
    loop.driver.on_message(EVENT, b"junk", b"")
    loop.driver.run()
    assert len(loop.put) == 1 + 2 + 1, "the start, and what had room"
    refused: list[tuple[str, str, int]] = []

    def refuse(topic: Topic, why: Refused, source: str = "", *, count: int) -> list[Any]:
        refused.append((topic.name, why.kind, count))
        return []

    quiet: Any = SimpleNamespace(
        beat=lambda *_: None, host=SimpleNamespace(refuse=refuse), latest=0, write=lambda *_: 0
    )
    context = ProcessContext(quiet, loop.inbox, {}, quiet, quiet, quiet, quiet, None, None, backlog=backlog)
    context.beat(0.0)
    context.beat(1.0)
    assert refused == [("tm/state", "too many", 5)]
    loop.driver.on_message(STATE, b"junk", b"")
    assert loop.inbox.take(), "there is room again"


def test_a_query_that_is_turned_away_is_told_to_ask_again() -> None:
    loop, refusals = Loop(Backlog(max_messages=1)), []
    query: Any = SimpleNamespace(refuse=refusals.append, payload=b"{}")
    loop.driver.on_query(LINK_SHOW, query)
    loop.driver.on_query(LINK_SHOW, query)
    assert [refusal.code for refusal in refusals] == [RefusalCode.BUSY]


def test_what_a_process_takes_in_beside_its_node_is_bounded_alike() -> None:
    inbox, backlog, taken = Inbox(), Backlog(max_messages=2), []
    receive = backlog.receiving(inbox, EARTH_CLOCK, taken.append)
    for number in range(5):
        receive(b"%d" % number, b"")
    inbox.take_all()
    assert taken == [b"0", b"1"]
    assert backlog.turned_away() == [(EARTH_CLOCK, 3)]
    receive(b"5", b"")
    inbox.take_all()
    assert taken[-1] == b"5"
