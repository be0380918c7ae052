"""Random nodes in separate processes over Zenoh in lockstep have the same history as in one process."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from schemas.lockstep import TimeControl, TimeStatus
from schemas.topics import TIME_CONTROL
from services.runtime.drivers.simulation import Simulation
from services.runtime.event_log import EventLog, merge_event_logs
from services.runtime.transport.client import Client
from tests.waiting import until

CHATTER = Path(__file__).parents[1] / "chatter.py"
_SPEC = importlib.util.spec_from_file_location("chatter", CHATTER)
assert _SPEC is not None
assert _SPEC.loader is not None
chatter = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(chatter)

START = 1893456000 * 10**9


def silent(client: Client) -> TimeStatus:
    """The status once no process has anything left to do."""

    def seen() -> TimeStatus | None:
        status: TimeStatus = client.query(TIME_CONTROL, TimeControl())
        return status if status.step > 0 and status.next_at is None and not status.waits_for else None

    status = until(seen, "silence")
    assert status is not None
    return status


@pytest.mark.parametrize("seed", [3, 17, 58])
def test_random_nodes_have_the_same_history_over_zenoh_as_in_one_process(
    seed: int, missions: Callable[..., object], tmp_path: Path
) -> None:
    alone = tmp_path / "alone.log"
    log = EventLog(alone)
    Simulation(chatter.chatters(seed), "short", START, event_sink=log).run()
    log.close()

    names = [interface.name for interface in chatter.interfaces(seed)]
    mission = missions("short", "--lockstep")
    for name in names:
        flags = ["--wait-for", ",".join(names)] if name == "link" else []
        command = [sys.executable, str(CHATTER), name, str(seed), "short", "--lockstep", *flags]
        endpoints = ["--moon", mission.moon, "--earth", mission.earth]
        mission.run(name, [*command, *endpoints, "--events", str(tmp_path / f"{name}.log")])
    mission.ready()
    status = silent(mission.client())
    mission.stop()

    merge_event_logs([tmp_path / f"{name}.log" for name in names], tmp_path / "apart.log")
    merge_event_logs([alone], alone)
    assert alone.read_bytes().count(b"\n") > 50
    assert (tmp_path / "apart.log").read_bytes() == alone.read_bytes()
    assert set(status.members) == set(names)
