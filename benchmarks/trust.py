"""Rights in practice: every role tries every right on every topic, over TLS, at the routers of a running mission.

A mission runs with temporary keys. For each role there are two further identities: a probe, which publishes and
queries, and a witness, which subscribes and answers. Each does both on every key of both sides, whether the topic
table allows it or not; each message names its sender. What arrived is compared with the table: a pair of a probe and a
witness between which something passed that should not have, or did not pass that should have, is an exception.

A revoked operator takes part as well. Strangers without a certificate or without TLS, and holders of an expired or a
foreign certificate, must not get a session.
"""

from __future__ import annotations

import json as json_format
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path
from typing import Any

import zenoh

from benchmarks import kept
from he3.errors import He3Error, PeerUnreachable
from schemas.roles import Role
from schemas.topics import BY_NAME, TOPICS, Query, Side, addressed, counted
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import Endpoints, free_endpoints
from services.console.launch.keys import issue_for_processes
from services.console.launch.scenarios import Chosen, choose
from services.console.launch.separate import services_of
from services.console.report.outputs import outputs
from services.runtime.transport.opening import open_client, session_config
from services.runtime.trust.access_control import PARTICIPANTS, Right
from services.runtime.trust.authority import Authority
from services.runtime.trust.certificates import Subject, utc_now
from services.runtime.trust.identity import Identity, load_identity

PROBE, WITNESS, REVOKED = "probe", "witness", "revoked"
MARK = b"he3 trust "
VALID_FOR = timedelta(hours=1)
SETTLE_S = 1.0
"""Waiting time after all expected messages have arrived; unexpected ones would arrive in it."""
QUERY_WITHIN_S = 5.0
ARRIVES_WITHIN_S = 20.0
RIGHTS = (Right.PUBLISH, Right.SUBSCRIBE, Right.QUERY, Right.ANSWER)

Pair = tuple[str, str, str]
"""Sender, receiver and key."""


@dataclass(slots=True)
class Passed:
    """The messages that passed the router on one side; filled by Zenoh's threads."""

    messages: set[Pair] = field(default_factory=set)
    queries: set[Pair] = field(default_factory=set)
    replies: set[Pair] = field(default_factory=set)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def add(self, to: set[Pair], sender: str, receiver: str, key: str) -> None:
        with self._lock:
            to.add((sender, receiver, key))


@dataclass(frozen=True, slots=True)
class Keys:
    """The identities of one trial."""

    folder: Path
    probes: dict[str, Identity]
    witnesses: dict[str, Identity]
    shut_out: dict[str, Identity]
    """Identities that must not get a session."""


def run(
    scenario: str = "short", json: Path | str | None = None, *, say: Callable[[str], None] = print
) -> dict[str, Any]:
    """The matrix as measured and the exceptions, printed and written to ``json``.

    Raises He3Error if there is an exception, or if a service of the mission has ended.
    """
    began = time.monotonic()
    with ExitStack() as ends:
        keys = ends.enter_context(_keys())
        chosen = choose(scenario, rate=1.0, keys=keys.folder)
        free = free_endpoints("tls")
        launcher, endpoints = ends.enter_context(services_of(chosen, outputs(None, None), free))
        viewer = None if chosen.keys is None else chosen.keys.viewer
        with MissionClient.when_up(endpoints.earth, chosen.scenario.name, launcher.check, identity=viewer) as client:
            client.wait_for_ground(launcher.check)
            say(f"mission '{chosen.scenario.name}' runs over TLS: {endpoints.moon}, {endpoints.earth}")
            rows, exceptions = _trials(keys, chosen, endpoints)
            sessions = _shut_out(keys, endpoints)
            launcher.check()
            phase = client.status().phase.value
    exceptions += [f"{who} got a session" for who, got in sessions.items() if got]
    _print(rows, sessions, exceptions, say)
    document = {
        "attempts": len(rows),
        "exceptions": exceptions,
        "without_a_session": sorted(sessions),
        "mission_phase_afterwards": phase,
        "seconds": round(time.monotonic() - began, 1),
        "rows": rows,
    }
    say(f"{len(rows)} attempts, {len(exceptions)} exceptions, in {document['seconds']} s; the mission is {phase}")
    kept.write_whole(json, document)
    if exceptions:
        raise He3Error(f"trust: expected no exception, got {len(exceptions)}, the first: {exceptions[0]}")
    return document


# --- keys ---------------------------------------------------------------------------------------------------------


@contextmanager
def _keys() -> Iterator[Keys]:
    """Identities of the mission's processes, of a probe and a witness per role, and of clients to be refused."""
    place = Path(tempfile.mkdtemp(prefix="he3-trust-"))
    try:
        earlier = utc_now() - timedelta(days=2)
        Authority.create(place / "keys", clock=lambda: earlier)
        authority = Authority(place / "keys")
        issue_for_processes(authority, VALID_FOR)
        for role in Role:
            for name in (PROBE, WITNESS):
                authority.issue(Subject(role, name), VALID_FOR)
        revoked = Subject(Role.OPERATOR, REVOKED)
        authority.issue(revoked, VALID_FOR)
        before = load_identity(authority.folder_of(revoked))
        authority.revoke(revoked)
        expired = Authority(place / "keys", lambda: earlier).issue(Subject(Role.OPERATOR, "expired"), timedelta(days=1))
        foreign = Authority.create(place / "foreign").issue(Subject(Role.OPERATOR, PROBE), VALID_FOR)
        yield Keys(
            place / "keys",
            {**{role.value: _identity(authority, role, PROBE) for role in Role}, REVOKED: before},
            {**{role.value: _identity(authority, role, WITNESS) for role in Role}, REVOKED: before},
            {"expired": load_identity(expired, earlier), "foreign": load_identity(foreign)},
        )
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _identity(authority: Authority, role: Role, name: str) -> Identity:
    return load_identity(authority.folder_of(Subject(role, name)))


def _shut_out(keys: Keys, endpoints: Endpoints) -> dict[str, bool]:
    """Whether each client that must be refused got a session, on either side."""
    found: dict[str, bool] = {}
    for side in Side:
        endpoint = endpoints.moon if side is Side.MOON else endpoints.earth
        tls: dict[str, dict[str, Any] | None] = {"stranger without TLS": None}
        trusted = keys.probes[Role.VIEWER.value]
        tls["stranger without a certificate"] = {"root_ca_certificate": str(trusted.authority_path)}
        for who, identity in keys.shut_out.items():
            tls[f"{who} certificate"] = {
                "root_ca_certificate": str(trusted.authority_path),
                "connect_certificate": str(identity.certificate_path),
                "connect_private_key": str(identity.key_path),
                "enable_mtls": True,
            }
        for who, settings in tls.items():
            at = endpoint if settings is not None else endpoint.replace("tls/", "tcp/")
            found[f"{who}, {side}"] = _opens(side, at, settings)
    return found


def _opens(side: Side, endpoint: str, tls: dict[str, Any] | None) -> bool:
    config = session_config(side, "client", endpoint)
    if tls is not None:
        config.insert_json5("transport/link/tls", json_format.dumps({**tls, "verify_name_on_connect": False}))
    # A router that says nothing to a stranger is as good as one that refuses.
    config.insert_json5("transport/unicast/open_timeout", "3000")
    try:
        session = zenoh.open(config)
    except zenoh.ZError:
        return False
    session.close()  # type: ignore[no-untyped-call]
    return True


# --- the trials ---------------------------------------------------------------------------------------------------


def _trials(keys: Keys, chosen: Chosen, endpoints: Endpoints) -> tuple[list[dict[str, Any]], list[str]]:
    rows: list[dict[str, Any]] = []
    exceptions: list[str] = []
    for side in Side:
        endpoint = endpoints.moon if side is Side.MOON else endpoints.earth
        mission = chosen.scenario.name
        tried = _tried_keys(mission)
        allowed = _by_table(side, mission)
        passed = _tried(keys, side, endpoint, tried, allowed)
        exceptions += _exceptions(side, passed, _expected(allowed, tried))
        rows += _rows(side, tried, allowed, passed)
    return rows, exceptions


def _tried_keys(mission: str) -> list[str]:
    """Every key that a topic has on any side, with those of lockstep, and keys that no topic has."""
    keys = []
    for topic in TOPICS:
        names = (
            [addressed(topic, role.value) for role in (*PARTICIPANTS, Role.VIEWER)] if topic.per_process else [topic]
        )
        for each in names:
            keys.append(each.key(mission))
            if not isinstance(topic.service, Query):
                keys.append(counted(each).key(mission))
    command = BY_NAME["tc/command"]
    return [*keys, command.key("another-mission"), f"{command.key(mission)}/more", f"he3/{mission}/earth/unknown"]


def _by_table(side: Side, mission: str) -> dict[str, dict[Right, set[str]]]:
    """The keys that each role may use on that side, by right: from the topic table, not from the rules made of it."""
    found: dict[str, dict[Right, set[str]]] = {role.value: {right: set() for right in RIGHTS} for role in Role}
    for topic in TOPICS:
        if side not in topic.sides:
            continue
        access = topic.access_on(side)
        for right in RIGHTS:
            for role in getattr(access, right.value):
                own = (role,) if right is Right.SUBSCRIBE else access.subscribe
                if topic.per_process:
                    keys = {counted(addressed(topic, each.value)).key(mission) for each in own}
                else:
                    keys = {topic.key(mission)}
                    both = role in PARTICIPANTS and any(each in PARTICIPANTS for each in access.subscribe)
                    if both and right in (Right.PUBLISH, Right.SUBSCRIBE):
                        keys.add(counted(topic).key(mission))
                found[role.value][right] |= keys
    return found


def _expected(allowed: dict[str, Any], tried: list[str]) -> Passed:
    """The messages that must pass, by the table."""

    def pairs(sends: Right, receives: Right) -> set[Pair]:
        return {
            (sender, receiver, key)
            for sender, own in allowed.items()
            for receiver, theirs in allowed.items()
            for key in set(own.get(sends, ())) & set(theirs.get(receives, ())) & set(tried)
        }

    asked = pairs(Right.QUERY, Right.ANSWER)
    return Passed(pairs(Right.PUBLISH, Right.SUBSCRIBE), asked, set(asked))


def _tried(keys: Keys, side: Side, endpoint: str, tried: list[str], allowed: dict[str, Any]) -> Passed:
    """The messages that passed when every client tried every right."""
    passed = Passed()
    expected = _expected(allowed, tried)
    with ExitStack() as ends:
        witnesses = {who: _opened(ends, side, endpoint, each) for who, each in keys.witnesses.items()}
        probes = {who: _opened(ends, side, endpoint, each) for who, each in keys.probes.items()}
        held = [_witness(who, session, tried, passed) for who, session in witnesses.items()]
        _until_heard(probes, tried, allowed)
        ended = [threading.Event() for _ in range(len(probes) * len(tried))]
        waiting = iter(ended)
        for who, session in probes.items():
            for key in tried:
                session.put(key, MARK + who.encode(), congestion_control=zenoh.CongestionControl.BLOCK)
                _ask(session, who, key, passed, next(waiting))
        give_up = time.monotonic() + ARRIVES_WITHIN_S
        for each in ended:
            each.wait(max(0.0, give_up - time.monotonic()))
        while time.monotonic() < give_up and not (
            passed.messages >= expected.messages and passed.replies >= expected.replies
        ):
            time.sleep(0.05)
        time.sleep(SETTLE_S)
        del held
    return passed


def _opened(ends: ExitStack, side: Side, endpoint: str, identity: Identity) -> zenoh.Session:
    try:
        session = open_client(side, endpoint, identity=identity)
    except PeerUnreachable as error:
        raise He3Error(f"{identity.common_name}: expected a session, got: {error}") from None
    ends.callback(session.close)
    return session


def _witness(who: str, session: zenoh.Session, tried: list[str], passed: Passed) -> list[Any]:
    """Subscribers and queryables on every key, which note the messages that reach them."""

    def heard(key: str, sample: Any) -> None:
        payload = sample.payload.to_bytes()
        if payload.startswith(MARK):
            passed.add(passed.messages, payload.removeprefix(MARK).decode(), who, key)

    def asked(key: str, query: Any) -> None:
        payload = b"" if query.payload is None else query.payload.to_bytes()
        if payload.startswith(MARK):
            passed.add(passed.queries, payload.removeprefix(MARK).decode(), who, key)
            query.reply(key, MARK + who.encode())
        query.drop()

    held: list[Any] = []
    for key in tried:
        held.append(session.declare_subscriber(key, lambda sample, key=key: heard(key, sample)))
        held.append(session.declare_queryable(key, lambda query, key=key: asked(key, query)))
    return held


def _ask(session: zenoh.Session, who: str, key: str, passed: Passed, ended: threading.Event) -> None:
    def replied(reply: Any) -> None:
        payload = b"" if reply.ok is None else reply.ok.payload.to_bytes()
        if payload.startswith(MARK):
            passed.add(passed.replies, who, payload.removeprefix(MARK).decode(), key)

    session.get(
        key,
        handler=zenoh.handlers.Callback(replied, ended.set),
        payload=MARK + who.encode(),
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=QUERY_WITHIN_S,
    )


def _until_heard(probes: dict[str, zenoh.Session], tried: list[str], allowed: dict[str, Any]) -> None:
    """Wait until the router knows of every subscriber that it allows, so that no message is sent too early."""
    give_up = time.monotonic() + ARRIVES_WITHIN_S
    for who, session in probes.items():
        for key in set(allowed.get(who, {}).get(Right.PUBLISH, ())) & set(tried):
            publisher = session.declare_publisher(key)
            while time.monotonic() < give_up and not publisher.matching_status.matching:
                time.sleep(0.01)
            publisher.undeclare()


def _exceptions(side: Side, passed: Passed, expected: Passed) -> list[str]:
    found = []
    for what in ("messages", "queries", "replies"):
        got, wanted = getattr(passed, what), getattr(expected, what)
        found += [f"{side}: {key}: {what} of {a} reached {b}" for a, b, key in sorted(got - wanted)]
        found += [f"{side}: {key}: no {what} of {a} reached {b}" for a, b, key in sorted(wanted - got)]
    return found


def _rows(side: Side, tried: list[str], allowed: dict[str, Any], passed: Passed) -> list[dict[str, Any]]:
    """A row for each attempt: side, key, role, right, the table's rule and the observation."""
    seen = {
        Right.PUBLISH: {(sender, key) for sender, _, key in passed.messages},
        Right.SUBSCRIBE: {(receiver, key) for _, receiver, key in passed.messages},
        Right.QUERY: {(sender, key) for sender, _, key in passed.queries},
        Right.ANSWER: {(receiver, key) for _, receiver, key in passed.replies},
    }
    return [
        {
            "side": side.value,
            "key": key,
            "role": who,
            "right": right.value,
            "allowed": key in allowed.get(who, {}).get(right, ()),
            "done": (who, key) in seen[right],
        }
        for key in tried
        for who in (*(role.value for role in Role), REVOKED)
        for right in RIGHTS
    ]


# --- shown --------------------------------------------------------------------------------------------------------


def _print(
    rows: list[dict[str, Any]], sessions: dict[str, bool], exceptions: list[str], say: Callable[[str], None]
) -> None:
    """The matrix: a line for each key that a role may use, P S Q A for the rights used, '!' for an exception."""
    roles = (*(role.value for role in Role), REVOKED)
    say(f"{'':<46} {' '.join(f'{role:<10}' for role in roles)}")
    lines: dict[tuple[str, str], dict[str, str]] = {}
    for row in rows:
        cell = lines.setdefault((row["side"], row["key"]), dict.fromkeys(roles, ""))
        letter = row["right"][0].upper() if row["done"] else ""
        cell[row["role"]] += letter + ("!" if row["done"] != row["allowed"] else "")
    unused = 0
    for (side, key), cells in lines.items():
        if not any(cells.values()):
            unused += 1
            continue
        say(f"{side:<5} {key:<40} {' '.join(f'{cells[role] or chr(183):<10}' for role in roles)}")
    say(f"P publishes, S subscribes, Q queries, A answers; on {unused} further keys no client did anything")
    for who, got in sessions.items():
        say(f"{who:<40} {'GOT A SESSION' if got else 'no session'}")
    for each in exceptions[:40]:
        say(f"exception: {each}")
