"""The ground station's messages to operators."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Final, Literal

from pydantic import Field

from schemas.maps import MapScore
from schemas.plans import Waypoint
from schemas.telemetry import RoverState, SampleReport
from schemas.wire import Count, Identifier, MissionTimeNs, PersonName, Text, Wire, is_none


class MissionPhase(StrEnum):
    WAITING = "waiting"
    """No message of the rover has arrived yet."""
    PLANNING = "planning"
    EXECUTING = "executing"
    COMPLETED = "completed"
    FAILED = "failed"


class FieldWarp(Wire):
    """The map between a latent field and the field, where that is skewed (``he3.warping``)."""

    centre_ppb: float
    width_ppb: Annotated[float, Field(gt=0)]
    shift: float
    """Above 0 where the field varies more where it is high, below 0 where it is low."""
    strength: Annotated[float, Field(gt=0)]
    noise_std_ppb: Annotated[float, Field(ge=0)]
    """The instrument's noise as stated, which is one of the field."""


class WeightedKernel(Wire):
    """One of the kernels of a mixture, in the same units as the one in use."""

    weight: Annotated[float, Field(gt=0, le=1)]
    name: Text | None = Field(default=None, exclude_if=is_none)
    """None where it is of the same name as the kernel in use."""
    parameters: dict[str, float]
    """Those that a kernel of its name has; ``stretch`` and ``bearing_deg`` where it has two lengths; ``amplitude_...``
    where it varies more in some parts of the site than in others (``he3.local_amplitude``)."""
    noise_std_ppb: float | None = Field(default=None, exclude_if=is_none)
    """None where the noise is that of the kernel in use."""
    warp: FieldWarp | None = Field(default=None, exclude_if=is_none)
    """With it, kernel and noise are those of a latent field; None where the field is none other."""


class KernelParameters(Wire):
    """The covariance function in use, in standardised units, with the scale of those units in ppb."""

    name: Text
    parameters: dict[str, float]
    noise_std_ppb: float
    mean_ppb: float
    scale_ppb: float
    mean_std_ppb: float | None = Field(default=None, exclude_if=is_none)
    """Prior standard deviation of what the mean may be off by; None where the mean is taken for certain."""
    level_extent_m: Annotated[float, Field(gt=0)] | None = Field(default=None, exclude_if=is_none)
    """Width of the site over which the mean varies (``he3.level``); None where it is the same everywhere."""
    trend_shares: Annotated[tuple[float, ...], Field(max_length=100)] | None = Field(default=None, exclude_if=is_none)
    """How much room each layer of the trend has, 0 for one that is left out; None without a choice."""
    alternatives: Annotated[tuple[WeightedKernel, ...], Field(max_length=100)] | None = Field(
        default=None, exclude_if=is_none
    )
    """The kernels that together stand for what the samples leave possible; None where this one is taken for certain."""


class CostTally(Wire):
    """What driving has cost so far, by the ground's knowledge."""

    kind: Literal["distance", "time", "energy"]
    unit: Literal["m", "h", "Wh"]
    spent: Annotated[float, Field(ge=0)]
    budget: Annotated[float, Field(gt=0)] | None
    """What it may cost in all; None: as much as it takes. A budget of hours counts all hours, and is not meant."""


class GoalForecast(Wire):
    """What the planner expects the goal to take from now on."""

    samples: Count | None
    """Further samples; None if all that are left do not suffice."""
    metres: Annotated[float, Field(ge=0)] | None
    worst_ppb: Annotated[float, Field(ge=0)]
    """Greatest standard deviation over the area after its design [ppb]."""
    budget_m: Annotated[float, Field(ge=0)] | None
    """Metres that are left; None: as many as it takes."""
    reachable: bool
    """Whether the samples and metres that are left suffice."""
    text: Text


class GoalStatus(Wire):
    """The mission's goal, and how far the map is from it."""

    std_ppb: Annotated[float, Field(gt=0)]
    probability: Annotated[float, Field(gt=0, lt=1)]
    area: Text
    holds: bool
    """Whether it is certified; the mission then ends."""
    worst_ppb: Annotated[float, Field(ge=0)] | None
    """Greatest standard deviation over the area [ppb]; None before the first refit."""
    share: Annotated[float, Field(ge=0, le=1)] | None
    """Share of the area that reaches the goal."""
    weight: Annotated[float, Field(ge=0, le=1)] | None
    """Probability of the hyperparameters under which all of the area does; None while the share is below 1."""
    likely_ppb: Annotated[float, Field(ge=0)] | None = None
    """Distance from the map [ppb] within which a share `probability` of the area lies with that probability."""
    unseen: Annotated[float, Field(ge=0)] | None = None
    """Greatest share that the samples leave of the variance of a field as it was thought to be before landing."""
    within_ppb: Annotated[float, Field(gt=0)] | None = None
    """Distance from the map [ppb] within which a share `probability` of the area is promised to lie, once it holds."""
    forecast: GoalForecast | None = None
    """None if it holds, and where the planner foresees nothing."""
    text: Text
    """All of it in words."""


class GroundStatus(Wire):
    """The state of the mission on the ground."""

    phase: MissionPhase
    planner: Text
    round: Count
    """Rounds completed."""
    rounds: Count
    """Rounds of the whole mission."""
    samples: Count
    """Measurements in the map."""
    samples_total: Count
    driven_m: Annotated[float, Field(ge=0)]
    budget_m: float | None
    plan_revision: Count
    plans_in_work: Count
    map_revision: Count
    mean_std_ppb: float | None
    kernel: KernelParameters | None
    score: MapScore | None
    """Score against the reference field, if a simulated Moon provides one. Belief and planners do not use it."""
    rover: RoverState | None
    rover_made_at: MissionTimeNs | None
    """Mission time at which the rover reported its last state; None if it has reported none."""
    cost: CostTally | None = Field(default=None, exclude_if=is_none)
    """What driving has cost, where `ground.cost` is not the distance."""
    goal: GoalStatus | None = Field(default=None, exclude_if=is_none)
    """The goal and its certificate; None for a mission without a goal."""
    detail: Text = ""
    proposal: Count | None = Field(default=None, exclude_if=is_none)
    """Number of the plan that waits for the operator's approval; None if none does."""

    @property
    def is_over(self) -> bool:
        """Whether the mission has completed or failed."""
        return self.phase in (MissionPhase.COMPLETED, MissionPhase.FAILED)


class KeepOutArea(Wire):
    """A part of the site that the rover may not enter. An area that is being changed has several outlines."""

    area_id: Identifier
    polygon_m: Annotated[tuple[Waypoint, ...], Field(min_length=3, max_length=256)]


MAX_OVERVIEW_CELLS: Final = 4096
"""Most cells of the values in an overview of the map: 64 x 64."""
MAX_OVERVIEW_CORNERS: Final = 4096
"""Most corners of the keep-outs in an overview; areas beyond are shown by its `traversable` alone."""


class MapValues(Wire):
    """Layers of the map as base64, row 0 in the south: mean and std as little-endian float32, traversable as bytes."""

    rows: Annotated[int, Field(ge=1, le=MAX_OVERVIEW_CELLS)]
    columns: Annotated[int, Field(ge=1, le=MAX_OVERVIEW_CELLS)]
    mean_base64: Annotated[str, Field(max_length=24_000)]
    std_base64: Annotated[str, Field(max_length=24_000)]
    traversable_base64: Annotated[str, Field(max_length=6_000)]


class MapOverview(Wire):
    """A new revision of the map: what led to it, a checksum of all its values, and some of them."""

    revision: Count
    samples: Count
    """Measurements in the map."""
    added: tuple[Identifier, ...]
    """The samples that were added since the revision before, in that order."""
    fits: Count
    """Changes of the hyperparameters so far; each rebuilds the map, from the samples in the order of their planning."""
    mission_time_ns: MissionTimeNs
    """Mission time of that revision."""
    kernel: KernelParameters
    rows: Count
    columns: Count
    resolution_m: Annotated[float, Field(gt=0)]
    origin_lat_deg: float | None
    """Latitude and longitude of the south-west corner; None if the region has no coordinates on the Moon."""
    origin_lon_deg: float | None
    checksum: Annotated[int, Field(ge=0, lt=2**32)]
    """CRC-32 of mean, then std, on all cells: little-endian float32, row 0 in the south."""
    step: Annotated[int, Field(ge=1)]
    """`values` are of every step-th cell: of the one in the middle of each block of step x step cells."""
    values: MapValues | None
    """None if only the checksum tells of the values."""
    keep_outs: tuple[KeepOutArea, ...] = ()


class InterestArea(Wire):
    """A part of the site whose uncertainty counts `weight` times in planning."""

    area_id: Identifier
    polygon_m: Annotated[tuple[Waypoint, ...], Field(min_length=3, max_length=256)]
    weight: Annotated[float, Field(ge=0, le=1000)]


class MissionTrack(Wire):
    """Samples, driven path, planned path, areas and scores of one revision of the map, when it was last shown."""

    samples: tuple[SampleReport, ...]
    driven_path_m: tuple[Waypoint, ...]
    planned_path_m: tuple[Waypoint, ...]
    score_history: tuple[MapScore, ...]
    plan_ends: MissionTimeNs | None = None
    keep_outs: tuple[KeepOutArea, ...] = ()
    """The areas in force for planning."""
    interests: tuple[InterestArea, ...] = ()
    """The areas of interest."""


class InterestChange(Wire):
    """Sets or removes an area of interest; without an area it is a query for the list of areas."""

    area_id: Identifier | None = None
    polygon_m: Annotated[tuple[Waypoint, ...], Field(min_length=3, max_length=256)] | None = None
    """Corners [m]; None removes the area."""
    weight: Annotated[float, Field(ge=0, le=1000)] = 2.0
    by: PersonName | None = Field(default=None, exclude_if=is_none)
    """Who changes it; in a mission with keys, the signer of the request."""


class InterestList(Wire):
    areas: tuple[InterestArea, ...]


class Presence(Wire):
    """Heartbeat of a process, sent every second of wall time."""

    name: Identifier
    side: Text
    incarnation: Count
    software: Text
    pid: Count
    host: Text
    refused: Count
    """Messages refused since the process started."""
    events: Count
    defects: Count = 0
    """Messages set aside since the process started, because the program failed upon them."""
    insecure: bool = False
    """Whether it uses an endpoint off loopback without TLS."""
