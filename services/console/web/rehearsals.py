"""The page's rehearsals: one at a time, in a thread, and the last one kept for every browser."""

from __future__ import annotations

import threading
from dataclasses import asdict, dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from he3.errors import Busy, He3Error, InvalidInput
from services.console.rehearsal.alternative import AS_PLANNED, parse_alternative

if TYPE_CHECKING:
    from services.console.client.mission_client import MissionClient
    from services.console.rehearsal.alternative import Alternative
    from services.console.rehearsal.flight import Flight
    from services.console.rehearsal.forecast import Forecast

BEGINNING: Final = "services.console.rehearsal.beginning"
FORECAST: Final = "services.console.rehearsal.forecast"
"""Imported with the first rehearsal: they have the ground station and all that it computes with."""
TRACK_DIGITS: Final = 1


@dataclass(slots=True)
class _Rehearsal:
    """One rehearsal, under way or over."""

    number: int
    flights: int
    by: str
    done: int = 0
    why: str = ""
    """Why it came to nothing; empty while it is under way, and if it did not."""
    result: dict[str, Any] | None = None
    stop: threading.Event = field(default_factory=threading.Event)

    @property
    def running(self) -> bool:
        return self.result is None and not self.why


class Rehearsals:
    """Rehearses the mission for the page."""

    def __init__(self, mission: MissionClient, recorded: bool) -> None:
        """recorded: whether the mission is a recording, which has nothing ahead."""
        self._mission = mission
        self._recorded = recorded
        self._lock = threading.Lock()
        self._last: _Rehearsal | None = None

    def begin(self, draws: int, against: str | None, by: str) -> None:
        """Begin a rehearsal. against: an alternative to be rehearsed beside it, in words; by: who wants it.

        Raises InvalidInput for an alternative that is none, and for a recording; Busy while one is under way.
        """
        if self._recorded:
            raise InvalidInput("expected a running mission, got a recording, which cannot be rehearsed")
        alternatives = (AS_PLANNED,) if against is None else (AS_PLANNED, parse_alternative(against))
        with self._lock:
            last = self._last
            if last is not None and last.running:
                raise Busy(
                    f"a rehearsal of {last.by} is under way, {last.done} of {last.flights} done: wait, or stop it"
                )
            number = 1 if last is None else last.number + 1
            rehearsal = self._last = _Rehearsal(number, draws * len(alternatives), by)
        threading.Thread(
            target=self._fly, args=(rehearsal, draws, alternatives), name="web-rehearsal", daemon=True
        ).start()

    def stop(self) -> None:
        """End the rehearsal that is under way, if there is one."""
        with self._lock:
            if self._last is not None:
                self._last.stop.set()

    def document(self, known: int | None = None) -> dict[str, Any]:
        """The last rehearsal as JSON values. known: the number of the one whose result is not wanted again."""
        with self._lock:
            last = self._last
            if last is None:
                return {"number": 0, "running": False}
            told = {"number": last.number, "running": last.running, "done": last.done, "of": last.flights}
            result = None if last.number == known else last.result
            return {**told, "by": last.by, "why": last.why, "result": result}

    def _fly(self, rehearsal: _Rehearsal, draws: int, alternatives: tuple[Alternative, ...]) -> None:
        begin, fly = import_module(BEGINNING), import_module(FORECAST)

        def count(_: Flight) -> None:
            with self._lock:
                rehearsal.done += 1

        result, why = None, "rehearsal: it broke off"
        try:
            start = begin.start_of(self._mission)
            found = fly.rehearse(start, draws, count, alternatives=alternatives, stop=rehearsal.stop)
            result, why = _result(found), ""
        except He3Error as error:
            why = str(error)
        finally:  # whatever happens, the next one can begin
            with self._lock:
                rehearsal.result, rehearsal.why = result, why


def _result(forecasts: tuple[Forecast, ...]) -> dict[str, Any]:
    first = forecasts[0]
    return {
        "at": first.at,
        "draws": len(first.flights),
        "wall_s": first.wall_s,
        "drawn": first.drawn(),
        "assumptions": list(first.assumptions),
        "forecasts": [_forecast(each) for each in forecasts],
        "more": {figure: asdict(forecasts[-1].less(first, figure)) for figure in import_module(FORECAST).FIGURES},
    }


def _forecast(forecast: Forecast) -> dict[str, Any]:
    """The forecast without its flights, but for their tracks as x and y [m]."""
    document = forecast.document()
    del document["flights"]
    tracks = [
        [(round(x, TRACK_DIGITS), round(y, TRACK_DIGITS)) for _, x, y in flight.track_m] for flight in forecast.flights
    ]
    return {**document, "not_done": forecast.not_done(), "tracks_m": tracks}
