"""A process's journal: every input of its node, kept before it is acted on, in MCAP files that anybody can open.

Each start of a process writes a file of its own, ``NAME-0001.mcap``, ``NAME-0002.mcap``, ...; together, in order, they
are the node's history. Each record is flushed to the operating system before the node sees what it holds, so the end
of the process loses nothing. A file may end in the middle of a record: that tail was never acted on; it is passed over
and reported.

Beside them may lie a checkpoint, ``NAME.checkpoint``: the state that all inputs up to some byte had led to, so that a
restart handles only those again that came later. It is a short cut and no more: it replaces its predecessor at once or
not at all, only the very program that wrote it reads it, and without it the journals tell everything.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import struct
import sys
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import IO, Any

from mcap.exceptions import McapError
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from he3.errors import He3Error, InvalidInput
from schemas.topics import BY_NAME
from services.mission.scenario import Scenario
from services.runtime.inputs import (
    CheckedQueryArrived,
    ComputationEnded,
    Input,
    MessageArrived,
    ProcessStarted,
    QueryArrived,
    QueryUnanswered,
    ReplyArrived,
    TimerElapsed,
)
from services.runtime.node import MissionTime, NoReply

IDENTITY = "he3-journal"
CRC_BYTES = 4


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
    state: bytes | None = None
    """From a checkpoint: what everything before `inputs` had led to; None: `inputs` are all."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A place in a journal file between two records."""

    offset: int = 0
    channels: dict[int, str] = field(default_factory=dict)
    """Registered before it: number and name."""


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A state, where in the journals it belongs, and whose it is."""

    identity: dict[str, str]
    program: str
    file: str
    mark: Mark
    starts: int
    state: bytes


Keep = Callable[[Mark, int, bytes], None]
"""Called with a place in the journal, the starts since it began, and the state that belongs there."""


class JournalWriter:
    """Appends inputs to a stream, as MCAP; each call is flushed before it returns."""

    def __init__(self, stream: IO[bytes], identity: dict[str, str], keep: Keep = lambda *_: None) -> None:
        """keep: what is done with a checkpoint."""
        self._stream = stream
        self._keep = keep
        self._starts = 0
        self._writer = Writer(stream, use_chunking=False, compression=CompressionType.NONE)
        self._writer.start(profile=IDENTITY)
        self._writer.add_metadata(IDENTITY, identity)
        self._channels: dict[str, int] = {}
        self._count = 0

    def append(self, now: MissionTime, inputs: Sequence[Input]) -> None:
        """Keep inputs that are about to be handled at that time."""
        for given in inputs:
            name, data = encode_input(given)
            channel = self._channels.get(name)
            if channel is None:
                channel = self._writer.register_channel(name, "application/octet-stream", 0)
                self._channels[name] = channel
            sealed = zlib.crc32(data).to_bytes(CRC_BYTES, "little") + data
            self._writer.add_message(channel, now, sealed, now, self._count)
            self._count += 1
            self._starts += isinstance(given, ProcessStarted)
        self._stream.flush()

    def checkpoint(self, state: bytes) -> None:
        """Keep the state after everything that was appended so far."""
        names = {number: name for name, number in self._channels.items()}
        self._keep(Mark(self._stream.tell(), names), self._starts, state)

    def close(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.close()


class JournalFolder:
    """The journals of one node of one mission, in a folder."""

    def __init__(self, folder: Path, node: str, identity: dict[str, str]) -> None:
        self._folder = folder
        self._node = node
        self._identity = {**identity, "node": node}
        self._checkpoint = folder / f"{node}.checkpoint"

    def history(self) -> History:
        """Everything that was kept; raises InvalidInput if it is another mission's, JournalDamaged if it is spoilt."""
        inputs: list[tuple[MissionTime, Input]] = []
        torn = 0
        files = self._files()
        checkpoint = self._usable_checkpoint(files)
        if checkpoint is not None:
            files = [path for path in files if path.name >= checkpoint.file]
        for path in files:
            size = path.stat().st_size
            mark = checkpoint.mark if checkpoint is not None and path.name == checkpoint.file else Mark()
            with path.open("rb") as stream:
                reader = JournalReader(stream, self._identity, str(path), mark)
                inputs.extend(reader)
            torn += size - reader.good_bytes
        starts = sum(1 for _, given in inputs if isinstance(given, ProcessStarted))
        if checkpoint is None:
            return History(tuple(inputs), starts, torn)
        return History(tuple(inputs), checkpoint.starts + starts, torn, checkpoint.state)

    def begin(self, history: History | None = None) -> JournalWriter:
        """The writer of the next file; `history` is what the earlier ones hold, for who keeps checkpoints."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            path = self._folder / f"{self._node}-{len(self._files()) + 1:04d}.mcap"
            stream = path.open("xb")
        except OSError as error:
            raise InvalidInput(f"{self._folder}: cannot keep a journal there: {error.strerror}") from None
        if history is None:
            return JournalWriter(stream, self._identity)
        starts = history.starts
        return JournalWriter(stream, self._identity, lambda *what: self._keep_checkpoint(path.name, starts, *what))

    def _keep_checkpoint(self, file: str, earlier_starts: int, mark: Mark, starts: int, state: bytes) -> None:
        checkpoint = Checkpoint(self._identity, _program(), file, mark, earlier_starts + starts, state)
        data = pickle.dumps(checkpoint, pickle.HIGHEST_PROTOCOL)
        new = self._checkpoint.with_suffix(".new")
        new.write_bytes(zlib.crc32(data).to_bytes(CRC_BYTES, "little") + data)
        new.replace(self._checkpoint)  # at once or not at all

    def _usable_checkpoint(self, files: Sequence[Path]) -> Checkpoint | None:
        """The checkpoint, if it is whole, of this mission and this very program, and its journal is there."""
        if not self._checkpoint.is_file():
            return None
        sealed = self._checkpoint.read_bytes()
        data = sealed[CRC_BYTES:]
        if zlib.crc32(data) != int.from_bytes(sealed[:CRC_BYTES], "little") or _program().encode() not in data:
            return None
        checkpoint: Checkpoint = pickle.loads(data)
        sizes = {path.name: path.stat().st_size for path in files}
        fits = checkpoint.identity == self._identity and checkpoint.program == _program()
        return checkpoint if fits and sizes.get(checkpoint.file, -1) >= checkpoint.mark.offset else None

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
        self._identity = identity
        self._where = where

    def __iter__(self) -> Iterator[tuple[MissionTime, Input]]:
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
                    yield now, decode_input(channels[number], data[CRC_BYTES:])
            self.good_bytes = self._stream.tell()

    def _check(self, metadata: dict[str, str]) -> None:
        for name, expected in self._identity.items():
            came = metadata.get(name)
            if came != expected:
                raise InvalidInput(
                    f"{self._where}: expected a journal of {name} {expected}, got one of {came}; "
                    "name another folder to begin anew"
                )


# --- one input, as channel and bytes ----------------------------------------------------------------------------


def encode_input(given: Input) -> tuple[str, bytes]:
    """Channel and bytes of an input; messages are kept exactly as they came."""
    match given:
        case ProcessStarted(incarnation):
            return "start", b"%d" % incarnation
        case MessageArrived(topic, payload):
            return f"message/{topic.name}", payload
        case QueryArrived(topic, payload, token):
            return f"query/{topic.name}", b"%d\n" % token + payload
        case CheckedQueryArrived(topic, request, token):
            return f"checked_query/{topic.name}", b"%d\n" % token + request.model_dump_json().encode()
        case ReplyArrived(query, payload):
            return "reply", query.encode() + b"\n" + payload
        case QueryUnanswered(query, why, detail):
            return "unanswered", json.dumps([query, why.name, detail]).encode()
        case TimerElapsed(timer):
            return "timer", timer.encode()
        case ComputationEnded(job, result, error):
            return "computation", job.encode() + b"\n" + pickle.dumps((result, error))


def decode_input(channel: str, data: bytes) -> Input:
    """The input that those bytes stand for. Journals are our own files: computed results in them are trusted."""
    what, _, name = channel.partition("/")
    head, _, rest = data.partition(b"\n")
    match what:
        case "start":
            return ProcessStarted(int(data))
        case "message":
            return MessageArrived(BY_NAME[name], data)
        case "query":
            return QueryArrived(BY_NAME[name], rest, int(head))
        case "checked_query":
            return CheckedQueryArrived(BY_NAME[name], BY_NAME[name].payload.model_validate_json(rest), int(head))
        case "reply":
            return ReplyArrived(head.decode(), rest)
        case "unanswered":
            query, why, detail = json.loads(data)
            return QueryUnanswered(query, NoReply[why], detail)
        case "timer":
            return TimerElapsed(data.decode())
        case "computation":
            outcome: tuple[Any, Any] = pickle.loads(rest)
            return ComputationEnded(head.decode(), *outcome)
    raise JournalDamaged(f"expected a record of a journal, got one of channel '{channel}'")


@cache
def _program() -> str:
    """A digest of this program's files: what state they keep, and how, is known to the same files only."""
    root = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256(sys.version.encode())
    for package in ("he3", "schemas", "services"):
        for path in sorted((root / package).rglob("*.py")):
            status = path.stat()
            digest.update(f"{path.relative_to(root)} {status.st_size} {status.st_mtime_ns}\n".encode())
    return digest.hexdigest()


def identity_of(scenario: Scenario) -> dict[str, str]:
    """What two processes must agree on to share a history: everything in a scenario but where and how fast it runs."""
    document = scenario.model_dump(mode="json", exclude={"network", "rate", "description"})
    digest = hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()
    return {"mission": scenario.name, "scenario": digest[:16]}
