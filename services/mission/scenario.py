"""The scenario: everything that determines a mission, read from one TOML file and frozen.

Every quantity has its unit in its name and its provenance in its comment: [read] from a source, [calc] or [assumed].
Bad values are refused in one line with file, key, expected and actual value.
"""

from __future__ import annotations

import json
import math
import re
from datetime import UTC, date, datetime, time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    field_validator,
    model_validator,
)

from he3.constants import MAX_SAMPLES
from he3.driving import DrivingModel
from he3.driving_cost import CostKind
from he3.errors import InvalidInput
from he3.frames import Place
from he3.kernels import AUTO, KERNELS
from schemas.link import LinkConditions
from schemas.validation import one_line
from schemas.wire import MissionName
from services.mission.toml_files import parsed_toml

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime

MAX_SCENARIO_BYTES = 1_000_000

Fraction = Annotated[float, Field(ge=0, le=1)]
# What a mission can be computed for. The bounds lie far beyond every real rover, and keep times within int64 ns.
Speed = Annotated[float, Field(ge=1e-4, le=100)]  # m/s
Length = Annotated[float, Field(ge=0, le=10_000)]  # m
Power = Annotated[float, Field(ge=0, le=1e6)]  # W
EnergyPerMetre = Annotated[float, Field(ge=0, le=1e7)]  # J/m
Duration = Annotated[float, Field(ge=0, le=1e7)]  # s; 116 days
Period = Annotated[float, Field(ge=0.1, le=1e7)]  # s
LayerName = Annotated[str, Field(min_length=1, max_length=1000)]
Polygon = Annotated[tuple[Place, ...], Field(min_length=3, max_length=256)]


class Section(BaseModel):
    """One table of a scenario: frozen, no unknown keys, finite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class FieldConfig(Section):
    """The Moon: its region, and the noise of the instruments."""

    noise_std_ppb: Annotated[float, Field(ge=0, le=1000)] = 0.1
    """Standard deviation of a measurement [ppb]; the paper's."""
    hidden_hazards: Annotated[int, Field(ge=0, le=1000)] = 0
    """Boulders that the ground's terrain map does not show, at random places that follow from the seed."""
    hazard_radius_m: Annotated[float, Field(gt=0, le=1000)] = 3.0
    field_seed: Annotated[int, Field(ge=0, lt=2**63)] | None = None
    """Seed of the reference field's perturbation; None: the region's own, for which its published figures hold."""


class RoverConfig(Section):
    """The vehicle: speeds, times and power."""

    speed_m_s: Speed = 0.1
    """Speed on flat ground [m/s]. VIPER: 0.1 nominal, 0.2 top [read]."""
    slope_limit_deg: Annotated[float, Field(gt=0, le=45)] = 20.0
    """Steepest slope that the rover enters. VIPER: 15 nominal, 20 limit [assumed]."""
    slope_slowdown: Annotated[float, Field(ge=0, le=100)] = 1.0
    """Speed is speed_m_s / (1 + slope_slowdown * slope / slope_limit_deg) [assumed]."""
    footprint_radius_m: Annotated[float, Field(ge=0, le=100)] = 0.8
    """Half the vehicle's width [m]. VIPER is 1.5 m square [read]."""
    look_ahead_m: Annotated[float, Field(ge=0.1, le=10_000)] = 10.0
    """Length of the pieces in which a path is inspected and driven [m]; at least a cell."""
    bite_m: Annotated[float, Field(ge=0.001, le=10)] = 0.1
    """Depth of one bite of the drill [m]. TRIDENT: 0.1 [read]."""
    drill_s_per_m: Annotated[float, Field(ge=1e-3, le=1e7)] = 3600.0
    """Drilling time per metre; TRIDENT: about an hour [assumed]."""
    analysis_s: Duration = 300.0
    """Heating and mass spectrometry of one sample; 5 to 60 minutes [assumed]."""
    base_load_w: Power = 150.0
    """Power that is always drawn [assumed]."""
    traction_j_per_m: EnergyPerMetre = 240.0
    """Traction energy per metre on flat ground [assumed]."""
    climb_j_per_m: EnergyPerMetre = 700.0
    """Added per metre of climb: 430 kg * 1.62 m/s^2 [calc]."""
    drill_w: Power = 200.0
    """Added to the base load while drilling [assumed]."""
    analysis_w: Power = 100.0
    """Added to the base load while analysing [assumed]."""
    solar_w: Power = 450.0
    """Solar power, constant because missions last less than a lunar day [assumed]."""
    capacity_wh: Annotated[float, Field(ge=1e-3, le=1e9)] = 5000.0
    """Battery [assumed]."""
    initial_charge: Fraction = 1.0
    reserve: Fraction = 0.2
    """Share of the capacity below which the rover enters safe mode and charges [assumed]."""
    resume_charge: Fraction = 0.5
    """Charge, as a share of the capacity, at which a charging rover resumes by itself."""
    state_period_s: Period = 60.0
    """Interval between the rover's state reports [s]."""
    instrument_retry_s: Period = 30.0
    """Time after which the rover repeats a query that an instrument has not replied to [s]."""
    watchdog_s: Period | None = None
    """Time without a message from the ground after which a parked rover enters safe mode [s]; None: never."""

    @property
    def driving(self) -> DrivingModel:
        """What driving takes, as the rover and the ground compute it."""
        return DrivingModel(
            speed_m_s=self.speed_m_s,
            slope_slowdown=self.slope_slowdown,
            slope_limit_deg=self.slope_limit_deg,
            traction_j_per_m=self.traction_j_per_m,
            climb_j_per_m=self.climb_j_per_m,
            base_load_w=self.base_load_w,
        )

    @model_validator(mode="after")
    def _charges_beyond_its_reserve(self) -> RoverConfig:
        if self.resume_charge <= self.reserve:
            raise ValueError(f"expected resume_charge above reserve, got {self.resume_charge} and {self.reserve}")
        return self


class InterestRegion(Section):
    """A part of the site whose uncertainty counts more (weight above 1) or less (below 1) than elsewhere."""

    polygon_m: Polygon
    weight: Annotated[float, Field(ge=0, le=1000)]
    """Factor of the uncertainty there, relative to ground without an area of interest."""


class Blocks(Section):
    """The site divided into square blocks, of each of which the mean is meant."""

    blocks_m: Annotated[float, Field(gt=0, le=100_000)]
    """Side of a block [m]."""


def _kind_of_area(area: object) -> str | None:
    if isinstance(area, Blocks | dict):
        return "blocks"
    if isinstance(area, list | tuple):
        return "polygon"
    return "site" if area == "everywhere" else None


GoalArea = Annotated[
    Annotated[Literal["everywhere"], Tag("site")]
    | Annotated[Polygon, Tag("polygon")]
    | Annotated[Blocks, Tag("blocks")],
    Discriminator(
        _kind_of_area,
        custom_error_type="area",
        custom_error_message='expected "everywhere", the corners of a polygon, or a side { blocks_m = B }',
    ),
]


class GoalConfig(Section):
    """When the map is good enough: the mission ends as soon as that is certain."""

    std_ppb: Annotated[float, Field(gt=0, le=1000)]
    """Greatest standard deviation of the map over the area [ppb]."""
    area: GoalArea = "everywhere"
    """Every cell of the site, or of a polygon [m]; or the mean over each block of a side."""
    probability: Annotated[float, Field(ge=0.5, le=0.999)] = 0.95
    """Probability of the hyperparameters under which it is to hold, and share of the area that is promised."""

    @property
    def area_text(self) -> str:
        """The area in words."""
        if isinstance(self.area, Blocks):
            return f"for the mean of each block of {self.area.blocks_m:g} m"
        return "everywhere" if self.area == "everywhere" else f"in the polygon of {len(self.area)} corners"


def _kernel_name(name: str) -> str:
    if name not in KERNELS and name != AUTO:
        raise ValueError(f"expected {', '.join(KERNELS)} or {AUTO}")
    return name


KernelName = Annotated[str, AfterValidator(_kernel_name)]
PUBLISHED_KERNEL = "matern52"
"""The kernel of the published figures."""


def _default_kernel(ground: dict[str, Any]) -> str:
    """The kernel where none is named. ground: the keys before it."""
    return PUBLISHED_KERNEL if ground.get("hyperparameters") == "ml" else AUTO


PLANNER_NAMES = ("rrt", "rrtstar", "informative", "tour")
"""The built-in planners, as `services.ground.planners.PLANNERS`, which is above this package."""
PLUGIN_NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")
"""Name of a plug-in planner: a function of a module."""


def _planner_name(name: str) -> str:
    if name not in PLANNER_NAMES and not PLUGIN_NAME.fullmatch(name):
        raise ValueError(f"expected {', '.join(PLANNER_NAMES)} or module:function")
    return name


PlannerName = Annotated[str, AfterValidator(_planner_name)]


class GroundConfig(Section):
    """The ground station: belief, planning and budgets."""

    planner: PlannerName = "rrtstar"
    hyperparameters: Literal["ml", "bayes"] = "bayes"
    """The kernel's parameters: all that the samples leave possible under priors in ppb and metres, their uncertainty
    and that of the mean in the map's; or those of maximum likelihood, taken for certain, as the paper's."""
    kernel: KernelName = Field(default_factory=_default_kernel)
    """The covariance function; auto for a mixture of all, each as much as it predicts the samples. The paper states
    squared exponential, but its figures come from Matern 5/2, which is the default with ``hyperparameters = "ml"``."""
    prior: Literal["constant", "orbital"] = "constant"
    """Prior mean: a learned constant, or the coarse orbital map with learned gain and offset."""
    covariates: Annotated[tuple[LayerName, ...], Field(max_length=16)] = ()
    """Layers that may say something of the field: orbital_ppb, elevation_m, slope_deg of the region, or rasters .npy
    and .tif of its cells. The weight of each is learned, and may come out as none."""
    planning_s: Duration = 30.0
    """Mission time that planning a round takes in virtual time, and at least on the wall clock [s]."""
    planner_limit_s: Annotated[float, Field(ge=1, le=1e6)] = 1800.0
    """Time limit of a plug-in planner [s of wall-clock time]; it is ended then and counts as failed."""
    pipeline: Annotated[int, Field(ge=0, le=50)] = 0
    """Rounds on board in addition to the one in execution; 0 is stop-and-wait."""
    approval: Literal["auto", "operator"] = "auto"
    """Whether a plan goes to the rover at once, or waits until an operator approves it."""
    budget_m: Annotated[float, Field(gt=0, le=1e8)] | None = None
    """Most metres that the whole mission may drive [m]."""
    budget_h: Annotated[float, Field(gt=0, le=1e5)] | None = None
    """Time that the whole mission may take, charging included [h]."""
    budget_wh: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """Energy that all driving may draw, the base load meanwhile included [Wh]; with `cost = "energy"`."""
    cost: CostKind = "distance"
    """What legs cost: metres, the time that they take on slopes, or the energy that they draw."""
    information_exponent: Annotated[float, Field(gt=0, le=100)] = 1.0
    """alpha of the utility I^alpha / c."""
    clearance_m: Length = 15.0
    """Least distance of a target from every sample [m]; the paper's."""
    max_slope_deg: Annotated[float, Field(gt=0, le=45)] | None = None
    """Steepest slope that planners use; None: as in the region's traversability."""
    goal: GoalConfig | None = None
    """The mission ends when the map is that certain; None: when all samples are taken."""
    keep_outs_m: Annotated[tuple[Polygon, ...], Field(max_length=100)] = ()
    interest: Annotated[tuple[InterestRegion, ...], Field(max_length=100)] = ()
    score: bool = True
    """Compare the map with the reference field, which only a simulated Moon provides."""
    status_period_s: Period = 60.0
    """Interval between status messages when nothing changes [s of mission time]."""
    rover_timeout_s: Period = 3600.0
    """Time without a message after which the rover is reported as silent [s]."""
    patience_h: Annotated[float, Field(ge=0.01, le=1e5)] = 72.0
    """Time without progress after which the mission ends with the samples it has [h]. Light time, transmission, contact
    gaps and the rover's own steps are added to it."""

    @model_validator(mode="after")
    def _budgets_count_the_cost(self) -> GroundConfig:
        if self.budget_m is not None and self.cost != "distance":
            instead = {"time": "budget_h", "energy": "budget_wh"}[self.cost]
            raise ValueError(f'expected {instead} with cost "{self.cost}", got budget_m')
        if self.budget_wh is not None and self.cost != "energy":
            raise ValueError(f'expected cost "energy" with budget_wh, got "{self.cost}"')
        if self.cost != "distance" and self.planner == "rrt":
            raise ValueError(f'expected cost "distance" with planner rrt, which weighs no ways, got "{self.cost}"')
        return self

    @property
    def keep_outs(self) -> dict[str, Polygon]:
        """Corners [m] of each keep-out area, by the id that rover, ground and operator use."""
        return {_area_id(number): polygon for number, polygon in enumerate(self.keep_outs_m, start=1)}

    @property
    def interests(self) -> dict[str, InterestRegion]:
        """The areas of interest, by the id that operators use."""
        return {_area_id(number): area for number, area in enumerate(self.interest, start=1)}


def _area_id(number: int) -> str:
    """Id of the scenario's area with that number, from 1."""
    return f"scenario-{number}"


class NetworkConfig(Section):
    """Endpoints on which the two routers listen; loopback by default."""

    moon: Annotated[str, Field(pattern=r"^(tcp|tls|quic|unixsock-stream)/\S+$")] = "tcp/127.0.0.1:7447"
    earth: Annotated[str, Field(pattern=r"^(tcp|tls|quic|unixsock-stream)/\S+$")] = "tcp/127.0.0.1:7448"


class Scenario(Section):
    """A whole mission."""

    name: MissionName
    """Name of the mission, also its chunk in every key."""
    description: str = ""
    region: str
    """`t1`, `t2`, or a path to a region's folder or .npz file."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    start: datetime = datetime(2030, 1, 1, tzinfo=UTC)
    """Mission time at which the mission begins (UTC)."""
    rounds: Annotated[int, Field(ge=1, le=1000)] = 30
    samples_per_round: Annotated[int, Field(ge=1, le=256)] = 5
    sample_depth_m: Annotated[float, Field(gt=0, le=3)] = 0.1
    start_m: Place = (25.0, 25.0)
    """Landing place (x, y) [m]."""
    rate: Annotated[float, Field(gt=0, le=100_000)] = 1.0
    """Mission seconds per wall second, on the wall clock."""
    field: FieldConfig = FieldConfig()
    rover: RoverConfig = RoverConfig()
    ground: GroundConfig = GroundConfig()
    link: LinkConditions = LinkConditions()
    network: NetworkConfig = NetworkConfig()

    @model_validator(mode="after")
    def _cost_is_positive(self) -> Scenario:
        if self.ground.cost == "energy" and not self.rover.base_load_w + self.rover.traction_j_per_m > 0:
            raise ValueError(
                'ground.cost: expected a rover that draws energy on level ground with "energy", got one that draws none'
            )
        return self

    @model_validator(mode="after")
    def _goal_is_above_the_instruments_floor(self) -> Scenario:
        goal, noise_ppb = self.ground.goal, self.field.noise_std_ppb
        floor_ppb = noise_ppb / math.sqrt(self.samples)
        if goal is not None and goal.std_ppb <= floor_ppb:
            raise ValueError(
                f"ground.goal.std_ppb: expected more than {floor_ppb:.3g} ppb, which {self.samples} samples with a "
                f"noise of {noise_ppb:g} ppb leave where all of them are taken at one place, got {goal.std_ppb:g}"
            )
        return self

    @model_validator(mode="after")
    def _samples_fit_into_a_map(self) -> Scenario:
        if self.samples > MAX_SAMPLES:
            raise ValueError(
                f"expected at most {MAX_SAMPLES} samples in all, got {self.rounds} rounds of {self.samples_per_round}"
            )
        return self

    @field_validator("start")
    @classmethod
    def _start_is_utc(cls, start: datetime) -> datetime:
        if start.tzinfo is None:
            raise ValueError("expected a time with its zone, such as 2030-01-01T00:00:00Z")
        if start.year < 1971 or start.year > 2200:
            raise ValueError("expected a year from 1971 to 2200")
        return start.astimezone(UTC)

    @property
    def start_ns(self) -> MissionTime:
        """Mission time [ns] at which the mission begins."""
        return int(self.start.timestamp()) * 1_000_000_000 + self.start.microsecond * 1000

    @property
    def samples(self) -> int:
        """Samples of the whole mission."""
        return self.rounds * self.samples_per_round

    def changed(self, **sections: dict[str, Any]) -> Scenario:
        """This scenario with other values, validated: ``changed(ground={"planner": "rrt"}, top={"seed": 7})``."""
        document = self.model_dump(mode="json")
        for section, values in sections.items():
            (document if section == "top" else document[section]).update(values)
        return self.replaced(document, sets_kernel="kernel" in sections.get("ground", {}))

    def replaced(self, document: dict[str, Any], *, sets_kernel: bool) -> Scenario:
        """The scenario of a document that was derived from this one; raises InvalidInput.

        sets_kernel: whether the kernel was among the changes. If it never was named, it is the default again, which
        depends on what may have changed.
        """
        if not sets_kernel and "kernel" not in self.ground.model_fields_set:
            del document["ground"]["kernel"]
        return checked_scenario(document, f"scenario '{self.name}' as changed")


def load_scenario(path: Path) -> Scenario:
    """The scenario of a TOML file.

    A region file that does not exist in the working directory is taken from the scenario's folder. Raises InvalidInput,
    in one line with file, key and expectation.
    """
    document = toml_document(path, "scenario", MAX_SCENARIO_BYTES)
    if isinstance(region := document.get("region"), str):
        document["region"] = _found_region(region, path.parent)
    return checked_scenario(document, str(path))


def toml_document(path: Path, what: str, most_bytes: int) -> dict[str, Any]:
    """The content of a TOML file; raises InvalidInput. what: such as "scenario", for the error's line."""
    try:
        with path.open("rb") as stream:
            content = stream.read(most_bytes + 1)  # a device may have neither size nor end
        if len(content) > most_bytes:
            raise InvalidInput(f"{path}: expected a {what} of at most {most_bytes} bytes, got more")
        return parsed_toml(content, path)
    except OSError as error:
        raise InvalidInput(f"{path}: cannot read the {what}: {error.strerror}") from None


def _found_region(region: str, folder: Path) -> str:
    """The region, or the path of its file in the scenario's folder if only that exists."""
    try:
        found = folder / region
        is_region = found.is_file() if region.endswith(".npz") else (found / "region.toml").is_file()
        if is_region and not Path(region).exists():
            return str((folder / region).resolve())
    except (OSError, ValueError):  # not a valid file name: the loader refuses it
        pass
    return region


def checked_scenario(document: dict[str, Any], where: str) -> Scenario:
    """The validated scenario of a document; raises InvalidInput with a line that begins with ``where``."""
    try:
        # Through JSON, so that a scenario is validated as strictly as a message.
        return Scenario.model_validate_json(json.dumps(document, default=_as_text))
    except ValidationError as error:
        raise InvalidInput(f"{where}: {one_line(error)}") from None


def _as_text(value: object) -> str:
    """Text of a TOML date or time, for which JSON has no type."""
    return value.isoformat() if isinstance(value, date | time) else str(value)
