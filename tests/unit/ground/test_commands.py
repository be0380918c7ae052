"""Telecommands through the ground: what is sent, what is refused, and what is planned anew."""

from __future__ import annotations

import pytest

from he3.errors import He3Error
from schemas.codec import decode
from schemas.commands import CommandKind, CommandReport, CommandStage, CommandStatus, NoParameters
from schemas.topics import (
    COMMAND_REPORT,
    COMMAND_STATUS,
    ISSUE_COMMAND,
    LIST_COMMANDS,
)
from services.mission.mission_time import SECOND
from tests.unit.ground.stand_in_mission import (
    ELSEWHERE,
    IN_DEGREES,
    IN_ONE_LINE,
    Mission,
    command,
    listed,
    scenario,
    stages,
)


def test_a_command_goes_up_once_and_its_stages_are_listed_in_the_order_in_which_they_were_passed() -> None:
    mission = Mission(scenario())
    told: list[CommandStatus] = []
    mission.simulation.tap(
        lambda topic, side, payload, now: (
            told.append(decode(COMMAND_STATUS, payload, "test")[1]) if topic is COMMAND_STATUS else None
        )
    )
    mission.simulation.run_for(10.0)
    first = mission.simulation.ask(ISSUE_COMMAND, command())
    again = mission.simulation.ask(ISSUE_COMMAND, command())
    assert first == again
    at = mission.simulation.now
    for stage, delay in ((CommandStage.ACCEPTED, 3), (CommandStage.RECEIVED, 2), (CommandStage.ACCEPTED, 3)):
        mission.tell_ground(COMMAND_REPORT, CommandReport(command_id="c1", stage=stage, at=at + delay))
    listed = mission.simulation.ask(LIST_COMMANDS, NoParameters())
    assert [report.stage.value for report in listed.commands[0].stages] == [
        "queued", "released", "received", "accepted",
    ]  # fmt: skip
    assert mission.rover.commands == [command()]
    assert told[-1] == listed.commands[0]
    assert len(told) == 3


def test_a_command_that_cannot_be_executed_is_refused_and_not_sent() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(10.0)
    mission.simulation.ask(ISSUE_COMMAND, command())
    past = mission.simulation.now - 2 * SECOND
    for bad, complaint in (
        (command(CommandKind.SAFE), "expected a new id"),
        (command(name="c2", expires_at=past), "expected an expiry ahead, got one 2 s ago"),
        (command(CommandKind.GO_TO, "c3", target_m=(70.0, 3.0)), "expected a target within"),
        (command(CommandKind.SET_KEEP_OUT, "c4", area_id="a", polygon_m=IN_DEGREES), f"c4: polygon_m: {ELSEWHERE}"),
        (
            command(CommandKind.SET_KEEP_OUT, "c5", area_id="a", polygon_m=IN_ONE_LINE),
            "c5: polygon_m: expected corners",
        ),
    ):
        with pytest.raises(He3Error, match=complaint):
            mission.simulation.ask(ISSUE_COMMAND, bad)
    mission.simulation.step()
    assert mission.rover.commands == [command()]


def test_the_rover_is_not_sent_to_or_straight_over_ground_that_the_map_knows_as_closed() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(10.0)
    x, y = mission.rover.place
    wall = ((x + 8, 0.0), (x + 12, 0.0), (x + 12, 60.0), (x + 8, 60.0))
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.SET_KEEP_OUT, area_id="a", polygon_m=wall))
    for name, target, complaint in (
        ("into", (x + 10, y), "into: expected a target on open ground"),
        ("over", (x + 20, y), "over: expected open ground on the straight way"),
    ):
        with pytest.raises(He3Error, match=complaint):
            mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.GO_TO, name, target_m=target))
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.GO_TO, "beside", target_m=(x, y + 10)))
    assert [status.command.command_id for status in listed(mission)] == ["c1", "beside"]


def test_a_command_without_a_report_is_lost_after_its_time() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(10.0)
    expires = mission.simulation.now + 100 * SECOND
    mission.simulation.ask(ISSUE_COMMAND, command(expires_at=expires))
    mission.simulation.run_for(100.0)
    assert stages(mission) == ["queued", "released"]
    mission.simulation.run_for(100.0)
    assert stages(mission) == ["queued", "released", "lost"]


def test_a_keep_out_closes_ground_and_rounds_that_lead_through_it_are_planned_anew() -> None:
    mission = Mission(scenario(ground={"pipeline": 1}))
    mission.simulation.run_for(200.0)
    second = mission.rover.on_board[0]
    x, y = second.path_m[1]
    area = ((x - 2, y - 2), (x + 2, y - 2), (x + 2, y + 2), (x - 2, y + 2))
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.SET_KEEP_OUT, area_id="a", polygon_m=area))
    mission.simulation.run_for(200.0)
    assert not mission.snapshot.traversable[int(y), int(x)]
    assert mission.rover.on_board[0].round == 2
    assert mission.rover.on_board[0].samples[0].sample_id.startswith("r02v")
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.SET_KEEP_OUT, "c2", area_id="a"))
    mission.simulation.step()
    assert not mission.snapshot.traversable[int(y), int(x)]
    done = CommandReport(command_id="c2", stage=CommandStage.COMPLETED, at=mission.simulation.now)
    mission.tell_ground(COMMAND_REPORT, done)
    assert mission.snapshot.traversable.all()
    assert mission.run().ok


def test_the_report_that_a_keep_out_was_set_changes_no_plan() -> None:
    mission = Mission(scenario(ground={"planning_s": 500.0}))
    corner = ((50.0, 50.0), (55.0, 50.0), (55.0, 55.0))
    mission.simulation.run_for(10.0)
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.SET_KEEP_OUT, area_id="a", polygon_m=corner))
    mission.simulation.run_for(300.0)
    before = mission.snapshot
    done = CommandReport(command_id="c1", stage=CommandStage.COMPLETED, at=mission.simulation.now)
    mission.tell_ground(COMMAND_REPORT, done)
    assert mission.snapshot is before
    mission.simulation.run_for(250.0)
    assert len(mission.rover.plans) == 1


def test_while_the_rover_is_sent_elsewhere_nothing_is_planned_and_then_from_there() -> None:
    mission = Mission(scenario())
    mission.simulation.run_for(10.0)
    mission.simulation.ask(ISSUE_COMMAND, command(CommandKind.GO_TO, target_m=(40.0, 41.0)))
    at = mission.simulation.now
    mission.tell_ground(COMMAND_REPORT, CommandReport(command_id="c1", stage=CommandStage.STARTED, at=at))
    mission.simulation.run_for(1000.0)
    assert mission.rover.plans == []
    mission.rover.place = (40.0, 41.0)
    done = CommandReport(command_id="c1", stage=CommandStage.COMPLETED, at=mission.simulation.now)
    mission.tell_ground(COMMAND_REPORT, done)
    assert mission.run().ok
    assert mission.rover.plans[0][1].rounds[0].path_m[0] == (40.0, 41.0)
