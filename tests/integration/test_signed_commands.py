"""Signed commands in a real mission: who holds the link or the ground's keys still commands nothing."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import pytest

from he3.errors import He3Error
from schemas.codec import body_of, decode, encode
from schemas.commands import CommandKind, Telecommand
from schemas.roles import Role
from schemas.signing import Part
from schemas.topics import COMMAND, LINK_SET, Side
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import Endpoints, free_endpoints
from services.console.launch.keys import issue_for_processes
from services.console.launch.launcher import Launcher
from services.mission.mission_time import SECOND
from services.runtime.transport.opening import open_client
from services.runtime.trust.audit import file_lines, rows, verify
from services.runtime.trust.authority import IDENTITY_VALID_FOR, Authority
from services.runtime.trust.certificates import Subject
from services.runtime.trust.identity import load_identity
from services.runtime.trust.signing import Signer
from tests.processes import he3_here
from tests.waiting import until

MISSION = "short"
ROOT = Path(__file__).parents[2]
AUDITED = ("link", "rover", "ground")


class Site(NamedTuple):
    authority: Authority
    endpoints: Endpoints
    folder: Path

    def identity(self, role, name="main"):
        return load_identity(self.authority.folder_of(Subject(role, name)))

    def signer(self, role, name="main", instance="run-1"):
        identity = self.identity(role, name)
        return Signer(identity.common_name, identity.key, instance)

    def audit(self, process):
        return self.folder / f"{process}.jsonl"

    def written(self, process, kind):
        return [row for row in rows(file_lines(self.audit(process))) if row["kind"] == kind]


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Iterator[Site]:
    folder = tmp_path_factory.mktemp("signed")
    authority = Authority.create(folder / "keys")
    people = ((Role.OPERATOR, "anna"), (Role.VIEWER, "anna"), (Role.CONTROLLER, "ben"))
    issue_for_processes(authority, IDENTITY_VALID_FOR)
    for role, name in people:
        authority.issue(Subject(role, name))
    endpoints = free_endpoints("tls")
    flags = {
        role.value: ["--identity", str(authority.folder_of(Subject(role, "main"))), "--instance", "run-1"]
        for role in (Role.LINK, Role.FIELD, Role.ROVER, Role.GROUND, Role.RECORDER)
    }
    for name in AUDITED:
        flags[name] += ["--audit", str(folder / f"{name}.jsonl")]
    scenario = ROOT / "deploy" / "scenarios" / f"{MISSION}.toml"
    slow = ("--rate", "20", "--set", "rover.analysis_s=100000.0")
    with Launcher(scenario, endpoints, slow, logs=folder, service_flags=flags) as launcher:
        viewer = authority.folder_of(Subject(Role.VIEWER, "launcher"))
        with MissionClient.when_up(endpoints.earth, MISSION, launcher.check, identity=viewer) as client:
            client.wait_for_ground(launcher.check)
        yield Site(authority, endpoints, folder)


def test_signed_commands_are_carried_out_and_everything_else_is_refused_with_its_line(site):
    anna = site.identity(Role.OPERATOR, "anna")
    with ExitStack() as ends:
        recorder = open_client(Side.EARTH, site.endpoints.earth, identity=site.identity(Role.RECORDER))
        ends.callback(recorder.close)
        uplink: list[bytes] = []
        held = recorder.declare_subscriber(COMMAND.key(MISSION), lambda s: uplink.append(s.payload.to_bytes()))
        client = ends.enter_context(MissionClient(site.endpoints.earth, MISSION, identity=anna.folder))
        issued = client.command("set_keep_out", area_id="rim", polygon_m=[(1, 1), (3, 1), (3, 3)])
        issued.wait("completed")
        assert issued.status.command.by == "operator.anna"
        assert [status.command.by for status in client.commands()] == ["operator.anna"]
        until(lambda: uplink, "the command on its way")
        del held

        # Who holds the link has what was sent, and both routers; here, the ground's keys as well.
        moon = open_client(Side.MOON, site.endpoints.moon, identity=site.identity(Role.LINK))
        ends.callback(moon.close)
        header, command = decode(COMMAND, uplink[0], MISSION)
        altered = Telecommand.model_validate_json(body_of(uplink[0]).replace(b'"rim"', b'"sim"'))
        now = client.now()
        ground, person, viewer = (
            site.signer(*who) for who in ((Role.GROUND,), (Role.OPERATOR, "anna"), (Role.VIEWER, "anna"))
        )
        safe = Telecommand(command_id="forged", kind=CommandKind.SAFE)
        hour = 3600 * SECOND
        otherwise = site.signer(Role.OPERATOR, "anna", "run-0")
        attempts = [
            (header.model_copy(update={"checksum": None}), altered, None, "altered, or forged"),
            (*numbered(header, 1, now, safe), ground, "expected the signature of role operator, got none"),
            (*numbered(header, 2, now, viewer.authorized(named(safe, "v"), MISSION, now, now + hour)), ground,
             "command v of viewer anna: expected role operator"),
            (*numbered(header, 3, now, person.authorized(named(safe, "r"), MISSION, now - 2 * hour, now - hour)),
             ground, "command r of operator anna: expired"),
            (*numbered(header, 4, now, otherwise.authorized(named(safe, "m"), MISSION, now, now + hour)), ground,
             "expected mission 'short', run run-1, got mission 'short', run run-0"),
            (*numbered(header, 5, now, person.authorized(named(safe, "o"), "other", now, now + hour)), ground,
             "command o: expected the signature of operator.anna over this very message"),
        ]  # fmt: skip
        for head, body, signer, line in attempts:
            sign = None if signer is None else lambda h, b, who=signer: who.signed(Part.MESSAGE, COMMAND.name, h, b)
            moon.put(COMMAND.key(MISSION), encode(head, body, sign))
            until(
                lambda line=line: any(line in row["why"] for row in site.written("rover", "refusal")),
                f"a line on the rover: {line}",
            )
        moon.put(COMMAND.key(MISSION), uplink[0])  # once more, bit for bit
        assert [row["what"] for row in site.written("rover", "command")] == [f"set_keep_out {command.command_id}"]
        assert len(site.written("rover", "refusal")) == len(attempts)


def test_the_page_of_a_viewer_and_a_stranger_change_nothing(site):
    viewer = site.identity(Role.VIEWER, "anna").folder
    with MissionClient(site.endpoints.earth, MISSION, identity=viewer) as client, pytest.raises(He3Error):
        client.command("safe")
    session = open_client(Side.EARTH, site.endpoints.earth, identity=site.identity(Role.CONTROLLER, "ben"))
    try:
        (reply,) = list(session.get(f"{LINK_SET.key(MISSION)}?up.loss=1", timeout=20.0))
        assert reply.ok is None, "unsigned, though the router lets a controller through"
    finally:
        session.close()


def test_a_change_of_link_and_clock_is_written_down_with_its_name(site):
    ben = site.identity(Role.CONTROLLER, "ben").folder
    with MissionClient(site.endpoints.earth, MISSION, identity=ben) as client:
        client.set_clock_rate(25.0)
    lines = site.written("link", "change")
    assert [(row["by"], row["verified"], row["topic"]) for row in lines] == [
        ("controller.ben", True, "earth/clock/set")
    ]


def test_every_audit_log_is_whole_and_signed(site):
    for name in AUDITED:
        verdict = verify(file_lines(site.audit(name)))
        assert verdict.fault is None
        checked = he3_here("audit", "verify", str(site.audit(name)), "--keys", str(site.authority.folder), "--json")
        assert checked.returncode == 0, checked.stderr
        assert json.loads(checked.stdout)["signed"] == verdict.lines > 0


def numbered(header, sequence, now, body):
    head = header.model_copy(
        update={"sequence": sequence, "made_at": now, "held_from": sequence, "checksum": None, "signature": None}
    )
    return head, body


def named(command, command_id):
    return command.model_copy(update={"command_id": command_id})
