"""What a process has kept for its next start is read back only from files of its own user."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from he3.errors import InvalidInput
from services.link.kept_clock import keep, kept_clock
from services.link.kept_conditions import KeptConditions, kept_conditions
from services.mission.scenario import Scenario
from services.runtime.clock import started
from services.runtime.files.input import MAX_KEPT_BYTES, open_own, read_own
from services.runtime.inputs import ProcessStarted, TimerElapsed
from services.runtime.journal import JournalFolder
from services.runtime.kept_file import KeptFile, kept_file
from services.runtime.machine_time import this_machine
from services.runtime.state_codec import StateCodec

SCENARIO = Scenario(name="m", region="t1")

Damage = Callable[[Path], None]


@pytest.fixture
def given_away(monkeypatch: pytest.MonkeyPatch) -> Damage:
    """Makes a file that of another user."""

    def give(path: Path) -> None:
        if os.getuid() == 0:
            os.chown(path, 12_345, -1)
        else:
            monkeypatch.setattr(os, "getuid", lambda: path.stat().st_uid + 1)

    return give


def behind_a_link(path: Path) -> None:
    path.rename(path.with_name("elsewhere"))
    path.symlink_to("elsewhere")


def a_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


@pytest.fixture(params=["another user's", "a link", "a pipe"])
def damage(request: pytest.FixtureRequest, given_away: Damage) -> tuple[Damage, str]:
    """What another user can put in place of a file, and what the refusal says it is."""
    return {
        "another user's": (given_away, "expected a file of this user, got one of user"),
        "a link": (behind_a_link, "expected a file, got a symbolic link"),
        "a pipe": (a_pipe, "expected a file, got something else"),
    }[request.param]


def test_a_file_of_this_user_is_read_and_no_other(tmp_path: Path, damage: tuple[Damage, str]) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"mine")
    assert read_own(file) == b"mine"
    put, what = damage
    put(file)
    for read in (read_own, open_own):
        with pytest.raises(OSError, match=what):
            read(file)


def test_a_file_without_end_takes_no_memory(tmp_path: Path) -> None:
    file = tmp_path / "file"
    with file.open("wb") as stream:
        stream.truncate(MAX_KEPT_BYTES + 1)
    with pytest.raises(OSError, match=f"expected at most {MAX_KEPT_BYTES} bytes"):
        read_own(file)


def test_the_link_believes_no_conditions_of_another_s_making(tmp_path: Path, damage: tuple[Damage, str]) -> None:
    file = kept_file(tmp_path, "link")
    planted = KeptConditions(mission="m", of_scenario=SCENARIO.link, conditions=SCENARIO.link, contact_forced=False)
    KeptFile(file, pytest.fail).replace(planted, 0.0)
    assert kept_conditions(file, "m", SCENARIO.link) == planted
    put, what = damage
    put(file)
    with pytest.raises(InvalidInput, match=rf"link\.json: cannot read the kept conditions of the link: {what}"):
        kept_conditions(file, "m", SCENARIO.link)


def test_the_link_believes_no_clock_of_another_s_making(tmp_path: Path, damage: tuple[Damage, str]) -> None:
    file, machine = tmp_path / "clock.json", this_machine()
    keep(file, started(0, 1.0, machine.wall_ns()), machine, "m")
    kept_clock(file, machine, "m", 0)
    put, what = damage
    put(file)
    with pytest.raises(OSError, match=what):
        kept_clock(file, machine, "m", 0)


@pytest.mark.parametrize("name", ["rover-0001.mcap", "rover.checkpoint"])
def test_no_process_continues_from_a_journal_of_another_s_making(
    tmp_path: Path, name: str, damage: tuple[Damage, str]
) -> None:
    folder = JournalFolder(tmp_path, "rover", {"mission": "m", "scenario": "s"}, StateCodec({}))
    writer = folder.begin(folder.history())
    writer.append(1, [ProcessStarted(1)])
    writer.checkpoint({})
    writer.append(2, [TimerElapsed("step")])
    writer._stream.close()
    assert folder.history().starts == 1
    put, what = damage
    put(tmp_path / name)
    if put is a_pipe and name.endswith("checkpoint"):  # as if there were none: the journal has the whole history
        assert folder.history().state is None
        return
    if put is a_pipe:  # the checkpoint tells that the journal was longer
        what = "expected at least"
    with pytest.raises(InvalidInput, match=rf"rover\S+: (cannot read the journal: )?{what}"):
        folder.history()
