"""Waiting for a telecommand: one meaning of a stage, from reports and from the list of commands."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from he3.errors import InvalidInput, PeerUnreachable
from schemas.commands import ENDS, CommandKind, CommandList, CommandReport, CommandStage, CommandStatus, Telecommand
from schemas.topics import COMMAND_STATUS, LIST_COMMANDS
from schemas.wire import Header
from services.console.client.commands import CommandHandle, telecommand

Stage = CommandStage
HEADER = Header(mission="m", source="ground", incarnation=1, sequence=1, made_at=1)


def status(*stages: CommandStage, name: str = "c1", at: int = 1) -> CommandStatus:
    return CommandStatus(
        command=Telecommand(command_id=name, kind=CommandKind.PAUSE),
        stages=tuple(CommandReport(command_id=name, stage=stage, at=at) for stage in stages),
    )


def handle(session: Any, *listed: CommandStatus) -> CommandHandle:
    session.answers[LIST_COMMANDS] = lambda: CommandList(commands=listed)
    return CommandHandle(session.client, status(Stage.QUEUED))


@pytest.mark.parametrize("wanted", [Stage.RELEASED, "radiated", Stage.RECEIVED])
def test_a_stage_is_reached_by_that_stage_or_a_later_one(session: Any, wanted: Stage | str) -> None:
    passed = status(Stage.QUEUED, Stage.RELEASED, Stage.RECEIVED)
    assert handle(session, passed).wait(wanted) == passed


@pytest.mark.parametrize("end", sorted(ENDS))
def test_every_end_ends_the_wait(session: Any, end: Stage) -> None:
    found = handle(session, status(Stage.QUEUED, end)).wait("completed").end
    assert found is not None
    assert found.stage is end


def test_a_report_that_comes_while_it_waits_ends_the_wait(session: Any) -> None:
    issued = handle(session)
    done = status(Stage.QUEUED, Stage.COMPLETED)

    def report() -> None:
        while not session.listeners.get(COMMAND_STATUS):
            pass
        session.send(
            COMMAND_STATUS,
            HEADER,
            status(Stage.QUEUED, Stage.FAILED, name="another"),
        )
        session.send(COMMAND_STATUS, HEADER, done)

    sender = threading.Thread(target=report)
    sender.start()
    assert issued.wait(timeout_s=30.0) == done
    sender.join()
    assert session.listeners[COMMAND_STATUS] == []


def test_a_wait_that_takes_too_long_names_the_last_stage(session: Any) -> None:
    with pytest.raises(PeerUnreachable, match=r"^command c1: expected completed within 0 s, got queued so far$"):
        handle(session).wait(timeout_s=0.0)


def test_a_stage_that_does_not_exist_is_refused_with_those_that_do(session: Any) -> None:
    with pytest.raises(InvalidInput, match=r"expected a stage out of queued, .*; got 'soon'"):
        handle(session).wait("soon")


def test_a_telecommand_has_a_kind_that_exists_and_an_id_of_its_own() -> None:
    assert telecommand("go-to", target_m=(1, 2)).target_m == (1.0, 2.0)
    assert telecommand("pause").command_id != telecommand("pause").command_id
    with pytest.raises(InvalidInput, match="expected one of pause"):
        telecommand("dance")
    with pytest.raises(InvalidInput, match="target_m with go_to"):
        telecommand("go_to")
