"""``he3 alarms``: what needs attention, what people did about it, and what is over."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.console.cli.flag_groups import with_flags
from services.console.cli.options import AsJson, checked, one_of
from services.console.cli.session import NamedSession, Session

if TYPE_CHECKING:
    from collections.abc import Sequence

    from schemas.mission_log import LogEntry
    from services.console.client.alarms import Alarm, Alarms
    from services.console.client.mission_client import MissionClient
    from services.console.client.mission_state import MissionState

EXAMPLES = """\b
Examples:
  he3 alarms                                  # the most urgent first
  he3 alarms --history                        # those that are over, too
  he3 alarms --recording runs/t1/mission.mcap --history
  he3 alarms acknowledge safe-mode
  he3 alarms shelve no-contact --for 2h --why "relay below the horizon"
  he3 alarms unshelve no-contact
"""

KINDS = ("stale", "low-energy", "blocked", "safe-mode", "no-contact", "mission-failed", "defect")
HEARTBEAT_WITHIN_S = 1.5
"""Wall time for the first heartbeats, which tell of messages that a process has failed upon."""

app = typer.Typer(rich_markup_mode=None, invoke_without_command=True, epilog=EXAMPLES)


def _kind(word: str) -> str:
    from he3.errors import InvalidInput

    if word.replace("_", "-") not in KINDS:
        raise InvalidInput(f"expected one of {', '.join(KINDS)}; got '{word[:80]}'")
    return word.replace("-", "_")


def _duration(text: str) -> str:
    from services.console.client.time_format import parse_duration_s

    parse_duration_s(text)
    return text


Kind = Annotated[
    str,
    typer.Argument(metavar="KIND", help=f"{', '.join(KINDS)}.", callback=checked(_kind), autocompletion=one_of(*KINDS)),
]
Why = Annotated[str, typer.Option("--why", metavar="TEXT", help="A note for the log.")]


@app.callback()
@with_flags
def alarms(
    session: Session,
    context: typer.Context,
    history: Annotated[bool, typer.Option("--history", help="Also show those that are over.")] = False,
    recording: Annotated[
        Path | None, typer.Option("--recording", metavar="FILE", help="Of a recorded mission instead of a running one.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Show the alarms, the most urgent first: severity, since when, and who has seen or shelved them."""
    if context.invoked_subcommand is not None:
        return
    if recording is not None:
        from services.console.report.alarm_history import recorded_alarms

        name, found = str(recording), recorded_alarms(recording)
    else:
        name, found = _of_mission(session)
    if json:
        typer.echo(_document(name, found))
        return
    lines = alarm_lines(found.current) + _shelved_lines(found)
    if history:
        lines += [
            "over, and acknowledged or raised again:",
            *(alarm_lines(tuple(reversed(found.history))) or ["  none"]),
        ]
    typer.echo("\n".join(lines or [f"mission '{name}': no alarms"]))


def _document(mission: str, found: Alarms) -> str:
    """The alarms as JSON text."""
    import json as json_format

    from services.console.client.alarms import documents

    shelved = [{"kind": kind, "until": until, "by": by} for kind, (until, by) in found.shelved.items()]
    document = {"mission": mission, "alarms": documents(found.current), "history": documents(found.history)}
    return json_format.dumps({**document, "shelved": shelved}, indent=2)


def _of_mission(session: Session) -> tuple[str, Alarms]:

    with session.join() as client:
        return client.mission, alarms_of(client, client.state())


def alarms_of(client: MissionClient, state: MissionState) -> Alarms:
    """The alarms of a running mission now. Raises PeerUnreachable if the ground does not answer."""
    from services.console.client.alarms import Alarms

    found = Alarms()
    found.past(client.log())
    give_up = time.monotonic() + HEARTBEAT_WITHIN_S
    while state.process_silent_s("ground") is None and time.monotonic() < give_up:
        state.changed.wait(0.1)
        state.changed.clear()
    clock = state.time
    found.look(state.status, state.link, clock.now(), clock.recent_rate, state.defect_report, state.report_period_s)
    return found


def _name(kind: str) -> str:
    """The kind as it is written on the command line and in the documents."""
    return kind.replace("_", "-")


def _shelved_lines(found: Alarms) -> list[str]:
    """One line for each kind that is shelved without an alarm: the next one of it will need no attention."""
    from services.console.client.time_format import utc

    raised = {alarm.kind for alarm in found.current}
    return [
        f"{'shelved':<9} {_name(kind):<15} until {utc(until, 0)} by {by}; no alarm now"
        for kind, (until, by) in found.shelved.items()
        if kind not in raised
    ]


def alarm_lines(found: Sequence[Alarm]) -> list[str]:
    """Alarms in aligned lines of plain text."""
    from services.console.client.time_format import utc

    lines = []
    for alarm in found:
        state = "active" if alarm.active else "over"
        again = f", {alarm.times} times" if alarm.times > 1 else ""
        ended = "" if alarm.ended_at is None else f" to {utc(alarm.ended_at, 0)}"
        lines.append(
            f"{alarm.severity.value:<9} {_name(alarm.kind):<15} {state:<7} {utc(alarm.raised_at, 0)}{ended}{again}  "
            f"{alarm.text}"
        )
        if alarm.acknowledged_at is not None:
            lines.append(f"{'':<10}acknowledged {utc(alarm.acknowledged_at, 0)} by {alarm.acknowledged_by}")
        if alarm.shelved_until is not None:
            lines.append(f"{'':<10}shelved until {utc(alarm.shelved_until, 0)} by {alarm.shelved_by}")
    return lines


@app.command(short_help="Note that you have seen an alarm.", epilog=EXAMPLES)
@with_flags
def acknowledge(
    session: NamedSession,
    kind: Kind,
    why: Why = "",
    json: AsJson = False,
) -> None:
    """Note that you have seen the alarm; it stays until its cause is gone."""

    with session.join() as client:
        _require(client, kind)
        _print(client, client.acknowledge_alarm(kind, why), json)


@app.command(epilog=EXAMPLES)
@with_flags
def shelve(
    session: NamedSession,
    kind: Kind,
    how_long: Annotated[
        str,
        typer.Option("--for", metavar="TIME", help="Mission time, such as 30min or 2h.", callback=checked(_duration)),
    ],
    why: Why = "",
    json: AsJson = False,
) -> None:
    """Let alarms of that kind need no attention for a time."""
    from services.console.client.time_format import parse_duration_s
    from services.mission.mission_time import seconds

    with session.join() as client:
        entry = client.shelve_alarm(kind, client.now() + seconds(parse_duration_s(how_long)), why)
        _print(client, entry, json)


@app.command(epilog=EXAMPLES)
@with_flags
def unshelve(
    session: NamedSession,
    kind: Kind,
    why: Why = "",
    json: AsJson = False,
) -> None:
    """Let a shelved alarm count again."""

    with session.join() as client:
        _print(client, client.unshelve_alarm(kind, why), json)


def _print(client: MissionClient, entry: LogEntry, json: bool) -> None:
    """Print the alarms as they are now as a JSON document, or what was done."""
    if json:
        typer.echo(_document(client.mission, alarms_of(client, client.state())))
    else:
        typer.echo(f"mission '{client.mission}': {entry.text}")


def _require(client: MissionClient, kind: str) -> None:
    """Raise He3Error unless there is an alarm of that kind."""
    from he3.errors import He3Error

    found = alarms_of(client, client.state())
    if not any(alarm.kind.value == kind for alarm in found.current):
        raise He3Error(f"mission '{client.mission}': there is no alarm {_name(kind)} to acknowledge")
