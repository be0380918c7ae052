"""The audit log: who did what, in lines that only ever get added, each with the hash of the one before.

Each line is a JSON object. `previous` is the SHA-256 of the line before it, so a line that is altered, taken out or put
in breaks the chain. Where the writer has an identity, each line is signed, so the rest of a file cannot be written anew
either. What no file can show by itself is that its end was cut off: for that, compare the head (the hash of the last
line) with one that was kept elsewhere.

A process that is killed while it writes leaves a torn last line. The next start names that line's hash and goes on, so
a torn line is told apart from tampering.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from cryptography.exceptions import InvalidSignature

from he3.errors import He3Error, InvalidInput
from schemas.roles import PROCESS_ROLES
from schemas.wire import printable
from services.runtime.files.lock import FileLock, lock_beside
from services.runtime.files.output import failed, open_output, require_own
from services.runtime.trust.certificates import parse_common_name

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    from services.runtime.trust.signing import Key

BEGINNING: Final = "0" * 64
"""`previous` of the first line."""
MAX_LINE_BYTES: Final = 16_384
MAX_TEXT: Final = 1_000
MAX_WHAT: Final = 12_000
"""Characters of what was changed or ordered, as JSON writes them: a preset, some hundred contact windows, a polygon."""
_MOST: Final = {"what": MAX_WHAT, "order": MAX_WHAT}
_PURPOSE = b"he3 audit 1\n"
"""Prefix of the signed bytes, so that no other signature of a key counts as a line's."""


class AuditKind(StrEnum):
    """What a line is about."""

    OPENED = "opened"
    """The writer has started; `torn` is the hash of what a killed one left unfinished."""
    COMMAND = "command"
    CHANGE = "change"
    """Of the link, the clock, or an area of interest."""
    REFUSAL = "refusal"
    AUTHORITY = "authority"
    """Command authority was taken or released."""


def line_hash(line: bytes) -> str:
    """SHA-256 of a line without its newline, in hexadecimal."""
    return hashlib.sha256(line).hexdigest()


def audit_line(
    number: int,
    previous: str,
    kind: AuditKind,
    written_at: datetime,
    fields: dict[str, Any],
    signer: tuple[str, Key] | None = None,
) -> bytes:
    """A line, without its newline. written_at: wall time. fields: the rest, such as `by`; long texts are cut."""
    row: dict[str, Any] = {
        "number": number,
        "previous": previous,
        "written_at": written_at.isoformat(timespec="milliseconds"),
        "kind": kind.value,
        **{
            key: printable(value[: _MOST.get(key, MAX_TEXT)]) if isinstance(value, str) else value
            for key, value in fields.items()
            if value is not None
        },
    }
    if signer is not None:
        row["signer"] = signer[0]
        row["signature"] = signer[1].sign(_PURPOSE + _bytes(row)).hex()
    return _bytes(row)


def _bytes(row: dict[str, Any]) -> bytes:
    return json.dumps(row, separators=(",", ":")).encode()


# --- verified -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class AuditVerdict:
    """What is known of an audit log."""

    lines: int
    """Whole lines before the first fault, or all."""
    head: str
    """Hash of the last of them."""
    signed: int
    """How many of them have a signature that was verified."""
    torn: tuple[int, ...] = ()
    """Numbers of the file's lines, from 1, that a killed process left unfinished."""
    fault: str | None = None
    """The first line that is altered or missing; None if there is none."""
    rest: bytes = b""
    """What a killed process left unfinished at the end."""
    signers: tuple[str, ...] = ()
    """Common names of the identities whose signatures were verified: of one process, with a revocation in between of
    several generations."""


def verify(lines: Iterable[bytes], key_of: Callable[[str], Ed25519PublicKey | None] | None = None) -> AuditVerdict:
    """The verdict on an audit log. lines: with their newlines, as a file gives them.

    key_of: the key of a signer, None for one that is not known. With it, every line must be signed, and by the identity
    of one process: else a person with any identity of the mission could write the log anew.
    """
    given = list(lines)
    previous, count, signed = BEGINNING, 0, 0
    torn: list[int] = []
    open_: list[tuple[int, bytes]] = []
    signers: dict[str, None] = {}

    def ended(fault: str | None = None, rest: bytes = b"") -> AuditVerdict:
        return AuditVerdict(count, previous, signed, tuple(torn), fault, rest, tuple(signers))

    for place, raw in enumerate(given, start=1):
        line = raw.removesuffix(b"\n")
        row = _row(line)
        if row is None:
            if not _begins_like(line, count, previous):
                return ended(
                    f"line {place}: altered: it is not the next line of an audit log, nor the beginning of one"
                )
            open_.append((place, line))
            continue
        if open_:
            if row["kind"] != AuditKind.OPENED or row.get("torn") != _torn_hash(open_):
                return ended(f"line {open_[0][0]}: altered: it is cut, and no start of the writer names it")
            torn += [each for each, _ in open_]
            open_ = []
        if row["number"] != count:
            return ended(_out_of_order(place, count, row["number"]))
        if key_of is not None:
            if (why := _unsigned(row, key_of) or _of_another(row["signer"], signers)) is not None:
                return ended(f"line {place}: {why}")
            signers[row["signer"]] = None
        if row["previous"] != previous:
            return ended(_broken(place, line, given[place:]))
        signed += key_of is not None
        previous, count = line_hash(line), count + 1
    if open_ and given[-1].endswith(b"\n"):
        return ended(f"line {open_[0][0]}: altered: it is cut, and no start of the writer names it")
    torn += [each for each, _ in open_]
    return ended(rest=b"\n".join(line for _, line in open_))


def _begins_like(line: bytes, number: int, previous: str) -> bool:
    """Whether that is the beginning of the line that comes next, as a killed process leaves it."""
    expected = b'{"number":%d,"previous":"%b",' % (number, previous.encode())
    return line.startswith(expected) or expected.startswith(line)


def _torn_hash(lines: list[tuple[int, bytes]]) -> str:
    return line_hash(b"\n".join(line for _, line in lines))


def _broken(place: int, line: bytes, following: list[bytes]) -> str:
    """The fault where a line does not follow from the one before: the line after it tells which of the two it is."""
    if place == 1:
        return "line 1: altered, or lines before it are missing"
    after = _row(following[0].removesuffix(b"\n")) if following else None
    if after is None:
        return f"line {place - 1} or {place}: altered"
    return f"line {place - 1 if after['previous'] == line_hash(line) else place}: altered"


def _row(line: bytes) -> dict[str, Any] | None:
    """The line's object; None for one that is not exactly as `audit_line` writes it."""
    try:
        row = json.loads(line)
        whole = (
            isinstance(row, dict)
            and type(row["number"]) is int
            and isinstance(row["previous"], str)
            and row["kind"] in set(AuditKind)
            and _bytes(row) == line
        )
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return row if whole else None


def _out_of_order(place: int, expected: int, number: int) -> str:
    if number > expected:
        return f"line {place}: {number - expected} missing before it (expected number {expected}, got {number})"
    return f"line {place}: out of place (expected number {expected}, got {number})"


def _unsigned(row: dict[str, Any], key_of: Callable[[str], Ed25519PublicKey | None]) -> str | None:
    """Why the line's signature does not count; None if it does."""
    signer, signature = row.get("signer"), row.get("signature")
    if not isinstance(signer, str) or not isinstance(signature, str):
        return "not signed"
    key = key_of(signer)
    if key is None:
        return f"signed by '{printable(signer)[:80]}', who is not in the roster"
    rest = {name: value for name, value in row.items() if name != "signature"}
    try:
        key.verify(bytes.fromhex(signature), _PURPOSE + _bytes(rest))
    except (InvalidSignature, ValueError):
        return f"altered: the signature of {signer} is of another line"
    return None


def _of_another(signer: str, before: Iterable[str]) -> str | None:
    """Why a line of that signer does not belong in a log whose lines so far are of these; None if it does."""
    role = parse_common_name(signer).role
    if role not in PROCESS_ROLES:
        return f"signed by {signer}: expected a process, as no person writes audit logs"
    writer = next(iter(before), signer)
    if role is not parse_common_name(writer).role:
        return f"signed by {signer}: expected {writer}, who has signed the lines before it"
    return None


def file_lines(path: Path) -> Iterator[bytes]:
    """The lines of that file; a longer one than this system writes comes in pieces.

    Raises InvalidInput for a file that cannot be read, and for a device, which may never end.
    """
    try:
        with path.open("rb") as file:
            if stat.S_ISCHR(os.fstat(file.fileno()).st_mode):
                raise InvalidInput(f"{path}: expected an audit log, got a device")
            while line := file.readline(MAX_LINE_BYTES):
                yield line
    except OSError as error:
        raise InvalidInput(f"{path}: cannot read: {error.strerror}") from None


def rows(lines: Iterable[bytes]) -> Iterator[dict[str, Any]]:
    """The objects of the lines that are whole, verified or not."""
    for line in lines:
        row = _row(line.removesuffix(b"\n"))
        if row is not None:
            yield row


# --- written ------------------------------------------------------------------------------------------------------


class AuditLog:
    """Adds lines to one file, of mode 0600. Use it from one thread."""

    def __init__(self, path: Path, wall_time: Callable[[], datetime], signer: tuple[str, Key] | None = None) -> None:
        """Continue that file, or begin it. signer: common name and key, to sign each line.

        Raises InvalidInput for a file that another process writes or whose chain is broken, He3Error if it cannot be
        written.
        """
        self.path = path
        self._wall_time = wall_time
        self._signer = signer
        self._lock: FileLock = lock_beside(path, f"{path}: expected an audit log that no other process writes")
        try:
            self._open()
        except BaseException:
            self._lock.release()
            raise

    def _open(self) -> None:
        verdict = _continue_from(self.path)
        self._number, self.head = verdict.lines, verdict.head
        try:
            self._file = open_output(self.path, append=True, buffering=0)
            require_own(os.fstat(self._file.fileno()), self.path)
            ends_a_line = self.path.stat().st_size == 0 or _last_byte(self.path) == b"\n"
        except OSError as error:
            raise failed(f"{self.path}: cannot write", error) from None
        self._before = b"" if ends_a_line else b"\n"  # written with the next line, in one piece
        self.add(AuditKind.OPENED, torn=line_hash(verdict.rest) if verdict.rest else None, process=os.getpid())

    def add(self, kind: AuditKind, **fields: Any) -> None:
        """Add a line; it is on the disk when this returns. Raises He3Error if it cannot be written."""
        line = audit_line(self._number, self.head, kind, self._wall_time(), fields, self._signer)
        self._write(self._before + line + b"\n")
        self._before = b""
        self._number, self.head = self._number + 1, line_hash(line)

    def _write(self, content: bytes) -> None:
        """Write the content whole, or nothing of it: a line that follows later must not stand behind a part of one.

        A file that was deleted is no place for it: its lines would be on the disk, and no program could open them.
        """
        found = os.fstat(self._file.fileno())
        if not found.st_nlink:
            raise He3Error(f"{self.path}: it was deleted while this process wrote it")
        whole = found.st_size
        try:
            while content:
                content = content[self._file.write(content) or 0 :]
            os.fsync(self._file.fileno())
        except OSError as error:
            os.ftruncate(self._file.fileno(), whole)
            raise He3Error(f"{self.path}: cannot write: {error.strerror}") from None

    def close(self) -> None:
        self._file.close()
        self._lock.release()


def _continue_from(path: Path) -> AuditVerdict:
    """The verdict on that file, or on an empty one if there is none.

    Raises InvalidInput if the chain is broken: a log that was tampered with is set aside by a person, not continued.
    """
    verdict = verify(file_lines(path)) if path.exists() else AuditVerdict(0, BEGINNING, 0)
    if verdict.fault is not None:
        raise InvalidInput(f"{path}: {verdict.fault}; expected an audit log whose chain is whole")
    return verdict


def _last_byte(path: Path) -> bytes:
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1)
