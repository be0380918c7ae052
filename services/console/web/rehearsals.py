"""The page's rehearsals: one at a time, in a thread, and the last one kept for every browser.

Who has begun a rehearsal may stop it, and so may people who may change the mission. The name of the login is a
person's name here; people who share a login share it.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from he3.errors import Busy, He3Error, InvalidInput

if TYPE_CHECKING:
    from collections.abc import Callable

    from services.console.client.mission_client import MissionClient
    from services.console.rehearsal.alternative import Alternative
    from services.console.rehearsal.flight import Flight
    from services.console.rehearsal.forecast import Forecast

    Rehearse = Callable[
        [MissionClient, int, Callable[[Flight], None], tuple[Alternative, ...], threading.Event], tuple[Forecast, ...]
    ]
    """Flies the rest of the mission: draws, what is called with each flight, the alternatives, and what stops it."""

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

    def __init__(self, mission: MissionClient, rehearse: Rehearse | None, first: int = 1) -> None:
        """rehearse: None for a recording, which has nothing ahead. first: the number of the first rehearsal."""
        self._mission = mission
        self._rehearse = rehearse
        self._next = first
        self._lock = threading.Lock()
        self._last: _Rehearsal | None = None

    def begin(self, draws: int, alternatives: tuple[Alternative, ...], by: str) -> None:
        """Begin a rehearsal of each alternative. by: who wants it.

        Raises InvalidInput for a recording, Busy while one is under way.
        """
        if self._rehearse is None:
            raise InvalidInput("expected a running mission, got a recording, which cannot be rehearsed")
        with self._lock:
            last = self._last
            if last is not None and last.running:
                raise Busy(
                    f"a rehearsal of {last.by} is under way, {last.done} of {last.flights} done: wait, or stop it"
                )
            rehearsal = self._last = _Rehearsal(self._next, draws * len(alternatives), by)
            self._next += 1
        threading.Thread(
            target=self._fly, args=(rehearsal, draws, alternatives), name="web-rehearsal", daemon=True
        ).start()

    def stop(self, number: int, by: str, of_any: bool) -> None:
        """End that rehearsal. by: who wants it. of_any: whether this person may end the rehearsals of others.

        Raises InvalidInput if it is not under way, or is another person's.
        """
        with self._lock:
            last = self._last
            if last is None or not last.running or last.number != number:
                raise InvalidInput(f"rehearsal: expected the one that is under way, got number {number}")
            if not (of_any or last.by == by):
                raise InvalidInput(f"rehearsal: only {last.by}, an operator or a controller may stop it, got {by}")
            last.stop.set()

    def close(self) -> None:
        """End the rehearsal that is under way, if there is one: the server ends."""
        with self._lock:
            if self._last is not None:
                self._last.stop.set()

    def document(self, known: int | None = None, *, by: str = "", of_any: bool = False) -> dict[str, Any]:
        """The last rehearsal as JSON values. known: the number of the one whose result is not wanted again.

        by, of_any: whom it is for, as for `stop`.
        """
        with self._lock:
            last = self._last
            if last is None:
                return {"number": 0, "running": False}
            told = {"number": last.number, "running": last.running, "done": last.done, "of": last.flights}
            result = None if last.number == known else last.result
            may_stop = last.running and (of_any or last.by == by)
            return {**told, "by": last.by, "may_stop": may_stop, "why": last.why, "result": result}

    def _fly(self, rehearsal: _Rehearsal, draws: int, alternatives: tuple[Alternative, ...]) -> None:
        assert self._rehearse is not None, "refused by `begin`"

        def count(_: Flight) -> None:
            with self._lock:
                rehearsal.done += 1

        result, why = None, "rehearsal: it broke off"
        try:
            found = self._rehearse(self._mission, draws, count, alternatives, rehearsal.stop)
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
        "more": forecasts[-1].differences(first),
    }


def _forecast(forecast: Forecast) -> dict[str, Any]:
    """The forecast without its flights, but for their tracks as x and y [m]."""
    document = forecast.document()
    del document["flights"]
    tracks = [
        [(round(x, TRACK_DIGITS), round(y, TRACK_DIGITS)) for _, x, y in flight.track_m] for flight in forecast.flights
    ]
    return {**document, "not_done": forecast.not_done(), "tracks_m": tracks}
