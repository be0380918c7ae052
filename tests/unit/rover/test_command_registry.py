"""The command registry: stages in order, outdated commands, bounded memory."""

from __future__ import annotations

import itertools

import pytest

from schemas.commands import CommandKind, CommandStage, Telecommand
from schemas.wire import Header
from services.rover.command_registry import CommandRegistry, IllegalStage


def command(command_id: str = "c1", kind: CommandKind = CommandKind.PAUSE) -> Telecommand:
    return Telecommand(command_id=command_id, kind=kind)


def made(at: int, sequence: int = 0) -> Header:
    return Header(mission="m", source="ground", incarnation=1, sequence=sequence, made_at=at)


STAGE_ORDERS = {
    (CommandStage.RECEIVED, CommandStage.REJECTED),
    (CommandStage.RECEIVED, CommandStage.EXPIRED),
    (CommandStage.RECEIVED, CommandStage.ACCEPTED, CommandStage.EXPIRED),
    (CommandStage.RECEIVED, CommandStage.ACCEPTED, CommandStage.FAILED),
    (CommandStage.RECEIVED, CommandStage.ACCEPTED, CommandStage.STARTED, CommandStage.COMPLETED),
    (CommandStage.RECEIVED, CommandStage.ACCEPTED, CommandStage.STARTED, CommandStage.FAILED),
}


def admits(stages: tuple[CommandStage, ...]) -> bool:
    registry = CommandRegistry()
    try:
        for at, stage in enumerate(stages):
            registry.advance(command(), stage, at)
    except IllegalStage:
        return False
    return True


def test_a_command_passes_its_stages_only_in_order():
    for length in (1, 2, 3, 4):
        for stages in itertools.product(CommandStage, repeat=length):
            assert admits(stages) is any(stages == order[:length] for order in STAGE_ORDERS)


def test_a_stage_out_of_order_is_refused_naming_both_stages():
    registry = CommandRegistry()
    registry.advance(command(), CommandStage.RECEIVED, 0)
    with pytest.raises(IllegalStage, match="command c1 is received and cannot be completed next"):
        registry.advance(command(), CommandStage.COMPLETED, 1)


def test_a_command_made_before_one_on_the_same_subject_is_overtaken():
    registry = CommandRegistry()
    assert registry.overtaken(command("c2", CommandKind.RESUME), made(20), 30) is None
    assert "resume c2 was made later" in str(registry.overtaken(command("c1"), made(10), 31))
    assert registry.overtaken(command("c3"), made(20, sequence=1), 32) is None


@pytest.mark.parametrize("from_the_future", [2**63 - 1, 10**9])
def test_a_command_from_the_future_outdates_no_command_that_is_made_after_it_came(from_the_future):
    registry = CommandRegistry()
    assert registry.overtaken(command("forged"), made(from_the_future), 30) is None
    assert registry.overtaken(command("c1"), made(31), 40) is None


def test_the_registry_is_bounded_and_keeps_the_commands_that_have_not_ended(monkeypatch):
    monkeypatch.setattr("services.rover.command_registry.MAX_REMEMBERED", 3)
    registry = CommandRegistry()
    registry.advance(command("open"), CommandStage.RECEIVED, 0)
    for k in range(10):
        registry.advance(command(f"c{k}"), CommandStage.RECEIVED, k)
        registry.advance(command(f"c{k}"), CommandStage.REJECTED, k)
    assert registry.reported(command("open")) is not None
    assert registry.reported(command("c9")) is not None
    assert registry.reported(command("c0")) is None
