"""How exactly the link keeps its light time at rate 1, between separate processes, before and after a live change.

The real link runs as a process of its own with its two routers. A process on Earth sends telecommands up and a process
on the Moon sends sample reports down, at the same time; each takes the mission time at which a message reaches it. The
error of a message is

    error = (mission time at its arrival - the `made_at` of its header) - light time

so it includes all delays except the light time: both hops over Zenoh, the link's queue and its timers. Then an
operator sets the light time to 3.0 s while all of it runs, and what follows is measured again.

    owlt_s          the one-way light time that was asked for [s]
    messages        how many arrived, of as many sent
    error_p50_s, error_p99_s, error_max_s     median, 99th percentile and largest of the absolute errors [s]
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import os
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from benchmarks import kept
from benchmarks.peer import SETTLING_S, Peer, answer_line
from he3.errors import He3Error, InvalidInput, PeerUnreachable
from schemas.codec import decode, encode
from schemas.commands import CommandKind, Telecommand
from schemas.link import ClockState, LinkChange, LinkStatus
from schemas.telemetry import SampleReport
from schemas.topics import COMMAND, EARTH_CLOCK, MOON_CLOCK, SAMPLE, Side, Topic
from schemas.wire import Header, Wire
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import free_endpoints
from services.mission.deployment import find_scenario
from services.mission.mission_time import SECOND
from services.mission.scenario import load_scenario
from services.runtime.clock import mission_time
from services.runtime.transport.client import Client
from services.runtime.transport.opening import open_client
from services.runtime.transport.session import Session

Row = dict[str, Any]
T = TypeVar("T")


def run(
    messages: int = 250,
    interval_s: float = 0.02,
    changed_to_s: float = 3.0,
    scenario: str = "t1-paper",
    json: Path | str | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """A row for each direction, and for both together, before and after the change; printed, and written to ``json``.

    messages: sent each way. interval_s: between two of them. Raises InvalidInput for figures out of range.
    """
    if messages < 1 or interval_s < 0 or not 0 <= changed_to_s <= 86_400:
        raise InvalidInput(
            f"expected messages of at least 1, an interval of 0 s or more and a light time from 0 to 86400 s, "
            f"got {messages}, {interval_s:g} and {changed_to_s:g}"
        )
    path = find_scenario(scenario)
    mission = load_scenario(path)
    endpoints = free_endpoints()
    where = ["--moon", endpoints.moon, "--earth", endpoints.earth]
    say(f"{'light time':>10} {'direction':<9} {'messages':>8} {'median':>10} {'99 %':>10} {'largest':>10}")
    rows: list[Row] = []
    with ExitStack() as ends:
        link = Peer(ends, "services.link", str(path), "--rate", "1", "--log-level", "warning", *where)
        client = ends.enter_context(MissionClient.when_up(endpoints.earth, mission.name, link.check))
        sides = [
            Peer(ends, "benchmarks.link_timing", side.value, getattr(endpoints, side.value), mission.name)
            for side in Side
        ]
        for side in sides:
            side.answer()  # it listens: what the other one sends from now on reaches it
        for owlt_s in (None, changed_to_s):
            change = LinkChange() if owlt_s is None else LinkChange(one_way_light_time_s=owlt_s)
            status = _changed(client, change, link.check)
            rows += _measured(sides, status, messages, interval_s)
            for row in rows[-3:]:
                say(
                    f"{row['owlt_s']:>8.3f} s {row['direction']:<9} {row['messages']:>8} {_ms(row['error_p50_s'])} "
                    f"{_ms(row['error_p99_s'])} {_ms(row['error_max_s'])}"
                )
    if json is not None:
        whole = next(row for row in rows if row["direction"] == "both")
        document = {**whole, "rows": rows, "interval_s": interval_s, "machine": _machine()}
        kept.write_whole(json, document)
    return rows


def _changed(client: MissionClient, change: LinkChange, check: Callable[[], None]) -> LinkStatus:
    """The link's reply to a change."""
    status: LinkStatus = _once_it_answers(partial(client.change_link, change), check)
    return status


def _once_it_answers(ask: Callable[[], T], check: Callable[[], None] = lambda: None) -> T:
    """The link's first reply; its routers listen before it can answer."""
    give_up = time.monotonic() + SETTLING_S
    while True:
        check()
        try:
            return ask()
        except PeerUnreachable:
            if time.monotonic() > give_up:
                raise
        time.sleep(0.05)


def _measured(sides: Sequence[Peer], status: LinkStatus, messages: int, interval_s: float) -> list[Row]:
    light = {"up": status.conditions.up.one_way_light_time_s, "down": status.conditions.down.one_way_light_time_s}
    longest_s = messages * interval_s + max(light.values()) + SETTLING_S
    for side in sides:
        side.tell(f"{messages} {interval_s} {longest_s}")
    delays = {"up": np.array(sides[0].answer(longest_s)), "down": np.array(sides[1].answer(longest_s))}
    errors = {direction: np.abs(delays[direction] / SECOND - light[direction]) for direction in delays}
    for direction, came in errors.items():
        if len(came) != messages:
            raise He3Error(f"link: expected {messages} messages {direction}, got {len(came)}")
    both = np.concatenate(list(errors.values()))
    owlt_s = {**light, "both": sum(light.values()) / 2}
    return [
        {
            "owlt_s": owlt_s[direction],
            "direction": direction,
            "messages": len(came),
            "error_p50_s": float(np.quantile(came, 0.5)),
            "error_p99_s": float(np.quantile(came, 0.99)),
            "error_max_s": float(came.max()),
            "load": os.getloadavg()[0],
        }
        for direction, came in {**errors, "both": both}.items()
    ]


def _machine() -> dict[str, Any]:
    return {"cpus": os.cpu_count(), "load": os.getloadavg()[0]}


def _ms(seconds: float) -> str:
    return f"{seconds * 1e3:>7.3f} ms"


# --- one side of the link, in a process of its own --------------------------------------------------------------

SENDS: dict[Side, Topic] = {Side.MOON: SAMPLE, Side.EARTH: COMMAND}
HEARS: dict[Side, Topic] = {Side.MOON: COMMAND, Side.EARTH: SAMPLE}
SENDERS = {Side.MOON: "rover", Side.EARTH: "ground"}  # the link carries messages of the topic's own source alone
CLOCKS: dict[Side, Topic] = {Side.MOON: MOON_CLOCK, Side.EARTH: EARTH_CLOCK}


def _one_side(side: Side, endpoint: str, mission: str) -> None:
    """Send and receive as the lines on standard input request; prints the delays [ns] of arrivals as JSON lines."""
    sys.setswitchinterval(0.0005)
    came = _Arrivals()
    with Client(endpoint, mission, "bench", side) as client:
        client.subscribe_raw(HEARS[side], came.take)
        clock: ClockState = _once_it_answers(partial(client.latest, CLOCKS[side]))[1]
        session = Session(open_client(side, endpoint), mission)
        answer_line(side.value)
        try:
            first = 0
            for line in sys.stdin:
                messages, interval_s, longest_s = line.split()
                numbers = range(first, first + int(messages))
                _send(session, side, mission, clock, numbers, float(interval_s))
                first = numbers.stop
                heard = came.wait(int(messages), float(longest_s))
                made = [decode(HEARS[side], payload, mission)[0].made_at for payload, _ in heard]
                answer_line([mission_time(clock, at) - made_at for (_, at), made_at in zip(heard, made, strict=True)])
        finally:
            session.close()


def _send(session: Session, side: Side, mission: str, clock: ClockState, numbers: range, interval_s: float) -> None:
    began = time.monotonic()
    for number in numbers:
        time.sleep(max(0.0, began + (number - numbers.start) * interval_s - time.monotonic()))
        now = mission_time(clock, time.time_ns())
        header = Header(mission=mission, source=SENDERS[side], incarnation=1, sequence=number, made_at=now)
        session.publish(SENDS[side], encode(header, _body(side, number, now)))


class _Arrivals:
    """Payloads and the wall times [ns] of their arrival."""

    def __init__(self) -> None:
        self._came: list[tuple[bytes, int]] = []
        self._news = threading.Condition()

    def take(self, payload: bytes) -> None:
        at = time.time_ns()
        with self._news:
            self._came.append((payload, at))
            self._news.notify_all()

    def wait(self, count: int, within_s: float) -> list[tuple[bytes, int]]:
        """Returns and clears the arrivals, once there are that many or the time is over."""
        with self._news:
            self._news.wait_for(lambda: len(self._came) >= count, within_s)
            came, self._came = self._came, []
            return came


def _body(side: Side, number: int, now: int) -> Wire:
    if side is Side.EARTH:
        return Telecommand(command_id=f"bench-{number}", kind=CommandKind.PAUSE)
    return SampleReport(
        sample_id=f"bench-{number}",
        round=1,
        plan_revision=1,
        x_m=25.0,
        y_m=25.0,
        depth_m=0.1,
        helium3_ppb=8.0,
        noise_std_ppb=0.1,
        measured_at=now,
        driven_m=0.0,
    )


if __name__ == "__main__":
    if len(sys.argv) == 4:
        _one_side(Side(sys.argv[1]), sys.argv[2], sys.argv[3])
    else:
        run()
