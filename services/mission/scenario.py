"""A scenario: everything that determines a mission, read from one TOML file and frozen.

Every figure has its unit in its name and its provenance in its comment: [read] and [assumed] as in the documentation.
Bad values are refused with one line that names file, key, expectation and what came.
"""

from __future__ import annotations

import json
import re
import tomllib
from datetime import UTC, date, datetime, time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from he3.constants import MAX_SAMPLES
from he3.errors import InvalidInput
from he3.frames import Place
from schemas.codec import one_line
from schemas.link import LinkConditions
from schemas.wire import MissionName

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime

MAX_SCENARIO_BYTES = 1_000_000

Fraction = Annotated[float, Field(ge=0, le=1)]
# What a mission can be computed for. Every bound lies far beyond anything that flies, and keeps times within int64 ns.
Speed = Annotated[float, Field(ge=1e-4, le=100)]  # m/s
Length = Annotated[float, Field(ge=0, le=10_000)]  # m
Power = Annotated[float, Field(ge=0, le=1e6)]  # W
EnergyPerMetre = Annotated[float, Field(ge=0, le=1e7)]  # J/m
Duration = Annotated[float, Field(ge=0, le=1e7)]  # s; 116 days
Period = Annotated[float, Field(ge=0.1, le=1e7)]  # s
Polygon = Annotated[tuple[Place, ...], Field(min_length=3, max_length=256)]


class Section(BaseModel):
    """One table of a scenario: frozen, no unknown keys, finite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class FieldConfig(Section):
    """The Moon: which region it is, and how well its instruments see it."""

    noise_std_ppb: Annotated[float, Field(ge=0, le=1000)] = 0.1
    """Standard deviation of a measurement [ppb]; the paper's."""
    hidden_hazards: Annotated[int, Field(ge=0, le=1000)] = 0
    """Boulders that the ground's terrain map does not show, put at random (seeded)."""
    hazard_radius_m: Annotated[float, Field(gt=0, le=1000)] = 3.0
    field_seed: Annotated[int, Field(ge=0, lt=2**63)] | None = None
    """Seed of the reference field's perturbation; None: the region's own, under which its published figures hold."""


class RoverConfig(Section):
    """The vehicle. Every time and power figure is a setting."""

    speed_m_s: Speed = 0.1
    """On the flat [m/s]. VIPER: 0.1 nominal, 0.2 top [read]."""
    slope_limit_deg: Annotated[float, Field(gt=0, le=45)] = 20.0
    """It does not enter steeper terrain. VIPER: 15 nominal, 20 limit [assumed]."""
    slope_slowdown: Annotated[float, Field(ge=0, le=100)] = 1.0
    """Speed is speed_m_s / (1 + slope_slowdown * slope / slope_limit_deg) [assumed]."""
    footprint_radius_m: Annotated[float, Field(ge=0, le=100)] = 0.8
    """Half the vehicle's width [m]. VIPER is 1.5 m square [read]."""
    look_ahead_m: Annotated[float, Field(ge=0.1, le=10_000)] = 10.0
    """Length of the pieces in which a path is looked at and driven [m]."""
    bite_m: Annotated[float, Field(ge=0.001, le=10)] = 0.1
    """The drill goes down in bites of this depth [m]. TRIDENT: 0.1 [read]."""
    drill_s_per_m: Annotated[float, Field(ge=1e-3, le=1e7)] = 3600.0
    """TRIDENT takes about an hour a metre [assumed]."""
    analysis_s: Duration = 300.0
    """Heating and mass spectrometry of one sample; 5 to 60 minutes [assumed]."""
    base_load_w: Power = 150.0
    """Always drawn [assumed]."""
    traction_j_per_m: EnergyPerMetre = 240.0
    """On the flat [assumed]."""
    climb_j_per_m: EnergyPerMetre = 700.0
    """More for each metre of climb: 430 kg * 1.62 m/s^2 [calc]."""
    drill_w: Power = 200.0
    """More while drilling [assumed]."""
    analysis_w: Power = 100.0
    """More while analysing [assumed]."""
    solar_w: Power = 450.0
    """Drawn from the sun, always: the missions last less than a lunar day [assumed]."""
    capacity_wh: Annotated[float, Field(ge=1e-3, le=1e9)] = 5000.0
    """Battery [assumed]."""
    initial_charge: Fraction = 1.0
    reserve: Fraction = 0.2
    """Below this share of the capacity the rover goes safe and charges [assumed]."""
    resume_charge: Fraction = 0.5
    """Charged to this share, it goes on by itself."""
    state_period_s: Period = 60.0
    """How often the rover reports its state [s]."""
    instrument_retry_s: Period = 30.0
    """How long the rover waits before it asks a silent instrument again [s]."""
    watchdog_s: Period | None = None
    """Parked and without a word from the ground for longer, it goes safe; None: never."""

    @model_validator(mode="after")
    def _charges_beyond_its_reserve(self) -> RoverConfig:
        if self.resume_charge <= self.reserve:
            raise ValueError(f"expected resume_charge above reserve, got {self.resume_charge} and {self.reserve}")
        return self


class InterestRegion(Section):
    """A part of the site that is worth more (weight above 1) or less (below 1) than the rest."""

    polygon_m: Polygon
    weight: Annotated[float, Field(ge=0, le=1000)]
    """How many times as much the uncertainty there counts as where no area says anything."""


KernelName = Literal["se", "matern12", "matern32", "matern52", "smooth+rough", "auto"]
PLANNER_NAMES = ("rrt", "rrtstar", "informative", "tour")
OWN_PLANNER = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")
"""Anybody's planner, a function of a module."""


def _planner_name(name: str) -> str:
    if name not in PLANNER_NAMES and not OWN_PLANNER.fullmatch(name):
        raise ValueError(f"expected {', '.join(PLANNER_NAMES)} or module:function")
    return name


PlannerName = Annotated[str, AfterValidator(_planner_name)]


class GroundConfig(Section):
    """Belief and direction."""

    planner: PlannerName = "rrtstar"
    kernel: KernelName = "matern52"
    """The paper says squared exponential; what produced its numbers used Matern 5/2."""
    prior: Literal["constant", "orbital"] = "constant"
    """Prior mean: a learned constant, or the coarse orbital map with learned gain and offset."""
    planning_s: Duration = 30.0
    """Mission time that planning a round takes in virtual time; on the wall clock it takes what it takes, if more."""
    planner_limit_s: Annotated[float, Field(ge=1, le=1e6)] = 1800.0
    """Wall-clock time after which a plug-in planner without an answer is ended, and the planning has failed [s]."""
    pipeline: Annotated[int, Field(ge=0, le=50)] = 0
    """Rounds that are on board beyond the one being executed; 0 is stop-and-wait."""
    budget_m: Annotated[float, Field(gt=0, le=1e8)] | None = None
    """Metres that the whole mission may drive."""
    budget_h: Annotated[float, Field(gt=0, le=1e5)] | None = None
    """Hours that the whole mission may take, the charging of the rover included."""
    information_exponent: Annotated[float, Field(gt=0, le=100)] = 1.0
    """alpha of the utility I^alpha / c."""
    clearance_m: Length = 15.0
    """No target nearer to a sample than this [m]; the paper's."""
    max_slope_deg: Annotated[float, Field(gt=0, le=45)] | None = None
    """Plan on terrain up to this slope; None: as the region's traversability says."""
    keep_outs_m: Annotated[tuple[Polygon, ...], Field(max_length=100)] = ()
    interest: Annotated[tuple[InterestRegion, ...], Field(max_length=100)] = ()
    score: bool = True
    """Compare the map with the reference field, which only a simulated Moon can offer."""
    status_period_s: Period = 60.0
    """How often status is published when nothing changes [s of mission time]."""
    rover_timeout_s: Period = 3600.0
    """Unheard of for longer, the rover is reported as silent."""
    patience_h: Annotated[float, Field(ge=0.01, le=1e5)] = 72.0
    """Without any progress for longer, the mission ends with what it has [h]. What the light, the link's rate, contact
    gaps and the rover's own steps take comes on top."""

    @property
    def keep_outs(self) -> dict[str, Polygon]:
        """Corners [m] of each keep-out area by the id under which rover, ground and operator know it."""
        return {_area_id(number): polygon for number, polygon in enumerate(self.keep_outs_m, start=1)}

    @property
    def interests(self) -> dict[str, InterestRegion]:
        """The areas of interest by the id under which the operator changes them."""
        return {_area_id(number): area for number, area in enumerate(self.interest, start=1)}


def _area_id(number: int) -> str:
    """The id of the scenario's area of that number, counted from 1."""
    return f"scenario-{number}"


class NetworkConfig(Section):
    """Where the two routers listen. Loopback unless somebody decides otherwise."""

    moon: Annotated[str, Field(pattern=r"^(tcp|tls|quic|unixsock-stream)/\S+$")] = "tcp/127.0.0.1:7447"
    earth: Annotated[str, Field(pattern=r"^(tcp|tls|quic|unixsock-stream)/\S+$")] = "tcp/127.0.0.1:7448"


class Scenario(Section):
    """A whole mission."""

    name: MissionName
    """Also the mission's chunk in every key."""
    description: str = ""
    region: str
    """`t1`, `t2`, or a path to a .npz file."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    start: datetime = datetime(2030, 1, 1, tzinfo=UTC)
    """Mission time at which the mission begins (UTC)."""
    rounds: Annotated[int, Field(ge=1, le=1000)] = 30
    samples_per_round: Annotated[int, Field(ge=1, le=256)] = 5
    sample_depth_m: Annotated[float, Field(gt=0, le=3)] = 0.1
    start_m: Place = (25.0, 25.0)
    """Where the rover lands (x, y) [m]."""
    rate: Annotated[float, Field(gt=0, le=100_000)] = 1.0
    """Mission seconds a wall second, on the wall clock."""
    field: FieldConfig = FieldConfig()
    rover: RoverConfig = RoverConfig()
    ground: GroundConfig = GroundConfig()
    link: LinkConditions = LinkConditions()
    network: NetworkConfig = NetworkConfig()

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
        return self.rounds * self.samples_per_round

    def changed(self, **sections: dict[str, Any]) -> Scenario:
        """This scenario with other values, checked again: ``changed(ground={"planner": "rrt"}, top={"seed": 7})``."""
        document = self.model_dump(mode="json")
        for section, values in sections.items():
            (document if section == "top" else document[section]).update(values)
        return self.replaced(document)

    def replaced(self, document: dict[str, Any]) -> Scenario:
        """The scenario that the document describes, which began as this one."""
        return checked_scenario(document, f"scenario '{self.name}' as changed")


def load_scenario(path: Path) -> Scenario:
    """The scenario in that TOML file; raises InvalidInput with one line that names file, key and expectation.

    A region's file that is not found from the working directory is looked for beside the scenario.
    """
    try:
        with path.open("rb") as stream:
            content = stream.read(MAX_SCENARIO_BYTES + 1)  # a device may have no size, and no end
        if len(content) > MAX_SCENARIO_BYTES:
            raise InvalidInput(f"{path}: expected a scenario of at most {MAX_SCENARIO_BYTES} bytes, got more")
        # Editors of some systems put a byte order mark before the text; it means nothing in UTF-8.
        document = tomllib.loads(content.decode("utf-8-sig").replace("\r\n", "\n"))
    except OSError as error:
        raise InvalidInput(f"{path}: cannot read the scenario: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InvalidInput(f"{path}: expected UTF-8 text, got other bytes") from None
    except tomllib.TOMLDecodeError as error:
        raise InvalidInput(f"{path}: expected TOML, got a syntax error: {error}") from None
    if isinstance(region := document.get("region"), str):
        document["region"] = _found_region(region, path.parent)
    return checked_scenario(document, str(path))


def _found_region(region: str, folder: Path) -> str:
    """The region, or the path of its file in the scenario's folder where only that exists."""
    try:
        if region.endswith(".npz") and not Path(region).exists() and (folder / region).is_file():
            return str((folder / region).resolve())
    except (OSError, ValueError):  # no name that a file can have: for who loads it to say
        pass
    return region


def checked_scenario(document: dict[str, Any], where: str) -> Scenario:
    """The scenario that the document describes; raises InvalidInput that begins with `where`."""
    try:
        # By way of JSON, so that a scenario is checked as strictly as what goes over the wire.
        return Scenario.model_validate_json(json.dumps(document, default=_as_text))
    except ValidationError as error:
        raise InvalidInput(f"{where}: {one_line(error)}") from None


def _as_text(value: object) -> str:
    """TOML dates and times, as JSON has no type of its own for them."""
    return value.isoformat() if isinstance(value, date | time) else str(value)
