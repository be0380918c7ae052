"""A recorded mission at an endpoint of its own is read by the client of running missions, over Zenoh."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.faults import small_region
from he3.errors import He3Error
from schemas.topics import GROUND_STATUS, STATE
from services.console.__main__ import main
from services.console.client.mission_client import MissionClient
from services.console.client.run_file import RunningMission, announced
from services.console.launch.endpoints import free_endpoints
from services.console.replay.mission import RecordedMission
from services.console.replay.serving import serving
from services.mission.mission_time import SECOND
from tests.unit.console.flown import HOUR_S, Flown
from tests.waiting import until


@pytest.fixture(scope="module")
def recorded(flown_with_faults: Flown) -> Iterator[RecordedMission]:
    with RecordedMission(flown_with_faults.path, small_region()) as mission:
        mission.jump(mission.begin_ns + round(1.5 * HOUR_S * SECOND))
        yield mission


@pytest.fixture(scope="module")
def client(recorded: RecordedMission) -> Iterator[MissionClient]:
    earth = free_endpoints().earth
    with serving(recorded, earth), MissionClient(earth, "faults") as client:
        yield client


def test_its_answers_are_those_of_the_recording_at_its_time(client: MissionClient, recorded: RecordedMission) -> None:
    assert client.now() == recorded.now_ns
    assert client.status() == recorded.session.latest(GROUND_STATUS)[1]
    assert client.point(40, 30) == recorded.point(40, 30)
    assert (client.layer("std").values == recorded.layer("std").values).all()
    assert client.track() == recorded.track()
    assert client.log() == recorded.log()
    assert client.commands() == recorded.commands()
    assert client.link() == recorded.link()
    assert client.set_interest() == recorded.set_interest()


def test_its_messages_come_at_the_pace_that_its_clock_is_set_to(
    client: MissionClient, recorded: RecordedMission
) -> None:
    state = client.state()
    assert state.rover is None, "nothing comes while time stands still"
    assert client.set_clock_rate(2000.0).rate == 2000.0
    until(lambda: state.rover is not None, "a report of the rover")
    assert client.set_clock_rate(0.0).rate == recorded.pace == 0.0
    until(lambda: state.rover == recorded.session.latest(STATE)[1], "the last report before time stood still")
    until(lambda: state.process_silent_s("ground") is not None, "a heartbeat")
    assert abs(state.time.now() - recorded.now_ns) < 2000.0 * SECOND, "a second of wall time at that pace"


def test_every_command_and_the_page_say_that_nothing_of_it_is_live(
    client: MissionClient, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert client.recording_note is None, "it is not announced"
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    served = RunningMission("faults", "", "", client.earth, os.getpid(), {}, recording="/runs/mission.mcap")
    said = "RECORDING: mission 'faults' is served from /runs/mission.mcap; nothing of it is live"
    with announced(served):
        with MissionClient() as found:
            assert found.recording_note == said
        assert capsys.readouterr().err == f"he3: {said}\n"
        assert main(["status"]) == 0
        printed = capsys.readouterr()
        assert printed.out.splitlines()[0] == "RECORDING  /runs/mission.mcap; nothing of it is live"
        assert printed.err == f"he3: {said}\n"
        assert main(["status", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["recording"] == "/runs/mission.mcap"


def test_it_is_not_commanded(client: MissionClient) -> None:
    for change in (
        lambda: client.command("pause"), lambda: client.set_link(loss=0.5), lambda: client.acknowledge_alarm("stale"),
        lambda: client.fork(),
    ):  # fmt: skip
        with pytest.raises(He3Error, match="expected a running mission, got a recording"):
            change()
