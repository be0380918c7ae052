"""An MCAP recording: every message under the JSON Schema of its topic, readable even after the process was killed.

Beside them are messages in Foxglove's schemas, which `foxglove` makes of them, for programs that do not know ours.

Messages gather in a chunk. A chunk is written when it is large enough or when `flush` is called; a file that ends in
the middle of a chunk holds every chunk before it. Chunks, data and summary have checksums, and the topic of each
channel is written twice: so `reader` can say what is damaged, and assign the messages that are whole.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import IO, TYPE_CHECKING, Protocol, Self, cast

from mcap.writer import CompressionType, Writer

from schemas.wire import SCHEMA_VERSION, Envelope

if TYPE_CHECKING:
    from schemas.topics import Topic
    from services.mission.mission_time import MissionTime
    from services.recorder.foxglove.derivation import Derived

CHUNK_BYTES = 65_536
"""Uncompressed size at which a chunk is written: without a flush, a kill loses at most this much."""

PROFILE = "he3-seeker"

MISSION_RECORD = "mission"
"""Metadata record: the mission and the version of the message schemas."""
CHANNEL_RECORD = "channel"
"""Metadata record: id and topic of a channel, in case the chunk that introduces it is lost."""
REPAIR_RECORD = "repair"
"""Metadata record of a repaired file: one line on a part that was not whole, and whether messages were in it."""
GAP_RECORD = "gap"
"""Metadata record: how many messages were not recorded at this place, and when the first and the last were received."""


class Stream(Protocol):
    """Where a recording is written; a binary file is one."""

    def write(self, data: bytes, /) -> int: ...

    def tell(self) -> int: ...

    def flush(self) -> None: ...


class RecordingWriter:
    """Writes a recording into a stream that it is given, and does not close it."""

    def __init__(
        self,
        stream: Stream,
        mission: str,
        least_flush_s: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
        about: Mapping[str, Mapping[str, str]] | None = None,
    ) -> None:
        """least_flush_s: shortest wall time between two flushes [s]; a fast mission would flush after each message.

        about: further metadata records of the file, by name; see `services.recorder.about`.
        """
        self._stream = stream
        self._least_flush_s = least_flush_s
        self._clock = clock
        self._flushed_at = -math.inf
        self._mission = mission
        self._channels: dict[str, int] = {}
        self._derived: dict[str, int] = {}
        self._writer = mcap_writer(stream)
        self._writer.start(profile=PROFILE, library=PROFILE)
        self._writer.add_metadata(MISSION_RECORD, {"mission": mission, "schema_version": str(SCHEMA_VERSION)})
        for name, fields in (about or {}).items():
            self._writer.add_metadata(name, dict(fields))
        self._stream.flush()
        self.messages = 0
        """Messages written so far."""
        self.stored = 0
        """Messages in chunks that were given to the stream."""

    def write(
        self, topic: Topic, payload: bytes, received_at: MissionTime, made_at: MissionTime, sequence: int
    ) -> None:
        """Append one message: when it reached the recorder and when it was made, both in mission time [ns]."""
        channel = self._channels.get(topic.name)
        if channel is None:
            channel = self._channels[topic.name] = register(self._writer, topic, self._mission)
        before = self._stream.tell()
        self._writer.add_message(
            channel, log_time=received_at, data=payload, publish_time=made_at, sequence=sequence & 0xFFFFFFFF
        )
        self.messages += 1
        if self._stream.tell() > before:
            self.stored = self.messages

    def write_derived(self, message: Derived, received_at: MissionTime) -> None:
        """Append a message in a schema of Foxglove's; it is not counted among the messages."""
        channel = self._derived.get(message.topic)
        if channel is None:
            channel = self._derived[message.topic] = register_derived(self._writer, message.topic)
        before = self._stream.tell()
        self._writer.add_message(channel, received_at, message.payload, message.made_at)
        if self._stream.tell() > before:
            self.stored = self.messages

    def write_gap(self, count: int, first: MissionTime, last: MissionTime) -> None:
        """Note that `count` messages were not recorded here, and when the first and the last were received [ns]."""
        self.flush(now=True)
        self._writer.add_metadata(GAP_RECORD, {"count": str(count), "first": str(first), "last": str(last)})

    def flush(self, *, now: bool = False) -> None:
        """Hand all messages to the operating system, at most once per `least_flush_s`; a kill then loses none of them.

        now: at once, also before that time is over.
        """
        time_s = self._clock()
        if not now and time_s - self._flushed_at < self._least_flush_s:
            return
        self._flushed_at = time_s
        self._writer.flush()  # type: ignore[no-untyped-call]
        self.stored = self.messages

    def close(self) -> None:
        """Complete the file with its index and summary."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self.stored = self.messages
        self._stream.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def mcap_writer(stream: Stream) -> Writer:
    """The library's writer with the settings of a recording: its chunks are small, and they have checksums."""
    output = cast(IO[bytes], stream)  # the library uses no other method of it
    return Writer(output, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True)


def register(writer: Writer, topic: Topic, mission: str) -> int:
    """The new channel of that topic, under its JSON Schema."""
    schema = Envelope[topic.payload].model_json_schema()  # type: ignore[name-defined]
    schema_id = writer.register_schema(
        name=topic.payload.__name__, encoding="jsonschema", data=json.dumps(schema).encode()
    )
    channel = writer.register_channel(
        topic=topic.key(mission), message_encoding="json", schema_id=schema_id, metadata={"topic": topic.name}
    )
    writer.add_metadata(CHANNEL_RECORD, {"id": str(channel), "topic": topic.name})
    return channel


def register_derived(writer: Writer, topic: str) -> int:
    """The new channel of that topic, under its schema of Foxglove's."""
    # Imported here, as those who only read a recording do without protobuf.
    from services.recorder.foxglove.derivation import CHANNELS
    from services.recorder.foxglove.schemas import ENCODING, PACKAGE, descriptors

    schema = writer.register_schema(f"{PACKAGE}.{CHANNELS[topic]}", ENCODING, descriptors(CHANNELS[topic]))
    return writer.register_channel(topic, ENCODING, schema)
