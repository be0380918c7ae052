"""A study: one TOML file that says which missions a campaign flies. docs/campaigns.md describes it.

Missions are scenarios x points of the grid x listed points x draws x seeds. The draw changes slowest, so that what is
flown of a campaign that is not over is a fair part of it, with every combination of the grid.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import exp, log
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from he3.errors import InvalidInput
from schemas.validation import one_line
from services.console.campaign.identity import planner_checksum, region_checksum, software_identity
from services.console.campaign.task import Task
from services.mission.deployment import find_scenario
from services.mission.scenario import Scenario, load_scenario, toml_document
from services.runtime.options import require_plugin_allowed, with_settings

MAX_BYTES: Final = 1_000_000
MAX_TASKS: Final = 1_000_000
DIGITS: Final = 6
"""Significant digits of a drawn value: few enough that the command that flies it again is short, and exact."""
FLY: Final = "services.console.campaign.mission_task:fly"
IGNORED: Final = ("description", "network", "rate")
"""Keys of a scenario that a mission in one process does not depend on."""

Value = str | bool | int | float
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,63}$")]
Key = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*){0,3}$")]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Parameter(_Table):
    """One thing that a study varies, and the keys of the scenario that it sets."""

    keys: Annotated[tuple[Key, ...], Field(min_length=1)]
    """All get the same value, such as the light time up and down."""
    values: Annotated[tuple[Value, ...], Field(min_length=1)] | None = None
    """Those of a grid."""
    low: float | None = None
    high: float | None = None
    """Range of the draws."""
    scale: Literal["linear", "log"] = "linear"
    integer: bool = False
    unit: str = ""
    """For the report."""

    @model_validator(mode="after")
    def _is_one_kind(self) -> Parameter:
        if (self.low is None) != (self.high is None):
            raise ValueError("expected both of low and high, or none")
        if self.values is not None and self.low is not None:
            raise ValueError("expected values or a range from low to high, got both")
        if self.low is not None and self.high is not None:
            if not self.low < self.high:
                raise ValueError(f"expected low below high, got {self.low} and {self.high}")
            if self.scale == "log" and self.low <= 0:
                raise ValueError(f"expected low above 0 on a log scale, got {self.low}")
        return self

    @property
    def is_drawn(self) -> bool:
        """Whether its values are drawn from a range."""
        return self.low is not None

    def at(self, share: float) -> Value:
        """The value at that share, 0 to 1, of the range."""
        assert self.low is not None, "only drawn parameters have a range"
        assert self.high is not None, "only drawn parameters have a range"
        if self.integer:
            return int(min(self.high, self.low + share * (self.high - self.low + 1) // 1))
        if self.scale == "log":
            value = exp(log(self.low) + share * (log(self.high) - log(self.low)))
        else:
            value = self.low + share * (self.high - self.low)
        return float(f"{value:.{DIGITS}g}")


class Draws(_Table):
    """How many points are drawn from the ranges, and how."""

    count: Annotated[int, Field(ge=1, le=MAX_TASKS)]
    method: Literal["latin-hypercube", "random"] = "latin-hypercube"
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1


class _Document(_Table):
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
    description: str = ""
    scenarios: Annotated[tuple[str, ...], Field(min_length=1)]
    seeds: Annotated[int, Field(ge=1, le=MAX_TASKS)] | tuple[int, ...] | Literal["draws"] = 1
    """How many, from 1 on; or which; or one for each draw, its number from 1 on."""
    set: dict[Key, Value] = {}
    parameters: dict[Name, Parameter] = {}
    points: tuple[dict[Name, Value], ...] = ()
    draws: Draws | None = None

    @model_validator(mode="after")
    def _fits_together(self) -> _Document:
        drawn = [name for name, parameter in self.parameters.items() if parameter.is_drawn]
        listed = [
            name for name, parameter in self.parameters.items() if not parameter.is_drawn and not parameter.values
        ]
        if drawn and self.draws is None:
            raise ValueError(f"expected a table draws, as {drawn[0]} has a range, got none")
        if self.draws is not None and not drawn:
            raise ValueError("expected a parameter with low and high to draw, got none")
        if self.seeds == "draws" and self.draws is None:
            raise ValueError('expected a table draws with seeds = "draws", got none')
        if isinstance(self.seeds, tuple) and not self.seeds:
            raise ValueError("expected one seed at least, got none")
        for number, point in enumerate(self.points, start=1):
            if sorted(point) != sorted(listed):
                raise ValueError(
                    f"expected points with the parameters that have neither values nor a range, "
                    f"{', '.join(listed) or 'none'}; got {', '.join(point) or 'none'} in point {number}"
                )
        if listed and not self.points:
            raise ValueError(f"expected values, a range, or points for parameter {listed[0]}, got none")
        keys = [key for parameter in self.parameters.values() for key in parameter.keys] + list(self.set)
        twice = sorted({key for key in keys if keys.count(key) > 1})
        if twice:
            raise ValueError(f"expected every key of the scenario once, got {twice[0]} twice")
        if "seed" in keys or "name" in keys:
            raise ValueError("expected seeds in the key seeds, and no name of the mission, among what is varied")
        return self


@dataclass(frozen=True, slots=True)
class Study:
    """A study that was read: its tasks follow from it."""

    name: str
    description: str
    document: _Document
    folder: Path
    """Of its file: where scenario files are looked for first."""
    allow_plugin: bool

    @property
    def size(self) -> int:
        """Number of missions."""
        return sum(1 for _ in self._points())

    def tasks(self) -> Iterator[Task]:
        """The missions, in the order in which they are flown; raises InvalidInput for one that cannot be."""
        software = software_identity()
        bases = {name: self._scenario(name) for name in self.document.scenarios}
        for reference, seed, values in self._points():
            settings = {key: value for name, value in values.items() for key in self.document.parameters[name].keys}
            scenario = self._changed(bases[reference], seed, settings)
            content = scenario.model_dump(mode="json")
            planner = scenario.ground.planner
            arguments = {
                "scenario": {key: value for key, value in content.items() if key not in IGNORED},
                "region_sha256": region_checksum(scenario.region),
                "planner_sha256": planner_checksum(planner),
            }
            labels = {
                "scenario": reference,
                "seed": seed,
                "parameters": values,
                "settings": {**self.document.set, **settings},
            }
            yield Task(FLY, arguments, software, labels)

    def _scenario(self, reference: str) -> Scenario:
        beside = self.folder / reference
        scenario = load_scenario(beside if beside.is_file() else find_scenario(reference))
        asked = [("ground", "planner", "")] if self.allow_plugin else []
        require_plugin_allowed(scenario, asked, self.allow_plugin)
        return scenario

    def _changed(self, base: Scenario, seed: int, settings: dict[str, Value]) -> Scenario:
        changes: list[tuple[str, str, Any]] = [("top", "seed", seed)]
        for key, value in (*self.document.set.items(), *settings.items()):
            section, dot, rest = key.partition(".")
            changes.append((section, rest, value) if dot else ("top", section, value))
        changed = with_settings(base, changes)
        require_plugin_allowed(changed, [], self.allow_plugin)
        if changed.ground.approval == "operator":
            raise InvalidInput(
                f"study '{self.name}': expected ground.approval \"auto\", as no operator can reach these missions"
            )
        return changed

    def _points(self) -> Iterator[tuple[str, int, dict[str, Value]]]:
        """Scenario, seed and values of parameters of each mission."""
        grid = {name: one.values for name, one in self.document.parameters.items() if one.values is not None}
        combinations = [dict(zip(grid, values, strict=True)) for values in product(*grid.values())]
        listed: Sequence[dict[str, Value]] = self.document.points or ({},)
        for number, drawn in enumerate(self._drawn(), start=1):
            for seed in self._seeds(number):
                for reference in self.document.scenarios:
                    for point in listed:
                        for combination in combinations:
                            values = {**combination, **point, **drawn}
                            yield reference, seed, {name: values[name] for name in self.document.parameters}

    def _seeds(self, draw: int) -> Sequence[int]:
        seeds = self.document.seeds
        if seeds == "draws":
            return (draw,)
        return range(1, seeds + 1) if isinstance(seeds, int) else [int(seed) for seed in seeds]

    def _drawn(self) -> list[dict[str, Value]]:
        """The values of the drawn parameters for each draw; one without any if nothing is drawn."""
        draws = self.document.draws
        ranges = {name: one for name, one in self.document.parameters.items() if one.is_drawn}
        if draws is None:
            return [{}]
        import numpy as np
        from scipy.stats import qmc

        rng = np.random.default_rng(np.random.SeedSequence((draws.seed, draws.count)))
        if draws.method == "random":
            shares = rng.random((draws.count, len(ranges)))
        else:
            shares = qmc.LatinHypercube(len(ranges), rng=rng).random(draws.count)
        return [
            {name: parameter.at(float(share)) for (name, parameter), share in zip(ranges.items(), row, strict=True)}
            for row in shares
        ]


def load_study(path: Path, allow_plugin: bool = False) -> Study:
    """The study of a TOML file, checked as far as it can be without its scenarios.

    allow_plugin: run the code of plug-in planners that it or its scenarios name. Raises InvalidInput, in one line with
    file, key and expectation.
    """
    table = toml_document(path, "study", MAX_BYTES)
    try:
        document = _Document.model_validate(table)
    except ValidationError as error:
        raise InvalidInput(f"{path}: {one_line(error)}") from None
    study = Study(document.name, document.description, document, path.resolve().parent, allow_plugin)
    if study.size > MAX_TASKS:
        raise InvalidInput(f"{path}: expected at most {MAX_TASKS} missions, got {study.size}")
    return study
