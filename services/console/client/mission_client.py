"""A mission from Python: the map as arrays, samples as a table, commands with their stages, news as they come.

    from services.console import MissionClient

    with MissionClient() as mission:                      # the one that runs on this machine; else earth=, mission=
        mission.point(120, 340)                           # posterior at a place
        mean = mission.layer("mean")                      # .values (rows, columns), .x_m, .y_m, .unit, .revision
        rich = mission.layer("exceedance", threshold=9)
        mission.samples()                                 # a NumPy record array, a row a measurement
        mission.resource([(100, 100), (200, 100), (150, 200)], cutoff_ppb=9)
        mission.preview("go-to", target_m=(120, 340)).rows()  # what it would do; nothing is sent
        mission.command("pause").wait("completed")        # staged acknowledgement, light time included
        for news in mission.live(timeout_s=60):           # status, samples, events, command stages
            ...

Every query goes over Zenoh as any client may send it (docs/map-queries.md); none of them delays the mission.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from he3.errors import PeerUnreachable
from schemas.topics import GROUND_STATUS, Side, Topic
from schemas.wire import printable
from services.console.client.areas import Areas
from services.console.client.credentials import credentials_for
from services.console.client.displays import Displaying
from services.console.client.feed import MapFeed
from services.console.client.forking import Forks
from services.console.client.live import LiveNews
from services.console.client.map_files import MapFiles
from services.console.client.mission_state import MissionState
from services.console.client.operations import Operations
from services.console.client.plan_review import PlanReviewing
from services.console.client.previews import Previewing
from services.console.client.run_file import find
from services.runtime.transport.client import Client
from services.runtime.transport.opening import SilenceReport, WhileWaiting

if TYPE_CHECKING:
    from schemas.ground import GroundStatus
    from services.mission.mission_time import MissionTime

REPORT_AFTER_S = 15.0
"""Waiting for the router of a mission that is being started is reported after this time."""


class MissionClient(MapFiles, Areas, PlanReviewing, Previewing, Operations, Forks, LiveNews, MapFeed, Displaying):
    """A session with a running mission. Use it in a `with` statement; its methods may be called from any thread."""

    def __init__(
        self,
        earth: str | None = None,
        mission: str | None = None,
        name: str = "operator",
        *,
        identity: Path | None = None,
        insecure: bool = False,
        while_waiting: WhileWaiting | None = None,
        as_name: str | None = None,
    ) -> None:
        """Join the mission that runs on this machine, or the one of that Earth endpoint and name.

        name: source of its messages, unless there is an identity. identity: folder, see `credentials_for`. insecure:
        whether an endpoint off loopback may be without TLS.
        as_name: see `person`.
        while_waiting: called while the router accepts the connection and has not replied; None: one line on standard
        error.
        Raises PeerUnreachable when there is none, InvalidInput when there are several.
        """
        self.earth, self.mission = find(mission, earth)
        credentials = credentials_for(self.earth, self.mission, identity, insecure=insecure)
        self.as_name = as_name
        self.identity, self.warning = credentials.identity, credentials.warning
        if self.warning is not None:
            _report(self.warning)
        self.recording = credentials.recording
        """The recording that is served in place of a running mission; empty for one that runs."""
        if self.recording_note is not None:
            _report(self.recording_note)
        waiting = while_waiting or SilenceReport(Side.EARTH, self.earth, _report)
        self._session = Client(self.earth, self.mission, name, while_waiting=waiting, identity=self.identity)

    @classmethod
    def when_up(
        cls,
        earth: str,
        mission: str,
        check: Callable[[], None],
        name: str = "operator",
        *,
        identity: Path | None = None,
        insecure: bool = False,
    ) -> MissionClient:
        """A session with a mission whose router is being started; `check` raises if the start has failed.

        Waits as long as `check` does not raise; a line on standard error names what it waits for.
        """
        began = time.monotonic()
        silence = SilenceReport(Side.EARTH, earth, _report)
        reported = False

        def look(waited_s: float) -> None:
            check()
            silence(waited_s)

        while True:
            check()
            try:
                return cls(earth, mission, name, identity=identity, insecure=insecure, while_waiting=look)
            except PeerUnreachable as error:
                if not reported and time.monotonic() - began > REPORT_AFTER_S:
                    reported = True
                    _report(f"{error}; waiting for it as long as the services run")
            time.sleep(0.05)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self._session.close()

    @property
    def recording_note(self) -> str | None:
        """One line that says that this is no running mission; None for one that runs."""
        served = (
            f"RECORDING: mission '{self.mission}' is served from {printable(self.recording)}; nothing of it is live"
        )
        return served if self.recording else None

    def status(self, timeout_s: float = 10.0) -> GroundStatus:
        """The mission as the ground sees it."""
        status: GroundStatus = self._session.latest(GROUND_STATUS, timeout_s)[1]
        return status

    def wait_for_ground(self, check: Callable[[], None]) -> None:
        """Return when the ground station answers; `check` raises if it never will."""
        while True:
            check()
            try:
                self.status(timeout_s=1.0)
                return
            except PeerUnreachable:
                time.sleep(0.05)

    def state(
        self,
        on_change: Callable[[Topic | None], None] | None = None,
        start_ns: MissionTime | None = None,
        *,
        follow: bool = True,
    ) -> MissionState:
        """The newest facts of the mission, kept up to date from now on, or from `follow()` on; see `MissionState`."""
        state = MissionState(self._session, on_change, start_ns)
        if follow:
            state.follow()
        return state


def _report(line: str) -> None:
    print(f"he3: {line}", file=sys.stderr)
