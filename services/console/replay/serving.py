"""A recorded mission at an endpoint of its own: every client of running missions reads it there.

The replay stands in for the processes on Earth. It is the router, publishes what was recorded as its time goes by, and
answers queries as they were answered then. Its pace is that of the mission's clock, which `he3 time` sets. Everything
else that would change a mission is refused.
"""

from __future__ import annotations

import os
import platform
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from he3.errors import He3Error
from schemas.codec import encode
from schemas.ground import Presence
from schemas.roles import PERSON_ROLES, Role
from schemas.topics import CLOCK_SET, EARTH_CLOCK, EARTH_PRESENCE, TOPICS, Query, Side, Topic
from schemas.wire import Header
from services.ground.map.service import MAP_TOPICS, SLOW_TOPICS
from services.runtime.heartbeat import PERIOD_S, software_version
from services.runtime.queries.server import Encoded, QueryServer, QueryService
from services.runtime.refusals import refusal_of
from services.runtime.transport.opening import open_router
from services.runtime.transport.session import IncomingQuery, Session

if TYPE_CHECKING:
    from collections.abc import Callable

    from schemas.wire import Wire
    from services.console.replay.mission import RecordedMission
    from services.mission.mission_time import MissionTime

PLAY_EVERY_S: Final = 0.02
"""Wall time between two looks at which messages are due [s]."""
STANDS_FOR: Final = (Role.LINK, Role.GROUND)
"""The processes whose heartbeats the replay sends: their words are what it has."""


def _for_people(topic: Topic) -> bool:
    access = topic.access
    return Side.EARTH in topic.sides and any(role in PERSON_ROLES for role in (*access.subscribe, *access.query))


ASKED: Final = tuple(topic for topic in TOPICS if isinstance(topic.service, Query) and _for_people(topic))
"""The queries that people may send."""
PUBLISHED: Final = tuple(
    topic for topic in TOPICS if topic.recorded and _for_people(topic) and topic is not EARTH_CLOCK
)
"""What people may read of a recording."""
KEPT: Final = (EARTH_CLOCK, *(topic for topic in PUBLISHED if topic.kept))
"""Topics whose last message can be queried."""


@contextmanager
def serving(mission: RecordedMission, endpoint: str) -> Iterator[None]:
    """Serve that mission at that Earth endpoint within the `with` statement.

    Raises PeerUnreachable, with the reason, where nothing can listen there.
    """
    session = Session(open_router(Side.EARTH, endpoint), mission.mission)
    ended = threading.Event()
    server = _Server(mission, session)
    thread = threading.Thread(target=server.run, args=(ended,), name="replay", daemon=True)
    try:
        server.declare()
        thread.start()
        yield
    finally:
        ended.set()
        thread.join()
        session.close()


class _Server:
    """Publishes and answers on one session."""

    def __init__(self, mission: RecordedMission, session: Session) -> None:
        self._mission = mission
        self._session = session
        self._recorded = mission.session
        self._told: tuple[int, float] | None = None
        self._beats = 0
        self._beat_at = 0.0

    @property
    def mission_time_ns(self) -> MissionTime:
        """The present time of the recording: it is the snapshot from which queries are answered."""
        return self._mission.now_ns

    def declare(self) -> None:
        """Declare what is answered and published."""
        for role in STANDS_FOR:
            service = QueryService(ASKED, self._answer, self._render, slow=SLOW_TOPICS)
            queries = QueryServer(service, role.value, self._mission.mission)
            queries.show(self)
            for topic in ASKED:
                if role in topic.access.answer:
                    queries.serve(topic, self._session)
        for topic in KEPT:
            self._session.serve(topic, self._last(topic))
        for topic in PUBLISHED:
            self._recorded.subscribe(topic, self._publisher(replace(topic, kept=False)))
        for role in STANDS_FOR:
            self._session.declare_alive(role.value, Side.EARTH)

    def run(self, ended: threading.Event) -> None:
        """Let time go by until told to end."""
        while not ended.wait(PLAY_EVERY_S):
            self._recorded.play()
            self._tell_time()
            if time.monotonic() >= self._beat_at:
                self._beat_at = time.monotonic() + PERIOD_S
                self._beat()

    def _answer(self, topic: Topic, request: Any, _snapshot: object) -> Wire:
        if topic is CLOCK_SET:
            self._mission.set_pace(request.rate)
            self._tell_time()
            return self._mission.clock()
        reply: Wire = self._recorded.query(topic, request)
        return reply

    def _render(self, topic: Topic, request: Any, _snapshot: object) -> Encoded | None:
        found = self._recorded.map_answer(topic, request) if topic in MAP_TOPICS else None
        return found if isinstance(found, Encoded) else None

    def _last(self, topic: Topic) -> Callable[[IncomingQuery], None]:
        def answer(query: IncomingQuery) -> None:
            try:
                query.reply(encode(*self._recorded.latest(topic)))
            except He3Error as error:
                query.refuse(refusal_of(error))

        return answer

    def _publisher(self, topic: Topic) -> Callable[[Header, Any], None]:
        return lambda header, body: self._session.publish_best_effort(topic, encode(header, body))

    def _tell_time(self) -> None:
        """Publish the clock when its pace is another than it was last told."""
        time_ = self._recorded.time
        if self._told != (time_.revision, time_.pace):
            self._told = time_.revision, time_.pace
            self._session.publish_best_effort(EARTH_CLOCK, encode(*self._recorded.latest(EARTH_CLOCK)))

    def _beat(self) -> None:
        self._beats += 1
        for name in (role.value for role in STANDS_FOR):
            body = Presence(
                name=name, side=Side.EARTH.value, incarnation=0, software=f"{software_version()}, a recording",
                pid=os.getpid(), host=platform.node()[:100], refused=0, events=0,
            )  # fmt: skip
            header = Header(
                mission=self._mission.mission, source=name, incarnation=0, sequence=self._beats,
                made_at=self._mission.now_ns,
            )  # fmt: skip
            self._session.publish_best_effort(EARTH_PRESENCE, encode(header, body))
