"""Run files: how commands find a mission that runs on this machine."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from he3.errors import He3Error, InvalidInput, PeerUnreachable
from services.console.client.run_file import RunningMission, announced, announced_as, find, folder, running_missions


@pytest.fixture(autouse=True)
def _runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def mission(name: str = "m", pid: int | None = None, earth: str = "tcp/127.0.0.1:1") -> RunningMission:
    return RunningMission(name, "m.toml", "tcp/127.0.0.1:2", earth, pid or os.getpid(), {"link": 1})


def test_a_running_mission_is_found_by_itself_by_name_and_by_endpoint_until_it_ends() -> None:
    with announced(mission()) as path:
        assert find() == ("tcp/127.0.0.1:1", "m")
        assert find(mission="m") == ("tcp/127.0.0.1:1", "m")
        assert find(earth="tcp/127.0.0.1:1") == ("tcp/127.0.0.1:1", "m")
        assert path.parent == folder()
    assert running_missions() == []


def test_flags_alone_are_enough_for_a_mission_on_another_machine() -> None:
    assert find("far", "tcp/10.0.0.2:7448") == ("tcp/10.0.0.2:7448", "far")


def test_with_several_missions_one_must_be_named() -> None:
    with announced(mission("a")), announced(mission("b", earth="tcp/127.0.0.1:3")):
        with pytest.raises(
            InvalidInput,
            match=r"expected one mission, got 2: choose one with --mission \('a' at tcp/127.0.0.1:1, 'b' at",
        ):
            find()
        assert find("b") == ("tcp/127.0.0.1:3", "b")


def test_of_a_mission_and_a_recording_of_one_name_the_recording_is_told_apart() -> None:
    recording = RunningMission("m", "m.mcap", "", "tcp/127.0.0.1:3", os.getppid(), {}, recording="/runs/m.mcap")
    with announced(mission()), announced(recording):
        with pytest.raises(InvalidInput, match=r"\('m' at tcp/127.0.0.1:1, 'm' at tcp/127.0.0.1:3, a recording\)"):
            find()
        assert announced_as("tcp/127.0.0.1:3", "m") == recording


def test_of_two_missions_of_one_name_the_endpoint_must_be_named() -> None:
    with announced(mission(pid=os.getpid())), announced(mission(pid=os.getppid(), earth="tcp/127.0.0.1:3")):
        for name in (None, "m"):
            with pytest.raises(InvalidInput, match="choose one with --earth"):
                find(name)
        assert find(earth="tcp/127.0.0.1:3") == ("tcp/127.0.0.1:3", "m")


def test_nobody_is_found_where_nothing_runs() -> None:
    with pytest.raises(PeerUnreachable, match="no running mission found"):
        find()
    with announced(mission("a")), pytest.raises(PeerUnreachable, match="no running mission 'b' found"):
        find("b")


def test_the_file_of_a_mission_whose_starter_was_killed_is_passed_over_and_removed() -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    with announced(mission(pid=ended.pid)) as path:
        assert running_missions() == []
        assert not path.exists()


def test_a_file_that_is_no_run_file_is_passed_over() -> None:
    (folder() / "x.json").write_text("{}")
    (folder() / "y.json").write_text("nonsense")
    assert running_missions() == []


def test_the_folder_is_this_user_s_alone() -> None:
    assert folder().stat().st_mode & 0o077 == 0


def test_without_a_runtime_folder_the_user_s_cache_has_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert folder() == tmp_path / "cache" / "he3-seeker"


@pytest.mark.parametrize("home", ["/proc/none", "/dev/null/home"])
def test_a_user_without_a_home_has_it_among_the_temporary_files(
    home: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", home)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    place = folder()
    assert place == tmp_path / f"he3-seeker-{os.getuid()}"
    assert place.stat().st_mode & 0o077 == 0
    place.rmdir()
    (tmp_path / "planted").mkdir()
    place.symlink_to(tmp_path / "planted")
    with pytest.raises(He3Error, match="expected a folder of this user, got a link"):
        folder()
    monkeypatch.setattr(tempfile, "tempdir", "/proc/none")
    with pytest.raises(He3Error, match="XDG_RUNTIME_DIR names another"):
        folder()


def test_a_folder_that_is_a_link_or_open_to_others_or_another_user_s_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "he3-seeker"
    (tmp_path / "theirs").mkdir(mode=0o700)
    place.symlink_to(tmp_path / "theirs")
    with pytest.raises(He3Error, match="expected a folder of this user"):
        folder()
    place.unlink()
    place.mkdir()
    place.chmod(0o770)
    with pytest.raises(He3Error, match="expected mode 0700, got 0770"):
        folder()
    place.chmod(0o700)
    monkeypatch.setattr(os, "getuid", lambda: place.stat().st_uid + 1)
    with pytest.raises(He3Error, match="expected a folder of this user"):
        folder()


def test_a_run_file_that_is_a_link_or_names_no_mission_is_passed_over(tmp_path: Path) -> None:
    with announced(mission("a")) as path:
        elsewhere = tmp_path / "elsewhere"
        path.rename(elsewhere)
        path.symlink_to(elsewhere)
        assert running_missions() == []
    with announced(mission("\x1b[2Jname")):
        assert running_missions() == []
