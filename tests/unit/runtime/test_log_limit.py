from dataclasses import replace

import pytest

from services.runtime.log_limit import FIRST, FORGOTTEN_AFTER_S, MAX_CAUSES, SUMMARY_EVERY_S, LogLimit
from services.runtime.node import Cause, Level, LogRecord


def refused(source="mallory", kind="tc/plan: malformed", number=0):
    return LogRecord(Level.WARNING, f"refused: tc/plan of {source}", {"refused": number}, Cause(kind, source))


def flood(limit, lines, at_s, **of):
    return [line for number in range(lines) for line in limit.admit(refused(number=number, **of), at_s)]


def not_shown(lines):
    return sum(line.fields.get("not_shown", 0) for line in lines)


def test_a_line_that_nobody_outside_causes_is_always_written():
    limit, line = LogLimit(), LogRecord(Level.WARNING, "the disk is full")
    assert [shown for _ in range(1_000) for shown in limit.admit(line, 0.0)] == [line] * 1_000


def test_the_first_lines_of_a_cause_are_written_whole_and_the_rest_as_one_count():
    limit = LogLimit()
    assert flood(limit, 10_000, 1.0) == [refused(number=number) for number in range(FIRST)]
    assert limit.due(SUMMARY_EVERY_S) == []
    (summary,) = limit.due(1.0 + SUMMARY_EVERY_S)
    assert summary.level is Level.WARNING
    assert summary.fields == {"not_shown": 10_000 - FIRST, "refused": 9_999}
    assert "9995 more lines" in summary.text
    assert "9995 of 'mallory' (tc/plan: malformed)" in summary.text
    assert "refused: tc/plan of mallory" in summary.text, "the last of them"
    assert limit.due(1e6) == []


def test_a_flood_writes_one_summary_a_minute_and_no_line_goes_uncounted():
    limit = LogLimit()
    lines = [line for second in range(600) for line in [*flood(limit, 100, float(second)), *limit.due(float(second))]]
    lines += limit.rest()
    whole = [line for line in lines if "not_shown" not in line.fields]
    assert len(whole) == FIRST
    assert len(lines) - len(whole) == 10
    assert not_shown(lines) + len(whole) == 60_000


def test_a_summary_is_due_even_while_a_flood_leaves_no_time_to_ask_for_it():
    limit = LogLimit()
    assert not_shown(flood(limit, 100, 0.0) + flood(limit, 100, SUMMARY_EVERY_S)) > 0


@pytest.mark.parametrize("other", [{"source": "rover"}, {"kind": "tm/state: not permitted"}])
def test_a_flood_does_not_bury_the_line_of_another_source_or_kind(other):
    limit = LogLimit()
    flood(limit, 10_000, 0.0)
    assert limit.admit(refused(**other), 0.0) == [refused(**other)]


def test_a_source_that_sends_something_wrong_once_an_hour_has_a_line_each_time():
    limit = LogLimit()
    hourly = FORGOTTEN_AFTER_S + 1
    assert len([line for hour in range(100) for line in limit.admit(refused(), hour * hourly)]) == 100


def test_invented_senders_share_few_lines_and_little_memory():
    limit = LogLimit()
    lines = [line for number in range(100_000) for line in limit.admit(refused(source=f"m{number}"), 0.0)]
    assert len(lines) == MAX_CAUSES + FIRST
    assert len(limit._seen) <= MAX_CAUSES + 1
    (summary,) = limit.rest()
    assert not_shown([summary]) + len(lines) == 100_000
    assert len(summary.text) < 500


def test_a_kind_that_is_new_has_its_lines_though_invented_senders_have_all_places():
    limit = LogLimit()
    for number in range(1_000):
        limit.admit(refused(source=f"m{number}"), 0.0)
    new = refused(kind="tm/state: damaged", source="rover")
    assert limit.admit(new, 0.0) == [new]


def test_places_of_senders_that_are_quiet_are_given_to_others():
    limit = LogLimit()
    for number in range(1_000):
        limit.admit(refused(source=f"m{number}"), 0.0)
    limit.rest()
    later = FORGOTTEN_AFTER_S + 1
    assert flood(limit, FIRST, later, source="rover") == [
        refused(source="rover", number=number) for number in range(FIRST)
    ]


def test_a_summary_has_the_highest_level_of_what_it_counts():
    limit = LogLimit()
    flood(limit, FIRST + 1, 0.0)
    for _ in range(FIRST + 1):
        limit.admit(replace(refused(kind="defect"), level=Level.ERROR), 0.0)
    assert [line.level for line in limit.rest()] == [Level.ERROR]


def test_nothing_to_count_gives_no_summary():
    limit = LogLimit()
    flood(limit, FIRST, 0.0)
    assert limit.rest() == []
