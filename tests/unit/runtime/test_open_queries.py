"""Queries that a node answers itself: each once, in the form in which it was asked."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import pytest

from schemas.codec import Refused, body_of, encode
from schemas.link import ClockChange
from schemas.refusal import Refusal
from schemas.wire import Header
from services.runtime.context import OpenQueries

HEADER = Header(mission="short", source="link", incarnation=1, sequence=0, made_at=5)
MESSAGE = encode(HEADER, ClockChange(rate=2.5))


@dataclass
class FakeQuery:
    payload: bytes | None = None
    ends: list[Any] = field(default_factory=list)

    def reply(self, payload: bytes, attachment: bytes | None = None) -> None:
        self.ends.append((payload, attachment))

    def refuse(self, refusal: Refusal) -> None:
        self.ends.append(refusal)


def test_a_message_is_answered_with_a_message_and_parameters_with_the_plain_body() -> None:
    queries = OpenQueries()
    asked_by_message, asked_by_selector = FakeQuery(MESSAGE), FakeQuery(None)
    for token, query in enumerate((asked_by_message, asked_by_selector), start=1):
        queries.add(token, query)
        queries.reply(token, MESSAGE, b"stamp")
    assert asked_by_message.ends == [(MESSAGE, b"stamp")]
    assert asked_by_selector.ends == [(b'{"rate":2.5}', b"stamp")]


def test_a_query_ends_once_and_an_unknown_token_is_passed_over() -> None:
    queries = OpenQueries()
    query = FakeQuery(MESSAGE)
    queries.add(queries.next_token(), query)
    queries.refuse(1, Refusal("busy"))
    queries.refuse(1, Refusal("again"))
    queries.reply(1, MESSAGE)
    queries.reply(99, MESSAGE)
    assert query.ends == [Refusal("busy")]


def test_the_body_of_a_message_is_taken_out_as_it_stands() -> None:
    assert body_of(MESSAGE) == b'{"rate":2.5}'
    for other in (b"", b'{"rate":2.5}', MESSAGE.replace(b"checksum", b"sum")):
        with pytest.raises(Refused):
            body_of(other)
