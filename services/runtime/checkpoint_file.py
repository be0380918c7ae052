"""A checkpoint on disk: the state of a node, and the place in its journal to which it belongs.

The file holds a CRC-32 of what follows (4 bytes, little endian), the length of the head (8 bytes), the head (JSON) and
the state as the state codec wrote it. It replaces its predecessor in one step. A checkpoint only saves time. It is
ignored if it is damaged, of another mission, or of another version of the program. One that is ahead of the journal
shows that the journal has lost what it held: that is damage.
"""

from __future__ import annotations

import hashlib
import json
import sys
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Final

from he3.errors import InvalidInput
from services.runtime.files.input import open_own
from services.runtime.files.output import replace_output

CRC_BYTES: Final = 4


class JournalDamaged(InvalidInput):
    """A journal is damaged: more is wrong than the unfinished last record of a process that ended.

    It is bad input: no restart mends it.
    """


_LENGTH_BYTES: Final = 8


@dataclass(frozen=True, slots=True)
class Mark:
    """A place in a journal file between two records."""

    offset: int = 0
    channels: dict[int, str] = field(default_factory=dict)
    """MCAP channels registered before this place: number and name."""
    records: int = 0
    """Inputs before it."""


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """An encoded state, and where in the journals it belongs."""

    file: str
    mark: Mark
    starts: int
    """How often the node had been started."""
    state: bytes


def write_checkpoint(path: Path, identity: Mapping[str, str], checkpoint: Checkpoint) -> None:
    """Replace the checkpoint file in one step; a reader finds the old one or the new one."""
    head = {
        "identity": dict(identity),
        "program": program_digest(),
        "file": checkpoint.file,
        "offset": checkpoint.mark.offset,
        "records": checkpoint.mark.records,
        "channels": [[number, name] for number, name in checkpoint.mark.channels.items()],
        "starts": checkpoint.starts,
    }
    text = json.dumps(head).encode()
    content = b"".join((len(text).to_bytes(_LENGTH_BYTES, "little"), text, checkpoint.state))
    replace_output(path, zlib.crc32(content).to_bytes(CRC_BYTES, "little") + content)


class CheckpointKeeper:
    """Replaces a checkpoint file. One that cannot be written is reported once, until one is written again.

    The journal alone is the history then, so nothing is lost, and the restart after it takes longer.
    """

    def __init__(self, path: Path, identity: Mapping[str, str], report: Callable[[str], None]) -> None:
        """report: is given one line when writing begins to fail, and one when it succeeds again."""
        self._path = path
        self._identity = identity
        self._report = report
        self._failed = 0

    def keep(self, checkpoint: Checkpoint) -> None:
        """Write the checkpoint, if the system lets it be written."""
        try:
            write_checkpoint(self._path, self._identity, checkpoint)
        except OSError as error:
            self._failed += 1
            if self._failed == 1:
                self._report(
                    f"{self._path}: cannot write the checkpoint: {error.strerror or type(error).__name__}; "
                    "the journal goes on without it, so a restart takes longer"
                )
            return
        if self._failed:
            self._report(f"{self._path}: the checkpoint is written again; {self._failed} before it were not")
            self._failed = 0


def read_checkpoint(path: Path, identity: Mapping[str, str], journal_sizes: Mapping[str, int]) -> Checkpoint | str:
    """The checkpoint, or one line on why it cannot be used. journal_sizes: bytes of each journal file, by name.

    Raises JournalDamaged for a journal that is shorter than it was: the checkpoint was written after the journal.
    """
    with open_own(path) as stream:
        sealed = stream.read()
    content = sealed[CRC_BYTES:]
    if zlib.crc32(content) != int.from_bytes(sealed[:CRC_BYTES], "little"):
        return "it is damaged"
    begin = _LENGTH_BYTES + int.from_bytes(content[:_LENGTH_BYTES], "little")
    try:
        head = json.loads(content[_LENGTH_BYTES:begin])
        channels = {int(number): str(name) for number, name in head["channels"]}
        mark = Mark(int(head["offset"]), channels, int(head["records"]))
        checkpoint = Checkpoint(str(head["file"]), mark, int(head["starts"]), content[begin:])
        whose, program = head["identity"], head["program"]
    except (ValueError, KeyError, TypeError):
        return "it is no checkpoint of this program"
    if whose != dict(identity):
        return "it is of another mission"
    size = journal_sizes.get(checkpoint.file, 0)
    if size < mark.offset:
        raise JournalDamaged(
            f"{path}: expected at least {mark.offset} bytes in {checkpoint.file}, got {size}: "
            "inputs that were handled are missing"
        )
    if program != program_digest():
        return "it was written by another version of the program"
    return checkpoint


@cache
def program_digest() -> str:
    """A digest of this program's files; a checkpoint is valid only for the same files."""
    root = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256(sys.version.encode())
    for package in ("he3", "schemas", "services"):
        for path in sorted((root / package).rglob("*.py")):
            status = path.stat()
            digest.update(f"{path.relative_to(root)} {status.st_size} {status.st_mtime_ns}\n".encode())
    return digest.hexdigest()
