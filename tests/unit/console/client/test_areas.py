"""The areas that operators have commanded, and how the command line finds and lists them."""

from __future__ import annotations

import pytest

from he3.errors import InvalidInput
from schemas.commands import CommandKind, CommandReport, CommandStage, CommandStatus, Telecommand
from services.console.cli.area import _found, area_lines
from services.console.client.areas import Area, AreaKind, commanded_keep_outs

FIRST, SECOND = ((0.0, 0.0), (9.0, 0.0), (9.0, 9.0)), ((1.0, 1.0), (8.0, 1.0), (8.0, 8.0))


def keep_out(number: int, corners: tuple[tuple[float, float], ...] | None, *stages: CommandStage) -> CommandStatus:
    command = Telecommand(command_id=f"op-{number}", kind=CommandKind.SET_KEEP_OUT, area_id="crater", polygon_m=corners)
    reports = tuple(
        CommandReport(command_id=command.command_id, stage=stage, at=index)
        for index, stage in enumerate((CommandStage.QUEUED, *stages))
    )
    return CommandStatus(command=command, stages=reports)


def test_a_keep_out_has_its_last_outline_from_the_moment_at_which_it_is_sent() -> None:
    done = keep_out(1, FIRST, CommandStage.COMPLETED)
    assert commanded_keep_outs([done]) == {"crater": FIRST}
    assert commanded_keep_outs([done, keep_out(2, SECOND)]) == {"crater": SECOND}
    assert commanded_keep_outs([done, keep_out(2, SECOND, CommandStage.REJECTED)]) == {"crater": FIRST}


def test_a_keep_out_is_gone_only_when_the_rover_has_opened_it() -> None:
    done = keep_out(1, FIRST, CommandStage.COMPLETED)
    assert commanded_keep_outs([done, keep_out(2, None)]) == {"crater": FIRST}
    assert commanded_keep_outs([done, keep_out(2, None, CommandStage.COMPLETED)]) == {}


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
