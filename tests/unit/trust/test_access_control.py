"""The routers' access rules follow from the topic table: nothing more is allowed, and nothing less."""

from __future__ import annotations

from pathlib import Path

import pytest

from schemas.roles import PERSON_ROLES, Role
from schemas.topics import DISPLAYS, SIDES, TOPICS, Side, liveliness_key
from services.runtime.lockstep.topics import JOIN, TO_TIME_MANAGER, grant_to
from services.runtime.trust.access_control import Right, access_control, allowed_keys
from services.runtime.trust.zenoh_files import EXAMPLE_NAMES, example_files

RIGHTS = {Right.PUBLISH: "publish", Right.SUBSCRIBE: "subscribe", Right.QUERY: "query", Right.ANSWER: "answer"}
SHIPPED = Path(__file__).parents[3] / "deploy" / "zenoh"


def may(role, right, key, side):
    return key in allowed_keys(side, "m").get(role, {}).get(right, ())


@pytest.mark.parametrize("topic", [each for each in TOPICS if not each.per_process], ids=lambda topic: topic.name)
def test_each_role_may_do_with_a_topic_what_the_table_says_and_nothing_else(topic):
    for side in topic.sides:
        access = topic.access_on(side)
        for role in Role:
            for right, name in RIGHTS.items():
                assert may(role, right, topic.key("m"), side) == (role in getattr(access, name)), (side, role, right)


def test_a_role_has_no_rights_on_the_other_side():
    for side in Side:
        assert set(allowed_keys(side, "m")) == {role for role in Role if side in SIDES[role]}


def test_no_key_is_a_pattern_but_those_of_liveliness():
    for side in Side:
        for role, rights in allowed_keys(side, "m").items():
            for right, keys in rights.items():
                assert len(keys) == len(set(keys)), (role, right)
                if right not in (Right.APPEAR, Right.WATCH):
                    assert not [key for key in keys if "*" in key]


def test_only_participants_may_use_the_keys_of_lockstep():
    for side in Side:
        for role, rights in allowed_keys(side, "m").items():
            counted = [key for right in RIGHTS for key in rights.get(right, ()) if "@counted" in key]
            assert bool(counted) == (role in (Role.LINK, Role.FIELD, Role.ROVER, Role.GROUND)), (side, role)


@pytest.mark.parametrize("role", [Role.FIELD, Role.ROVER, Role.GROUND])
def test_a_participant_may_join_and_hears_its_own_grants_alone(role):
    (side,) = SIDES[role]
    assert may(role, Right.QUERY, JOIN[side].key("m"), side)
    for other in Role:
        grants = grant_to(other.value, side).key("m")
        assert may(role, Right.SUBSCRIBE, grants, side) == (other is role)
        assert may(Role.LINK, Right.PUBLISH, grants, side) == (other in (Role.FIELD, Role.ROVER, Role.GROUND)
                                                               and side in SIDES[other])  # fmt: skip
    for family in TO_TIME_MANAGER:
        assert may(role, Right.PUBLISH, family[side].key("m"), side)
        assert may(Role.LINK, Right.SUBSCRIBE, family[side].key("m"), side)


def test_a_process_appears_under_its_own_name_alone():
    for side in Side:
        for role, rights in allowed_keys(side, "m").items():
            for key in rights.get(Right.APPEAR, ()):
                assert key.rsplit("/", 1)[1] in (role.value, f"{role.value}.$*")


def test_a_person_may_appear_as_a_display_of_earth_under_the_own_role_and_see_the_others():
    for role in PERSON_ROLES:
        assert may(role, Right.APPEAR, liveliness_key("m", Side.EARTH, f"{role.value}.$*", DISPLAYS), Side.EARTH)
        assert may(role, Right.WATCH, liveliness_key("m", Side.EARTH, "*", DISPLAYS), Side.EARTH)
        others = [other for other in Role if other is not role]
        for other in others:
            assert not may(role, Right.APPEAR, liveliness_key("m", Side.EARTH, f"{other}.$*", DISPLAYS), Side.EARTH)


def test_a_role_that_no_certificate_has_is_left_out_because_zenoh_takes_no_name_for_every_name():
    rules = access_control(Side.EARTH, "m", {Role.LINK: ("link.main",), Role.OPERATOR: ()})
    assert [each["id"] for each in rules["subjects"]] == ["link"]
    assert all(each["cert_common_names"] for each in rules["subjects"])
    assert {rule["id"].split("-")[0] for rule in rules["rules"]} == {"link"}


def test_everything_is_denied_that_no_rule_allows():
    for side in Side:
        rules = access_control(side, "m", EXAMPLE_NAMES)
        assert rules["enabled"]
        assert rules["default_permission"] == "deny"
        assert {rule["permission"] for rule in rules["rules"]} == {"allow"}
        used = [rule for policy in rules["policies"] for rule in policy["rules"]]
        assert sorted(used) == sorted(rule["id"] for rule in rules["rules"])


def test_the_shipped_files_are_the_generated_ones():
    for side, text in example_files().items():
        path = SHIPPED / f"{side.value}-access.json5"
        assert path.read_text() == text, (
            f"expected the output of `python -m services.runtime.trust.zenoh_files` in {path}"
        )


@pytest.mark.parametrize("side", Side)
def test_zenoh_reads_from_a_shipped_file_the_rules_that_the_link_applies(side):
    import json

    zenoh = pytest.importorskip("zenoh")
    config = zenoh.Config.from_file(str(SHIPPED / f"{side.value}-access.json5"))
    read = json.loads(config.get_json("access_control"))
    made = access_control(side, "t1", EXAMPLE_NAMES)
    assert read["default_permission"] == "deny"
    for part in ("rules", "subjects", "policies"):
        assert [{key: each[key] for key in given} for each, given in zip(read[part], made[part], strict=True)] == made[
            part
        ]
