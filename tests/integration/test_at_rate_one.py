"""A mission at rate 1, seen by operators and other clients: light times, changes of the link, bad input, restarts."""

from __future__ import annotations

import json
import re
import time
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

import pytest
import zenoh

from he3.errors import He3Error, PeerUnreachable
from schemas.commands import CommandKind, CommandStage, NoParameters, Telecommand
from schemas.ground import MissionPhase
from schemas.link import ClockChange, LinkChange
from schemas.maps import MapPointQuery
from schemas.topics import (
    BY_NAME,
    CLOCK_SET,
    COMMAND,
    COMMAND_STATUS,
    EARTH_CLOCK,
    EARTH_PRESENCE,
    GROUND_STATUS,
    ISSUE_COMMAND,
    LINK_SET,
    LINK_SHOW,
    LIST_COMMANDS,
    MAP_POINT,
    MOON_PRESENCE,
    Side,
)
from services.mission.mission_time import SECOND
from services.runtime.clock import mission_time
from services.runtime.transport.client import Client
from tests.waiting import PATIENCE_S, expect_within, until

SERVICES = ("rover", "recorder", "ground", "field")
"""All but the link, in an unusual order."""

_numbers = count(1)


@pytest.fixture(scope="module")
def mission(shared_missions, tmp_path_factory):
    """t1-paper at rate 1; its link is started last, and its mission time survives in a journal."""
    folder = tmp_path_factory.mktemp("rate-one")
    mission = shared_missions("t1-paper", "--journal", str(folder / "journal"))
    mission.start(*SERVICES, flags=["--out", str(folder / "mission.mcap")])
    for name in SERVICES:
        mission[name].line("still trying")
    mission.start("link")
    mission.ready()
    with mission.client(name="first") as client:
        until(lambda: answered(client), "the first map")
    return mission


def answered(client):
    """Whether there is a map to answer from."""
    with suppress(He3Error):
        return client.query(MAP_POINT, MapPointQuery(x=1.0, y=1.0))


@pytest.fixture
def earth(mission):
    """An operator's session."""
    with mission.client(name=f"operator-{next(_numbers)}") as client:
        yield client


@pytest.fixture
def ordinary_link(earth):
    """The link as the scenario has it, before and after."""
    ordinary = LinkChange(one_way_light_time_s=1.282)
    earth.query(LINK_SET, ordinary)
    yield
    earth.query(LINK_SET, ordinary)


@pytest.fixture
def moon(mission):
    """A session on the Moon, which receives the same messages as the rover."""
    with mission.client(Side.MOON, name=f"listener-{next(_numbers)}") as client:
        yield client


def command(client, kind=CommandKind.PAUSE, **more):
    """Issue a command with a new id at the ground; its first status."""
    return client.query(ISSUE_COMMAND, Telecommand(command_id=f"test-{next(_numbers)}", kind=kind, **more))


def passed(status, stage):
    """When the command passed that stage [ns of mission time]; None while it has not."""
    return next((report.at for report in status.stages if report.stage is stage), None)


@contextmanager
def time_stopped(client):
    """Mission time stands within, and goes on at rate 1 after it."""
    client.query(CLOCK_SET, ClockChange(rate=0.0))
    yield
    client.query(CLOCK_SET, ClockChange(rate=1.0))


# --- starting ---------------------------------------------------------------------------------------------------


def test_services_that_come_before_their_router_say_so_once_and_take_part_when_it_is_there(mission):
    for name in SERVICES:
        side = "moon" if name in ("rover", "field") else "earth"
        waiting = [line for line in mission[name].lines if "still trying" in line]
        assert len(waiting) == 1, mission[name].text
        assert f"no {side} router at {mission.moon if side == 'moon' else mission.earth}; still trying" in waiting[0]


def test_every_process_shows_that_it_lives_on_the_sides_where_it_stands(mission, earth, moon, listen):
    on_earth, on_moon = listen(earth, EARTH_PRESENCE), listen(moon, MOON_PRESENCE)
    for heard, names in ((on_earth, ("ground", "recorder", "link")), (on_moon, ("rover", "field", "link"))):
        for name in names:
            presence = heard.wait(lambda _, body, name=name: body.name == name).body
            assert presence.pid == mission[name].pid


# --- what operators ask -----------------------------------------------------------------------------------------


def test_a_stock_client_that_knows_only_the_key_is_told_mean_deviation_revision_and_time(mission):
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([mission.earth]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        (reply,) = session.get("he3/t1-paper/earth/map/point?x=120;y=340", timeout=PATIENCE_S)
        assert reply.ok is not None, reply.err.payload.to_bytes()
        assert str(reply.ok.encoding) == "application/json"
        answer = json.loads(reply.ok.payload.to_bytes())
        assert (answer["x_m"], answer["y_m"]) == (120.0, 340.0)
        assert answer["std_ppb"] > 0
        assert {"mean_ppb", "revision", "mission_time_ns", "samples", "traversable"} <= set(answer)

        for selector, expected in (
            ("point?x=120;y=9000", "expected a place within 0..500 m east and 0..500 m north, got (120, 9000)"),
            ("point?x=120", "y: field required"),
            ("point?x=120;y=340;z=1", "z: extra inputs are not permitted"),
            ("point?x=north;y=340", "x: input should be a valid number"),
            ("point?x=nan;y=340", "x: input should be"),
            ("point", "field required"),
            ("point?x=1e9;y=340", "x: input should be less than or equal to 100000"),
        ):
            (reply,) = session.get(f"he3/t1-paper/earth/map/{selector}", timeout=PATIENCE_S)
            error = json.loads(reply.err.payload.to_bytes())["error"]
            assert expected in error, selector
            assert "\n" not in error


def test_every_selector_that_the_page_on_the_wire_shows_is_answered(mission, earth, listen):
    told = listen(earth, COMMAND_STATUS)
    page = (Path(__file__).parents[2] / "docs" / "zenoh.md").read_text()
    selectors = re.findall(r"\| `(he3/\{mission\}/[^`]*)`", page.split("## Asking")[1].split("## Listening")[0])
    assert len(selectors) > 8
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([mission.earth]))
    try:
        with zenoh.open(config) as session:
            for selector in selectors:
                (reply,) = session.get(selector.replace("{mission}", mission.name), timeout=PATIENCE_S)
                assert reply.ok is not None, f"{selector}: {reply.err.payload.to_bytes()!r}"
                assert isinstance(json.loads(reply.ok.payload.to_bytes()), dict)
            status = earth.query(LINK_SET, LinkChange())
            assert status.conditions.up.one_way_light_time_s == 3.0
            assert (status.conditions.up.loss, status.conditions.down.loss) == (0.0, 0.3)
            assert earth.latest(EARTH_CLOCK)[1].rate == 10
    finally:
        earth.query(LINK_SET, LinkChange(one_way_light_time_s=1.282, loss=0.0))
        earth.query(CLOCK_SET, ClockChange(rate=1.0))
    # What follows must not have to wait for it: commands are handed up in the order in which they were sent.
    told.wait(lambda _, body: body.command.command_id == "mine-1" and passed(body, CommandStage.RECEIVED) is not None)


def test_a_client_tells_three_causes_of_no_answer_apart(earth):
    with pytest.raises(PeerUnreachable, match="the field does not answer"):
        earth.query(BY_NAME["moon/field/measure"], LinkChange())
    with pytest.raises(He3Error, match="field required"):
        earth.query(MAP_POINT, LinkChange())


def test_an_answer_of_another_version_is_an_error_in_one_line(mission):
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([mission.earth]))
    with zenoh.open(config) as stranger, Client(mission.earth, "newer") as client:
        stranger.declare_queryable(
            EARTH_CLOCK.key("newer"), lambda query: query.reply(query.key_expr, b'{"header":{"version":99},"body":{}}')
        )

        def said():
            try:
                return client.latest(EARTH_CLOCK)
            except PeerUnreachable:
                return None  # the router does not know the queryable yet
            except He3Error as error:
                return str(error)

        assert "expected schema version 1, got 99" in until(said, "an answer")


# --- light time -------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("ordinary_link")
def test_a_command_takes_its_light_time_and_a_change_of_it_holds_for_what_follows_at_once(mission, earth, moon, listen):
    arrived = listen(moon, COMMAND)
    told = listen(earth, COMMAND_STATUS)
    clock = earth.latest(EARTH_CLOCK)[1]
    for light_s in (1.282, 3.0, 0.2):
        status = earth.query(LINK_SET, LinkChange(one_way_light_time_s=light_s))
        assert status.conditions.up.one_way_light_time_s == light_s
        issued = command(earth).command.command_id
        message = arrived.wait(lambda _, body, issued=issued: body.command_id == issued)
        took_s = (mission_time(clock, message.wall_ns) - message.header.made_at) / SECOND
        assert light_s <= took_s
        expect_within(0.5, took_s - light_s, "what a command takes beyond its light time")

        def reported(_, body, issued=issued):
            return body.command.command_id == issued and passed(body, CommandStage.RECEIVED) is not None

        report = told.wait(reported)
        received_s = (passed(report.body, CommandStage.RECEIVED) - message.header.made_at) / SECOND
        there_and_back_s = (mission_time(clock, report.wall_ns) - message.header.made_at) / SECOND
        assert received_s >= light_s
        assert there_and_back_s >= 2 * light_s
        expect_within(0.5, received_s - light_s, "what the receipt takes beyond its light time")
        expect_within(1.0, there_and_back_s - 2 * light_s, "what the report takes beyond two light times")


@pytest.fixture
def slow_time(earth):
    """Mission time so slow that messages stay in flight, on any machine."""
    earth.query(CLOCK_SET, ClockChange(rate=0.05))
    yield
    earth.query(CLOCK_SET, ClockChange(rate=1.0))


@pytest.mark.usefixtures("ordinary_link", "slow_time")
def test_what_is_on_its_way_keeps_its_arrival_when_the_light_time_changes(earth, moon, listen):
    def commands_on_their_way():
        flights = earth.query(LINK_SET, LinkChange()).in_flight
        return {flight.sequence: flight for flight in flights if flight.topic == COMMAND.name}

    arrived = listen(moon, COMMAND)
    earth.query(LINK_SET, LinkChange(one_way_light_time_s=3.0))  # it arrives before it would be repeated
    earlier = commands_on_their_way()  # repetitions
    issued = command(earth).command.command_id
    sequence = until(lambda: max(commands_on_their_way().keys() - earlier.keys(), default=0), "the command to leave")
    flight = commands_on_their_way()[sequence]
    assert flight.departs_at + 3 * SECOND == flight.arrives_at
    earth.query(LINK_SET, LinkChange(one_way_light_time_s=60.0))
    earth.query(LINK_SET, LinkChange(one_way_light_time_s=0.1))
    earth.query(CLOCK_SET, ClockChange(rate=1.0))
    clock = earth.latest(EARTH_CLOCK)[1]
    message = arrived.wait(lambda _, body: body.command_id == issued)
    late_s = (mission_time(clock, message.wall_ns) - flight.arrives_at) / SECOND
    assert late_s >= 0
    expect_within(0.5, late_s, "what a command takes beyond its light time")


# --- bad input from outside -------------------------------------------------------------------------------------


def test_malformed_payloads_on_every_key_change_nothing_and_are_counted(mission, earth, moon, listen):
    presence = {Side.EARTH: listen(earth, EARTH_PRESENCE), Side.MOON: listen(moon, MOON_PRESENCE)}

    def refused(name, side):
        heard = [each.body for each in presence[side].heard if each.body.name == name]
        return heard[-1].refused if heard else 0

    services = {"rover": Side.MOON, "field": Side.MOON, "ground": Side.EARTH, "recorder": Side.EARTH}
    for name, side in services.items():
        presence[side].wait(lambda _, body, name=name: body.name == name)
    before = {name: refused(name, side) for name, side in services.items()}
    conditions = earth.query(LINK_SET, LinkChange()).conditions
    until(lambda: earth.latest(GROUND_STATUS)[1].phase is not MissionPhase.PLANNING, "the first plan")
    state = earth.latest(GROUND_STATUS)[1]
    commands = earth.query(LIST_COMMANDS, BY_NAME["earth/ground/commands"].payload())
    rubbish = (
        b"",
        b"\xff\xfe rubbish",
        b"[" * 100_000,
        b'{"header":{},"body":{}}',
        b'{"header":{"version":1,"mission":"other","source":"s","incarnation":1,"sequence":0,"made_at":1},"body":{}}',
        b'{"header":{"version":2,"mission":"t1-paper","source":"s","incarnation":1,"sequence":0,"made_at":1}}',
        b'{"x":NaN}',
        b"0" * 2_000_000,
    )
    for side, endpoint in ((Side.MOON, mission.moon), (Side.EARTH, mission.earth)):
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        with zenoh.open(config) as stranger:
            for topic in BY_NAME.values():
                if side not in topic.sides:
                    continue
                for payload in rubbish:
                    stranger.put(topic.key(mission.name), payload)
                    if topic.reply is not None and topic.name.split("/")[1] != "time":
                        replies = stranger.get(topic.key(mission.name), payload=payload, timeout=PATIENCE_S)
                        _is_refused(list(replies), topic)
    for name, side in services.items():
        if name == "field":
            continue  # it hears no messages; its questions were answered with refusals above
        presence[side].wait(lambda _, body, name=name: body.name == name and body.refused > before[name])
    assert earth.query(LINK_SET, LinkChange()).conditions == conditions
    after = earth.latest(GROUND_STATUS)[1]
    assert (after.samples, after.round, after.phase) == (state.samples, state.round, state.phase)
    assert earth.query(LIST_COMMANDS, BY_NAME["earth/ground/commands"].payload()) == commands
    assert all(process.running for process in mission.processes.values())
    told = listen(earth, COMMAND_STATUS)
    issued = command(earth).command.command_id
    told.wait(lambda _, body: body.command.command_id == issued and passed(body, CommandStage.ACCEPTED) is not None)


def _is_refused(replies, topic):
    assert replies, f"{topic.name}: no answer"
    for reply in replies:
        assert reply.err is not None, f"{topic.name}: accepted rubbish: {reply.ok.payload.to_bytes()[:200]!r}"
        line = json.loads(reply.err.payload.to_bytes())["error"]
        assert "\n" not in line
        assert topic.name in line
        assert len(line) < 500


# --- restarts ---------------------------------------------------------------------------------------------------


def test_services_find_a_restarted_link_again_by_themselves(mission, earth, listen):
    before = earth.latest(EARTH_CLOCK)[1]
    changed = earth.query(LINK_SET, LinkChange(duplicate=0.125, by="operator"))
    earth.close()
    mission["link"].kill()
    mission.start("link")
    mission.ready("link")
    with mission.client(name="after") as client, mission.client(Side.MOON, name="after") as moon:
        clock = client.latest(EARTH_CLOCK)[1]
        assert (clock.epoch, clock.revision) == (before.epoch, before.revision)
        now = time.time_ns()
        assert mission_time(clock, now) == pytest.approx(mission_time(before, now), abs=SECOND // 10)
        assert client.query(LINK_SHOW, NoParameters()).conditions == changed.conditions
        client.query(LINK_SET, LinkChange(duplicate=0.0))
        for listener, names in (
            (listen(client, EARTH_PRESENCE), ("ground", "recorder")),
            (listen(moon, MOON_PRESENCE), ("rover", "field")),
        ):
            for name in names:
                listener.wait(lambda _, body, name=name: body.name == name)
        told = listen(client, COMMAND_STATUS)
        issued = command(client).command.command_id
        told.wait(lambda _, body: body.command.command_id == issued and passed(body, CommandStage.ACCEPTED) is not None)


def test_a_killed_rover_and_a_killed_ground_go_on_where_they_were(mission, earth, listen):
    told = listen(earth, COMMAND_STATUS)
    issued = command(earth, CommandKind.RESUME).command.command_id
    over = {CommandStage.COMPLETED, CommandStage.REJECTED}
    told.wait(lambda _, body: body.command.command_id == issued and over & {each.stage for each in body.stages})
    with time_stopped(earth):  # commands of earlier tests go on otherwise
        commands = earth.query(LIST_COMMANDS, BY_NAME["earth/ground/commands"].payload())
        for name in ("rover", "ground"):
            mission[name].kill()
            mission.start(name)
        for name in ("rover", "ground"):
            assert "torn_bytes=" in mission[name].line("restarted from its journal")
            mission.ready(name)
        again = earth.query(LIST_COMMANDS, BY_NAME["earth/ground/commands"].payload())
        assert again == commands
    status = command(earth).command.command_id
    told.wait(lambda _, body: body.command.command_id == status and passed(body, CommandStage.ACCEPTED) is not None)
