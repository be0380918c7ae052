"""Shipped scenarios: each loads, and the reference among them names every key with its default."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

from he3.kernels import AUTO, KERNELS
from services.console.__main__ import main
from services.console.launch.scenarios import choose
from services.ground.planners import PLANNERS
from services.mission.deployment import deployment, shipped_scenarios
from services.mission.scenario import PLANNER_NAMES, Scenario, load_scenario

REFERENCE = deployment("scenarios", "t1-paper.toml")
DOCUMENTATION = Path(__file__).parents[4] / "docs" / "scenarios.md"


def keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for name, field in model.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from keys(kind, f"{prefix}{name}.")
        else:
            yield prefix + name


def uncommented() -> str:
    """The reference with its optional keys switched on."""
    return re.sub(r"^# (\w+ = )", r"\1", REFERENCE.read_text(), flags=re.MULTILINE)


def named(table: dict[str, object], prefix: str = "") -> Iterator[str]:
    for name, value in table.items():
        if isinstance(value, dict):
            yield f"{prefix}{name}"
            yield from named(value, f"{prefix}{name}.")
        else:
            yield prefix + name


@pytest.mark.parametrize("name", shipped_scenarios())
def test_every_shipped_scenario_loads_under_its_own_name_and_is_documented(name: str) -> None:
    scenario = choose(name).scenario
    assert scenario.name == name
    assert scenario.description
    assert f"`{name}`" in DOCUMENTATION.read_text()


def test_the_nominal_scenario_is_what_every_default_says_but_for_the_published_hyperparameters() -> None:
    reference = load_scenario(REFERENCE)
    defaults = Scenario(name="t1-paper", region="t1", description=reference.description)
    assert reference == defaults.changed(ground={"hyperparameters": "ml"})


def test_the_nominal_scenario_names_every_key_that_there_is() -> None:
    text = uncommented()
    # Windows and a duty cycle exclude one another, so the text as a whole is TOML, though no scenario.
    assert set(keys(Scenario)) <= set(named(tomllib.loads(text)))


@pytest.mark.parametrize(
    ("absent", "cost"), [(("windows", "budget_wh"), "distance"), (("duty_cycle", "budget_m"), "energy")]
)
def test_its_optional_keys_are_right_when_they_are_switched_on(
    absent: tuple[str, ...], cost: str, tmp_path: Path
) -> None:
    path, text = tmp_path / "all.toml", uncommented().replace('cost = "distance"', f'cost = "{cost}"')
    for key in absent:
        text = re.sub(rf"^{key} = .*$", "", text, flags=re.MULTILINE)
    path.write_text(text)
    scenario = load_scenario(path)
    assert scenario.ground.interest
    assert (scenario.ground.budget_m is None) == (scenario.ground.budget_wh is not None)
    assert bool(scenario.link.windows) != (scenario.link.duty_cycle is not None)


def test_flags_change_the_scenario_and_are_handed_on_to_the_services() -> None:
    chosen = choose("short", seed=7, planner="tour", rate=50.0, settings=["link.down.loss=0.25", "region=t2"])
    scenario = chosen.scenario
    assert (scenario.seed, scenario.ground.planner, scenario.rate, scenario.region) == (7, "tour", 50.0, "t2")
    assert scenario.link.down.loss == 0.25
    assert scenario.link.up.loss == 0.0

    from services.runtime.options import parse_options

    assert parse_options("ground", [str(chosen.path), *chosen.flags]).scenario == scenario


@pytest.mark.parametrize("region", ["t1", "t2"])
def test_an_earlier_name_of_a_scenario_still_works_and_one_line_gives_the_name_of_today(
    region: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert choose(f"{region}-nominal").scenario == choose(f"{region}-paper").scenario
    assert capsys.readouterr().err == (
        f"he3: {region}-nominal is {region}-paper now, the published protocol; {region} runs the best planner\n"
    )


@pytest.mark.parametrize("region", ["t1", "t2"])
def test_the_scenario_of_a_region_differs_from_the_published_protocol_in_the_ground_alone(region: str) -> None:
    best, paper = choose(region).scenario, choose(f"{region}-paper").scenario
    assert (best.ground.planner, best.ground.kernel, best.ground.pipeline) == ("tour", "auto", 2)
    same = {"name": paper.name, "description": paper.description}
    assert best.changed(top=same, ground=paper.ground.model_dump(mode="json")) == paper


def test_a_scenario_accepts_every_built_in_planner_and_no_other() -> None:
    assert tuple(PLANNERS) == PLANNER_NAMES


@pytest.mark.parametrize(("key", "names"), [("planner", [*PLANNERS]), ("kernel", [*KERNELS, AUTO])], ids=str)
def test_the_reference_and_the_page_on_scenarios_name_every_planner_and_kernel(key: str, names: list[str]) -> None:
    line = next(line for line in REFERENCE.read_text().splitlines() if line.startswith(f"{key} = "))
    assert set(names) <= set(re.findall(r"[\w+]+", line.partition("#")[2]))
    table = [row for row in DOCUMENTATION.read_text().splitlines() if row.startswith("| `")]
    assert set(names) <= {name for row in table for name in re.findall(r"`([\w+]+)`", row.split("|")[1])}


def test_the_help_of_run_names_every_built_in_planner(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--help"]) == 0
    assert f"{', '.join(PLANNERS)}, or a plug-in" in " ".join(capsys.readouterr().out.split())
