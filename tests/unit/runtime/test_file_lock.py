"""Locks on outputs: one owner at a time, named in the refusal, and gone with its process."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from he3.errors import He3Error, InvalidInput
from services.runtime.files.lock import FileLock, lock_beside

HOLD = """
import sys
from pathlib import Path
from services.runtime.files.lock import FileLock
lock = FileLock(Path(sys.argv[1]), "expected")
print("held", flush=True)
sys.stdin.read()
"""


def holder(path: Path) -> subprocess.Popen[str]:
    """A process that holds the lock until its standard input ends."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


def test_a_second_process_is_refused_in_one_line_that_names_the_first(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    with holder(path) as first:
        with pytest.raises(InvalidInput) as refusal:
            FileLock(path, "--out x: expected a folder that no other mission writes to")
        first.kill()
    assert re.fullmatch(
        rf"--out x: expected a folder that no other mission writes to, got one in use by process {first.pid} "
        r"since \d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC",
        str(refusal.value),
    )


def test_the_lock_of_a_killed_process_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    with holder(path) as first:
        first.kill()
    assert path.exists(), "a killed process leaves its lock file"
    with FileLock(path, "expected"):
        assert f"pid {os.getpid()} " in path.read_text()


def test_a_released_lock_leaves_no_file_and_can_be_taken_again(tmp_path: Path) -> None:
    for _ in range(2):
        with lock_beside(tmp_path / "new" / "report.json", "expected"):
            assert [each.name for each in (tmp_path / "new").iterdir()] == [".report.json.lock"]
        assert list((tmp_path / "new").iterdir()) == []


def test_of_many_that_take_and_release_a_lock_at_once_one_holds_it_at_a_time(tmp_path: Path) -> None:
    path, holding, most, taken = tmp_path / ".lock", [], [], []

    def take_often() -> None:
        for _ in range(300):
            try:
                with FileLock(path, "expected"):
                    holding.append(1)
                    most.append(len(holding))
                    holding.pop()
                    taken.append(1)
            except InvalidInput:
                continue

    threads = [threading.Thread(target=take_often) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert max(most) == 1
    assert len(taken) > 1


def test_a_place_without_room_for_a_lock_file_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(He3Error, match="file: cannot make the folder"):
        lock_beside(tmp_path / "file" / "report.json", "expected")
