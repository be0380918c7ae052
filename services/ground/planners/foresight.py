"""What a planner foresees of the mission's goal, in figures and in words."""

from __future__ import annotations

from math import inf

from schemas.ground import GoalForecast


def forecast_of(
    samples: int,
    metres: float,
    worst_ppb: float,
    std_ppb: float,
    samples_left: int,
    budget_m: float,
    unit: str = "m",
) -> GoalForecast:
    """What a planner foresees, in words, too.

    samples, metres: what its design for the goal takes; worst_ppb: the greatest standard deviation that it leaves
    [ppb], above the goal `std_ppb` if all samples that are left do not suffice; unit: of metres and budget.
    """
    enough = worst_ppb <= std_ppb
    reachable = enough and samples <= samples_left and metres <= budget_m
    takes = f"{samples} more sample{'' if samples == 1 else 's'}"
    if not enough:
        text = f"with the {samples_left} samples left the greatest std is about {worst_ppb:.3f} ppb"
        text += f"; the goal takes {std_ppb:.3f}"
    elif metres > budget_m:
        text = f"it takes about {takes} and {metres:,.0f} {unit}, of {budget_m:,.0f} {unit} left"
    else:
        text = f"it takes about {takes} and {metres:,.0f} {unit}"
    return GoalForecast(
        samples=samples if enough else None,
        metres=metres if enough else None,
        worst_ppb=worst_ppb,
        reachable=reachable,
        budget_m=None if budget_m == inf else budget_m,
        text=text,
    )
