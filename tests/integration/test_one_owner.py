"""Outputs and journals belong to one process at a time; a second one is refused and names the first."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from services.console.__main__ import main
from services.console.report.outputs import Outputs, claimed
from tests.waiting import until


def test_a_second_service_on_the_same_journal_is_refused_until_the_first_is_gone(missions, tmp_path):
    journal = ("--journal", str(tmp_path / "j"))
    first, second = missions("short"), missions("short")
    second.moon, second.earth = first.moon, first.earth
    first.start("link", "rover", flags=journal)
    first.ready()
    second.start("rover", flags=journal)
    assert second["rover"].end() == 2
    assert re.fullmatch(
        rf"he3 rover: --journal {re.escape(journal[1])}: expected a folder that no other rover uses, got one in use by "
        rf"process {first['rover'].pid} since [\d :-]+ UTC",
        second["rover"].text,
    )
    first["rover"].kill()
    second.start("rover", flags=journal)
    second["rover"].line("restarted from its journal")


def test_of_two_processes_of_one_role_the_second_is_refused_until_the_first_is_gone(missions, coarse_t1):
    first, second = (missions("short", "--set", f"region={coarse_t1}") for _ in range(2))
    second.moon, second.earth = first.moon, first.earth
    first.start("link", "ground", "field")
    second.start("field")  # at once
    first.ready("ground")
    fields = [first["field"], second["field"]]
    refused = until(lambda: next((each for each in fields if not each.running), None), "one field to be refused")
    (holder,) = (each for each in fields if each is not refused)
    assert refused.end() == 2
    only = "expected to be the only {} of mission 'short', got another one that takes part: process {} on "
    assert refused.text.splitlines()[-1].startswith(f"he3 field: {only.format('field', holder.pid)}")
    assert " ready" not in refused.text
    holder.line(" ready")

    second.start("ground")
    assert second["ground"].end() == 2
    assert only.format("ground", first["ground"].pid) in second["ground"].text

    holder.kill()
    second.start("field")
    second["field"].line(" ready")


@pytest.mark.parametrize(
    "words",
    [
        ["run", "short", "--in-process", "--out", "{out}"],
        ["run", "short", "--lockstep", "--out", "{out}"],
        ["run", "short", "--in-process", "--report", "{out}/report.json"],
        ["run", "short", "--in-process", "--events", "{out}/events.log"],
        ["up", "short", "--set", "network.moon={taken}", "--out", "{out}"],
        ["up", "short", "--set", "network.moon={taken}", "--journal", "{out}/journal"],
    ],
)
def test_a_mission_whose_outputs_are_in_use_is_refused_and_changes_nothing(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    held = claimed(Outputs(out, out / "report.json"), out / "events.log", out / "journal")
    with held, socket.create_server(("127.0.0.1", 0)) as other:
        taken = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        (out / "mission.mcap").write_bytes(b"theirs")
        (out / "report.json").write_bytes(b"theirs")
        assert main([word.format(out=out, taken=taken) for word in words]) == 2
        said = capsys.readouterr().err
        assert re.fullmatch(rf"he3: {words[-2]} .*: expected .*, got one in use by process \d+ since .*\n", said)
        kept = {
            path.name: path.read_bytes() for path in out.iterdir() if not path.name.startswith(".") and path.is_file()
        }
    assert kept == {"mission.mcap": b"theirs", "report.json": b"theirs"}


def test_a_second_recorder_of_one_file_is_refused(tmp_path: Path) -> None:
    from he3.errors import InvalidInput
    from services.recorder.files import open_recording

    with open_recording(tmp_path / "mission.mcap") as first:
        first.write(b"first")
        with pytest.raises(InvalidInput, match=r"mission\.mcap: expected a recording that no other process writes"):
            open_recording(tmp_path / "mission.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["mission.mcap"]
    assert (tmp_path / "mission.mcap").read_bytes() == b"first"


def test_a_run_after_one_that_was_killed_has_the_folder(tmp_path: Path) -> None:
    hold = (
        "import os, sys; from pathlib import Path\n"
        "from services.console.report.outputs import Outputs, claimed\n"
        "with claimed(Outputs(Path(sys.argv[1]), None)): os.kill(os.getpid(), 9)\n"
    )
    subprocess.run([sys.executable, "-c", hold, str(tmp_path)], check=False)
    assert (tmp_path / ".lock").exists()
    with claimed(Outputs(tmp_path, None)):
        pass
    assert not (tmp_path / ".lock").exists()
