"""``he3 stack``: a list of telecommands with conditions, checked whole, then sent one after the other."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.console.cli.flag_groups import with_flags
from services.console.cli.options import AsJson
from services.console.cli.session import NamedSession

if TYPE_CHECKING:
    from schemas.commands import CommandStatus
    from services.console.client.mission_client import MissionClient
    from services.console.client.previews import CommandOutlook
    from services.console.client.stacks import StackLine, StackRun

MAX_BYTES = 1_000_000
"""Most bytes of a stack."""

EXAMPLES = """\b
Examples:
  he3 stack run survey.stack --dry-run     # check it; nothing is sent
  he3 stack run survey.stack               # check it, ask once, send it
  he3 stack run survey.stack --step        # ask before every command
  he3 stack run --do pause --do "after completed: resume" --yes
  generate | he3 stack run - --yes --json
\b
A file has one command a line, in the words of 'he3 command'; conditions come first:
  pause                                    # the first one: at once
  after accepted: keep-out crater 100,100 150,100 125,150
  after completed, at next contact: resume
  at 2h: go-to 120 340 --expires-in 3600
Without a condition a command waits until the one before it has completed. The stack
stops at its first failure. 'at next contact' is at once while there is contact.
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.callback()
def _group() -> None:
    """A list of telecommands with conditions: checked whole, then sent one after the other."""


@app.command(short_help="Check a stack of commands, then send it.", epilog=EXAMPLES)
@with_flags
def run(
    session: NamedSession,
    file: Annotated[Path | None, typer.Argument(metavar="FILE", help="The stack; - reads standard input.")] = None,
    do: Annotated[
        list[str] | None, typer.Option("--do", metavar="LINE", help="A line of the stack, instead of FILE; repeatable.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only check it and say what it would do.")] = False,
    step: Annotated[bool, typer.Option("--step", help="Ask before every command.")] = False,
    yes: Annotated[
        bool, typer.Option("--yes", "-y", help="Send it without a question. Without a terminal there is none.")
    ] = False,
    json: AsJson = False,
) -> None:
    """Check a stack of commands against the rover's rules, then send it; stops at the first failure."""
    from he3.errors import InvalidInput
    from services.console.cli.command import has_terminal
    from services.console.client.stacks import MissionDesk, StackRun, parse_stack

    if step and not has_terminal():
        raise InvalidInput("stack: --step asks before every command: expected a terminal, got none")
    text = _text(file, do)
    with session.join() as client:
        stack = StackRun(parse_stack(text, client.clock().start_ns), MissionDesk(client))
        quiet = json and not dry_run
        checked = [_checked(stack, line, outlook, quiet) for line, outlook in stack.check()]
        if dry_run:
            _end(client, stack, json, checked)
            return
        if not (yes or step) and has_terminal() and not _agreed("the whole stack"):
            typer.echo("he3: nothing was sent", err=True)
            raise typer.Exit(1)
        try:
            for line, status in stack.run(lambda line, _: not step or _agreed(line.name)):
                _report(line, status, json)
        finally:
            _end(client, stack, json, checked)


def _text(file: Path | None, do: list[str] | None) -> str:
    """The text of the stack; raises InvalidInput unless there is exactly one."""
    from he3.errors import InvalidInput

    if (file is None) == (not do):
        raise InvalidInput("stack: expected a FILE or lines with --do, and not both")
    if file is None:
        return "\n".join(do or ())
    if str(file) == "-" and sys.stdin is None:
        raise InvalidInput("stack: -: expected a stack on standard input, which is closed")
    try:
        with nullcontext(sys.stdin.buffer) if str(file) == "-" else file.open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)  # a device may have no end
        if len(content) > MAX_BYTES:
            raise InvalidInput(f"stack: {file}: expected at most {MAX_BYTES:,} bytes, got more")
        return content.decode()
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is no text in UTF-8"
        raise InvalidInput(f"stack: {file}: cannot read: {why}") from None


def _checked(stack: StackRun, line: StackLine, outlook: CommandOutlook, quiet: bool) -> dict[str, Any]:
    """One command of the check, shown unless `quiet`, as a document."""
    if not quiet:
        typer.echo(f"line {line.number:<3} {line.waits_for}: {line.text}", err=True)
        for name, text in stack.rows(line, outlook):
            if name in ("does", "drive", "energy", "closes", "opens", "rounds", "REFUSED", "WARNING", "now"):
                typer.echo(f"         {name:<8} {text}", err=True)
    return {"line": line.number, "command": line.text, "waits_for": line.waits_for, "outlook": outlook.document()}


def _agreed(what: str) -> bool:
    from services.console.cli.command import sends

    typer.echo(f"Enter sends {what}, any other answer does not: ", nl=False, err=True)
    return sends(sys.stdin.readline())


def _report(line: StackLine, status: CommandStatus, json: bool) -> None:
    from services.console.client.time_format import utc

    if json:
        return
    last = status.stages[-1]
    typer.echo(f"{utc(last.at)}  line {line.number:<3} {last.stage.value:<10} {line.text}")


def _end(client: MissionClient, stack: StackRun, json: bool, checked: list[dict[str, Any]]) -> None:
    """Print the document, or the last line, of a stack that has ended or was checked."""
    import json as json_format

    done = sum(status.end is not None for status in stack.statuses.values())
    if not json:
        sent = f"{len(stack.sent)} of {len(stack.lines)} commands sent, {done} ended" if stack.sent else "nothing sent"
        typer.echo(f"mission '{client.mission}': {sent}")
        return
    document = {
        "mission": client.mission,
        "lines": checked,
        "sent": [
            {"line": line.number, "command_id": name, "status": _status(stack.statuses.get(name))}
            for name, line in stack.sent.items()
        ],
        "complete": bool(stack.sent) and done == len(stack.lines),
    }
    typer.echo(json_format.dumps(document, indent=2))


def _status(status: CommandStatus | None) -> Any:
    return None if status is None else status.model_dump(mode="json")
