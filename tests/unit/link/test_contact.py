"""The contact schedule: windows, duty cycles and forced contact."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.link import DutyCycle, LinkConditions, Window
from services.link.contact import Contact, Span

START = 1_893_456_000_000_000_000
S = 1_000_000_000


def windows(*pairs: tuple[float, float]) -> LinkConditions:
    return LinkConditions(windows=tuple(Window(opens_s=opens, closes_s=closes) for opens, closes in pairs))


def duty(period_s: float, contact_s: float, offset_s: float = 0.0) -> LinkConditions:
    return LinkConditions(duty_cycle=DutyCycle(period_s=period_s, contact_s=contact_s, offset_s=offset_s))


def test_without_windows_there_is_always_contact() -> None:
    contact = Contact.of(LinkConditions(), START)
    assert contact.open_at(START)
    assert contact.open_at(START + 10**18)
    assert contact.changes_at(START) is None
    assert contact.longest_from(START) is None
    assert contact.after(START, 5 * S) == START + 5 * S


def test_a_window_includes_its_opening_and_excludes_its_closing() -> None:
    contact = Contact.of(windows((10, 20), (30, 35)), START)
    assert not contact.open_at(START + 10 * S - 1)
    assert contact.open_at(START + 10 * S)
    assert contact.open_at(START + 20 * S - 1)
    assert not contact.open_at(START + 20 * S)
    assert contact.changes_at(START) == START + 10 * S
    assert contact.changes_at(START + 10 * S) == START + 20 * S
    assert contact.changes_at(START + 20 * S) == START + 30 * S
    assert contact.changes_at(START + 35 * S) is None
    assert contact.span_from(START + 35 * S) is None


def test_adjacent_windows_are_merged() -> None:
    contact = Contact.of(windows((0, 10), (10, 20)), START)
    assert contact.windows == (Span(START, START + 20 * S),)


def test_a_duty_cycle_repeats_before_and_after_its_offset() -> None:
    contact = Contact.of(duty(100, 30, offset_s=50), START)
    assert [contact.open_at(START + t * S) for t in (-50, -21, -20, 0, 49, 50, 79, 80, 149, 150, 180)] == [
        True, True, False, False, False, True, True, False, False, True, False,
    ]  # fmt: skip
    assert contact.changes_at(START) == START + 50 * S
    assert contact.longest_from(START + 79 * S) == 30 * S


def test_forced_contact_and_forced_blackout_override_the_schedule() -> None:
    closed = Contact.of(LinkConditions(), START, forced=False)
    opened = Contact.of(windows((10, 20)), START, forced=True)
    assert not closed.open_at(START)
    assert closed.changes_at(START) is None
    assert closed.after(START, 1) is None
    assert closed.longest_from(START) == 0
    assert opened.open_at(START + 25 * S)
    assert opened.changes_at(START) is None


def test_contact_time_passes_only_within_windows() -> None:
    contact = Contact.of(windows((10, 20), (30, 35)), START)
    assert contact.after(START, 4 * S) == START + 14 * S
    assert contact.after(START + 18 * S, 2 * S) == START + 20 * S
    assert contact.after(START + 18 * S, 3 * S) == START + 31 * S
    assert contact.after(START, 16 * S) is None


@given(
    period=st.integers(1, 50),
    share=st.integers(1, 50),
    offset=st.integers(0, 100),
    begins=st.integers(0, 300),
    duration=st.integers(0, 300),
)
def test_contact_time_in_a_duty_cycle_agrees_with_counting_seconds(
    period: int, share: int, offset: int, begins: int, duration: int
) -> None:
    share = min(share, period)
    contact = Contact.of(duty(period, share, offset), START)
    counted, time = 0, begins
    while counted < duration or not contact.open_at(START + time * S):
        if counted == duration and duration > 0:
            break
        counted += contact.open_at(START + time * S)
        time += 1
    assert contact.after(START + begins * S, duration * S) == START + time * S


@given(period=st.integers(1, 50), share=st.integers(1, 50), offset=st.integers(0, 100), time=st.integers(-200, 300))
def test_contact_does_not_change_before_the_predicted_time(period: int, share: int, offset: int, time: int) -> None:
    contact = Contact.of(duty(period, min(share, period), offset), START)
    changes_at = contact.changes_at(START + time * S)
    if changes_at is None:
        assert share >= period
        return
    assert changes_at > START + time * S
    now = contact.open_at(START + time * S)
    assert contact.open_at(changes_at - 1) is now
    assert contact.open_at(changes_at) is not now


@pytest.mark.parametrize(("time_s", "longest_s"), [(0, 10), (15, 5), (20, 5), (34, 1), (35, 0)])
def test_the_longest_contact_counts_the_rest_of_the_present_one(time_s: int, longest_s: int) -> None:
    contact = Contact.of(windows((10, 20), (30, 35)), START)
    assert contact.longest_from(START + time_s * S) == longest_s * S
