"""Plan review: the plan that waits for the operator, and the operator's decision on it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from he3.errors import InvalidInput
from schemas.commands import NoParameters
from schemas.plans import PlanDecision, PlanReview, PlanVerdict
from schemas.topics import DECIDE_PLAN, SHOW_PLAN
from schemas.validation import one_line
from services.console.client.commands import Commanding

if TYPE_CHECKING:
    from he3.frames import Place
    from schemas.plans import PlanProposal


class PlanReviewing(Commanding):
    """The part of `MissionClient` that reviews plans, in a mission with `ground.approval = "operator"`."""

    def proposed_plan(self) -> PlanProposal | None:
        """The plan that waits for approval; None if none does."""
        review: PlanReview = self._session.query(SHOW_PLAN, NoParameters())
        return review.proposal

    def approve_plan(self, proposal: int, drop: Sequence[str] = (), why: str = "") -> PlanProposal | None:
        """Send the plan of that proposal to the rover, without the samples of these ids; returns what waits then.

        Raises InvalidInput, in one line, for a proposal that does not wait, and for samples that are not in it.
        """
        return self._decide(proposal, PlanVerdict.APPROVE, why, drop=tuple(drop)).proposal

    def revise_plan(self, proposal: int, places_m: Sequence[Place], why: str = "") -> PlanProposal:
        """Let the ground make that plan anew, to sample these places [m] in this order; returns what waits then.

        Nothing is sent to the rover. Raises InvalidInput, in one line, for a proposal that does not wait, and for
        places that are too many, closed, not to be reached, or beyond the budget; the proposal then waits on.
        """
        places = tuple((float(x), float(y)) for x, y in places_m)
        review = self._decide(proposal, PlanVerdict.REVISE, why, places_m=places)
        assert review.proposal is not None, "a plan that is revised waits"
        return review.proposal

    def send_plan_back(self, proposal: int, why: str = "") -> PlanProposal | None:
        """Let the ground plan that round again; returns what waits then, as a rule nothing until it is planned.

        Raises InvalidInput for a proposal that does not wait.
        """
        return self._decide(proposal, PlanVerdict.SEND_BACK, why).proposal

    def _decide(self, proposal: int, verdict: PlanVerdict, why: str, **changes: Any) -> PlanReview:
        try:
            decision = PlanDecision(proposal=proposal, verdict=verdict, by=self.person, why=why, **changes)
        except ValidationError as error:
            raise InvalidInput(f"plan: {one_line(error)}") from None
        review: PlanReview = self._session.query(DECIDE_PLAN, decision)
        return review
