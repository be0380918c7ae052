"""The link's clock where no earlier start of the link had saved it: it continues where the other processes are."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from he3.errors import InvalidInput
from schemas.topics import Side
from services.link.clock_keeper import ClockKeeper
from services.mission.mission_time import SECOND
from services.runtime.backlog import Backlog
from services.runtime.process_clock import ProcessClock

START = 1_893_456_000 * SECOND
HOUR = 3600 * SECOND


class Link:
    """A link's process whose sessions have no peer."""

    def __init__(
        self, *, keys: bool = False, rate: float = 1.0, wait_for: tuple[str, ...] = (), journal: Path | None = None
    ) -> None:
        self.warnings: list[str] = []
        self.infos: list[str] = []
        session = SimpleNamespace(
            serve=lambda *_: None, publish=lambda *_: None, watch_alive=lambda *_: None,
        )  # fmt: skip
        self.clock = ProcessClock()
        context: Any = SimpleNamespace(
            clock=self.clock, inbox=None, backlog=Backlog(),
            mission="m", name="link", sessions=dict.fromkeys(Side, session),
            options=SimpleNamespace(
                wait_for=wait_for, journal=journal, identity="link.main" if keys else None,
                scenario=SimpleNamespace(start_ns=START, rate=rate),
            ),
            log=SimpleNamespace(warning=self.warnings.append, info=lambda text, **_: self.infos.append(text)),
        )  # fmt: skip
        self.keeper = ClockKeeper(context)
        self.keeper.begin()

    def hours(self) -> int:
        """Whole hours of mission time."""
        return (self.clock.now() - START) // HOUR


@pytest.mark.parametrize("wait_for", [(), ("rover",)])
def test_it_continues_at_the_latest_time_that_a_process_has_reached(wait_for: tuple[str, ...]) -> None:
    link = Link(wait_for=wait_for)
    before = link.clock.followed.state
    for name, hours in (("field", 0), ("rover", 5), ("ground", 7), ("recorder", 6)):
        link.keeper._reached(name, START + hours * HOUR)
    assert link.hours() == 7
    after = link.clock.followed.state
    assert before is not None
    assert after is not None
    assert (after.epoch, after.rate) == (before.epoch, before.rate)
    assert after.revision > before.revision, "every process follows it"
    assert [line[line.index("; ") :] for line in link.warnings] == [
        "; rover has reached 2030-01-01T05:00:00Z, where it continues",
        "; ground has reached 2030-01-01T07:00:00Z, where it continues",
    ]


def test_processes_that_have_not_begun_or_are_ahead_by_their_clock_s_error_change_nothing() -> None:
    link = Link(rate=100.0)
    link.keeper._reached("rover", 0)
    link.keeper._reached("rover", START + 90 * SECOND)  # 0.9 s of wall time
    assert link.hours() == 0
    assert link.warnings == []


@pytest.mark.parametrize("rate", [0.0, 1.0])
def test_a_process_that_ran_on_at_a_high_rate_until_it_heard_of_the_change_moves_no_time(rate: float) -> None:
    link = Link(rate=20_000.0)
    link.keeper._change_rate(rate)
    link.keeper._reached("rover", link.clock.now() + 2 * HOUR)  # 0.36 s of wall time at the former rate
    assert link.warnings == []
    link.keeper._reached("rover", link.clock.now() + 24 * HOUR)
    assert len(link.warnings) == 1


def test_in_a_mission_with_keys_no_process_moves_time_and_the_log_says_once_why_it_stands() -> None:
    link = Link(keys=True)
    for _ in range(3):
        link.keeper._reached("rover", START + 5 * HOUR)
    assert link.hours() == 0
    (line,) = link.warnings
    assert line.endswith("rover has reached 2030-01-01T05:00:00Z, and all processes stand until then")


@pytest.mark.parametrize("keys", [True, False])
@pytest.mark.parametrize("content", [b"", b"\xff\x00", b"{}", b"folder"])
def test_a_saved_clock_that_cannot_be_read_ends_the_start_and_is_left_as_it_is(
    tmp_path: Path, content: bytes, keys: bool
) -> None:
    file = tmp_path / "clock.json"
    if content == b"folder":
        file.mkdir()
    else:
        file.write_bytes(content)
    with pytest.raises(InvalidInput, match=r"clock\.json: (expected the clock|cannot read)") as refusal:
        Link(keys=keys, journal=tmp_path)
    if file.is_file():
        assert file.read_bytes() == content
        assert ("remove it" in str(refusal.value)) is not keys, "with keys no process moves mission time"


def test_a_link_says_that_mission_time_continues(tmp_path: Path) -> None:
    assert Link(journal=tmp_path).infos == []
    assert Link(journal=tmp_path).infos == ["mission time continues"]


def test_the_clock_of_another_mission_in_the_folder_ends_the_start(tmp_path: Path) -> None:
    Link(journal=tmp_path)
    kept = (tmp_path / "clock.json").read_text()
    (tmp_path / "clock.json").write_text(kept.replace('"mission":"m"', '"mission":"other"'))
    with pytest.raises(InvalidInput, match="expected the clock of mission m, got that of mission other"):
        Link(journal=tmp_path)


def test_a_link_that_continues_after_a_start_of_the_machine_says_how_long_the_wall_clock_says_it_was_away(
    tmp_path: Path,
) -> None:
    Link(journal=tmp_path)
    assert Link(journal=tmp_path).warnings == [], "within one boot the monotonic clock tells it"
    file = tmp_path / "clock.json"
    kept = json.loads(file.read_text())
    for moved_s, said in ((-7200, "continues at 2030-01-01T02:00:0"), (7200, "7200 s earlier than when")):
        moved = {**kept["clock"], "anchor_wall_ns": kept["clock"]["anchor_wall_ns"] + moved_s * SECOND}
        file.write_text(json.dumps({**kept, "boot_id": "another", "clock": moved}))
        (line,) = Link(journal=tmp_path).warnings
        assert said in line
