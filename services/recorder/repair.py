"""Repair of a recording: every whole record goes into a complete file, which takes the place of the one that is not.

A recorder that is killed leaves a file without its end: no index, no summary, and perhaps half a chunk. Such a file is
read here, but other programs refuse it or read it slowly. The repaired file has all records that are whole, in their
order, and says what was not: in a metadata record of its own for each part.
"""

from __future__ import annotations

import os
import secrets
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import TYPE_CHECKING, Final

from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema

from he3.errors import InvalidInput
from schemas.topics import BY_NAME
from services.recorder.files import free_name
from services.recorder.reader import Recording
from services.recorder.recovery import read_records
from services.recorder.writer import CHANNEL_RECORD, PROFILE, REPAIR_RECORD, mcap_writer, register
from services.runtime.files.lock import lock_beside
from services.runtime.files.output import failed, open_output

if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import IO

    from services.recorder.recovery import Content

NO_RECORDER: Final = "expected a recording that no process writes"


@dataclass(frozen=True, slots=True)
class Repair:
    """What became of a recording."""

    file: Path
    messages: int
    """Messages in the file."""
    repaired: tuple[str, ...] = ()
    """One line on each part that was not whole; empty if the file was complete and is as it was."""
    lost: tuple[str, ...] = ()
    """Those of them that may have held messages, and how many messages of each topic are missing, if that is known."""
    kept: Path | None = None
    """The file as it was, if records in it were damaged; None if only its end was missing."""


def repair(path: Path) -> Repair:
    """Complete that recording, with all its whole records; a complete one is left as it is.

    Raises InvalidInput for a file that is no recording, and while a process writes it; He3Error if the repaired file
    cannot be written. The recording is then as it was.
    """
    path = path.resolve()
    if not path.is_file():
        raise InvalidInput(f"{path}: expected a recording, got {'a folder' if path.is_dir() else 'no file'}")
    recording = Recording(path)
    with lock_beside(path, f"{path}: {NO_RECORDER}"):
        messages = sum(1 for _ in recording.messages())
        if not recording.gaps:
            unread = recording.foreign.total() + sum(each.count for each in recording.left_out.values())
            return Repair(path, messages + unread)
        damaged = tuple(str(gap) for gap in recording.gaps if not gap.fault.at_end)
        lost = damaged + tuple(recording.missing())
        ends = tuple(str(gap) for gap in recording.gaps if gap.fault.at_end)
        scratch = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
        try:
            with open_output(scratch, new=True) as stream:
                copied = _copy(path, stream, recording.mission, ends, lost)
                stream.flush()
                os.fsync(stream.fileno())
            kept = free_name(path.with_stem(f"{path.stem}-damaged")) if damaged else None
            if kept is not None:
                kept.hardlink_to(path)  # the recording keeps its name at every moment
            scratch.replace(path)
        except OSError as error:
            raise failed(f"{path}: cannot write the repaired recording", error) from None
        finally:
            scratch.unlink(missing_ok=True)
    return Repair(path, copied, (*damaged, *ends), lost, kept)


def _copy(path: Path, stream: IO[bytes], mission: str, ends: Iterable[str], lost: Iterable[str]) -> int:
    """Write all whole records of that file into the stream; the number of messages among them."""
    with path.open("rb") as source, mmap(source.fileno(), 0, access=ACCESS_READ) as data:
        copy = _Copy(stream, mission)
        for record in read_records(data):
            copy.add(record)
        for what, messages in ((ends, "no"), (lost, "yes")):
            for line in what:
                copy.note(line, messages)
        copy.finish()
    return copy.messages


class _Copy:
    """The repaired file. The library numbers schemas and channels anew, in the order in which they are introduced."""

    def __init__(self, stream: IO[bytes], mission: str) -> None:
        self._writer = mcap_writer(stream)
        self._mission = mission
        self._started = False
        self._schemas: dict[int, int] = {0: 0}  # number in the file -> number in the copy; 0 is none, in both
        self._channels: dict[int, int] = {}
        self._topics: dict[int, str] = {}
        self.messages = 0

    def add(self, record: Content | object) -> None:
        """Write the record, if it is one to be kept; a message whose channel is lost is none."""
        if isinstance(record, Header):
            self._start(record.profile, record.library)
            return
        self._start(PROFILE, PROFILE)
        match record:
            case Schema():
                if record.id not in self._schemas:
                    self._schemas[record.id] = self._writer.register_schema(record.name, record.encoding, record.data)
            case Channel():
                self._introduce(record)
            case Message():
                self._add_message(record)
            case Metadata(name=name) if name == CHANNEL_RECORD:
                if record.metadata.get("id", "").isdecimal():
                    self._topics[int(record.metadata["id"])] = record.metadata.get("topic", "")
            case Metadata():
                self._writer.add_metadata(record.name, record.metadata)
            case Attachment():
                self._writer.add_attachment(
                    record.create_time, record.log_time, record.name, record.media_type, record.data
                )

    def note(self, line: str, messages: str) -> None:
        """Say in the file itself that a part was not whole. messages: "yes" if it may have held some, else "no"."""
        self._writer.add_metadata(REPAIR_RECORD, {"what": line, "messages": messages})

    def finish(self) -> None:
        """Write index and summary."""
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _start(self, profile: str, library: str) -> None:
        if not self._started:
            self._started = True
            self._writer.start(profile=profile, library=library)

    def _introduce(self, channel: Channel) -> None:
        if channel.id in self._channels:
            return  # it is repeated in the summary
        number = self._writer.register_channel(
            channel.topic, channel.message_encoding, self._schemas.get(channel.schema_id, 0), channel.metadata
        )
        self._channels[channel.id] = number
        if "topic" in channel.metadata:
            self._writer.add_metadata(CHANNEL_RECORD, {"id": str(number), "topic": channel.metadata["topic"]})

    def _add_message(self, message: Message) -> None:
        number = self._channels.get(message.channel_id)
        if number is None:
            topic = BY_NAME.get(self._topics.get(message.channel_id, ""))
            if topic is None:
                return
            # The chunk that introduced the channel is lost; the record beside it names the topic.
            number = self._channels[message.channel_id] = register(self._writer, topic, self._mission)
        self._writer.add_message(number, message.log_time, message.data, message.publish_time, message.sequence)
        self.messages += 1
