"""The time keeper: who acts when, what is counted, who takes part, and how an operator lets time go on."""

from __future__ import annotations

import pytest

from he3.errors import InvalidInput
from schemas.lockstep import Join, StepDone, TimeControl
from services.mission.mission_time import SECOND
from services.runtime.lockstep.pace import CATCHES_UP_S, Pace
from services.runtime.lockstep.stamp import Stamp, read_stamp
from services.runtime.lockstep.time_manager import TimeManager

NEWS = ("moon/news", "moon")
MEASURE = ("moon/measure", "moon")


def joining(name: str, start: int = 1, next_wake: int | None = None, **more: object) -> Join:
    about = {"name": name, "process": f"{name}.{start}", "hears": (), "serves": (), "next_wake": next_wake}
    return Join(**{"term": "keeper/0", **about, **more})


def done(keeper: TimeManager, name: str, start: int = 1, next_wake: int | None = None, **more: object) -> bool:
    report = {"name": name, "process": f"{name}.{start}", "step": keeper.step, "next_wake": next_wake, **more}
    return keeper.done(StepDone(**report))


def keeper_of(*joins: Join, required: tuple[str, ...] = ()) -> TimeManager:
    """A time keeper whose members have all acted once, at time 0, and asked for what their joins say."""
    keeper = TimeManager(0, frozenset(required or (join.name for join in joins)))
    for join in joins:
        keeper.join(join)
    keeper.admit()
    keeper.grant(0)
    for join in joins:
        assert done(keeper, join.name, next_wake=join.next_wake)
    return keeper


# --- grants -----------------------------------------------------------------------------------------------------


def test_time_jumps_to_the_earliest_next_event_of_all_and_only_its_owner_acts() -> None:
    keeper = keeper_of(joining("rover", next_wake=70), joining("ground", next_wake=50))
    assert keeper.next_instant() == 50
    grants = keeper.grant(50)
    assert list(grants) == ["ground"]
    assert (grants["ground"].at, grants["ground"].process, grants["ground"].expects) == (50, "ground.1", {})


def test_time_stands_while_anybody_has_not_finished_a_step() -> None:
    keeper = keeper_of(joining("rover", next_wake=50), joining("ground", next_wake=50))
    keeper.grant(50)
    done(keeper, "rover")
    assert keeper.next_instant() is None
    done(keeper, "ground")
    assert keeper.next_instant() is None
    assert not keeper.outstanding, "nobody wants anything any more"


def test_a_grant_is_never_before_one_that_was_given_even_if_somebody_asks_for_the_past() -> None:
    keeper = keeper_of(joining("rover", next_wake=50))
    keeper.grant(50)
    done(keeper, "rover", next_wake=7)
    assert keeper.next_instant() == 50


def test_what_was_sent_is_expected_by_those_who_hear_it_in_the_next_step_at_the_same_time() -> None:
    keeper = keeper_of(
        joining("rover", next_wake=50),
        joining("field", hears=(NEWS,)),
        joining("link", hears=(NEWS,)),
        joining("ground"),
    )
    keeper.grant(50)
    done(keeper, "rover", published=((*NEWS, 3),))
    assert keeper.next_instant() == 50
    grants = keeper.grant(50)
    assert {name: grant.expects for name, grant in grants.items()} == {"field": {"rover": 3}, "link": {"rover": 3}}


def test_nobody_expects_his_own_messages() -> None:
    keeper = keeper_of(joining("rover", next_wake=50, hears=(NEWS,)))
    keeper.grant(50)
    done(keeper, "rover", published=((*NEWS, 1),))
    assert keeper.next_instant() is None


def test_a_message_on_the_other_side_is_not_heard() -> None:
    keeper = keeper_of(joining("rover", next_wake=50), joining("ground", hears=(("moon/news", "earth"),)))
    keeper.grant(50)
    done(keeper, "rover", published=((*NEWS, 1),))
    assert keeper.next_instant() is None


def test_a_question_is_expected_by_who_serves_it_and_its_answer_by_who_asked() -> None:
    keeper = keeper_of(joining("rover", next_wake=50), joining("field", serves=(MEASURE,)))
    keeper.grant(50)
    done(keeper, "rover", asked=(MEASURE, MEASURE))
    assert keeper.grant(50)["field"].expects == {"rover": 2}
    done(keeper, "field", answered=(("rover.1", keeper.step - 1),) * 2)
    assert keeper.grant(50)["rover"].expects == {"field": 2}


def test_a_question_that_nobody_serves_comes_back_to_its_asker() -> None:
    keeper = keeper_of(joining("rover", next_wake=50))
    keeper.grant(50)
    done(keeper, "rover", asked=(MEASURE,))
    assert keeper.grant(50)["rover"].expects == {"rover": 1}


def test_whom_an_operator_has_written_to_acts_now() -> None:
    keeper = keeper_of(joining("rover", next_wake=50), joining("ground"))
    keeper.poke("ground", "ground.1")
    assert keeper.next_instant() == 0
    assert list(keeper.grant(0)) == ["ground"]


def test_a_poke_during_a_step_is_not_lost() -> None:
    keeper = keeper_of(joining("rover", next_wake=50))
    keeper.grant(50)
    keeper.poke("rover", "rover.1")
    done(keeper, "rover", next_wake=90)
    assert keeper.next_instant() == 50


def test_time_may_pass_between_two_instants_but_not_beyond_the_next() -> None:
    keeper = keeper_of(joining("rover", next_wake=50))
    keeper.advance(20)
    assert (keeper.now, keeper.next_instant()) == (20, 50)
    keeper.advance(60)
    assert (keeper.now, keeper.next_instant()) == (50, 50)
    keeper.advance(10)
    assert keeper.now == 50


# --- who takes part ---------------------------------------------------------------------------------------------


def test_time_does_not_begin_before_all_who_are_required_take_part() -> None:
    keeper = TimeManager(0, frozenset({"rover", "ground"}))
    keeper.join(joining("rover", next_wake=5))
    keeper.admit()
    assert (keeper.next_instant(), keeper.missing()) == (None, ["ground"])
    keeper.join(joining("ground"))
    keeper.admit()
    assert keeper.next_instant() == 0
    assert set(keeper.grant(0)) == {"rover", "ground"}, "everybody begins"


def test_an_onlooker_that_was_to_be_waited_for_is_not_once_it_is_known_as_one() -> None:
    keeper = keeper_of(joining("rover", next_wake=50), required=("rover", "recorder"))
    assert keeper.next_instant() is None
    keeper.excuse("recorder")
    assert keeper.next_instant() == 50


def test_who_comes_during_a_step_takes_part_from_the_next_and_is_owed_nothing_of_this_one() -> None:
    keeper = keeper_of(joining("rover", next_wake=50))
    keeper.grant(50)
    keeper.join(joining("field", hears=(NEWS,)))
    assert keeper.admit() == []
    done(keeper, "rover", published=((*NEWS, 1),))
    assert [join.name for join in keeper.admit()] == ["field"]
    assert keeper.grant(50)["field"].expects == {}


def test_who_asks_again_whether_it_takes_part_is_told_so_and_nothing_changes() -> None:
    keeper = keeper_of(joining("rover", next_wake=50))
    keeper.join(joining("rover", next_wake=60))
    assert [join.name for join in keeper.admit()] == ["rover"]
    assert (keeper.next_instant(), keeper.answer(joining("rover"), True).starts) == (50, 1)


def test_time_stands_when_a_required_process_dies_and_goes_on_when_it_is_back() -> None:
    keeper = keeper_of(joining("rover", next_wake=50), joining("ground", next_wake=60))
    keeper.grant(50)
    assert keeper.leave("rover.1") == "rover"
    assert (keeper.next_instant(), keeper.missing(), keeper.outstanding) == (None, ["rover"], set())
    keeper.join(joining("rover", start=2))
    keeper.admit()
    assert keeper.next_instant() == 50
    assert set(keeper.grant(50)) == {"rover", "ground"}, "what the dead one sent in its last step is handled at once"
    assert keeper.answer(joining("rover"), True).starts == 2


def test_time_goes_on_without_a_process_that_is_not_required() -> None:
    keeper = keeper_of(joining("rover", next_wake=50), joining("guest"), required=("rover",))
    keeper.leave("guest.1")
    done(keeper, "rover", next_wake=50)
    assert keeper.next_instant() == 0
    assert keeper.missing() == []


def test_a_new_process_takes_the_place_of_a_hung_one_whose_reports_count_no_more() -> None:
    keeper = keeper_of(joining("rover", next_wake=50), joining("field", hears=(NEWS,)))
    keeper.grant(50)
    keeper.join(joining("rover", start=2))
    keeper.admit()
    assert not done(keeper, "rover", start=1, published=((*NEWS, 1),))
    grants = keeper.grant(50)
    assert grants["rover"].process == "rover.2"
    assert grants["field"].expects == {}


def test_a_process_that_was_replaced_is_refused_when_it_asks_again() -> None:
    keeper = keeper_of(joining("rover"))
    keeper.join(joining("rover", start=2))
    keeper.admit()
    with pytest.raises(InvalidInput, match=r"another process has taken part as rover since: rover\.2"):
        keeper.join(joining("rover", start=1))
    assert keeper.members["rover"].process == "rover.2"


def test_a_process_that_was_thought_gone_takes_part_again() -> None:
    keeper = keeper_of(joining("rover", next_wake=50))
    keeper.leave("rover.1")
    assert not keeper.join(joining("rover", next_wake=50)), "it may still act upon what it was granted before"
    assert keeper.answer(joining("rover"), admitted=False).term == "keeper/1"
    assert keeper.join(joining("rover", next_wake=50, term="keeper/1"))
    keeper.admit()
    assert (keeper.missing(), keeper.answer(joining("rover"), True).starts) == ([], 1)


def test_the_late_news_that_an_earlier_process_is_gone_does_not_concern_its_successor() -> None:
    keeper = keeper_of(joining("rover"))
    keeper.join(joining("rover", start=2))
    keeper.admit()
    assert keeper.leave("rover.1") is None
    assert keeper.missing() == []


def test_an_answer_to_an_earlier_process_is_not_owed_to_its_successor() -> None:
    keeper = keeper_of(joining("rover", next_wake=50), joining("field", serves=(MEASURE,), next_wake=70))
    keeper.grant(50)
    done(keeper, "rover", asked=(MEASURE,))
    keeper.grant(50)
    keeper.leave("rover.1")
    done(keeper, "field", next_wake=70)
    keeper.join(joining("rover", start=2))
    keeper.admit()
    keeper.grant(50)
    done(keeper, "rover", start=2)
    done(keeper, "field", answered=(("rover.1", 2),))
    assert keeper.next_instant() is None


def test_a_process_that_has_been_further_than_a_new_time_keeper_takes_it_along() -> None:
    keeper = TimeManager(0, frozenset({"rover"}))
    keeper.join(joining("rover", next_wake=70, now=60, step=12))
    keeper.admit()
    assert keeper.next_instant() == 60
    assert keeper.grant(60)["rover"].step == 13


def test_an_answer_to_a_question_from_before_its_asker_was_given_up_is_not_owed() -> None:
    keeper = keeper_of(joining("rover", next_wake=50), joining("field", serves=(MEASURE,), next_wake=70))
    keeper.grant(50)
    asked_in = keeper.step
    done(keeper, "rover", asked=(MEASURE,))
    keeper.grant(50)
    keeper.leave("rover.1")
    keeper.join(joining("rover", term="keeper/1"))
    done(keeper, "field", answered=(("rover.1", asked_in),))
    keeper.admit()
    assert keeper.grant(50)["rover"].expects == {}
    done(keeper, "rover")
    done(keeper, "field", answered=(("rover.1", asked_in),))
    assert keeper.next_instant() is None


def test_an_answer_of_somebody_who_was_given_up_since_he_was_asked_is_not_owed() -> None:
    keeper = keeper_of(joining("rover", next_wake=50), joining("field", serves=(MEASURE,), next_wake=70))
    keeper.grant(50)
    asked_in = keeper.step
    done(keeper, "rover", asked=(MEASURE,))
    keeper.leave("field.1")
    keeper.join(joining("field", serves=(MEASURE,), term="keeper/1"))
    keeper.admit()
    keeper.grant(50)
    done(keeper, "rover")
    done(keeper, "field", answered=(("rover.1", asked_in),))
    assert keeper.next_instant() is None


def test_who_obeys_another_time_keeper_is_not_taken_in() -> None:
    keeper = TimeManager(0, frozenset({"rover"}))
    assert not keeper.join(joining("rover", term="another/0"))
    assert keeper.admit() == []
    assert keeper.missing() == ["rover"]


def test_two_processes_that_serve_the_same_are_refused_in_one_line() -> None:
    keeper = keeper_of(joining("field", serves=(MEASURE,)))
    with pytest.raises(InvalidInput, match=r"mock: expected .* got moon/measure on moon, which field serves"):
        keeper.join(joining("mock", serves=(MEASURE,)))


def test_a_report_of_another_step_is_passed_over() -> None:
    keeper = keeper_of(joining("rover", next_wake=50))
    keeper.grant(50)
    assert not keeper.done(StepDone(name="rover", process="rover.1", step=keeper.step - 1, next_wake=None))
    assert keeper.outstanding == {"rover"}


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
def test_whatever_else_is_attached_marks_a_message_from_outside(attachment: bytes) -> None:
    assert read_stamp(attachment) is None
