"""One measurement, as the belief takes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from he3.frames import Place


@dataclass(frozen=True, slots=True)
class Observation:
    """One measurement."""

    planned: tuple[int, int, int]
    """Position in the order of planning: round, revision of the plan, index within the round."""
    place_m: Place
    """Place of the sample [m]."""
    value_ppb: float
