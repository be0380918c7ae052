"""The event log: a node handles an event whether or not its line can be written, and a log that ends early says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from he3.errors import He3Error, InvalidInput
from services.runtime.event_log import EventLog, lacks_of_merged, open_event_log

FULL = Path("/dev/full")
MANY = 1000
"""Lines that are more than a file buffers."""


def test_an_event_log_on_a_full_disk_raises_for_no_event_and_says_that_it_ends_early() -> None:
    log = EventLog(FULL)
    for number in range(MANY):
        log(number, "rover", "started")
    log.close()
    assert log.problem == "/dev/full: the event log ends early: No space left on device"


def test_an_event_log_of_which_only_the_end_does_not_fit_says_so_when_it_is_closed() -> None:
    log = EventLog(FULL)
    log(1, "rover", "started")
    assert log.problem is None
    log.close()
    assert log.problem is not None


def test_a_process_whose_event_log_ends_early_fails_at_its_end_and_not_for_bad_input() -> None:
    with pytest.raises(He3Error, match="the event log ends early") as found, open_event_log(FULL) as log:
        log(1, "rover", "started")
    assert not isinstance(found.value, InvalidInput)


def test_a_failure_of_the_process_is_not_hidden_by_its_event_log() -> None:
    def failing() -> None:
        with open_event_log(FULL) as log:
            log(1, "rover", "started")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        failing()


def test_an_event_log_in_a_place_without_its_folder_is_bad_input(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InvalidInput, match="cannot write the event log"):
        EventLog(tmp_path / "file" / "events.log")


def test_logs_are_not_merged_when_one_of_them_ends_early(tmp_path: Path) -> None:
    part, into = tmp_path / "rover.log", tmp_path / "events.log"
    part.write_text("1\trover\tstarted\n")
    assert lacks_of_merged([part], into, ["rover.log ends early"]) == ["rover.log ends early"]
    assert not into.exists()
    assert lacks_of_merged([part], into, []) == []
    assert into.read_text() == part.read_text()
    assert lacks_of_merged([part], FULL, []) == ["/dev/full: cannot write the event log: No space left on device"]
