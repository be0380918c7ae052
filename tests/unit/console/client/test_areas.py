"""The areas that operators have commanded, and how the command line finds and lists them."""

from __future__ import annotations

import pytest

from he3.errors import InvalidInput
from schemas.commands import CommandKind, CommandReport, CommandStage, CommandStatus, Telecommand
from services.console.cli.area import _found, _said, area_lines
from services.console.client.areas import Area, AreaKind, AreaState, with_commanded

FIRST, SECOND = ((0.0, 0.0), (9.0, 0.0), (9.0, 9.0)), ((1.0, 1.0), (8.0, 1.0), (8.0, 8.0))


def keep_out(number: int, corners: tuple[tuple[float, float], ...] | None, *stages: CommandStage) -> CommandStatus:
    command = Telecommand(command_id=f"op-{number}", kind=CommandKind.SET_KEEP_OUT, area_id="crater", polygon_m=corners)
    reports = tuple(
        CommandReport(command_id=command.command_id, stage=stage, at=index)
        for index, stage in enumerate((CommandStage.QUEUED, *stages))
    )
    return CommandStatus(command=command, stages=reports)


def listed(*commands: CommandStatus, known: dict[str, Area] | None = None) -> dict[str, tuple[object, str]]:
    found = with_commanded(known or {}, commands)
    return {name: (area.polygon_m, area.state.value) for name, area in found.items()}


DONE = keep_out(1, FIRST, CommandStage.COMPLETED)


def test_a_keep_out_has_its_last_outline_from_the_moment_at_which_it_is_sent() -> None:
    assert listed(DONE) == {"crater": (FIRST, "in force")}
    assert listed(DONE, keep_out(2, SECOND, CommandStage.COMPLETED)) == {"crater": (SECOND, "in force")}
    assert listed(DONE, keep_out(2, SECOND, CommandStage.REJECTED)) == {"crater": (FIRST, "in force")}


def test_a_keep_out_that_the_rover_has_not_confirmed_is_on_its_way() -> None:
    for stage in (CommandStage.RELEASED, CommandStage.RADIATED, CommandStage.RECEIVED, CommandStage.ACCEPTED):
        assert listed(keep_out(1, FIRST, stage)) == {"crater": (FIRST, "on its way to the rover")}
    # The ground closes it in its own map at once, which says nothing of the rover.
    known = {"crater": Area(AreaKind.KEEP_OUT, "crater", FIRST)}
    assert listed(keep_out(1, FIRST), known=known) == {"crater": (FIRST, "on its way to the rover")}


def test_a_keep_out_is_gone_only_when_the_rover_has_opened_it() -> None:
    assert listed(DONE, keep_out(2, None)) == {"crater": (FIRST, "being removed")}
    assert listed(DONE, keep_out(2, None, CommandStage.REJECTED)) == {"crater": (FIRST, "in force")}
    assert listed(DONE, keep_out(2, None, CommandStage.COMPLETED)) == {}


@pytest.mark.parametrize("end", [CommandStage.REJECTED, CommandStage.EXPIRED, CommandStage.LOST])
def test_a_keep_out_that_only_the_ground_knows_is_not_in_force(end: CommandStage) -> None:
    known = {"crater": Area(AreaKind.KEEP_OUT, "crater", FIRST)}
    unconfirmed = (FIRST, "not confirmed by the rover")
    assert listed(keep_out(1, FIRST, end), known=known) == {"crater": unconfirmed}
    assert listed(DONE, keep_out(2, FIRST, end), known=known) == {"crater": (FIRST, "in force")}
    assert listed(keep_out(1, SECOND, end), known=known) == {"crater": (FIRST, "in force")}


def test_the_document_of_an_area_has_its_state() -> None:
    area = Area(AreaKind.KEEP_OUT, "crater", FIRST, state=AreaState.ON_ITS_WAY)
    assert area.document()["state"] == "on its way to the rover"


AREAS = (Area(AreaKind.KEEP_OUT, "crater", FIRST), Area(AreaKind.INTEREST, "crater", SECOND, 3.0))


def test_a_name_that_two_areas_have_needs_the_kind() -> None:
    with pytest.raises(InvalidInput, match="expected --kind"):
        _found(AREAS, "crater", None)
    assert _found(AREAS, "crater", "interest") is AREAS[1]
    with pytest.raises(InvalidInput, match=r"expected the name of an area that is set \(crater\), got 'rim'"):
        _found(AREAS[:1], "rim", None)


def test_areas_are_listed_with_kind_name_weight_and_corners() -> None:
    assert area_lines(AREAS) == [
        "keep-out  crater  0,0 9,0 9,9",
        "interest  crater  weight 3  1,1 8,1 8,8",
    ]


def test_a_change_that_the_rover_does_not_have_is_listed_as_such() -> None:
    waiting = tuple(Area(AreaKind.KEEP_OUT, "rim", FIRST, state=state) for state in AreaState)
    assert area_lines(waiting) == [
        "keep-out  rim  0,0 9,0 9,9",
        "keep-out  rim  0,0 9,0 9,9  (on its way to the rover)",
        "keep-out  rim  0,0 9,0 9,9  (not confirmed by the rover)",
        "keep-out  rim  0,0 9,0 9,9  (being removed)",
    ]


def test_a_keep_out_that_was_sent_is_not_said_to_be_set() -> None:
    keep, interest = AREAS
    assert _said(keep, "keep-out crater", "set") == "keep-out crater is on its way to the rover (he3 area list)"
    assert _said(interest, "interest crater", "set") == "interest crater set"
