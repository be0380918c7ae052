"""Alternatives: what could be done now instead of going on as planned, to be rehearsed beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from he3.errors import InvalidInput
from schemas.commands import CommandKind
from services.console.client.stacks import parse_stack
from services.ground.planners import PLANNERS

if TYPE_CHECKING:
    from schemas.commands import Telecommand

FIRST_LINE: Final = "stack: line 1: "
PLANNER: Final = "planner"
MAX_COMMANDS: Final = 20
MAX_TEXT: Final = 2_000
HOLDING: Final = frozenset({CommandKind.PAUSE, CommandKind.SAFE})
"""Commands after which the mission waits for the operator."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """What is done at the beginning of a rehearsal."""

    name: str
    planner: str | None = None
    """The planner from now on; None: the scenario's."""
    commands: tuple[Telecommand, ...] = ()
    """Issued at the beginning, in this order."""


AS_PLANNED: Final = Alternative("as planned")


def parse_alternative(text: str) -> Alternative:
    """The alternative in these words: ``planner NAME``, commands as of ``he3 command``, or both, with ; between them.

    Raises InvalidInput for another planner or command, and for a command that would hold the rover.
    """
    if len(text) > MAX_TEXT:
        raise InvalidInput(f"alternative: expected at most {MAX_TEXT} characters, got {len(text)}")
    planner: str | None = None
    commands: list[Telecommand] = []
    for part in filter(None, (each.strip() for each in text.replace("\n", ";").split(";"))):
        word, _, rest = part.partition(" ")
        if word == PLANNER:
            planner = rest.strip()
            if planner not in PLANNERS:
                raise InvalidInput(f"alternative: expected a planner among {', '.join(PLANNERS)}; got '{planner[:80]}'")
            continue
        commands.append(_command(part))
    if planner is None and not commands:
        raise InvalidInput(
            f"alternative: expected '{PLANNER} NAME' or a command such as 'abort-round', got '{text[:80]}'"
        )
    if len(commands) > MAX_COMMANDS:
        raise InvalidInput(f"alternative: expected at most {MAX_COMMANDS} commands, got {len(commands)}")
    return Alternative(" ".join(text.split()), planner, tuple(commands))


def _command(said: str) -> Telecommand:
    try:
        (line,) = parse_stack(said, 0)
    except InvalidInput as error:
        raise InvalidInput(f"alternative: {str(error).removeprefix(FIRST_LINE)}") from None
    if line.after is not None or line.at is not None or line.at_contact or line.expires_in_s is not None:
        raise InvalidInput(f"alternative: expected a command without conditions and expiry, got '{said[:80]}'")
    if line.command.kind in HOLDING:
        raise InvalidInput(f"alternative: expected a command after which the mission goes on, got '{said[:80]}'")
    return line.command


def alternatives_of(against: str | None) -> tuple[Alternative, ...]:
    """The mission as planned, and the alternative in those words beside it. Raises InvalidInput: see above."""
    return (AS_PLANNED,) if against is None else (AS_PLANNED, parse_alternative(against))
