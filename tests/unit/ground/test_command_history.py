"""The command history: stages in order, departures as the link saw them, and lost commands."""

from __future__ import annotations

import pytest

from he3.errors import InvalidInput
from he3.frames import SiteGrid
from schemas.commands import CommandKind, CommandReport, CommandStage, Telecommand
from schemas.link import Direction, DirectionCounts, InFlight, LinkConditions, LinkStatus
from schemas.topics import COMMAND, PLAN
from services.ground.command_history import LOOK_AGAIN_S, MAX_LISTED, MAX_UNDER_WAY, CommandHistory
from services.mission.mission_time import SECOND

NOW = 1_000 * SECOND


def book() -> CommandHistory:
    return CommandHistory(SiteGrid(100, 100), round_trip_s=2.5)


def pause(name: str = "a", **more: object) -> Telecommand:
    return Telecommand(command_id=name, kind=CommandKind.PAUSE, **more)


def flight(sequence: int, departs_at: int | None, offered_at: int = NOW, topic: str = COMMAND.name) -> InFlight:
    return InFlight(
        topic=topic, source="ground", sequence=sequence, direction=Direction.UP, size_bytes=300,
        offered_at=offered_at, departs_at=departs_at, arrives_at=None if departs_at is None else departs_at + SECOND,
    )  # fmt: skip


def link(*flights: InFlight, contact_changes_at: int | None = None) -> LinkStatus:
    return LinkStatus(
        conditions=LinkConditions(), contact=True, contact_changes_at=contact_changes_at, up=DirectionCounts(),
        down=DirectionCounts(), in_flight=flights, incarnation=1,
    )  # fmt: skip


def names(commands: CommandHistory, name: str = "a") -> list[str]:
    status = commands.find(name)
    assert status is not None
    return [report.stage.value for report in status.stages]


def report(stage: CommandStage, at: int, name: str = "a") -> CommandReport:
    return CommandReport(command_id=name, stage=stage, at=at)


def test_stages_are_kept_in_the_order_in_which_they_were_passed_whatever_the_order_of_reports() -> None:
    commands = book()
    commands.issue(pause(), NOW)
    for stage, at in (
        (CommandStage.COMPLETED, 9), (CommandStage.RECEIVED, 5), (CommandStage.STARTED, 9), (CommandStage.ACCEPTED, 5),
    ):  # fmt: skip
        assert commands.report(report(stage, NOW + at)) is not None
    assert names(commands) == ["queued", "released", "received", "accepted", "started", "completed"]


def test_a_repeated_report_and_one_of_an_unknown_command_change_nothing() -> None:
    commands = book()
    commands.issue(pause(), NOW)
    assert commands.report(report(CommandStage.RECEIVED, NOW + 1)) is not None
    assert commands.report(report(CommandStage.RECEIVED, NOW + 2)) is None
    assert commands.report(report(CommandStage.RECEIVED, NOW + 2, "b")) is None


def test_a_command_has_left_when_the_link_says_so_and_not_before() -> None:
    commands = book()
    commands.issue(pause(), NOW)
    commands.issue(pause("b"), NOW)
    left, again = commands.seen_on_link(link(flight(0, None), flight(1, NOW + 7)), "ground", NOW)
    assert (left, again) == ([], NOW + 7)
    left, again = commands.seen_on_link(link(flight(0, None), flight(1, NOW + 7)), "ground", NOW + 9)
    assert [status.command.command_id for status in left] == ["b"]
    assert left[0].stages[-1] == report(CommandStage.RADIATED, NOW + 7, "b")
    assert again == NOW + 9 + round(LOOK_AGAIN_S * SECOND)
    assert commands.leaving() == ["a"]


@pytest.mark.parametrize(
    "other",
    [
        flight(0, NOW - 5, offered_at=NOW - 10),  # of an earlier start of the process
        flight(0, NOW, topic=PLAN.name),
        flight(1, NOW),
        flight(0, NOW).model_copy(update={"source": "another"}),
    ],
)
def test_another_message_on_the_link_is_not_taken_for_the_command(other: InFlight) -> None:
    commands = book()
    commands.issue(pause(), NOW)
    assert commands.seen_on_link(link(other), "ground", NOW + 1)[0] == []


def test_out_of_contact_the_link_is_next_read_when_contact_comes() -> None:
    commands = book()
    commands.issue(pause(), NOW)
    assert commands.seen_on_link(link(flight(0, None), contact_changes_at=NOW + 4), "ground", NOW)[1] == NOW + 4


def test_after_a_restart_messages_are_numbered_from_zero() -> None:
    commands = book()
    commands.issue(pause(), NOW)
    commands.restarted()
    commands.issue(pause("b"), NOW + 2)
    left, _ = commands.seen_on_link(link(flight(0, NOW + 2, offered_at=NOW + 2)), "ground", NOW + 2)
    assert [status.command.command_id for status in left] == ["b"]


def test_a_command_without_a_report_after_its_time_is_lost() -> None:
    commands = book()
    for name in ("a", "b"):
        commands.issue(pause(name, expires_at=NOW + 100 * SECOND), NOW)
    commands.report(report(CommandStage.RECEIVED, NOW + 1, "b"))
    assert commands.overdue_at(pause(expires_at=NOW)) == NOW + round(62.5 * SECOND)
    assert commands.overdue_at(pause()) is None
    assert commands.give_up("a", NOW + 200 * SECOND) is not None
    assert commands.give_up("b", NOW + 200 * SECOND) is None
    assert names(commands)[-1] == "lost"
    # A report of it may still come, and is kept.
    assert commands.report(report(CommandStage.RECEIVED, NOW + 300 * SECOND)) is not None
    assert names(commands)[-1] == "received"


def test_no_more_commands_than_an_operator_can_follow_are_under_way() -> None:
    commands = book()
    for number in range(MAX_UNDER_WAY):
        commands.issue(pause(f"c{number}"), NOW)
    with pytest.raises(InvalidInput, match="at most 200 commands under way"):
        commands.issue(pause("more"), NOW)
    commands.report(report(CommandStage.REJECTED, NOW, "c0"))
    assert commands.issue(pause("more"), NOW)[1]


def test_the_list_holds_the_newest() -> None:
    commands = book()
    for number in range(MAX_LISTED + 5):
        commands.issue(pause(f"c{number}"), NOW)
        commands.report(report(CommandStage.REJECTED, NOW, f"c{number}"))
    listed = commands.listed()
    assert len(listed) == MAX_LISTED
    assert listed[-1].command.command_id == f"c{MAX_LISTED + 4}"


# --- keep-outs --------------------------------------------------------------------------------------------------

HERE = ((10.0, 10.0), (20.0, 10.0), (20.0, 20.0))
THERE = ((50.0, 10.0), (60.0, 10.0), (60.0, 20.0))
REFUSALS = (CommandStage.REJECTED, CommandStage.FAILED, CommandStage.EXPIRED)


def keep_out(name: str, polygon: tuple[tuple[float, float], ...] | None = None, area: str = "pit") -> Telecommand:
    return Telecommand(command_id=name, kind=CommandKind.SET_KEEP_OUT, area_id=area, polygon_m=polygon)


def after(*happened: Telecommand | tuple[str, CommandStage]) -> CommandHistory:
    commands = book()
    for number, item in enumerate(happened):
        if isinstance(item, Telecommand):
            commands.issue(item, NOW + number)
        else:
            commands.report(report(item[1], NOW + number, item[0]))
    return commands


def test_an_area_is_closed_as_soon_as_its_command_is_issued_and_other_areas_are_not() -> None:
    commands = after(keep_out("a", HERE), keep_out("b", THERE, "hole"))
    assert commands.closed_by("pit") == [HERE]
    assert commands.closed_by("hole") == [THERE]
    assert commands.closed_by("dune") == []


@pytest.mark.parametrize("end", [*REFUSALS, CommandStage.LOST, CommandStage.STARTED])
def test_an_area_is_open_when_its_removal_is_completed_and_not_by_any_other_end(end: CommandStage) -> None:
    closed = ("a", CommandStage.COMPLETED)
    commands = after(keep_out("a", HERE), closed, keep_out("b"), ("b", end))
    assert commands.closed_by("pit") == [HERE]
    assert after(keep_out("a", HERE), closed, keep_out("b"), ("b", CommandStage.COMPLETED)).closed_by("pit") == []


@pytest.mark.parametrize("end", REFUSALS)
def test_an_area_of_the_scenario_is_open_when_its_removal_is_completed(end: CommandStage) -> None:
    assert after().closed_by("pit", [HERE]) == [HERE]
    assert after(keep_out("a"), ("a", end)).closed_by("pit", [HERE]) == [HERE]
    assert after(keep_out("a"), ("a", CommandStage.COMPLETED)).closed_by("pit", [HERE]) == []


def test_an_area_that_is_moved_is_closed_at_both_places_until_the_rover_has_moved_it() -> None:
    moved = (keep_out("a", HERE), ("a", CommandStage.COMPLETED), keep_out("b", THERE))
    assert after(*moved).closed_by("pit") == [HERE, THERE]
    assert after(*moved, ("b", CommandStage.REJECTED)).closed_by("pit") == [HERE, THERE]
    assert after(*moved, ("b", CommandStage.COMPLETED)).closed_by("pit") == [THERE]


def test_a_removal_that_is_completed_late_does_not_open_what_was_closed_again_meanwhile() -> None:
    commands = after(keep_out("a", HERE), keep_out("b"), keep_out("c", THERE), ("b", CommandStage.COMPLETED))
    assert commands.closed_by("pit") == [THERE]


def test_of_two_removals_the_second_may_be_rejected_because_the_first_was_completed() -> None:
    commands = after(
        keep_out("a", HERE), keep_out("b"), keep_out("c"), ("b", CommandStage.COMPLETED), ("c", CommandStage.REJECTED)
    )
    assert commands.closed_by("pit") == []


@pytest.mark.parametrize("end", REFUSALS)
def test_what_the_rover_did_not_close_stays_closed_on_the_ground_until_the_operator_removes_it(
    end: CommandStage,
) -> None:
    assert after(keep_out("a", HERE), ("a", end)).closed_by("pit") == [HERE]
    assert after(keep_out("a", HERE), ("a", end), keep_out("b")).closed_by("pit") == []
