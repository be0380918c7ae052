"""``he3 watch``: a running mission over the whole terminal; plain lines without one, JSON lines on request."""

from __future__ import annotations

import queue
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import typer

from he3.errors import He3Error, PeerUnreachable
from services.console.cli.flag_groups import with_flags
from services.console.cli.options import AsJsonLines
from services.console.cli.session import Session

if TYPE_CHECKING:
    from schemas.topics import Topic
    from schemas.wire import Header, Wire
    from services.console.client.live import News
    from services.console.client.mission_client import MissionClient
    from services.console.client.mission_state import Happened, MissionState

EXAMPLES = """\b
Examples:
  he3 watch                 # until Ctrl-C, or until the mission is over
  he3 watch --json          # every message as a JSON line
"""

DRAWN_EVERY_S = 0.25
MAP_EVERY_S = 1.0
EVENTS_SHOWN = 6
COMMANDS_SHOWN = 3
MAP_FROM_COLUMNS = 72
"""Width of a terminal from which on there is room for the map beside the figures."""


@with_flags
def watch(
    session: Session,
    json: AsJsonLines = False,
) -> None:
    """Follow a running mission until it is over, or until Ctrl-C."""

    with session.join() as client:
        client.declare_display()
        if json:
            as_json(client)
            return
        state = client.state()
        phase = _on_screen(client, state) if sys.stdout.isatty() else _in_lines(client, state)
    typer.echo(f"mission '{client.mission}' is over: {phase}")


def as_json(client: MissionClient) -> None:
    """Print every message as a JSON line, until the status that says that the mission is over.

    Raises PeerUnreachable if the mission falls silent before.
    """
    from schemas.topics import GROUND_STATUS
    from services.console.client.live import NEWS, News

    heard: queue.SimpleQueue[News] = queue.SimpleQueue()
    printed: Wire | None = None

    def keeper(topic: Topic) -> Callable[[Header, Any], None]:
        return lambda header, body: heard.put(News(topic.name, header.source, header.made_at, body))

    def print_all() -> None:
        nonlocal printed
        while not heard.empty():
            news = heard.get()
            printed = news.body if news.topic == GROUND_STATUS.name else printed
            _print(news)

    for topic in NEWS:
        client.listen(topic, keeper(topic))
    state = client.state()
    for _ in _until_over(client, state, 0.1):
        print_all()
    print_all()
    last = state.fact(GROUND_STATUS)
    if last is not None and printed != last.body:  # it was queried: the message was sent before, or was lost
        _print(News(GROUND_STATUS.name, last.header.source, last.made_at, last.body))


def _print(news: News) -> None:
    import json as json_format

    body = news.body.model_dump(mode="json")
    typer.echo(json_format.dumps({"topic": news.topic, "source": news.source, "made_at": news.made_at, "body": body}))


def _in_lines(client: MissionClient, state: MissionState) -> str:
    from services.console.report.progress import moment_now, progress_for

    with progress_for(f"{client.mission} at {client.earth}", "Ctrl-C ends the display, not the mission") as progress:
        for _ in _until_over(client, state, 0.1):
            progress.show(lambda: moment_now(state))
    assert state.status is not None
    return state.status.phase.value


def _until_over(client: MissionClient, state: MissionState, every_s: float) -> Iterator[None]:
    """Yield at every change, and once per period, until the mission is over; raises PeerUnreachable if it is silent.

    A mission whose clock is stopped is not silent, because its heartbeats continue.
    """
    while state.status is None or not state.status.is_over:
        yield
        state.changed.wait(every_s)
        state.changed.clear()
        state.refresh()
        if state.is_silent:
            raise PeerUnreachable(
                f"mission '{client.mission}' at {client.earth}: nothing heard for {state.silent_s:.0f} s"
            )


def _on_screen(client: MissionClient, state: MissionState) -> str:
    from rich.console import Console
    from rich.live import Live

    screen = _Screen(client, state)
    with Live(console=Console(), screen=True, auto_refresh=False) as live:
        drawn = 0.0
        for _ in _until_over(client, state, DRAWN_EVERY_S):
            if time.monotonic() - drawn >= DRAWN_EVERY_S:
                drawn = time.monotonic()
                live.update(screen.drawn(live.console.width, live.console.height), refresh=True)
    assert state.status is not None
    return state.status.phase.value


class _Screen:
    """The screen with a mission's state."""

    def __init__(self, client: MissionClient, state: MissionState) -> None:
        self._client = client
        self._state = state
        self._curve: list[float] = []
        self._map: list[str] = []
        self._map_at = 0.0
        self._map_of: tuple[int, int] = (-1, 0)

    def drawn(self, width: int, height: int) -> Any:
        """The whole screen."""
        from rich.layout import Layout
        from rich.panel import Panel
        from rich.text import Text

        from services.console.cli.command import command_lines

        map_width = max(20, min(width - 52, (height - 12) * 2))
        layout, left, right = Layout(), Layout(name="map", size=map_width + 4), Layout(name="side")
        upper = Layout(name="upper", ratio=3)
        layout.split_column(upper, Layout(name="events", size=EVENTS_SHOWN + 2))
        side_width = width
        if width >= MAP_FROM_COLUMNS:
            side_width = width - map_width - 4
            upper.split_row(left, right)
            picture = Text.from_ansi("\n".join(self._picture(map_width)), no_wrap=True)
            left.update(Panel(picture, title="helium-3, mean [ppb]", border_style="dim"))
        else:
            upper.split_row(right)
        commands = command_lines(self._state.commands[-COMMANDS_SHOWN:])
        lower = Layout(Panel(Text("\n".join(commands) or "no commands yet"), title="commands", border_style="dim"))
        figures = Panel(self._figures(), title=f"{self._client.mission}", border_style="cyan")
        right.split_column(Layout(figures, size=lines_of(figures, side_width)), lower)
        events = "\n".join(_event_line(each) for each in reversed(self._state.events[-EVENTS_SHOWN:]))
        layout["events"].update(
            Panel(
                Text(events or "no events yet"),
                title="events, newest first",
                subtitle="Ctrl-C ends the display, not the mission",
                border_style="dim",
            )
        )
        return layout

    def _figures(self) -> Any:
        from rich.console import Group
        from rich.progress_bar import ProgressBar
        from rich.text import Text

        from services.console.report.progress import moment_now, sparkline

        moment = moment_now(self._state)
        if moment.rmse_ppb is not None and (not self._curve or self._curve[-1] != moment.rmse_ppb):
            self._curve.append(moment.rmse_ppb)
        bar = ProgressBar(total=max(1, moment.samples_total), completed=moment.samples)
        parts: list[Any] = [bar, Text(""), table_of(self._rows())]
        if len(self._curve) > 1:
            parts.append(Text.assemble(("RMSE  ", "dim"), (sparkline(self._curve, 40), "cyan")))
        return Group(*parts)

    def _rows(self) -> list[tuple[str, str]]:
        from services.console.cli.status import queued
        from services.console.client.time_format import duration
        from services.console.report.progress import moment_now

        state, moment = self._state, moment_now(self._state)
        status, link = state.status, state.link
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
                ("age", f"{duration(state.time.age_s(status.rover_made_at))}"),
                ("plan", queued(rover.rounds_on_board)),
                ("driven", f"{rover.driven_m:,.0f} m, drilled {rover.drilled_m:.1f} m"),
                ("battery", f"{rover.energy_wh:,.0f} of {rover.capacity_wh:,.0f} Wh"),
                ("queue", f"{rover.queue_depth} messages not yet acknowledged"),
            ]
        if link is not None:
            light = link.conditions.down.one_way_light_time_s
            contact = "in contact" if link.contact else "NO CONTACT"
            rows += [
                ("link", f"{contact}, one-way light time {light:g} s"),
                ("", f"up {link.up.in_flight} in flight, {link.up.waiting} waiting"),
                ("", f"down {link.down.in_flight} in flight, {link.down.waiting} waiting"),
            ]
        return rows

    def _picture(self, width: int) -> list[str]:
        """The map as lines, queried again when it has changed, at most once per second."""
        status = self._state.status
        wanted = (0 if status is None else status.map_revision, width)
        if wanted == self._map_of or time.monotonic() - self._map_at < MAP_EVERY_S:
            return self._map
        from services.console.cli.terminal import drawn
        from services.console.report.mission_report import array_of

        self._map_at = time.monotonic()
        try:
            raster = self._client.raster("mean", step=2, timeout_s=2.0)
        except He3Error as error:
            return self._map or [str(error)]
        self._map, self._map_of = drawn(array_of(raster), raster, width, colours=True), wanted
        return self._map


def table_of(rows: Sequence[tuple[str, str]]) -> Any:
    """Names and texts in two columns. A text that is longer than its column continues on the next line."""
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for name, text in rows:
        alert = "bold red" if "NO CONTACT" in text or text.startswith("safe") else ""
        table.add_row(Text(name, style="dim", no_wrap=True), Text(text, style=alert, overflow="fold"))
    return table


def lines_of(what: Any, width: int) -> int:
    """How many lines it takes at that width."""
    from rich.console import Console

    console = Console(width=width, color_system=None)
    return len(console.render_lines(what, console.options.update(width=width)))


def _event_line(happened: Happened) -> str:
    event = happened.event
    detail = f"  {event.detail}" if event.detail else ""
    where = f"({event.x_m:.0f}, {event.y_m:.0f}) m"
    return f"{event.kind.value.replace('_', ' '):<20} round {event.round:<3} {where}{detail}"


def _ppb(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f} ppb"
