"""``he3 command`` and ``he3 commands``: telecommands to the rover, and what became of them."""

from __future__ import annotations

import math
import time
import uuid
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.console.cli.options import AsJson, Earth, Mission

if TYPE_CHECKING:
    from schemas.commands import CommandStage, CommandStatus

EXAMPLES = """\b
Examples:
  he3 command pause
  he3 command resume --wait completed
  he3 command go-to 120 340 --expires-in 3600
  he3 command keep-out crater 100,100 150,100 125,150
  he3 command keep-out crater              takes that area back
  he3 commands
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

CommandId = Annotated[str | None, typer.Option("--id", metavar="ID", help="Its name; the same name executes once.")]
ExpiresIn = Annotated[
    float | None,
    typer.Option("--expires-in", metavar="S", help="Not to be executed later than that [s, mission time]."),
]
Wait = Annotated[
    str | None, typer.Option("--wait", metavar="STAGE", help="Wait until it is released, received, completed, ...")
]
Within = Annotated[float, typer.Option("--timeout", metavar="S", help="How long to wait at most [s, wall time].")]

_PLAIN = {
    "pause": "Stop where it is, until 'resume'.",
    "resume": "Go on after 'pause', or after safe mode.",
    "abort-round": "Give up the present round; the ground plans anew.",
    "return-to-start": "Drive back to where it landed.",
    "safe": "Go into safe mode at once.",
}


def _plain(word: str, about: str) -> None:
    def issue(
        mission: Mission = None,
        earth: Earth = None,
        command_id: CommandId = None,
        expires_in: ExpiresIn = None,
        wait: Wait = None,
        timeout: Within = 60.0,
        json: AsJson = False,
    ) -> None:
        _issue({"kind": word.replace("-", "_")}, mission, earth, command_id, expires_in, wait, timeout, json)

    app.command(word, help=about, epilog=EXAMPLES)(issue)


for _word, _about in _PLAIN.items():
    _plain(_word, _about)


@app.command("go-to", epilog=EXAMPLES, context_settings={"ignore_unknown_options": True})
def go_to(
    x: Annotated[float, typer.Argument(metavar="X", help="Metres east of the south-west corner.")],
    y: Annotated[float, typer.Argument(metavar="Y", help="Metres north of it.")],
    mission: Mission = None,
    earth: Earth = None,
    command_id: CommandId = None,
    expires_in: ExpiresIn = None,
    wait: Wait = None,
    timeout: Within = 60.0,
    json: AsJson = False,
) -> None:
    """Drive there, and stay until the next plan."""
    what = {"kind": "go_to", "target_m": [x, y]}
    _issue(what, mission, earth, command_id, expires_in, wait, timeout, json)


@app.command("keep-out", epilog=EXAMPLES)
def keep_out(
    area: Annotated[str, typer.Argument(metavar="AREA", help="Name of the area.")],
    corners: Annotated[list[str] | None, typer.Argument(metavar="X,Y", help="Its corners; none takes it back.")] = None,
    mission: Mission = None,
    earth: Earth = None,
    command_id: CommandId = None,
    expires_in: ExpiresIn = None,
    wait: Wait = None,
    timeout: Within = 60.0,
    json: AsJson = False,
) -> None:
    """Close an area to the rover, or open it again."""
    what: dict[str, Any] = {"kind": "set_keep_out", "area_id": area}
    if corners:
        what["polygon_m"] = [_corner(text) for text in corners]
    _issue(what, mission, earth, command_id, expires_in, wait, timeout, json)


def _corner(text: str) -> list[float]:
    from he3.errors import InvalidInput

    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise InvalidInput(f"keep-out: expected corners as X,Y in metres, got '{text}'") from None
    return [x, y]


def _issue(
    what: dict[str, Any],
    mission: str | None,
    earth: str | None,
    command_id: str | None,
    expires_in: float | None,
    wait: str | None,
    timeout_s: float,
    json: bool,
) -> None:
    from he3.errors import InvalidInput
    from schemas.link import ClockState
    from schemas.topics import EARTH_CLOCK, ISSUE_COMMAND
    from services.console.client.session import join
    from services.runtime.clock import mission_time
    from services.runtime.node import seconds

    stage = _stage(wait)
    if expires_in is not None and not 0 < expires_in < math.inf:
        raise InvalidInput(f"--expires-in: expected a time ahead [s], got {expires_in:g}")
    document = {"command_id": command_id or f"op-{uuid.uuid4().hex[:10]}", **what}
    _checked(document)
    with join(mission, earth) as client:
        if expires_in is not None:
            clock: ClockState = client.latest(EARTH_CLOCK)[1]
            document["expires_at"] = mission_time(clock, time.time_ns()) + seconds(expires_in)
        status: CommandStatus = client.query(ISSUE_COMMAND, _checked(document))
        if stage is not None:
            status = _waited(client, status, stage, timeout_s)
    typer.echo(status.model_dump_json(indent=2) if json else "\n".join(command_lines([status])))
    fail_if_it_failed(status, stage)


def _stage(word: str | None) -> CommandStage | None:
    from he3.errors import InvalidInput
    from schemas.commands import CommandStage

    try:
        return None if word is None else CommandStage(word)
    except ValueError:
        known = ", ".join(stage.value for stage in CommandStage)
        raise InvalidInput(f"--wait: expected a stage out of {known}; got '{word}'") from None


def _checked(document: dict[str, Any]) -> Any:
    import json as json_format

    from pydantic import ValidationError

    from he3.errors import InvalidInput
    from schemas.codec import one_line
    from schemas.commands import Telecommand

    try:
        return Telecommand.model_validate_json(json_format.dumps(document))
    except ValidationError as error:
        raise InvalidInput(f"command: {one_line(error)}") from None


def _waited(client: Any, status: CommandStatus, stage: CommandStage, timeout_s: float) -> CommandStatus:
    """The command's status once it has passed that stage or ended; raises PeerUnreachable when time runs out."""
    import queue

    from he3.errors import PeerUnreachable
    from schemas.commands import CommandList, NoParameters
    from schemas.topics import COMMAND_STATUS, LIST_COMMANDS

    name = status.command.command_id
    news: queue.SimpleQueue[CommandStatus] = queue.SimpleQueue()
    client.subscribe(COMMAND_STATUS, lambda header, body: news.put(body))
    # What happened between the answer and the subscription is in the list.
    listed: CommandList = client.query(LIST_COMMANDS, NoParameters())
    status = next((each for each in listed.commands if each.command.command_id == name), status)
    deadline = time.monotonic() + timeout_s
    while not status.has_reached(stage):
        try:
            heard = news.get(timeout=max(0.0, deadline - time.monotonic()))
        except queue.Empty:
            last = status.stages[-1].stage.value if status.stages else "nowhere"
            raise PeerUnreachable(
                f"command {name}: not {stage.value} within {timeout_s:g} s; it is {last} so far (see he3 commands)"
            ) from None
        if heard.command.command_id == name:
            status = heard
    return status


def fail_if_it_failed(status: CommandStatus, stage: CommandStage | None) -> None:
    """Raise He3Error, with stage and reason, for a command that has ended otherwise than completed or as waited for."""
    from he3.errors import He3Error
    from schemas.commands import ENDS
    from schemas.commands import CommandStage as Stage

    end = status.end
    if end is not None and end.stage is not (stage if stage in ENDS else Stage.COMPLETED):
        raise He3Error(f"command {status.command.command_id}: {end.stage.value}{': ' + end.why if end.why else ''}")


def commands(mission: Mission = None, earth: Earth = None, json: AsJson = False) -> None:
    """Every telecommand, and each stage that it has passed, with its time."""
    from schemas.commands import CommandList, NoParameters
    from schemas.topics import LIST_COMMANDS
    from services.console.client.session import join

    with join(mission, earth) as client:
        listed: CommandList = client.query(LIST_COMMANDS, NoParameters())
    if json:
        typer.echo(listed.model_dump_json(indent=2))
    else:
        typer.echo("\n".join(command_lines(list(listed.commands))) or "no commands yet")


def command_lines(statuses: list[CommandStatus]) -> list[str]:
    """Commands with their stages in aligned lines of plain text."""
    from services.console.cli.link import clock_text

    lines = []
    for status in statuses:
        command = status.command
        about = command.kind.value
        if command.target_m is not None:
            about += f" ({command.target_m[0]:g}, {command.target_m[1]:g}) m"
        if command.area_id is not None:
            about += f" {command.area_id}: {len(command.polygon_m) if command.polygon_m else 'no'} corners"
        expires = "" if command.expires_at is None else f", expires {clock_text(command.expires_at)}"
        lines.append(f"{command.command_id}  {about}{expires}")
        for report in status.stages:
            why = f"  {report.why}" if report.why else ""
            lines.append(f"    {clock_text(report.at)}  {report.stage.value:<10}{why}".rstrip())
    return lines
