"""``he3 watch``: a running mission over the whole terminal; lines where there is none, JSON lines on request."""

from __future__ import annotations

import sys
import time
from collections import deque
from typing import TYPE_CHECKING, Any

import typer

from he3.errors import He3Error, PeerUnreachable
from services.console.cli.options import AsJson, Earth, Mission

if TYPE_CHECKING:
    from schemas.commands import CommandStatus
    from services.console.client.mission_client import MissionClient
    from services.console.client.session import Watcher
    from services.runtime.transport.client import Client

EXAMPLES = """\b
Examples:
  he3 watch                 until Ctrl-C, or until the mission is over
  he3 watch --json          everything that is said, a JSON line each
"""

DRAWN_EVERY_S = 0.25
MAP_EVERY_S = 1.0
SILENT_S = 15.0
MAX_EVENTS = 40


def watch(mission: Mission = None, earth: Earth = None, json: AsJson = False) -> None:
    """Follow a running mission until it is over, or until Ctrl-C."""
    from services.console.client.mission_client import MissionClient

    with MissionClient(earth, mission) as client:
        if json:
            _as_json(client)
            return
        from services.console.client.session import Watcher

        watcher = Watcher(client.client)
        watcher.catch_up()
        phase = _on_screen(client, watcher) if sys.stdout.isatty() else _in_lines(client, watcher)
    typer.echo(f"mission '{client.mission}' is over: {phase}")


def _over(watcher: Watcher) -> bool:
    return watcher.status is not None and watcher.status.phase.value in ("completed", "failed")


def _as_json(client: MissionClient) -> None:
    import json as json_format

    for news in client.live():
        body = news.body.model_dump(mode="json")
        typer.echo(
            json_format.dumps({"topic": news.topic, "source": news.source, "made_at": news.made_at, "body": body})
        )
        if news.topic == "earth/ground/status" and body["phase"] in ("completed", "failed"):
            return


def _in_lines(client: MissionClient, watcher: Watcher) -> str:
    from services.console.report.progress import progress_for

    with progress_for(f"{client.mission} at {client.earth}", "Ctrl-C leaves; it goes on") as progress:
        for _ in _news(client, watcher, 0.1):
            progress.show(watcher.moment)
    assert watcher.status is not None
    return watcher.status.phase.value


def _news(client: MissionClient, watcher: Watcher, every_s: float) -> Any:
    """Comes back with every news, and now and then, until the mission is over; raises when it has fallen silent."""
    heard = time.monotonic()
    while not _over(watcher):
        yield
        if watcher.changed.wait(every_s):
            heard = time.monotonic()
            watcher.changed.clear()
        elif time.monotonic() - heard > SILENT_S:
            raise PeerUnreachable(f"mission '{client.mission}' at {client.earth}: nothing heard for {SILENT_S:g} s")


def _on_screen(client: MissionClient, watcher: Watcher) -> str:
    from rich.console import Console
    from rich.live import Live

    screen = _Screen(client, watcher)
    with Live(console=Console(), screen=True, auto_refresh=False) as live:
        drawn = 0.0
        for _ in _news(client, watcher, DRAWN_EVERY_S):
            if time.monotonic() - drawn >= DRAWN_EVERY_S:
                drawn = time.monotonic()
                live.update(screen.drawn(live.console.width, live.console.height), refresh=True)
    assert watcher.status is not None
    return watcher.status.phase.value


class _Screen:
    """What the screen shows, kept by the session's threads and drawn by the main one."""

    def __init__(self, client: MissionClient, watcher: Watcher) -> None:
        from schemas.topics import COMMAND_STATUS, EVENT

        self._mission = client
        self._watcher = watcher
        self._events: deque[str] = deque(maxlen=MAX_EVENTS)
        self._commands: dict[str, CommandStatus] = {}
        self._curve: list[float] = []
        self._map: list[str] = []
        self._map_at = 0.0
        self._map_of: tuple[int, int, int] = (-1, 0, 0)
        session: Client = client.client
        session.subscribe(EVENT, lambda _, body: self._happened(body))
        session.subscribe(COMMAND_STATUS, lambda _, body: self._commanded(body))
        for status in client.commands():
            self._commanded(status)

    def _happened(self, body: Any) -> None:
        detail = f"  {body.detail}" if body.detail else ""
        where = f"({body.x_m:.0f}, {body.y_m:.0f}) m"
        self._events.appendleft(f"{body.kind.value.replace('_', ' '):<20} round {body.round:<3} {where}{detail}")

    def _commanded(self, status: CommandStatus) -> None:
        self._commands[status.command.command_id] = status

    def drawn(self, width: int, height: int) -> Any:
        """The whole screen."""
        from rich.layout import Layout
        from rich.panel import Panel
        from rich.text import Text

        from services.console.cli.command import command_lines

        map_width = max(20, min(width - 52, (height - 12) * 2))
        layout, left, right = Layout(), Layout(name="map", size=map_width + 4), Layout(name="side")
        upper = Layout(name="upper", ratio=3)
        layout.split_column(upper, Layout(name="events", size=8))
        upper.split_row(left, right)
        picture = Text.from_ansi("\n".join(self._picture(map_width)), no_wrap=True)
        left.update(Panel(picture, title="helium-3, mean, in ppb", border_style="dim"))
        commands = command_lines(list(self._commands.values())[-3:])
        lower = Layout(Panel("\n".join(commands) or "none sent", title="commands", border_style="dim"))
        right.split_column(
            Layout(Panel(self._figures(), title=f"{self._mission.mission}", border_style="cyan"), size=19), lower
        )
        events = "\n".join(list(self._events)[:6]) or "nothing yet"
        layout["events"].update(
            Panel(events, title="events, newest first", subtitle="Ctrl-C leaves; it goes on", border_style="dim")
        )
        return layout

    def _figures(self) -> Any:
        from rich.console import Group
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        from services.console.cli.status import age_s
        from services.console.report.progress import duration, sparkline

        watcher, moment = self._watcher, self._watcher.moment()
        status, link = watcher.status, watcher.link
        if moment.rmse_ppb is not None and (not self._curve or self._curve[-1] != moment.rmse_ppb):
            self._curve.append(moment.rmse_ppb)
        rows = [
            ("time", f"{duration(moment.mission_time_s)} since the beginning"),
            ("phase", f"{moment.phase}{': ' + moment.detail if moment.detail else ''}"),
            ("round", f"{moment.round} of {moment.rounds}, {moment.samples} of {moment.samples_total} samples"),
            ("map", f"mean std {_ppb(moment.mean_std_ppb)}, RMSE {_ppb(moment.rmse_ppb)}"),
        ]
        if status is not None and status.rover is not None and status.rover_made_at is not None:
            rover = status.rover
            rows += [
                ("rover", f"{rover.mode.value} at ({rover.x_m:.1f}, {rover.y_m:.1f}) m"),
                ("seen", f"as it was {duration(age_s(watcher, status.rover_made_at))} ago"),
                ("driven", f"{rover.driven_m:,.0f} m, drilled {rover.drilled_m:.1f} m"),
                ("battery", f"{rover.energy_wh:,.0f} of {rover.capacity_wh:,.0f} Wh"),
                ("queue", f"{rover.queue_depth} messages wait for Earth"),
            ]
        if link is not None:
            light = link.conditions.down.one_way_light_time_s
            contact = "contact" if link.contact else "NO CONTACT"
            rows += [
                ("link", f"{contact}, {light:g} s one way"),
                ("", f"up {link.up.in_flight} in flight, {link.up.waiting} waiting"),
                ("", f"down {link.down.in_flight} in flight, {link.down.waiting} waiting"),
            ]
        table = Table.grid(padding=(0, 2))
        for name, text in rows:
            alert = "bold red" if "NO CONTACT" in text or text.startswith("safe") else ""
            table.add_row(Text(name, style="dim"), Text(text, style=alert, no_wrap=True, overflow="ellipsis"))
        bar = ProgressBar(total=max(1, moment.samples_total), completed=moment.samples)
        parts: list[Any] = [bar, Text(""), table]
        if len(self._curve) > 1:
            parts.append(Text.assemble(("RMSE  ", "dim"), (sparkline(self._curve, 40), "cyan")))
        return Group(*parts)

    def _picture(self, width: int) -> list[str]:
        """The map as lines, asked for anew when it has changed, at most once a second."""
        status = self._watcher.status
        wanted = (0 if status is None else status.map_revision, width, 0)
        if wanted == self._map_of or time.monotonic() - self._map_at < MAP_EVERY_S:
            return self._map
        from schemas.maps import MapLayer, MapLayerQuery
        from schemas.topics import MAP_LAYER
        from services.console.cli.terminal import drawn
        from services.console.report.mission_report import array_of

        self._map_at = time.monotonic()
        try:
            raster = self._mission.client.query(MAP_LAYER, MapLayerQuery(layer=MapLayer.MEAN, step=2), timeout_s=2.0)
        except He3Error as error:
            return self._map or [str(error)]
        self._map, self._map_of = drawn(array_of(raster), raster, width, colours=True), wanted
        return self._map


def _ppb(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f} ppb"
