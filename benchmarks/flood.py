"""A flood: mutated messages and page requests over TLS, at a bounded rate, against one live mission with keys.

The mission runs in lockstep. Messages come from holders of every identity: of those that may not send them, which the
routers turn away, and of one with the link's own, which reach ground and rover and fail at their signatures. People's
requests are mutated too. The page is asked at the same time, over TLS, by a browser that is logged in.

Mission time runs through the warm-up, up to the middle of the mission, and stands for the rest of the flood: what grows
then grows by the flood. Afterwards the mission goes on to its end, and its report is compared with that of an
undisturbed one; left out are `driver`, `wall_time_s`, and the bytes that crossed the link, as signatures have some.

    queries    the ground's process that answers queries of the map
    growth     resident memory at the end of the flood, compared with that after the warm-up
"""

from __future__ import annotations

import json as json_format
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from random import Random
from typing import Any, Final

import zenoh

from benchmarks import kept
from benchmarks.fuzzing.messages import mutated_message
from benchmarks.fuzzing.page_requests import MOST_GROWTH, ServedPageOverTls, resident_kb
from he3.errors import He3Error, InvalidInput
from schemas.maps import MapFormat, MapLayer
from schemas.report import MissionReport
from schemas.roles import Role
from schemas.topics import (
    BY_NAME,
    MAP_BOX,
    MAP_FEED,
    MAP_HISTORY,
    MAP_LAYER,
    MAP_POINT,
    MAP_REGION,
    MAP_RESOURCE,
    MAP_SCORE,
    TOPICS,
    TRACK,
    Query,
    Side,
    Topic,
    counted,
)
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import Endpoints, free_endpoints
from services.console.launch.in_process import run_in_process
from services.console.launch.keys import DEMO_NAME, PROCESS_NAME, temporary_keys
from services.console.launch.launcher import Launcher
from services.console.launch.scenarios import Chosen, choose
from services.console.launch.separate import services_of
from services.console.launch.terrain_facts import terrain_facts
from services.console.report.mission_report import Run, gather
from services.console.report.outputs import Outputs
from services.console.report.progress import progress_for
from services.ground.map.rendering import MAX_KEPT_BYTES
from services.mission.regions import load_region
from services.runtime.transport.opening import open_client
from services.runtime.trust.access_control import Right, allowed_keys
from services.runtime.trust.identity import load_identity

STANDSTILL: Final = 1e-6
"""Pace at which the mission does not begin before it is told to [mission seconds per second]."""
WARM_UP: Final = 0.4
"""Share of the flood that is the warm-up: the allocators' pools are full after some 40,000 messages."""
TOLD_EVERY_S: Final = 5.0
MOST_OPEN: Final = 64
"""Most requests without a reply; further ones wait."""
SENDERS: Final = {
    Side.EARTH: (Role.VIEWER, Role.OPERATOR, Role.CONTROLLER, Role.RECORDER, Role.GROUND),
    Side.MOON: (Role.ROVER, Role.FIELD),
}
"""Whose identities are used, beside the link's, for what their role does not allow."""


def run(
    messages: int = 100_000,
    requests: int = 20_000,
    rate: float = 400.0,
    page_rate: float = 80.0,
    scenario: str = "short",
    seed: int = 1,
    json: Path | str | None = None,
    *,
    say: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Memory of each process before, during and after the flood; printed, and written to ``json``.

    rate, page_rate: messages and page requests per second, at most. Raises InvalidInput for less than one message or
    request, He3Error if a process grew by more than 10 %, failed or ended, or if the mission was disturbed.
    """
    if messages < 1 or requests < 1 or not rate > 0 or not page_rate > 0:
        raise InvalidInput(
            f"expected at least 1 message and 1 request, and rates over 0, got {messages}, {requests}, {rate:g}, "
            f"{page_rate:g}"
        )
    began = time.monotonic()
    undisturbed = run_in_process(
        choose(scenario).scenario, Outputs(None, None), progress_for("", "", quiet=True)
    ).report
    with ExitStack() as ends:
        site = _Site(ends, scenario, undisturbed)
        say(f"mission '{site.chosen.scenario.name}' runs over TLS: {site.endpoints.moon}, {site.endpoints.earth}")
        memory = {"start": site.memory_kb()}
        flood = _Flood(site, ends, Random(f"flood:{seed}"))
        page = _PageFlood(site, requests, page_rate, Random(f"flood:page:{seed}"))
        warm_s = WARM_UP * max(messages / rate, requests / page_rate)
        site.run_to_the_middle(warm_s)
        flood.fill()
        memory |= _flooded(site, flood, page, messages, rate)
        report = site.ended()
        defects = site.defects()
    document = {
        "messages": flood.sent,
        "requests": page.sent,
        "answered": flood.answered,
        "memory_kb": memory,
        "growth": {name: memory["end"][name] / warm - 1.0 for name, warm in memory["warm"].items()},
        "faults": page.faults,
        "defects": defects,
        "differences": _differences(report, undisturbed),
        "seconds": round(time.monotonic() - began, 1),
    }
    _print(document, say)
    kept.write_whole(json, document)
    wrong = _wrong(document)
    if wrong:
        raise He3Error(f"flood: {'; '.join(wrong)}")
    return document


def _flooded(site: _Site, flood: _Flood, page: _PageFlood, messages: int, rate: float) -> dict[str, dict[str, int]]:
    """Memory after the warm-up and at the end of the flood."""
    warm: dict[str, int] = {}
    began = told = time.monotonic()
    page.start()
    while flood.sent < messages or page.running:
        if flood.sent < messages:
            time.sleep(max(0.0, began + flood.sent / rate - time.monotonic()))
            flood.send()
        else:
            page.wait(1.0)
        progress = min(flood.sent / messages, page.sent / page.requests)
        if not warm and progress >= WARM_UP:
            site.require_standing()
            warm = site.memory_kb()
        if time.monotonic() - told > TOLD_EVERY_S:
            told = time.monotonic()
            site.launcher.check()
            shown = ", ".join(f"{name} {kb / 1024:.0f}" for name, kb in site.memory_kb().items())
            print(f"flood: {flood.sent} messages, {page.sent} requests; MB: {shown}", file=sys.stderr)
    flood.settle()
    site.launcher.check()
    site.page.require_alive()
    return {"warm": warm, "end": site.memory_kb()}


_ONE_OF_EACH: Final = (
    *(f"{MAP_LAYER.name}?layer={layer};format={form}" for layer in MapLayer for form in MapFormat),
    *(f"{MAP_BOX.name}?layer=std;x_min=0;y_min=0;x_max=50;y_max=50;format={form}" for form in MapFormat),
    f"{MAP_POINT.name}?x=30;y=30",
    *(topic.name for topic in (MAP_RESOURCE, MAP_HISTORY, MAP_REGION, MAP_SCORE, TRACK)),
)
"""Queries of the map: each kind with which the process that answers imports or allocates something else."""


class _Site:
    """The mission, its page and its keys."""

    def __init__(self, ends: ExitStack, scenario: str, undisturbed: MissionReport) -> None:
        self._undisturbed = undisturbed
        self.keys = ends.enter_context(temporary_keys())
        folder = Path(ends.enter_context(tempfile.TemporaryDirectory(prefix="he3-flood-")))
        self.chosen: Chosen = choose(scenario, keys=self.keys)
        self.mission = self.chosen.scenario.name
        running = services_of(self.chosen, Outputs(folder, None), free_endpoints("tls"), lockstep=True, pace=STANDSTILL)
        self.launcher: Launcher
        self.endpoints: Endpoints
        self.launcher, self.endpoints = ends.enter_context(running)
        controller = self.identity_folder(Role.CONTROLLER)
        self.owner = ends.enter_context(
            MissionClient.when_up(self.endpoints.earth, self.mission, self.launcher.check, identity=controller)
        )
        self.owner.wait_for_ground(self.launcher.check)
        self._state = self.owner.state(start_ns=self.chosen.scenario.start_ns)
        self._defects: dict[str, int] = {}
        for side in Side:
            heard = self.session(ends, side, Role.LINK).declare_subscriber(
                f"he3/{self.mission}/{side.value}/presence", self._keep_presence
            )
            ends.callback(heard.undeclare)
        self.page = ServedPageOverTls(self.mission, self.endpoints.earth, self.identity_folder(Role.OPERATOR))
        ends.callback(self.page.close)

    def identity_folder(self, role: Role) -> Path:
        names = {Role.VIEWER: "launcher", Role.OPERATOR: DEMO_NAME, Role.CONTROLLER: DEMO_NAME}
        return self.keys / "identities" / f"{role.value}-{names.get(role, PROCESS_NAME)}"

    def session(self, ends: ExitStack, side: Side, role: Role) -> zenoh.Session:
        endpoint = self.endpoints.moon if side is Side.MOON else self.endpoints.earth
        session = open_client(side, endpoint, identity=load_identity(self.identity_folder(role)))
        ends.callback(session.close)
        return session

    def memory_kb(self) -> dict[str, int]:
        """Resident memory of each process [kB]; Linux."""
        pids = {**self.launcher.pids, "page": self.page.pid}
        queries = _child_of(pids["ground"], "services.ground.map.process")
        if queries is not None:
            pids["queries"] = queries
        return {name: resident_kb(pid) for name, pid in pids.items()}

    def run_to_the_middle(self, within_s: float) -> None:
        """Let mission time run to the middle of the mission, in that wall time."""
        start_ns = self.chosen.scenario.start_ns
        half_s = self._undisturbed.mission_time_s / 2
        self.owner.control_time(until=start_ns + round(half_s * 1e9), rate=half_s / within_s)

    def require_standing(self) -> None:
        """Return when mission time stands in the middle of the mission."""
        while not self.owner.control_time().paused:
            self.launcher.check()
            time.sleep(0.1)

    def ended(self) -> MissionReport:
        """The report of the mission, run to its end."""
        self.owner.control_time(paused=False, unlimited=True)
        while (status := self._state.status) is None or not status.is_over:
            self.launcher.check()
            self._state.changed.wait(0.5)
            self._state.changed.clear()
        scenario = self.chosen.scenario
        region = load_region(scenario.region, scenario.field.field_seed)
        ended_s, terrain = self._state.status_time_s, terrain_facts(scenario, region)
        facts = Run("lockstep", None, region.provenance, ended_s, 0.0, region.layers, *terrain)
        report = gather(self.owner, scenario, status, facts).report
        self.launcher.check()
        return report

    def defects(self) -> dict[str, int]:
        """Inputs that a process has failed upon, by process; empty if there is none."""
        return {name: count for name, count in self._defects.items() if count}

    def _keep_presence(self, sample: zenoh.Sample) -> None:
        body = json_format.loads(sample.payload.to_bytes())["body"]
        self._defects[body["name"]] = body["defects"]


class _Flood:
    """Mutated messages and requests, of senders that may not send them."""

    def __init__(self, site: _Site, ends: ExitStack, rng: Random) -> None:
        self.sent = 0
        self.answered = 0
        self._site = site
        self._rng = rng
        self._open = threading.Semaphore(MOST_OPEN)
        self._genuine: dict[str, bytes] = {}
        self._link = {side: site.session(ends, side, Role.LINK) for side in Side}
        self._others: list[tuple[Side, Role, zenoh.Session]] = [
            (side, role, site.session(ends, side, role)) for side, roles in SENDERS.items() for role in roles
        ]
        self._rights = {side: allowed_keys(side, site.mission) for side in Side}
        for side, role in ((Side.EARTH, Role.RECORDER), (Side.EARTH, Role.LINK), (Side.MOON, Role.LINK)):
            session = site.session(ends, side, role)
            for key in self._rights[side][role].get(Right.SUBSCRIBE, ()):
                ends.callback(session.declare_subscriber(key, self._keep).undeclare)
        site.owner.status()
        self._published = [topic for topic in TOPICS if not isinstance(topic.service, Query) and topic is not MAP_FEED]
        self._asked = [topic for topic in TOPICS if isinstance(topic.service, Query) and "/time/" not in topic.name]
        self._signed = {
            Side.EARTH: [topic for topic in self._published if topic.signed and topic.name.startswith("tm/")],
            Side.MOON: [topic for topic in self._published if topic.signed and topic.name.startswith("tc/")],
        }

    def _keep(self, sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).removeprefix(f"he3/{self._site.mission}/").removesuffix("/@counted")
        if name in BY_NAME:
            self._genuine[name] = sample.payload.to_bytes()

    def fill(self) -> None:
        """Ask once for everything that the ground answers, then for more different maps than it keeps.

        So no first answer of a kind, with what it imports and allocates, comes after the warm-up, and what the ground
        keeps does not grow afterwards.
        """
        session = next(session for _, role, session in self._others if role is Role.VIEWER)
        for asked in _ONE_OF_EACH:
            list(session.get(f"he3/{self._site.mission}/{asked}", timeout=60.0))
            self._site.launcher.check()
        kept, step = 0, 0
        while kept < 2 * MAX_KEPT_BYTES:
            step += 1
            asked = f"{MAP_LAYER.key(self._site.mission)}?layer=exceedance;threshold={step / 100};format=npy"
            for reply in session.get(asked, timeout=60.0):
                if reply.ok is not None:
                    kept += len(reply.ok.payload)
            self._site.launcher.check()

    def send(self) -> None:
        """One message or request; waits while too many requests have no reply."""
        self.sent += 1
        match self._rng.choice(("denied", "denied", "forged", "asked")):
            case "denied":
                self._send_denied()
            case "forged":
                self._send_forged()
            case "asked":
                self._ask()

    def _payload(self, topic: Topic) -> bytes:
        if not self._genuine:
            return b"{}"
        return mutated_message(self._rng, topic, dict(self._genuine), self._site.mission, 0)

    def _send_denied(self) -> None:
        side, role, session = self._rng.choice(self._others)
        topic = self._rng.choice([topic for topic in self._published if side in topic.sides])
        for key in (topic.key(self._site.mission), counted(topic).key(self._site.mission)):
            if key not in self._rights[side][role].get(Right.PUBLISH, ()):
                _put(session, key, self._payload(topic))

    def _send_forged(self) -> None:
        """A message with the link's right to publish it, and without its sender's signature."""
        side = self._rng.choice(list(Side))
        topic = self._rng.choice(self._signed[side])
        payload = self._payload(topic).replace(b'"signature":"', b'"signature":"%02x' % self._rng.randrange(256))
        _put(self._link[side], counted(topic).key(self._site.mission), payload)

    def _ask(self) -> None:
        side, _, session = self._rng.choice([each for each in self._others if each[1] not in (Role.ROVER, Role.FIELD)])
        topic = self._rng.choice([topic for topic in self._asked if side in topic.sides])
        self._open.acquire()
        session.get(
            topic.key(self._site.mission),
            handler=zenoh.handlers.Callback(self._replied, self._open.release),
            payload=self._payload(topic),
            timeout=60.0,
        )

    def _replied(self, _: zenoh.Reply) -> None:
        self.answered += 1

    def settle(self) -> None:
        """Return when every request has ended, and the routers have handled every message."""
        for _ in range(MOST_OPEN):
            self._open.acquire()
        for _ in range(MOST_OPEN):
            self._open.release()
        for session in (*self._link.values(), *(session for *_, session in self._others)):
            list(session.get(f"he3/{self._site.mission}/settled", timeout=60.0))


class _PageFlood:
    """Mutated requests of the page, in a thread of their own."""

    def __init__(self, site: _Site, requests: int, rate: float, rng: Random) -> None:
        self.sent = 0
        self.requests = requests
        self.faults: list[str] = []
        self._site = site
        self._rate = rate
        self._rng = rng
        self._thread = threading.Thread(target=self._work, name="page", daemon=True)

    def start(self) -> None:
        self._thread.start()

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    def wait(self, timeout_s: float) -> None:
        self._thread.join(timeout_s)

    def _work(self) -> None:
        began = time.monotonic()
        while self.sent < self.requests:
            time.sleep(max(0.0, began + self.sent / self._rate - time.monotonic()))
            try:
                what, wrong = self._site.page.example(self._rng)
            except Exception as error:  # noqa: BLE001 - whatever a request leads to is told, and the flood goes on
                what, wrong = "a request", f"{type(error).__name__}: {error}"
            self.sent += 1
            if wrong is not None:
                self.faults.append(f"{what}: {wrong}")


def _child_of(parent: int, module: str) -> int | None:
    """Process id of the child of that process, of any of its threads, that runs that module; None if there is none."""
    started = (path.read_text(encoding="ascii") for path in Path(f"/proc/{parent}/task").glob("*/children"))
    for pid in " ".join(started).split():
        if module.encode() in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0"):
            return int(pid)
    return None


def _put(session: zenoh.Session, key: str, payload: bytes) -> None:
    session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)


def _differences(report: MissionReport, undisturbed: MissionReport) -> list[str]:
    """The fields in which the reports differ, but for those that the module's docstring leaves out."""

    def compared(given: MissionReport) -> dict[str, Any]:
        tree = given.model_dump(exclude={"wall_time_s", "driver"})
        for direction in ("up", "down"):
            del tree["messages"][direction]["bytes_delivered"]
        return tree

    left, right = compared(report), compared(undisturbed)
    return [name for name, value in left.items() if value != right[name]]


def _wrong(document: dict[str, Any]) -> list[str]:
    wrong = [
        f"{name} has grown by {100 * grown:.1f} %"
        for name, grown in document["growth"].items()
        if grown > MOST_GROWTH - 1.0
    ]
    if document["faults"]:
        wrong.append(f"{len(document['faults'])} faults of the page, the first: {document['faults'][0]}")
    wrong += [f"{name} has failed upon {count} inputs" for name, count in document["defects"].items()]
    if document["differences"]:
        wrong.append(f"the report differs from an undisturbed one in {', '.join(document['differences'])}")
    return wrong


def _print(document: dict[str, Any], say: Callable[[str], None]) -> None:
    memory = document["memory_kb"]
    say(f"{'process':<10} {'start MB':>9} {'warm MB':>9} {'end MB':>9} {'growth':>8}")
    for name, grown in document["growth"].items():
        figures = (memory[phase][name] / 1024 for phase in ("start", "warm", "end"))
        say(f"{name:<10} {' '.join(f'{figure:>9.1f}' for figure in figures)} {100 * grown:>+7.1f} %")
    end = "as an undisturbed one" if not document["differences"] else "disturbed"
    say(
        f"{document['messages']} messages and {document['requests']} page requests in {document['seconds']} s, "
        f"{len(document['faults'])} faults; the mission has ended {end}"
    )
