"""A process's journal: every input of its node, kept before it is handled, in MCAP files.

Each start of a process writes a file of its own, ``NAME-0001.mcap``, ``NAME-0002.mcap``, ...; together, in order, they
are the node's history. Each record is on the disk before the node sees what it holds, so neither the end of the process
nor a power failure loses what was acted on. A file may end in the middle of a record: that tail was never handled; it
is ignored and reported. Anything else that is wrong is damage: what lies behind it was handled, so no node starts
without it. Beside the files may lie a checkpoint, ``NAME.checkpoint``, so that a restart handles only the later inputs
again.

SQLite in WAL mode is not used, because it does not notice damage. [measured: ext4, 2 cores, records of 1 kB]

- Without a sync an append takes 6 us to MCAP and 13 us to SQLite (synchronous=NORMAL), and a power failure loses what
  the system had not written yet. With a sync for each batch of inputs both take what the disk takes.
- A file that is cut off loses the unfinished record in both.
- MCAP reports a changed byte, wherever it is. In SQLite, one changed bit in the WAL ended the history at that place (28
  of 60 records were left), and one in the database returned a wrong record, both without an error.
- An MCAP file is read by the tools that read recordings; it is not finished, so they read it as a stream.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from io import SEEK_END, BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Metadata
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from he3.errors import He3Error, InvalidInput
from services.runtime.checkpoint_file import (
    CRC_BYTES,
    Checkpoint,
    CheckpointKeeper,
    JournalDamaged,
    Mark,
    read_checkpoint,
)
from services.runtime.files.input import open_own
from services.runtime.files.output import failed, open_output, sync_folder
from services.runtime.input_codec import decode_input, encode_input
from services.runtime.inputs import Input, ProcessStarted

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime
    from services.mission.scenario import Scenario
    from services.runtime.node import SavedState
    from services.runtime.state_codec import StateCodec

PROFILE: Final = "he3-journal"
FORMAT: Final = "2"
"""Format of the records; a journal of another format is refused."""


_FRAME: Final = struct.Struct("<BQ")  # operation code and length of an MCAP record
_MESSAGE: Final = struct.Struct("<HIQQ")  # channel, sequence, log time and publish time of an MCAP message
_LONGEST_BEGINNING: Final = 4096
"""Bytes before the first input, at most: who wrote the journal, and of which mission."""
_ANEW: Final = "name another folder to begin anew"

_Parsed = TypeVar("_Parsed")


@dataclass(frozen=True, slots=True)
class History:
    """The content of a node's journals."""

    inputs: tuple[tuple[MissionTime, Input], ...]
    starts: int
    """How often the node has been started."""
    torn_bytes: int
    """Length of the unfinished tails that were ignored."""
    state: SavedState | None = None
    """State from a checkpoint, after everything before `inputs`; None: `inputs` hold the whole history."""
    notice: str = ""
    """One line on why a checkpoint was ignored."""


@dataclass(frozen=True, slots=True)
class Record:
    """An input as the journal keeps it."""

    now: MissionTime
    channel: str
    data: bytes


Keep = Callable[[Mark, int, bytes], None]
"""Called with a place in the journal, the starts since it began, and the encoded state that belongs there."""


class JournalWriter:
    """Appends inputs to a stream, as MCAP; what a call has written is on the disk when it returns."""

    def __init__(
        self,
        stream: IO[bytes],
        identity: dict[str, str],
        codec: StateCodec,
        keep: Keep = lambda *_: None,
        where: str = "journal",
        is_there: Callable[[], bool] = lambda: True,
        sync: Callable[[], None] = lambda: None,
    ) -> None:
        """keep: called with each checkpoint. where: the file, for the line of an error. is_there: whether the file has
        a name still, so that the next start finds it. sync: makes what was flushed safe from a power failure.
        """
        self._sync = sync
        self._is_there = is_there
        self._stream = stream
        self._where = where
        self._codec = codec
        self._keep = keep
        self._starts = 0
        self._writer = Writer(stream, use_chunking=False, compression=CompressionType.NONE)
        self._writer.start(profile=PROFILE)
        self._writer.add_metadata(PROFILE, {**identity, "format": FORMAT})
        self._channels: dict[str, int] = {}
        self._count = 0

    def append(self, now: MissionTime, inputs: Sequence[Input]) -> None:
        """Write inputs that are about to be handled at that time.

        Raises He3Error if the system refuses, InvalidInput if the file was deleted: what no start will find in the
        journal must not be handled.
        """
        try:
            self._write(now, inputs)
            self._sync()
            if self._is_there():
                return
        except OSError as error:
            raise He3Error(f"{self._where}: cannot write the journal: {error.strerror}") from None
        raise InvalidInput(f"{self._where}: the journal was deleted while this process wrote it")

    def _write(self, now: MissionTime, inputs: Sequence[Input]) -> None:
        for given in inputs:
            name, data = encode_input(given, self._codec)
            channel = self._channels.get(name)
            if channel is None:
                channel = self._writer.register_channel(name, "application/octet-stream", 0)
                self._channels[name] = channel
            sealed = _checksum(self._count, now, name, data) + data
            self._writer.add_message(channel, now, sealed, now, self._count)
            self._count += 1
            self._starts += isinstance(given, ProcessStarted)
        self._stream.flush()

    def checkpoint(self, state: SavedState) -> None:
        """Write a checkpoint: the state after everything that was appended so far."""
        names = {number: name for name, number in self._channels.items()}
        self._keep(Mark(self._stream.tell(), names, self._count), self._starts, self._codec.encode(state))


class JournalFolder:
    """The journals of one node of one mission, in a folder."""

    def __init__(self, folder: Path, node: str, identity: dict[str, str], codec: StateCodec) -> None:
        self._folder = folder
        self._node = node
        self._identity = {**identity, "node": node}
        self._codec = codec
        self._checkpoint = folder / f"{node}.checkpoint"

    def history(self) -> History:
        """The history in this folder. Raises InvalidInput for another mission or another format, JournalDamaged for a
        damaged file, He3Error for one that cannot be read.
        """
        try:
            files = self._files()
            found = self._usable_checkpoint(files)
            if isinstance(found, str):
                return self._read(files, notice=found)
            checkpoint, state = found
            later = [path for path in files if path.name >= checkpoint.file]
            return self._read(later, checkpoint, state)
        except OSError as error:
            raise failed(f"{error.filename or self._folder}: cannot read the journal", error) from None

    def begin(self, history: History | None = None, report: Callable[[str], None] = lambda _: None) -> JournalWriter:
        """The writer of the next file; `history` is what the earlier ones hold, for one that keeps checkpoints.

        report: is given a line when checkpoints can no longer be written, and when they can again.
        """
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            path = self._folder / f"{self._node}-{len(self._files()) + 1:04d}.mcap"
            stream = open_output(path, new=True)
            sync_folder(self._folder)
        except OSError as error:
            raise failed(f"{self._folder}: cannot keep a journal there", error) from None

        def is_there() -> bool:
            return os.fstat(stream.fileno()).st_nlink > 0

        def sync() -> None:
            os.fdatasync(stream.fileno())

        if history is None:
            return JournalWriter(stream, self._identity, self._codec, where=str(path), is_there=is_there, sync=sync)
        earlier_starts = history.starts
        keeper = CheckpointKeeper(self._checkpoint, self._identity, report)

        def keep(mark: Mark, starts: int, state: bytes) -> None:
            keeper.keep(Checkpoint(path.name, mark, earlier_starts + starts, state))

        return JournalWriter(stream, self._identity, self._codec, keep, str(path), is_there, sync)

    def _read(
        self,
        files: Sequence[Path],
        checkpoint: Checkpoint | None = None,
        state: SavedState | None = None,
        notice: str = "",
    ) -> History:
        """The inputs in these files, from the checkpoint on if there is one."""
        inputs: list[tuple[MissionTime, Input]] = []
        torn = 0
        for path in files:
            mark = checkpoint.mark if checkpoint is not None and path.name == checkpoint.file else Mark()
            with open_own(path) as stream:
                reader = JournalReader(stream, self._identity, str(path), mark)
                inputs.extend((record.now, decode_input(record.channel, record.data, self._codec)) for record in reader)
            torn += path.stat().st_size - reader.good_bytes
        starts = sum(1 for _, given in inputs if isinstance(given, ProcessStarted))
        if checkpoint is not None:
            starts += checkpoint.starts
        return History(tuple(inputs), starts, torn, state, notice)

    def _usable_checkpoint(self, files: Sequence[Path]) -> tuple[Checkpoint, SavedState] | str:
        """The checkpoint with its state, or one line on why it cannot be used; the line is empty if there is none."""
        if not self._checkpoint.is_file():
            return ""
        sizes = {path.name: path.stat().st_size for path in files}
        found = read_checkpoint(self._checkpoint, self._identity, sizes)
        if isinstance(found, str):
            return f"{self._checkpoint}: passed over: {found}"
        try:
            return found, self._codec.decode(found.state)
        except InvalidInput as refusal:
            return f"{self._checkpoint}: passed over: {refusal}"

    def _files(self) -> list[Path]:
        """The files of the journal, oldest first; raises JournalDamaged if one between them is missing."""
        files = sorted(self._folder.glob(f"{self._node}-[0-9][0-9][0-9][0-9].mcap"))
        for number, path in enumerate(files, start=1):
            expected = f"{self._node}-{number:04d}.mcap"
            if path.name != expected:
                raise JournalDamaged(f"{self._folder}: expected {expected}, got {path.name} as the next one; {_ANEW}")
        return files


class JournalReader:
    """Yields the complete records of one journal file, in order; ends quietly where the file is torn.

    Raises JournalDamaged for a file with other content, or that is damaged anywhere before its last record.
    """

    def __init__(self, stream: IO[bytes], identity: dict[str, str], where: str, mark: Mark | None = None) -> None:
        """mark: where to begin; None: at the beginning."""
        self._mark = mark or Mark()
        self.good_bytes = self._mark.offset
        """Where the last complete record ends, once everything has been read."""
        self._stream = stream
        self._identity = {**identity, "format": FORMAT}
        self._where = where
        self._channels = dict(self._mark.channels)
        self._number = self._mark.records
        self._whose_is_known = self._mark.offset > 0

    def __iter__(self) -> Iterator[Record]:
        for opcode, body in self._frames():
            match opcode:
                case Opcode.HEADER if self.good_bytes == 0:
                    continue
                case Opcode.CHANNEL if self._whose_is_known:
                    channel = self._parsed(Channel.read, body)
                    self._channels[channel.id] = channel.topic
                case Opcode.METADATA:
                    self._check(self._parsed(Metadata.read, body).metadata)
                    self._whose_is_known = True
                    self.good_bytes = self._stream.tell()
                case Opcode.MESSAGE if self._whose_is_known:
                    message = self._parsed(partial(Message.read, length=len(body)), body)
                    name, data = self._channels.get(message.channel_id, ""), message.data[CRC_BYTES:]
                    if _checksum(self._number, message.log_time, name, data) != message.data[:CRC_BYTES]:
                        raise self._damaged()
                    yield Record(message.log_time, name, data)
                    self._number += 1
                    self.good_bytes = self._stream.tell()
                case _:
                    raise self._damaged()

    def _frames(self) -> Iterator[tuple[int, bytes]]:
        """Operation code and body of each complete MCAP record; raises JournalDamaged unless the rest is torn."""
        end = self._stream.seek(0, SEEK_END)
        self._stream.seek(0)
        magic = self._stream.read(len(MCAP0_MAGIC))
        if not MCAP0_MAGIC.startswith(magic):
            raise JournalDamaged(f"{self._where}: expected a journal of this program, got other content; {_ANEW}")
        self._stream.seek(self._mark.offset or len(magic))
        # What a running process adds meanwhile is not read: it would be taken for damage where the file ended before.
        while (left := end - self._stream.tell()) > 0:
            head = self._stream.read(min(left, _FRAME.size))
            if len(head) == _FRAME.size:
                opcode, length = _FRAME.unpack(head)
                if opcode != 0 and length <= end - self._stream.tell():
                    yield opcode, self._stream.read(length)
                    continue
            tail = head + self._stream.read(end - self._stream.tell())
            if not self._is_torn(tail):
                raise self._damaged()

    def _is_torn(self, tail: bytes) -> bool:
        """Whether that is what the end of the process leaves, a part of one record, or of the machine, zeros."""
        if not tail.strip(b"\0"):
            return self._whose_is_known
        opcode, body = tail[0], tail[_FRAME.size :]
        may_come: tuple[int, ...] = (Opcode.CHANNEL, Opcode.MESSAGE)
        if not self._whose_is_known:
            may_come = (Opcode.HEADER, Opcode.METADATA)
            if len(tail) > _LONGEST_BEGINNING:
                return False
        elif opcode == Opcode.MESSAGE and len(body) >= _MESSAGE.size:
            channel, number, log_time, publish_time = _MESSAGE.unpack_from(body)
            if channel not in self._channels or number != self._number or log_time != publish_time:
                return False
        # A length that was changed hides the records that follow; what was torn has none behind it.
        return opcode in may_come and not self._holds_a_record(tail)

    def _holds_a_record(self, tail: bytes) -> bool:
        """Whether a whole record lies in the tail, be it the first one, under a wrong length."""
        if self._is_whole(tail[_FRAME.size :]):
            return True
        place = 0
        while (place := tail.find(bytes([Opcode.MESSAGE]), place + 1)) >= 0:
            begin = place + _FRAME.size
            if begin > len(tail):
                return False
            length = _FRAME.unpack_from(tail, place)[1]
            if length <= len(tail) - begin and self._is_whole(tail[begin : begin + length]):
                return True
        return False

    def _is_whole(self, body: bytes) -> bool:
        """Whether that is the body of a message of this journal, whatever its number."""
        if len(body) < _MESSAGE.size + CRC_BYTES:
            return False
        channel, number, log_time, publish_time = _MESSAGE.unpack_from(body)
        if log_time != publish_time or number < self._number:
            return False
        name, data = self._channels.get(channel), body[_MESSAGE.size + CRC_BYTES :]
        if name is None:
            return True  # of a channel that the wrong length hides, too
        return _checksum(number, log_time, name, data) == body[_MESSAGE.size :][:CRC_BYTES]

    def _parsed(self, read: Callable[[ReadDataStream], _Parsed], body: bytes) -> _Parsed:
        try:
            return read(ReadDataStream(BytesIO(body)))
        except (McapError, EOFError, ValueError, struct.error):
            raise self._damaged() from None

    def _damaged(self) -> JournalDamaged:
        where = f"{self._where}: after {self._number} whole records, between bytes {self.good_bytes} and"
        return JournalDamaged(f"{where} {self._stream.tell()}, a record is damaged; {_ANEW}")

    def _check(self, metadata: dict[str, str]) -> None:
        for name, expected in self._identity.items():
            came = metadata.get(name)
            if came != expected:
                raise InvalidInput(
                    f"{self._where}: expected a journal of {name} {expected}, got one of {came}; {_ANEW}"
                )


def _checksum(number: int, now: MissionTime, channel: str, data: bytes) -> bytes:
    """CRC-32 of a record: its number in the file, its time, its channel and its content."""
    return zlib.crc32(data, zlib.crc32(f"{number} {now} {channel}".encode())).to_bytes(CRC_BYTES, "little")


def identity_of(scenario: Scenario) -> dict[str, str]:
    """Name and digest of the scenario without endpoints, rate and description; equal ones can share journals."""
    document = scenario.model_dump(mode="json", exclude={"network", "rate", "description"})
    digest = hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()
    return {"mission": scenario.name, "scenario": digest[:16]}
