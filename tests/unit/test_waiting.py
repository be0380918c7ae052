"""A promised duration is judged by what the machine did meanwhile: strictly where no process had to wait."""

from __future__ import annotations

import math

import pytest

from tests.waiting import SHARED, Stalls, expect_within, slowness, stalled_s


class Machine:
    """A clock and a time of waiting that a test moves."""

    def __init__(self) -> None:
        self.now_s = self.stalled_s = 100.0
        self.stalls = Stalls(lambda: self.stalled_s, lambda: self.now_s)

    def run(self, seconds: float, share: float) -> None:
        """Time passes, and for a share of it processes wait."""
        for _ in range(round(seconds / 0.1)):
            self.now_s += 0.1
            self.stalled_s += share * 0.1
            self.stalls.read()


def test_waiting_is_counted_over_the_asked_time_alone() -> None:
    machine = Machine()
    machine.run(5.0, 1.0)
    machine.run(4.0, 0.5)
    assert machine.stalls.within(2.0) == pytest.approx(1.0, abs=0.06)
    assert machine.stalls.within(8.0) == pytest.approx(6.0, abs=0.11)
    assert machine.stalls.within(1e6) == pytest.approx(7.0)


@pytest.mark.parametrize(
    ("took", "share", "kept"), [(1.0, 0.0, True), (2.0, 0.2, False), (3.0, 0.9, True), (2.0 * SHARED, 1.0, False)]
)
def test_a_promise_is_kept_late_only_if_processes_had_to_wait_for_so_long(
    took: float, share: float, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.waiting.slowness", lambda *_: 1.0)
    machine = Machine()
    machine.run(took, share)
    if kept:
        expect_within(1.0, took, "the end", stalls=machine.stalls)
        return
    with pytest.raises(AssertionError, match=r"the end: took .* expected at most 1 s"):
        expect_within(1.0, took, "the end", stalls=machine.stalls)


def test_what_this_machine_tells_of_waiting_never_falls() -> None:
    before = stalled_s()
    assert slowness() >= 1.0
    assert math.isinf(before) or stalled_s() >= before >= 0.0
