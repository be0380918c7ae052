"""Every error in a command line or a scenario: one line on standard error, exit code 2, nothing written."""

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
    "no such region to show": (SCENARIO, ["region", "show", "t9"], ("t9",)),
    "a region without a place to go": (SCENARIO, ["region", "build", "t1", "--out", "no/t1.npz"], ("no/t1.npz",)),
    "a link that is changed in nothing": (SCENARIO, ["link", "set"], ("--loss",)),
    "a share above one": (SCENARIO, ["link", "set", "--loss", "2"], ("loss", "2")),
    "a contact that is neither": (SCENARIO, ["link", "set", "--contact", "maybe"], ("--contact", "maybe")),
    "a table in two formats": (SCENARIO, ["map", "samples", "--csv", "--json"], ("--csv", "--json", "both")),
    "a path in two formats": (SCENARIO, ["map", "plan", "--csv", "--json"], ("--csv", "--json", "both")),
    "a log in two formats": (SCENARIO, ["log", "--csv", "--json"], ("--csv", "--json", "both")),
    "no such layer": (SCENARIO, ["map", "show", "gold"], ("gold", "mean")),
    "an exceedance of nothing": (SCENARIO, ["map", "show", "exceedance"], ("--threshold",)),
    "a map of no time": (SCENARIO, ["map", "at", "1", "2", "--as-of", "yesterday"], ("--as-of", "yesterday", "2030")),
    "a place that is no number": (SCENARIO, ["map", "at", "here", "3"], ("X", "number")),
    "an export of unknown kind": (SCENARIO, ["map", "export", "map.xyz"], (".xyz", ".npz")),
    "a keep-out of two corners": (SCENARIO, ["command", "keep-out", "a", "1,1", "2,2"], ("polygon", "3")),
    "an area of two corners": (SCENARIO, ["area", "add", "a", "1,1", "2,2"], ("polygon", "3")),
    "a kind of area that is none": (SCENARIO, ["area", "remove", "a", "--kind", "hill"], ("keep-out", "hill")),
    "a corner that is none": (SCENARIO, ["command", "keep-out", "a", "1;1"], ("1;1",)),
    "an expiry that is past": (SCENARIO, ["command", "pause", "--expires-in", "-5"], ("--expires-in", "-5")),
    "an area of one corner": (SCENARIO, ["map", "resource", "100,100"], ("3 corners", "1")),
    "an endpoint that is none": (SCENARIO, ["status", "--earth", "foo"], ("--earth", "PROTO/HOST:PORT", "foo")),
    "an endpoint without a port": (
        SCENARIO, ["status", "--mission", "m", "--earth", "tcp/moon"], ("--earth", "PROTO/HOST:PORT", "tcp/moon"),
    ),
    "an endpoint with a port out of range": (
        SCENARIO, ["status", "--mission", "m", "--earth", "tcp/127.0.0.1:99999"], ("--earth", "65535", "99999"),
    ),
    "a mission of a name that none can have": (SCENARIO, ["status", "--mission", "My"], ("--mission", "a-z", "My")),
    "a page on a port out of range": (SCENARIO, ["web", "--port", "99999"], ("--port", "0 to 65535", "99999")),
    "a page on a negative port": (SCENARIO, ["web", "--port", "-1"], ("--port", "0 to 65535", "-1")),
    "a page of a host that is a URL": (SCENARIO, ["web", "--allow-host", "http://x/"], ("--allow-host", "http://x/")),
    "a region's variation of a negative seed": (
        SCENARIO, ["region", "show", "t1", "--field-seed", "-1"], ("--field-seed", "0 or more", "-1"),
    ),
    "a scenario's variation of a negative seed": (
        SCENARIO, ["run", "mine.toml", "--in-process", "--set", "field.field_seed=-1"], ("field.field_seed", "-1"),
    ),
    "a scenario's variation of a region file": (
        SCENARIO,
        ["run", "mine.toml", "--in-process", "--set", "region=x.npz", "--set", "field.field_seed=1"],
        ("x.npz", "field seed"),
    ),
    "a benchmark of a negative seed": (SCENARIO, ["bench", "map", "--seed", "-1"], ("--seed", "0 or more", "-1")),
    "a variation of a region file": (
        SCENARIO, ["region", "show", "x.npz", "--field-seed", "1"], ("--field-seed", "x.npz", "t1 or t2"),
    ),
    "a rate above the largest": (SCENARIO, ["run", "mine.toml", "--rate", "1e6"], ("--rate", "100000", "1e+06")),
    "a demonstration at no rate": (SCENARIO, ["demo", "--rate", "-2"], ("--rate", "above 0", "-2")),
    "a place beyond every site": (SCENARIO, ["map", "at", "1e9", "0"], ("X", "-100000 to 100000", "1e+09")),
    "a threshold that is no number": (SCENARIO, ["map", "at", "1", "1", "--threshold", "nan"], ("--threshold", "nan")),
    "a threshold without exceedance": (SCENARIO, ["map", "show", "mean", "--threshold", "9"], ("--threshold", "mean")),
    "a drawing without width": (SCENARIO, ["map", "show", "mean", "--width", "0"], ("--width", "10 to 250", "0")),
    "a cell without a side": (
        SCENARIO, ["map", "box", "mean", "0", "0", "9", "9", "--resolution", "0"], ("--resolution", "above 0", "got 0"),
    ),
    "a probability of one": (SCENARIO, ["map", "resource", "--probability", "1"], ("--probability", "got 1")),
    "a cut-off that is no number": (SCENARIO, ["map", "resource", "--cutoff", "nan"], ("--cutoff", "nan")),
    "a feed of negative length": (SCENARIO, ["map", "follow", "--seconds", "-1"], ("--seconds", "0 to 86400", "-1")),
    "a light time that is negative": (SCENARIO, ["link", "set", "--light-time", "-1"], ("--light-time", "86400", "-1")),
    "a jitter that is not finite": (SCENARIO, ["link", "set", "--jitter", "inf"], ("--jitter", "86400", "inf")),
    "a data rate of nothing": (SCENARIO, ["link", "set", "--bit-rate", "0"], ("--bit-rate", "1 to 1e+12", "0")),
    "no such direction": (SCENARIO, ["link", "set", "--direction", "left"], ("--direction", "up, down", "left")),
    "no such edge": (SCENARIO, ["link", "set", "--at-edge", "jump"], ("--at-edge", "hold, drop", "jump")),
    "no such preset": (SCENARIO, ["link", "set", "--preset", "fog"], ("--preset", "nominal", "fog")),
    "an id with a space": (SCENARIO, ["command", "pause", "--id", "a b"], ("--id", "a b")),
    "an area without a name": (SCENARIO, ["command", "keep-out", ""], ("AREA", "letter or digit first")),
    "a wait of negative length": (SCENARIO, ["command", "pause", "--timeout", "-1"], ("--timeout", "0 to 86400", "-1")),
    "a corner that is a flag": (SCENARIO, ["command", "keep-out", "a", "--fast"], ("X,Y", "--fast")),
    "no step": (SCENARIO, ["time", "step", "0"], ("[N]", "1 to 1000000", "got 0")),
    "a time that is none": (SCENARIO, ["time", "until", "soon"], ("TIME", "15min", "soon")),
    "a time beyond all times": (SCENARIO, ["time", "until", "999999999d"], ("TIME", "2262", "999999999d")),
    "a speed of nothing": (SCENARIO, ["time", "rate", "0"], ("R", "above 0 up to 1000000000", "got 0")),
    "no region, by the former name of the command": (SCENARIO, ["reference", "show", "nowhere"], ("nowhere", "t1")),
    "a value of two lines": (SCENARIO, ["area", "remove", "a\nb\x1b[31m"], ("AREA", "letter or digit first", "--help")),
    "a name of two lines": (SCENARIO, ["command", "pause", "--as", "a\nb"], ("--as", "on one line")),
    "a name of nothing": (SCENARIO, ["command", "pause", "--as", ""], ("--as", "on one line")),
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
    assert capfd.readouterr().err.startswith("he3: no mission of this machine is at tcp/127.0.0.1:9; ")
