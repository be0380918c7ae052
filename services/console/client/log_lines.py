"""The operators' log as one list of lines: events, commands, plans, the link, interests, authority and alarms."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

from schemas.mission_log import LogKind
from services.console.client.time_format import utc

if TYPE_CHECKING:
    from schemas.commands import CommandStatus
    from schemas.link import LinkEvent
    from schemas.mission_log import MissionLog
    from services.console.client.alarms import Alarm
    from services.mission.mission_time import MissionTime

EVENT, COMMAND, LINK, ALARM = "event", "command", "link", "alarm"
KINDS = (EVENT, COMMAND, LINK, ALARM, *(kind.value for kind in LogKind if kind is not LogKind.ALARM))
"""Kinds of lines; `alarm` are those raised and ended as well as what people did about them."""


@dataclass(frozen=True, slots=True)
class LogLine:
    """One line of the log."""

    at: MissionTime
    """When it happened."""
    known_at: MissionTime
    """When it was known on Earth."""
    kind: str
    """One of ``KINDS``."""
    name: str
    """What happened, such as the kind of the event or the stage of the command."""
    text: str
    by: str = ""


def log_lines(
    log: MissionLog, commands: Iterable[CommandStatus], link: Iterable[LinkEvent], alarms: Iterable[Alarm]
) -> list[LogLine]:
    """All lines, in the order in which they were known on Earth."""
    lines = [
        LogLine(heard.event.at, heard.received_at, EVENT, heard.event.kind.value, _event(heard.event))
        for heard in log.events
    ]
    lines += [
        LogLine(entry.at, entry.at, entry.kind.value, entry.kind.value, entry.text, entry.by) for entry in log.entries
    ]
    for status in commands:
        command = status.command
        about = f"{command.kind.value.replace('_', '-')} {command.command_id}"
        for report in status.stages:
            text = f"{about}{': ' + report.why if report.why else ''}"
            lines.append(LogLine(report.at, report.at, COMMAND, report.stage.value, text, command.by))
    for change in link:
        name = "changed" if change.what else "contact" if change.contact else "no contact"
        text = change.what or ("contact with the Moon" if change.contact else "no contact with the Moon")
        lines.append(LogLine(change.at, change.at, LINK, name, text, change.by))
    for alarm in alarms:
        lines.append(LogLine(alarm.raised_at, alarm.raised_at, ALARM, f"{alarm.kind.value} raised", alarm.text))
        if alarm.ended_at is not None:
            lines.append(LogLine(alarm.ended_at, alarm.ended_at, ALARM, f"{alarm.kind.value} over", alarm.text))
    return sorted(lines, key=lambda line: (line.known_at, line.at))


def _event(event: Any) -> str:
    parts = [f"round {event.round}" if event.round else "", event.sample_id or ""]
    parts += [f"({event.x_m:.1f}, {event.y_m:.1f}) m", event.detail]
    return ", ".join(part for part in parts if part)


def chosen(
    lines: Iterable[LogLine], kinds: Sequence[str] = (), since: MissionTime | None = None, text: str = ""
) -> list[LogLine]:
    """The lines of these kinds (none: all) that happened since then and contain that text, in any case."""
    wanted = text.casefold()
    return [
        line
        for line in lines
        if (not kinds or line.kind in kinds)
        and (since is None or line.at >= since)
        and wanted in f"{line.kind} {line.name} {line.text} {line.by}".casefold()
    ]


def documents(lines: Iterable[LogLine]) -> list[dict[str, Any]]:
    """The lines as JSON values, with times as ISO 8601 beside those in nanoseconds."""
    return [{**asdict(line), "at_utc": utc(line.at), "known_at_utc": utc(line.known_at)} for line in lines]


def as_csv(lines: Iterable[LogLine]) -> str:
    """The lines as comma-separated values with a head."""
    names = [*(each.name for each in fields(LogLine)), "at_utc", "known_at_utc"]
    text = io.StringIO()
    table = csv.DictWriter(text, names, lineterminator="\n")
    table.writeheader()
    for document in documents(lines):
        # A spreadsheet takes a text that begins so for a formula.
        table.writerow(
            {key: f"'{value}" if str(value)[:1] in ("=", "+", "-", "@") else value for key, value in document.items()}
        )
    return text.getvalue()
