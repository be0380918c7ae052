"""A mission's progress on standard error: a live panel on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol, Self, TextIO

from schemas.ground import MissionPhase
from services.console.client.time_format import duration

if TYPE_CHECKING:
    from schemas.ground import GroundStatus
    from services.console.client.mission_state import MissionState

REDRAW_S = 0.1
PLAIN_EVERY_S = 10.0


@dataclass(frozen=True, slots=True)
class Moment:
    """The figures of a mission's progress at one moment."""

    phase: str = "starting"
    round: int = 0
    rounds: int = 0
    samples: int = 0
    samples_total: int = 0
    rmse_ppb: float | None = None
    mean_std_ppb: float | None = None
    driven_m: float = 0.0
    cost: str = ""
    """What driving has cost beside its metres; empty where the cost is the distance."""
    mission_time_s: float = 0.0
    in_flight: int = 0
    rover: str = "no report yet"
    detail: str = ""


def moment_of(status: GroundStatus | None, mission_time_s: float, in_flight: int) -> Moment:
    """The progress at one moment, from the ground's newest status, the clock and the link."""
    if status is None:
        return Moment(mission_time_s=mission_time_s, in_flight=in_flight)
    rover = status.rover
    return Moment(
        phase=_phase(status),
        round=status.round,
        rounds=status.rounds,
        samples=status.samples,
        samples_total=status.samples_total,
        rmse_ppb=None if status.score is None else status.score.rmse_ppb,
        mean_std_ppb=status.mean_std_ppb,
        driven_m=status.driven_m,
        cost="" if status.cost is None else f", {status.cost.spent:,.1f} {status.cost.unit}",
        mission_time_s=mission_time_s,
        in_flight=in_flight,
        rover="no report yet" if rover is None else f"{rover.mode.value} at ({rover.x_m:.0f}, {rover.y_m:.0f}) m",
        detail=status.detail,
    )


def _phase(status: GroundStatus) -> str:
    """The mission's phase in a word; with all samples in the map there is nothing left to plan."""
    over = status.phase is MissionPhase.PLANNING and status.samples >= status.samples_total
    return "ending" if over else status.phase.value


def moment_now(state: MissionState) -> Moment:
    """The progress now, as far as an operator's session knows."""
    link = state.link
    in_flight = 0 if link is None else sum(each.in_flight + each.waiting for each in (link.up, link.down))
    return moment_of(state.status, state.time.elapsed_s() or 0.0, in_flight)


def time_left_s(moment: Moment, elapsed_s: float) -> float | None:
    """Expected wall time until the last sample, at the average speed so far; None before the first sample."""
    if moment.samples == 0 or moment.samples_total == 0:
        return None
    return elapsed_s * (moment.samples_total - moment.samples) / moment.samples


def plain_line(moment: Moment, elapsed_s: float) -> str:
    """The moment on one line, without colours."""
    rmse = "-" if moment.rmse_ppb is None else f"{moment.rmse_ppb:.4f} ppb"
    left = time_left_s(moment, elapsed_s)
    return (
        f"round {moment.round}/{moment.rounds}  samples {moment.samples}/{moment.samples_total}  rmse {rmse}  "
        f"driven {moment.driven_m:.0f} m{moment.cost}  mission time {duration(moment.mission_time_s)}  "
        f"in flight {moment.in_flight}  left {'-' if left is None else duration(left)}  {moment.phase}"
    )


class Progress(Protocol):
    """Shows the progress of a mission; cheap to call in every pass of a loop."""

    def show(self, now: Callable[[], Moment]) -> None:
        """Show the moment, if it is time to redraw."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


@dataclass
class PlainProgress:
    """A line a round, one every `every_s` in between, and one for what is new to say, with that below."""

    stream: TextIO = field(default_factory=lambda: sys.stderr)
    clock: Callable[[], float] = time.monotonic
    every_s: float = PLAIN_EVERY_S

    def __enter__(self) -> Self:
        self._began = self._drawn = self._looked = self.clock()
        self._round = 0
        self._said = ""
        self._last: Callable[[], Moment] | None = None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None and self._last is not None and (moment := self._last()).round != self._round:
            self._write(moment, self.clock())

    def show(self, now: Callable[[], Moment]) -> None:
        self._last = now
        at = self.clock()
        if at - self._looked < REDRAW_S:
            return
        self._looked = at
        moment = now()
        is_new = moment.round != self._round or moment.detail not in ("", self._said)
        if not is_new and at - self._drawn < self.every_s:
            return
        self._write(moment, at)

    def _write(self, moment: Moment, at: float) -> None:
        self._round, self._drawn = moment.round, at
        self.stream.write(plain_line(moment, at - self._began) + "\n")
        if moment.detail != self._said:
            self._said = moment.detail
            self.stream.write(f"  {moment.detail}\n" if moment.detail else "")
        self.stream.flush()


class SilentProgress:
    """Shows nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None

    def show(self, now: Callable[[], Moment]) -> None:
        return None


class LiveProgress:
    """A panel that is redrawn in place on a terminal."""

    def __init__(self, title: str, note: str) -> None:
        from rich.console import Console
        from rich.live import Live

        self._title, self._note = title, note
        self._live = Live(console=Console(stderr=True), auto_refresh=False, transient=False)
        self._began = self._drawn = time.monotonic()
        self._curve: list[tuple[int, float]] = []
        self._last: Callable[[], Moment] | None = None

    def __enter__(self) -> Self:
        self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._last is not None:
            self._draw(self._last())
        self._live.__exit__(kind, error, trace)

    def show(self, now: Callable[[], Moment]) -> None:
        self._last = now
        at = time.monotonic()
        if at - self._drawn >= REDRAW_S:
            self._drawn = at
            self._draw(now())

    def _draw(self, moment: Moment) -> None:
        if moment.rmse_ppb is not None and (not self._curve or self._curve[-1][0] != moment.samples):
            self._curve.append((moment.samples, moment.rmse_ppb))
        elapsed = time.monotonic() - self._began
        curve = [value for _, value in self._curve]
        self._live.update(panel(self._title, self._note, moment, elapsed, curve), refresh=True)


def panel(title: str, note: str, moment: Moment, elapsed_s: float, rmse_curve: list[float]) -> Any:
    """The panel: the figures of a running mission."""
    from rich import box
    from rich.console import Group
    from rich.panel import Panel
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    left = time_left_s(moment, elapsed_s)
    figures = Table.grid(padding=(0, 3))
    for _ in range(4):
        figures.add_column(no_wrap=True)
    rows = [
        ("round", f"{moment.round} of {moment.rounds}", "samples", f"{moment.samples} of {moment.samples_total}"),
        ("RMSE", _ppb(moment.rmse_ppb), "mean std", _ppb(moment.mean_std_ppb)),
        ("driven", f"{moment.driven_m:,.0f} m{moment.cost}", "in flight", f"{moment.in_flight} messages"),
        ("mission time", duration(moment.mission_time_s), "wall time", duration(elapsed_s)),
        ("phase", moment.phase, "time left", "-" if left is None else duration(left)),
        ("rover", moment.rover, "", ""),
    ]
    for name, value, other, second in rows:
        figures.add_row(Text(name, style="dim"), Text(value, style="bold"), Text(other, style="dim"), Text(second))
    bar = ProgressBar(total=max(1, moment.samples_total), completed=moment.samples, width=64)
    parts: list[Any] = [bar, Text(""), figures]
    if len(rmse_curve) > 1:
        parts += [Text(""), Text.assemble(("RMSE  ", "dim"), (sparkline(rmse_curve, 58), "cyan"))]
    if moment.detail:
        parts += [Text(moment.detail, style="yellow")]
    return Panel(Group(*parts), title=title, subtitle=note, box=box.ROUNDED, expand=False, padding=(1, 2))


def sparkline(values: list[float], width: int) -> str:
    """The values as a line of block characters, at most `width` long, lowest to highest."""
    if len(values) > width:
        values = [values[round(i * (len(values) - 1) / (width - 1))] for i in range(width)]
    low, high = min(values), max(values)
    scale = 7 / (high - low) if high > low else 0.0
    return "".join("▁▂▃▄▅▆▇█"[round((value - low) * scale)] for value in values)


def progress_for(title: str, note: str, quiet: bool = False) -> Progress:
    """The display that suits standard error: a panel on a terminal, lines elsewhere, nothing with --quiet."""
    if quiet:
        return SilentProgress()
    return LiveProgress(title, note) if sys.stderr.isatty() else PlainProgress()


def _ppb(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f} ppb"
