"""Whom virtual time waits for, and what is known of each."""

from __future__ import annotations

import pytest

from schemas.lockstep import StepBusy
from services.link.late import REPORT_AFTER_S, REPORT_COMPUTING_AFTER_S, SignsOfLife


class Clock:
    def __init__(self) -> None:
        self.s = 100.0

    def __call__(self) -> float:
        return self.s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def signs(clock: Clock) -> SignsOfLife:
    signs = SignsOfLife(clock)
    signs.begin_step()
    return signs


def busy(name: str, **why: object) -> StepBusy:
    return StepBusy(name=name, process=f"{name}.1", step=7, **why)


def test_nothing_is_overdue_before_the_bound_or_when_all_have_finished(clock: Clock, signs: SignsOfLife) -> None:
    clock.s += REPORT_AFTER_S
    assert not signs.overdue({"rover"})
    clock.s += 0.1
    assert signs.overdue({"rover"})
    assert not signs.overdue(set())
    signs.begin_step()
    assert not signs.overdue({"rover"})


def test_processes_that_compute_have_longer_if_all_that_are_waited_for_do(clock: Clock, signs: SignsOfLife) -> None:
    signs.busy(busy("ground", computing=("plan-3",)))
    clock.s += REPORT_AFTER_S + 1
    assert not signs.overdue({"ground"})
    assert signs.overdue({"ground", "rover"})
    clock.s += REPORT_COMPUTING_AFTER_S
    assert signs.overdue({"ground"})


def test_the_report_says_what_each_lacks_computes_or_when_it_was_last_heard_of(
    clock: Clock, signs: SignsOfLife
) -> None:
    signs.heard("rover")
    clock.s += 4.0
    signs.busy(busy("ground", computing=("plan-3", "score")))
    signs.busy(busy("link", lacks={"rover": 2, "ground": 1}))
    clock.s += 2.0
    assert signs.report(7, {"rover", "ground", "link", "field"}) == (
        "step 7 waits for field (not heard from yet), ground (computing plan-3, score), "
        "link (has not received 1 from ground, 2 from rover), rover (last heard from 6 s ago); mission time stands"
    )


def test_what_was_said_of_an_earlier_step_is_forgotten(clock: Clock, signs: SignsOfLife) -> None:
    signs.busy(busy("ground", computing=("plan-3",)))
    signs.begin_step()
    assert signs.report(8, {"ground"}) == "step 8 waits for ground (last heard from 0 s ago); mission time stands"
