"""Plans of one or several rounds, from the ground to the rover."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field, model_validator

from schemas.wire import MAX_COUNT, Count, Identifier, MissionTimeNs, PersonName, PositionM, Text, Wire, is_none

Waypoint = tuple[PositionM, PositionM]


class PlannedSample(Wire):
    """A place to drill, on the round's path."""

    sample_id: Identifier
    x_m: PositionM
    y_m: PositionM
    depth_m: Annotated[float, Field(gt=0, le=3)]


class RoundPlan(Wire):
    """One round: a path from where it begins, and the places to sample on it, in the order in which it reaches them."""

    round: Annotated[int, Field(ge=1, le=10_000)]
    path_m: Annotated[tuple[Waypoint, ...], Field(min_length=1, max_length=4096)]
    samples: Annotated[tuple[PlannedSample, ...], Field(max_length=256)]
    information_nats: Annotated[float, Field(ge=0)]
    """Mutual information between the round's measurements and the field, given the samples known and pending."""


class MissionPlan(Wire):
    """Consecutive rounds, the next first. A newer revision replaces the rounds that have not begun."""

    revision: Annotated[int, Field(ge=1, lt=MAX_COUNT)]
    rounds: Annotated[tuple[RoundPlan, ...], Field(min_length=1, max_length=64)]
    last: bool = False
    """No rounds follow: the mission is complete when these are."""
    samples_known: Count
    """Number of measured values on the ground at the time of planning."""
    samples_pending: tuple[Identifier, ...] = ()
    """Measurements under way that the plan takes into account; the posterior variance does not need their values."""
    planned_at: MissionTimeNs

    @model_validator(mode="after")
    def _rounds_follow_each_other(self) -> MissionPlan:
        numbers = [planned.round for planned in self.rounds]
        if numbers != list(range(numbers[0], numbers[0] + len(numbers))):
            raise ValueError(f"expected consecutive rounds, got {numbers}")
        ids = [sample.sample_id for planned in self.rounds for sample in planned.samples]
        if len(set(ids)) != len(ids):
            raise ValueError("expected every sample id once")
        return self


class PlanProposal(Wire):
    """A round that is planned and waits for the operator (`ground.approval = "operator"`)."""

    proposal: Annotated[int, Field(ge=1, lt=MAX_COUNT)]
    """Number of the proposal; every one has another."""
    plan: RoundPlan
    length_m: Annotated[float, Field(ge=0)]
    """Length of its path."""
    lasts_s: Annotated[float, Field(ge=0)] | None
    """Expected duration, charging included; None: the sun never charges the rover enough."""
    drive_s: Annotated[float, Field(ge=0)] = 0.0
    """Expected time in motion, without charging [s]."""
    energy_wh: Annotated[float, Field(ge=0)] = 0.0
    """Energy that is drawn while it drives, the base load included [Wh]."""
    cost: Annotated[float, Field(ge=0)] = 0.0
    """Cost of its path, by the mission's `ground.cost`."""
    cost_unit: Literal["m", "h", "Wh"] = "m"
    last: bool
    """Whether no round follows it."""
    goal: Text | None = Field(default=None, exclude_if=is_none)
    """How far the map is from the mission's goal, and what that takes from this round on; None without a goal."""
    proposed_at: MissionTimeNs


class PlanReview(Wire):
    """What waits for the operator's approval."""

    proposal: PlanProposal | None = None


class PlanVerdict(StrEnum):
    APPROVE = "approve"
    SEND_BACK = "send_back"
    REVISE = "revise"
    """Sample other places: the ground finds the ways, and the plan waits once more under another number."""


class PlanDecision(Wire):
    """The operator's decision on a proposal."""

    proposal: Annotated[int, Field(ge=1, lt=MAX_COUNT)]
    """The proposal that it is about; a decision on another one than that which waits is refused."""
    verdict: PlanVerdict
    by: PersonName
    """Who decides; in a mission with keys, the signer of the request."""
    drop: Annotated[tuple[Identifier, ...], Field(max_length=256)] = ()
    """Samples that are not taken (`approve` only); the rover drives by their places."""
    places_m: Annotated[tuple[Waypoint, ...], Field(max_length=256)] = ()
    """Places to sample in place of those proposed, in the order in which they are reached (`revise` only)."""
    why: Text = ""
    """A note for the log."""

    @model_validator(mode="after")
    def _changes_fit_the_verdict(self) -> PlanDecision:
        if self.drop and self.verdict is not PlanVerdict.APPROVE:
            raise ValueError(f"expected samples to drop with approve only, got some with {self.verdict.value}")
        if bool(self.places_m) != (self.verdict is PlanVerdict.REVISE):
            raise ValueError("expected places to sample with revise and only there")
        return self
