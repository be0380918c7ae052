"""A mission by the command line in separate processes over Zenoh: it ends by itself, and can be ended at any time."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from schemas.report import MissionReport
from services.recorder.reader import Recording
from services.runtime.child import ROOT
from tests.processes import he3_here, run, start
from tests.waiting import PATIENCE_S, expect_within, until

HE3 = [sys.executable, "-m", "services.console"]
GONE_WITHIN_S = 2.0
"""How long all processes of a mission may take to end, as promised."""


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    runtime = tmp_path / "runtime"
    runtime.mkdir()
    return {**os.environ, "XDG_RUNTIME_DIR": str(runtime)}


@contextmanager
def started(*words: str, environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    process = start([*HE3, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def he3(*words: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return run([*HE3, *words], env=environment)


def on_free_ports() -> list[str]:
    """Flags for `he3 up`, which listens where its scenario says: on a shared machine a mission may be there already."""
    ports = zip(("moon", "earth"), free_ports(), strict=True)
    return [word for side, port in ports for word in ("--set", f'network.{side}="tcp/127.0.0.1:{port}"')]


def services_of(process: subprocess.Popen[str], environment: dict[str, str]) -> dict[str, int]:
    """Process ids of the services, once they are announced."""
    folder = Path(environment["XDG_RUNTIME_DIR"]) / "he3-seeker"

    def announced() -> dict[str, int]:
        assert process.poll() is None, process.communicate()
        files = list(folder.glob("*.json"))
        services: dict[str, int] = json.loads(files[0].read_text())["services"] if files else {}
        return services

    return until(announced, "the mission to be announced")


def until_answered(environment: dict[str, str], *words: str) -> str:
    """What the command prints once it succeeds."""

    def answered() -> str | None:
        done = he3_here(*words, env=environment)
        return done.stdout if done.returncode == 0 else None

    said = until(answered, f"he3 {' '.join(words)} to succeed")
    assert said is not None
    return said


def alive(pids: dict[str, int]) -> list[str]:
    return [name for name, pid in pids.items() if Path(f"/proc/{pid}").exists()]


def test_a_mission_in_five_processes_ends_by_itself_with_every_sample_and_leaves_its_files(
    tmp_path: Path, environment: dict[str, str], coarse_t1: Path
) -> None:
    out = tmp_path / "out"
    settings = ["--set", "rounds=2", "--set", "samples_per_round=2", "--set", f"region={coarse_t1}"]
    done = he3("run", "short", "--rate", "2000", "--out", str(out), *settings, environment=environment)
    assert done.returncode == 0, done.stderr
    report = MissionReport.model_validate_json((out / "report.json").read_bytes())
    assert report.completed
    assert (report.driver, report.rate, report.samples) == ("zenoh", 2000.0, 4)
    assert report.messages.lost == 0
    assert {"report.json", "map.png", "rmse.png", "mission.mcap", "logs", "audit"} == {
        path.name for path in out.iterdir()
    }
    samples = {m.body.sample_id for m in Recording(out / "mission.mcap").messages() if m.topic.name == "tm/sample"}
    assert samples == {row.sample_id for row in report.sample_table}
    assert "RMSE" in done.stdout
    assert list((Path(environment["XDG_RUNTIME_DIR"]) / "he3-seeker").glob("*.json")) == []


@pytest.mark.exhaustive
def test_the_rest_of_a_running_mission_is_rehearsed_from_the_command_line(environment: dict[str, str]) -> None:
    with started("up", "short", "--rate", "20", "--quiet", *on_free_ports(), environment=environment) as process:
        services_of(process, environment)
        until_answered(environment, "map", "score")  # the ground is up
        against = ("--against", "abort-round; planner tour")
        forecast = json.loads(he3_here("rehearse", "--draws", "2", "--json", *against, env=environment).stdout)
        assert (forecast["bands"]["samples"]["median"], forecast["flights"][0]["completed"]) == (9.0, True)
        (other,) = forecast["against"]
        assert (other["name"], other["flights"][0]["completed"]) == ("abort-round; planner tour", True)
        assert other["more"]["driven_m"]["median"] != 0.0


def test_a_running_mission_answers_its_operator(tmp_path: Path, environment: dict[str, str], coarse_t1: Path) -> None:
    settings = [*on_free_ports(), "--set", f"region={coarse_t1}"]
    with started("up", "short", "--rate", "20", "--quiet", *settings, environment=environment) as process:
        pids = services_of(process, environment)
        until_answered(environment, "map", "score")  # the ground is up
        status = json.loads(until_answered(environment, "status", "--json"))
        assert status["mission"] == "short"
        assert {"link", "ground"} <= set(status["alive_on_earth"])
        assert status["clock"]["rate"] == 20.0

        point = json.loads(until_answered(environment, "map", "at", "120", "340", "--json"))
        assert (point["x_m"], point["y_m"]) == (120.0, 340.0)
        assert point["std_ppb"] > 0
        outside = he3_here("map", "at", "900", "1", env=environment)
        assert outside.returncode == 2
        assert outside.stderr.startswith("he3: map: expected a place within")
        astray = he3_here("command", "go-to", "9999", "1", env=environment)
        assert astray.returncode == 2
        assert astray.stderr == "he3: expected a target within 0..500 m east and 0..500 m north, got (9999, 1)\n"

        preview = json.loads(he3_here("command", "go-to", "130", "340", "--preview", "--json", env=environment).stdout)
        assert preview["drive_m"] > 0
        light_ns = round(1.282e9)
        assert preview["word_back_at"] - light_ns == preview["received_at"] == preview["at"] + light_ns
        assert he3_here("commands", env=environment).stdout == "no commands yet\n"

        changed = he3_here("link", "set", "--direction", "down", "--light-time", "2.5", "--json", env=environment)
        conditions = json.loads(changed.stdout)["conditions"]
        assert (conditions["down"]["one_way_light_time_s"], conditions["up"]["one_way_light_time_s"]) == (2.5, 1.282)
        said = he3_here("link", "set", "--loss", "0", env=environment).stdout
        assert said.startswith("mission 'short'\n"), "whoever changes something is told of which mission"

        picture = tmp_path / "std.png"
        assert he3_here("map", "show", "std", "--png", str(picture), env=environment).returncode == 0
        assert picture.read_bytes().startswith(b"\x89PNG")
        drawn = he3_here("map", "show", "traversable", "--width", "40", env=environment).stdout.splitlines()
        assert {len(line) for line in drawn[:-1]} == {40}
        table = tmp_path / "map.csv"
        assert he3_here("map", "export", str(table), env=environment).returncode == 0
        assert len(table.read_text().splitlines()) == 1 + 125 * 125

        patience = ("--timeout", str(PATIENCE_S))
        refused = he3_here("command", "resume", "--id", "r1", "--wait", "completed", *patience, env=environment)
        assert refused.returncode == 1
        assert re.fullmatch(r"he3: command r1: rejected: .+\n", refused.stderr), refused.stderr

        paused = he3_here("command", "pause", "--id", "p1", "--wait", "accepted", *patience, env=environment)
        assert paused.returncode == 0, paused.stderr
        assert paused.stdout.startswith("mission 'short'\n")
        listed = json.loads(he3_here("commands", "--json", env=environment).stdout)["commands"]
        assert [entry["command"]["command_id"] for entry in listed] == ["r1", "p1"]
        assert {"queued", "released", "received", "accepted"} <= {stage["stage"] for stage in listed[1]["stages"]}

        assert_ends(process, pids, signal.SIGINT, 130, "he3: interrupted")


@pytest.mark.parametrize(
    ("number", "after_s", "code", "last_line"),
    [
        pytest.param(signal.SIGINT, 0.0, 130, "he3: interrupted", marks=pytest.mark.exhaustive),
        (signal.SIGTERM, 0.7, 143, "he3: terminated"),
        (signal.SIGINT, 2.5, 130, "he3: interrupted"),
    ],
)
def test_a_mission_ends_at_any_moment_without_a_traceback(
    number: signal.Signals, after_s: float, code: int, last_line: str, environment: dict[str, str]
) -> None:
    with started("run", "short", "--rate", "100", "--quiet", environment=environment) as process:
        pids = services_of(process, environment)
        time.sleep(after_s)  # any moment is meant to do: this is no waiting for an event
        assert_ends(process, pids, number, code, last_line)


@pytest.mark.parametrize("victim", ["link", pytest.param("rover", marks=pytest.mark.exhaustive), "ground"])
def test_a_service_that_dies_is_named_and_the_others_are_ended(victim: str, environment: dict[str, str]) -> None:
    with started("run", "short", "--rate", "100", "--quiet", environment=environment) as process:
        pids = services_of(process, environment)
        until_answered(environment, "status")
        os.kill(pids[victim], signal.SIGKILL)
        killed_at = time.monotonic()
        _, said = process.communicate()
        took_s = time.monotonic() - killed_at
        expect_within(GONE_WITHIN_S, took_s, f"the end after the death of the {victim}", processes=2)
        assert process.returncode == 1
        # A line before it may say what was waited for while the services started.
        assert said.endswith(f"he3: the {victim} service ended by itself, killed by SIGKILL\n")
        assert alive(pids) == []


@pytest.mark.exhaustive
def test_a_mission_goes_on_without_a_recorder_that_dies_and_says_so(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    short = ("--set", "rounds=1", "--set", "samples_per_round=2")
    flags = ("--rate", "1000", "--quiet", "--json", "--out", str(tmp_path / "out"), *short)
    with started("run", "short", *flags, environment=environment) as process:
        pids = services_of(process, environment)
        until(
            lambda: json.loads(until_answered(environment, "status", "--json"))["mission_time_s"],
            "the mission to begin",
        )
        os.kill(pids["recorder"], signal.SIGKILL)
        output, said = process.communicate()
    assert process.returncode == 0, said
    report = MissionReport.model_validate_json(output)
    ended = "the recorder service ended by itself, killed by SIGKILL"
    incomplete = f"{tmp_path / 'out' / 'mission.mcap'}: not complete: {ended}"
    assert (report.samples, report.output_problems) == (2, (incomplete,))
    assert said.endswith(f"he3: {ended}; the mission continues without it\nhe3: {incomplete}\n")


@pytest.mark.exhaustive
def test_services_that_are_up_stay_up_without_a_recorder_that_dies_and_report_on_the_mission_when_it_is_over(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    changes = ("rounds=1", "samples_per_round=2", "ground.approval=operator")
    settings = [*on_free_ports(), *(word for setting in changes for word in ("--set", setting))]
    out = tmp_path / "out"
    with started(
        "up", "short", "--rate", "500", "--quiet", "--out", str(out), *settings, environment=environment
    ) as process:
        assert process.stderr is not None
        pids = services_of(process, environment)
        # On a busy machine it may first say that it still waits for the router.
        assert any("is up" in line for line in iter(process.stderr.readline, ""))
        os.kill(pids["recorder"], signal.SIGKILL)
        waits = json.loads(until_answered(environment, "plan", "revise", "200,300", "195,305", "--json"))["proposal"]
        assert [(each["x_m"], each["y_m"]) for each in waits["plan"]["samples"]] == [(200.0, 300.0), (195.0, 305.0)]
        assert json.loads(until_answered(environment, "plan", "approve", "--json")) == {"proposal": None}
        assert he3_here("plan", "send-back", env=environment).stderr.endswith("no plan waits for approval\n")
        ended = "he3: the recorder service ended by itself, killed by SIGKILL; the mission continues without it\n"
        over = (
            f"he3: mission 'short' is over (completed): wrote {out / 'report.json'}, {out / 'map.png'}, "
            f"{out / 'rmse.png'}; its services still answer\n"
        )
        assert {process.stderr.readline(), process.stderr.readline()} == {ended, over}
        assert MissionReport.model_validate_json((out / "report.json").read_text()).samples == 2
        until_answered(environment, "map", "score")
        assert "recorder" not in alive(pids)
        process.send_signal(signal.SIGINT)
        assert process.wait() == 130


def test_a_service_whose_input_is_bad_ends_its_starter_with_the_exit_code_of_bad_input(
    environment: dict[str, str], tmp_path: Path
) -> None:
    journals = tmp_path / "journals"
    journals.mkdir()
    (journals / "rover-0001.mcap").write_bytes(b"no journal of ours" * 99)
    flags = (*on_free_ports(), "--rate", "100", "--quiet", "--journal", str(journals))
    done = he3("up", "short", *flags, environment=environment)
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    *_, last = done.stderr.splitlines()
    assert last.startswith("he3: the rover service ended by itself, exit code 2: he3 rover: ")
    assert "rover-0001.mcap: expected a journal of this program, got other content" in last


@pytest.mark.exhaustive
def test_the_services_do_not_outlive_a_starter_that_was_killed(environment: dict[str, str]) -> None:
    with started("run", "short", "--rate", "100", "--quiet", environment=environment) as process:
        pids = services_of(process, environment)
        until_answered(environment, "status")
        process.kill()
        killed_at = time.monotonic()
        until(lambda: not alive(pids), "the services to end")
        took_s = time.monotonic() - killed_at
        expect_within(GONE_WITHIN_S, took_s, "the end of services without their starter", processes=2)
        assert he3("status", environment=environment).returncode == 1


def assert_ends(
    process: subprocess.Popen[str], pids: dict[str, int], number: signal.Signals, code: int, last_line: str
) -> None:
    told_at = time.monotonic()
    process.send_signal(number)
    _, said = process.communicate()
    expect_within(GONE_WITHIN_S, time.monotonic() - told_at, "the end of a mission", processes=2)
    assert process.returncode == code
    assert said.splitlines()[-1] == last_line
    assert "Traceback" not in said
    assert alive(pids) == []


def free_ports() -> tuple[int, int]:
    import socket

    with socket.socket() as one, socket.socket() as other:
        one.bind(("127.0.0.1", 0))
        other.bind(("127.0.0.1", 0))
        return one.getsockname()[1], other.getsockname()[1]


@pytest.mark.exhaustive
def test_no_process_of_a_mission_imports_a_module_that_lies_beside_the_user(
    environment: dict[str, str], tmp_path: Path
) -> None:
    """Also not what other packages try to import late, and not in the processes that the services start themselves."""
    folder = tmp_path / "shared"
    folder.mkdir()
    for name in ("zstandard", "random", "cbor2", "uvloop", "brotli", "orjson", "scipy", "PIL", "rasterio", "secrets"):
        trap = f"open({str(tmp_path / 'imported')!r}, 'a').write({name!r} + chr(10))\nraise ImportError({name!r})\n"
        (folder / f"{name}.py").write_text(trap)
    words = ["run", "short", "--lockstep", "--quiet", "--set", "rounds=1", "--out", str(tmp_path / "out")]
    done = run([*HE3, *words], env={**environment, "PYTHONPATH": f"{ROOT}{os.pathsep}"}, cwd=folder)
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "imported").exists()
    modes = {path.stat().st_mode & 0o077 for path in (tmp_path / "out").rglob("*")}
    assert modes == {0}
