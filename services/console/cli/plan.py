"""``he3 plan``: the plan that waits for the operator's approval, and the decision on it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from services.console.cli.coordinates import NEGATIVE_NUMBERS, points
from services.console.cli.flag_groups import with_flags
from services.console.cli.options import AsJson
from services.console.cli.session import NamedSession, Session
from services.console.client.words import counted

if TYPE_CHECKING:
    from schemas.plans import PlanProposal
    from services.console.client.mission_client import MissionClient

EXAMPLES = """\b
Examples:
  he3 up t1 --set ground.approval=operator &   # a mission whose plans wait for approval
  he3 plan show
  he3 plan approve                             # send the plan that waits to the rover
  he3 plan approve --drop r07s2 --drop r07s3   # without these samples; the rover drives by
  he3 plan revise 120,340 150,322 181,300      # sample these places, in this order; it waits again
  he3 plan send-back --why "too close to the rim"
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

Why = Annotated[str, typer.Option("--why", metavar="TEXT", help="A note for the log of the ground station.")]
Number = Annotated[
    int | None,
    typer.Option("--proposal", metavar="N", help="Number of the proposal, such as 12; without it, the one that waits."),
]


@app.command(epilog=EXAMPLES)
@with_flags
def show(
    session: Session,
    json: AsJson = False,
) -> None:
    """Show the plan that waits for approval."""
    with session.join() as client:
        proposal = client.proposed_plan()
    _print(proposal, "no plan waits for approval" if proposal is None else "\n".join(plan_lines(proposal)), json)


@app.command(epilog=EXAMPLES)
@with_flags
def approve(
    session: NamedSession,
    drop: Annotated[
        list[str] | None,
        typer.Option("--drop", metavar="SAMPLE", help="Leave out a sample, such as r07s2; repeatable."),
    ] = None,
    proposal: Number = None,
    why: Why = "",
    json: AsJson = False,
) -> None:
    """Send the plan that waits to the rover."""

    with session.join() as client:
        number, about = _waiting(client, proposal)
        waits = client.approve_plan(number, drop or (), why)
    dropped = f" without {', '.join(drop)}" if drop else ""
    _print(waits, f"mission '{client.mission}': {about} approved{dropped}", json)


@app.command(
    short_help="Replace the samples of the plan that waits by other places.",
    epilog=EXAMPLES,
    context_settings=NEGATIVE_NUMBERS,
)
@with_flags
def revise(
    session: NamedSession,
    places: Annotated[
        list[str], typer.Argument(metavar="X,Y", help="Places to sample [m], in the order in which they are reached.")
    ],
    proposal: Number = None,
    why: Why = "",
    json: AsJson = False,
) -> None:
    """Replace the samples of the plan that waits by these places; the ground plans the ways, and it waits again."""
    places_m = points(places)
    with session.join() as client:
        number, about = _waiting(client, proposal)
        revised = client.revise_plan(number, places_m, why)
    _print(revised, "\n".join((f"mission '{client.mission}': {about} revised", *plan_lines(revised))), json)


@app.command("send-back", epilog=EXAMPLES)
@with_flags
def send_back(
    session: NamedSession,
    proposal: Number = None,
    why: Why = "",
    json: AsJson = False,
) -> None:
    """Send nothing to the rover: the ground plans the round again."""

    with session.join() as client:
        number, about = _waiting(client, proposal)
        waits = client.send_plan_back(number, why)
    _print(waits, f"mission '{client.mission}': {about} sent back", json)


def _print(waits: PlanProposal | None, text: str, json: bool) -> None:
    """Print the plan that waits now as a JSON document, or the text."""
    from schemas.plans import PlanReview

    typer.echo(PlanReview(proposal=waits).model_dump_json(indent=2) if json else text)


def _waiting(client: MissionClient, wanted: int | None) -> tuple[int, str]:
    """The number of the proposal that is decided on, and its name in words; raises He3Error if none waits."""
    from he3.errors import He3Error

    waits = client.proposed_plan()
    if waits is None:
        raise He3Error(f"mission '{client.mission}': no plan waits for approval")
    return wanted or waits.proposal, f"proposal {wanted or waits.proposal} (round {waits.plan.round})"


def plan_lines(proposal: PlanProposal) -> list[str]:
    """The plan in lines of plain text: its figures, and its samples in their order."""
    from services.console.client.time_format import duration, utc

    plan = proposal.plan
    lasts = (
        "never: the sun does not charge the rover enough" if proposal.lasts_s is None else duration(proposal.lasts_s)
    )
    last = ", the last one" if proposal.last else ""
    cost = "" if proposal.cost_unit == "m" else f", costs {proposal.cost:,.1f} {proposal.cost_unit}"
    samples = counted(len(plan.samples), "sample")
    return [
        f"proposal {proposal.proposal}  round {plan.round}{last}, waits since {utc(proposal.proposed_at, 0)}",
        f"    {proposal.length_m:,.1f} m, {samples}, {plan.information_nats:.2f} nat, takes {lasts}",
        f"    in motion {duration(proposal.drive_s)}, {proposal.energy_wh:,.1f} Wh with the base load{cost}",
        *([] if proposal.goal is None else [f"    goal: {proposal.goal}"]),
        *(f"    {sample.sample_id:<10} ({sample.x_m:.1f}, {sample.y_m:.1f}) m" for sample in plan.samples),
    ]
