"""A mission that can no longer change ends, with its samples and the reason; one that can still change continues."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from he3.frames import SiteGrid
from he3.reference import Region
from schemas.commands import CommandKind, CommandStatus, Telecommand
from schemas.ground import MissionPhase
from schemas.link import LinkChange
from schemas.topics import ISSUE_COMMAND, LINK_SET
from services.field.node import build_node as build_field
from services.ground.node import build_node as build_ground
from services.ground.planner_process import PlannerProcess
from services.ground.planners.interface import PlannedRound, Planner, PlanningRequest
from services.link.node import build_node as build_link
from services.mission.in_process import InProcessMission
from services.mission.scenario import Scenario, checked_scenario
from services.rover.node import build_node as build_rover
from services.runtime.scheduler import Executor

HOUR_S = 3600.0
DAY_S = 24 * HOUR_S
ALL = ("field", "rover", "link", "ground")
NO_CONTACT = {"windows": [{"opens_s": 0.0, "closes_s": 100.0}]}


def scenario(**sections: dict[str, Any]) -> Scenario:
    document: dict[str, Any] = {
        "name": "standing", "region": "unused.npz", "rounds": 2, "samples_per_round": 2, "start_m": [12.0, 12.0],
        "ground": {"status_period_s": 1800.0, "patience_h": 12.0}, "rover": {"state_period_s": 1800.0},
    }  # fmt: skip
    for name, values in sections.items():
        document.setdefault(name, {}).update(values)
    return checked_scenario(document, "test")


def east_and_back(request: PlanningRequest) -> PlannedRound:
    end = (60.0, 12.0) if request.start_m[0] < 40.0 else (12.0, 12.0)
    path = np.array([request.start_m, end])
    shares = np.arange(1, request.samples + 1) / request.samples
    return PlannedRound(path, path[0] + shares[:, None] * (path[1] - path[0]), 1.0)


class Mission(InProcessMission):
    """A mission of those services on a flat site; region and planner are small."""

    def __init__(
        self,
        plan: Scenario,
        services: Iterable[str] = ALL,
        planner: Planner | None = east_and_back,
        executor: Executor | None = None,
    ) -> None:
        grid = SiteGrid(80, 80, 1.0)
        east = np.linspace(4.0, 9.0, 80)[None, :].repeat(80, axis=0)
        flat = np.zeros(grid.shape)
        region = Region(
            name="flat", title="flat", provenance="made by a test", grid=grid, he3_ppb=east, orbital_ppb=east,
            elevation_m=flat, slope_deg=flat.copy(), traversable=np.ones(grid.shape, dtype=bool),
        )  # fmt: skip
        nodes = {
            "field": lambda: build_field(plan, region),
            "rover": lambda: build_rover(plan, grid),
            "link": lambda: build_link(plan),
            "ground": lambda: build_ground(plan, region, planner),
        }
        super().__init__(plan, executor, nodes=[nodes[name]() for name in services])

    def detail(self) -> str:
        assert self.status is not None
        return self.status.detail

    def samples(self) -> int:
        assert self.status is not None
        return self.status.samples


both = {"up": {"loss": 1.0}, "down": {"loss": 1.0}}
damaged = {"up": {"corrupt": 1.0}, "down": {"corrupt": 1.0}}
too_short = {"up": {"rate_bit_s": 10.0}, "duty_cycle": {"period_s": 10 * HOUR_S, "contact_s": 30.0}}


@pytest.mark.parametrize(
    ("sections", "samples", "reason"),
    [
        ({"link": NO_CONTACT}, 0, "the last contact window closed 100 s after the mission began"),
        ({"link": {**NO_CONTACT, "at_edge": "drop"}}, 0, "the last contact window closed 100 s"),
        ({"link": both}, 0, "the rover was never heard from"),
        ({"link": damaged}, 0, "the rover was never heard from"),
        ({"link": {"up": {"loss": 1.0}}}, 0, "plan 1 has not reached the rover"),
        ({"link": {"up": {"corrupt": 1.0}}}, 0, "plan 1 has not reached the rover"),
        ({"link": {"down": {"loss": 1.0}}}, 0, "the rover was never heard from"),
        ({"link": {"down": {"corrupt": 1.0}}}, 0, "the rover was never heard from"),
        pytest.param({"link": too_short}, 0, "plan 1 has not reached the rover", marks=pytest.mark.exhaustive),
        ({"rover": {"solar_w": 0.0, "capacity_wh": 120.0}}, 1, "the rover is safe; safe mode entered: a step needs"),
        ({"rover": {"solar_w": 150.0, "capacity_wh": 100.0}}, 2, "the rover is safe; safe mode entered: a step needs"),
        ({"rover": {"initial_charge": 0.0, "solar_w": 150.0}}, 0, "the rover is safe; safe mode entered: a step needs"),
        ({"rover": {"drill_w": 1e6}}, 0, "the rover is safe; safe mode entered: a step needs"),
    ],
)
def test_a_mission_that_can_no_longer_change_ends_with_what_it_has_and_says_why(
    sections: dict[str, Any], samples: int, reason: str
) -> None:
    mission = Mission(scenario(**sections))
    assert mission.run(until_s=30 * DAY_S) is MissionPhase.FAILED
    assert mission.samples() == samples
    assert mission.detail().startswith(f"{samples} of 4 samples are in the map; no progress for ")
    assert reason in mission.detail()


@pytest.mark.parametrize(
    ("services", "reason"),
    [
        (("field", "rover", "ground"), "the rover was never heard from"),
        (("field", "link", "ground"), "the rover was never heard from"),
        (("ground",), "the rover was never heard from"),
        (("rover", "link", "ground"), "the rover is driving; instrument silent: moon/field/terrain"),
    ],
)
def test_a_mission_without_one_of_its_services_ends(services: tuple[str, ...], reason: str) -> None:
    mission = Mission(scenario(), services)
    assert mission.run(until_s=30 * DAY_S) is MissionPhase.FAILED
    assert reason in mission.detail()


def test_a_plug_in_planner_that_never_answers_ends_the_mission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "endless.py").write_text("def planner(request):\n    while True:\n        pass\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    plan = scenario(ground={"planner": "endless:planner", "planner_limit_s": 1.0})
    with PlannerProcess(parallel=1) as planners:
        mission = Mission(plan, planner=None, executor=planners)
        assert mission.run() is MissionPhase.FAILED
    assert mission.detail().endswith(
        "round 1 could not be planned: expected an answer within 1 s of wall-clock time, got none; the task was ended"
    )
    sys.modules.pop("endless")


def test_a_mission_whose_contact_ends_half_way_keeps_what_came_before() -> None:
    plan = scenario(link={"windows": [{"opens_s": 0.0, "closes_s": 0.65 * HOUR_S}]})
    mission = Mission(plan)
    assert mission.run(until_s=30 * DAY_S) is MissionPhase.FAILED
    assert mission.samples() == 2
    assert "2 of 4 samples are in the map; no progress for" in mission.detail()


def test_with_every_sample_in_the_map_a_mission_completes_even_if_the_rover_is_not_heard_again() -> None:
    mission = Mission(scenario())
    while mission.status is None or mission.status.samples < 4:
        assert mission.simulation.step()
    # The last round's end and the completion of the plan are still to come.
    if mission.end is None:
        mission.ask(LINK_SET, LinkChange(loss=1.0))
    assert mission.run(until_s=30 * DAY_S) is MissionPhase.COMPLETED
    assert mission.detail() == "4 of 4 samples are in the map"


def test_the_patience_is_the_scenario_s() -> None:
    mission = Mission(scenario(link=both, ground={"patience_h": 5.0}))
    assert mission.run(until_s=30 * DAY_S) is MissionPhase.FAILED
    assert 5 * HOUR_S < mission.mission_time_s < 9 * HOUR_S


@pytest.mark.parametrize("patience_h", [72.0, 12.0, 5.0])
def test_after_the_last_contact_window_six_hours_without_news_end_the_mission(patience_h: float) -> None:
    mission = Mission(scenario(link=NO_CONTACT, ground={"patience_h": patience_h}))
    assert mission.run(until_s=30 * DAY_S) is MissionPhase.FAILED
    assert min(patience_h, 6.0) < mission.mission_time_s / HOUR_S < min(patience_h, 6.0) + 4.0


@pytest.mark.parametrize(
    "sections",
    [
        {"link": {"windows": [{"opens_s": 0.0, "closes_s": 600.0}, {"opens_s": DAY_S, "closes_s": 2 * DAY_S}]}},
        pytest.param(
            {"link": {"duty_cycle": {"period_s": DAY_S, "contact_s": HOUR_S}}, "ground": {"pipeline": 1}},
            marks=pytest.mark.exhaustive,
        ),
        pytest.param(
            {"link": {"up": {"one_way_light_time_s": 6 * HOUR_S}, "down": {"one_way_light_time_s": 6 * HOUR_S}}},
            marks=pytest.mark.exhaustive,
        ),
        {"link": {"up": {"rate_bit_s": 1.0}}},
        pytest.param({"link": {"up": {"loss": 0.9}, "down": {"loss": 0.9}}}, marks=pytest.mark.exhaustive),
        {"rover": {"analysis_s": DAY_S, "analysis_w": 0.0}},
        {"rover": {"bite_m": 0.1, "drill_s_per_m": 10 * DAY_S, "drill_w": 0.0}},
        pytest.param({"rover": {"speed_m_s": 1e-4, "traction_j_per_m": 0.0}}, marks=pytest.mark.exhaustive),
        pytest.param(
            {"rover": {"solar_w": 151.0, "initial_charge": 0.0, "capacity_wh": 500.0}}, marks=pytest.mark.exhaustive
        ),
        {"ground": {"planning_s": DAY_S}},
    ],
)
def test_a_mission_that_only_takes_long_goes_on_to_its_end(sections: dict[str, Any]) -> None:
    mission = Mission(scenario(**sections))
    assert mission.run(until_s=400 * DAY_S) is MissionPhase.COMPLETED
    assert mission.detail() == "4 of 4 samples are in the map"


def issue(mission: Mission, kind: CommandKind) -> None:
    status: CommandStatus = mission.ask(ISSUE_COMMAND, Telecommand(command_id=kind.value, kind=kind))
    assert status.command.kind is kind


@pytest.mark.parametrize("hold", [CommandKind.PAUSE, CommandKind.SAFE])
def test_a_rover_that_the_operator_holds_is_waited_for(hold: CommandKind) -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(HOUR_S / 2)
    issue(mission, hold)
    mission.simulation.run_for(2 * DAY_S)
    assert mission.end is None
    issue(mission, CommandKind.RESUME)
    assert mission.run(until_s=30 * DAY_S) is MissionPhase.COMPLETED


def test_a_held_rover_that_is_not_heard_any_more_is_not_waited_for() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(HOUR_S / 2)
    issue(mission, CommandKind.PAUSE)
    mission.simulation.run_for(HOUR_S)
    mission.ask(LINK_SET, LinkChange(loss=1.0))
    assert mission.run(until_s=30 * DAY_S) is MissionPhase.FAILED


def test_a_black_out_that_the_operator_began_is_the_operator_s_to_end() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(HOUR_S / 2)
    mission.ask(LINK_SET, LinkChange(contact=False))
    mission.simulation.run_for(DAY_S)
    assert mission.end is None
    mission.ask(LINK_SET, LinkChange(contact=True))
    assert mission.run(until_s=30 * DAY_S) is MissionPhase.COMPLETED


def test_contact_windows_that_the_operator_sets_are_waited_for() -> None:
    mission = Mission(scenario(link=NO_CONTACT))
    mission.simulation.run_for(HOUR_S)
    now_s = mission.mission_time_s
    later = {"opens_s": now_s + DAY_S, "closes_s": now_s + 2 * DAY_S}
    conditions = mission.scenario.link.model_copy(update={"windows": ()})
    changed = type(conditions).model_validate({**conditions.model_dump(mode="json"), "windows": [later]}, strict=False)
    mission.ask(LINK_SET, LinkChange(conditions=changed))
    assert mission.run(until_s=30 * DAY_S) is MissionPhase.COMPLETED
