"""The store of a campaign: one SQLite file with a row for each task, which survives whatever ends the campaign.

A row is written in one transaction of its own (write-ahead log, synchronised): after a crash it is there as a whole or
not at all. Its key is the task's, so that no task has two rows.
"""

from __future__ import annotations

import json
import sqlite3
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from he3.errors import He3Error, InvalidInput
from services.console.campaign.task import DONE, FAILED, Reply, Task, canonical
from services.runtime.files.lock import FileLock, lock_beside

FORMAT: Final = "1"
IN_MEMORY: Final = Path(":memory:")
"""The path of a store that ends with its process, and leaves no file however that ends."""
_TABLES: Final = """
CREATE TABLE IF NOT EXISTS about (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS rows (
    number INTEGER PRIMARY KEY,
    key TEXT NOT NULL UNIQUE,
    status TEXT NOT NULL CHECK (status IN ('done', 'failed')),
    labels TEXT NOT NULL,
    result TEXT,
    error TEXT NOT NULL,
    attempts INTEGER NOT NULL,
    wall_s REAL NOT NULL,
    worker TEXT NOT NULL,
    written_at TEXT NOT NULL,
    work TEXT NOT NULL,
    software TEXT NOT NULL,
    arguments BLOB NOT NULL,
    current INTEGER NOT NULL DEFAULT 1
);
"""
_WRITE: Final = """
INSERT INTO rows (key, status, labels, result, error, attempts, wall_s, worker, written_at, work, software, arguments)
VALUES (:key, :status, :labels, :result, :error, 1, :wall_s, :worker, :written_at, :work, :software, :arguments)
ON CONFLICT (key) DO UPDATE SET status = :status, result = :result, error = :error, attempts = attempts + 1,
    wall_s = :wall_s, worker = :worker, written_at = :written_at WHERE status = 'failed'
"""


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the store."""

    key: str
    status: str
    """DONE or FAILED."""
    labels: Mapping[str, Any]
    result: Mapping[str, Any] | None
    error: str
    wall_s: float


_READ: Final = "key, status, labels, result, error, wall_s"


_OBJECTS: Final = ("parameters", "settings")
"""Labels that are objects themselves."""


def _row(found: tuple[Any, ...]) -> Row:
    """The row; raises ValueError unless its columns have what a campaign writes."""
    key, status, labels_text, result_text, error, wall_s = found
    labels = _object(labels_text)
    for name in _OBJECTS:
        if not isinstance(labels.get(name, {}), dict):
            raise ValueError(f"{name}: expected an object")
    result = None if result_text is None else _object(result_text)
    if not (isinstance(key, str) and isinstance(error, str) and isinstance(wall_s, float)):
        raise ValueError("expected texts and a number")
    return Row(key, status, labels, result, error, wall_s)


def _object(text: Any) -> dict[str, Any]:
    """The JSON object of that text; raises ValueError for anything else."""
    try:
        found = json.loads(text, parse_constant=_no_number) if isinstance(text, str) else None
    except RecursionError:
        found = None
    if not isinstance(found, dict):
        raise ValueError("expected a JSON object")
    return found


def _no_number(name: str) -> Any:
    raise ValueError(f"expected a number, got {name}")


def _values(task: Task, reply: Reply) -> dict[str, Any]:
    if reply.status not in (DONE, FAILED):
        raise ValueError(f"expected a reply of a task that was computed, got {reply.status}")
    return {
        "key": task.key,
        "status": reply.status,
        "labels": canonical(task.labels),
        "result": None if reply.result is None else canonical(reply.result),
        "error": reply.error,
        "wall_s": reply.wall_s,
        "worker": reply.worker,
        "written_at": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "work": task.work,
        "software": task.software,
        "arguments": zlib.compress(canonical(task.arguments).encode()),
    }


class Store:
    """A store that is open; use it in a `with` statement."""

    def __init__(self, path: Path, *, write: bool) -> None:
        """path: the file, or IN_MEMORY. write: make it if it does not exist, and lock it; else it is read, also while a
        campaign writes it.

        Raises InvalidInput for a file that is no store, or one that another process writes; He3Error if it cannot be
        opened.
        """
        self._path = path
        self._lock: FileLock | None = None
        if write and path != IN_MEMORY:
            self._lock = lock_beside(path, f"{path}: expected a store that no other campaign writes")
        elif not write and not path.is_file():
            raise InvalidInput(f"{path}: expected a campaign's store, got no such file")
        try:
            with self._told():
                self._database = sqlite3.connect(path, isolation_level=None)
                if write:
                    self._database.execute("PRAGMA journal_mode = WAL")
                    self._database.executescript(_TABLES)
                    self._database.execute("INSERT OR IGNORE INTO about VALUES ('format', ?)", (FORMAT,))
                self._expect_tables()
                found = self.about("format")
            if found != FORMAT:
                raise InvalidInput(f"{path}: expected a store of format {FORMAT}, got {found!r}")
        except BaseException:
            self.close()
            raise

    def _expect_tables(self) -> None:
        """Raise InvalidInput for views in place of tables: a query of one may never end."""
        query = "SELECT name FROM sqlite_master WHERE lower(name) IN ('about', 'rows') AND type != 'table'"
        if self._database.execute(query).fetchone() is not None:
            raise InvalidInput(f"{self._path}: expected a campaign's store, got views in place of its tables")

    def about(self, name: str) -> str:
        """A fact about the store, such as the name of its study; empty if it has none."""
        found = self._database.execute("SELECT value FROM about WHERE name = ?", (name,)).fetchone()
        return "" if found is None else str(found[0])

    def describe(self, **facts: str) -> None:
        """Write facts about the store."""
        with self._told():
            self._database.executemany("INSERT OR REPLACE INTO about VALUES (?, ?)", facts.items())

    def begin(self, tasks: Iterable[Task]) -> dict[str, str]:
        """Make these tasks the store's current ones, which the report is about; returns the status of those with a row.

        Rows of other tasks stay in the store: of a study as it was before a change, or of other software.
        """
        with self._told():
            self._database.execute("BEGIN IMMEDIATE")
            known = dict(self._database.execute("SELECT key, status FROM rows"))
            self._database.execute("UPDATE rows SET current = 0")
            found = {task.key: task for task in tasks if task.key in known}
            self._database.executemany(
                "UPDATE rows SET current = 1, labels = ? WHERE key = ?",
                ((canonical(task.labels), key) for key, task in found.items()),
            )
            self._database.execute("COMMIT")
        return {key: known[key] for key in found}

    def write(self, task: Task, reply: Reply) -> None:
        """Write the row of that task, durably. A row with a result is never replaced, one with an error is."""
        with self._told():
            if not self._database.execute(_WRITE, _values(task, reply)).rowcount:
                self._database.execute("UPDATE rows SET attempts = attempts + 1 WHERE key = ?", (task.key,))

    def write_all(self, rows: Iterable[tuple[Task, Reply]]) -> None:
        """Write many rows in one transaction."""
        with self._told():
            self._database.execute("BEGIN IMMEDIATE")
            self._database.executemany(_WRITE, (_values(task, reply) for task, reply in rows))
            self._database.execute("COMMIT")

    def rows(self) -> Iterator[Row]:
        """Every current row, in the order of the keys, which does not depend on the order of computing."""
        with self._told():
            for found in self._database.execute(f"SELECT {_READ} FROM rows WHERE current = 1 ORDER BY key"):
                yield self._checked(found)

    def row(self, key: str) -> Row | None:
        """The row of that key; None if there is none."""
        with self._told():
            found = self._database.execute(f"SELECT {_READ} FROM rows WHERE key = ?", (key,)).fetchone()
        return None if found is None else self._checked(found)

    def _checked(self, found: tuple[Any, ...]) -> Row:
        try:
            return _row(found)
        except ValueError:
            raise InvalidInput(
                f"{self._path}: expected rows that a campaign has written, got another under {str(found[0])[:80]!r}"
            ) from None

    @property
    def others(self) -> int:
        """Number of rows that are not current."""
        with self._told():
            return int(self._database.execute("SELECT count(*) FROM rows WHERE current = 0").fetchone()[0])

    @property
    def rewritten(self) -> int:
        """Number of current rows whose task was computed more than once to its end."""
        with self._told():
            query = "SELECT count(*) FROM rows WHERE current = 1 AND attempts > 1"
            return int(self._database.execute(query).fetchone()[0])

    def close(self) -> None:
        """Close the file and let others write it."""
        database = getattr(self, "_database", None)
        if database is not None:
            database.close()
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Within this context an error of SQLite is raised as He3Error, or InvalidInput for a file of another kind."""
        try:
            yield
        except sqlite3.DatabaseError as error:
            if isinstance(error, sqlite3.OperationalError) and "no such table" not in str(error):
                raise He3Error(f"{self._path}: cannot use the store: {error}") from None
            raise InvalidInput(f"{self._path}: expected a campaign's store, got: {error}") from None
