"""Rights over real TLS: a router's rules, certificates that do not count, and a whole mission with keys."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import timedelta
from functools import partial
from typing import NamedTuple

import pytest
import zenoh

from he3.errors import He3Error, NotAllowed, PeerUnreachable
from schemas.codec import encode
from schemas.commands import CommandKind, Telecommand
from schemas.link import DirectionCounts, LinkConditions, LinkStatus
from schemas.roles import Role
from schemas.signing import Part
from schemas.topics import COMMAND, GROUND_STATUS, ISSUE_COMMAND, LINK_STATUS, PLAN, Side, liveliness_key
from schemas.wire import Header
from services.console.launch.endpoints import free_endpoints
from services.link.routers import guard_of
from services.runtime.transport.client import Client
from services.runtime.transport.opening import open_client, open_router
from services.runtime.trust.authority import Authority
from services.runtime.trust.certificates import Subject, utc_now
from services.runtime.trust.identity import Identity, load_identity
from services.runtime.trust.signing import Signer
from tests.processes import he3, run
from tests.waiting import until

MISSION = "m"


class Site(NamedTuple):
    """An Earth router with keys."""

    authority: Authority
    endpoint: str
    identities: dict[str, Identity]

    def session(self, ends: ExitStack, who: str) -> zenoh.Session:
        session = open_client(Side.EARTH, self.endpoint, identity=self.identities[who])
        ends.callback(session.close)
        return session


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Iterator[Site]:
    earlier = utc_now() - timedelta(days=2)
    folder = tmp_path_factory.mktemp("site") / "keys"
    Authority.create(folder, clock=lambda: earlier)
    authority = Authority(folder)
    roles = (Role.LINK, Role.GROUND, Role.RECORDER, Role.VIEWER, Role.OPERATOR)
    found = {role.value: load_identity(authority.issue(Subject(role, "a"))) for role in roles}
    found["revoked"] = load_identity(authority.issue(Subject(Role.OPERATOR, "gone")))
    authority.revoke(Subject(Role.OPERATOR, "gone"))
    old = Authority(folder, lambda: earlier).issue(Subject(Role.OPERATOR, "old"), timedelta(days=1))
    found["expired"] = load_identity(old, earlier)
    foreign = Authority.create(folder.parent / "foreign").issue(Subject(Role.OPERATOR, "a"))
    shutil.copy(authority.folder_of(Subject(Role.LINK, "a")) / "authority.pem", foreign / "authority.pem")
    found["foreign"] = Identity(foreign, found["operator"].subject, *(None,) * 4)  # type: ignore[arg-type]
    link = load_identity(authority.folder_of(Subject(Role.LINK, "a")))
    endpoint = free_endpoints("tls").earth
    router = open_router(Side.EARTH, endpoint, guard_of(Side.EARTH, MISSION, link))
    yield Site(authority, endpoint, found)
    router.close()


def test_what_the_table_allows_arrives_and_what_it_does_not_is_dropped(site):
    plan, status = PLAN.key(MISSION), GROUND_STATUS.key(MISSION)
    with ExitStack() as ends:
        heard: list[bytes] = []
        held = [site.session(ends, "recorder").declare_subscriber(key, lambda s: heard.append(s.payload.to_bytes()))
                for key in (plan, status)]  # fmt: skip
        ground = site.session(ends, "ground")
        publishers = [ground.declare_publisher(key) for key in (plan, status)]
        until(lambda: all(each.matching_status.matching for each in publishers), "the router to know the recorder")
        for who in ("viewer", "operator", "revoked"):
            session = site.session(ends, who)
            for key in (plan, status):
                session.put(key, f"forged by {who}".encode())
            assert list(session.get(plan, timeout=5.0)) == []  # the router has handled what this session sent before
        for number in range(2):
            ground.put((plan, status)[number], b"genuine %d" % number)
        until(lambda: len(heard) >= 2, "what the ground sent")
        assert sorted(heard) == [b"genuine 0", b"genuine 1"]
        del held


def test_a_session_that_the_rules_give_nothing_sees_nothing(site):
    with ExitStack() as ends:
        seen: list[str] = []
        held = [
            site.session(ends, who).declare_subscriber(key, lambda _, who=who: seen.append(who))
            for who in ("revoked", "viewer")
            for key in (COMMAND.key(MISSION), "he3/**")
        ]
        recorder = site.session(ends, "recorder")
        arrived: list[bytes] = []
        held.append(recorder.declare_subscriber(COMMAND.key(MISSION), lambda s: arrived.append(s.payload.to_bytes())))
        publisher = site.session(ends, "ground").declare_publisher(COMMAND.key(MISSION))
        until(lambda: publisher.matching_status.matching, "the router to know the recorder")
        publisher.put(b"pause")
        until(lambda: arrived, "the command at the recorder")
        assert seen == []


def test_a_rival_that_claims_to_answer_everything_is_asked_nothing(site):
    key = ISSUE_COMMAND.key(MISSION)
    with ExitStack() as ends:
        asked: list[str] = []

        def answer(who, query):
            asked.append(who)
            query.reply(key, who.encode())
            query.drop()

        held = [
            site.session(ends, who).declare_queryable(key, lambda query, who=who: answer(who, query), complete=claims)
            for who, claims in (("viewer", True), ("recorder", True), ("ground", False))
        ]
        operator = site.session(ends, "operator")
        replies = until(lambda: list(operator.get(key, timeout=5.0)), "the ground's reply")
        assert [each.ok.payload.to_bytes() for each in replies] == [b"ground"]
        assert set(asked) == {"ground"}
        assert list(site.session(ends, "viewer").get(key, timeout=5.0)) == []
        del held


@pytest.mark.parametrize("rival_says", ["unsigned", "signed by another", "refused", "nothing"])
def test_a_client_waits_for_the_genuine_answer_behind_that_of_a_rival(site, rival_says):
    """The rival has the certificate of a link, so the router lets it answer; it says that it has all answers."""

    def status(incarnation: int, who: str | None) -> bytes:
        counts = DirectionCounts()
        body = LinkStatus(conditions=LinkConditions(), contact=True, contact_changes_at=None, up=counts, down=counts,
                          in_flight=(), incarnation=incarnation)  # fmt: skip
        header = Header(mission=MISSION, source="link", incarnation=incarnation, sequence=0, made_at=5)
        if who is None:
            return encode(header, body)
        signer = Signer(site.identities[who].common_name, site.identities[who].key, "run")
        return encode(header, body, partial(signer.signed, Part.MESSAGE, LINK_STATUS.name))

    def answer(query: zenoh.Query) -> None:
        query.reply(query.key_expr, status(1, "link"))
        query.drop()

    def rival(query: zenoh.Query) -> None:
        match rival_says:
            case "unsigned":
                query.reply(query.key_expr, status(9, None))
            case "signed by another":
                query.reply(query.key_expr, status(9, "viewer"))
            case "refused":
                query.reply_err(b"no")
        if rival_says == "nothing":
            silent.append(query)
        else:
            query.drop()
            heard.set()

    heard, silent = threading.Event(), []
    key = LINK_STATUS.key(MISSION)
    with ExitStack() as ends:
        held = [site.session(ends, "link").declare_queryable(key, rival, complete=True)]
        client = ends.enter_context(Client(site.endpoint, MISSION, identity=site.identities["operator"]))
        if rival_says != "nothing":
            until(lambda: _failure(client), "the rival to be asked")
            assert "expected" in _failure(client) or _failure(client) == "no"
        held.append(site.session(ends, "link").declare_queryable(key, answer))
        until(lambda: _failure(client) is None, "the genuine answer")
        for _ in range(20):  # whichever comes first
            assert client.latest(LINK_STATUS)[1].incarnation == 1
        assert heard.is_set() or silent
        del held


def _failure(client: Client) -> str | None:
    """The line with which a query for the link's status fails; None if it has an answer that counts."""
    try:
        client.latest(LINK_STATUS, timeout_s=5.0)
    except PeerUnreachable:
        return ""
    except He3Error as error:
        return str(error)
    return None


def test_a_process_appears_under_its_own_name_alone(site):
    with ExitStack() as ends:
        seen: list[str] = []
        pattern = liveliness_key(MISSION, Side.EARTH, "*")
        watching = site.session(ends, "viewer").liveliness()
        held = [watching.declare_subscriber(pattern, lambda token: seen.append(str(token.key_expr)), history=True)]
        appearing = site.session(ends, "recorder").liveliness()
        names = ("ground", "link", "recorder")
        held += [appearing.declare_token(liveliness_key(MISSION, Side.EARTH, name)) for name in names]
        own = liveliness_key(MISSION, Side.EARTH, "recorder")
        until(lambda: own in seen, "the recorder to appear")
        assert seen == [own]
        del held


@pytest.mark.parametrize("who", ["expired", "foreign"])
def test_a_certificate_that_does_not_count_gets_no_session(site, who):
    name = site.identities[who].common_name
    refused = (
        rf"^no earth router at \S+: a program listens there, but it and {name} do not accept each other; expected keys"
    )
    with pytest.raises(PeerUnreachable, match=refused):
        open_client(Side.EARTH, site.endpoint, identity=site.identities[who])


def test_a_client_without_keys_is_told_that_the_mission_may_have_some(site):
    endpoint = site.endpoint.replace("tls/", "tcp/")
    with pytest.raises(PeerUnreachable, match=r"a program listens there.* a mission with keys has tls/ endpoints"):
        open_client(Side.EARTH, endpoint)


def test_only_a_link_can_pose_as_a_router(site):
    endpoint = free_endpoints("tls").earth
    false_router = open_router(Side.EARTH, endpoint, guard_of(Side.EARTH, MISSION, site.identities["operator"]))
    try:
        with pytest.raises(PeerUnreachable, match="no earth router"):
            open_client(Side.EARTH, endpoint, identity=site.identities["ground"])
    finally:
        false_router.close()


def test_a_client_says_which_role_a_query_takes(site):
    with (
        Client(site.endpoint, MISSION, identity=site.identities["viewer"]) as client,
        pytest.raises(NotAllowed, match=r"earth/ground/command: expected an identity of role operator, got viewer.a"),
    ):
        client.query(ISSUE_COMMAND, Telecommand(command_id="c", kind=CommandKind.PAUSE))


def test_a_mission_with_keys_runs_to_its_end_in_lockstep(tmp_path, coarse_t1):
    keys = str(tmp_path / "keys")
    assert run(he3("keys", "init", keys)).returncode == 0
    small = ["--set", "rounds=1", "--set", "samples_per_round=2", "--set", f"region={coarse_t1}", "--json", "-q"]
    flown = run(he3("run", "short", "--lockstep", "--keys", keys, *small))
    assert flown.returncode == 0, flown.stderr
    report = json.loads(flown.stdout)
    assert (report["completed"], report["samples"]) == (True, 2)
