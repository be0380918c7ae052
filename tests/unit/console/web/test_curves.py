"""The curves of the charts: in the order of time, thinned, with the past put before them."""

from __future__ import annotations

from services.console.web.curves import MAX_POINTS, Curves


def test_a_point_out_of_turn_is_left_out_and_a_level_stretch_keeps_its_ends() -> None:
    curves = Curves()
    grown = [curves.add("queue", at, value) for at, value in ((0, 1), (1, 1), (2, 1), (1.5, 9), (3, 2))]
    assert grown == [True, True, False, False, True]
    assert curves.document()["queue"] == [(0, 1), (2, 1), (3, 2)]


def test_a_long_curve_keeps_its_first_and_its_last_point() -> None:
    curves = Curves()
    for at in range(3 * MAX_POINTS):
        curves.add("queue", at, at % 7)
    points = curves.document()["queue"]
    assert len(points) <= MAX_POINTS
    assert (points[0], points[-1]) == ((0, 0), (3 * MAX_POINTS - 1, (3 * MAX_POINTS - 1) % 7))
    assert points == sorted(points)


def test_the_past_is_put_before_what_was_heard() -> None:
    heard, past = Curves(), Curves()
    heard.add("queue", 5.0, 1.0)
    for at in (1.0, 5.0, 7.0):
        past.add("queue", at, at)
    heard.prepend(past)
    assert heard.document()["queue"] == [(1.0, 1.0), (5.0, 1.0)]
