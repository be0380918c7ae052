"""A process's journal: every input of its node, kept before it is handled, in MCAP files.

Each start of a process writes a file of its own, ``NAME-0001.mcap``, ``NAME-0002.mcap``, ...; together, in order, they
are the node's history. Each record is handed to the operating system before the node sees what it holds, so the end of
the process loses nothing. A file may end in the middle of a record: that tail was never handled; it is passed over and
reported. Beside them may lie a checkpoint, ``NAME.checkpoint``, so that a restart handles only the later inputs again.
"""

from __future__ import annotations

import hashlib
import json
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final

from mcap.exceptions import McapError
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from he3.errors import He3Error, InvalidInput
from services.mission.scenario import Scenario
from services.runtime.checkpoint_file import CRC_BYTES, Checkpoint, Mark, read_checkpoint, write_checkpoint
from services.runtime.input_codec import decode_input, encode_input
from services.runtime.inputs import Input, ProcessStarted
from services.runtime.node import MissionTime
from services.runtime.state_codec import SavedState, StateCodec

PROFILE: Final = "he3-journal"
FORMAT: Final = "2"
"""Of the records; a journal of another format is refused."""


class JournalDamaged(He3Error):
    """A journal holds something that cannot have been written by a process that merely ended."""


@dataclass(frozen=True, slots=True)
class History:
    """What the journals of a node hold."""

    inputs: tuple[tuple[MissionTime, Input], ...]
    starts: int
    """How often the node has been started."""
    torn_bytes: int
    """Length of the unfinished tails that were passed over."""
    state: SavedState | None = None
    """From a checkpoint: what everything before `inputs` had led to; None: `inputs` are all."""
    notice: str = ""
    """One line on why a checkpoint was passed over."""


@dataclass(frozen=True, slots=True)
class Record:
    """An input as it is kept."""

    now: MissionTime
    channel: str
    data: bytes


Keep = Callable[[Mark, int, bytes], None]
"""Called with a place in the journal, the starts since it began, and the encoded state that belongs there."""


class JournalWriter:
    """Appends inputs to a stream, as MCAP; each call is flushed before it returns."""

    def __init__(
        self, stream: IO[bytes], identity: dict[str, str], codec: StateCodec, keep: Keep = lambda *_: None
    ) -> None:
        """keep: what is done with a checkpoint."""
        self._stream = stream
        self._codec = codec
        self._keep = keep
        self._starts = 0
        self._writer = Writer(stream, use_chunking=False, compression=CompressionType.NONE)
        self._writer.start(profile=PROFILE)
        self._writer.add_metadata(PROFILE, {**identity, "format": FORMAT})
        self._channels: dict[str, int] = {}
        self._count = 0

    def append(self, now: MissionTime, inputs: Sequence[Input]) -> None:
        """Keep inputs that are about to be handled at that time."""
        for given in inputs:
            name, data = encode_input(given, self._codec)
            channel = self._channels.get(name)
            if channel is None:
                channel = self._writer.register_channel(name, "application/octet-stream", 0)
                self._channels[name] = channel
            sealed = zlib.crc32(data).to_bytes(CRC_BYTES, "little") + data
            self._writer.add_message(channel, now, sealed, now, self._count)
            self._count += 1
            self._starts += isinstance(given, ProcessStarted)
        self._stream.flush()

    def checkpoint(self, state: SavedState) -> None:
        """Keep the state after everything that was appended so far."""
        names = {number: name for name, number in self._channels.items()}
        self._keep(Mark(self._stream.tell(), names), self._starts, self._codec.encode(state))

    def close(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.close()


class JournalFolder:
    """The journals of one node of one mission, in a folder."""

    def __init__(self, folder: Path, node: str, identity: dict[str, str], codec: StateCodec) -> None:
        self._folder = folder
        self._node = node
        self._identity = {**identity, "node": node}
        self._codec = codec
        self._checkpoint = folder / f"{node}.checkpoint"

    def history(self) -> History:
        """Everything that was kept.

        Raises InvalidInput if it is another mission's or not of this format, JournalDamaged if it is damaged.
        """
        files = self._files()
        found = self._usable_checkpoint(files)
        if isinstance(found, str):
            return self._read(files, notice=found)
        checkpoint, state = found
        later = [path for path in files if path.name >= checkpoint.file]
        return self._read(later, checkpoint, state)

    def begin(self, history: History | None = None) -> JournalWriter:
        """The writer of the next file; `history` is what the earlier ones hold, for one that keeps checkpoints."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            path = self._folder / f"{self._node}-{len(self._files()) + 1:04d}.mcap"
            stream = path.open("xb")
        except OSError as error:
            raise InvalidInput(f"{self._folder}: cannot keep a journal there: {error.strerror}") from None
        if history is None:
            return JournalWriter(stream, self._identity, self._codec)
        earlier_starts = history.starts

        def keep(mark: Mark, starts: int, state: bytes) -> None:
            checkpoint = Checkpoint(path.name, mark, earlier_starts + starts, state)
            write_checkpoint(self._checkpoint, self._identity, checkpoint)

        return JournalWriter(stream, self._identity, self._codec, keep)

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
            with path.open("rb") as stream:
                reader = JournalReader(stream, self._identity, str(path), mark)
                inputs.extend((record.now, decode_input(record.channel, record.data, self._codec)) for record in reader)
            torn += path.stat().st_size - reader.good_bytes
        starts = sum(1 for _, given in inputs if isinstance(given, ProcessStarted))
        if checkpoint is not None:
            starts += checkpoint.starts
        return History(tuple(inputs), starts, torn, state, notice)

    def _usable_checkpoint(self, files: Sequence[Path]) -> tuple[Checkpoint, SavedState] | str:
        """The checkpoint with its state, or one line on why there is none to use; empty if there is none at all."""
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
        return sorted(self._folder.glob(f"{self._node}-[0-9][0-9][0-9][0-9].mcap"))


class JournalReader:
    """Yields the complete records of one journal file, in order; ends quietly where the file is torn."""

    def __init__(self, stream: IO[bytes], identity: dict[str, str], where: str, mark: Mark | None = None) -> None:
        """mark: where to begin; None: at the beginning."""
        self._mark = mark or Mark()
        self.good_bytes = self._mark.offset
        """Where the last complete record ends, once everything has been read."""
        self._stream = stream
        self._identity = {**identity, "format": FORMAT}
        self._where = where

    def __iter__(self) -> Iterator[Record]:
        channels = dict(self._mark.channels)
        self._stream.seek(self._mark.offset)
        records = StreamReader(self._stream, skip_magic=self._mark.offset > 0).records
        while True:
            try:
                record = next(records, None)
            except (McapError, EOFError, ValueError, struct.error):
                return  # the tail that the end of the process tore
            if record is None:
                self.good_bytes = self._stream.tell()
                return
            match record:
                case Metadata(metadata=metadata):
                    self._check(metadata)
                case Channel(id=number, topic=topic):
                    channels[number] = topic
                case Message(channel_id=number, log_time=now, data=data):
                    seal = int.from_bytes(data[:CRC_BYTES], "little")
                    if zlib.crc32(data[CRC_BYTES:]) != seal:
                        raise JournalDamaged(f"{self._where}: a record before byte {self._stream.tell()} is damaged")
                    yield Record(now, channels[number], data[CRC_BYTES:])
            self.good_bytes = self._stream.tell()

    def _check(self, metadata: dict[str, str]) -> None:
        for name, expected in self._identity.items():
            came = metadata.get(name)
            if came != expected:
                raise InvalidInput(
                    f"{self._where}: expected a journal of {name} {expected}, got one of {came}; "
                    "name another folder to begin anew"
                )


def identity_of(scenario: Scenario) -> dict[str, str]:
    """What two processes must agree on to share a history: everything in a scenario but where and how fast it runs."""
    document = scenario.model_dump(mode="json", exclude={"network", "rate", "description"})
    digest = hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()
    return {"mission": scenario.name, "scenario": digest[:16]}
