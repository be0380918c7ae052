"""Times as text and back: exact to the nanosecond, and refused when invalid."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from he3.errors import InvalidInput
from services.console.client.time_format import duration, parse_moment, speed, utc

SECOND = 1_000_000_000
START = 1_893_456_000 * SECOND  # 2030-01-01


@pytest.mark.parametrize(
    ("digits", "text"),
    [
        (0, "2030-01-01T00:00:01Z"),
        (3, "2030-01-01T00:00:01.282Z"),
        (9, "2030-01-01T00:00:01.282999999Z"),
    ],
)
def test_a_time_is_cut_off_after_its_digits(digits: int, text: str) -> None:
    assert utc(START + 1_282_999_999, digits) == text


@given(st.integers(0, 2**63 - 1))
def test_a_time_that_is_written_with_microseconds_is_read_back(at: int) -> None:
    assert parse_moment(utc(at, 6), 0) == at - at % 1000


@pytest.mark.parametrize(("text", "seconds"), [("90", 90), ("1.5s", 1.5), ("15min", 900), ("2h", 7200), ("3d", 259200)])
def test_a_duration_counts_from_the_beginning(text: str, seconds: float) -> None:
    assert parse_moment(text, START) == START + round(seconds * SECOND)


@pytest.mark.parametrize(
    "text", ["", "soon", "-5", "1e5", "nan", "1969-12-31T23:59:59Z", "9999-01-01T00:00:00", "999999999d", "9" * 400]
)
def test_what_is_no_mission_time_is_refused(text: str) -> None:
    with pytest.raises(InvalidInput, match=r"^expected .*, got '"):
        parse_moment(text, START)


def test_a_time_of_another_zone_is_converted() -> None:
    assert parse_moment("2030-01-01T02:00:00+02:00", 0) == START


@pytest.mark.parametrize(
    ("rate", "text"), [(0, "paused"), (1, "real time"), (20, "20x"), (2.5, "2.5x"), (4000, "4,000x")]
)
def test_a_speed_is_a_factor_of_real_time(rate: float, text: str) -> None:
    assert speed(rate) == text


@pytest.mark.parametrize(
    ("seconds", "text"), [(12, "12 s"), (185, "3 min 05 s"), (14_520, "4 h 02 min"), (198_000, "2 d 07 h")]
)
def test_a_duration_has_its_two_largest_units(seconds: float, text: str) -> None:
    assert duration(seconds) == text
