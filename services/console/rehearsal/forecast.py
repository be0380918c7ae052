"""What is to be expected of the mission: medians and bands over rehearsals."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from multiprocessing import get_context
from signal import SIG_IGN, SIGINT, signal
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import stdtrit

from he3.errors import He3Error, InvalidInput
from services.console.client.time_format import duration
from services.console.rehearsal.alternative import AS_PLANNED, Alternative
from services.console.rehearsal.flight import Flight, Start, assumptions, fly, scenario_of
from services.ground.pure_tasks import MissionExecutor
from services.mission.regions import load_region
from services.runtime.child import child_environment
from services.runtime.entry import end_with_parent

if TYPE_CHECKING:
    from threading import Event

    from he3.reference import Region
    from services.console.client.mission_client import MissionClient

LEVELS: Final = (0.68, 0.95)
RANKED_FROM: Final = 39
"""Flights from which the bands are ranks: of fewer, smallest and largest hold the next one in less than 95 %."""
DISCREPANCY: Final = 1.5
"""Factor of the bands' width about the median. Missions differ from their rehearsals by more than rehearsals from each
other, because no field is quite a draw from its posterior (Kennedy & O'Hagan 2001 on the discrepancy of a model).
Of the first missions of ``he3 bench rehearsal``, figures lay up to 1.4 half-widths of 95 % from the median."""
MIN_DRAWS: Final = 2
MAX_DRAWS: Final = 200
CURVE_POINTS: Final = 60
"""Moments of a curve over the time of the flights."""
NICENESS: Final = 5
STOPPED_EVERY_S: Final = 0.2
"""Wall time between two looks at whether to stop."""
FIGURES: Final = ("lasts_s", "driven_m", "samples", "mean_std_ppb", "charge_wh", "lowest_wh")


class Stopped(He3Error):
    """A rehearsal was stopped before its end."""


@dataclass(frozen=True, slots=True)
class Band:
    """Median of a figure over the flights, and the bands in which one more flight lies with 68 and 95 %."""

    median: float
    low_68: float
    high_68: float
    low_95: float
    high_95: float

    @classmethod
    def of(cls, values: Sequence[float], least: float = 0.0) -> Band:
        """The band of these values, at least two. least: below which there can be none.

        From `RANKED_FROM` values on the bands are ranks i/(n + 1), for any distribution (Wilks 1941). Of fewer they are
        Student's prediction interval for one further value, t s sqrt(1 + 1/n), which takes the values as normally
        distributed; that of 95 % also has all values, because most figures have longer tails: metres are the same in
        most flights, and others in those that plan by another kernel.
        """
        sample = np.asarray(values, dtype=np.float64)
        middle, count = float(np.median(sample)), len(sample)
        bounds: list[float] = []
        for level in LEVELS:
            tails = (0.5 - level / 2.0, 0.5 + level / 2.0)
            if count >= RANKED_FROM:
                low, high = np.quantile(sample, tails, method="weibull")
            else:
                half = stdtrit(count - 1, tails[1]) * sample.std(ddof=1) * math.sqrt(1.0 + 1.0 / count)
                low, high = max(least, middle - half), middle + half
                if level == LEVELS[-1]:
                    low, high = min(low, sample.min()), max(high, sample.max())
            bounds += [float(low), float(high)]
        return cls(middle, *bounds)

    def widened(self) -> Band:
        """The band of the mission, where this one is of one more flight; none of its values is negative."""
        around = (self.low_68, self.high_68, self.low_95, self.high_95)
        return Band(self.median, *(max(0.0, self.median + DISCREPANCY * (each - self.median)) for each in around))


@dataclass(frozen=True, slots=True)
class Forecast:
    """The rehearsals of one mission from one moment."""

    name: str
    """What is done at its beginning."""
    at: int
    """Mission time of the copy [ns]."""
    assumptions: tuple[str, ...]
    flights: tuple[Flight, ...]
    """In the order of their draws."""
    wall_s: float

    def band(self, figure: str) -> Band:
        """The band of that figure of the mission, one of `FIGURES`."""
        return Band.of([getattr(flight, figure) for flight in self.flights]).widened()

    def rounds(self) -> dict[int, Band]:
        """Seconds from now to the end of each round that every flight has ended, by its number."""
        numbers = set.intersection(*(set(flight.rounds_s) for flight in self.flights))
        ends_s = {number: [flight.rounds_s[number] for flight in self.flights] for number in sorted(numbers)}
        return {number: Band.of(each).widened() for number, each in ends_s.items()}

    def charges(self) -> list[tuple[float, Band]]:
        """The battery's charge [Wh] at moments in seconds from now, up to the end of the first flight."""
        ends_s = min(flight.lasts_s for flight in self.flights)
        moments_s = np.linspace(0.0, ends_s, CURVE_POINTS)
        each = np.array(
            [np.interp(moments_s, *np.array(flight.charges_wh).T) for flight in self.flights if flight.charges_wh]
        )
        if len(each) < MIN_DRAWS:
            return []
        return [(float(at_s), Band.of(each[:, number].tolist()).widened()) for number, at_s in enumerate(moments_s)]

    def minus(self, other: Forecast, figure: str) -> Band:
        """The band of that figure here minus that in the other, draw by draw; not widened."""
        pairs = zip(self.flights, other.flights, strict=True)
        return Band.of([getattr(here, figure) - getattr(there, figure) for here, there in pairs], -math.inf)

    def differences(self, other: Forecast) -> dict[str, Any]:
        """The bands of how much more each figure is here than in the other, as JSON values."""
        return {figure: asdict(self.minus(other, figure)) for figure in FIGURES}

    def document(self) -> dict[str, Any]:
        """The forecast as JSON values; tracks included."""
        return {
            "name": self.name,
            "at": self.at,
            "assumptions": list(self.assumptions),
            "wall_s": self.wall_s,
            "bands": {figure: asdict(self.band(figure)) for figure in FIGURES},
            "charges_wh": [{"at_s": at_s, **asdict(band)} for at_s, band in self.charges()],
            "rounds_s": {str(number): asdict(band) for number, band in self.rounds().items()},
            "flights": [asdict(flight) for flight in self.flights],
        }

    def rows(self) -> list[tuple[str, str]]:
        """The forecast as names and texts for people."""
        rows = [("ends in", _band(self.band("lasts_s"), duration))]
        nearest = list(self.rounds().items())[:3]
        rows += [(f"round {number}", f"done in {_band(band, duration)}") for number, band in nearest]
        rows += [
            ("drives", _band(self.band("driven_m"), _m)),
            ("samples", _band(self.band("samples"), _count)),
            ("mean std", _band(self.band("mean_std_ppb"), _ppb)),
            ("battery", f"{_band(self.band('charge_wh'), _wh)} at the end"),
            ("lowest", _band(self.band("lowest_wh"), _wh)),
        ]
        if failed := self.not_done():
            rows.append(("NOT DONE", failed))
        return [*rows, *self.notes(), ("draws", self.drawn())]

    def not_done(self) -> str:
        """How many flights did not complete the mission, and why one of them did not; empty if all did."""
        ended = [flight for flight in self.flights if not flight.completed]
        return f"{len(ended)} of {len(self.flights)}, for example: {ended[0].why}" if ended else ""

    def notes(self) -> list[tuple[str, str]]:
        """What the rehearsals take for granted, as names and texts."""
        return [("assumes", line) for line in self.assumptions]

    def drawn(self) -> str:
        """How many flights there are, how long they took, and what their bands take for granted."""
        few = "; the bands of so few take them as normally distributed" if len(self.flights) < RANKED_FROM else ""
        return f"{len(self.flights)} in {self.wall_s:.1f} s{few}"


def rehearse(
    start: Start,
    draws: int,
    on_flight: Callable[[Flight], None] = lambda flight: None,
    processes: int | None = None,
    alternatives: Sequence[Alternative] = (AS_PLANNED,),
    stop: Event | None = None,
) -> tuple[Forecast, ...]:
    """Fly the rest of the mission that often under each alternative, in child processes; a forecast for each.

    on_flight: called with each flight that is done. processes: None: one for each processor. stop: ends it when it is
    set. Raises InvalidInput for another number of draws, for a mission that cannot be rehearsed here, and for a command
    that the ground refuses; Stopped if it was stopped.
    """
    if not MIN_DRAWS <= draws <= MAX_DRAWS:
        raise InvalidInput(f"rehearsal: expected {MIN_DRAWS} to {MAX_DRAWS} draws, got {draws}")
    scenario_of(start.fork)
    began = time.monotonic()
    flights: dict[int, list[Flight]] = {number: [] for number in range(len(alternatives))}
    with _pool(min(draws * len(alternatives), processes or os.cpu_count() or 1), start) as pool:
        waiting: dict[Future[Flight], int] = {
            pool.submit(_flown, draw, alternative): number
            for draw in range(draws)
            for number, alternative in enumerate(alternatives)
        }
        left = set(waiting)
        while left:
            done, left = wait(left, STOPPED_EVERY_S, FIRST_COMPLETED)
            if stop is not None and stop.is_set():
                raise Stopped("rehearsal: it was stopped")
            for each in done:
                flights[waiting[each]].append(_result(each))
                on_flight(_result(each))
    wall_s = time.monotonic() - began
    return tuple(
        Forecast(
            alternative.name,
            start.fork.at,
            tuple(assumptions(start)),
            tuple(sorted(flights[number], key=lambda flight: flight.draw)),
            wall_s,
        )
        for number, alternative in enumerate(alternatives)
    )


def start_of(mission: MissionClient) -> Start:
    """The mission as its ground knows it now, its link, and the commands under way; the mission does not change."""
    under_way = tuple(status.command for status in mission.commands() if status.end is None)
    return Start(mission.fork(), mission.link(), under_way)


def rehearse_live(
    mission: MissionClient,
    draws: int,
    on_flight: Callable[[Flight], None],
    alternatives: tuple[Alternative, ...],
    stop: Event,
) -> tuple[Forecast, ...]:
    """As `rehearse`, from where a running mission is now."""
    return rehearse(start_of(mission), draws, on_flight, alternatives=alternatives, stop=stop)


def _result(done: Future[Flight]) -> Flight:
    try:
        return done.result()
    except BrokenProcessPool:
        raise He3Error("rehearsal: expected its processes to go on, got one that has ended") from None


@contextmanager
def _pool(processes: int, start: Start) -> Iterator[ProcessPoolExecutor]:
    """Child processes for flights from there; none is left when all are done, or an error or Ctrl-C ends the wait."""
    before = {name: os.environ.get(name) for name in child_environment()}
    os.environ.update(child_environment())  # each child computes with one BLAS thread
    pool = ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_begin, initargs=(start,))
    try:
        yield pool
    finally:
        for child in (pool._processes or {}).values():
            child.kill()  # it keeps nothing, and would take a fifth of a second to end by itself
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


_starts: list[Start] = []
"""In a child process, where its flights begin."""


def _begin(start: Start) -> None:
    """Leave Ctrl-C to the parent, end with it, and keep where the flights begin."""
    signal(SIGINT, SIG_IGN)
    end_with_parent()
    os.nice(NICENESS)  # a live mission may run on this machine
    _starts.append(start)


def _flown(draw: int, alternative: Alternative) -> Flight:
    start = _starts[-1]
    scenario = scenario_of(start.fork)
    region = _region(scenario.region, scenario.field.field_seed)
    with MissionExecutor() as executor:  # as in the live mission, no plan depends on those before it
        return fly(start, region, draw, executor, alternative)


@cache
def _region(name: str, field_seed: int) -> Region:
    return load_region(name, field_seed)


def _band(band: Band, text: Callable[[float], str]) -> str:
    if text(band.low_95) == text(band.high_95):
        return text(band.median)
    return (
        f"{text(band.median)}; 68 %: {text(band.low_68)} to {text(band.high_68)}; "
        f"95 %: {text(band.low_95)} to {text(band.high_95)}"
    )


def compared(one: Forecast, other: Forecast) -> list[tuple[str, ...]]:
    """Two forecasts side by side: names, and texts of the one, of the other, and of how much the other differs.

    The difference is taken draw by draw. Below each median stands its 95 % band.
    """
    rows: list[tuple[str, ...]] = [("", one.name, other.name, "difference")]
    for figure, (name, text, more) in _SHOWN.items():
        shown = ((one.band(figure), text), (other.band(figure), text), (other.minus(one, figure), more))
        rows.append((name, *(said(band.median) for band, said in shown)))
        ends = [(said(band.low_95), said(band.high_95)) for band, said in shown]
        if any(low != high for low, high in ends):
            rows.append(("  95 %", *(f"{low} to {high}" for low, high in ends)))
    failed = one.not_done(), other.not_done()
    if any(failed):
        rows.append(("NOT DONE", *failed, ""))
    return rows


def _signed(text: Callable[[float], str]) -> Callable[[float], str]:
    """The text of a difference: with its sign, unless it is as good as none."""

    def said(value: float) -> str:
        size = text(abs(value))
        return size if size == text(0.0) else f"{'-' if value < 0 else '+'}{size}"

    return said


def _wh(value: float) -> str:
    return f"{value:,.0f} Wh"


def _m(value: float) -> str:
    return f"{value:,.0f} m"


def _ppb(value: float) -> str:
    """Three digits: two decimals from 1 ppb on, one from 10 ppb on; below 1 ppb three decimals."""
    return f"{value:.{3 if value < 1.0 else 2 if value < 10.0 else 1}f} ppb"


def _count(value: float) -> str:
    return f"{value:.0f}"


_SHOWN: Final[dict[str, tuple[str, Callable[[float], str], Callable[[float], str]]]] = {
    figure: (name, text, _signed(text))
    for figure, name, text in (
        ("lasts_s", "ends in", duration),
        ("driven_m", "drives", _m),
        ("samples", "samples", _count),
        ("mean_std_ppb", "mean std", _ppb),
        ("charge_wh", "battery", _wh),
        ("lowest_wh", "lowest", _wh),
    )
}
"""Name and texts of each figure, of its value and of a difference."""
