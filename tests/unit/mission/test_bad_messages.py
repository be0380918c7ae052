"""Bad messages on every topic: each is refused in one line, and changes nothing.

The examples and what is wrong with them are made from each topic's own JSON Schema, so that a new topic, or a new field
of an old one, is tested from the beginning.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterator
from functools import partial
from typing import Any

import pytest

from he3.errors import He3Error
from schemas.codec import Damaged, Refused, decode, decode_reply, encode
from schemas.topics import BY_NAME, MAP_FEED, MAP_POINT, TOPICS, Crosses, Side, Topic
from schemas.wire import SCHEMA_VERSION, Header
from services.mission.deployment import find_scenario
from services.mission.in_process import InProcessMission
from services.mission.scenario import load_scenario
from services.runtime.host import origin
from services.runtime.node import Level
from services.runtime.transport.request import request_from_selector

MISSION = "short"
ENVELOPES = [topic for topic in TOPICS if topic is not MAP_FEED]
"""The map's feed is no envelope: what it refuses is in test_map_feed."""

Json = Any


# --- an example of anything, from its schema --------------------------------------------------------------------


def example(schema: Json, definitions: Json) -> Json:
    """The smallest value that such a schema admits."""
    if "$ref" in schema:
        return example(definitions[schema["$ref"].rsplit("/", 1)[-1]], definitions)
    if "const" in schema:
        return schema["const"]
    if "enum" in schema:
        return schema["enum"][0]
    if "anyOf" in schema:
        return None if {"type": "null"} in schema["anyOf"] else example(schema["anyOf"][0], definitions)
    match schema.get("type"):
        case "object":
            properties = schema.get("properties", {})
            return {name: example(properties[name], definitions) for name in schema.get("required", [])}
        case "array" if "prefixItems" in schema:
            return [example(each, definitions) for each in schema["prefixItems"]]
        case "array":
            return [example(schema["items"], definitions)] * schema.get("minItems", 0)
        case "integer":
            return schema.get("minimum", schema.get("exclusiveMinimum", -1) + 1)
        case "number" if "exclusiveMinimum" in schema:
            low = schema["exclusiveMinimum"]
            return (low + schema.get("maximum", schema.get("exclusiveMaximum", low + 2.0))) / 2
        case "number":
            return float(schema.get("minimum", 0.0))
        case "boolean":
            return False
        case "string":
            return "a1"
    return None


def body_schema(topic: Topic) -> tuple[Json, Json]:
    schema = topic.payload.model_json_schema()
    return schema, schema.get("$defs", {})


def body_example(topic: Topic) -> dict[str, Json]:
    body = example(*body_schema(topic))
    assert isinstance(body, dict)
    return body


def wrong_values(schema: Json, definitions: Json) -> Iterator[tuple[str, Json]]:
    """A description of the error and a wrong value, for a field of that schema."""
    if "$ref" in schema:
        yield from wrong_values(definitions[schema["$ref"].rsplit("/", 1)[-1]], definitions)
        return
    for branch in schema.get("anyOf", []):
        if branch != {"type": "null"}:
            yield from wrong_values(branch, definitions)
            return
    if "enum" in schema or "const" in schema:
        yield "an unknown word", "nothing-of-the-kind"
    kind = schema.get("type")
    yield "another type", "text" if kind in ("object", "array") else {"an": "object"}
    if kind in ("integer", "number"):
        yield "a number as text", "1"
        yield "a truth value", True
        if "minimum" in schema:
            yield "below its range", schema["minimum"] - 1
        if "exclusiveMinimum" in schema:
            yield "at an open end of its range", schema["exclusiveMinimum"]
        if "maximum" in schema:
            yield "above its range", schema["maximum"] * 2 + 1
        if "exclusiveMaximum" in schema:
            yield "beyond its range", schema["exclusiveMaximum"]
        yield "NaN", float("nan")
        yield "infinite", float("inf")
    if kind == "integer":
        yield "a fraction", 0.5
    if kind == "string" and "maxLength" in schema:
        yield "too long", "a" * (schema["maxLength"] + 1)
    if kind == "string" and "pattern" in schema:
        yield "other letters", "\n\x00 ;"
    if kind == "array" and schema.get("maxItems", 10**9) <= 10_000 and "prefixItems" not in schema:
        yield "too many", [example(schema["items"], definitions)] * (schema["maxItems"] + 1)
    if kind == "array" and schema.get("minItems"):
        yield "too few", []


# --- bad messages of one topic ----------------------------------------------------------------------------------


def header(source: str = "stranger", **more: Json) -> dict[str, Json]:
    return {"mission": MISSION, "source": source, "incarnation": 1, "sequence": 0, "made_at": 5, **more}


def text(head: Json, body: Json) -> bytes:
    return json.dumps({"header": head, "body": body}).encode()


def source_of(topic: Topic) -> str:
    """A process that makes such messages, or a person."""
    return min(topic.sources or {"stranger"})


def bad_messages(topic: Topic) -> Iterator[tuple[str, bytes]]:
    """A description of the error and the message with it."""
    body, head = body_example(topic), partial(header, source=source_of(topic))
    good = text(head(), body)
    decode(topic, good, MISSION)  # else nothing below would mean anything
    sealed = encode(Header.model_validate(head()), decode(topic, good, MISSION)[1])
    decode(topic, sealed, MISSION)
    yield "nothing", b""
    yield "other bytes", bytes(range(128, 256))
    yield "no JSON", b"mission please"
    yield "half of it", good[: len(good) // 2]
    yield "more than it", good + b"x"
    yield "two of them", good + good
    yield "deeply nested", b"[" * 10_000 + b"]" * 10_000
    yield "deeply nested objects", b'{"a":' * 2_000
    yield "a list", b"[1, 2]"
    yield "a number", b"7"
    yield "nothing at all", b"null"
    yield "too long", good + b" " * topic.max_bytes
    yield "no header", json.dumps({"body": body}).encode()
    yield "no body", json.dumps({"header": head()}).encode()
    yield "one part too many", json.dumps({"header": head(), "body": body, "tail": 1}).encode()
    yield "header: an unknown field", text(head(colour="red"), body)
    yield "header: another version", text(head(version=SCHEMA_VERSION + 1), body)
    yield "header: a version as text", text(head(version=str(SCHEMA_VERSION)), body)
    yield "header: another mission", text(head(mission="another"), body)
    yield "header: no mission's name", text(head(mission="../moon"), body)
    yield "header: a source that is no name", text(head(source="a b"), body)
    if topic.sources is not None:
        yield "header: a source that does not make them", text(head(source="mallory"), body)
        yield "header: a source in other letters", text(head(source=source_of(topic).upper()), body)
    yield "header: a lone surrogate", text(head(source="\ud800"), body)
    yield "header: a number that none reaches", text(head(sequence=2**53), body)
    yield "header: an incarnation that none reaches", text(head(incarnation=2**62), body)
    yield "header: a message that is not kept", text(head(held_from=1), body)
    yield "header: a source without end", text(head(source="a" * 65), body)
    yield "header: a negative sequence", text(head(sequence=-1), body)
    yield "header: a sequence that is a fraction", text(head(sequence=0.5), body)
    yield "header: a time before time", text(head(made_at=-1), body)
    yield "header: a time beyond time", text(head(made_at=2**63), body)
    yield "header: a time in seconds", text(head(made_at=1.5), body)
    yield "header: a checksum that is not where it belongs", text(head(checksum=1), body)
    for name in head():
        yield f"header: no {name}", text({key: value for key, value in head().items() if key != name}, body)
    yield "body: a text", text(head(), "text")
    yield "body: an unknown field", text(head(), {**body, "colour": "red"})
    yield "a checksum of another message", sealed.replace(b'"sequence":0', b'"sequence":1')
    yield "a byte of it changed", sealed.replace(b'"body":{', b'"body": {', 1)
    schema, definitions = body_schema(topic)
    for name in schema.get("required", []):
        yield f"{name}: missing", text(head(), {key: value for key, value in body.items() if key != name})
    for name, field in schema.get("properties", {}).items():
        for what, value in wrong_values(field, definitions):
            yield f"{name}: {what}", text(head(), {**body, name: value})


def is_one_clear_line(line: str, topic: Topic) -> bool:
    """Whether the text names the place, is short, and is one line."""
    return topic.key(MISSION) in line and "\n" not in line and len(line) < 400 and ("expected" in line or ":" in line)


@pytest.mark.parametrize("topic", ENVELOPES, ids=lambda topic: topic.name)
def test_a_message_that_is_not_what_its_topic_asks_for_is_refused_in_one_line(topic):
    for what, payload in bad_messages(topic):
        with pytest.raises(Refused) as refused:
            decode(topic, payload, MISSION)
        assert is_one_clear_line(str(refused.value), topic), f"{what}: {refused.value}"


@pytest.mark.parametrize(
    "topic", [topic for topic in ENVELOPES if topic.reply is not None], ids=lambda topic: topic.name
)
def test_an_answer_that_is_not_what_its_question_asks_for_is_refused_too(topic):
    for payload in (b"", b"7", b"\xff", text(header(), "text"), text(header(mission="another"), {})):
        with pytest.raises(Refused) as refused:
            decode_reply(topic, payload, MISSION)
        assert "\n" not in str(refused.value)
        assert "(reply)" in str(refused.value)


def test_what_was_damaged_on_the_way_is_told_from_what_was_never_right():
    topic = BY_NAME["tc/command"]
    head = header(source="ground")
    sealed = encode(Header.model_validate(head), decode(topic, text(head, body_example(topic)), MISSION)[1])
    for position in range(len(sealed)):
        for change in (0x01, 0x20):
            spoilt = sealed[:position] + bytes([sealed[position] ^ change]) + sealed[position + 1 :]
            with pytest.raises(Refused):
                decode(topic, spoilt, MISSION)
    with pytest.raises(Damaged, match="damaged"):
        decode(topic, sealed.replace(b"ground", b"groumd"), MISSION)


def test_a_refusal_names_version_before_everything_else():
    topic = BY_NAME["tm/state"]
    with pytest.raises(Refused, match=r"expected schema version 1, got 9$"):
        decode(topic, text({"version": 9, "from": "the future"}, {"quite": "different"}), MISSION)


# --- a whole mission, and all of it at its doors ----------------------------------------------------------------


@pytest.fixture(scope="module")
def mission() -> InProcessMission:
    """The short mission, with its first sample in the map."""
    mission = InProcessMission(load_scenario(find_scenario(MISSION)))
    while mission.status is None or mission.status.samples < 1:
        assert mission.simulation.step()
    return mission


NODES = ("field", "rover", "link", "ground")


def states(mission: InProcessMission) -> dict[str, bytes]:
    """The state of each node and its host, without the number of refused messages."""
    states = {}
    for name in NODES:
        host = mission.simulation.host(name)
        if name in ("rover", "ground"):
            states[name] = host.codec.encode({**host.checkpoint(), "refused": 0})
        else:  # they keep no journal, so they name no state
            kept = {key: value for key, value in vars(host).items() if key not in ("_heard", "_trace", "_refused")}
            states[name] = pickle.dumps(kept)
    return states


def refusals(mission: InProcessMission) -> dict[str, int]:
    return {name: mission.simulation.host(name).refused for name in NODES}


@pytest.mark.parametrize("topic", ENVELOPES, ids=lambda topic: topic.name)
def test_bad_messages_on_a_topic_change_no_node_and_are_counted_by_those_who_hear_it(mission, topic):
    simulation = mission.simulation
    # What crosses is put where it arrives: the link carries letters unread.
    side = next(side for side in topic.sides if topic.crosses is Crosses.NEVER or side is not origin(topic))
    hearing = [name for name in NODES if simulation.host(name).receives(topic, side)]
    before, refused_before, noted = states(mission), refusals(mission), len(simulation.log_records)
    now = simulation.now
    sent = 0
    for _, payload in bad_messages(topic):
        simulation.inject(topic, side, payload)
        sent += 1
    simulation.run(until=now)
    assert simulation.now == now
    assert states(mission) == before
    counted = {name: count - refused_before[name] for name, count in refusals(mission).items()}
    assert counted == {name: sent if name in hearing else 0 for name in NODES}
    lines = [note for _, _, note in simulation.log_records[noted:]]
    assert len(lines) <= sent * len(hearing), "a flood of refusals is not all logged"
    assert all(note.level is Level.WARNING and note.text.startswith("refused: ") for note in lines)


SERVED = [
    topic
    for topic in ENVELOPES
    if topic.reply is not None
    and not topic.name.startswith(("moon/time", "earth/time", "earth/clock", "moon/claim", "earth/claim"))
]


@pytest.mark.parametrize("topic", SERVED, ids=lambda topic: topic.name)
def test_bad_questions_are_answered_with_a_line_and_change_no_node(mission, topic):
    before = states(mission)
    for what, payload in bad_messages(topic):
        answer = mission.simulation.ask_raw(topic, payload)
        assert isinstance(answer, str), f"{what}: answered with {answer[:80]!r}"
        assert is_one_clear_line(answer, topic), f"{what}: {answer}"
    assert states(mission) == before


def test_the_mission_goes_on_after_all_of_it(mission):
    samples = mission.status.samples
    while mission.status.samples == samples:
        assert mission.simulation.step()
    assert not any(note.level is Level.ERROR for _, _, note in mission.simulation.log_records)


# --- selectors --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("topic", SERVED, ids=lambda topic: topic.name)
def test_selector_parameters_that_a_question_does_not_have_are_refused_in_one_line(topic):
    for parameters in ({"colour": "red"}, {"": ""}, {"x": "1", "y": "2", "z": "3"}, {"header": "{}"}):
        with pytest.raises(He3Error) as refused:
            request_from_selector(topic, parameters)
        assert str(refused.value).startswith(f"{topic.name}: ")
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "parameters",
    [
        {},
        {"x": "120"},
        {"x": "120", "y": ""},
        {"x": "120", "y": "north"},
        {"x": "nan", "y": "340"},
        {"x": "inf", "y": "340"},
        {"x": "-1e9", "y": "340"},
        {"x": "1,5", "y": "340"},
        {"x": "120", "y": "340", "threshold": "high"},
        {"x": "120", "y": "340", "as_of": "yesterday"},
        {"x": "120 ", "y": "3 40"},
        {"x": "0x10", "y": "340"},
    ],
    ids=str,
)
def test_a_map_point_without_two_good_numbers_is_refused(parameters):
    with pytest.raises(He3Error) as refused:
        request_from_selector(MAP_POINT, parameters)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300


def test_sides_of_the_table_are_those_of_the_keys():
    for topic in TOPICS:
        first = topic.name.split("/", 1)[0]
        assert first in {"tc": "tc", "tm": "tm", "moon": "moon", "earth": "earth"}
        assert topic.sides == ((Side.MOON, Side.EARTH) if first in ("tc", "tm") else (Side(first),))
