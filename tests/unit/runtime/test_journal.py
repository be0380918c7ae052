"""Journals and checkpoints: whatever is cut off, everything that was kept comes back, and a restart is where it was."""

from __future__ import annotations

import pickle
import time
from pathlib import Path
from typing import Any

import pytest

from benchmarks.faults import World, small_region
from he3.errors import InvalidInput
from schemas.link import LinkChange
from schemas.topics import BY_NAME, LINK_SET, SAMPLE, Topic, addressed
from services.runtime import journal as journals
from services.runtime.drivers.simulation import SimulatedJournal
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
    decode_input,
    encode_input,
)
from services.runtime.node import Interface, NoReply, SetTimer, TimerFired
from services.runtime.scheduler import CHECKPOINT_EVERY, InlineExecutor, NodeScheduler

WHO = {"mission": "m", "scenario": "s"}


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
    """The file of a journal that holds those inputs, of a process that ended without a word."""
    writer = JournalFolder(path, "rover", WHO).begin()
    for now, given in kept:
        writer.append(now, [given])
    ended(writer)
    return path / "rover-0001.mcap"


def ended(writer: JournalWriter) -> None:
    """What the end of its process does to a journal: the file is closed as it is."""
    writer._stream.close()


def same(some: Any, others: Any) -> bool:
    return [(now, encode_input(given)) for now, given in some] == [(now, encode_input(given)) for now, given in others]


@pytest.mark.parametrize("given", [given for _, given in inputs(8)], ids=lambda given: type(given).__name__)
def test_every_kind_of_input_comes_back_as_it_was(given: Input) -> None:
    back = decode_input(*encode_input(given))

    assert back == given


def test_a_journal_cut_at_every_byte_of_its_last_4_kb_gives_back_every_complete_record(tmp_path: Path) -> None:
    kept = inputs(60)
    path = folder_with(tmp_path, kept)
    whole = path.read_bytes()
    ends = _record_ends(tmp_path / "again", kept)
    assert ends[-1] == len(whole)

    history = JournalFolder(tmp_path, "rover", WHO).history()
    for length in range(len(whole) - 4096, len(whole) + 1):
        path.write_bytes(whole[:length])
        history = JournalFolder(tmp_path, "rover", WHO).history()
        complete = sum(end <= length for end in ends)
        assert len(history.inputs) == complete
        assert history.torn_bytes <= length - (ends[complete - 1] if complete else 0)
    assert same(history.inputs, kept)


def _record_ends(path: Path, kept: list[tuple[int, Input]]) -> list[int]:
    """Size of the file after each append."""
    writer = JournalFolder(path, "rover", WHO).begin()
    ends = []
    for now, given in kept:
        writer.append(now, [given])
        ends.append((path / "rover-0001.mcap").stat().st_size)
    ended(writer)
    return ends


def test_the_next_start_writes_a_file_of_its_own_behind_a_torn_one(tmp_path: Path) -> None:
    path = folder_with(tmp_path, inputs(20))
    path.write_bytes(path.read_bytes()[:-3])
    folder = JournalFolder(tmp_path, "rover", WHO)
    writer = folder.begin()
    writer.append(5000, [TimerElapsed("later")])
    ended(writer)
    history = folder.history()

    assert same(history.inputs[:19], inputs(19))
    assert history.inputs[19:] == ((5000, TimerElapsed("later")),)
    assert history.torn_bytes > 0


def test_a_damaged_record_in_the_middle_is_no_torn_tail_and_is_reported(tmp_path: Path) -> None:
    path = folder_with(tmp_path, inputs(20))
    content = bytearray(path.read_bytes())
    content[content.index(b'"a": "b"')] ^= 1
    path.write_bytes(content)
    with pytest.raises(JournalDamaged, match="rover-0001"):
        JournalFolder(tmp_path, "rover", WHO).history()


def test_the_journal_of_another_mission_is_refused(tmp_path: Path) -> None:
    folder_with(tmp_path, inputs(3))
    with pytest.raises(InvalidInput, match="expected a journal of scenario other, got one of s"):
        JournalFolder(tmp_path, "rover", {**WHO, "scenario": "other"}).history()


# --- checkpoints ----------------------------------------------------------------------------------------------------


def checkpointed(path: Path, before: int, after: int, *, starts: int = 1) -> JournalFolder:
    """A folder whose last file has a checkpoint between its inputs."""
    folder = JournalFolder(path, "rover", WHO)
    for number in range(1, starts + 1):
        writer = folder.begin(folder.history())
        writer.append(number, [ProcessStarted(number)])
        if number < starts:
            ended(writer)
    for now, given in inputs(before):
        writer.append(now, [given])
    writer.checkpoint(b"the state")
    for now, given in inputs(after):
        writer.append(now, [given])
    ended(writer)
    return folder


def test_after_a_checkpoint_only_later_inputs_are_read_and_no_start_is_forgotten(tmp_path: Path) -> None:
    folder = checkpointed(tmp_path, before=7, after=5, starts=3)
    history = folder.history()

    assert history.state == b"the state"
    assert same(history.inputs, inputs(5))
    assert history.starts == 3

    writer = folder.begin(history)
    writer.append(9, [ProcessStarted(4)])
    ended(writer)
    assert folder.history().starts == 4
    assert same(folder.history().inputs, [*inputs(5), (9, ProcessStarted(4))])


def test_a_later_checkpoint_takes_the_place_of_an_earlier_one(tmp_path: Path) -> None:
    folder = checkpointed(tmp_path, before=7, after=5)
    writer = folder.begin(folder.history())
    writer.append(50, [ProcessStarted(2), TimerElapsed("a")])
    writer.checkpoint(b"a later state")
    writer.append(60, [TimerElapsed("b")])
    ended(writer)

    history = folder.history()
    assert history.state == b"a later state"
    assert history.inputs == ((60, TimerElapsed("b")),)
    assert history.starts == 2


@pytest.mark.parametrize("spoil", ["cut", "bit", "program", "journal", "mission"])
def test_a_checkpoint_that_cannot_be_trusted_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spoil: str
) -> None:
    folder = checkpointed(tmp_path, before=7, after=5)
    checkpoint, file = tmp_path / "rover.checkpoint", tmp_path / "rover-0001.mcap"
    content = checkpoint.read_bytes()
    expected = [(1, ProcessStarted(1)), *inputs(7), *inputs(5)]
    match spoil:
        case "cut":
            checkpoint.write_bytes(content[:-1])
        case "bit":
            checkpoint.write_bytes(content[:-9] + bytes([content[-9] ^ 1]) + content[-8:])
        case "program":
            monkeypatch.setattr(journals, "_program", lambda: "f" * 64)
        case "journal":
            file.write_bytes(file.read_bytes()[:400])
        case "mission":
            (tmp_path / "other").mkdir()
            (tmp_path / "other" / "rover.checkpoint").write_bytes(content)
            other = {**WHO, "mission": "n"}
            assert JournalFolder(tmp_path / "other", "rover", other).history().inputs == ()
            return
    history = folder.history()
    assert history.state is None
    if spoil != "journal":
        assert same(history.inputs, expected)


class Counting:
    """A node that counts its timers, one every second."""

    interface = Interface("rover", ())

    def __init__(self) -> None:
        self.count = 0

    def handle(self, event: object, now: int) -> list[SetTimer]:
        self.count += isinstance(event, TimerFired)
        return [SetTimer("tick", now + 1_000_000_000)]


def test_a_seat_restored_from_its_checkpoint_goes_on_where_it_was() -> None:
    from services.runtime.host import Host

    journal = SimulatedJournal(WHO)
    scheduler = NodeScheduler(Host(Counting(), "m"), InlineExecutor(), journal)
    scheduler.put((0, "", 0), ProcessStarted(1))  # type: ignore[arg-type]
    scheduler.run(0)
    while (wake := scheduler.next_wake()) is not None and scheduler.host._node.count < CHECKPOINT_EVERY + 50:  # type: ignore[attr-defined]
        scheduler.run(wake)
    assert journal.state is not None
    later = journal.entries(since_checkpoint=True)
    assert 0 < len(later) < CHECKPOINT_EVERY

    again = NodeScheduler(Host(Counting(), "m"), InlineExecutor())
    again.replay(later, journal.state)
    assert again.host._node.count == CHECKPOINT_EVERY + 50  # type: ignore[attr-defined]
    assert again.next_wake() == scheduler.next_wake()
    assert again.last == scheduler.last


@pytest.mark.parametrize("topic", [*BY_NAME.values(), addressed(SAMPLE, "somebody")], ids=lambda topic: topic.name)
def test_a_topic_of_the_table_comes_back_from_a_pickle_as_itself(topic: Topic) -> None:
    back = pickle.loads(pickle.dumps(topic))

    assert back == topic
    assert (back is topic) == (topic.name in BY_NAME)


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
    assert any(each.state is not None for each in kept)
    shown: Any = simulation.snapshots["ground"]
    replayed: Any = simulation.replayed_snapshot(world._built("ground"))

    assert shown.mean_ppb.tobytes() == replayed.mean_ppb.tobytes()
    assert shown.std_ppb.tobytes() == replayed.std_ppb.tobytes()
    assert shown.revision == replayed.revision
    assert small_region().grid.shape == shown.mean_ppb.shape


def test_a_long_journal_costs_a_restart_no_more_than_its_last_part(tmp_path: Path) -> None:
    folder = JournalFolder(tmp_path, "rover", WHO)
    writer = folder.begin(folder.history())
    writer.append(0, [given for _, given in inputs(20_000)])
    began = time.process_time()
    assert len(folder.history().inputs) == 20_000
    without = time.process_time() - began
    writer.checkpoint(b"state")
    writer.append(1, [given for _, given in inputs(10)])
    ended(writer)
    began = time.process_time()
    assert len(folder.history().inputs) == 10
    assert time.process_time() - began < 0.2 * without


def test_a_reader_begins_where_it_is_told_to(tmp_path: Path) -> None:
    checkpointed(tmp_path, before=3, after=2)
    with (tmp_path / "rover-0001.mcap").open("rb") as stream:
        everything = list(JournalReader(stream, {**WHO, "node": "rover"}, "here"))
    assert len(everything) == 6
