"""Times as text, and text as times: the only place in the console that formats or parses them."""

from __future__ import annotations

import re
from datetime import UTC, datetime

from he3.errors import InvalidInput
from services.mission.mission_time import SECOND, MissionTime

_UNITS_S = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_DURATION = re.compile(r"(\d{1,15}(?:\.\d{1,9})?)\s*(s|min|h|d|)")


def utc(at: MissionTime, digits: int = 3) -> str:
    """A mission time as ISO 8601 in UTC, with `digits` (0 to 9) of the second's fraction; cut off, never rounded up."""
    whole, rest = divmod(at, SECOND)
    fraction = f".{rest:09d}"[: digits + 1] if digits else ""
    return f"{datetime.fromtimestamp(whole, UTC):%Y-%m-%dT%H:%M:%S}{fraction}Z"


def duration(seconds: float) -> str:
    """A duration in its two largest units: 12 s, 3 min 05 s, 4 h 02 min, 2 d 07 h."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    if whole < 86_400:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole // 86_400} d {whole % 86_400 // 3600:02d} h"


def speed(rate: float) -> str:
    """How fast mission time runs on the wall clock: paused, real time, or a factor such as 20x."""
    if rate == 0:
        return "paused"
    return "real time" if rate == 1 else f"{rate:,.10g}x"


def parse_duration_s(text: str) -> float:
    """Seconds of a duration such as 90, 15min, 2h or 3d; raises InvalidInput."""
    found = _DURATION.fullmatch(text.strip())
    if found is None:
        raise InvalidInput(f"expected a duration such as 90, 15min, 2h or 3d, got '{text}'")
    return float(found[1]) * _UNITS_S[found[2]]


def parse_moment(text: str, start_ns: MissionTime) -> MissionTime:
    """Mission time [ns] of a duration since the beginning (90, 15min, 2h, 3d) or of a UTC time; raises InvalidInput."""
    if _DURATION.fullmatch(text.strip()) is not None:
        return _in_range(start_ns + round(parse_duration_s(text) * SECOND), text)
    try:
        at = datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    except ValueError:
        raise InvalidInput(
            f"expected 90, 15min, 2h or 3d after the mission's beginning, or a time such as 2030-01-01T12:00:00, "
            f"got '{text}'"
        ) from None
    try:
        at = at.replace(tzinfo=UTC) if at.tzinfo is None else at.astimezone(UTC)
    except OverflowError:
        raise _out_of_range(text) from None
    past = at - datetime(1970, 1, 1, tzinfo=UTC)
    return _in_range(((past.days * 86_400 + past.seconds) * 1_000_000 + past.microseconds) * 1_000, text)


def _in_range(at: MissionTime, text: str) -> MissionTime:
    if not 0 <= at < 2**63:
        raise _out_of_range(text)
    return at


def _out_of_range(text: str) -> InvalidInput:
    return InvalidInput(f"expected a time from 1970 to 2262, got '{text}'")
