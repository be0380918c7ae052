"""The operators' log: what is kept, in which order, and when a round is expected to begin and to end."""

from __future__ import annotations

import pytest

from schemas.authority import AuthorityAction, AuthorityChange
from schemas.ground import InterestChange
from schemas.mission_log import MAX_EVENTS, AlarmAction, AlarmKind, AlarmMark, LogKind
from schemas.plans import MissionPlan, PlannedSample, RoundPlan
from schemas.telemetry import EventKind, RoverEvent, RoverMode, RoverState
from services.ground.budget import Committed
from services.ground.operations_log import OperationsLog
from services.ground.round_log import RoundLog
from services.ground.state_types import STATE_TYPES
from services.mission.mission_time import SECOND
from services.runtime.node import RefuseQuery, Send, SendReply
from services.runtime.state_codec import StateCodec

NOW, LIGHT_S = 1_000 * SECOND, 10.0


class Budget:
    """A metre takes a second, a sample a minute."""

    def lasts_s(self, committed: Committed) -> float:
        return committed.metres + 60.0 * committed.samples


def log(rounds: RoundLog | None = None) -> OperationsLog:
    return OperationsLog(rounds or RoundLog(), Budget(), LIGHT_S)  # type: ignore[arg-type]


def plan(number: int, metres: float, samples: int = 1) -> RoundPlan:
    places = tuple(
        PlannedSample(sample_id=f"r{number}s{index}", x_m=metres, y_m=0.0, depth_m=1.0) for index in range(samples)
    )
    return RoundPlan(round=number, path_m=((0.0, 0.0), (metres, 0.0)), samples=places, information_nats=0.0)


def state(mode: RoverMode) -> RoverState:
    return RoverState(
        mode=mode, x_m=1.0, y_m=2.0, heading_deg=0.0, energy_wh=4000.0, capacity_wh=5000.0, driven_m=0.0,
        drilled_m=0.0, round=1, plan_revision=1, rounds_on_board=0, samples_done=0, queue_depth=0,
    )  # fmt: skip


def event(at: int) -> RoverEvent:
    return RoverEvent(kind=EventKind.CHARGED, at=at, x_m=1.0, y_m=2.0)


def sent(rounds: RoundLog, *plans: RoundPlan) -> MissionPlan:
    return MissionPlan(revision=len(rounds.chain), rounds=plans, samples_known=0, planned_at=NOW)


def test_a_round_begins_when_its_plan_has_arrived_or_the_rounds_before_it_are_done() -> None:
    rounds = RoundLog()
    kept = log(rounds)
    first, second = plan(1, 100.0), plan(2, 50.0, samples=2)
    rounds.append(first, 1)
    kept.planned(sent(rounds, first), NOW)
    rounds.append(second, 2)
    kept.planned(sent(rounds, first, second), NOW + SECOND)
    times = [(entry.round, entry.begins_at, entry.ends_at) for entry in kept.listed().entries]
    assert times == [
        (1, NOW + 10 * SECOND, NOW + 170 * SECOND),
        (2, NOW + 161 * SECOND, NOW + 331 * SECOND),
    ]


def test_what_people_change_is_kept_and_published_with_their_names() -> None:
    kept = log()
    triangle = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    effects = [
        kept.interest(InterestChange(area_id="rim", polygon_m=triangle, weight=3.0, by="anna"), NOW),
        kept.interest(InterestChange(area_id="rim"), NOW),
        kept.authority(AuthorityChange(action=AuthorityAction.TAKE, by="ben", over_from="anna"), NOW),
    ]
    assert [effect.body for effect in effects if isinstance(effect, Send)] == list(kept.listed().entries)
    assert [(entry.number, entry.kind, entry.text, entry.by) for entry in kept.listed().entries] == [
        (0, LogKind.INTEREST, "area of interest rim set with weight 3", "anna"),
        (1, LogKind.INTEREST, "area of interest rim removed", ""),
        (2, LogKind.AUTHORITY, "command authority taken over from anna", "ben"),
    ]


def mark(action: AlarmAction, until: int | None = None) -> AlarmMark:
    return AlarmMark(kind=AlarmKind.NO_CONTACT, action=action, by="anna", until=until, why="a pass is due")


def test_a_mark_on_an_alarm_is_answered_with_its_entry_and_one_into_the_past_is_refused() -> None:
    kept = log()
    refused = list(kept.mark(mark(AlarmAction.SHELVE, until=NOW), 7, NOW))
    assert isinstance(refused[0], RefuseQuery)
    assert (len(refused), kept.listed().entries) == (1, ())
    reply, published = kept.mark(mark(AlarmAction.SHELVE, until=NOW + 1800 * SECOND), 8, NOW)
    (entry,) = kept.listed().entries
    assert (reply, published) == (SendReply(8, entry), Send(published.topic, entry))  # type: ignore[union-attr]
    assert entry.text == "no-contact shelved for 30 min: a pass is due"
    with pytest.raises(ValueError, match="expected until with shelve and only there"):
        mark(AlarmAction.ACKNOWLEDGE, until=NOW)


def test_only_changes_of_the_mode_are_kept_and_none_that_was_overtaken() -> None:
    kept = log()
    for mode, made_at in (
        ("driving", 1),
        ("driving", 2),
        ("drilling", 5),
        ("driving", 4),
        ("drilling", 6),
        ("idle", 7),
    ):
        kept.reported(state(RoverMode(mode)), made_at, NOW + made_at)
    assert [(change.mode.value, change.made_at) for change in kept.listed().modes] == [
        ("driving", 1),
        ("drilling", 5),
        ("idle", 7),
    ]


def test_what_the_rover_did_during_a_silence_is_not_known() -> None:
    kept = log()
    for made_at_s in (10, 60, 60 + 400, 520):
        kept.reported(state(RoverMode.DRIVING), made_at_s * SECOND, NOW)
    assert [(change.made_at // SECOND, change.before_at) for change in kept.listed().modes] == [
        (10, None),
        (460, 60 * SECOND),
    ]


def test_the_log_is_bounded_and_survives_a_restart() -> None:
    kept = log()
    for at in range(MAX_EVENTS + 5):
        kept.happened(event(at), at + 1)
    kept.reported(state(RoverMode.IDLE), 1, 2)
    kept.interest(InterestChange(area_id="rim"), NOW)
    assert [heard.event.at for heard in kept.listed().events] == list(range(5, MAX_EVENTS + 5))
    codec = StateCodec(STATE_TYPES, {})
    again = log()
    again.restore(codec.decode(codec.encode(kept.checkpoint())))
    assert again.listed() == kept.listed()
    again.interest(InterestChange(area_id="rim"), NOW)
    assert again.listed().entries[-1].number == 1
