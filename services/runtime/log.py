"""Structured log lines on standard error: wall time, mission time, process, level, text, fields."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, TextIO

from schemas.wire import printable
from services.mission.mission_time import SECOND, MissionTime
from services.runtime.node import Level, LogRecord

ORDER = {Level.DEBUG: 0, Level.INFO: 1, Level.WARNING: 2, Level.ERROR: 3}


class Log:
    """Writes one line for each log record, as text or as JSON. Safe to use from several threads."""

    def __init__(
        self,
        name: str,
        mission_time: Callable[[], MissionTime | None],
        least: Level = Level.INFO,
        as_json: bool = False,
        stream: TextIO | None = None,
    ) -> None:
        self._name = name
        self._mission_time = mission_time
        self._least = ORDER[least]
        self._as_json = as_json
        self._stream = stream or sys.stderr
        self._lock = threading.Lock()

    def write(self, record: LogRecord, now: MissionTime | None = None) -> None:
        """Write the record, with the given mission time or the present one."""
        if ORDER[record.level] < self._least:
            return
        mission_ns = now if now is not None else self._mission_time()
        wall = datetime.now(UTC)
        line = self._json(record, wall, mission_ns) if self._as_json else self._text(record, wall, mission_ns)
        with self._lock:
            try:
                self._stream.write(line + "\n")
                self._stream.flush()
            except (OSError, ValueError):
                return  # the reader is gone or the disk is full: a service does not end because of its log

    def info(self, text: str, **fields: Any) -> None:
        self.write(LogRecord(Level.INFO, text, fields))

    def warning(self, text: str, **fields: Any) -> None:
        self.write(LogRecord(Level.WARNING, text, fields))

    def error(self, text: str, **fields: Any) -> None:
        self.write(LogRecord(Level.ERROR, text, fields))

    def _json(self, record: LogRecord, wall: datetime, mission_ns: MissionTime | None) -> str:
        head = {"wall": wall.isoformat(timespec="milliseconds"), "mission_ns": mission_ns, "service": self._name}
        return json.dumps({**head, "level": record.level.value, "text": record.text, **record.fields}, default=str)

    def _text(self, record: LogRecord, wall: datetime, mission_ns: MissionTime | None) -> str:
        mission = "-" * 19 if mission_ns is None else datetime.fromtimestamp(mission_ns / SECOND, UTC).isoformat()[:19]
        fields = "".join(f" {name}={value}" for name, value in record.fields.items())
        head = f"{wall:%H:%M:%S.%f}"[:12]
        return f"{head} {mission} {self._name:<8} {record.level.value:<7} {printable(record.text + fields)}"
