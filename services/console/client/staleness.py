"""The ages from which facts about a mission are too old to rely on."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from schemas.link import LinkStatus

SILENT_S = 15.0
"""Wall time without any message after which a mission counts as gone; heartbeats come every second."""
PROCESS_SILENT_S = 3.0
"""Wall time without a heartbeat after which a display says that a process is silent."""
STATE_PERIOD_S = 60.0
"""Mission time between two reports of the rover's state, until this session has heard a few; the scenario's default."""
MISSED_STATES = 3
"""Reports of the rover's state that may be missed, beyond the light time, before its state counts as stale."""
CHANCE = 1e-6
"""Chance, at each report, that random losses alone make the rover's state stale: at one a minute, once in 2 years."""
MOST_LOSS = 0.9
"""A link that loses a larger share is not waited for any longer."""
COMPUTING_S = 1.0
"""Wall time that a message may spend in the queues of busy computers."""


def stale_after_s(state_period_s: float, link: LinkStatus | None, rate: float) -> float:
    """Age [s of mission time] from which the rover's last known state is stale.

    rate: mission seconds per wall second, of late; at a high rate, processing delays are long in mission time.
    """
    down = None if link is None else link.conditions.down
    light_s, loss = (0.0, 0.0) if down is None else (down.one_way_light_time_s, down.loss)
    return missed_states(loss) * state_period_s + light_s + COMPUTING_S * rate


def missed_states(loss: float) -> int:
    """Reports of the rover's state that may be missed in a row over a link that loses that share of them at random."""
    if loss <= 0.0:
        return MISSED_STATES
    return max(MISSED_STATES, math.ceil(math.log(CHANCE) / math.log(min(loss, MOST_LOSS))))
