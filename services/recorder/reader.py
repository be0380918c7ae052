"""A recording, read back: all messages that are whole, and an account of what is damaged, missing or left out."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mcap.records import Channel, Message, Metadata, Statistics

from he3.errors import InvalidInput
from schemas.codec import Refused, decode
from schemas.topics import BY_NAME, Topic
from schemas.wire import MAX_TEXT, printable
from services.mission.mission_time import SECOND, MissionTime
from services.recorder.recovery import Fault, read_records
from services.recorder.writer import CHANNEL_RECORD, GAP_RECORD, MISSION_RECORD, REPAIR_RECORD

if TYPE_CHECKING:
    from collections.abc import Mapping

    from schemas.wire import Header

MISSION_NAME: Final = re.compile(r"[a-z0-9][a-z0-9_-]{0,47}")
MAX_DIGITS: Final = 19
"""Digits of the largest number that a record may have, 2**63 - 1."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """One recorded message, checked against its schema."""

    topic: Topic
    header: Header
    body: Any
    payload: bytes
    received_at: MissionTime


@dataclass(frozen=True, slots=True)
class Gap:
    """A part of the file that is damaged or missing, and the whole messages around it."""

    fault: Fault
    after: MissionTime | None = None
    """When the last whole message before it was received; None if there is none."""
    before: MissionTime | None = None
    """When the first whole message behind it was received; None if there is none."""

    def __str__(self) -> str:
        after = "the beginning" if self.after is None else _utc(self.after)
        before = "the end" if self.before is None else _utc(self.before)
        place = f"byte {self.fault.start}"
        if self.fault.end > self.fault.start:
            place = f"bytes {self.fault.start} to {self.fault.end}"
        return f"{place}, between {after} and {before}: {self.fault.what}"


@dataclass(slots=True)
class LeftOut:
    """Messages of one topic that are in the file and were not returned."""

    topic: str
    why: str
    """Why the first of them was left out."""
    count: int = 0

    def __str__(self) -> str:
        return f"{self.topic}: {self.count} left out, the first because: {self.why}"


class Recording:
    """The messages of a recording in the order in which they were written; iterate once over `messages`.

    The facts about the file are complete after the iteration.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.mission = ""
        self.gaps: list[Gap] = []
        """The parts of the file that are not whole, in their order."""
        self.left_out: dict[str, LeftOut] = {}
        """Intact messages that this version cannot read, by topic."""
        self.omissions: list[str] = []
        """One line on each place where messages are missing and the file says so: a full disk, or a repair."""
        self.repairs: list[str] = []
        """One line on each part that a repair completed without a loss of whole records."""
        self.messages_by_topic: Counter[str] = Counter()
        """The messages that were returned."""
        self.foreign: Counter[str] = Counter()
        """Messages of other programs' formats, by the topic of their channel; they are not returned."""
        self.about: dict[str, dict[str, str]] = {}
        """The metadata records on the mission, by name; see `services.recorder.about`."""
        self._topics: dict[int, str] = {}
        self._foreign: dict[int, str] = {}
        self._named_mission = ""
        self._recorded: Counter[int] | None = None

    def messages(self) -> Iterator[Recorded]:
        """Each whole message; raises InvalidInput, in one line, for a file that is no recording of a mission."""
        try:
            with self.path.open("rb") as stream:
                if stream.seek(0, 2) > 0:
                    with mmap(stream.fileno(), 0, access=ACCESS_READ) as data:
                        yield from self._read(data)
        except OSError as error:
            raise InvalidInput(f"{self.path}: expected a recording, got: {error.strerror}") from None
        if not self.mission:
            raise InvalidInput(f"{self.path}: expected a recording of a mission, got none of its records")

    @property
    def whole(self) -> bool:
        """Whether every message that was recorded was returned, and the file is neither cut off nor damaged."""
        return not self.problems()

    @property
    def recorded(self) -> Counter[str] | None:
        """Messages that were recorded, by topic, as the summary of the file counts them; None if it is lost."""
        if self._recorded is None:
            return None
        ours = {channel: n for channel, n in self._recorded.items() if channel not in self._foreign}
        return Counter({self._topics.get(channel, f"channel {channel}"): n for channel, n in ours.items()})

    def problems(self) -> list[str]:
        """One line on each part that is not whole, each topic with messages left out, and how many are missing."""
        lines = [*map(str, self.gaps), *self.omissions, *map(str, self.left_out.values())]
        if self._named_mission and self._named_mission != self.mission:
            lines.append(f"the recording is named '{self._named_mission}', its messages are of '{self.mission}'")
        if lines and self.recorded is None:
            lines.append("how many messages are missing is not known: the summary of the file is lost")
        return lines + self.missing()

    def missing(self) -> list[str]:
        """One line on each topic of which the summary of the file counts more messages than were returned."""
        if self.recorded is None:
            return []
        missing = self.recorded - self.messages_by_topic
        return [
            f"{topic}: {self.messages_by_topic[topic]} of {self.recorded[topic]} messages are read"
            for topic in sorted(missing)
        ]

    def _read(self, data: mmap) -> Iterator[Recorded]:
        received_at: MissionTime | None = None
        for record in read_records(data):
            match record:
                case Fault():
                    self.gaps.append(Gap(record, received_at))
                case Metadata(name=name, metadata=fields) if name == MISSION_RECORD:
                    self._named_mission = _text(fields, "mission")
                    self.mission = self.mission or _mission(self._named_mission)
                case Metadata(name=name, metadata=fields) if name == CHANNEL_RECORD:
                    if (channel := _number(fields, "id")) is not None:
                        self._topics.setdefault(channel, _text(fields, "topic"))
                case Metadata(name=name, metadata=fields) if name == GAP_RECORD:
                    self.omissions.append(_omission(fields))
                case Metadata(name=name, metadata=fields) if name == REPAIR_RECORD:
                    (self.repairs if fields.get("messages") == "no" else self.omissions).append(_text(fields, "what"))
                case Metadata(name=name, metadata=fields):
                    self.about.setdefault(name, fields)
                case Channel():
                    self._introduce(record)
                case Statistics():
                    self._recorded = Counter(record.channel_message_counts)
                case Message():
                    received_at = record.log_time
                    if self.gaps and self.gaps[-1].before is None:
                        self.gaps = [gap if gap.before else replace(gap, before=received_at) for gap in self.gaps]
                    message = self._checked(record)
                    if message is not None:
                        self.messages_by_topic[message.topic.name] += 1
                        yield message

    def _introduce(self, channel: Channel) -> None:
        if "topic" not in channel.metadata:
            self._foreign[channel.id] = printable(channel.topic)
            return
        # A channel's record is under a checksum, a metadata record is not: what the channel says holds.
        self._topics[channel.id] = _text(channel.metadata, "topic") or printable(channel.topic)[:MAX_TEXT]
        parts = channel.topic.split("/")
        if len(parts) > 1:
            self.mission = _mission(parts[1]) or self.mission

    def _checked(self, message: Message) -> Recorded | None:
        if message.channel_id in self._foreign:
            self.foreign[self._foreign[message.channel_id]] += 1
            return None
        name = self._topics.get(message.channel_id, f"channel {message.channel_id}")
        topic = BY_NAME.get(name)
        if topic is None:
            self._leave_out(name, "expected a topic of this version")
            return None
        try:
            header, body = decode(topic, message.data, self.mission)
        except Refused as refusal:
            self._leave_out(name, str(refusal))
            return None
        return Recorded(topic, header, body, message.data, message.log_time)

    def _leave_out(self, topic: str, why: str) -> None:
        self.left_out.setdefault(topic, LeftOut(topic, why)).count += 1


def _omission(fields: dict[str, str]) -> str:
    times = [_number(fields, name) for name in ("first", "last")]
    first, last = ("an unknown time" if time is None else _utc(time) for time in times)
    count = _number(fields, "count")
    return f"{'some' if count is None else count} messages received from {first} to {last} were not recorded: no room"


def _text(fields: Mapping[str, str], name: str) -> str:
    """A text of a record, safe to show: the author of the file may have put anything there."""
    return printable(fields.get(name, ""))[:MAX_TEXT]


def _number(fields: Mapping[str, str], name: str) -> int | None:
    """A number of a record, such as a mission time [ns]; None if there is none, or one that no recorder writes."""
    text = fields.get(name, "")
    return int(text) if text.isdecimal() and len(text) <= MAX_DIGITS and int(text) < 2**63 else None


def _mission(name: str) -> str:
    """The name, if a mission can have it: it becomes a part of keys and of names of files; else an empty one."""
    return name if MISSION_NAME.fullmatch(name) else ""


def _utc(time: MissionTime) -> str:
    return f"{datetime.fromtimestamp(time // SECOND, UTC):%Y-%m-%dT%H:%M:%SZ}"
