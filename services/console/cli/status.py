"""``he3 status``: who is alive, where the rover is, what is in flight."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import typer

from he3.errors import PeerUnreachable
from services.console.cli.options import AsJson, Earth, Mission

if TYPE_CHECKING:
    from services.console.client.session import Watcher

EXAMPLES = """\b
Examples:
  he3 status
  he3 status --json | jq .ground.score.rmse_ppb
  he3 status --mission t1 --earth tcp/10.0.0.2:7448
"""

LIVELINESS_S = 0.3
"""How long the list of those who are alive may take to come in."""


def status(mission: Mission = None, earth: Earth = None, json: AsJson = False) -> None:
    """Who is alive, where the rover is, what the map is worth, what is in flight."""
    import json as json_format

    from schemas.topics import Side
    from services.console.client.run_file import find
    from services.console.client.session import Watcher, join

    endpoint, name = find(mission, earth)
    alive: dict[str, bool] = {}
    with join(name, endpoint) as client:
        client.watch_alive(Side.EARTH, alive.__setitem__)
        watcher = Watcher(client)
        watcher.catch_up()
        deadline = time.monotonic() + LIVELINESS_S
        while not {"link", "ground"} <= alive.keys() and time.monotonic() < deadline:
            time.sleep(0.01)
    if watcher.clock is None and watcher.link is None and watcher.status is None:
        raise PeerUnreachable(f"mission '{name}' at {endpoint}: nobody answers")
    there = sorted(process for process, here in alive.items() if here)
    document = _document(name, endpoint, there, watcher)
    typer.echo(json_format.dumps(document, indent=2) if json else "\n".join(_lines(document, watcher)))


def _document(name: str, endpoint: str, alive: list[str], watcher: Watcher) -> dict[str, Any]:
    return {
        "mission": name,
        "earth": endpoint,
        "mission_time_s": watcher.mission_time_s,
        "alive_on_earth": alive,
        "clock": None if watcher.clock is None else watcher.clock.model_dump(mode="json"),
        "ground": None if watcher.status is None else watcher.status.model_dump(mode="json"),
        "link": None if watcher.link is None else watcher.link.model_dump(mode="json"),
    }


def _lines(document: dict[str, Any], watcher: Watcher) -> list[str]:
    from services.console.report.progress import duration

    ground, link, clock = watcher.status, watcher.link, watcher.clock
    pace = "nobody tells the time"
    if clock is not None:
        pace = "lockstep" if clock.mode.value == "lockstep" else f"{clock.rate:g} times as fast as life"
    rows = [
        ("mission", f"{document['mission']} at {document['earth']}"),
        ("time", f"{duration(watcher.mission_time_s or 0.0)} since its beginning, {pace}"),
        ("on Earth", ", ".join(document["alive_on_earth"]) or "nobody"),
    ]
    if ground is None:
        rows.append(("ground", "has not said anything"))
    else:
        score = "" if ground.score is None else f", RMSE {ground.score.rmse_ppb:.4f} ppb"
        std = "" if ground.mean_std_ppb is None else f", mean std {ground.mean_std_ppb:.4f} ppb"
        rows += [
            ("phase", f"{ground.phase.value}{': ' + ground.detail if ground.detail else ''}"),
            (
                "progress",
                f"round {ground.round} of {ground.rounds}, {ground.samples} of {ground.samples_total} samples",
            ),
            ("map", f"revision {ground.map_revision}{std}{score}"),
        ]
    if ground is not None and ground.rover is not None and ground.rover_made_at is not None:
        rover = ground.rover
        age = "" if clock is None else f", {duration(age_s(watcher, ground.rover_made_at))} ago"
        rows.append(
            (
                "rover",
                f"{rover.mode.value} at ({rover.x_m:.1f}, {rover.y_m:.1f}) m{age}; {rover.driven_m:,.0f} m driven, "
                f"{rover.energy_wh:,.0f} of {rover.capacity_wh:,.0f} Wh, {rover.queue_depth} messages queued",
            )
        )
    if link is not None:
        up, down = link.conditions.up, link.conditions.down
        light = f"{up.one_way_light_time_s:g} s up, {down.one_way_light_time_s:g} s down"
        rows += [
            ("link", f"{'contact' if link.contact else 'NO CONTACT'}, one-way light time {light}"),
            ("up", _counts(link.up)),
            ("down", _counts(link.down)),
        ]
    return [f"{name:<10} {text}" for name, text in rows]


def age_s(watcher: Watcher, made_at: int) -> float:
    start = 0 if watcher.clock is None else watcher.clock.start_ns
    return max(0.0, (watcher.mission_time_s or 0.0) - (made_at - start) / 1e9)


def _counts(counts: Any) -> str:
    gone = counts.lost + counts.dropped_out_of_contact + counts.dropped_queue_full
    return (
        f"{counts.offered} sent, {counts.delivered} delivered, {counts.in_flight} in flight, "
        f"{counts.waiting} waiting, {gone} lost"
    )
