"""The conditions that survive a restart of the link."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from he3.errors import He3Error, InvalidInput
from schemas.commands import NoParameters
from schemas.link import AtEdge, Direction, LinkChange, LinkConditions
from schemas.topics import LINK_SET, LINK_SHOW
from services.link.kept_conditions import KeptConditions, kept_conditions
from services.link.node import LinkNode, build_node
from services.mission.scenario import Scenario
from services.runtime.kept_file import KeptFile, kept_file
from services.runtime.node import Effect, Keep, LogRecord, QueryReceived, RefuseQuery, SendReply, Started

SCENARIO = Scenario(name="m", region="t1")
START = SCENARIO.start_ns

CHANGES = st.one_of(
    st.builds(LinkChange, loss=st.floats(0.0, 0.9), direction=st.sampled_from([None, *Direction])),
    st.builds(LinkChange, contact=st.booleans(), at_edge=st.sampled_from([None, *AtEdge])),
    st.builds(LinkChange, one_way_light_time_s=st.floats(0.0, 1200.0)),
    st.just(LinkChange(contact_as_scheduled=True)),
)


def give(node: LinkNode, change: LinkChange) -> list[Effect]:
    return list(node.handle(QueryReceived(LINK_SET, change, 7), START))


def status(node: LinkNode) -> tuple[LinkConditions, bool, bool | None]:
    effects = list(node.handle(QueryReceived(LINK_SHOW, NoParameters(), 8), START))
    (reply,) = [effect.reply for effect in effects if isinstance(effect, SendReply)]
    return reply.conditions, reply.contact, reply.contact_forced  # type: ignore[attr-defined]


@given(st.lists(CHANGES, min_size=1, max_size=4))
def test_a_link_that_starts_again_has_the_conditions_that_were_set(changes: list[LinkChange]) -> None:
    node = build_node(SCENARIO)
    list(node.handle(Started(1), START))
    for change in changes:
        effects = give(node, change)
        kinds = [type(effect) for effect in effects]
        assert kinds.index(Keep) < kinds.index(SendReply), "it is on the disk before the reply promises it"
        (kept,) = [effect.value for effect in effects if isinstance(effect, Keep)]
    assert isinstance(kept, KeptConditions)
    again = build_node(SCENARIO, kept=KeptConditions.model_validate_json(kept.model_dump_json()))
    assert status(again) == status(node)


def test_a_link_that_starts_again_says_which_conditions_were_set() -> None:
    node = build_node(SCENARIO)
    effects = [*give(node, LinkChange(contact=False)), *give(node, LinkChange(direction=Direction.UP, loss=0.25))]
    kept = [effect.value for effect in effects if isinstance(effect, Keep)][-1]
    assert isinstance(kept, KeptConditions)
    started = build_node(SCENARIO, kept=kept).handle(Started(2), START)
    lines = [effect.text for effect in started if isinstance(effect, LogRecord)]
    assert lines[1] == (
        "the conditions are those that were set before this start: "
        "up: light time 1.282 s, loss 0.25; down: light time 1.282 s; contact off (black-out)"
    )
    anew = [effect.text for effect in build_node(SCENARIO).handle(Started(2), START) if isinstance(effect, LogRecord)]
    assert anew == ["link up"]


def test_a_change_that_is_refused_is_not_kept() -> None:
    bad = LinkChange.model_construct(**{**LinkChange().model_dump(), "loss": 7.0})
    effects = give(build_node(SCENARIO), bad)
    assert any(isinstance(effect, RefuseQuery) for effect in effects)
    assert not any(isinstance(effect, Keep) for effect in effects)
    assert not any(isinstance(effect, Keep) for effect in give(build_node(SCENARIO), LinkChange(by="operator")))


def test_without_a_file_the_conditions_are_those_of_the_scenario(tmp_path: Path) -> None:
    assert kept_conditions(tmp_path / "link.json", "m", SCENARIO.link) is None


@pytest.mark.parametrize("content", [b"", b"\xff\x00", b"{}", b"folder", b'{"mission": "m"}'])
def test_kept_conditions_that_cannot_be_read_end_the_start_and_are_left_as_they_are(
    tmp_path: Path, content: bytes
) -> None:
    file = tmp_path / "link.json"
    if content == b"folder":
        file.mkdir()
    else:
        file.write_bytes(content)
    with pytest.raises(InvalidInput, match=r"link\.json: (expected the conditions|cannot read)"):
        kept_conditions(file, "m", SCENARIO.link)
    if file.is_file():
        assert file.read_bytes() == content


def test_kept_conditions_of_another_mission_or_scenario_end_the_start(tmp_path: Path) -> None:
    file = kept_file(tmp_path, "link")
    changed = SCENARIO.link.model_copy(update={"at_edge": AtEdge.DROP})
    KeptFile(file, pytest.fail).replace(
        KeptConditions(mission="m", of_scenario=SCENARIO.link, conditions=changed, contact_forced=False), 0.0
    )
    kept = kept_conditions(file, "m", SCENARIO.link)
    assert kept is not None
    assert (kept.conditions, kept.contact_forced) == (changed, False)
    with pytest.raises(InvalidInput, match=r"of mission other, got those of m; restore the file, or remove it"):
        kept_conditions(file, "other", SCENARIO.link)
    with pytest.raises(InvalidInput, match=r"set from those of this scenario, got some that were set from others"):
        kept_conditions(file, "m", changed)


def test_what_a_full_disk_refused_is_written_when_there_is_room_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    file = tmp_path / "journal" / "link.json"
    kept = KeptFile(file, said.append)
    value = KeptConditions(mission="m", of_scenario=SCENARIO.link, conditions=SCENARIO.link, contact_forced=False)

    def full(path: Path, content: bytes) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr("services.runtime.kept_file.replace_output", full)
        kept.replace(value, 10.0)
        kept.tend(14.0)
        kept.tend(16.0)
    assert said == [f"{file}: cannot keep for a restart what was set: No space left on device; it is tried again"]
    assert not file.exists()
    kept.tend(20.0)
    assert not file.exists(), "it was tried a moment ago"
    kept.tend(21.0)
    assert kept_conditions(file, "m", SCENARIO.link) == value
    assert said[1:] == [f"{file}: what was set is kept for a restart again"]
    kept.tend(99.0)
    assert len(said) == 2


def test_without_a_folder_for_journals_nothing_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    KeptFile(None, pytest.fail).replace(SCENARIO.link, 0.0)
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_may_not_be_read_is_an_error_of_the_system_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(path: Path) -> bytes:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr("services.link.kept_conditions.read_own", broken)
    with pytest.raises(He3Error, match=r"cannot read the kept conditions of the link: Input/output error") as error:
        kept_conditions(tmp_path / "link.json", "m", SCENARIO.link)
    assert not isinstance(error.value, InvalidInput), "the same command may succeed later"
