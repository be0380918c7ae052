"""The query process, seen from its owner: it answers from the last snapshot, also after it died and was restarted."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from he3.errors import He3Error
from he3.frames import SiteGrid
from schemas.topics import Side
from services.ground.map.snapshot import MapSnapshot
from services.runtime.queries import process as query_process
from services.runtime.queries.process import QueryProcess
from tests.waiting import until

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
    # No router listens there; snapshots are taken in all the same.
    process = QueryProcess("services.ground.map.process", Side.EARTH, "tcp/127.0.0.1:9", "answering", warnings.append)
    yield process
    process.close()


def test_a_query_process_settles_on_the_newest_snapshot(answering: QueryProcess) -> None:
    assert answering.settle()  # nothing was shown, so nothing is to come
    for revision in range(1, 20):
        answering.show(snapshot(revision))
    assert answering.settle()


def test_a_query_process_that_died_is_replaced_and_gets_the_newest_snapshot_again(
    answering: QueryProcess, warnings: list[str]
) -> None:
    answering.show(snapshot(1))
    assert answering.settle()
    before = answering.pid
    assert before is not None
    os.kill(before, signal.SIGKILL)
    answering.show(snapshot(2))
    assert answering.settle()
    assert answering.pid not in (None, before)
    assert sum("ended by itself" in warning for warning in warnings) == 1  # a slow machine also says what it waits for


def test_waiting_for_a_query_process_that_never_gets_ready_ends_when_told_to_stop(answering: QueryProcess) -> None:
    stop = threading.Event()
    stop.set()
    answering.wait_until_ready(stop)


def test_a_query_process_that_dies_before_it_is_ready_is_reported_with_the_reason(warnings: list[str]) -> None:
    process = QueryProcess("services.no_such_module", Side.EARTH, "tcp/127.0.0.1:9", "answering", warnings.append)
    try:
        with pytest.raises(
            He3Error, match=r"services\.no_such_module ended by itself, exit code 1, before it was ready"
        ):
            process.wait_until_ready(threading.Event())
    finally:
        process.close()


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="needs SIGSTOP")
def test_a_query_process_that_hangs_is_waited_for_until_it_has_been_silent_for_long(
    answering: QueryProcess, warnings: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(query_process, "SILENT_AFTER_S", 3.0)
    answering.show(snapshot(1))
    assert answering.settle()
    pid = answering.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    try:
        answering.show(snapshot(2))
        assert not answering.settle()
        assert not answering.settle()  # at once: it is known to hang
        assert [line for line in warnings if "silent" in line] == [
            f"the query process (pid {pid}) has been silent for 3 s; not waiting"
        ]
    finally:
        os.kill(pid, signal.SIGCONT)
    until(answering.settle, "the query process to be heard of again")


def test_a_closed_query_process_is_gone(answering: QueryProcess) -> None:
    answering.show(snapshot(1))
    assert answering.settle()
    pid = answering.pid
    assert pid is not None
    answering.close()
    until(lambda: is_gone(pid), "the query process to be gone")


def is_gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False
