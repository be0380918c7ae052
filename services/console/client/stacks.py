"""Command stacks: a list of telecommands with conditions, checked whole before the first one is sent.

A stack is text, one command a line, in the words of ``he3 command``. Conditions come first and end with a colon:

    # The area is closed before the rover drives on.
    pause
    after accepted: keep-out crater 100,100 150,100 125,150
    after completed, at next contact: resume
    at 2h: go-to 120 340 --expires-in 3600

A line without a condition is sent when the command before it has completed. A stack stops at its first failure.
"""

from __future__ import annotations

import re
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

from he3.errors import He3Error, InvalidInput, OutcomeUnknown, PeerUnreachable
from schemas.commands import CommandKind, CommandStage, Telecommand
from schemas.telemetry import RoverMode
from services.console.client.commands import MAX_EXPIRY_S, stage_named, telecommand
from services.console.client.time_format import parse_moment

if TYPE_CHECKING:
    from schemas.commands import CommandStatus
    from services.console.client.mission_client import MissionClient
    from services.console.client.previews import CommandOutlook
    from services.mission.mission_time import MissionTime

MAX_LINES = 200
LOOK_EVERY_S = 0.25
"""Wall time between two looks at the stages, the clock and the contact while a condition is waited for."""
NEXT_CONTACT = ("next contact", "contact")

_CONDITIONS = re.compile(r"((?:after|at)\s.*?)\s*:\s+(\S.*)")
_SAID = {"keep-out": "set-keep-out"}
"""Words of ``he3 command`` that differ from the name of their kind."""
_WORDS = tuple(
    {kind: word for word, kind in _SAID.items()}.get(each, each)
    for each in (kind.value.replace("_", "-") for kind in CommandKind)
)
_HELD = {RoverMode.PAUSED: "paused", RoverMode.SAFE: "in safe mode"}


@dataclass(frozen=True, slots=True)
class StackLine:
    """One command of a stack, with what is waited for before it is sent."""

    number: int
    """Of the line in the file, from 1."""
    text: str
    """The command in the words of ``he3 command``."""
    command: Telecommand
    expires_in_s: float | None = None
    after: CommandStage | None = None
    """Stage that the command before it must have reached; None: none is waited for."""
    at: MissionTime | None = None
    """Mission time before which it is not sent."""
    at_contact: bool = False
    """Whether it is sent only while there is contact."""

    @property
    def name(self) -> str:
        """The line for people: its number and its command."""
        return f"line {self.number} ({self.text})"

    @property
    def waits_for(self) -> str:
        """Its conditions in words."""
        from services.console.client.time_format import utc

        parts = [] if self.after is None else [f"after {self.after.value}"]
        if self.at is not None:
            parts.append(f"at {utc(self.at, 0)}")
        if self.at_contact:
            parts.append("at next contact")
        return ", ".join(parts) or "at once"


def parse_stack(text: str, start_ns: MissionTime) -> tuple[StackLine, ...]:
    """The commands of that text; start_ns: the mission's beginning, which times such as 2h count from.

    Raises InvalidInput, in one line that names the line, for text that is no stack.
    """
    found: list[StackLine] = []
    for number, whole in enumerate(text.splitlines(), 1):
        if not (content := whole.partition("#")[0].strip()):
            continue
        try:
            line = _line(number, content, start_ns)
        except InvalidInput as error:
            raise InvalidInput(f"stack: line {number}: {error}") from None
        if not found:
            if line.after is not None and _CONDITIONS.fullmatch(content):
                raise InvalidInput(f"stack: line {number}: expected no 'after' in the first command, got one")
            line = replace(line, after=None)
        found.append(line)
    if not 1 <= len(found) <= MAX_LINES:
        raise InvalidInput(f"stack: expected 1 to {MAX_LINES} commands, got {len(found)}")
    return tuple(found)


def _line(number: int, content: str, start_ns: MissionTime) -> StackLine:
    conditional = _CONDITIONS.fullmatch(content)
    conditions, said = ("", content) if conditional is None else (conditional[1], conditional[2])
    after: CommandStage | None = None if conditions else CommandStage.COMPLETED
    at, at_contact = None, False
    for condition in filter(None, (part.strip() for part in conditions.split(","))):
        word, _, rest = condition.partition(" ")
        rest = " ".join(rest.split())
        if word == "after":
            after = stage_named(rest)
        elif word == "at" and rest in NEXT_CONTACT:
            at_contact = True
        elif word == "at":
            at = parse_moment(rest, start_ns)
        else:
            raise InvalidInput(f"expected conditions 'after STAGE', 'at TIME' or 'at next contact', got '{condition}'")
    command, expires_in_s = _command(said)
    return StackLine(number, " ".join(said.split()), command, expires_in_s, after, at, at_contact)


def _command(said: str) -> tuple[Telecommand, float | None]:
    """The command in these words, and for how long it is valid [s]."""
    try:
        kind, *words = shlex.split(said)
    except ValueError as error:
        raise InvalidInput(f"expected words as of 'he3 command', got '{said[:80]}': {error}") from None
    expires_in_s: float | None = None
    if "--expires-in" in words:
        place = words.index("--expires-in")
        expires_in_s = _number("--expires-in", words[place + 1 : place + 2])
        del words[place : place + 2]
        if not 0 < expires_in_s <= MAX_EXPIRY_S:
            raise InvalidInput(f"--expires-in: expected above 0 up to {MAX_EXPIRY_S:g}, got {expires_in_s:g}")
    kind = _SAID.get(kind, kind)
    if kind == "go-to":
        if len(words) != 2:
            raise InvalidInput(f"go-to: expected X Y in metres, got {len(words)} values")
        return telecommand(kind, target_m=(_number("X", words[:1]), _number("Y", words[1:]))), expires_in_s
    if kind == "set-keep-out":
        if not words:
            raise InvalidInput("keep-out: expected the name of an area, got none")
        corners = tuple(_corner(word) for word in words[1:]) or None
        return telecommand(kind, area_id=words[0], polygon_m=corners), expires_in_s
    if kind.replace("-", "_") not in tuple(CommandKind):
        raise InvalidInput(f"expected a command out of {', '.join(_WORDS)}; got '{kind[:80]}'")
    command = telecommand(kind)
    if words:
        raise InvalidInput(f"{kind}: expected nothing after it, got '{' '.join(words)[:80]}'")
    return command, expires_in_s


def _number(name: str, words: Sequence[str]) -> float:
    try:
        return float(words[0])
    except (IndexError, ValueError):
        raise InvalidInput(f"{name}: expected a number, got '{words[0] if words else 'nothing'}'") from None


def _corner(word: str) -> tuple[float, float]:
    x, _, y = word.partition(",")
    return _number(f"corner {word}", [x]), _number(f"corner {word}", [y])


# --- the check ------------------------------------------------------------------------------------------------------


def rule_broken(lines: Sequence[StackLine], mode: RoverMode | None) -> str | None:
    """One line on the first command that the rover would reject after those before it; None if there is none.

    mode: of the rover now; None if it is not known. The rules are those of the rover's command handlers.
    """
    held = None if mode is None else _HELD.get(mode, "")
    for line in lines:
        kind = line.command.kind
        if kind is CommandKind.RESUME and held == "":
            return f"{line.name}: expected a rover that is paused or in safe mode by then, got one that is neither"
        if kind is CommandKind.PAUSE and held == _HELD[RoverMode.SAFE]:
            return f"{line.name}: the rover is in safe mode by then"
        if kind is CommandKind.PAUSE:
            held = _HELD[RoverMode.PAUSED]
        elif kind is CommandKind.SAFE:
            held = _HELD[RoverMode.SAFE]
        elif kind in (CommandKind.RESUME, CommandKind.GO_TO, CommandKind.RETURN_TO_START):
            held = ""
    return None


# --- the run --------------------------------------------------------------------------------------------------------


class StackDesk(Protocol):
    """What a stack needs of a mission."""

    def now(self) -> MissionTime: ...

    def in_contact(self) -> bool: ...

    def rover_mode(self) -> RoverMode | None: ...

    def outlook(self, line: StackLine) -> CommandOutlook: ...

    def send(self, line: StackLine) -> str:
        """Send the command; its id."""

    def stages(self) -> dict[str, CommandStatus]: ...

    def pause(self) -> None:
        """Let some time pass between two looks."""


@dataclass
class StackRun:
    """A stack on its way: what was sent, and with which stages."""

    lines: tuple[StackLine, ...]
    desk: StackDesk
    sent: dict[str, StackLine] = field(default_factory=dict)
    """The lines that were sent, by the id of their command, in order."""
    statuses: dict[str, CommandStatus] = field(default_factory=dict)

    def check(self) -> Iterator[tuple[StackLine, CommandOutlook]]:
        """What each command would do as things are now; raises InvalidInput for the first that would be refused.

        Nothing is sent. A warning refuses a command, too, unless a command before it may change what it warns of.
        """
        broken = rule_broken(self.lines, self.desk.rover_mode())
        if broken is not None:
            raise InvalidInput(f"stack: {broken}; nothing was sent")
        for line in self.lines:
            outlook = self.desk.outlook(line)
            yield line, outlook
            warning = "" if self._may_change_before(line) else outlook.preview.warning
            if why := outlook.preview.objection or warning:
                raise InvalidInput(f"stack: {line.name}: {why}; nothing was sent")

    def rows(self, line: StackLine, outlook: CommandOutlook) -> list[tuple[str, str]]:
        """What the command would do, as names and texts for people.

        A warning that commands before it may make void is named as what holds now.
        """
        if not self._may_change_before(line):
            return outlook.rows()
        return [
            ("now", f"{text}; what comes before it may change that") if name == "WARNING" else (name, text)
            for name, text in outlook.rows()
        ]

    def _may_change_before(self, line: StackLine) -> bool:
        """Whether things may be other than they are now when that command's turn comes."""
        before = self.lines[: self.lines.index(line)]
        if line.command.kind is CommandKind.SET_KEEP_OUT:
            return any(each.command.area_id == line.command.area_id for each in before)
        return bool(before) or line.at is not None

    def run(self, may_send: Callable[[StackLine, CommandOutlook], bool]) -> Iterator[tuple[StackLine, CommandStatus]]:
        """Send the commands, each under its conditions and if `may_send` says so; yields a line with every new stage.

        Raises He3Error, in one line, at the first command that fails or is not to be sent, and PeerUnreachable when the
        mission does not answer; nothing is sent after it.
        """
        try:
            yield from self._run(may_send)
        except OutcomeUnknown as silence:
            raise OutcomeUnknown(f"stack: {silence}; beside it {self._account()}") from None
        except PeerUnreachable as silence:
            raise PeerUnreachable(f"stack: {silence}; {self._account()}") from None

    def _run(self, may_send: Callable[[StackLine, CommandOutlook], bool]) -> Iterator[tuple[StackLine, CommandStatus]]:
        for line in self.lines:
            while not self._may_go(line):
                self.desk.pause()
                yield from self._look()
            outlook = self.desk.outlook(line)
            if outlook.preview.objection:
                raise self._failure(line, outlook.preview.objection)
            if not may_send(line, outlook):
                raise self._failure(line, "not sent, as the operator decided")
            try:
                name = self.desk.send(line)
            except InvalidInput as refusal:
                raise self._failure(line, str(refusal)) from None
            except PeerUnreachable as silence:
                raise type(silence)(f"{line.name}: {silence}") from None
            self.sent[name] = line
            yield from self._look()
        while any(not self._ended(name) for name in self.sent):
            self.desk.pause()
            yield from self._look()

    def _may_go(self, line: StackLine) -> bool:
        if line.after is not None:
            before = self.statuses.get(list(self.sent)[-1])
            if before is None or not before.has_reached(line.after):
                return False
        if line.at is not None and self.desk.now() < line.at:
            return False
        return not line.at_contact or self.desk.in_contact()

    def _look(self) -> Iterator[tuple[StackLine, CommandStatus]]:
        found = self.desk.stages()
        for name, line in self.sent.items():
            known, status = self.statuses.get(name), found.get(name)
            if status is None or (known is not None and len(known.stages) >= len(status.stages)):
                continue
            self.statuses[name] = status
            yield line, status
        for name, line in self.sent.items():
            status = self.statuses.get(name)
            end = None if status is None else status.end
            if end is not None and end.stage is not CommandStage.COMPLETED:
                raise self._failure(line, f"{end.stage.value}{': ' + end.why if end.why else ''}")

    def _ended(self, name: str) -> bool:
        status = self.statuses.get(name)
        return status is not None and status.end is not None

    def _failure(self, line: StackLine, why: str) -> He3Error:
        return He3Error(f"stack: {line.name}: {why}; {self._account()}")

    def _account(self) -> str:
        return f"{len(self.sent)} of {len(self.lines)} commands sent, nothing is sent after it"


class MissionDesk:
    """A running mission, for a stack."""

    def __init__(self, mission: MissionClient) -> None:
        self._mission = mission

    def now(self) -> MissionTime:
        return self._mission.now()

    def in_contact(self) -> bool:
        return self._mission.link().contact

    def rover_mode(self) -> RoverMode | None:
        rover = self._mission.status().rover
        return None if rover is None else rover.mode

    def outlook(self, line: StackLine) -> CommandOutlook:
        command = line.command
        return self._mission.preview(
            command.kind, target_m=command.target_m, area_id=command.area_id, polygon_m=command.polygon_m
        )

    def send(self, line: StackLine) -> str:
        command = line.command
        issued = self._mission.command(
            command.kind,
            target_m=command.target_m,
            area_id=command.area_id,
            polygon_m=command.polygon_m,
            expires_in_s=line.expires_in_s,
            command_id=command.command_id,
        )
        return issued.command_id

    def stages(self) -> dict[str, CommandStatus]:
        return {status.command.command_id: status for status in self._mission.commands()}

    def pause(self) -> None:
        time.sleep(LOOK_EVERY_S)
