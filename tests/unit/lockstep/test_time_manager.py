"""The time manager: which process acts when, what is counted, which takes part, and how an operator controls time."""

from __future__ import annotations

import pytest

from he3.errors import InvalidInput
from schemas.lockstep import Join, StepDone, TimeControl
from services.mission.mission_time import SECOND
from services.runtime.lockstep.pace import CATCHES_UP_S, Pace
from services.runtime.lockstep.time_manager import TimeManager
from services.runtime.stamp import Stamp, read_stamp

NEWS = ("moon/news", "moon")
MEASURE = ("moon/measure", "moon")


def joining(name: str, start: int = 1, next_wake: int | None = None, **more: object) -> Join:
    about = {"name": name, "process": f"{name}.{start}", "hears": (), "serves": (), "next_wake": next_wake}
    return Join(**{"term": "manager/0", **about, **more})


def done(manager: TimeManager, name: str, start: int = 1, next_wake: int | None = None, **more: object) -> bool:
    report = {"name": name, "process": f"{name}.{start}", "step": manager.step, "next_wake": next_wake, **more}
    return manager.done(StepDone(**report))


def manager_of(*joins: Join, required: tuple[str, ...] = ()) -> TimeManager:
    """A time manager whose members have all acted once, at time 0, and next act when their requests say."""
    manager = TimeManager(0, frozenset(required or (join.name for join in joins)))
    for join in joins:
        manager.join(join)
    manager.admit()
    manager.grant(0)
    for join in joins:
        assert done(manager, join.name, next_wake=join.next_wake)
    return manager


# --- grants -----------------------------------------------------------------------------------------------------


def test_time_jumps_to_the_earliest_next_event_of_all_and_only_its_owner_acts() -> None:
    manager = manager_of(joining("rover", next_wake=70), joining("ground", next_wake=50))
    assert manager.next_instant() == 50
    grants = manager.grant(50)
    assert list(grants) == ["ground"]
    assert (grants["ground"].at, grants["ground"].process, grants["ground"].expects) == (50, "ground.1", {})


def test_time_stands_while_a_process_has_not_finished_a_step() -> None:
    manager = manager_of(joining("rover", next_wake=50), joining("ground", next_wake=50))
    manager.grant(50)
    done(manager, "rover")
    assert manager.next_instant() is None
    done(manager, "ground")
    assert manager.next_instant() is None
    assert not manager.outstanding, "no process wants to act again"


def test_a_grant_is_never_before_an_earlier_one_even_if_a_process_asks_for_the_past() -> None:
    manager = manager_of(joining("rover", next_wake=50))
    manager.grant(50)
    done(manager, "rover", next_wake=7)
    assert manager.next_instant() == 50


def test_a_message_is_expected_by_its_receivers_in_the_next_step_at_the_same_time() -> None:
    manager = manager_of(
        joining("rover", next_wake=50),
        joining("field", hears=(NEWS,)),
        joining("link", hears=(NEWS,)),
        joining("ground"),
    )
    manager.grant(50)
    done(manager, "rover", published=((*NEWS, 3),))
    assert manager.next_instant() == 50
    grants = manager.grant(50)
    assert {name: grant.expects for name, grant in grants.items()} == {"field": {"rover": 3}, "link": {"rover": 3}}


def test_a_process_does_not_expect_its_own_messages() -> None:
    manager = manager_of(joining("rover", next_wake=50, hears=(NEWS,)))
    manager.grant(50)
    done(manager, "rover", published=((*NEWS, 1),))
    assert manager.next_instant() is None


def test_a_message_on_the_other_side_is_not_expected() -> None:
    manager = manager_of(joining("rover", next_wake=50), joining("ground", hears=(("moon/news", "earth"),)))
    manager.grant(50)
    done(manager, "rover", published=((*NEWS, 1),))
    assert manager.next_instant() is None


def test_a_query_is_expected_by_its_server_and_its_reply_by_its_sender() -> None:
    manager = manager_of(joining("rover", next_wake=50), joining("field", serves=(MEASURE,)))
    manager.grant(50)
    done(manager, "rover", asked=(MEASURE, MEASURE))
    assert manager.grant(50)["field"].expects == {"rover": 2}
    done(manager, "field", answered=(("rover.1", manager.step - 1),) * 2)
    assert manager.grant(50)["rover"].expects == {"field": 2}


def test_a_query_without_a_server_is_expected_by_its_own_sender() -> None:
    manager = manager_of(joining("rover", next_wake=50))
    manager.grant(50)
    done(manager, "rover", asked=(MEASURE,))
    assert manager.grant(50)["rover"].expects == {"rover": 1}


def test_a_process_that_an_operator_has_sent_something_acts_now() -> None:
    manager = manager_of(joining("rover", next_wake=50), joining("ground"))
    manager.poke("ground", "ground.1")
    assert manager.next_instant() == 0
    assert list(manager.grant(0)) == ["ground"]


def test_a_poke_during_a_step_is_not_lost() -> None:
    manager = manager_of(joining("rover", next_wake=50))
    manager.grant(50)
    manager.poke("rover", "rover.1")
    done(manager, "rover", next_wake=90)
    assert manager.next_instant() == 50


def test_time_may_pass_between_two_instants_but_not_beyond_the_next() -> None:
    manager = manager_of(joining("rover", next_wake=50))
    manager.advance(20)
    assert (manager.now, manager.next_instant()) == (20, 50)
    manager.advance(60)
    assert (manager.now, manager.next_instant()) == (50, 50)
    manager.advance(10)
    assert manager.now == 50


# --- who takes part ---------------------------------------------------------------------------------------------


def test_time_does_not_begin_before_all_required_processes_take_part() -> None:
    manager = TimeManager(0, frozenset({"rover", "ground"}))
    manager.join(joining("rover", next_wake=5))
    manager.admit()
    assert (manager.next_instant(), manager.missing()) == (None, ["ground"])
    manager.join(joining("ground"))
    manager.admit()
    assert manager.next_instant() == 0
    assert set(manager.grant(0)) == {"rover", "ground"}, "everybody begins"


def test_a_required_process_that_proves_to_be_an_onlooker_is_not_waited_for() -> None:
    manager = manager_of(joining("rover", next_wake=50), required=("rover", "recorder"))
    assert manager.next_instant() is None
    manager.excuse("recorder")
    assert manager.next_instant() == 50


def test_a_process_that_joins_during_a_step_takes_part_from_the_next_and_expects_nothing_of_this_one() -> None:
    manager = manager_of(joining("rover", next_wake=50))
    manager.grant(50)
    manager.join(joining("field", hears=(NEWS,)))
    assert manager.admit() == []
    done(manager, "rover", published=((*NEWS, 1),))
    assert [join.name for join in manager.admit()] == ["field"]
    assert manager.grant(50)["field"].expects == {}


def test_a_member_that_asks_again_whether_it_takes_part_is_told_so_and_nothing_changes() -> None:
    manager = manager_of(joining("rover", next_wake=50))
    manager.join(joining("rover", next_wake=60))
    assert [join.name for join in manager.admit()] == ["rover"]
    assert (manager.next_instant(), manager.answer(joining("rover"), True).starts) == (50, 1)


def test_time_stands_when_a_required_process_dies_and_goes_on_when_it_is_back() -> None:
    manager = manager_of(joining("rover", next_wake=50), joining("ground", next_wake=60))
    manager.grant(50)
    assert manager.leave("rover.1") == "rover"
    assert (manager.next_instant(), manager.missing(), manager.outstanding) == (None, ["rover"], set())
    manager.join(joining("rover", start=2))
    manager.admit()
    assert manager.next_instant() == 50
    assert set(manager.grant(50)) == {"rover", "ground"}, "what the dead one sent in its last step is handled at once"
    assert manager.answer(joining("rover"), True).starts == 2


def test_time_goes_on_without_a_process_that_is_not_required() -> None:
    manager = manager_of(joining("rover", next_wake=50), joining("guest"), required=("rover",))
    manager.leave("guest.1")
    done(manager, "rover", next_wake=50)
    assert manager.next_instant() == 0
    assert manager.missing() == []


def test_a_new_process_replaces_one_that_hangs_and_the_reports_of_that_one_do_not_count() -> None:
    manager = manager_of(joining("rover", next_wake=50), joining("field", hears=(NEWS,)))
    manager.grant(50)
    manager.join(joining("rover", start=2))
    manager.admit()
    assert not done(manager, "rover", start=1, published=((*NEWS, 1),))
    grants = manager.grant(50)
    assert grants["rover"].process == "rover.2"
    assert grants["field"].expects == {}


def test_a_process_that_was_replaced_is_refused_when_it_asks_again() -> None:
    manager = manager_of(joining("rover"))
    manager.join(joining("rover", start=2))
    manager.admit()
    with pytest.raises(InvalidInput, match=r"another process has taken part as rover since: rover\.2"):
        manager.join(joining("rover", start=1))
    assert manager.members["rover"].process == "rover.2"


def test_a_process_that_was_given_up_takes_part_again() -> None:
    manager = manager_of(joining("rover", next_wake=50))
    manager.leave("rover.1")
    assert not manager.join(joining("rover", next_wake=50)), "it may still act upon what it was granted before"
    assert manager.answer(joining("rover"), admitted=False).term == "manager/1"
    assert manager.join(joining("rover", next_wake=50, term="manager/1"))
    manager.admit()
    assert (manager.missing(), manager.answer(joining("rover"), True).starts) == ([], 1)


def test_the_late_news_that_an_earlier_process_is_gone_does_not_concern_its_successor() -> None:
    manager = manager_of(joining("rover"))
    manager.join(joining("rover", start=2))
    manager.admit()
    assert manager.leave("rover.1") is None
    assert manager.missing() == []


def test_a_reply_to_an_earlier_process_is_not_expected_by_its_successor() -> None:
    manager = manager_of(joining("rover", next_wake=50), joining("field", serves=(MEASURE,), next_wake=70))
    manager.grant(50)
    done(manager, "rover", asked=(MEASURE,))
    manager.grant(50)
    manager.leave("rover.1")
    done(manager, "field", next_wake=70)
    manager.join(joining("rover", start=2))
    manager.admit()
    manager.grant(50)
    done(manager, "rover", start=2)
    done(manager, "field", answered=(("rover.1", 2),))
    assert manager.next_instant() is None


def test_a_process_that_is_ahead_of_a_new_time_manager_sets_its_time_and_step() -> None:
    manager = TimeManager(0, frozenset({"rover"}))
    manager.join(joining("rover", next_wake=70, now=60, step=12))
    manager.admit()
    assert manager.next_instant() == 60
    assert manager.grant(60)["rover"].step == 13


def test_a_reply_to_a_query_from_before_its_sender_was_given_up_is_not_expected() -> None:
    manager = manager_of(joining("rover", next_wake=50), joining("field", serves=(MEASURE,), next_wake=70))
    manager.grant(50)
    asked_in = manager.step
    done(manager, "rover", asked=(MEASURE,))
    manager.grant(50)
    manager.leave("rover.1")
    manager.join(joining("rover", term="manager/1"))
    done(manager, "field", answered=(("rover.1", asked_in),))
    manager.admit()
    assert manager.grant(50)["rover"].expects == {}
    done(manager, "rover")
    done(manager, "field", answered=(("rover.1", asked_in),))
    assert manager.next_instant() is None


def test_a_reply_of_a_server_that_was_given_up_since_the_query_is_not_expected() -> None:
    manager = manager_of(joining("rover", next_wake=50), joining("field", serves=(MEASURE,), next_wake=70))
    manager.grant(50)
    asked_in = manager.step
    done(manager, "rover", asked=(MEASURE,))
    manager.leave("field.1")
    manager.join(joining("field", serves=(MEASURE,), term="manager/1"))
    manager.admit()
    manager.grant(50)
    done(manager, "rover")
    done(manager, "field", answered=(("rover.1", asked_in),))
    assert manager.next_instant() is None


def test_a_process_that_obeys_another_time_manager_is_not_admitted() -> None:
    manager = TimeManager(0, frozenset({"rover"}))
    assert not manager.join(joining("rover", term="another/0"))
    assert manager.admit() == []
    assert manager.missing() == ["rover"]


def test_a_second_server_of_a_query_is_refused_in_one_line() -> None:
    manager = manager_of(joining("field", serves=(MEASURE,)))
    with pytest.raises(InvalidInput, match=r"mock: expected .* got moon/measure on moon, which field serves"):
        manager.join(joining("mock", serves=(MEASURE,)))


def test_a_report_on_another_step_is_ignored() -> None:
    manager = manager_of(joining("rover", next_wake=50))
    manager.grant(50)
    assert not manager.done(StepDone(name="rover", process="rover.1", step=manager.step - 1, next_wake=None))
    assert manager.outstanding == {"rover"}


# --- pace -------------------------------------------------------------------------------------------------------


def test_a_paused_mission_stays_where_it_is() -> None:
    pace = Pace()
    pace.control(TimeControl(paused=True), now=5, wall_s=0.0)
    assert pace.latest(50, 5, 1.0) == 5
    pace.control(TimeControl(paused=False), now=5, wall_s=2.0)
    assert pace.latest(50, 5, 3.0) == 50


def test_single_steps_pause_before_the_instant_after_the_last() -> None:
    pace = Pace(paused=True)
    pace.control(TimeControl(steps=2), now=0, wall_s=0.0)
    for instant in (10, 20):
        assert pace.latest(instant, instant - 10, 0.0) == instant
        pace.stepped()
    assert pace.latest(30, 20, 0.0) == 20
    assert pace.paused


def test_time_passes_up_to_where_the_operator_wanted_it_to_stop() -> None:
    pace = Pace()
    pace.control(TimeControl(until=25), now=0, wall_s=0.0)
    assert pace.latest(20, 0, 0.0) == 20
    assert not pace.paused
    assert pace.latest(30, 20, 0.0) == 25
    assert pace.paused
    pace.control(TimeControl(until=30), now=25, wall_s=0.0)
    assert pace.latest(30, 25, 0.0) == 30, "what happens at that very time still does"


@pytest.mark.parametrize(
    ("first", "second"),
    [(TimeControl(steps=1), TimeControl(until=40)), (TimeControl(until=20), TimeControl(steps=4))],
)
def test_of_two_ends_that_the_operator_sets_the_newer_one_counts(first: TimeControl, second: TimeControl) -> None:
    pace = Pace()
    pace.control(first, now=0, wall_s=0.0)
    pace.control(second, now=0, wall_s=0.0)
    now = 0
    for instant in (10, 20, 30, 40, 50):
        now = pace.latest(instant, now, 0.0)
        pace.stepped()
    assert now == 40
    assert pace.paused


def test_an_end_that_has_passed_is_refused_and_changes_nothing() -> None:
    pace = Pace(rate=100.0)
    with pytest.raises(
        InvalidInput, match=r"expected a time from 1970-01-01T00:00:25Z on, the present one, got .*:20Z"
    ):
        pace.control(TimeControl(until=20 * SECOND, unlimited=True), now=25 * SECOND, wall_s=0.0)
    assert (pace.paused, pace.until, pace.rate) == (False, None, 100.0)
    pace.control(TimeControl(until=25 * SECOND, unlimited=True), now=25 * SECOND, wall_s=0.0)
    assert pace.latest(30 * SECOND, 25 * SECOND, 0.0) == 25 * SECOND, "the present time is no past one"
    assert pace.paused


def test_a_rate_lets_no_more_mission_time_pass_than_wall_time_allows() -> None:
    pace = Pace()
    pace.control(TimeControl(rate=100.0), now=0, wall_s=10.0)
    assert pace.latest(500 * SECOND, 0, 10.25) == 25 * SECOND
    assert pace.wait_s(500 * SECOND, 10.25, at_most_s=9.0) == pytest.approx(4.75)
    assert pace.latest(500 * SECOND, 25 * SECOND, 10.5) == 50 * SECOND
    pace.control(TimeControl(unlimited=True), now=50 * SECOND, wall_s=10.5)
    assert pace.latest(500 * SECOND, 50 * SECOND, 10.5) == 500 * SECOND


def test_time_that_was_lost_to_planning_is_not_made_up_for_all_at_once() -> None:
    pace = Pace()
    pace.control(TimeControl(rate=100.0), now=0, wall_s=0.0)
    most = round(CATCHES_UP_S * 100 * SECOND)
    assert pace.latest(10**6 * SECOND, 0, 60.0) == most
    assert pace.latest(10**6 * SECOND, most, 60.1) == most + 10 * SECOND


# --- stamps -----------------------------------------------------------------------------------------------------


def test_a_stamp_comes_back_as_it_was() -> None:
    stamp = Stamp("rover", "rover.17.ab", 3, 12, 1893456000000000000)
    assert read_stamp(stamp.encode()) == stamp


@pytest.mark.parametrize(
    "attachment",
    [
        b"",
        b"rover",
        b"rover\tp\t1\t2",
        b"rover\tp\t1\t2\t-3",
        b"rover\tp\tx\t2\t3",
        b"\tp\t1\t2\t3",
        b"\xff\tp\t1\t2\t3",
        b"rover\tp\t1\t2\t3\t4",
        b"r" * 10_000 + b"\tp\t1\t2\t3",
        "rover\tp\t²\t2\t3".encode(),
    ],
)
def test_any_other_attachment_marks_a_message_from_outside(attachment: bytes) -> None:
    assert read_stamp(attachment) is None
