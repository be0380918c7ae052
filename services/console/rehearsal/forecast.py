"""What is to be expected of the mission: medians and bands over rehearsals."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from multiprocessing import get_context
from signal import SIG_IGN, SIGINT, signal
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import stdtrit

from he3.errors import InvalidInput
from services.console.client.time_format import duration
from services.console.rehearsal.flight import Flight, Start, assumptions, fly, scenario_of
from services.ground.pure_tasks import MissionExecutor
from services.mission.regions import load_region
from services.runtime.child import child_environment
from services.runtime.entry import end_with_parent

if TYPE_CHECKING:
    from he3.reference import Region

LEVELS: Final = (0.68, 0.95)
RANKED_FROM: Final = 39
"""Flights from which the bands are ranks: of fewer, smallest and largest hold the next one in less than 95 %."""
MIN_DRAWS: Final = 2
MAX_DRAWS: Final = 200
FIGURES: Final = ("lasts_s", "driven_m", "samples", "mean_std_ppb", "charge_wh", "lowest_wh")


@dataclass(frozen=True, slots=True)
class Band:
    """Median of a figure over the flights, and the bands in which one more flight lies with 68 and 95 %."""

    median: float
    low_68: float
    high_68: float
    low_95: float
    high_95: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Band:
        """The band of these values, at least two, none of them negative.

        From `RANKED_FROM` values on the bands are ranks i/(n + 1), for any distribution. Of fewer they are Student's
        prediction interval, which takes the values as normally distributed.
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
                low, high = max(0.0, middle - half), middle + half
            bounds += [float(low), float(high)]
        return cls(middle, *bounds)


@dataclass(frozen=True, slots=True)
class Forecast:
    """The rehearsals of one mission from one moment."""

    at: int
    """Mission time of the copy [ns]."""
    assumptions: tuple[str, ...]
    flights: tuple[Flight, ...]
    """In the order of their draws."""
    wall_s: float

    def band(self, figure: str) -> Band:
        """The band of that figure, one of `FIGURES`, over the flights."""
        return Band.of([getattr(flight, figure) for flight in self.flights])

    def rounds(self) -> dict[int, Band]:
        """Seconds from now to the end of each round that every flight has ended, by its number."""
        numbers = set.intersection(*(set(flight.rounds_s) for flight in self.flights))
        return {number: Band.of([flight.rounds_s[number] for flight in self.flights]) for number in sorted(numbers)}

    def document(self) -> dict[str, Any]:
        """The forecast as JSON values; tracks included."""
        return {
            "at": self.at,
            "assumptions": list(self.assumptions),
            "wall_s": self.wall_s,
            "bands": {figure: asdict(self.band(figure)) for figure in FIGURES},
            "rounds_s": {str(number): asdict(band) for number, band in self.rounds().items()},
            "flights": [asdict(flight) for flight in self.flights],
        }

    def rows(self) -> list[tuple[str, str]]:
        """The forecast as names and texts for people."""
        ended = [flight for flight in self.flights if not flight.completed]
        rows = [("ends in", _band(self.band("lasts_s"), duration))]
        nearest = list(self.rounds().items())[:3]
        rows += [(f"round {number}", f"done in {_band(band, duration)}") for number, band in nearest]
        rows += [
            ("drives", _band(self.band("driven_m"), lambda value: f"{value:,.0f} m")),
            ("samples", _band(self.band("samples"), lambda value: f"{value:.0f}")),
            ("mean std", _band(self.band("mean_std_ppb"), lambda value: f"{value:.4f} ppb")),
            ("battery", f"{_band(self.band('charge_wh'), _wh)} at the end"),
            ("lowest", _band(self.band("lowest_wh"), _wh)),
        ]
        if ended:
            rows.append(("NOT DONE", f"{len(ended)} of {len(self.flights)}, for example: {ended[0].why}"))
        rows += [("assumes", line) for line in self.assumptions]
        few = "; the bands of so few take them as normally distributed" if len(self.flights) < RANKED_FROM else ""
        rows.append(("draws", f"{len(self.flights)} in {self.wall_s:.1f} s{few}"))
        return rows


def rehearse(
    start: Start,
    draws: int,
    on_flight: Callable[[Flight], None] = lambda flight: None,
    processes: int | None = None,
) -> Forecast:
    """Fly the rest of the mission that often, in child processes. on_flight: called with each flight that is done.

    processes: None: one for each processor. Raises InvalidInput for another number of draws, and for a
    mission that cannot be rehearsed here.
    """
    if not MIN_DRAWS <= draws <= MAX_DRAWS:
        raise InvalidInput(f"rehearsal: expected {MIN_DRAWS} to {MAX_DRAWS} draws, got {draws}")
    scenario_of(start.fork)
    began = time.monotonic()
    flights: list[Flight] = []
    with _pool(min(draws, processes or os.cpu_count() or 1)) as pool:
        waiting: list[Future[Flight]] = [pool.submit(_flown, start, draw) for draw in range(draws)]
        for done in as_completed(waiting):
            flights.append(done.result())
            on_flight(flights[-1])
    flights.sort(key=lambda flight: flight.draw)
    return Forecast(start.fork.at, tuple(assumptions(start)), tuple(flights), time.monotonic() - began)


@contextmanager
def _pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    """Child processes; none is left when an error or Ctrl-C ends the wait for them."""
    before = {name: os.environ.get(name) for name in child_environment()}
    os.environ.update(child_environment())  # each child computes with one BLAS thread
    pool = ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_begin)
    try:
        yield pool
    except BaseException:
        for child in (pool._processes or {}).values():
            child.kill()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _begin() -> None:
    """Leave Ctrl-C to the parent, and end with it."""
    signal(SIGINT, SIG_IGN)
    end_with_parent()


def _flown(start: Start, draw: int) -> Flight:
    scenario = scenario_of(start.fork)
    region = _region(scenario.region, scenario.field.field_seed)
    with MissionExecutor() as executor:  # as in the live mission, no plan depends on those before it
        return fly(start, region, draw, executor)


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


def _wh(value: float) -> str:
    return f"{value:,.0f} Wh"
