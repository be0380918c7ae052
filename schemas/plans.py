"""Plans of one or several rounds, from the ground to the rover."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from schemas.wire import MAX_COUNT, Count, Identifier, MissionTimeNs, PositionM, Wire

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
