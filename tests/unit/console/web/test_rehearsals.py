"""The page's rehearsals: what is refused before one begins, who may stop one, and what is said of one that failed."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from he3.errors import Busy, He3Error, InvalidInput, PeerUnreachable
from schemas.commands import CommandStatus
from services.console.client.mission_client import MissionClient
from services.console.rehearsal.alternative import AS_PLANNED, alternatives_of
from services.console.rehearsal.forecast import Forecast, rehearse_live
from services.console.web.rehearsals import Rehearsals
from tests.waiting import until


class Away(MissionClient):
    """A mission whose ground does not answer before it is let."""

    def __init__(self) -> None:
        self.asked = threading.Event()

    def commands(self) -> tuple[CommandStatus, ...]:
        self.asked.wait()
        raise PeerUnreachable("expected an answer from the ground, got none")


def test_a_rehearsal_that_comes_to_nothing_says_why_and_the_next_one_can_begin() -> None:
    mission = Away()
    rehearsals = Rehearsals(mission, rehearse_live)
    assert rehearsals.document() == {"number": 0, "running": False}
    rehearsals.begin(20, alternatives_of("abort-round"), "anna")
    assert rehearsals.document() == {
        "number": 1, "running": True, "done": 0, "of": 40, "by": "anna", "may_stop": False, "why": "", "result": None,
    }  # fmt: skip
    with pytest.raises(Busy, match="a rehearsal of anna is under way, 0 of 40 done"):
        rehearsals.begin(20, (AS_PLANNED,), "ben")
    mission.asked.set()
    until(lambda: not rehearsals.document()["running"], "the end of the rehearsal")
    assert rehearsals.document()["why"] == "expected an answer from the ground, got none"
    rehearsals.begin(2, (AS_PLANNED,), "ben")
    assert rehearsals.document()["number"] == 2


def test_what_cannot_be_rehearsed_is_refused_and_leaves_the_last_one() -> None:
    with pytest.raises(InvalidInput, match="got a recording, which cannot be rehearsed"):
        Rehearsals(Away(), None).begin(2, (AS_PLANNED,), "anna")
    rehearsals = Rehearsals(Away(), rehearse_live)
    with pytest.raises(InvalidInput, match="expected a planner among"):
        alternatives_of("planner x")
    rehearsals.close()
    assert rehearsals.document() == {"number": 0, "running": False}


def test_only_who_began_a_rehearsal_or_may_change_the_mission_stops_it() -> None:
    stopped: list[threading.Event] = []
    ended = threading.Event()

    def fly(*arguments: Any) -> tuple[Forecast, ...]:
        stopped.append(arguments[-1])
        stopped[-1].wait()
        ended.wait()
        raise He3Error("rehearsal: it was stopped")

    rehearsals = Rehearsals(Away(), fly)
    rehearsals.begin(2, (AS_PLANNED,), "viewer.anna")
    with pytest.raises(InvalidInput, match=r"only viewer\.anna, an operator or a controller may stop it"):
        rehearsals.stop(1, "viewer.ben", of_any=False)
    with pytest.raises(InvalidInput, match="expected the one that is under way, got number 2"):
        rehearsals.stop(2, "operator.carl", of_any=True)
    until(lambda: stopped, "the begin")
    assert not stopped[0].is_set()
    assert not rehearsals.document(by="viewer.ben")["may_stop"]
    assert rehearsals.document(by="viewer.anna")["may_stop"]
    assert rehearsals.document(by="operator.carl", of_any=True)["may_stop"]
    rehearsals.stop(1, "viewer.anna", of_any=False)
    assert stopped[0].is_set()
    ended.set()
    until(lambda: not rehearsals.document()["running"], "the end of the rehearsal")
    assert not rehearsals.document(by="viewer.anna")["may_stop"]
    with pytest.raises(InvalidInput, match="expected the one that is under way, got number 1"):
        rehearsals.stop(1, "viewer.anna", of_any=False)
    rehearsals.begin(2, (AS_PLANNED,), "viewer.ben")
    rehearsals.stop(2, "operator.carl", of_any=True)
    assert stopped[1].is_set()
