"""A recorded mission as the one client of running missions knows it: the same queries and facts, at a time that is set.

with RecordedMission(Path("runs/a/mission.mcap")) as mission:
    mission.jump(mission.begin_ns + 3600 * 10**9)  # an hour after the beginning
    mission.point(120, 340)                        # as the map was then
    mission.set_pace(100.0)                        # and on from there
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from services.console.client.clock import MissionClock
from services.console.client.mission_client import MissionClient
from services.console.client.mission_state import MissionState
from services.console.replay.maps import RecordedMaps
from services.console.replay.session import PlayedTime, RecordedSession
from services.console.replay.tape import Tape

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from he3.reference import Region
    from schemas.topics import Topic
    from services.mission.mission_time import MissionTime


class RecordedMission(MissionClient):
    """A client of a recorded mission. It stands at the beginning until it is played."""

    def __init__(self, path: Path, region: Region | None = None) -> None:
        """region: the mission's; None: the one that its scenario names.

        Raises InvalidInput, in one line, for a file that is no recording of a mission.
        """
        self.tape = Tape(path)
        self.earth = str(path)
        self.mission = self.tape.mission
        self.identity = self.warning = self.as_name = None
        self.recording = ""  # a page over it says so itself
        self._maps = RecordedMaps(self.tape, region)
        start_ns = min(self.tape.start_ns, self.tape.times[0])
        self._played = RecordedSession(self.tape, self._maps, PlayedTime(start_ns, self.tape.end_ns))
        self._session = self._played
        self._states: list[RecordedState] = []

    @property
    def session(self) -> RecordedSession:
        """The session behind this client."""
        return self._played

    @property
    def notes(self) -> tuple[str, ...]:
        """One line on each part of the mission that is not shown as it was."""
        return (*self.tape.evidence.problems, *self._maps.notes)

    @property
    def begin_ns(self) -> MissionTime:
        """The first time that can be shown [ns]."""
        return self._played.time.begin

    @property
    def end_ns(self) -> MissionTime:
        """The last time that can be shown [ns]."""
        return self._played.time.end

    @property
    def now_ns(self) -> MissionTime:
        """The present time of the recording [ns]."""
        return self._played.time.now()

    @property
    def pace(self) -> float:
        """Mission seconds per wall second; 0 while it stands still."""
        return self._played.time.pace

    @contextmanager
    def held(self) -> Iterator[None]:
        """Nothing is delivered by other threads meanwhile; take it before a lock that listeners take."""
        with self._played.lock:
            yield

    def jump(self, at: MissionTime) -> None:
        """Set the present time; all states are then those that were known at that time.

        Raises InvalidInput for a time that the recording does not have.
        """
        with self._played.lock:
            before = self._played.time.now()
            self._played.time.set(at)
            if at < before:
                self._played.begin_again()
                for state in self._states:
                    state.begin_again()
            self._played.play()

    def set_pace(self, pace: float) -> None:
        """Let time go at that many mission seconds per wall second; 0 stops it. Raises InvalidInput."""
        self._played.time.set(pace=pace)

    def state(
        self,
        on_change: Callable[[Topic | None], None] | None = None,
        start_ns: MissionTime | None = None,
        *,
        follow: bool = True,
    ) -> MissionState:
        """The newest facts at the present time of the recording; `refresh` takes in what was received since."""
        state = RecordedState(self._played, on_change, self.tape.start_ns if start_ns is None else start_ns)
        self._states.append(state)
        if follow:
            state.follow()
        return state

    def on_time(self, look: Callable[[], None]) -> None:
        """Call `look` as time goes by, also between messages and on the way of a jump."""
        self._played.on_time(look)


class RecordedClock(MissionClock):
    """The present time of a recording; its rate is the one at which the mission ran."""

    def __init__(self, session: RecordedSession, start_ns: MissionTime | None) -> None:
        super().__init__(start_ns)
        self._session = session

    @property
    def pace(self) -> float:
        """Mission seconds per wall second at which it is played."""
        return self._session.time.pace

    def now(self) -> MissionTime:
        return self._session.now()


class RecordedState(MissionState):
    """The facts of a mission as they were known at the present time of its recording."""

    def __init__(
        self,
        session: RecordedSession,
        on_change: Callable[[Topic | None], None] | None = None,
        start_ns: MissionTime | None = None,
    ) -> None:
        self._played = session
        super().__init__(session, on_change, start_ns)

    def follow(self, timeout_s: float = 0.0) -> None:
        """Take in what was received by the present time, and what is received from now on."""
        self._subscribe()
        with self._played.lock:
            self._played.begin_again()
            self._played.play()

    def refresh(self) -> None:
        """Take in what was received by the present time."""
        self._played.play()

    def begin_again(self) -> None:
        """Drop all facts: the messages come again from the first one on."""
        self._start_afresh()

    @property
    def silent_s(self) -> float:
        """A recording is never silent: it does not have the heartbeats."""
        return 0.0

    def _clock_of(self, start_ns: MissionTime | None) -> MissionClock:
        return RecordedClock(self._played, start_ns)
