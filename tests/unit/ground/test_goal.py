"""A mission with a goal ends when its map is certified to be good enough, and says how far it is until then."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from he3.errors import InvalidInput
from he3.frames import SiteGrid
from he3.reference import Region
from schemas.codec import decode
from schemas.commands import CommandKind, CommandStage, NoParameters
from schemas.ground import MissionPhase
from schemas.mission_log import LogKind
from schemas.topics import GROUND_STATUS, LIST_COMMANDS, SHOW_LOG
from services.ground.belief import Belief
from services.ground.fitting import fit
from services.ground.goal import MissionGoal
from services.ground.observation import Observation
from services.ground.planners.foresight import forecast_of
from services.ground.planners.interface import PlannedRound
from services.ground.state_types import STATE_TYPES
from services.mission.in_process import InProcessMission, build_nodes
from services.mission.scenario import Scenario, checked_scenario
from services.rover.node import RoverNode
from services.runtime.state_codec import StateCodec

GRID = SiteGrid(30, 40, 5.0)


def scenario(goal: dict[str, Any], link: dict[str, Any] | None = None, **ground: Any) -> Scenario:
    document = {
        "name": "goal", "region": "unused.npz", "rounds": 8, "samples_per_round": 4, "start_m": [7.5, 7.5],
        "ground": {"planner": "rrtstar", "kernel": "se", "goal": goal, **ground},
        "link": {"up": link or {}, "down": link or {}},
    }  # fmt: skip
    return checked_scenario(document, "test")


def field() -> np.ndarray:
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    return 8.0 + 1.5 * np.sin(x / 40.0) * np.cos(y / 50.0)


def region() -> Region:
    level = np.zeros(GRID.shape)
    return Region(
        name="test", title="a test", provenance="made for tests", grid=GRID, he3_ppb=field(), orbital_ppb=field(),
        elevation_m=level, slope_deg=level.copy(), traversable=np.ones(GRID.shape, dtype=np.bool_),
    )  # fmt: skip


def sampled(side: int) -> Belief:
    """The belief after side x side samples all over the site and a refit."""
    belief = Belief(GRID, "se", 0.1)
    steps = (np.arange(side) + 0.5) / side
    for i, (u, v) in enumerate((u, v) for u in steps for v in steps):
        row, column = int(v * GRID.rows), int(u * GRID.columns)
        place = ((column + 0.5) * 5.0, (row + 0.5) * 5.0)
        belief.add(f"s{i}", Observation((1, 1, i), place, float(field()[row, column])))
    request = belief.fit_request(1, (1,))
    assert request is not None
    belief.adopt(fit(request))
    return belief


def test_the_goal_holds_when_the_greatest_std_of_the_map_is_below_it_and_the_hyperparameters_agree() -> None:
    belief = sampled(5)
    worst = float(belief.map.std_ppb.max())
    lax, tight = (MissionGoal(scenario({"std_ppb": share * worst}), GRID, belief) for share in (1.5, 0.9))
    assert lax.holds()
    assert not tight.holds()
    shown = lax.status()
    assert shown is not None
    assert shown.holds
    assert shown.worst_ppb == pytest.approx(worst)
    assert shown.weight is not None
    assert shown.weight >= 0.95
    assert shown.within_ppb == pytest.approx(1.96 * 1.5 * worst, rel=1e-3)
    assert lax.news() == [shown.text]
    assert lax.news() == []
    assert f"std at most {1.5 * worst:g} ppb everywhere" in shown.text
    below = tight.status()
    assert below is not None
    assert below.weight is None
    assert 0.0 < (below.share or 0.0) < 1.0


def test_what_a_checkpoint_keeps_of_it_is_restored() -> None:
    belief = sampled(4)
    goal, again = (MissionGoal(scenario({"std_ppb": 0.9}), GRID, belief) for _ in range(2))
    goal.holds()
    planned = PlannedRound(np.zeros((1, 2)), np.zeros((1, 2)), 0.0, None, forecast_of(9, 50.0, 0.8, 0.9, 9, 40.0))
    assert [note.text for note in goal.planned(planned, 0)] == goal.checkpoint()["news"][-1:]
    codec = StateCodec(STATE_TYPES)
    again.restore(codec.decode(codec.encode(goal.checkpoint())))
    assert again.status() == goal.status()
    assert again.news() == goal.news()
    told = codec.decode(codec.encode(goal.for_planners()))
    assert told.std_ppb == 0.9


def test_before_the_first_refit_nothing_holds() -> None:
    goal = MissionGoal(scenario({"std_ppb": 900.0}), GRID, Belief(GRID, "se", 0.1))
    assert not goal.holds()
    shown = goal.status()
    assert shown is not None
    assert shown.worst_ppb is None
    assert not shown.holds


def test_a_polygon_and_blocks_ask_less_than_every_cell() -> None:
    belief = sampled(4)
    worst = []
    for area in ("everywhere", [[60.0, 40.0], [140.0, 40.0], [140.0, 110.0], [60.0, 110.0]], {"blocks_m": 50.0}):
        goal = MissionGoal(scenario({"std_ppb": 0.05, "area": area}), GRID, belief)
        goal.holds()
        shown = goal.status()
        assert shown is not None
        assert shown.worst_ppb is not None
        worst.append(shown.worst_ppb)
    assert worst[1] < worst[0]
    assert worst[2] < worst[0]


@pytest.mark.parametrize(
    ("area", "why"),
    [
        ([[0.0, 0.0], [900.0, 0.0], [0.0, 90.0]], r"expected corners within 0\.\.200 m east and 0\.\.150 m north"),
        ([[10.0, 10.0], [90.0, 90.0], [90.0, 10.0], [10.0, 90.0]], "does not cross or touch itself"),
        ({"blocks_m": 2.0}, r"expected blocks from a cell of 5 m to the site's 200 m, got 2 m"),
    ],
)
def test_an_area_that_is_not_on_the_site_is_refused_in_one_line(area: Any, why: str) -> None:
    with pytest.raises(InvalidInput, match=rf"^scenario 'goal': ground\.goal\.area: .*{why}") as refusal:
        MissionGoal(scenario({"std_ppb": 0.5, "area": area}), GRID, Belief(GRID, "se", 0.1))
    assert "\n" not in str(refusal.value)


def test_a_goal_that_no_samples_reach_is_refused_and_one_within_the_noise_is_said() -> None:
    with pytest.raises(InvalidInput, match=r"ground\.goal\.std_ppb: expected more than 0\.0177 ppb, which 32 samples"):
        scenario({"std_ppb": 0.01})
    belief = Belief(GRID, "se", 0.1)
    assert "not above the instrument's noise of 0.1 ppb" in MissionGoal(scenario({"std_ppb": 0.05}), GRID, belief).note
    assert MissionGoal(scenario({"std_ppb": 0.2}), GRID, belief).note == ""


def test_a_mission_ends_as_soon_as_its_goal_holds() -> None:
    chosen = scenario({"std_ppb": 0.8}, planner="informative", hyperparameters="ml")
    mission, told = InProcessMission(chosen, nodes=build_nodes(chosen, region())), []
    mission.simulation.tap(
        lambda topic, _, payload, __: told.append(decode(topic, payload, "goal")[1]), (GROUND_STATUS,)
    )
    assert mission.run(until_s=1e6) is MissionPhase.COMPLETED
    status = mission.status
    assert status is not None
    assert status.goal is not None
    assert status.goal.holds
    assert 8 <= status.samples < 32
    before = [each.goal for each in told if each.samples < status.samples and each.goal.worst_ppb is not None]
    assert before
    assert not any(goal.holds for goal in before)
    forecast = [entry for entry in mission.ask(SHOW_LOG, NoParameters()).entries if entry.kind is LogKind.GOAL]
    assert forecast[-1].text == status.goal.text
    assert status.detail.startswith(f"{status.samples} of 32 samples are in the map; the goal holds: std at most 0.8")


LINKS = {
    "no-light-time": {"one_way_light_time_s": 0.0},
    "a-lossy-minute": {
        "one_way_light_time_s": 60.0, "loss": 0.3, "duplicate": 0.1, "reorder": 0.1, "corrupt": 0.05, "jitter_s": 5.0,
    },
}  # fmt: skip


@pytest.mark.parametrize("link", LINKS.values(), ids=list(LINKS))
def test_the_rounds_on_board_are_recalled_when_the_goal_holds_and_nothing_measured_is_lost(
    link: dict[str, float],
) -> None:
    corner = [[5.0, 5.0], [65.0, 5.0], [65.0, 65.0], [5.0, 65.0]]
    goal = {"std_ppb": 0.9, "area": corner}
    chosen = scenario(goal, link, planner="informative", pipeline=2, hyperparameters="ml")
    nodes = build_nodes(chosen, region())
    mission = InProcessMission(chosen, nodes=nodes)
    assert mission.run(until_s=1e6) is MissionPhase.COMPLETED
    status = mission.status
    assert status is not None
    assert status.goal is not None
    assert status.goal.holds
    (recalled,) = mission.ask(LIST_COMMANDS, NoParameters()).commands
    assert recalled.command.kind is CommandKind.ABORT_ROUND
    assert recalled.end is not None
    assert recalled.end.stage is CommandStage.COMPLETED
    rover = next(node for node in nodes if isinstance(node, RoverNode))
    on_board = rover.checkpoint()["executive"]["plan_queue"]
    assert not on_board["on_board"]
    assert status.samples == len(on_board["measured"]) < 4 * on_board["plan"].rounds[-1].round
