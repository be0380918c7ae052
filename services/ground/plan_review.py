"""Plan review: a round that is planned waits until the operator approves it, edits it, or sends it back."""

from __future__ import annotations

from collections.abc import Iterable
from math import isfinite
from typing import TYPE_CHECKING

from he3.driving import J_PER_WH
from he3.errors import InvalidInput
from schemas.plans import PlanDecision, PlanProposal, PlanReview, PlanVerdict
from services.ground.budget import Committed
from services.ground.round_plans import path_length_m
from services.runtime.node import Effect, Level, LogRecord, RefuseQuery, SendReply

if TYPE_CHECKING:
    from services.ground.authority import CommandAuthority
    from services.ground.budget import Budget
    from services.ground.director import Director
    from services.ground.driving_costs import DrivingCosts
    from services.ground.goal import MissionGoal
    from services.ground.planning import RoundPlanning
    from services.ground.round_plans import ProposedRound
    from services.mission.mission_time import MissionTime


class PlanReviewer:
    """Shows the plan that waits for approval, and carries out what the operator decides."""

    def __init__(
        self,
        planning: RoundPlanning,
        budget: Budget,
        costs: DrivingCosts,
        director: Director,
        authority: CommandAuthority,
        goal: MissionGoal,
    ) -> None:
        self._planning = planning
        self._budget = budget
        self._costs = costs
        self._director = director
        self._authority = authority
        self._goal = goal

    def shown(self) -> PlanReview:
        """The plan that waits, if there is one."""
        proposed = self._planning.proposed
        if proposed is None:
            return PlanReview()
        length_m, count = path_length_m(proposed.plan), len(proposed.plan.samples)
        figures = self._costs.figures(proposed.plan.path_m)
        lasts_s = self._budget.lasts_s(Committed(0.0, count, 1, figures))
        goal = self._goal.status()
        proposal = PlanProposal(
            proposal=proposed.number,
            plan=proposed.plan,
            length_m=length_m,
            lasts_s=lasts_s if isfinite(lasts_s) else None,
            drive_s=figures.duration_s,
            energy_wh=figures.energy_j / J_PER_WH,
            cost=self._costs.unit.of(figures),
            cost_unit=self._costs.unit.unit,
            last=proposed.task.samples_left <= count,
            goal=None if goal is None else goal.text,
            proposed_at=proposed.proposed_at,
        )
        return PlanReview(proposal=proposal)

    def decide(self, decision: PlanDecision, token: int, now: MissionTime) -> Iterable[Effect]:
        """Answer the operator's decision, and send the plan as it is or edited, revise it, or plan the round again."""
        try:
            proposed = self._proposed(decision)
            if decision.verdict is PlanVerdict.REVISE:
                self._director.revise_plan(proposed, decision.places_m, now)
            plan = self._planning.edited(proposed, decision.drop)
        except InvalidInput as error:
            yield RefuseQuery(token, str(error))
            return
        fields = {"proposal": decision.proposal, "by": decision.by, "dropped": len(decision.drop), "why": decision.why}
        yield LogRecord(Level.INFO, f"plan of round {proposed.task.number}: {decision.verdict.value}", fields)
        effects: list[Effect] = []
        if decision.verdict is PlanVerdict.SEND_BACK:
            effects = self._director.send_back(now)
        elif decision.verdict is PlanVerdict.APPROVE:
            effects = self._director.send_plan(proposed, plan, now)
        yield SendReply(token, self.shown())
        yield from effects

    def _proposed(self, decision: PlanDecision) -> ProposedRound:
        """The plan that the decision is about; raises InvalidInput if it does not wait, or another person commands."""
        proposed = self._planning.proposed
        if proposed is None or proposed.number != decision.proposal:
            waits = "no plan waits for approval" if proposed is None else f"proposal {proposed.number} waits"
            raise InvalidInput(f"plan: {waits}, got a decision on proposal {decision.proposal}")
        if (why := self._authority.objection_to(decision.by, f"decision of {decision.by}")) is not None:
            raise InvalidInput(why)
        return proposed
