"""``he3 status``: the processes that are alive, the rover, the map and the link."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from he3.errors import PeerUnreachable
from services.console.cli.flag_groups import with_flags
from services.console.cli.options import AsJson
from services.console.cli.session import Session

if TYPE_CHECKING:
    from services.console.client.mission_state import MissionState

EXAMPLES = """\b
Examples:
  he3 status
  he3 status --json | jq .ground.score.rmse_ppb
  he3 status --mission t1 --earth tcp/10.0.0.2:7448
"""


@with_flags
def status(
    session: Session,
    json: AsJson = False,
) -> None:
    """Show the processes that are alive, the rover, the map and the link."""
    import json as json_format

    with session.join() as client:
        alive = client.alive_on_earth()
        state = client.state()
    if state.knows_nothing:
        raise PeerUnreachable(f"mission '{client.mission}' at {client.earth}: no process answers")
    document = _document(client.mission, client.earth, alive, state)
    document["recording"] = client.recording or None
    open_to_all = ", ".join(state.insecure)
    document["insecure"] = client.warning or (
        f"INSECURE: {open_to_all} without TLS off loopback" if open_to_all else None
    )
    typer.echo(json_format.dumps(document, indent=2) if json else "\n".join(_lines(document, state)))


def _document(name: str, endpoint: str, alive: tuple[str, ...], state: MissionState) -> dict[str, Any]:
    return {
        "mission": name,
        "earth": endpoint,
        "mission_time_s": state.time.elapsed_s(),
        "alive_on_earth": list(alive),
        "defects": state.defects,
        "clock": None if state.clock is None else state.clock.model_dump(mode="json"),
        "ground": None if state.status is None else state.status.model_dump(mode="json"),
        "link": None if state.link is None else state.link.model_dump(mode="json"),
    }


def _lines(document: dict[str, Any], state: MissionState) -> list[str]:
    from services.console.client.time_format import duration, speed

    ground, link, clock = state.status, state.link, state.clock
    pace = "clock not known"
    if clock is not None:
        pace = "lockstep" if clock.mode.value == "lockstep" else speed(clock.rate)
    rows = [] if document["insecure"] is None else [("INSECURE", document["insecure"].removeprefix("INSECURE: "))]
    if document["recording"] is not None:
        rows.append(("RECORDING", f"{document['recording']}; nothing of it is live"))
    if state.defects:
        rows.append(("DEFECT", state.defect_report))
    rows += [
        ("mission", f"{document['mission']} at {document['earth']}"),
        ("time", f"{duration(document['mission_time_s'] or 0.0)} since the beginning"),
        ("speed", pace),
        ("on Earth", ", ".join(document["alive_on_earth"]) or "no process"),
    ]
    if ground is None:
        rows.append(("ground", "no status yet"))
    else:
        score = "" if ground.score is None else f", RMSE {ground.score.rmse_ppb:.4f} ppb"
        std = "" if ground.mean_std_ppb is None else f", mean std {ground.mean_std_ppb:.4f} ppb"
        rows += [
            ("phase", f"{ground.phase.value}{': ' + ground.detail if ground.detail else ''}"),
            (
                "progress",
                f"round {ground.round} of {ground.rounds}, {ground.samples} of {ground.samples_total} samples",
            ),
            *([] if ground.goal is None else [("goal", ground.goal.text)]),
            ("map", f"revision {ground.map_revision}{std}{score}"),
        ]
    if ground is not None and ground.rover is not None and ground.rover_made_at is not None:
        rover = ground.rover
        age = "" if clock is None else f", {duration(state.time.age_s(ground.rover_made_at))} ago"
        rows += [
            ("rover", f"{rover.mode.value} at ({rover.x_m:.1f}, {rover.y_m:.1f}) m{age}"),
            (
                "",
                f"{rover.driven_m:,.0f} m driven, battery {rover.energy_wh:,.0f} of {rover.capacity_wh:,.0f} Wh, "
                f"{queued(rover.rounds_on_board)}, {rover.queue_depth} messages not yet acknowledged",
            ),
        ]
    if link is not None:
        up, down = link.conditions.up, link.conditions.down
        light = f"{up.one_way_light_time_s:g} s up, {down.one_way_light_time_s:g} s down"
        rows += [
            ("link", f"{'in contact' if link.contact else 'NO CONTACT'}, one-way light time {light}"),
            ("up", _counts(link.up)),
            ("down", _counts(link.down)),
        ]
    return [f"{name:<10} {text}" for name, text in rows]


def queued(rounds: int) -> str:
    """How many rounds wait on board the rover, in words."""
    return f"{rounds} round{'' if rounds == 1 else 's'} queued on board"


def _counts(counts: Any) -> str:
    """The counts of one direction in words, complete: what was sent and doubled is the sum of the others."""
    doubled = f" and {counts.duplicated} doubled" if counts.duplicated else ""
    replaced = f", {counts.superseded} replaced by newer ones" if counts.superseded else ""
    gone = counts.lost + counts.dropped_out_of_contact + counts.dropped_queue_full
    return (
        f"{counts.offered} sent{doubled}, {counts.delivered} delivered, {counts.in_flight} in flight, "
        f"{counts.waiting} waiting{replaced}, {gone} lost"
    )
