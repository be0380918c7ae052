"""``he3 up --lockstep`` and ``he3 time``: an operator controls virtual time from the shell."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.processes import he3_here, start
from tests.waiting import until

HE3 = [sys.executable, "-m", "services.console"]
SECOND = 1_000_000_000
START = 1893456000 * SECOND
SHORTER = ("--set", "rounds=1", "--set", "samples_per_round=2")


class Up:
    """A mission that is up, and the commands of its operator."""

    def __init__(self, environment: dict[str, str], flags: list[str]) -> None:
        self._environment = environment
        self.process = start(
            [*HE3, "up", "short", "--quiet", *flags], stderr=subprocess.PIPE, text=True, env=environment
        )
        assert self.process.stderr is not None
        assert "is up" in self.process.stderr.readline()

    def he3(self, *words: str) -> subprocess.CompletedProcess[str]:
        return he3_here(*words, env=self._environment)

    def time(self, *words: str) -> dict[str, Any]:
        done = self.he3("time", *words, "--json")
        assert done.returncode == 0, done.stderr
        document: dict[str, Any] = json.loads(done.stdout)
        return document

    def until(self, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        def seen() -> dict[str, Any]:
            status = self.time("show")
            return status if wanted(status) else {}

        return until(seen, lambda: f"another status than {self.time('show')}")

    def end(self) -> None:
        self.process.send_signal(signal.SIGINT)
        self.process.communicate()


@pytest.fixture(scope="module")
def up(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    import socket

    with socket.socket() as moon, socket.socket() as earth:
        for each in (moon, earth):
            each.bind(("127.0.0.1", 0))
        ports = moon.getsockname()[1], earth.getsockname()[1]
    sets = [f"network.{side}=tcp/127.0.0.1:{port}" for side, port in zip(("moon", "earth"), ports, strict=True)]
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path_factory.mktemp("runtime"))}
    mission = Up(
        environment, ["--lockstep", "--rate", "20", *SHORTER, *(word for each in sets for word in ("--set", each))]
    )
    yield mission
    mission.end()


def test_a_mission_begins_at_the_pace_of_its_rate_and_can_be_paused_and_stepped(up: Up) -> None:
    assert up.time("show")["rate"] == 20.0
    paused = up.time("pause")
    assert paused["paused"]
    assert paused["now"] < START + 1800 * SECOND
    stands = up.until(lambda status: not status["waits_for"])
    up.time("step")
    stepped = up.until(lambda status: status["paused"] and not status["waits_for"])
    assert stepped["now"] == stands["next_at"]
    assert up.time("show")["now"] == stepped["now"]


def test_a_mission_runs_until_a_time_as_a_person_writes_it(up: Up) -> None:
    up.time("pause")
    up.time("unlimited")
    up.time("until", "30min")
    assert up.until(lambda status: status["paused"])["now"] == START + 1800 * SECOND
    up.time("until", "2030-01-01T00:45:00")
    assert up.until(lambda status: status["paused"])["now"] == START + 2700 * SECOND
    past = up.he3("time", "until", "30min")
    assert past.returncode == 2
    assert "expected a time from 2030-01-01T00:45:00Z on, the present one, got 2030-01-01T00:30:00Z" in past.stderr


def test_the_commands_also_print_text_for_people(up: Up) -> None:
    up.time("pause")
    up.time("unlimited")
    said = up.he3("time", "show").stdout
    assert "since the mission's beginning" in said
    assert "paused; else as fast as possible" in said
    assert "field, ground, link, rover" in said


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("rate", "0"), "he3: Invalid value for 'R': expected above 0 up to 1000000000, got 0"),
        (
            ("until", "soon"),
            "he3: Invalid value for 'TIME': expected 90, 15min, 2h or 3d after the mission's",
        ),
        (("rate", "1e12"), "he3: Invalid value for 'R': expected above 0 up to 1000000000, got 1e+12"),
    ],
)
def test_a_bad_value_is_refused_in_one_line(up: Up, words: tuple[str, ...], line: str) -> None:
    done = up.he3("time", *words)
    assert done.returncode == 2
    assert done.stderr.startswith(line)
    assert done.stderr.count("\n") == 1


def test_a_mission_that_is_over_stands_and_goes_on_when_told_to(up: Up) -> None:
    up.time("unlimited")
    up.time("resume")
    over = up.until(lambda status: "ground" in status["finished"] and status["paused"])
    assert over["finished"]["ground"] == "2 of 2 samples are in the map"
    up.time("resume")
    assert up.until(lambda status: status["now"] > over["now"])["now"] > over["now"]
    up.time("pause")
