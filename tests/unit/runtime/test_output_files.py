"""What a mission writes is for its owner alone, and goes through no link that another user could have planted."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from he3.errors import He3Error, InvalidInput
from services.console.report.mission_report import remove_part
from services.recorder.files import open_recording
from services.runtime.checkpoint_file import Checkpoint, Mark, write_checkpoint
from services.runtime.child import ROOT
from services.runtime.event_log import EventLog
from services.runtime.files.lock import FileLock
from services.runtime.files.output import open_output, replace_output, require_own, write_output


@pytest.fixture
def link(tmp_path: Path) -> tuple[Path, Path]:
    """A link, as planted in a shared folder, and the file of the victim that it names."""
    victim = tmp_path / "victim"
    victim.write_text("precious")
    planted = tmp_path / "planted"
    planted.symlink_to(victim)
    return planted, victim


def test_a_link_is_followed_by_no_kind_of_writing(link: tuple[Path, Path]) -> None:
    planted, victim = link
    for write in (
        lambda: write_output(planted, b"x"),
        lambda: open_output(planted, append=True),
        lambda: open_output(planted, new=True),
    ):
        with pytest.raises(OSError):
            write()
    with pytest.raises(InvalidInput, match="cannot write the event log"):
        EventLog(planted)
    with pytest.raises(He3Error, match="cannot make the lock file"):
        FileLock(planted, "expected")
    remove_part(planted)
    assert planted.is_symlink()
    assert victim.read_text() == "precious"


def test_a_recording_in_place_of_a_link_leaves_what_the_link_names(link: tuple[Path, Path]) -> None:
    planted, victim = link
    with open_recording(planted) as recording:
        recording.write(b"new")
    assert planted.read_bytes() == b"new"
    assert victim.read_text() == "precious"


def test_a_file_put_in_place_of_a_link_leaves_what_the_link_names(link: tuple[Path, Path]) -> None:
    planted, victim = link
    replace_output(planted, b"new")
    assert not planted.is_symlink()
    write_checkpoint(planted, {}, Checkpoint("m-0001.mcap", Mark(), 1, b""))
    assert victim.read_text() == "precious"
    assert sorted(path.name for path in planted.parent.iterdir()) == ["planted", "victim"]


def test_a_file_that_is_put_in_place_of_another_is_on_the_disk_before_and_its_name_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "clock.json"
    path.write_bytes(b"old")
    seen: list[tuple[int, bytes]] = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: seen.append((os.fstat(descriptor).st_ino, path.read_bytes())))
    replace_output(path, b"new")
    assert seen[:2] == [(path.stat().st_ino, b"old"), (tmp_path.stat().st_ino, b"new")]


def test_a_lock_file_with_a_second_name_is_left_alone(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious")
    os.link(victim, tmp_path / "lock")
    with pytest.raises(He3Error, match="cannot use the lock file: expected a file of this user with one name"):
        FileLock(tmp_path / "lock", "expected")
    assert victim.read_text() == "precious"


def test_a_file_of_another_user_is_not_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getuid", lambda: tmp_path.stat().st_uid + 1)
    with pytest.raises(OSError, match="of this user"):
        require_own(tmp_path.stat(), tmp_path)


def test_a_link_of_the_system_such_as_standard_output_is_followed() -> None:
    write = (
        "from pathlib import Path; from services.runtime.files.output import write_output; "
        "write_output(Path('/dev/stdout'), b'said')"
    )
    done = subprocess.run([sys.executable, "-c", write], capture_output=True, cwd=ROOT, check=False)
    assert done.stdout == b"said", done.stderr


def test_files_and_folders_of_a_command_are_for_their_owner_alone(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "services.console", "schemas", str(out)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, umask=0)
    assert stat.S_IMODE(out.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in out.iterdir()} == {0o600}
