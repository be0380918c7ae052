"""The operators' log as lines: everything in the order in which it was known, filtered, and as a table."""

from __future__ import annotations

import csv
import io

from schemas.commands import CommandKind, CommandReport, CommandStage, CommandStatus, Telecommand
from schemas.link import LinkEvent
from schemas.mission_log import AlarmKind, HeardEvent, LogEntry, LogKind, MissionLog
from schemas.telemetry import EventKind, RoverEvent
from services.console.client.alarms import Alarm, Severity
from services.console.client.log_lines import LogLine, as_csv, chosen, documents, log_lines

EVENT = RoverEvent(kind=EventKind.BLOCKED, at=5, x_m=1.0, y_m=2.0, round=3, detail="a hollow")
LOG = MissionLog(
    events=(HeardEvent(event=EVENT, received_at=20),),
    entries=(LogEntry(number=0, at=15, kind=LogKind.INTEREST, text="=area", by="anna"),),
)
COMMAND = CommandStatus(
    command=Telecommand(command_id="op-1", kind=CommandKind.GO_TO, target_m=(1.0, 2.0), issued_by="ben"),
    stages=tuple(
        CommandReport(command_id="op-1", stage=stage, at=at, why=why)
        for stage, at, why in ((CommandStage.QUEUED, 12, ""), (CommandStage.FAILED, 30, "no way"))
    ),
)
LINK = (LinkEvent(at=10, contact=True), LinkEvent(at=11, contact=True, what="loss 0.1", by="carl"))
ALARM = Alarm(AlarmKind.BLOCKED, Severity.WARNING, 5, "it is blocked", active=False, ended_at=40)


def lines() -> list[LogLine]:
    return log_lines(LOG, [COMMAND], LINK, [ALARM])


def test_all_that_happened_is_in_the_order_in_which_it_was_known_on_earth() -> None:
    assert [(line.known_at, line.kind, line.name) for line in lines()] == [
        (5, "alarm", "blocked raised"),
        (10, "link", "contact"),
        (11, "link", "changed"),
        (12, "command", "queued"),
        (15, "interest", "interest"),
        (20, "event", "blocked"),
        (30, "command", "failed"),
        (40, "alarm", "blocked over"),
    ]
    assert [line.by for line in lines() if line.by] == ["carl", "ben (unverified)", "anna", "ben (unverified)"]


def test_lines_are_chosen_by_kind_time_and_text() -> None:
    assert [line.text for line in chosen(lines(), kinds=["command"])] == ["go-to op-1", "go-to op-1: no way"]
    assert [line.known_at for line in chosen(lines(), since=15)] == [15, 30, 40]
    assert [line.kind for line in chosen(lines(), text="CARL")] == ["link"]


def test_a_table_has_every_line_and_no_text_that_a_spreadsheet_takes_for_a_formula() -> None:
    rows = list(csv.DictReader(io.StringIO(as_csv(lines()))))
    assert len(rows) == len(lines())
    assert [row["text"] for row in rows if row["kind"] == "interest"] == ["'=area"]
    assert rows[0]["at_utc"] == documents(lines())[0]["at_utc"] == "1970-01-01T00:00:00.000Z"
