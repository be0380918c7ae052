"""``he3 command`` and ``he3 commands``: telecommands to the rover, and the stages that they have passed."""

from __future__ import annotations

import re
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.console.cli.coordinates import NEGATIVE_NUMBERS, Corners, X, Y, polygon
from services.console.cli.flag_groups import FlagGroup, with_flags
from services.console.cli.options import MAX_WAIT_S, AsJson, checked, one_of, within
from services.console.cli.session import NamedSession, Session
from services.console.interruption import Terminated

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from schemas.commands import CommandStage, CommandStatus
    from services.console.client.areas import AreaKind
    from services.console.client.mission_client import MissionClient
    from services.console.client.previews import CommandOutlook

EXAMPLES = """\b
Examples:
  he3 command pause
  he3 command resume --wait completed
  he3 command safe                         # enter safe mode at once
  he3 command abort-round                  # give up the present round; the ground plans anew
  he3 command return-to-start
  he3 command go-to 120 340 --preview      # what it would do; nothing is sent
  he3 command go-to 120 340 --expires-in 3600 --yes
  he3 command keep-out crater 100,100 150,100 125,150
  he3 command keep-out crater 90,90 160,90 125,160 --replace
  he3 command keep-out crater              # removes that area
  he3 commands
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

STAGES = ("queued", "released", "radiated", "received", "accepted", "started", "completed")
"""The stages that tab completion offers to wait for; a failure ends the waiting in any case."""

_IDENTIFIER = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.:-]{0,63}")


def _identifier(text: str) -> str:
    if not _IDENTIFIER.fullmatch(text):
        raise typer.BadParameter(
            f"expected at most 64 letters, digits, '_', '.', ':' and '-', a letter or digit first, got '{text[:80]}'"
        )
    return text


def _stage(word: str) -> str:
    from services.console.client.commands import stage_named

    return stage_named(word).value


CommandId = Annotated[
    str | None,
    typer.Option("--id", metavar="ID", help="Command id; commands of the same id execute once.",
                 callback=checked(_identifier)),
]  # fmt: skip
ExpiresIn = Annotated[
    float | None,
    typer.Option("--expires-in", metavar="S", help="Do not execute it later than S seconds of mission time from now.",
                 callback=within(0, 1e9, above=True)),
]  # fmt: skip
Wait = Annotated[
    str | None,
    typer.Option("--wait", metavar="STAGE", help="Wait until it has reached that stage (released, received, ...).",
                 callback=checked(_stage), autocompletion=one_of(*STAGES)),
]  # fmt: skip
Timeout = Annotated[
    float,
    typer.Option("--timeout", metavar="S", help="Longest time to wait [s of wall time].",
                 callback=within(0, MAX_WAIT_S)),
]  # fmt: skip
Preview = Annotated[
    bool, typer.Option("--preview", help="Only say what it would do: drive, energy, rounds lost, when; send nothing.")
]
Yes = Annotated[
    bool, typer.Option("--yes", "-y", help="Send it without asking. Without a terminal nothing is asked anyway.")
]
Replace = Annotated[bool, typer.Option("--replace", help="Replace the area of that name.")]
checked_name = checked(_identifier)
"""The name of an area, or a usage error."""
Area = Annotated[str, typer.Argument(metavar="AREA", help="Name of the area.", callback=checked_name)]


@dataclass(frozen=True, slots=True)
class Sending(FlagGroup):
    """How a command is sent, and what is shown of it."""

    command_id: CommandId = None
    expires_in: ExpiresIn = None
    wait: Wait = None
    timeout: Timeout = 60.0
    preview: Preview = False
    yes: Yes = False
    json: AsJson = False


_PLAIN = {
    "pause": "Stop the rover where it is, until 'resume'.",
    "resume": "Continue after 'pause', or leave safe mode.",
    "abort-round": "Abort the present round; the ground plans a new one.",
    "return-to-start": "Drive back to the landing place.",
    "safe": "Enter safe mode at once.",
}


def _plain(word: str, about: str) -> None:
    @app.command(word, help=about, epilog=EXAMPLES)
    @with_flags
    def issue(sending: Sending, session: NamedSession) -> None:
        _issue(session, word, {}, sending)


for _word, _about in _PLAIN.items():
    _plain(_word, _about)


@app.command("go-to", epilog=EXAMPLES, context_settings=NEGATIVE_NUMBERS)
@with_flags
def go_to(sending: Sending, session: NamedSession, x: X, y: Y) -> None:
    """Drive to a place, and wait there for the next plan."""
    _issue(session, "go-to", {"target_m": (x, y)}, sending)


@app.command(
    "keep-out", short_help="Close an area, or open it again.", epilog=EXAMPLES, context_settings=NEGATIVE_NUMBERS
)
@with_flags
def keep_out(
    sending: Sending, session: NamedSession, area: Area, corners: Corners = None, replace: Replace = False
) -> None:
    """Close an area to the rover; without corners, open it again. The name is new, unless --replace is given."""
    what: dict[str, Any] = {"area_id": area}
    if corners:
        what["polygon_m"] = polygon(corners)
    _issue(session, "set-keep-out", what, sending, new_area=bool(corners) and not replace)


def _issue(session: NamedSession, kind: str, what: dict[str, Any], how: Sending, *, new_area: bool = False) -> None:
    """Send the command; `new_area`: it sets an area whose name must be new."""
    from schemas.commands import CommandStage
    from services.console.client.areas import AreaKind
    from services.console.client.commands import new_command_id

    stage = None if how.wait is None else CommandStage(how.wait)
    with session.join() as client:
        if new_area:
            expect_new_name(client, AreaKind.KEEP_OUT, what["area_id"], how.command_id)
        if how.preview:
            _show(client, client.preview(kind, **what), json=how.json)
            return
        if asks(kind, yes=how.yes) and not confirmed(client, client.preview(kind, **what)):
            typer.echo("he3: nothing was sent", err=True)
            raise typer.Exit(1)
        command_id = how.command_id or new_command_id()
        with _named_if_interrupted(command_id):
            issued = client.command(kind, expires_in_s=how.expires_in, command_id=command_id, **what)
        try:
            if stage is not None:
                issued.wait(stage, how.timeout)
        finally:  # it is sent, whatever ends the waiting
            status = issued.status
            sent = f"mission '{client.mission}'", *command_lines([status])
            typer.echo(status.model_dump_json(indent=2) if how.json else "\n".join(sent))
    fail_if_it_failed(status, stage)


@contextmanager
def _named_if_interrupted(command_id: str) -> Iterator[None]:
    """Name the command, on standard error, if a signal ends the waiting for the ground's answer: it may be sent."""
    try:
        yield
    except (KeyboardInterrupt, Terminated):
        typer.echo(f"he3: command {command_id} may have been sent (he3 commands)", err=True)
        raise


def expect_new_name(client: MissionClient, kind: AreaKind, name: str, command_id: str | None = None) -> None:
    """Raise InvalidInput if an area of that kind has the name; command_id: see `Areas.name_objection`."""
    from he3.errors import InvalidInput

    objection = client.name_objection(kind, name, command_id)
    if objection is not None:
        raise InvalidInput(f"{objection}; --replace gives it another outline")


def asks(kind: str, *, yes: bool) -> bool:
    """Whether the operator is asked before the command is sent: on a terminal, where they see the question.

    `safe` is for emergencies, in which a question costs time.
    """
    return not yes and kind != "safe" and has_terminal()


def has_terminal() -> bool:
    """Whether the operator sees a question and can answer it; a closed stream is no terminal."""
    return all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr))


def _show(client: MissionClient, outlook: CommandOutlook, *, json: bool) -> None:
    """Print what the command would do; raises InvalidInput if the ground would refuse it."""
    import json as json_format

    from he3.errors import InvalidInput

    typer.echo(json_format.dumps(outlook.document(), indent=2) if json else "\n".join(outlook_lines(client, outlook)))
    if not outlook.sound:
        raise InvalidInput(outlook.preview.objection)


def confirmed(client: MissionClient, outlook: CommandOutlook, *further: tuple[str, str]) -> bool:
    """Whether the operator at the terminal sends the command that would do this: Enter does, any other answer not.

    further: names and texts of what else is decided.
    Raises InvalidInput for a command that the ground would refuse: there is nothing to ask.
    """
    from he3.errors import InvalidInput

    if not outlook.sound:
        raise InvalidInput(outlook.preview.objection)
    typer.echo("\n".join(outlook_lines(client, outlook, *further)), err=True)
    typer.echo("Enter sends it, any other answer does not: ", nl=False, err=True)
    return sends(sys.stdin.readline())


def sends(answer: str) -> bool:
    """Whether that line of an operator sends the command: Enter alone and yes do, the end of the input does not."""
    return answer.endswith("\n") and answer.strip() in ("", "y", "yes")


def outlook_lines(client: MissionClient, outlook: CommandOutlook, *further: tuple[str, str]) -> list[str]:
    """What a command would do in aligned lines of plain text; the mission that it goes to comes first."""
    rows = [("mission", f"{client.mission} at {client.earth}"), *outlook.rows(), *further]
    return [f"{name:<10} {text}" for name, text in rows]


def fail_if_it_failed(status: CommandStatus, stage: CommandStage | None) -> None:
    """Raise He3Error, with stage and reason, if the command ended neither completed nor in the stage waited for."""
    from he3.errors import He3Error
    from schemas.commands import ENDS
    from schemas.commands import CommandStage as Stage

    end = status.end
    if end is not None and end.stage is not (stage if stage in ENDS else Stage.COMPLETED):
        raise He3Error(f"command {status.command.command_id}: {end.stage.value}{': ' + end.why if end.why else ''}")


@with_flags
def commands(
    session: Session,
    json: AsJson = False,
) -> None:
    """List every telecommand with the stages that it has passed and their times."""
    from schemas.commands import CommandList

    with session.join() as client:
        listed = client.commands()
    if json:
        typer.echo(CommandList(commands=listed).model_dump_json(indent=2))
    else:
        typer.echo("\n".join(command_lines(listed)) or "no commands yet")


def command_lines(statuses: Sequence[CommandStatus]) -> list[str]:
    """Commands with their stages in aligned lines of plain text."""
    from services.console.client.time_format import utc

    lines = []
    for status in statuses:
        command = status.command
        about = command.kind.value.replace("_", " ")
        if command.target_m is not None:
            about += f" ({command.target_m[0]:g}, {command.target_m[1]:g}) m"
        if command.area_id is not None:
            about += f" {command.area_id}: {f'{len(command.polygon_m)} corners' if command.polygon_m else 'removed'}"
        expires = "" if command.expires_at is None else f", expires {utc(command.expires_at)}"
        by = f", by {command.by}" if command.by else ""
        lines.append(f"{command.command_id}  {about}{expires}{by}")
        for report in status.stages:
            why = f"  {report.why}" if report.why else ""
            lines.append(f"    {utc(report.at)}  {report.stage.value:<10}{why}".rstrip())
    return lines
