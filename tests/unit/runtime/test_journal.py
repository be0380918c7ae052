"""Journals and checkpoints: every complete record comes back, damage is reported, and a restart continues."""

from __future__ import annotations

import errno
import os
import pickle
import random
import resource
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from benchmarks.faults import World, small_region
from he3.errors import He3Error, InvalidInput, NoRoute
from schemas.link import LinkChange
from schemas.topics import LINK_SET, SAMPLE
from services.runtime import checkpoint_file
from services.runtime import journal as journals
from services.runtime.drivers.simulated_journal import SimulatedJournal
from services.runtime.host import STATE_TYPES as HOST_STATE_TYPES
from services.runtime.host import Host
from services.runtime.input_codec import decode_input, encode_input
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
from services.runtime.journal import (
    JournalDamaged,
    JournalFolder,
    JournalReader,
    JournalWriter,
)
from services.runtime.node import Interface, NoReply, SetTimer, TimerFired
from services.runtime.scheduler import CHECKPOINT_EVERY, InlineExecutor, NodeScheduler
from services.runtime.state_codec import StateCodec

WHO = {"mission": "m", "scenario": "s"}
CODEC = StateCodec(HOST_STATE_TYPES)
STATE = {"the": "state", "numbers": (1, 2.5)}


def inputs(count: int) -> list[tuple[int, Input]]:
    """Inputs of every kind, in turn."""
    kinds = [
        MessageArrived(SAMPLE, b'{"a": "b"}' * 7),
        TimerElapsed("step"),
        QueryArrived(LINK_SET, b"{}", 7),
        CheckedQueryArrived(LINK_SET, LinkChange(loss=0.5), 9),
        ReplyArrived("who", b"bytes\nof all sorts \x00\xff"),
        QueryUnanswered("who", NoReply.TIMEOUT, "too late"),
        ComputationEnded("plan:1", (1, "two"), None),
        ProcessStarted(3),
    ]
    return [(1000 + number, kinds[number % len(kinds)]) for number in range(count)]


def folder_with(path: Path, kept: list[tuple[int, Input]]) -> Path:
    """The file of a journal that holds those inputs, of a process that ended without a message."""
    writer = JournalFolder(path, "rover", WHO, CODEC).begin()
    for now, each in kept:
        writer.append(now, [each])
    ended(writer)
    return path / "rover-0001.mcap"


def ended(writer: JournalWriter) -> None:
    """End the journal's process: the file is closed as it is."""
    writer._stream.close()


def same(some: Any, others: Any) -> bool:
    return kept_bytes(some) == kept_bytes(others)


def kept_bytes(inputs: Any) -> list[tuple[int, tuple[str, bytes]]]:
    return [(now, encode_input(given, CODEC)) for now, given in inputs]


@pytest.mark.parametrize("kept", [each for _, each in inputs(8)], ids=lambda kept: type(kept).__name__)
def test_every_kind_of_input_comes_back_as_it_was(kept: Input) -> None:
    back = decode_input(*encode_input(kept, CODEC), CODEC)

    assert back == kept


def test_a_journal_cut_at_every_byte_of_its_last_4_kb_gives_back_every_complete_record(tmp_path: Path) -> None:
    kept = inputs(40)  # little more than 4 kB
    path = folder_with(tmp_path, kept)
    whole = path.read_bytes()
    ends = _record_ends(tmp_path / "again", kept)
    assert ends[-1] == len(whole)

    history = JournalFolder(tmp_path, "rover", WHO, CODEC).history()
    for length in range(len(whole) - 4096, len(whole) + 1):
        path.write_bytes(whole[:length])
        history = JournalFolder(tmp_path, "rover", WHO, CODEC).history()
        complete = sum(end <= length for end in ends)
        assert len(history.inputs) == complete
        assert history.torn_bytes <= length - (ends[complete - 1] if complete else 0)
    assert same(history.inputs, kept)


def _record_ends(path: Path, kept: list[tuple[int, Input]]) -> list[int]:
    """Size of the file after each append."""
    writer = JournalFolder(path, "rover", WHO, CODEC).begin()
    ends = []
    for now, each in kept:
        writer.append(now, [each])
        ends.append((path / "rover-0001.mcap").stat().st_size)
    ended(writer)
    return ends


def test_a_tail_of_zeros_that_the_end_of_the_machine_left_is_passed_over(tmp_path: Path) -> None:
    path = folder_with(tmp_path, inputs(20))
    path.write_bytes(path.read_bytes() + bytes(4096))
    history = JournalFolder(tmp_path, "rover", WHO, CODEC).history()

    assert same(history.inputs, inputs(20))
    assert history.torn_bytes == 4096


def test_the_next_start_writes_a_file_of_its_own_after_a_torn_one(tmp_path: Path) -> None:
    path = folder_with(tmp_path, inputs(20))
    path.write_bytes(path.read_bytes()[:-3])
    folder = JournalFolder(tmp_path, "rover", WHO, CODEC)
    writer = folder.begin()
    writer.append(5000, [TimerElapsed("later")])
    ended(writer)
    history = folder.history()

    assert same(history.inputs[:19], inputs(19))
    assert history.inputs[19:] == ((5000, TimerElapsed("later")),)
    assert history.torn_bytes > 0


def test_a_damaged_record_in_the_middle_is_reported_as_bad_input_that_no_restart_mends(tmp_path: Path) -> None:
    path = folder_with(tmp_path, inputs(20))
    content = bytearray(path.read_bytes())
    content[content.index(b'"a": "b"')] ^= 1
    path.write_bytes(content)
    with pytest.raises(JournalDamaged, match="rover-0001") as damaged:
        JournalFolder(tmp_path, "rover", WHO, CODEC).history()
    assert isinstance(damaged.value, InvalidInput)


FOREIGN = {
    "random bytes": random.Random(1).randbytes(5000),
    "few random bytes": random.Random(2).randbytes(5),
    "text": b"notes of the shift, 12 March\n" * 40,
    "zeros": bytes(4096),
    "the opening of an MCAP file, then text": b"\x89MCAP0\r\n" + b"notes of the shift\n" * 40,
    "the opening of an MCAP file, then random bytes": b"\x89MCAP0\r\n\x01" + random.Random(3).randbytes(5000),
}


@pytest.mark.parametrize("content", FOREIGN.values(), ids=FOREIGN)
def test_content_that_was_never_a_journal_is_an_error_and_is_left_as_it_is(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "rover-0001.mcap"
    path.write_bytes(content)
    with pytest.raises(JournalDamaged, match="rover-0001") as damaged:
        JournalFolder(tmp_path, "rover", WHO, CODEC).history()
    assert "\n" not in str(damaged.value)
    assert path.read_bytes() == content


def test_a_start_that_ended_before_it_wrote_anything_is_no_error(tmp_path: Path) -> None:
    (tmp_path / "rover-0001.mcap").write_bytes(b"")
    history = JournalFolder(tmp_path, "rover", WHO, CODEC).history()
    assert (history.inputs, history.torn_bytes) == ((), 0)


def test_a_journal_whose_record_has_another_length_is_damaged_and_not_taken_for_a_torn_one(tmp_path: Path) -> None:
    kept = inputs(40)
    path = folder_with(tmp_path, kept)
    whole = path.read_bytes()
    ends = _record_ends(tmp_path / "again", kept)
    for number, (begin, end) in enumerate(pairwise(ends)):
        spoilt = bytearray(whole)
        # A channel may precede the message; then its length is the one that is changed.
        for byte in range(1, 9):
            spoilt[begin + byte] ^= 0x40
            path.write_bytes(spoilt)
            with pytest.raises(JournalDamaged, match="rover-0001"):
                JournalFolder(tmp_path, "rover", WHO, CODEC).history()
            spoilt[begin + byte] ^= 0x40
        assert end <= len(whole), number


@pytest.mark.parametrize(
    "tail", [random.Random(4).randbytes(3000), b"\x05" + random.Random(5).randbytes(3000), b"and\n"]
)
def test_a_tail_that_is_no_beginning_of_a_record_is_damage(tmp_path: Path, tail: bytes) -> None:
    path = folder_with(tmp_path, inputs(20))
    path.write_bytes(path.read_bytes() + tail)
    with pytest.raises(JournalDamaged, match="rover-0001"):
        JournalFolder(tmp_path, "rover", WHO, CODEC).history()


@pytest.mark.parametrize("name", ["rover-0001.mcap", "rover.checkpoint"])
def test_a_journal_that_the_system_does_not_let_read_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    folder = checkpointed(tmp_path, before=7, after=5)
    open_ = os.open

    def refuse(path: Path | str) -> None:
        if Path(path).name == name:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    monkeypatch.setattr(os, "open", lambda path, *rest, **named: refuse(path) or open_(path, *rest, **named))
    with pytest.raises(InvalidInput, match=f"{name}: cannot read the journal: Permission denied"):
        folder.history()


def test_a_journal_that_lacks_a_file_is_damaged(tmp_path: Path) -> None:
    folder = JournalFolder(tmp_path, "rover", WHO, CODEC)
    for start in range(3):
        writer = folder.begin()
        writer.append(start, [ProcessStarted(start)])
        ended(writer)
    (tmp_path / "rover-0002.mcap").unlink()
    with pytest.raises(JournalDamaged, match=r"expected rover-0002\.mcap"):
        folder.history()


@example(place=320, change=1)
@example(place=55, change=8)
@example(place=-1, change=1)
@given(place=st.integers(0, 10**6), change=st.integers(1, 255))
def test_no_changed_byte_passes_as_another_history(place: int, change: int) -> None:
    kept = inputs(16)
    with tempfile.TemporaryDirectory() as folder:
        path = folder_with(Path(folder), kept)
        content = bytearray(path.read_bytes())
        content[place % len(content)] ^= change
        path.write_bytes(content)
        try:
            history = JournalFolder(Path(folder), "rover", WHO, CODEC).history()
        except (JournalDamaged, InvalidInput):
            return  # it is reported
    assert same(history.inputs, kept), "nothing is lost without an error"


def test_the_journal_of_another_mission_is_refused(tmp_path: Path) -> None:
    folder_with(tmp_path, inputs(3))
    with pytest.raises(InvalidInput, match="expected a journal of scenario other, got one of s"):
        JournalFolder(tmp_path, "rover", {**WHO, "scenario": "other"}, CODEC).history()


# --- checkpoints ----------------------------------------------------------------------------------------------------


def checkpointed(path: Path, before: int, after: int, *, starts: int = 1) -> JournalFolder:
    """A folder whose last file has a checkpoint between its inputs."""
    folder = JournalFolder(path, "rover", WHO, CODEC)
    for number in range(1, starts + 1):
        writer = folder.begin(folder.history())
        writer.append(number, [ProcessStarted(number)])
        if number < starts:
            ended(writer)
    for now, each in inputs(before):
        writer.append(now, [each])
    writer.checkpoint(STATE)
    for now, each in inputs(after):
        writer.append(now, [each])
    ended(writer)
    return folder


def test_with_a_checkpoint_only_later_inputs_are_read_and_every_start_is_counted(tmp_path: Path) -> None:
    folder = checkpointed(tmp_path, before=7, after=5, starts=3)
    history = folder.history()

    assert history.state == STATE
    assert same(history.inputs, inputs(5))
    assert history.starts == 3

    writer = folder.begin(history)
    writer.append(9, [ProcessStarted(4)])
    ended(writer)
    assert folder.history().starts == 4
    assert same(folder.history().inputs, [*inputs(5), (9, ProcessStarted(4))])


@contextmanager
def files_no_longer_than(size: int) -> Iterator[None]:
    """Let the system refuse every byte of a file beyond that size, as on a full disk."""
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))


@given(room=st.integers(0, 200))
def test_a_journal_that_cannot_be_written_is_one_line_and_what_was_written_before_is_read(room: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = JournalFolder(Path(name), "rover", WHO, CODEC)
        writer = folder.begin(folder.history())
        for now, each in inputs(8):
            writer.append(now, [each])
        path = Path(name) / "rover-0001.mcap"
        whole = path.stat().st_size
        with files_no_longer_than(whole + room), pytest.raises(He3Error) as refusal:
            append_without_end(writer)
        assert str(refusal.value) == f"{path}: cannot write the journal: File too large"
        kept = folder.history().inputs
        assert same(kept[:8], inputs(8))
        assert same(kept[8:], [(2000, TimerElapsed("step"))] * (len(kept) - 8))
        ended(writer)


@pytest.mark.parametrize("checkpoints", [False, True])
def test_what_is_handled_is_on_the_disk_so_that_a_power_failure_does_not_undo_it(
    checkpoints: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_disk: dict[int, int] = {}

    def synced(descriptor: int) -> None:
        found = os.fstat(descriptor)
        on_disk[found.st_ino] = found.st_size

    monkeypatch.setattr(os, "fdatasync", synced)
    monkeypatch.setattr(os, "fsync", synced)
    folder = JournalFolder(tmp_path, "rover", WHO, CODEC)
    writer = folder.begin(folder.history() if checkpoints else None)
    assert tmp_path.stat().st_ino in on_disk, "the name of the file is on the disk"
    for now, each in inputs(8):
        writer.append(now, [each])
        found = (tmp_path / "rover-0001.mcap").stat()
        assert on_disk[found.st_ino] == found.st_size
    ended(writer)


def test_an_input_that_the_disk_refuses_is_not_accepted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_descriptor: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    writer = JournalFolder(tmp_path, "rover", WHO, CODEC).begin()
    monkeypatch.setattr(os, "fdatasync", refused)
    with pytest.raises(He3Error, match=r"rover-0001\.mcap: cannot write the journal: Input/output error"):
        writer.append(1, [TimerElapsed("a")])
    ended(writer)


@pytest.mark.parametrize("checkpoints", [False, True])
def test_nothing_is_accepted_once_the_journal_was_deleted(tmp_path: Path, checkpoints: bool) -> None:
    folder = JournalFolder(tmp_path, "rover", WHO, CODEC)
    writer = folder.begin(folder.history() if checkpoints else None)
    writer.append(1, [TimerElapsed("a")])
    (tmp_path / "rover-0001.mcap").unlink()
    with pytest.raises(InvalidInput, match=r"rover-0001\.mcap: the journal was deleted while"):
        writer.append(2, [TimerElapsed("b")])
    ended(writer)


@pytest.mark.parametrize(("number", "kind"), [(errno.ENOSPC, He3Error), (errno.EACCES, InvalidInput)])
def test_a_full_disk_is_no_bad_input_where_a_journal_begins(
    number: int, kind: type[He3Error], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("services.runtime.journal.open_output", refused)
    with pytest.raises(He3Error, match="cannot keep a journal there") as found:
        JournalFolder(tmp_path, "rover", WHO, CODEC).begin()
    assert type(found.value) is kind


def append_without_end(writer: JournalWriter) -> None:
    while True:
        writer.append(2000, [TimerElapsed("step")])


def test_a_checkpoint_that_cannot_be_written_leaves_the_journal_and_the_earlier_checkpoint_in_use(
    tmp_path: Path,
) -> None:
    folder = JournalFolder(tmp_path, "rover", WHO, CODEC)
    writer = folder.begin(folder.history())
    writer.checkpoint(STATE)
    for now, each in inputs(8):
        writer.append(now, [each])
    with files_no_longer_than((tmp_path / "rover-0001.mcap").stat().st_size):
        writer.checkpoint({"large": "x" * 10_000})
    ended(writer)
    assert folder.history().state == STATE
    assert same(folder.history().inputs, inputs(8))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rover-0001.mcap", "rover.checkpoint"]


def test_checkpoints_that_cannot_be_written_are_reported_once_for_each_spell(tmp_path: Path) -> None:
    folder = JournalFolder(tmp_path, "rover", WHO, CODEC)
    lines: list[str] = []
    writer = folder.begin(folder.history(), lines.append)
    large = {"large": "x" * 10_000}
    for spell in (3, 1):
        with files_no_longer_than(5_000):
            for _ in range(spell):
                writer.checkpoint(large)
        writer.checkpoint(large)
        writer.checkpoint(large)
    ended(writer)
    begins = (
        f"{tmp_path / 'rover.checkpoint'}: cannot write the checkpoint: File too large; "
        "the journal goes on without it, so a restart takes longer"
    )
    ends = f"{tmp_path / 'rover.checkpoint'}: the checkpoint is written again;"
    assert lines == [begins, f"{ends} 3 before it were not", begins, f"{ends} 1 before it were not"]


def test_a_later_checkpoint_replaces_an_earlier_one(tmp_path: Path) -> None:
    folder = checkpointed(tmp_path, before=7, after=5)
    writer = folder.begin(folder.history())
    writer.append(50, [ProcessStarted(2), TimerElapsed("a")])
    writer.checkpoint({"later": True})
    writer.append(60, [TimerElapsed("b")])
    ended(writer)

    history = folder.history()
    assert history.state == {"later": True}
    assert history.inputs == ((60, TimerElapsed("b")),)
    assert history.starts == 2


@pytest.mark.parametrize(
    ("spoil", "notice"),
    [
        ("cut", "it is damaged"),
        ("bit", "it is damaged"),
        ("pickle", "it is no checkpoint of this program"),
        ("state", "state: expected one that this program has encoded"),
        ("program", "it was written by another version of the program"),
        ("mission", "it is of another mission"),
    ],
)
def test_a_checkpoint_that_cannot_be_used_is_passed_over_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spoil: str, notice: str
) -> None:
    folder = checkpointed(tmp_path, before=7, after=5)
    checkpoint = tmp_path / "rover.checkpoint"
    content = checkpoint.read_bytes()
    expected = [(1, ProcessStarted(1)), *inputs(7), *inputs(5)]
    match spoil:
        case "cut":
            checkpoint.write_bytes(content[:-1])
        case "bit":
            checkpoint.write_bytes(content[:-9] + bytes([content[-9] ^ 1]) + content[-8:])
        case "pickle":
            checkpoint.write_bytes(sealed(pickle.dumps({"the": "state"})))
        case "state":
            checkpoint.write_bytes(sealed(content[4:].replace(b"$tuple", b"$apply")))
        case "program":
            monkeypatch.setattr(checkpoint_file, "program_digest", lambda: "f" * 64)
        case "mission":
            checkpoint.write_bytes(sealed(content[4:].replace(b'"mission": "m"', b'"mission": "n"')))
    history = folder.history()
    assert history.state is None
    assert history.notice.startswith(f"{checkpoint}: passed over: {notice}")
    assert "\n" not in history.notice
    assert same(history.inputs, expected)


@pytest.mark.parametrize("program", ["this", "another"])
@pytest.mark.parametrize("left", ["some", "none", "no file"])
def test_a_journal_shorter_than_its_checkpoint_knows_it_to_be_is_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, left: str, program: str
) -> None:
    folder = checkpointed(tmp_path, before=7, after=5)
    file = tmp_path / "rover-0001.mcap"
    match left:
        case "some":
            file.write_bytes(file.read_bytes()[:400])
        case "none":
            file.write_bytes(b"")
        case _:
            file.unlink()
    if program == "another":
        monkeypatch.setattr(checkpoint_file, "program_digest", lambda: "f" * 64)
    with pytest.raises(
        JournalDamaged, match=r"rover\.checkpoint: expected at least \d+ bytes in rover-0001\.mcap, got"
    ):
        folder.history()


def sealed(content: bytes) -> bytes:
    """A checkpoint file with that content, whose checksum is right."""
    return zlib.crc32(content).to_bytes(4, "little") + content


def test_a_journal_of_an_earlier_format_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journals, "FORMAT", "1")
    folder_with(tmp_path, inputs(3))
    monkeypatch.undo()
    with pytest.raises(InvalidInput, match="expected a journal of format 2, got one of 1"):
        JournalFolder(tmp_path, "rover", WHO, CODEC).history()


@pytest.mark.parametrize(
    ("error", "comes_back"),
    [
        (NoRoute("walled in"), NoRoute),
        (InvalidInput("expected more"), InvalidInput),
        (ZeroDivisionError("by zero"), He3Error),
    ],
)
def test_the_error_of_a_computation_comes_back_with_its_text(error: Exception, comes_back: type[He3Error]) -> None:
    back = decode_input(*encode_input(ComputationEnded("plan:1", None, error), CODEC), CODEC)
    assert isinstance(back, ComputationEnded)
    assert (type(back.error), str(back.error)) == (comes_back, str(error))


@pytest.mark.parametrize(
    ("channel", "data"),
    [
        ("deliver/tm/sample", b"{}"),
        ("message/no/topic", b"{}"),
        ("timer", b"\xff"),
        ("start", b"first"),
        ("unanswered", b'["q", "SHY", ""]'),
        ("checked_query/earth/link/set", b'7\n{"loss": 2.0}'),
        ("computation", pickle.dumps((1, None))),
    ],
)
def test_a_record_that_no_journal_holds_is_refused_in_one_line(channel: str, data: bytes) -> None:
    with pytest.raises(InvalidInput, match="expected") as refusal:
        decode_input(channel, data, CODEC)
    assert "\n" not in str(refusal.value)


class Counting:
    """A node that counts its timers, one every second."""

    interface = Interface("rover", ())
    state_types: tuple[type, ...] = ()
    functions: Mapping[str, Callable[..., object]] = {}

    def __init__(self) -> None:
        self.count = 0

    def checkpoint(self) -> dict[str, int]:
        return {"count": self.count}

    def restore(self, state: dict[str, int]) -> None:
        self.count = state["count"]

    def handle(self, event: object, now: int) -> list[SetTimer]:
        self.count += isinstance(event, TimerFired)
        return [SetTimer("tick", now + 1_000_000_000)]


def test_a_scheduler_restored_from_its_checkpoint_continues_where_it_was() -> None:
    journal = SimulatedJournal(WHO, CODEC)
    scheduler = NodeScheduler(Host(Counting(), "m"), InlineExecutor(), journal)
    scheduler.put((0, "", 0), ProcessStarted(1))  # type: ignore[arg-type]
    scheduler.run(0)
    while (wake := scheduler.next_wake()) is not None and scheduler.host._node.count < CHECKPOINT_EVERY + 50:  # type: ignore[attr-defined]
        scheduler.run(wake)
    assert journal.has_checkpoint
    later = journal.entries(since_checkpoint=True)
    assert 0 < len(later) < CHECKPOINT_EVERY

    again = NodeScheduler(Host(Counting(), "m"), InlineExecutor())
    again.replay(later, journal.state())
    assert again.host._node.count == CHECKPOINT_EVERY + 50  # type: ignore[attr-defined]
    assert again.next_wake() == scheduler.next_wake()
    assert again.last == scheduler.last


def test_a_state_that_lacks_a_part_is_refused_in_one_line() -> None:
    scheduler = NodeScheduler(Host(Counting(), "m"), InlineExecutor())
    state = scheduler.checkpoint()
    del state["host"]["sequences"]
    with pytest.raises(InvalidInput, match="rover: expected the state of this program, got one without 'sequences'"):
        NodeScheduler(Host(Counting(), "m"), InlineExecutor()).replay([], state)


@pytest.mark.parametrize("planner", ["tour"])
def test_a_mission_restarted_from_checkpoints_has_the_map_of_one_replayed_from_the_beginning(planner: str) -> None:
    world = World(21, InlineExecutor(), planner=planner)
    simulation = world.mission.simulation
    for hour in range(1, 5):
        simulation.run(until=world.scenario.start_ns + hour * 3600 * 10**9)
        for name in ("ground", "rover"):
            simulation.kill(name)
            world.revive()
    world.mission.run()
    kept = simulation._journals["ground"]
    assert any(each.has_checkpoint for each in kept)
    shown: Any = simulation.snapshots["ground"]
    replayed: Any = simulation.replayed_snapshot(world._built("ground"))

    assert shown.mean_ppb.tobytes() == replayed.mean_ppb.tobytes()
    assert shown.std_ppb.tobytes() == replayed.std_ppb.tobytes()
    assert shown.revision == replayed.revision
    assert small_region().grid.shape == shown.mean_ppb.shape


def test_with_a_checkpoint_a_restart_reads_only_the_end_of_a_long_journal(tmp_path: Path) -> None:
    folder = JournalFolder(tmp_path, "rover", WHO, CODEC)
    writer = folder.begin(folder.history())
    writer.append(0, [given for _, given in inputs(20_000)])
    began = time.process_time()
    assert len(folder.history().inputs) == 20_000
    without = time.process_time() - began
    writer.checkpoint(STATE)
    writer.append(1, [given for _, given in inputs(10)])
    ended(writer)
    began = time.process_time()
    assert len(folder.history().inputs) == 10
    assert time.process_time() - began < 0.2 * without


def test_a_reader_yields_every_record_of_a_file(tmp_path: Path) -> None:
    checkpointed(tmp_path, before=3, after=2)
    with (tmp_path / "rover-0001.mcap").open("rb") as stream:
        everything = list(JournalReader(stream, {**WHO, "node": "rover"}, "here"))
    assert len(everything) == 6


@pytest.mark.parametrize("begun", [0, 1, 20])
def test_a_reader_yields_what_a_running_process_had_written_when_it_began(tmp_path: Path, begun: int) -> None:
    path = folder_with(tmp_path, inputs(8))
    whole = path.read_bytes()
    ends = _record_ends(tmp_path / "again", inputs(8))
    path.write_bytes(whole[: ends[3] + begun])  # the process is in the middle of its fifth record
    with path.open("rb") as stream, path.open("ab") as writing:
        reading = iter(JournalReader(stream, {**WHO, "node": "rover"}, "here"))
        read = [next(reading)]
        writing.write(whole[ends[3] + begun :])
        writing.flush()
        assert len(read + list(reading)) == 4
