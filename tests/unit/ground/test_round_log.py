"""The round log: which version of a round the rover executes, and which samples are still to come."""

from __future__ import annotations

import pytest

from schemas.plans import PlannedSample, RoundPlan
from services.ground.round_log import RoundLog
from services.ground.round_record import RoundRecord


def plan(number: int, version: str = "") -> RoundPlan:
    x = 10.0 * number
    return RoundPlan(
        round=number,
        path_m=((x, 0.0), (x, 10.0), (x, 20.0)),
        samples=tuple(
            PlannedSample(sample_id=f"r{number}{version}s{k}", x_m=x, y_m=10.0 * k, depth_m=0.1) for k in (1, 2)
        ),
        information_nats=1.0,
    )


def round_log(*rounds: tuple[int, int]) -> tuple[RoundLog, list[RoundRecord]]:
    book = RoundLog()
    return book, [book.append(plan(number, f"v{revision}"), revision) for number, revision in rounds]


def settle(record: RoundRecord, *indices: int) -> None:
    for index in indices:
        record.settled.add(record.plan.samples[index].sample_id)
        record.arrived += 1


def test_a_round_is_closed_when_no_sample_of_it_is_still_to_come() -> None:
    _, (first,) = round_log((1, 1))
    assert [planned.sample_id for planned in first.pending] == ["r1v1s1", "r1v1s2"]
    settle(first, 0)
    assert not first.closed
    settle(first, 1)
    assert first.closed


def test_of_a_round_that_ended_early_only_measured_samples_are_still_to_come() -> None:
    _, (first,) = round_log((1, 1))
    first.ended_early = True
    assert first.closed
    first.done.add("r1v1s2")
    assert [planned.sample_id for planned in first.pending] == ["r1v1s2"]


def test_beginning_a_round_means_that_those_before_it_have_begun() -> None:
    book, records = round_log((1, 1), (2, 2), (3, 3))
    assert not book.begin(records[1])
    assert [record.begun for record in records] == [True, True, False]
    assert book.not_begun == [records[2]]


def test_a_round_that_was_replaced_and_yet_begun_ends_the_chain() -> None:
    book, (first, second) = round_log((1, 1), (2, 2))
    book.begin(first)
    book.drop([second])
    replacement = book.append(plan(2, "v3"), 3)
    book.append(plan(3, "v4"), 4)
    assert book.begin(second)
    assert book.chain == [first, second]
    assert not replacement.begun
    assert book.next_number == 3


def test_of_two_versions_that_were_both_begun_the_rover_gave_up_the_older() -> None:
    book, (first, second) = round_log((1, 1), (2, 2))
    book.begin(first)
    book.drop([second])
    replacement = book.append(plan(2, "v3"), 3)
    book.begin(second)
    assert book.begin(replacement)
    assert book.chain == [first, second, replacement]
    assert second.closed
    assert not replacement.closed
    # A late report of the older one does not reverse that.
    assert not book.begin(second)
    assert book.goes_on_after(second)
    assert not book.goes_on_after(replacement)


@pytest.mark.parametrize(("revision", "expected"), [(1, None), (2, 2), (3, 2), (4, 4), (9, 4)])
def test_the_version_that_a_rover_executes_is_the_newest_of_its_plan(revision: int, expected: int | None) -> None:
    book, (_, second) = round_log((1, 1), (2, 2))
    book.drop([second])
    book.append(plan(2, "v4"), 4)
    found = book.version(2, revision)
    assert (found and found.introduced) == expected


def test_samples_of_a_version_that_was_dropped_are_still_known() -> None:
    book, (_, second) = round_log((1, 1), (2, 2))
    book.drop([second])
    known = book.of_sample("r2v2s2")
    assert known is not None
    assert known == (second, 1)
    assert book.of_sample("r9s1") is None


def test_progress_is_followed_along_the_path_and_never_backwards() -> None:
    _, (first,) = round_log((1, 1))
    first.note_place((10.5, 12.0))
    assert first.reached_m == pytest.approx(12.0)
    first.note_place((10.0, 5.0))
    first.note_place((18.0, 15.0))
    assert first.reached_m == pytest.approx(12.0)
    assert first.driven()[-1] == pytest.approx((10.0, 12.0))
    assert first.ahead()[0] == pytest.approx((10.0, 12.0))
    assert first.to_drive_m == pytest.approx(8.0)


def test_driven_and_planned_paths_are_the_same_objects_until_something_changes() -> None:
    book, (first, _) = round_log((1, 1), (2, 2))
    before = book.paths()
    assert book.paths() is before
    book.begin(first)
    first.note_place((10.0, 7.0))
    assert book.paths() != before
    assert book.paths()[0] == ((10.0, 0.0), (10.0, 7.0))


def test_fruitless_rounds_are_counted_from_the_last_with_a_sample() -> None:
    book, records = round_log((1, 1), (2, 2), (3, 3), (4, 4))
    for record in records[:3]:
        book.begin(record)
        record.ended = record.ended_early = True
    assert book.fruitless == 3
    settle(records[1], 0)
    assert book.fruitless == 1
