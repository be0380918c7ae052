"""Whatever is wrong with a command line or a scenario: one line on standard error, exit code 2, nothing written."""

from __future__ import annotations

from pathlib import Path

import pytest

from services.console.__main__ import main

SCENARIO = """
name = "mine"
region = "t1"
[ground]
planner = "rrtstar"
[link.up]
loss = 0.0
"""

# What stands in mine.toml, the command line, and what the complaint must name.
CASES: dict[str, tuple[str, list[str], tuple[str, ...]]] = {
    "no such command": (SCENARIO, ["fly"], ("fly", "see he3 --help")),
    "no scenario": (SCENARIO, ["run"], ("SCENARIO", "see he3 run --help")),
    "no such flag": (SCENARIO, ["run", "mine.toml", "--fast"], ("--fast",)),
    "no such shipped scenario": (SCENARIO, ["run", "t3-nominal"], ("t3-nominal", "t1-paper")),
    "no such file": (SCENARIO, ["run", "other.toml", "--in-process"], ("other.toml",)),
    "a folder for a scenario": (SCENARIO, ["run", ".", "--in-process"], (".",)),
    "two drivers": (SCENARIO, ["run", "mine.toml", "--in-process", "--rate", "10"], ("--in-process", "--rate")),
    "a seed that is no number": (SCENARIO, ["run", "mine.toml", "--seed", "one"], ("--seed",)),
    "a negative seed": (SCENARIO, ["run", "mine.toml", "--seed", "-1", "--in-process"], ("seed", "-1")),
    "no such planner": (SCENARIO, ["run", "mine.toml", "--planner", "dijkstra"], ("planner", "dijkstra", "rrtstar")),
    "a rate of nothing": (SCENARIO, ["run", "mine.toml", "--rate", "0"], ("rate", "0")),
    "a rate that is not finite": (SCENARIO, ["run", "mine.toml", "--rate", "nan"], ("rate",)),
    "a setting without a value": (SCENARIO, ["run", "mine.toml", "--set", "ground.pipeline"], ("ground.pipeline",)),
    "a setting of nothing known": (SCENARIO, ["run", "mine.toml", "--set", "ground.engine=1"], ("ground.engine",)),
    "a setting out of range": (SCENARIO, ["run", "mine.toml", "--set", "link.up.loss=1.5"], ("link.up.loss", "1.5")),
    "no such region": (SCENARIO, ["run", "mine.toml", "--in-process", "--set", "region=t9"], ("t9", "t1")),
    "a region file that is not there": (
        SCENARIO, ["run", "mine.toml", "--in-process", "--set", "region=x.npz"], ("x.npz",),
    ),
    "a start outside the region": (
        SCENARIO, ["run", "mine.toml", "--in-process", "--out", "o", "--set", "start_m=[-5,3]"], ("start_m", "-5"),
    ),
    "a start outside the region, in lockstep": (
        SCENARIO, ["run", "mine.toml", "--lockstep", "--out", "o", "--set", "start_m=[-5,3]"], ("start_m", "-5"),
    ),
    "a start outside the region, on the wall clock": (
        SCENARIO, ["run", "mine.toml", "--rate", "10", "--out", "o", "--set", "start_m=[-5,3]"], ("start_m", "-5"),
    ),
    "services of a start outside the region": (
        SCENARIO, ["up", "mine.toml", "--out", "o", "--set", "start_m=[900,3]"], ("start_m", "900"),
    ),
    "a report that is a folder": (SCENARIO, ["run", "mine.toml", "--in-process", "--report", "."], ("--report",)),
    "an event log that is a folder": (SCENARIO, ["run", "mine.toml", "--in-process", "--events", "."], ("--events",)),
    "an event log below a file": (
        SCENARIO, ["run", "mine.toml", "--lockstep", "--events", "mine.toml/e"], ("--events",),
    ),
    "an output folder that is a file": (
        SCENARIO, ["run", "mine.toml", "--in-process", "--out", "mine.toml"], ("--out",),
    ),
    "an output folder below a file": (
        SCENARIO, ["run", "mine.toml", "--in-process", "--out", "mine.toml/x"], ("--out",),
    ),
    "an unknown key": (SCENARIO + "\n[rover]\nspeed = 3\n", ["run", "mine.toml"], ("mine.toml", "rover.speed")),
    "a wrong type": (SCENARIO.replace('"rrtstar"', "7"), ["run", "mine.toml"], ("mine.toml", "ground.planner", "7")),
    "text that is no TOML": ("name = ", ["run", "mine.toml"], ("mine.toml",)),
    "bytes that are no text": ("\udcff\udcfe", ["run", "mine.toml"], ("mine.toml",)),
    "a name that is no key": (SCENARIO.replace('"mine"', '"My Mission"'), ["run", "mine.toml"], ("mine.toml", "name")),
    "a start without a zone": ("start = 2030-01-01T00:00:00\n" + SCENARIO, ["run", "mine.toml"], ("start", "zone")),
    "no region at all": ('name = "mine"\n', ["run", "mine.toml"], ("mine.toml", "region")),
    "a region given twice": (
        SCENARIO.replace("[ground]", 'region = "t2"\n[ground]'), ["run", "mine.toml"], ("mine.toml",),
    ),
    "a recording that is not there": (SCENARIO, ["replay", "none.mcap"], ("none.mcap",)),
    "a recording that is none": (SCENARIO, ["replay", "mine.toml"], ("mine.toml",)),
    "no such topic": (SCENARIO, ["replay", "mine.toml", "--topic", "tm/nothing"], ("tm/nothing", "tm/sample")),
    "no such benchmark": (SCENARIO, ["bench", "speed"], ("speed",)),
    "no such region to show": (SCENARIO, ["reference", "show", "t9"], ("t9",)),
    "a region without a place to go": (SCENARIO, ["reference", "build", "t1", "--out", "no/t1.npz"], ("no/t1.npz",)),
    "a link that is changed in nothing": (SCENARIO, ["link", "set"], ("--loss",)),
    "a share above one": (SCENARIO, ["link", "set", "--loss", "2"], ("loss", "2")),
    "a contact that is neither": (SCENARIO, ["link", "set", "--contact", "maybe"], ("--contact", "maybe")),
    "no such layer": (SCENARIO, ["map", "show", "gold"], ("gold", "mean")),
    "an exceedance of nothing": (SCENARIO, ["map", "show", "exceedance"], ("--threshold",)),
    "a map of no time": (SCENARIO, ["map", "at", "1", "2", "--as-of", "yesterday"], ("as_of", "yesterday")),
    "a place that is no number": (SCENARIO, ["map", "at", "here", "3"], ("X", "number")),
    "an export of unknown kind": (SCENARIO, ["map", "export", "map.xyz"], (".xyz", ".npz")),
    "a keep-out of two corners": (SCENARIO, ["command", "keep-out", "a", "1,1", "2,2"], ("polygon", "3")),
    "a corner that is none": (SCENARIO, ["command", "keep-out", "a", "1;1"], ("1;1",)),
    "an expiry that is past": (SCENARIO, ["command", "pause", "--expires-in", "-5"], ("--expires-in", "-5")),
    "an area of one corner": (SCENARIO, ["map", "resource", "100,100"], ("three corners", "1")),
    "an endpoint that is none": (SCENARIO, ["status", "--earth", "foo"], ("--earth", "PROTO/HOST:PORT", "foo")),
    "an endpoint without a port": (
        SCENARIO, ["status", "--mission", "m", "--earth", "tcp/moon"], ("--earth", "PROTO/HOST:PORT", "tcp/moon"),
    ),
    "no such stage": (SCENARIO, ["command", "pause", "--wait", "soon"], ("soon", "completed")),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_one_line_and_exit_code_2_and_nothing_is_written(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    text, arguments, names = CASES[case]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path.parent))
    scenario = tmp_path / "mine.toml"
    scenario.write_bytes(text.encode("utf-8", "surrogateescape"))

    code = main(arguments)

    said = capfd.readouterr()
    assert said.out == ""
    lines = said.err.splitlines()
    assert len(lines) == 1, said.err
    assert lines[0].startswith("he3: ")
    assert all(name in lines[0] for name in names), lines[0]
    assert code == 2
    assert list(tmp_path.iterdir()) == [scenario]


def test_a_mission_that_does_not_run_is_a_failure_and_not_bad_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert main(["map", "at", "1", "2"]) == 1
    assert capfd.readouterr().err.startswith("he3: no running mission found")


def test_an_endpoint_without_a_mission_is_a_failure_that_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert main(["status", "--earth", "tcp/127.0.0.1:9"]) == 1
    assert capfd.readouterr().err.startswith("he3: nobody answers at tcp/127.0.0.1:9: ")
