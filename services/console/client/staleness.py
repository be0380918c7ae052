"""The ages from which facts about a mission are too old to rely on."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from schemas.link import LinkStatus

SILENT_S = 15.0
"""Wall time without any message after which a mission counts as gone; heartbeats come every second."""
PROCESS_SILENT_S = 3.0
"""Wall time without a heartbeat after which a display says that a process is silent."""
STATE_PERIOD_S = 60.0
"""Mission time between two reports of the rover's state, until this session has heard a few; the scenario's default."""
MISSED_STATES = 3.0
"""Reports of the rover's state that may be missed, beyond the light time, before its state counts as stale."""
COMPUTING_S = 1.0
"""Wall time that a message may spend in the queues of busy computers."""


def stale_after_s(state_period_s: float, link: LinkStatus | None, rate: float) -> float:
    """Age [s of mission time] from which the rover's last known state is stale.

    rate: mission seconds per wall second; at a high rate, processing delays are long in mission time.
    """
    light_s = 0.0 if link is None else link.conditions.down.one_way_light_time_s
    return MISSED_STATES * state_period_s + light_s + COMPUTING_S * rate
