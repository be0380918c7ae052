"""Signed messages and commands: whatever is forged, altered, replayed or not theirs to say is refused."""

from __future__ import annotations

import json
from datetime import timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import Refused, body_of, decode, encode, header_of, restamped
from schemas.commands import CommandKind, Telecommand
from schemas.roles import PERSON_ROLES
from schemas.signing import Part
from schemas.topics import COMMAND, ISSUE_COMMAND, PLAN, SAMPLE, STATE, TOPICS, Query
from schemas.wire import Header
from services.mission.mission_time import MAX_AHEAD, SECOND
from services.runtime.trust.authority import Authority
from services.runtime.trust.certificates import subject, utc_now
from services.runtime.trust.identity import load_identity
from services.runtime.trust.signing import Signer, Verifier

NOW = 10**18
HOUR = 3600 * SECOND
ORDER = Telecommand(command_id="c-12", kind=CommandKind.GO_TO, target_m=(12.5, 340.0), expires_at=NOW + HOUR)
KEEP_OUT = Telecommand(
    command_id="k1", kind=CommandKind.SET_KEEP_OUT, area_id="rim", polygon_m=((0.0, 0.0), (9.0, 0.0), (9.0, 9.0))
)
HEADER = Header(mission="m", source="ground", incarnation=3, sequence=7, made_at=NOW, expires_at=NOW + HOUR)


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    authority = Authority.create(tmp_path_factory.mktemp("trust") / "keys")
    for role, name in (("ground", "main"), ("rover", "main"), ("operator", "anna"), ("viewer", "anna")):
        authority.issue(subject(role, name))
    return authority


def signer(authority, common_name, instance="run-1"):
    role, name = common_name.split(".")
    identity = load_identity(authority.folder_of(subject(role, name)))
    return Signer(identity.common_name, identity.key, instance)


def verifier(authority, mission="m", instance="run-1", after=timedelta(0)):
    roster = authority.roster
    return Verifier(lambda: roster, mission, instance, lambda: utc_now() + after)


def sent(authority, common_name="ground.main", header=HEADER, body=ORDER, topic=COMMAND.name, part=Part.MESSAGE):
    """Header and body of a signed message, as it is received."""
    who = signer(authority, common_name)
    payload = encode(header, body, lambda head, content: who.signed(part, topic, head, content))
    return Header.model_validate(header_of(payload)), body_of(payload)


def verified(authority, header, body, roles=COMMAND.access.publish, now=NOW, **which):
    return verifier(authority, **which).verify(Part.MESSAGE, COMMAND.name, header, body, roles, now)


def received(authority, payload, mission, instance):
    header, _ = decode(COMMAND, payload, mission)
    return verified(authority, header, body_of(payload), mission=mission, instance=instance)


# --- messages -----------------------------------------------------------------------------------------------------


def test_a_signed_message_names_its_signer(keys):
    header, body = sent(keys)
    assert verified(keys, header, body).common_name == "ground.main"


def test_a_message_is_encoded_as_before_where_nothing_is_signed():
    header = json.loads(encode(HEADER.model_copy(update={"expires_at": None}), ORDER))["header"]
    assert {"version", "mission", "source", "incarnation", "sequence", "made_at", "checksum"} == set(header)
    assert "authorization" not in ORDER.model_dump_json()
    assert "issued_by" not in ORDER.model_dump_json()


def test_a_repetition_keeps_its_signature(keys):
    who = signer(keys, "ground.main")
    payload = encode(HEADER, ORDER, lambda head, content: who.signed(Part.MESSAGE, COMMAND.name, head, content))
    again = restamped(payload, 4, 2)
    assert again != payload
    header, _ = decode(COMMAND, again, "m")
    assert (header.held_from, header.repetition) == (4, 2)
    assert verified(keys, header, body_of(again)).common_name == "ground.main"


@given(st.data())
def test_one_changed_bit_of_the_body_is_refused(keys, data):
    header, body = sent(keys)
    bit = data.draw(st.integers(0, 8 * len(body) - 1))
    altered = bytearray(body)
    altered[bit // 8] ^= 1 << bit % 8
    with pytest.raises(Refused, match=r"expected the signature of ground.main over this very message"):
        verified(keys, header, bytes(altered))


NUMBERS = ("version", "incarnation", "sequence", "made_at", "expires_at")
TEXTS = ("mission", "source", "instance", "signer", "signature")


@given(st.sampled_from(NUMBERS), st.integers(0, 62))
def test_one_changed_bit_of_a_number_of_the_header_is_refused(keys, field, bit):
    header, body = sent(keys)
    altered = header.model_copy(update={field: getattr(header, field) ^ (1 << bit)})
    with pytest.raises(Refused):
        verified(keys, altered, body)


@given(st.sampled_from(TEXTS), st.data())
def test_one_changed_bit_of_a_text_of_the_header_is_refused(keys, field, data):
    header, _ = sent(keys)
    text = bytearray(getattr(header, field).encode())
    bit = data.draw(st.integers(0, 8 * len(text) - 1))
    text[bit // 8] ^= 1 << bit % 8
    altered = header.model_copy(update={field: text.decode("latin-1")})
    payload = encode(altered, ORDER)  # with a checksum that is right
    with pytest.raises(Refused):
        # the receiver's own mission and run are those of the altered message, too: the signature alone decides
        received(keys, payload, altered.mission, altered.instance)


@pytest.mark.parametrize("field", ["instance", "expires_at", "signer", "signature"])
def test_a_signed_message_without_one_of_its_fields_is_refused(keys, field):
    header, body = sent(keys)
    with pytest.raises(Refused):
        verified(keys, header.model_copy(update={field: None}), body)


def test_an_unsigned_message_is_refused(keys):
    with pytest.raises(Refused, match="tc/command of ground: expected a signature of role ground, got none"):
        verified(keys, HEADER, ORDER.model_dump_json().encode())


@pytest.mark.parametrize("topic", [PLAN.name, ISSUE_COMMAND.name, SAMPLE.name])
def test_a_signature_for_another_topic_is_refused(keys, topic):
    header, body = sent(keys, topic=topic)
    with pytest.raises(Refused, match="altered, or forged"):
        verified(keys, header, body)


@pytest.mark.parametrize("part", [Part.QUERY, Part.REPLY, Part.AUTHORIZATION])
def test_a_signature_of_another_kind_of_text_is_refused(keys, part):
    header, body = sent(keys, part=part)
    with pytest.raises(Refused, match="altered, or forged"):
        verified(keys, header, body)


def test_the_signature_of_another_role_is_refused_and_its_holder_named(keys):
    header, body = sent(keys, "viewer.anna")
    with pytest.raises(Refused, match="tc/command of viewer anna: expected role ground"):
        verified(keys, header, body)


def test_a_signer_who_poses_as_another_source_is_refused(keys):
    header, body = sent(keys, header=HEADER.model_copy(update={"source": "mallory"}))
    with pytest.raises(Refused, match="tc/command of ground main: expected source 'ground', got 'mallory'"):
        verified(keys, header, body)


def test_a_message_to_another_mission_or_another_run_is_refused(keys):
    header, body = sent(keys)
    with pytest.raises(Refused, match="expected mission 'other', run run-1, got mission 'm', run run-1"):
        verified(keys, header, body, mission="other")
    with pytest.raises(Refused, match="expected mission 'm', run run-2, got mission 'm', run run-1"):
        verified(keys, header, body, instance="run-2")


def test_a_message_counts_until_it_expires_and_not_after(keys):
    header, body = sent(keys)
    assert verified(keys, header, body, now=NOW + HOUR)
    with pytest.raises(Refused, match="expired 3600 s ago: late, or replayed"):
        verified(keys, header, body, now=NOW + 2 * HOUR)


def test_a_message_from_the_end_of_time_is_refused(keys):
    header, body = sent(keys, header=HEADER.model_copy(update={"made_at": 2**63 - 1, "expires_at": None}))
    with pytest.raises(Refused, match="expected one made by now"):
        verified(keys, header, body)
    header, body = sent(keys, header=HEADER.model_copy(update={"made_at": NOW + MAX_AHEAD, "expires_at": None}))
    assert verified(keys, header, body)


def test_an_expired_and_a_revoked_and_a_foreign_identity_are_refused(keys, tmp_path):
    header, body = sent(keys)
    with pytest.raises(Refused, match=r"ground.main: the certificate expired"):
        verified(keys, header, body, after=timedelta(days=100))
    other = Authority.create(tmp_path / "other")
    other.issue(subject("ground", "main"))
    foreign = sent(other)
    with pytest.raises(Refused, match="altered, or forged"):
        verified(keys, *foreign)
    was_right = sent(other)
    other.revoke(subject("ground", "main"))
    with pytest.raises(Refused, match=r"ground.main: revoked at"):
        verified(other, *was_right)


def test_an_unknown_signer_is_refused_without_a_defect(keys):
    header, body = sent(keys)
    with pytest.raises(Refused, match=r"expected a name of this mission's roster, got 'ground.other'"):
        verified(keys, header.model_copy(update={"signer": "ground.other"}), body)


# --- commands -----------------------------------------------------------------------------------------------------


def authorized(authority, common_name="operator.anna", order=ORDER, expires_at=NOW + HOUR, made_at=NOW):
    return signer(authority, common_name).authorized(order, "m", made_at, expires_at)


def test_the_rover_knows_the_person_behind_a_command_that_the_ground_passes_on(keys):
    command = authorized(keys)
    received = Telecommand.model_validate_json(command.model_dump_json())
    assert verifier(keys).verify_command(received, NOW).common_name == "operator.anna"
    assert (received.by, received.order) == ("operator.anna", ORDER)


def test_a_command_of_the_ground_itself_is_refused(keys):
    with pytest.raises(Refused, match="command c-12: expected the signature of role operator, got none"):
        verifier(keys).verify_command(ORDER, NOW)
    with pytest.raises(Refused, match="command c-12 of ground main: expected role operator"):
        verifier(keys).verify_command(authorized(keys, "ground.main"), NOW)


def test_a_command_of_a_viewer_is_refused(keys):
    with pytest.raises(Refused, match=r"^command c-12 of viewer anna: expected role operator$"):
        verifier(keys).verify_command(authorized(keys, "viewer.anna"), NOW)


CHANGES = {
    "command_id": "c-13",
    "kind": CommandKind.RETURN_TO_START,
    "expires_at": ORDER.expires_at + 1,
    "target_m": (12.5, 340.0 + 2**-44),
    "area_id": "rim",
    "polygon_m": KEEP_OUT.polygon_m,
}


@pytest.mark.parametrize("field", sorted(CHANGES))
def test_a_command_that_was_altered_anywhere_is_refused(keys, field):
    altered = authorized(keys).model_copy(update={field: CHANGES[field]})
    with pytest.raises(Refused, match="altered, or forged"):
        verifier(keys).verify_command(altered, NOW)


def test_every_field_of_a_command_is_signed_or_says_who_signed():
    assert set(Telecommand.model_fields) == {*CHANGES, "authorization", "issued_by", "objection"}


@given(st.sampled_from(["made_at", "expires_at"]), st.integers(0, 62))
def test_one_changed_bit_of_the_times_of_a_consent_is_refused(keys, field, bit):
    command = authorized(keys)
    consent = command.authorization
    altered = consent.model_copy(update={field: getattr(consent, field) ^ (1 << bit)})
    with pytest.raises(Refused, match="altered, or forged"):
        verifier(keys).verify_command(command.model_copy(update={"authorization": altered}), NOW)


def test_the_consent_to_one_command_does_not_count_for_another(keys):
    moved = KEEP_OUT.model_copy(update={"authorization": authorized(keys).authorization})
    with pytest.raises(Refused, match=r"command k1: expected the signature of operator.anna"):
        verifier(keys).verify_command(moved, NOW)


def test_a_command_to_another_mission_or_run_is_refused(keys):
    command = authorized(keys)
    with pytest.raises(Refused, match="altered, or forged"):
        verifier(keys, mission="other").verify_command(command, NOW)
    with pytest.raises(Refused, match="expected mission 'm', run run-2, got mission 'm', run run-1"):
        verifier(keys, instance="run-2").verify_command(command, NOW)


def test_a_command_replayed_after_an_hour_is_refused(keys):
    command = authorized(keys, order=ORDER.model_copy(update={"expires_at": None}))
    with pytest.raises(Refused, match="command c-12 of operator anna: expired 10 s ago: late, or replayed"):
        verifier(keys).verify_command(command, NOW + HOUR + 10 * SECOND)


def test_a_signed_command_cannot_carry_a_second_name(keys):
    command = authorized(keys).model_copy(update={"issued_by": "ben@host"})
    with pytest.raises(Refused, match="expected no other name"):
        verifier(keys).verify_command(command, NOW)


def test_an_unverified_name_is_marked_as_one():
    assert ORDER.model_copy(update={"issued_by": "ben@host"}).by == "ben@host (unverified)"
    assert ORDER.by == ""


# --- the table ----------------------------------------------------------------------------------------------------


def test_everything_that_crosses_the_link_is_signed():
    assert all(topic.signed for topic in TOPICS if topic.direction is not None)
    assert STATE.signed


def test_every_query_of_a_person_that_changes_something_is_signed():
    changing = [
        topic
        for topic in TOPICS
        if isinstance(topic.service, Query) and not topic.service.observes and {*PERSON_ROLES} & {*topic.access.query}
    ]
    assert ISSUE_COMMAND in changing
    assert [topic.name for topic in changing if not topic.signed] == []
