"""The contacts to come, by the link's schedule."""

from __future__ import annotations

from schemas.link import DirectionCounts, DutyCycle, LinkConditions, LinkStatus, Window
from services.console.client.contacts import MAX_AHEAD, contacts_ahead
from services.mission.mission_time import SECOND

START = 1_000 * SECOND


def ahead(at_s: float, forced: bool | None = None, **conditions: object) -> list[tuple[float, float | None]]:
    link = LinkStatus(
        conditions=LinkConditions.model_validate(conditions), contact=True, contact_changes_at=None,
        up=DirectionCounts(), down=DirectionCounts(), in_flight=(), contact_forced=forced, incarnation=1,
    )  # fmt: skip
    spans = contacts_ahead(link, START, START + round(at_s * SECOND))
    return [((a - START) / SECOND, None if b is None else (b - START) / SECOND) for a, b in spans]


def test_the_present_contact_and_those_to_come_are_listed_in_order() -> None:
    windows = (Window(opens_s=0.0, closes_s=50.0), Window(opens_s=70.0, closes_s=90.0))
    assert ahead(10.0, windows=windows) == [(0.0, 50.0), (70.0, 90.0)]
    assert ahead(60.0, windows=windows) == [(70.0, 90.0)]
    assert ahead(90.0, windows=windows) == []


def test_a_duty_cycle_goes_on_and_is_listed_up_to_a_bound() -> None:
    found = ahead(5.0, duty_cycle=DutyCycle(period_s=100.0, contact_s=30.0))
    assert found[:2] == [(0.0, 30.0), (100.0, 130.0)]
    assert len(found) == MAX_AHEAD


def test_contact_without_an_end_is_one_span_and_a_black_out_is_none() -> None:
    assert ahead(5.0)[0][1] is None
    assert ahead(5.0, forced=False) == []
