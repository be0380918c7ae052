"""The table of topics, and the page that shows it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from schemas.__main__ import access_table, json_schemas, main, topic_table
from schemas.link import Direction
from schemas.roles import PERSON_ROLES, Role
from schemas.topics import BY_NAME, SIDES, TOPICS, Crosses, Custody, Latest, Query, Side, crossing

PAGE = Path(__file__).parents[3] / "docs" / "zenoh.md"
LOCK_DOWN = PAGE.with_name("lock-down.md")


def test_the_page_on_the_wire_shows_the_table_as_it_is():
    shown = re.search(r"<!-- topics: begin -->\n(.*)<!-- topics: end -->", PAGE.read_text(), re.DOTALL)
    assert shown is not None
    assert shown[1] == topic_table(), "expected the output of `python -m schemas --table` between the marks"


def test_every_key_that_the_page_names_is_a_topic_of_the_table():
    text = re.sub(r"<!-- topics: begin -->.*<!-- topics: end -->", "", PAGE.read_text(), flags=re.DOTALL)
    named = re.findall(r"he3/(?:\{mission\}|t1)/((?:tc|tm|moon|earth)/[a-z/-]+)", text)
    assert len(named) > 10
    assert {name.rstrip("/") for name in named} <= set(BY_NAME)


def test_names_are_unique_and_every_topic_is_in_the_table():
    import schemas.topics as table

    assert len(BY_NAME) == len(TOPICS)
    declared = [value for value in vars(table).values() if isinstance(value, table.Topic)]
    assert {topic.name for topic in declared} == set(BY_NAME)


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_a_key_is_made_of_root_mission_and_name(topic):
    assert topic.key("some-mission") == f"he3/some-mission/{topic.name}"


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_the_first_chunk_of_a_name_says_where_it_goes(topic):
    first = topic.name.split("/")[0]
    assert topic.crosses is {"tc": Crosses.UP, "tm": Crosses.DOWN}.get(first, Crosses.NEVER)
    assert topic.sides == ((Side.MOON, Side.EARTH) if first in ("tc", "tm") else (Side(first),))
    assert topic.direction is {"tc": Direction.UP, "tm": Direction.DOWN}.get(first)


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_questions_have_answers_and_only_what_crosses_is_under_custody(topic):
    assert isinstance(topic.service, Query) == (topic.reply is not None)
    if isinstance(topic.service, Custody):
        assert topic.crosses is not Crosses.NEVER
    if isinstance(topic.service, Latest) and topic.service.distinct:
        assert set(topic.service.distinct) <= set(topic.payload.model_fields)


def test_every_topic_that_crosses_goes_one_way():
    up, down = crossing(Direction.UP), crossing(Direction.DOWN)
    assert not set(up) & set(down)
    assert set(up) | set(down) == {topic for topic in TOPICS if topic.crosses is not Crosses.NEVER}


def test_commands_go_before_plans_and_samples_before_state():
    def priority(name):
        return BY_NAME[name].service.priority

    assert priority("tc/command") < priority("tc/plan")
    assert priority("tm/command") <= priority("tm/event") <= priority("tm/sample") < priority("tm/state")


def test_a_json_schema_is_there_for_every_message_and_every_answer(tmp_path, capsys):
    assert main([str(tmp_path)]) == 0
    written = {path.name.removesuffix(".schema.json") for path in tmp_path.iterdir()}
    assert written == set(json_schemas())
    assert {topic.name.replace("/", ".") for topic in TOPICS} <= written
    assert {f"{topic.name.replace('/', '.')}.reply" for topic in TOPICS if topic.reply} <= written
    assert main(["--table"]) == 0
    assert capsys.readouterr().out == topic_table()
    assert main(["one", "two"]) == 2


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_what_one_role_may_send_another_may_receive_and_the_reverse_on_each_side(topic):
    for side in topic.sides:
        access = topic.access_on(side)
        assert bool(access.publish) == bool(access.subscribe)
        assert bool(access.query) == bool(access.answer)
        assert access.publish or access.query, f"no role may use {topic.name} on the {side}"
        assert (topic.reply is not None) == (not access.publish)


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_a_role_has_rights_only_on_the_networks_that_it_stands_on(topic):
    for side in topic.sides:
        access = topic.access_on(side)
        roles = {*access.publish, *access.subscribe, *access.query, *access.answer}
        assert all(side in SIDES[role] for role in roles)


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_only_the_link_carries_what_crosses(topic):
    if topic.crosses is Crosses.NEVER:
        return
    departs, arrives = (Side.EARTH, Side.MOON) if topic.crosses is Crosses.UP else (Side.MOON, Side.EARTH)
    assert Role.LINK in topic.access_on(departs).subscribe
    assert topic.access_on(arrives).publish == (Role.LINK,)


def test_a_person_commands_and_changes_only_in_the_role_for_it():
    def changes(role):
        return {topic.name for topic in TOPICS if role in topic.access.query} - reads

    reads = {topic.name for topic in TOPICS if Role.VIEWER in topic.access.query}
    own = {"earth/ground/command", "earth/ground/interest", "earth/ground/authority", "earth/ground/plan/decide"}
    alarms = {"earth/ground/alarm"}
    assert changes(Role.OPERATOR) == own | alarms
    assert changes(Role.CONTROLLER) == alarms | {"earth/link/set", "earth/clock/set", "earth/time/control"}
    for role in PERSON_ROLES:
        assert not [topic.name for topic in TOPICS if role in (*topic.access.publish, *topic.access.answer)]


def test_the_page_on_lock_down_shows_who_may_do_what():
    shown = re.search(r"<!-- access: begin -->\n(.*)<!-- access: end -->", LOCK_DOWN.read_text(), re.DOTALL)
    assert shown is not None
    assert shown[1] == access_table(), "expected the output of `python -m schemas --access` between the marks"
