"""A plan that waits for approval, in lines of text."""

from __future__ import annotations

from schemas.plans import PlannedSample, PlanProposal, RoundPlan
from services.console.cli.plan import plan_lines

PLAN = RoundPlan(
    round=7,
    path_m=((0.0, 0.0), (1500.0, 0.0)),
    samples=(PlannedSample(sample_id="r07s1", x_m=1500.0, y_m=0.0, depth_m=1.0),),
    information_nats=1.25,
)


def test_a_plan_that_waits_is_shown_with_its_figures_and_its_samples() -> None:
    proposal = PlanProposal(
        proposal=12, plan=PLAN, length_m=1500.0, lasts_s=3600.0, drive_s=1800.0, energy_wh=750.0, cost=750.0,
        cost_unit="Wh", last=True, proposed_at=0,
    )  # fmt: skip
    assert plan_lines(proposal) == [
        "proposal 12  round 7, the last one, waits since 1970-01-01T00:00:00Z",
        "    1,500.0 m, 1 sample, 1.25 nat, takes 1 h 00 min",
        "    in motion 30 min 00 s, 750.0 Wh with the base load, costs 750.0 Wh",
        "    r07s1      (1500.0, 0.0) m",
    ]


def test_a_plan_that_no_sun_pays_for_says_so() -> None:
    proposal = PlanProposal(proposal=1, plan=PLAN, length_m=1.0, lasts_s=None, last=False, proposed_at=0)
    assert "takes never: the sun does not charge the rover enough" in plan_lines(proposal)[1]


def test_a_plan_of_a_mission_with_a_goal_says_how_far_the_goal_is() -> None:
    goal = "std at most 0.5 ppb everywhere; it takes about 9 more samples and 340 m"
    proposal = PlanProposal(proposal=1, plan=PLAN, length_m=1.0, lasts_s=1.0, last=False, goal=goal, proposed_at=0)
    assert f"    goal: {goal}" in plan_lines(proposal)
