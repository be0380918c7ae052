"""Measurements as they arrive: each enters the belief once, or is refused with the reason."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from he3.errors import He3Error
from services.ground.observation import Observation

if TYPE_CHECKING:
    from schemas.telemetry import SampleReport
    from services.ground.belief import Belief
    from services.ground.round_log import RoundLog
    from services.ground.round_record import RoundRecord
    from services.runtime.node import SavedState


@dataclass(frozen=True, slots=True)
class Taken:
    """The measurement is in the map; it belongs to that version of its round."""

    record: RoundRecord


@dataclass(frozen=True, slots=True)
class Refused:
    """The measurement cannot be right and is left out of the map; nothing more will come for its place."""

    record: RoundRecord
    why: str


@dataclass(frozen=True, slots=True)
class Unplanned:
    """The measurement was never planned."""

    why: str


@dataclass(frozen=True, slots=True)
class Repeated:
    """The measurement has arrived before."""


class SampleIntake:
    """Adds every planned measurement to the belief once, in any order of arrival."""

    def __init__(self, belief: Belief, round_log: RoundLog) -> None:
        self._belief = belief
        self._round_log = round_log
        self._refused: set[str] = set()
        self._reports: list[SampleReport] = []

    @property
    def reports(self) -> tuple[SampleReport, ...]:
        """Every measurement in the map, in the order in which they arrived."""
        return tuple(self._reports)

    def __len__(self) -> int:
        """Number of measurements in the map."""
        return len(self._reports)

    def take(self, report: SampleReport) -> Taken | Refused | Unplanned | Repeated:
        """Give the measurement to the belief, and note it in the round's record."""
        if report.sample_id in self._belief or report.sample_id in self._refused:
            return Repeated()
        known = self._round_log.of_sample(report.sample_id)
        if known is None:
            return Unplanned(f"sample {report.sample_id}: expected one that was planned; it is left out of the map")
        record, index = known
        planned = (record.number, record.introduced, index)
        try:
            self._belief.add(report.sample_id, Observation(planned, (report.x_m, report.y_m), report.helium3_ppb))
        except He3Error as error:
            self._refused.add(report.sample_id)
            record.settle(report.sample_id)
            return Refused(record, f"sample {report.sample_id} is left out of the map: {error}")
        self._reports.append(report)
        record.settle(report.sample_id, arrived=True)
        return Taken(record)

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "refused": set(self._refused),
            "reports": list(self._reports),
        }

    def restore(self, state: SavedState) -> None:
        """Restore the intake from this state."""
        self._refused = state["refused"]
        self._reports = state["reports"]
