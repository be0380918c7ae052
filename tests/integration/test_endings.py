"""Services end in time, in order and without output, whenever they are told to."""

from __future__ import annotations

import random
import signal
import socket
import time

import pytest
from mcap.reader import make_reader

from schemas.topics import EARTH_CLOCK, GROUND_STATUS
from services.recorder.reader import Recording
from services.recorder.repair import repair
from tests.waiting import PATIENCE_S, until

ALL = ("recorder", "ground", "rover", "field", "link")
RATE = "2000"


@pytest.mark.parametrize(("number", "seed"), [(signal.SIGINT, 1), (signal.SIGTERM, 2)])
def test_services_that_are_still_starting_end_at_once(missions, number, seed):
    """Every service gets the signal at a random moment between its first line of code and its being ready."""
    moments = random.Random(seed)
    mission = missions("short", "--rate", RATE)
    mission.start(*ALL)
    for process in mission.processes.values():
        process.wait_for_handlers()
        time.sleep(moments.uniform(0.0, 0.6))
        process.send(number)
    assert {name: process.end() for name, process in mission.processes.items()} == dict.fromkeys(ALL, 0)


@pytest.mark.parametrize(
    ("number", "seed"), [(signal.SIGINT, 1), pytest.param(signal.SIGTERM, 2, marks=pytest.mark.exhaustive)]
)
def test_a_running_mission_ends_within_two_seconds_and_leaves_a_recording(missions, listen, tmp_path, number, seed):
    recording = tmp_path / "mission.mcap"
    mission = missions("short", "--rate", RATE)
    mission.start("recorder", flags=["--out", str(recording)])
    mission.start(*ALL[1:])
    mission.ready()
    listen(mission.client(), GROUND_STATUS).wait(lambda _, status: status.samples > 0)
    time.sleep(random.Random(seed).uniform(0.0, 1.0))  # somewhere in a round: it drives, drills, plans, reports
    assert mission.stop(number) == dict.fromkeys(ALL, 0)
    read = Recording(recording)
    topics = {message.topic.name for message in read.messages()}
    assert {"tm/sample", "tc/plan", "earth/ground/status", "earth/link/status"} <= topics
    assert read.whole, "a recorder that is asked to end finishes its file"


@pytest.mark.exhaustive
def test_a_recorder_that_is_started_again_keeps_what_it_had_recorded(missions, listen, tmp_path):
    recording = tmp_path / "mission.mcap"
    mission = missions("short", "--rate", "500")  # so that it lasts while a recorder starts
    mission.start("recorder", flags=["--out", str(recording)])
    mission.start(*ALL[1:])
    mission.ready()
    heard = listen(mission.client(), GROUND_STATUS)
    heard.wait(lambda _, status: status.samples > 0)
    mission["recorder"].kill()
    mission.start("recorder", flags=["--out", str(recording)])
    mission.ready("recorder")
    before = heard.heard[-1].body.samples  # on a busy machine the mission has gone on meanwhile
    heard.wait(lambda _, status: status.samples > before + 1)
    mission.stop()
    assert_repairable(tmp_path / "mission-1.mcap")
    for path in (tmp_path / "mission-1.mcap", recording):
        assert any(message.topic is GROUND_STATUS for message in Recording(path).messages()), path


def assert_repairable(path):
    """The recording that a killed recorder left has whole messages, and all of them once others can open it."""
    left = Recording(path)
    before = [message.payload for message in left.messages()]
    assert [gap.fault.at_end for gap in left.gaps] == [True]
    done = repair(path)
    assert (done.lost, done.kept) == ((), None)
    with path.open("rb") as stream:
        ours = [m.data for _, c, m in make_reader(stream, validate_crcs=True).iter_messages() if "topic" in c.metadata]
    assert sorted(ours) == sorted(before)
    assert [message.payload for message in Recording(path).messages()] == before


@pytest.mark.exhaustive
def test_a_recorder_that_is_killed_at_any_instant_leaves_a_recording_that_is_repaired(missions, tmp_path):
    recording = tmp_path / "mission.mcap"
    moments = random.Random(3)
    mission = missions("short", "--rate", "50", "--set", "rounds=100")
    mission.start(*ALL[1:])
    mission.ready(*ALL[1:])
    for _ in range(20):
        mission.start("recorder", flags=["--out", str(recording)])
        mission.ready("recorder")
        until(lambda: recording.stat().st_size > 20_000, "messages in the recording")
        time.sleep(moments.uniform(0.0, 1.0))  # somewhere between two flushes, in a chunk, in an overview of the map
        mission["recorder"].kill()
    left = [*(tmp_path / f"mission-{number}.mcap" for number in range(1, 20)), recording]
    for path in left:
        assert_repairable(path)


def test_services_that_get_two_signals_end(missions):
    mission = missions("short", "--rate", RATE)
    mission.start("link", "rover")
    mission.ready()
    for process in mission.processes.values():
        process.send(signal.SIGINT)
        process.send(signal.SIGTERM)
    assert {name: process.end() for name, process in mission.processes.items()} == {"link": 0, "rover": 0}


def test_a_rover_ends_in_time_when_its_link_has_just_been_killed(missions):
    mission = missions("short", "--rate", RATE)
    mission.start("link", "rover")
    mission.ready()
    mission["link"].kill()
    assert mission["rover"].stop(signal.SIGINT) == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_service_ends_in_time_while_it_waits_for_a_router_that_says_nothing(missions, number):
    """Something listens at the endpoint and never answers: Zenoh waits for it in a call that no signal interrupts."""
    with socket.create_server(("127.0.0.1", 0)) as mute:
        mission = missions("short")
        mission.moon = f"tcp/127.0.0.1:{mute.getsockname()[1]}"
        mission.start("rover")
        mute.settimeout(PATIENCE_S)
        connection, _ = mute.accept()
        with connection:
            assert mission["rover"].stop(number) == 0


def test_mission_time_begins_even_if_the_link_is_killed_while_it_waits_for_processes(missions, tmp_path):
    mission = missions("short", "--journal", str(tmp_path / "journal"))
    mission.start("link", flags=["--wait-for", "rover"])
    mission["link"].line("mission time waits")
    mission["link"].kill()
    mission.start("link", flags=["--wait-for", "rover"])
    mission["link"].line("mission time waits")
    mission.start("rover")
    mission["link"].line("mission time runs")


def test_mission_time_begins_if_the_link_waited_when_it_was_killed_and_is_told_to_wait_for_no_process(
    missions, tmp_path
):
    mission = missions("short", "--journal", str(tmp_path / "journal"))
    mission.start("link", flags=["--wait-for", "rover"])
    mission["link"].line("mission time waits")
    mission["link"].kill()
    mission.start("link")
    mission["link"].line("mission time runs")


def test_a_link_without_a_saved_clock_continues_where_the_other_processes_are(missions, listen):
    mission = missions("short", "--rate", "500")
    mission.start(*(name for name in ALL if name != "recorder"))
    mission.ready()
    heard = listen(mission.client(), GROUND_STATUS).wait(lambda _, status: status.samples > 0)
    mission["link"].kill()
    mission.start("link")
    mission["link"].line("had no saved clock (--journal); ")
    header, clock = mission.client(name="late").latest(EARTH_CLOCK)
    assert clock.anchor_mission_ns >= heard.header.made_at
    assert header.made_at >= heard.header.made_at
    later = listen(mission.client(name="last"), GROUND_STATUS)
    later.wait(lambda _, status: status.samples > heard.body.samples)
    mission.stop()
