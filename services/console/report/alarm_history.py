"""The alarms of a recorded mission: computed from its messages, as a display computed them live."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING

from schemas.topics import EARTH_CLOCK, EVENT, GROUND_STATUS, LINK_STATUS, LOG_ENTRY, STATE
from services.console.client.alarms import Alarms
from services.console.client.staleness import STATE_PERIOD_S
from services.mission.mission_time import SECOND
from services.recorder.reader import Recording

if TYPE_CHECKING:
    from schemas.ground import GroundStatus
    from schemas.link import LinkStatus


def recorded_alarms(path: Path) -> Alarms:
    """The alarms at the end of that recording, with their history; raises InvalidInput for a file that is none."""
    alarms = Alarms()
    status: GroundStatus | None = None
    link: LinkStatus | None = None
    rate, last_state = 1.0, 0
    gaps_s: deque[float] = deque([STATE_PERIOD_S], maxlen=9)
    for message in Recording(path).messages():
        body = message.body
        if message.topic is EVENT:
            alarms.happened(body)
        elif message.topic is LOG_ENTRY:
            alarms.logged(body)
        elif message.topic is EARTH_CLOCK:
            rate = body.rate or 1.0
        elif message.topic is STATE:
            if last_state:
                gaps_s.append((message.header.made_at - last_state) / SECOND)
            last_state = message.header.made_at
        elif message.topic in (GROUND_STATUS, LINK_STATUS):
            status, link = (body, link) if message.topic is GROUND_STATUS else (status, body)
            alarms.look(status, link, message.received_at, rate, state_period_s=max(gaps_s))
    return alarms
