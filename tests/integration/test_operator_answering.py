"""The process that answers operators, seen from its owner: what it was shown, it answers from, also after its death."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from he3.frames import SiteGrid
from schemas.topics import Side
from services.ground.map.queries import MODULE
from services.ground.map.snapshot import MapSnapshot
from services.runtime.queries.process import QueryProcess
from tests.waiting import PATIENCE_S

GRID = SiteGrid(50, 60, 1.0)


def snapshot(revision: int) -> MapSnapshot:
    values = np.full(GRID.shape, float(revision), dtype=np.float32)
    return MapSnapshot(
        grid=GRID, mean_ppb=values, std_ppb=values, traversable=np.ones(GRID.shape, dtype=np.bool_), samples=(),
        driven_path_m=(), planned_path_m=(), plan_ends=None, revision=revision, mission_time_ns=revision, score=None,
        score_history=(),
    )  # fmt: skip


@pytest.fixture
def warnings() -> list[str]:
    return []


@pytest.fixture
def answering(warnings: list[str]) -> Iterator[QueryProcess]:
    # Nobody listens there: what is shown is taken in all the same.
    process = QueryProcess(MODULE, Side.EARTH, "tcp/127.0.0.1:9", "answering", warnings.append)
    yield process
    process.close()


def test_what_is_settled_is_answered_from(answering: QueryProcess) -> None:
    assert answering.settle(0.0)  # nothing was shown, so nothing is to come
    for revision in range(1, 20):
        answering.show(snapshot(revision))
    assert answering.settle(PATIENCE_S)


def test_one_that_died_is_replaced_and_is_shown_the_newest_again(answering: QueryProcess, warnings: list[str]) -> None:
    answering.show(snapshot(1))
    assert answering.settle(PATIENCE_S)
    before = answering.pid
    assert before is not None
    os.kill(before, signal.SIGKILL)
    answering.show(snapshot(2))
    assert answering.settle(PATIENCE_S)
    assert answering.pid not in (None, before)
    assert len(warnings) == 1


def test_waiting_for_one_that_never_gets_ready_ends_when_told_to_stop(answering: QueryProcess) -> None:
    stop = threading.Event()
    stop.set()
    answering.wait_until_ready(stop)


def test_nothing_is_left_behind(answering: QueryProcess) -> None:
    answering.show(snapshot(1))
    assert answering.settle(PATIENCE_S)
    pid = answering.pid
    assert pid is not None
    answering.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
