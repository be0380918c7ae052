"""``he3 replay``: the contents of a recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.console.cli.options import AsJson, checked

if TYPE_CHECKING:
    from schemas.ground import GroundStatus
    from services.recorder.reader import Recorded, Recording

EXAMPLES = """\b
Examples:
  he3 replay runs/t1/mission.mcap
  he3 replay runs/t1/mission.mcap --topic tm/sample | head -3
  he3 replay --live runs/t1/mission.mcap --at 20h --rate 100     # then: he3 status; he3 watch; he3 map at 120 340
  he3 replay --verify runs/t1/mission.mcap             # compute the map again, compare it with the recorded one
"""

FileName = Annotated[Path, typer.Argument(metavar="FILE", help="A recording: mission.mcap.")]
TopicName = Annotated[
    str | None,
    typer.Option("--topic", metavar="NAME", help="Print the messages of that topic, one JSON document a line."),
]
Verify = Annotated[
    bool,
    typer.Option(
        "--verify",
        help="Rebuild the belief from the recorded samples; compare it with the recorded map, to 1e-6 ppb.",
    ),
]
Live = Annotated[
    bool,
    typer.Option(
        "--live",
        help="Serve the recorded mission to every command that reads one, until Ctrl-C; he3 time pauses and paces it.",
    ),
]


def _moment(text: str) -> str:
    from services.console.client.time_format import parse_moment

    parse_moment(text, 0)
    return text


At = Annotated[
    str | None,
    typer.Option("--at", metavar="TIME", callback=checked(_moment),
                 help="With --live: begin there, such as 20h after the mission's beginning, or at a time in UTC."),
]  # fmt: skip
Pace = Annotated[
    float,
    typer.Option(
        "--rate",
        metavar="R",
        min=0,
        max=100_000,
        help="With --live: simulation speed, mission seconds per wall second; 0 pauses it.",
    ),
]


@dataclass
class _Seen:
    counts: Counter[str] = field(default_factory=Counter)
    size_bytes: Counter[str] = field(default_factory=Counter)
    first_ns: int | None = None
    last_ns: int = 0
    status: GroundStatus | None = None
    samples: set[str] = field(default_factory=set)

    def take(self, message: Recorded) -> None:
        name = message.topic.name
        self.counts[name] += 1
        self.size_bytes[name] += len(message.payload)
        self.first_ns = message.received_at if self.first_ns is None else self.first_ns
        self.last_ns = max(self.last_ns, message.received_at)
        if name == "tm/sample":
            self.samples.add(message.body.sample_id)
        elif name == "earth/ground/status":
            self.status = message.body


def replay(
    file: FileName,
    topic: TopicName = None,
    verify: Verify = False,
    live: Live = False,
    at: At = None,
    rate: Pace = 1.0,
    json: AsJson = False,
) -> None:
    """Summarise a recording. Intact parts of a damaged file are read; missing ones are reported, with exit code 1."""
    import json as json_format

    from he3.errors import InvalidInput
    from schemas.topics import TOPICS
    from schemas.wire import printable
    from services.recorder.reader import Recording

    if live:
        if verify or topic is not None or json:
            raise InvalidInput("--live: expected none of --verify, --topic and --json, got one")
        _serve(file, at, rate)
        return
    if at is not None:
        raise InvalidInput("--at: expected --live with it, got --at alone")
    names = [each.name for each in TOPICS if each.recorded]
    if topic is not None and topic not in names:
        raise InvalidInput(f"--topic: expected one of {', '.join(names)}; got '{topic}'")
    if verify:
        if topic is not None:
            raise InvalidInput("--verify and --topic: expected one of them, got both")
        _verify(file, json)
        return
    recording, seen = Recording(file), _Seen()
    for message in recording.messages():
        seen.take(message)
        if topic == message.topic.name:
            typer.echo(printable(message.payload.decode()))
    problems = recording.problems()
    if topic is None:
        document = _document(recording, seen, problems)
        typer.echo(json_format.dumps(document, indent=2) if json else "\n".join(_lines(document, seen)))
    _say_problems(file, problems)
    if problems:
        raise typer.Exit(1)


def _serve(file: Path, at: str | None, rate: float) -> None:
    """Serve the recorded mission at a free endpoint of this machine until Ctrl-C."""
    import os
    import threading

    from services.console.client.run_file import RunningMission, announced
    from services.console.client.time_format import parse_moment
    from services.console.launch.endpoints import free_endpoints
    from services.console.replay.mission import RecordedMission
    from services.console.replay.serving import serving

    with RecordedMission(file) as mission:
        _say_problems(file, mission.notes)
        if at is not None:
            mission.jump(parse_moment(at, mission.begin_ns))
        where = free_endpoints()
        running = RunningMission(
            mission.mission, str(file), where.moon, where.earth, os.getpid(), {}, recording=str(file.resolve())
        )
        with serving(mission, where.earth), announced(running):
            mission.set_pace(rate)
            typer.echo(
                f"recording of mission '{mission.mission}' at {where.earth}, {rate:g} mission seconds a second; "
                "he3 time rate and he3 time pause change that, Ctrl-C stops it",
                err=True,
            )
            threading.Event().wait()


def _verify(file: Path, json: bool) -> None:
    """Print how the recorded map compares with the rebuilt one; exit code 1 if they differ or the file is damaged."""
    import json as json_format
    from dataclasses import asdict

    from services.console.report.verification import TOLERANCE_PPB, verify

    result = verify(file)
    if json:
        document = {"file": str(file), "equal": result.equal, "tolerance_ppb": TOLERANCE_PPB, **asdict(result)}
        typer.echo(json_format.dumps(document, indent=2))
    else:
        verdict = (
            "equal"
            if result.equal
            else "DIFFERENT" + (f", most at revision {result.at_revision}" if result.at_revision else "")
        )
        mean, std = f"{result.largest_mean_ppb:.2g}", f"{result.largest_std_ppb:.2g}"
        lines = (
            f"belief     {verdict}: {result.revisions} revisions, rebuilt from {result.samples} recorded samples",
            f"difference at most {mean} ppb of the mean, {std} ppb of its std, over {result.values:,} values of each",
            f"checksum   {result.identical} of {result.revisions} revisions are identical on all cells",
        )
        typer.echo("\n".join(lines))
        if result.after_loss:
            largest = f"{result.largest_after_loss_ppb:.2g}"
            typer.echo(f"after loss {result.after_loss} revisions follow others that were not recorded: {largest} ppb")
    _say_problems(file, result.problems)
    if not result.equal or result.problems:
        raise typer.Exit(1)


def _say_problems(file: Path, problems: Sequence[str]) -> None:
    from schemas.wire import printable

    for problem in problems:
        typer.echo(f"he3: {printable(f'{file}: {problem}')}", err=True)


def _document(recording: Recording, seen: _Seen, problems: list[str]) -> dict[str, Any]:
    span_s = 0.0 if seen.first_ns is None else (seen.last_ns - seen.first_ns) / 1e9
    return {
        "file": str(recording.path),
        "mission": recording.mission,
        "complete": not problems,
        "problems": problems,
        "repairs": recording.repairs,
        "foreign": dict(sorted(recording.foreign.items())),
        "mission_over": seen.status is not None and seen.status.is_over,
        "messages": seen.counts.total(),
        "samples": len(seen.samples),
        "span_s": span_s,
        "topics": {
            name: {"messages": count, "bytes": seen.size_bytes[name]} for name, count in sorted(seen.counts.items())
        },
        "last_status": None if seen.status is None else seen.status.model_dump(mode="json"),
    }


def _lines(document: dict[str, Any], seen: _Seen) -> list[str]:
    from services.console.client.time_format import duration
    from services.console.report.progress import moment_of, plain_line

    lines = [
        f"recording  {document['file']}: mission '{document['mission']}', {document['messages']} messages in "
        f"{duration(document['span_s'])} of mission time",
        f"state      {_state(document)}",
    ]
    if seen.status is not None:
        lines.append(f"last       {plain_line(moment_of(seen.status, document['span_s'], 0), 0.0)}")
    lines.append(f"{'topic':<28} {'messages':>9} {'bytes':>12}")
    lines += [f"{name:<28} {row['messages']:>9} {row['bytes']:>12}" for name, row in document["topics"].items()]
    if document["foreign"]:
        lines.append(f"{'for other programs':<28} {sum(document['foreign'].values()):>9}")
    return lines


def _state(document: dict[str, Any]) -> str:
    if not document["complete"]:
        return f"incomplete: {document['problems'][0]}"
    file = "repaired file, once not closed" if document["repairs"] else "complete file"
    return "complete" if document["mission_over"] else f"{file}; the mission was not over"
