"""Plans that wait for the approval of an operator."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from he3.errors import He3Error
from schemas.commands import CommandKind, NoParameters
from schemas.plans import PlanDecision, PlanProposal, PlanReview, PlanVerdict
from schemas.topics import (
    DECIDE_PLAN,
    ISSUE_COMMAND,
    SHOW_PLAN,
)
from services.ground.node import build_node
from services.mission.mission_time import seconds
from services.runtime.node import (
    Finish,
    QueryReceived,
    SendReply,
)
from services.runtime.state_codec import StateCodec
from tests.unit.ground.stand_in_mission import Mission, command, scenario, straight


class Reviewed(Mission):
    """A mission in which every plan waits for an operator."""

    def __init__(self, **ground: object) -> None:
        super().__init__(scenario(ground={"approval": "operator", **ground}))

    def waits(self) -> PlanProposal:
        """The plan that waits, once there is one."""
        limit = self.simulation.now + seconds(10 * 3600.0)
        self.simulation.run(until=limit, stop=lambda: self.shown() is not None)
        proposal = self.shown()
        assert proposal is not None
        return proposal

    def shown(self) -> PlanProposal | None:
        review: PlanReview = self.simulation.ask(SHOW_PLAN, NoParameters())
        return review.proposal

    def decide(self, proposal: PlanProposal, verdict: str = "approve", **changes: Any) -> PlanReview:
        decision = PlanDecision(proposal=proposal.proposal, verdict=PlanVerdict(verdict), by="anna", **changes)
        review: PlanReview = self.simulation.ask(DECIDE_PLAN, decision)
        return review


def test_a_plan_waits_for_its_approval_however_long_and_the_mission_says_so() -> None:
    mission = Reviewed(patience_h=1.0)
    proposal = mission.waits()
    mission.simulation.run_for(20 * 3600.0)
    assert mission.rover.plans == []
    assert mission.shown() == proposal
    assert mission.status.proposal == proposal.proposal
    assert mission.status.detail == "the plan of round 1 waits for approval"
    assert not mission.simulation.finished
    assert mission.decide(proposal) == PlanReview()
    mission.simulation.run_for(10.0)
    assert [planned for _, plan in mission.rover.plans for planned in plan.rounds] == [proposal.plan]
    while "ground" not in mission.simulation.finished:
        mission.simulation.run_for(600.0)
        if (following := mission.shown()) is not None:
            mission.decide(following)
    assert mission.simulation.finished["ground"] == Finish(True, "12 of 12 samples are in the map")
    assert [plan.last for _, plan in mission.rover.plans] == [False, False, False, True]


def test_dropped_samples_are_not_taken_and_others_replace_them_in_later_rounds() -> None:
    mission = Reviewed()
    proposal = mission.waits()
    assert proposal.length_m == pytest.approx(float(np.hypot(*np.diff(proposal.plan.path_m, axis=0).T).sum()))
    dropped = proposal.plan.samples[1].sample_id
    for drop, complaint in (
        (("r09s9",), "expected samples among r01s1, r01s2, r01s3, got r09s9"),
        (tuple(sample.sample_id for sample in proposal.plan.samples), "at least one sample that is kept"),
    ):
        with pytest.raises(He3Error, match=complaint):
            mission.decide(proposal, drop=drop)
    mission.decide(proposal, drop=(dropped,))
    mission.simulation.run_for(10.0)
    sent = mission.rover.plans[0][1].rounds[0]
    assert [sample.sample_id for sample in sent.samples] == ["r01s1", "r01s3"]
    assert sent.path_m == proposal.plan.path_m
    assert sent.information_nats > 0
    rounds = 1
    while "ground" not in mission.simulation.finished:
        mission.simulation.run_for(600.0)
        if (following := mission.shown()) is not None:
            rounds += 1
            mission.decide(following)
    taken = [sample.sample_id for sample in mission.snapshot.samples]
    assert (len(taken), dropped in taken, rounds) == (12, False, 5)


def test_a_revised_plan_samples_the_places_that_the_operator_chose_and_waits_for_approval_again() -> None:
    mission = Reviewed(budget_m=300.0)
    mission.waits()
    corner = ((0.2, 0.2), (2.8, 0.2), (2.8, 2.8), (0.2, 2.8))
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.SET_KEEP_OUT, area_id="corner", polygon_m=corner))
    proposal = mission.waits()
    first, second, third = ((sample.x_m, sample.y_m) for sample in proposal.plan.samples)
    start, grid = proposal.plan.path_m[0], mission.snapshot.grid
    far = ((grid.width_m - 0.5, grid.height_m - 0.5), (grid.width_m - 0.5, 0.5))
    for places, complaint in (
        (((1e3, 1.0),), r"plan: expected places within the region, got \(1000, 1\) m"),
        (((1.5, 1.5),), r"plan: expected a place on open ground, got \(1.5, 1.5\) m"),
        ((first,) * 13, "plan: expected 1 to 12 places to sample, as many as are left, got 13"),
        (far * 6, r"plan: expected [\d.]+ m at most, got"),
    ):
        with pytest.raises(He3Error, match=complaint):
            mission.decide(proposal, "revise", places_m=places)
        assert mission.shown() == proposal
    added = (start[0] + 1.0, start[1])
    chosen = (added, third, first, second)
    revised = mission.decide(proposal, "revise", places_m=chosen).proposal
    assert revised is not None
    assert revised.proposal > proposal.proposal
    assert [(sample.x_m, sample.y_m) for sample in revised.plan.samples] == [pytest.approx(place) for place in chosen]
    assert revised.plan.path_m[0] == start
    assert revised.plan.information_nats > 0
    assert revised.length_m > proposal.length_m
    assert mission.rover.plans == []
    with pytest.raises(He3Error, match="got a decision on proposal"):
        mission.decide(proposal)
    mission.decide(revised)
    mission.simulation.run_for(10.0)
    assert mission.rover.plans[0][1].rounds[0] == revised.plan
    waits = mission.waits()
    assert {sample.sample_id for sample in waits.plan.samples}.isdisjoint(
        sample.sample_id for sample in revised.plan.samples
    )


def test_a_plan_that_is_sent_back_is_made_again_and_a_decision_on_the_former_one_is_refused() -> None:
    mission = Reviewed()
    first = mission.waits()
    mission.decide(first, "send_back")
    second = mission.waits()
    assert second.plan.round == first.plan.round
    assert second.plan.samples != first.plan.samples
    with pytest.raises(He3Error, match=f"proposal {second.proposal} waits, got a decision on proposal"):
        mission.decide(first)
    mission.decide(second)
    with pytest.raises(He3Error, match="no plan waits for approval"):
        mission.decide(second)


def test_a_plan_that_waits_is_made_again_when_its_ground_is_closed() -> None:
    mission = Reviewed()
    first = mission.waits()
    x, y = first.plan.path_m[-1]
    around_end = ((x - 1, y - 1), (x + 1, y - 1), (x + 1, y + 1), (x - 1, y + 1))
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.SET_KEEP_OUT, area_id="a", polygon_m=around_end))
    assert mission.shown() is None
    assert mission.waits().proposal != first.proposal


def test_a_plan_that_waits_is_in_a_checkpoint() -> None:
    mission = Reviewed()
    proposal = mission.waits()
    other = build_node(scenario(ground={"approval": "operator"}), mission.region, straight)
    codec = StateCodec((*other.state_types, Finish), other.functions)
    other.restore(codec.decode(codec.encode(mission.ground.checkpoint())))
    effects = list(other.handle(QueryReceived(SHOW_PLAN, NoParameters(), 1), mission.simulation.now))
    assert SendReply(1, PlanReview(proposal=proposal)) in effects
