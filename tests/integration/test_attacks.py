"""Attacks on real missions: none succeeds, and the report of each mission is that of one that was left alone.

Two missions stand in virtual time while a sample is under way. The one without keys is attacked by a program of the
same machine, with what is promised without keys. The one with keys is attacked over TLS by a stranger, and by holders
of every identity that may not do what they try; in it, names and numbers are as a genuine sender would choose them.

The undisturbed mission runs in one process. Compared are all fields of the reports but `driver`, `wall_time_s` and,
with keys, the bytes that crossed the link: signatures make messages longer.
"""

from __future__ import annotations

import http.client
import json
import re
import socket
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack, chdir
from pathlib import Path
from typing import Any

import pytest
import zenoh

from he3.errors import PeerUnreachable
from schemas.link import ClockState, DutyCycle
from schemas.refusal import decode_refusal
from schemas.report import MissionReport
from schemas.roles import Role
from schemas.topics import (
    ACK_DOWN,
    ACK_UP,
    BY_NAME,
    CLOCK_SET,
    COMMAND,
    EARTH_CLOCK,
    EARTH_POKE,
    EARTH_PRESENCE,
    EVENT,
    GROUND_STATUS,
    ISSUE_COMMAND,
    LINK_SET,
    MOON_CLOCK,
    MOON_PRESENCE,
    PLAN,
    SAMPLE,
    SET_INTEREST,
    STATE,
    TIME_CONTROL,
    TOPICS,
    Side,
    Topic,
    counted,
)
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import free_endpoints
from services.console.launch.in_process import run_in_process
from services.console.launch.keys import temporary_keys
from services.console.launch.scenarios import choose
from services.console.launch.separate import services_of
from services.console.launch.terrain_facts import terrain_facts
from services.console.report.mission_report import Run, gather
from services.console.report.outputs import Outputs
from services.console.report.progress import progress_for
from services.mission.mission_time import SECOND
from services.mission.regions import load_region
from services.runtime.log_limit import FIRST
from services.runtime.stamp import Stamp
from services.runtime.transport.opening import open_client
from services.runtime.trust.access_control import Right, allowed_keys
from services.runtime.trust.identity import Identity, load_identity
from tests.processes import he3, start
from tests.waiting import PATIENCE_S, until

MISSION = "short"
SMALL = ("rounds=2", "samples_per_round=2")
STANDS_BEFORE_S = 0.6
"""The missions stand so long [s] after the second measurement, whose sample is then half way to Earth."""
STANDSTILL = 1e-6
"""A pace at which a mission does not begin before it is told to [mission seconds per second]."""
ABSURD, HIGHEST = 2**62, 2**53 - 1

Change = Callable[[dict[str, Any], dict[str, Any]], None]
"""Changes header and body of a message."""


class Victim:
    """A mission that is attacked, as its owner and as its attacker see it."""

    def __init__(self, folder: Path | None, undisturbed: MissionReport, keys: Path | None, ends: ExitStack) -> None:
        """folder: of its files, logs and recording; None: it has none."""
        self.ends = ends
        self._keys = keys
        self.undisturbed = undisturbed
        self.asked: list[str] = []
        """The queries that reached a rival."""
        self.folder = folder
        self.chosen = choose(MISSION, settings=SMALL, keys=keys)
        where = Outputs(folder, None)
        free = free_endpoints("tcp" if keys is None else "tls")
        self.launcher, self.endpoints = ends.enter_context(
            services_of(self.chosen, where, free, lockstep=True, pace=STANDSTILL)
        )
        controller = None if keys is None else self.identity_folder("controller-demo")
        earth = self.endpoints.earth
        self.owner = ends.enter_context(MissionClient.when_up(earth, MISSION, self.launcher.check, identity=controller))
        self.state = self.owner.state(start_ns=self.chosen.scenario.start_ns)
        self.genuine: dict[str, bytes] = {}
        self.presence: dict[str, dict[str, int]] = {}
        for side, topics in (
            (Side.EARTH, (SAMPLE, EVENT, STATE, ACK_DOWN, COMMAND, PLAN, ACK_UP, EARTH_CLOCK, GROUND_STATUS)),
            (Side.MOON, (MOON_CLOCK,)),
        ):
            insider = self.session(side, None if keys is None else "link-main")
            listener = self.session(side, None if keys is None else ("recorder-main", "rover-main")[side is Side.MOON])
            for topic in topics:
                self.hear(listener, topic.key(MISSION), lambda sample, name=topic.name: self._keep(name, sample))
            heartbeats = EARTH_PRESENCE if side is Side.EARTH else MOON_PRESENCE
            self.hear(insider, heartbeats.key(MISSION), self._keep_presence)
        until(lambda: {"ground", "rover", "field", "link"} <= self.presence.keys(), "a sign of life of every process")
        first = next(each for each in undisturbed.sample_table[1:])
        stands_at = self.chosen.scenario.start_ns + round((first.measured_at_s + STANDS_BEFORE_S) * SECOND)
        self.owner.control_time(until=stands_at, unlimited=True)
        until(self._stands, lambda: f"standing time, got {self.owner.control_time()}")
        self.launcher.check()

    def _stands(self) -> bool:
        status = self.owner.control_time()
        return status.paused and not status.waits_for and status.next_at != status.now

    # --- what the attacker has ------------------------------------------------------------------------------------

    def identity_folder(self, name: str) -> Path:
        assert self._keys is not None
        return self._keys / "identities" / name

    def identity(self, name: str) -> Identity:
        return load_identity(self.identity_folder(name))

    def session(self, side: Side, identity: str | None = None) -> zenoh.Session:
        endpoint = self.endpoints.moon if side is Side.MOON else self.endpoints.earth
        session = open_client(side, endpoint, identity=None if identity is None else self.identity(identity))
        self.ends.callback(session.close)
        return session

    def hear(self, session: zenoh.Session, key: str, on_sample: Callable[[zenoh.Sample], None]) -> None:
        self.ends.callback(session.declare_subscriber(key, on_sample).undeclare)

    def _keep(self, name: str, sample: zenoh.Sample) -> None:
        self.genuine.setdefault(name, sample.payload.to_bytes())

    def _keep_presence(self, sample: zenoh.Sample) -> None:
        body = json.loads(sample.payload.to_bytes())["body"]
        self.presence[body["name"]] = {"refused": body["refused"], "defects": body["defects"]}

    def forged(self, topic: Topic, change: Change) -> bytes:
        """A genuine message of that topic, changed; without checksum, so that nobody finds it damaged."""
        tree = json.loads(self.genuine[topic.name])
        tree["header"].pop("checksum", None)
        change(tree["header"], tree["body"])
        return json.dumps(tree).encode("utf-8", "surrogatepass")

    # --- what becomes of it ---------------------------------------------------------------------------------------

    def refuses(self, process: str, payloads: list[tuple[zenoh.Session, Topic, bytes]]) -> None:
        """Publish these, and wait until that process has refused all of them."""
        before = self.presence[process]["refused"]
        for session, topic, payload in payloads:
            session.put(counted(topic).key(MISSION), payload, congestion_control=zenoh.CongestionControl.BLOCK)
        until(
            lambda: self.presence[process]["refused"] >= before + len(payloads),
            lambda: f"{process} to refuse {len(payloads)} messages, got {self.presence[process]['refused'] - before}",
            PATIENCE_S / 10,
        )
        assert self.presence[process] == {"refused": before + len(payloads), "defects": 0}

    def ends_as_if_nothing_had_been(self) -> None:
        self.launcher.check()
        self.owner.control_time(paused=False)
        state = self.state
        until(lambda: state.status is not None and state.status.is_over, lambda: f"the end, got {state.status}")
        scenario, status = self.chosen.scenario, state.status
        assert status is not None
        region = load_region(scenario.region, scenario.field.field_seed)
        run = Run(
            "in-process",
            None,
            region.provenance,
            state.status_time_s,
            0.0,
            region.layers,
            *terrain_facts(scenario, region),
        )
        report = gather(self.owner, scenario, status, run).report
        self.launcher.check()
        assert report.completed
        assert self._compared(report) == self._compared(self.undisturbed)
        assert all(each["defects"] == 0 for each in self.presence.values())

    def _compared(self, report: MissionReport) -> dict[str, Any]:
        tree = report.model_dump(exclude={"wall_time_s", "driver"})
        if self._keys is not None:
            for direction in ("up", "down"):
                del tree["messages"][direction]["bytes_delivered"]
        return tree


@pytest.fixture(scope="module")
def undisturbed() -> MissionReport:
    scenario = choose(MISSION, settings=SMALL).scenario
    return run_in_process(scenario, Outputs(None, None), progress_for("", "", quiet=True)).report


@pytest.fixture(scope="module")
def plain(undisturbed: MissionReport, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Victim]:
    """The mission without keys, begun in a folder with modules that are not ours."""
    place = tmp_path_factory.mktemp("plain")
    for name in ("zstandard", "numpy", "zenoh", "pydantic"):
        (place / f"{name}.py").write_text(f"open({str(place / 'imported')!r}, 'w').close()\n")
    with ExitStack() as ends:
        with chdir(place):
            victim = Victim(place / "out", undisturbed, None, ends)
        yield victim


@pytest.fixture(scope="module")
def locked(undisturbed: MissionReport) -> Iterator[Victim]:
    """The mission with keys."""
    with ExitStack() as ends:
        keys = ends.enter_context(temporary_keys())
        yield Victim(None, undisturbed, keys, ends)


# --- without keys ---------------------------------------------------------------------------------------------------


def numbered(sequence: int) -> Change:
    """As if the source had sent so many messages, and would send none of them again."""
    return lambda header, _: header.update(sequence=sequence, held_from=sequence)


@pytest.mark.parametrize("number", [ABSURD, HIGHEST])
def test_a_sequence_that_its_source_cannot_have_reached_skips_no_message(plain: Victim, number: int) -> None:
    earth, moon = plain.session(Side.EARTH), plain.session(Side.MOON)
    down = [(earth, topic, plain.forged(topic, numbered(number))) for topic in (SAMPLE, EVENT)]
    plain.refuses("ground", down)
    plain.refuses("rover", [(moon, PLAN, plain.forged(PLAN, numbered(number)))])


def test_samples_and_a_status_of_a_stranger_are_no_samples_and_no_end(plain: Victim) -> None:
    def of_mallory(number: int) -> Change:
        def change(header: dict[str, Any], body: dict[str, Any]) -> None:
            header.update(source="mallory", sequence=number, held_from=0)
            body.update(sample_id=f"s{number}", helium3_ppb=1e6)

        return change

    def over(header: dict[str, Any], body: dict[str, Any]) -> None:
        header.update(source="mallory", made_at=header["made_at"] + 10**9)
        body.update(phase="completed")

    earth = plain.session(Side.EARTH)
    earth.put(GROUND_STATUS.key(MISSION), plain.forged(GROUND_STATUS, over))
    plain.refuses("ground", [(earth, SAMPLE, plain.forged(SAMPLE, of_mallory(number))) for number in range(9)])
    assert plain.owner.status().phase.value == "executing"


def command(kind: str, source: str, made_at: int) -> bytes:
    header = {"mission": MISSION, "source": source, "incarnation": 1, "sequence": 0, "made_at": made_at}
    return json.dumps({"header": header, "body": {"command_id": f"evil-{kind}", "kind": kind}}).encode()


def test_a_command_that_no_ground_has_sent_is_executed_from_neither_side(plain: Victim) -> None:
    forged = command("safe", "mallory", plain.owner.now())
    plain.refuses("link", [(plain.session(Side.EARTH), COMMAND, forged)])
    plain.refuses("rover", [(plain.session(Side.MOON), COMMAND, forged)])
    assert plain.owner.commands() == ()


@pytest.mark.parametrize("ahead_ns", [2 * 86_400 * SECOND, None])
def test_a_command_from_the_future_outdates_no_later_one(plain: Victim, ahead_ns: int | None) -> None:
    made_at = 2**63 - 1 if ahead_ns is None else plain.owner.now() + ahead_ns
    plain.refuses("rover", [(plain.session(Side.MOON), COMMAND, command("pause", "ground", made_at))])


def test_no_single_message_ends_a_process(plain: Victim) -> None:
    earth, moon = plain.session(Side.EARTH), plain.session(Side.MOON)
    surrogate = plain.forged(STATE, lambda header, _: header.update(source="\ud800"))
    plain.refuses("link", [(moon, STATE, surrogate)])
    plain.refuses("ground", [(earth, STATE, surrogate)])
    before = plain.owner.link().conditions
    for conditions in (
        {"windows": [{"opens_s": 0.0, "closes_s": 1e12}]},
        {"duty_cycle": {"period_s": 1e300, "contact_s": 1.0}},
        {"duty_cycle": {"period_s": 2e-9, "contact_s": 1e-9}},
    ):
        body = {"conditions": {**json.loads(before.model_dump_json()), "windows": [], **conditions}}
        header = {"mission": MISSION, "source": "mallory", "incarnation": 0, "sequence": 0, "made_at": 0}
        payload = json.dumps({"header": header, "body": body}).encode()
        (reply,) = earth.get(LINK_SET.key(MISSION), payload=payload, timeout=60.0)
        assert reply.err is not None
        assert "expected" in decode_refusal(reply.err.payload.to_bytes()).error or "should be" in str(reply.err.payload)
    assert plain.owner.link().conditions == before
    with pytest.raises(ValueError, match="period_s"):
        DutyCycle(period_s=2e-9, contact_s=1e-9)


def test_a_clock_at_the_end_of_time_stops_no_side(plain: Victim) -> None:
    def at_the_end(header: dict[str, Any], body: dict[str, Any]) -> None:
        body.update(anchor_mission_ns=2**63 - 1, epoch=7)

    with pytest.raises(ValueError, match="anchor_mission_ns"):
        ClockState.model_validate_json(json.dumps(json.loads(plain.forged(EARTH_CLOCK, at_the_end))["body"]))
    for side, topic, names in ((Side.EARTH, EARTH_CLOCK, ("ground",)), (Side.MOON, MOON_CLOCK, ("rover", "field"))):
        before = {name: plain.presence[name]["refused"] for name in names}
        plain.session(side).put(topic.key(MISSION), plain.forged(topic, at_the_end))
        for name in names:
            until(lambda name=name, before=before: plain.presence[name]["refused"] > before[name], f"{name} to refuse")


def test_neither_an_acknowledgement_of_the_unsent_nor_an_absurd_start_silences_a_sender(plain: Victim) -> None:
    earth = plain.session(Side.EARTH)

    def of_everything(header: dict[str, Any], body: dict[str, Any]) -> None:
        header.update(sequence=HIGHEST)
        body.update(stream=PLAN.name, source="ground", next_sequence=HIGHEST, gaps=[], last_sequence=None)

    absurd = plain.forged(STATE, lambda header, _: header.update(incarnation=ABSURD))
    plain.refuses("ground", [(earth, ACK_DOWN, plain.forged(ACK_DOWN, of_everything)), (earth, STATE, absurd)])


def test_a_flood_reaches_neither_the_link_s_queue_nor_its_log(plain: Victim) -> None:
    earth, moon = plain.session(Side.EARTH), plain.session(Side.MOON)
    letter = command("pause", "mallory", 0)
    plain.refuses("link", [(earth, COMMAND, letter)] * 10_000)
    plain.refuses("link", [(moon, SAMPLE, bytes(20_000_000))] * 12)
    poke = plain.forged(STATE, lambda header, _: header.update(source="mallory"))
    plain.refuses("link", [(earth, EARTH_POKE, poke)] * 1_000)
    assert plain.owner.link().down.dropped_queue_full == 0
    lines = (plain.folder / "logs" / "link.log").read_text().splitlines()
    shown = [line for line in lines if "refused" in line]
    assert len(shown) < 100
    for what in ("tc/command: expected a message of ground", "tm/sample: expected at most", EARTH_POKE.key(MISSION)):
        assert sum(what in line for line in shown) >= FIRST, "no flood buries the lines of another kind"


@pytest.fixture
def page(plain: Victim) -> Iterator[tuple[str, int, int]]:
    """Host, port and process id of a page that commands without a login."""
    where = ("--mission", MISSION, "--earth", plain.endpoints.earth)
    server = start(he3("web", "--port", "0", "--authority", *where), stderr=subprocess.PIPE, text=True)
    try:
        assert server.stderr is not None
        found = re.search(r"http://([\d.]+):(\d+)/", server.stderr.readline())
        assert found is not None
        yield found[1], int(found[2]), server.pid
    finally:
        server.kill()
        server.communicate()


def posted(page: tuple[str, int, int], document: object, **headers: str) -> int:
    """The status of that command, sent as the page sends it but for these headers."""
    own = f"{page[0]}:{page[1]}"
    sent = {"host": own, "origin": f"http://{own}", "content-type": "application/json", "x-he3-console": "1", **headers}
    connection = http.client.HTTPConnection(*page[:2], timeout=PATIENCE_S)
    connection.request("POST", "/api/command", json.dumps(document), sent)
    status = connection.getresponse().status
    connection.close()
    return status


def test_a_page_that_may_command_takes_neither_the_memory_nor_the_orders_of_others(
    plain: Victim, page: tuple[str, int, int]
) -> None:
    assert posted(page, {"kind": "pause", "expires_in_s": [1]}) == 400
    safe = {"kind": "safe"}
    assert posted(page, safe, host="evil.example") == 403
    assert posted(page, safe, origin="http://evil.example") == 403
    assert posted(page, safe, origin="null") == 403
    with ExitStack() as half_open:
        for _ in range(600):
            half = half_open.enter_context(socket.create_connection(page[:2]))
            half.sendall(b"POST /api/command HTTP/1.1\r\nhost: 127.0.0.1\r\ncontent-length: 100000\r\n")
        assert posted(page, {"kind": "pause", "expires_in_s": "soon"}) == 400, "it answers all the same"
    peak = re.search(r"^VmHWM:\s+(\d+) kB", Path(f"/proc/{page[2]}/status").read_text(), re.MULTILINE)
    assert peak is not None
    assert int(peak[1]) < 500_000
    assert plain.owner.commands() == ()


def test_what_a_message_says_cannot_steer_the_terminal_of_who_reads_the_log(plain: Victim) -> None:
    earth = plain.session(Side.EARTH)
    payload = plain.forged(STATE, lambda header, body: body.update({"\x1b[2J\nhe3 ground: all is well": 1}))
    plain.refuses("ground", [(earth, STATE, payload)])
    text = (plain.folder / "logs" / "ground.log").read_text()
    assert re.search(r"refused: .*tm/state", text)
    assert all(line.isprintable() for line in text.splitlines())
    assert not any(line.startswith("he3 ground: all is well") for line in text.splitlines())


def test_the_files_of_a_mission_are_its_owner_s_alone(plain: Victim) -> None:
    written = [path for path in plain.folder.rglob("*") if path.is_file()]
    assert len(written) > 3
    assert {path.stat().st_mode & 0o777 for path in written} == {0o600}


def test_no_module_of_the_working_directory_is_imported(plain: Victim) -> None:
    assert (plain.folder.parent / "zstandard.py").exists()
    assert not (plain.folder.parent / "imported").exists()


def test_the_mission_without_keys_ends_as_if_nothing_had_been(plain: Victim) -> None:
    plain.ends_as_if_nothing_had_been()


# --- with keys ------------------------------------------------------------------------------------------------------

INSIDERS = {
    Side.EARTH: ("viewer-launcher", "recorder-main", "operator-demo", "controller-demo"),
    Side.MOON: ("field-main", "rover-main"),
}
"""Who has an identity, and no right to what they try."""


def role_of(identity: str) -> Role:
    return Role(identity.partition("-")[0])


def settled(session: zenoh.Session) -> None:
    """Return when the router has handled what this session sent before."""
    assert list(session.get(f"he3/{MISSION}/settled", timeout=60.0)) == []


def plausible(header: dict[str, Any], body: dict[str, Any]) -> None:
    """The next message of its source, as far as anybody can tell, that does harm."""
    header["sequence"] += 1
    body |= {
        key: value
        for key, value in {
            "helium3_ppb": 1e6,
            "phase": "completed",
            "next_sequence": 1_000,
            "anchor_mission_ns": 8_204_803_200 * 10**9 - 1,
            "revision": 1_000,
        }.items()
        if key in body
    }


@pytest.mark.exhaustive
def test_a_stranger_gets_no_session(locked: Victim) -> None:
    for endpoint in (locked.endpoints.earth, locked.endpoints.earth.replace("tls/", "tcp/")):
        with pytest.raises(PeerUnreachable, match="no earth router"):
            open_client(Side.EARTH, endpoint)


@pytest.mark.exhaustive
@pytest.mark.parametrize(("side", "who"), [(side, who) for side, insiders in INSIDERS.items() for who in insiders])
def test_nobody_publishes_what_their_role_does_not(locked: Victim, side: Side, who: str) -> None:
    session, rights = locked.session(side, who), allowed_keys(side, MISSION)
    others = {key for each in rights.values() for key in each.get(Right.PUBLISH, ())}
    others -= set(rights[role_of(who)].get(Right.PUBLISH, ()))
    step = locked.owner.control_time().step
    for key in others:
        name = key.removeprefix(f"he3/{MISSION}/").removesuffix("/@counted")
        payload = locked.forged(BY_NAME[name] if name in locked.genuine else STATE, plausible)
        source = json.loads(payload)["header"]["source"]
        session.put(key, payload, attachment=Stamp(source, f"{source}.1.ab", 10**6, step, locked.owner.now()).encode())
    assert len(others) >= 10
    settled(session)
    assert locked.owner.status().phase.value == "executing"
    assert not locked.state.status.is_over


@pytest.mark.exhaustive
def test_who_holds_the_link_forges_no_telemetry_no_plan_and_no_acknowledgement(locked: Victim) -> None:
    for side, topics, process in (
        (Side.EARTH, (SAMPLE, EVENT, STATE, ACK_DOWN), "ground"),
        (Side.MOON, (PLAN, ACK_UP), "rover"),
    ):
        session = locked.session(side, "link-main")
        altered = [(session, topic, locked.forged(topic, plausible)) for topic in topics]

        def unsigned(header: dict[str, Any], body: dict[str, Any]) -> None:
            plausible(header, body)
            for name in ("signer", "signature", "instance"):
                header.pop(name)

        bare = [(session, topic, locked.forged(topic, unsigned)) for topic in topics]
        locked.refuses(process, altered + bare)


@pytest.mark.exhaustive
@pytest.mark.parametrize("who", ["viewer-launcher", "recorder-main", "operator-demo", "controller-demo"])
def test_nobody_changes_link_clock_or_pace_or_commands_by_an_unsigned_query(locked: Victim, who: str) -> None:
    session, before = locked.session(Side.EARTH, who), locked.owner.link().conditions
    stands = locked.owner.control_time()
    for topic, parameters in (
        (LINK_SET, "loss=1"),
        (CLOCK_SET, "rate=0"),
        (TIME_CONTROL, "paused=false"),
        (ISSUE_COMMAND, "command_id=x;kind=safe"),
        (SET_INTEREST, "area_id=x"),
    ):
        assert all(reply.ok is None for reply in session.get(f"{topic.key(MISSION)}?{parameters}", timeout=60.0))
    assert (locked.owner.link().conditions, locked.owner.commands()) == (before, ())
    after = locked.owner.control_time()
    assert (after.now, after.paused) == (stands.now, True)


@pytest.mark.exhaustive
def test_a_rival_that_claims_to_know_all_answers_is_asked_nothing(locked: Victim) -> None:
    """It stays until the mission is over, and could answer the rover and the report's queries."""

    def answer(who: str, query: zenoh.Query) -> None:
        locked.asked.append(f"{who}: {query.key_expr}")
        query.reply(query.key_expr, b"{}")
        query.drop()

    for side, insiders in INSIDERS.items():
        for who in insiders:
            session = locked.session(side, who)
            own = allowed_keys(side, MISSION)[role_of(who)].get(Right.ANSWER, ())
            for topic in TOPICS:
                key = topic.key(MISSION)
                if side in topic.sides and key not in own:
                    held = session.declare_queryable(key, lambda query, who=who: answer(who, query), complete=True)
                    locked.ends.callback(held.undeclare)
            settled(session)
    assert locked.owner.link().contact
    assert locked.owner.point(100.0, 100.0).samples > 0
    assert locked.asked == []


@pytest.mark.exhaustive
def test_the_mission_with_keys_ends_as_if_nothing_had_been(locked: Victim) -> None:
    locked.ends_as_if_nothing_had_been()
    assert locked.asked == []
