"""The report of a finished mission: one JSON document."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from schemas.link import DirectionCounts
from schemas.maps import MapScore
from schemas.wire import Text, Wire

Count = Annotated[int, Field(ge=0)]


class MessageCounts(Wire):
    """Messages across the link, both directions together."""

    sent: Count
    delivered: Count
    retransmitted: Count
    lost: Count
    up: DirectionCounts
    down: DirectionCounts


class ReportSample(Wire):
    """One measurement as the ground has it."""

    sample_id: Text
    round: Count
    x_m: float
    y_m: float
    helium3_ppb: float
    measured_at_s: float
    """Seconds of mission time since the start."""


class MissionReport(Wire):
    """What a mission did and how good its map is. Only `wall_time_s` and `host` differ between equal runs."""

    scenario: Text
    region: Text
    region_note: Text
    """What the region's data are: the embedded regions are synthetic stand-ins."""
    planner: Text
    kernel: Text
    seed: int
    driver: Text
    """in-process, zenoh or lockstep."""
    rate: float | None
    completed: bool
    detail: Text
    """Why it ended as it did, in the ground's words."""
    rounds: Count
    samples: Count
    samples_wanted: Count
    """What the scenario asks for; fewer samples are a mission that ended early."""
    rmse_ppb: float | None
    """Of the final map, over all cells; None, as the coverages are, where nobody knows the truth."""
    rmse_history: tuple[MapScore, ...]
    """One entry a round."""
    coverage_68: float | None
    coverage_95: float | None
    path_length_m: float
    drilled_m: float
    mission_time_s: float
    wall_time_s: float
    messages: MessageCounts
    sample_table: tuple[ReportSample, ...]
    path_m: tuple[tuple[float, float], ...]
    one_way_light_time_s: float
    version: Text
    host: Text
    output_problems: tuple[Text, ...] = ()
    """One line, with file and cause, on each output of the mission that could not be written, or not in full."""
