"""Recordings: what Foxglove's messages add in bytes and time, and the memory that a long one takes to be read.

`he3 bench recording --file runs/t1/mission.mcap` writes the messages of that recording again, alone and with
Foxglove's, into files of which a chunk is completed every `flush_s` of mission time. Then it repeats them until there
are `messages` of ours, and reads that recording, and one of a tenth of it, each in a process of its own.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks import kept
from he3.errors import InvalidInput
from schemas.codec import encode
from services.mission.mission_time import seconds
from services.recorder.foxglove.derivation import Derivation
from services.recorder.reader import Recorded, Recording
from services.recorder.writer import RecordingWriter
from services.runtime.child import ROOT, child_environment

TIMES = ("at", "measured_at")
"""Fields of our messages that say when something was on the Moon [ns]."""

_READ = """
import sys
from pathlib import Path
from services.recorder.reader import Recording
recording = Recording(Path(sys.argv[1]))
count = sum(1 for _ in recording.messages())
assert recording.whole, recording.problems()
status = Path("/proc/self/status").read_text()
print(count, status.split("VmHWM:")[1].split()[0])
"""


@dataclass(frozen=True, slots=True)
class Written:
    """One file that was written."""

    messages: int
    bytes: int
    cpu_s: float


@dataclass(frozen=True, slots=True)
class Read:
    """One file that was read in a process of its own."""

    messages: int
    bytes: int
    wall_s: float
    peak_mb: float
    """Memory of that process at most, Python and its libraries included."""


def run(
    file: Path = Path("mission.mcap"),
    messages: int = 200_000,
    flush_s: float = 60.0,
    json: Path | None = None,
    say: Callable[[str], None] = print,
) -> dict[str, object]:
    """The figures, also printed. Raises InvalidInput for a file that is no recording."""
    if messages < 10:
        raise InvalidInput(f"--messages: expected 10 or more, got {messages}")
    given = list(Recording(file).messages())
    if not given:
        raise InvalidInput(f"{file}: expected a recording with messages, got none")
    with tempfile.TemporaryDirectory(prefix="he3-recording-") as folder:
        target = Path(folder) / "mission.mcap"
        plain = write(target, given, flush_s, foxglove=False)
        both = write(target, given, flush_s, foxglove=True)
        say(f"{'':<16} {'messages':>9} {'bytes':>12} {'CPU s':>7}")
        say(f"{'ours alone':<16} {plain.messages:>9} {plain.bytes:>12,} {plain.cpu_s:>7.2f}")
        say(f"{'with Foxglove':<16} {both.messages:>9} {both.bytes:>12,} {both.cpu_s:>7.2f}")
        extra_ms = (both.cpu_s - plain.cpu_s) / plain.messages * 1000
        say(f"{'ratio':<16} {'':>9} {both.bytes / plain.bytes:>12.2f}, {extra_ms:.3f} ms a message more")
        reads = []
        for count in (messages // 10, messages):
            write(target, repeated(given, count), flush_s, foxglove=False)
            reads.append(read(target))
            each = reads[-1]
            say(f"read {each.messages:>11} {each.bytes:>21,} {each.wall_s:>7.2f} s, {each.peak_mb:.0f} MB at most")
    result: dict[str, object] = {"plain": asdict(plain), "with_foxglove": asdict(both), "read": [*map(asdict, reads)]}
    kept.write_whole(json, result)
    return result


def write(target: Path, messages: Iterator[Recorded] | list[Recorded], flush_s: float, *, foxglove: bool) -> Written:
    """Write those messages, with the ones for Foxglove that follow from them or without."""
    began, flushed_at, flush = time.process_time(), 0, seconds(flush_s)
    derivation = Derivation()
    mission = ""
    with target.open("wb") as stream:
        writer: RecordingWriter | None = None
        for each in messages:
            if writer is None:
                mission = each.header.mission
                writer = RecordingWriter(stream, mission)
            writer.write(each.topic, each.payload, each.received_at, each.header.made_at, each.header.sequence)
            if foxglove:
                for derived in derivation.of(each.topic, each.header, each.body):
                    writer.write_derived(derived, each.received_at)
            if each.received_at - flushed_at >= flush:
                flushed_at = each.received_at
                writer.flush()
        assert writer is not None, "expected at least one message"
        count = writer.messages
        writer.close()
    return Written(count, target.stat().st_size, time.process_time() - began)


def repeated(messages: list[Recorded], count: int) -> Iterator[Recorded]:
    """So many messages: those given, again and again, each time with later sequences and times."""
    span = messages[-1].received_at - messages[0].received_at + seconds(1.0)
    for number in range(count):
        lap, index = divmod(number, len(messages))
        each = messages[index]
        header = each.header.model_copy(
            update={"sequence": number, "held_from": None, "made_at": each.header.made_at + lap * span}
        )
        times = {name: getattr(each.body, name) + lap * span for name in TIMES if hasattr(each.body, name)}
        body = each.body.model_copy(update=times)
        yield Recorded(each.topic, header, body, encode(header, body), each.received_at + lap * span)


def read(file: Path) -> Read:
    """Read all messages of that recording in a process of its own."""
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", _READ, str(file.absolute())],
        capture_output=True, text=True, check=True, cwd=ROOT, env=child_environment(),
    )  # fmt: skip
    count, peak_kb = map(int, done.stdout.split())
    return Read(count, file.stat().st_size, time.monotonic() - began, peak_kb / 1024)
