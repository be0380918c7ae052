"""A recording, read back: whole files, and what is left of a file whose writer was killed."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import StreamReader
from zstandard import ZstdError

from he3.errors import InvalidInput
from schemas.codec import Refused, decode
from schemas.topics import BY_NAME, Topic
from schemas.wire import Header
from services.runtime.node import MissionTime

RECORD_LIMIT_BYTES = 64 * 1024 * 1024

TORN = (McapError, ZstdError, struct.error, ValueError, EOFError, OverflowError)
"""What reading into a torn record raises, wherever the tear is."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """One recorded message, checked against its schema as it was when it came."""

    topic: Topic
    header: Header
    body: Any
    payload: bytes
    received_at: MissionTime


class Recording:
    """The messages of a recording in the order in which they were written; iterate once over `messages`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.mission = ""
        """Known once iteration has begun."""
        self.torn: str | None = None
        """After iteration: why the file ends early, in one line; None for a file that was finished."""

    def messages(self) -> Iterator[Recorded]:
        """Each complete message; raises InvalidInput, in one line, for a file that is no recording of ours."""
        try:
            with self.path.open("rb") as stream:
                yield from self._read(StreamReader(stream, validate_crcs=True, record_size_limit=RECORD_LIMIT_BYTES))
        except OSError as error:
            raise InvalidInput(f"{self.path}: expected a recording, got: {error.strerror}") from None
        if not self.mission:
            raise InvalidInput(f"{self.path}: expected a recording of a mission, got none of its records")

    def _read(self, reader: StreamReader) -> Iterator[Recorded]:
        channels: dict[int, Topic] = {}
        records = iter(reader.records)
        while True:
            try:
                record = next(records)
            except StopIteration:
                return
            except TORN as error:
                self.torn = f"it ends early ({type(error).__name__})"
                return
            if isinstance(record, Metadata) and record.name == "mission":
                self.mission = record.metadata.get("mission", "")
            elif isinstance(record, Channel):
                topic = BY_NAME.get(record.metadata.get("topic", ""))
                if topic is not None:
                    channels[record.id] = topic
            elif isinstance(record, Message) and record.channel_id in channels:
                yield self._checked(channels[record.channel_id], record)

    def _checked(self, topic: Topic, message: Message) -> Recorded:
        try:
            header, body = decode(topic, message.data, self.mission)
        except Refused as refusal:
            raise InvalidInput(f"{self.path}: {refusal}") from None
        return Recorded(topic, header, body, message.data, message.log_time)
