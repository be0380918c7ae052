"""Encoding and decoding of messages: the seal, the checks, and the refusals."""

from __future__ import annotations

import json
from random import Random

import pytest
from pydantic import TypeAdapter

from schemas.codec import Damaged, Refused, decode, encode, raw_objection, restamped
from schemas.plans import MissionPlan
from schemas.refusal import decode_refusal
from schemas.telemetry import EventKind, RoverEvent
from schemas.topics import EVENT, PLAN
from schemas.wire import MAX_TEXT, Header, Text
from services.link.impairments import corrupt

HEADER = Header(mission="m", source="rover", incarnation=2, sequence=5, made_at=10**18)
BODY = RoverEvent(kind=EventKind.PARKED, at=0, x_m=0.0, y_m=0.0, round=3, detail='a ,"checksum":1},"body": b')


def test_a_message_is_sealed_and_decoded_as_it_was() -> None:
    header, body = decode(EVENT, encode(HEADER, BODY), "m")
    assert body == BODY
    assert header.checksum is not None
    assert header.model_copy(update={"checksum": None}) == HEADER


def test_a_change_of_one_to_four_bytes_is_always_refused() -> None:
    payload = encode(HEADER, BODY)
    for seed in range(3000):
        with pytest.raises(Refused):
            decode(EVENT, corrupt(payload, Random(seed)), "m")


def test_damage_in_header_or_body_is_reported_as_damage() -> None:
    payload = encode(HEADER, BODY)
    for found, put in ((b'"sequence":5', b'"sequence":7'), (b'"round":3', b'"round":4')):
        with pytest.raises(Damaged, match=r"tm/event: expected checksum \d+ as in the header, got \d+: damaged"):
            decode(EVENT, payload.replace(found, put), "m")


def test_a_message_without_checksum_is_not_checked() -> None:
    plain = {"header": json.loads(HEADER.model_dump_json()), "body": json.loads(BODY.model_dump_json())}
    assert decode(EVENT, json.dumps(plain, indent=1).encode(), "m")[1] == BODY


def test_a_checksum_in_another_form_is_refused() -> None:
    spaced = json.dumps(json.loads(encode(HEADER, BODY))).encode()
    with pytest.raises(Refused, match="expected the checksum last"):
        decode(EVENT, spaced, "m")


def test_a_repetition_differs_in_its_number_and_its_seal_only() -> None:
    again = restamped(restamped(encode(HEADER, BODY), 3, 1), 4, 2)
    header, body = decode(EVENT, again, "m")
    assert body == BODY
    assert header.model_copy(update={"checksum": None}) == HEADER.model_copy(update={"held_from": 4, "repetition": 2})
    with pytest.raises(Refused, match="sealed"):
        restamped(b"{}", 1, 1)


def test_a_message_that_is_too_long_is_refused_before_it_is_read() -> None:
    with pytest.raises(Refused, match="at most 1048576 bytes"):
        decode(PLAN, b"x" * 1_048_577, "m")
    assert MissionPlan is PLAN.payload


@pytest.mark.parametrize("text", ["\x1b[2Jcleared", "two\nlines", "\u202etxt.exe", "\x9b31m", "\u2028"])
def test_a_text_of_a_message_is_shown_escaped_wherever_it_came_from(text: str) -> None:
    assert TypeAdapter(Text).validate_python(text).isprintable()
    assert TypeAdapter(Text).validate_json(json.dumps(text)).isprintable()
    assert len(TypeAdapter(Text).validate_python(text * 20)) <= MAX_TEXT
    assert decode_refusal(json.dumps({"error": text}).encode()).error.isprintable()
    assert decode_refusal(text.encode()).error.isprintable()


@pytest.mark.parametrize("source", ["[]", "{}", "7", "null", '"mallory"'])
def test_the_link_passes_on_no_message_of_a_source_that_does_not_make_it(source: str) -> None:
    why = raw_objection(PLAN, f'{{"header":{{"source":{source}}},"body":{{}}}}'.encode())
    assert why is not None
    assert str(why).startswith("tc/plan: expected a message of ground, got one of")
