"""Mission time: integer nanoseconds, the only time that nodes know."""

from __future__ import annotations

from datetime import UTC, datetime

MissionTime = int
"""Nanoseconds of mission time (UTC) since 1970-01-01T00:00:00Z."""

SECOND: MissionTime = 1_000_000_000

MAX_AHEAD: MissionTime = 86_400 * SECOND
"""Messages made further ahead of the present mission time are not believed [ns].

The clocks of two processes differ while a change of the rate is under way, and by the wall clocks of two machines.
"""


def seconds(value: float) -> MissionTime:
    """A duration [ns] from seconds, to the nearest nanosecond."""
    return round(value * SECOND)


def iso(time: MissionTime) -> str:
    """Mission time as an ISO 8601 text in UTC, to the second."""
    return datetime.fromtimestamp(time // SECOND, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
