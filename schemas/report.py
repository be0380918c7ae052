"""The report of a finished mission: one JSON document."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from schemas.ground import GoalStatus
from schemas.link import DirectionCounts
from schemas.maps import CrossValidationFigures, MapScore, ReachScore, RegionLayer
from schemas.wire import Count, Provenance, Text, Wire, is_none


class MessageCounts(Wire):
    """Messages across the link, both directions together."""

    sent: Count
    delivered: Count
    retransmitted: Count
    lost: Count
    up: DirectionCounts
    down: DirectionCounts


class ReportSample(Wire):
    """One measurement, as received on the ground."""

    sample_id: Text
    round: Count
    x_m: float
    y_m: float
    helium3_ppb: float
    measured_at_s: float
    """Mission time since the start [s]."""


class DrivingReport(Wire):
    """What driving took, by the rover's own model over the region's terrain; charging and sampling are not in it."""

    cost: Literal["distance", "time", "energy"]
    """What the planner kept low (`ground.cost`)."""
    unit: Literal["m", "h", "Wh"]
    spent: float
    """The cost, in that unit."""
    duration_h: float
    energy_wh: float
    """Energy that was drawn in motion, the base load included."""
    motion_wh: float
    """Of it, for traction and climbing."""
    climb_m: float
    """Sum of all rises from cell to cell."""
    steepest_deg: float
    """The steepest cell on the path."""


class ClosedGroundReport(Wire):
    """Shares of the site that are closed to the rover, each cell under its first reason, and the share cut off."""

    too_steep: float
    """Steeper than the rover, the planners or the region's rule admit, and not unknown."""
    rough: float
    """Not traversable in the region for another reason: steps, roughness or rocks, or by the paper's rule of relief."""
    unknown: float = 0.0
    """Without a value of the reference field, which only a simulated Moon has, whatever else closes such a cell."""
    keep_outs: float
    margin: float
    """So near to closed ground that the rover's footprint would touch it."""
    cut_off: float
    """Open, but not connected to the start."""


class LearnedReport(Wire):
    """What the samples showed of the instrument's noise, of a field's two lengths, of its skew and of uneven parts."""

    noise_std_ppb: float
    """Standard deviation of the noise that the map counts, over all kernels of the mixture."""
    stated_noise_std_ppb: float
    stretched_weight: float
    """Weight of the kernels with two lengths, 0 to 1."""
    stretch: float | None
    """Ratio of the lengths of the heaviest of these; None if there are none."""
    bearing_deg: float | None
    """Of its longer axis, clockwise from north, 0 to 180."""
    varies_more_where: Literal["high", "low"] | None = Field(default=None, exclude_if=is_none)
    """Where a skewed field varies more; None where the samples do not speak for a skew."""
    skewed_weight: Annotated[float, Field(ge=0, le=1)] | None = Field(default=None, exclude_if=is_none)
    """Weight of the kernels of such a field; None as above."""
    uneven_weight: Annotated[float, Field(ge=0, le=1)] | None = Field(default=None, exclude_if=is_none)
    """Weight of the kernels of a field that varies more in some parts than in others; None if it is small."""


class MissionReport(Wire):
    """The course of a mission and the quality of its map. Equal runs differ in `wall_time_s` and `host` only."""

    scenario: Text
    region: Text
    region_note: Provenance
    """Provenance of the region's data; the embedded regions are synthetic stand-ins."""
    region_layers: tuple[RegionLayer, ...] = ()
    """Provenance of each layer of the region; empty if the region does not give it."""
    planner: Text
    kernel: Text
    kernel_weights: dict[str, float] | None = Field(default=None, exclude_if=is_none)
    """Weight of each kernel in the final map, by name, the heaviest first; None where all of it has one name. As few
    kernels stand for many, it is not the probability of the name."""
    seed: int
    driver: Text
    """in-process, zenoh or lockstep."""
    rate: float | None
    completed: bool
    detail: Text
    """The reason for the mission's end, as the ground states it."""
    rounds: Count
    samples: Count
    samples_wanted: Count
    """Samples that the scenario asks for; a mission with fewer ended early."""
    rmse_ppb: float | None
    """RMSE of the final map, over all cells; None, like the coverages, if there is no reference field."""
    rmse_history: tuple[MapScore, ...]
    """One entry per round."""
    coverage_68: float | None
    coverage_95: float | None
    within_reach: ReachScore | None = Field(default=None, exclude_if=is_none)
    """RMSE and coverages over the ground that the rover can reach; None where that is all, or without a reference."""
    cross_validation: CrossValidationFigures | None = Field(default=None, exclude_if=is_none)
    """Each sample as the others predict it; None without a sample, in reports of earlier versions, and where the ground
    did not answer in time."""
    path_length_m: float
    driving: DrivingReport | None = None
    closed_ground: ClosedGroundReport | None = None
    learned: LearnedReport | None = Field(default=None, exclude_if=is_none)
    """None where the samples spoke for the stated noise and one length."""
    goal: GoalStatus | None = Field(default=None, exclude_if=is_none)
    """The goal and its certificate at the mission's end; None for a mission without a goal."""
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
    """One line, with file and cause, for each output that was not written, or not completely."""
