"""How a refusal crosses the wire: exceptions follow from its code alone, text is for people."""

from __future__ import annotations

import json

import pytest

from he3.errors import Busy, He3Error, InvalidInput, NoRoute, NotFound, NotReady, OutsideRegion
from schemas.codec import Damaged, Refused
from schemas.refusal import Refusal, RefusalCode, decode_refusal
from services.runtime.refusals import EXCEPTIONS, error_of, refusal_of


@pytest.mark.parametrize("kind", [InvalidInput, OutsideRegion, NotFound, NotReady, Busy, He3Error])
@pytest.mark.parametrize("text", ["map: expected a place, got (9999, 1)", "there is no map yet", ""])
def test_an_exception_is_the_same_class_with_the_same_text_at_the_client(kind: type[He3Error], text: str) -> None:
    error = error_of(decode_refusal(refusal_of(kind(text)).encode()))
    assert type(error) is kind
    assert str(error) == text


def test_every_code_has_one_exception_and_it_is_found_again() -> None:
    assert EXCEPTIONS.keys() == set(RefusalCode)
    for code, kind in EXCEPTIONS.items():
        assert refusal_of(kind("why")).code is code


def test_an_error_without_a_code_of_its_own_is_internal_and_a_refused_message_is_invalid_input() -> None:
    assert refusal_of(NoRoute("no way")) == Refusal("no way", RefusalCode.INTERNAL)
    assert refusal_of(ZeroDivisionError("of thirteen")) == Refusal("of thirteen", RefusalCode.INTERNAL)
    assert refusal_of(Refused("header: field required")) == Refusal("header: field required")
    assert refusal_of(Damaged("expected checksum 1, got 2")) == Refusal("expected checksum 1, got 2")


def test_a_stock_client_reads_text_and_code_from_one_json_object() -> None:
    body = json.loads(Refusal("y: field required", RefusalCode.INVALID_INPUT).encode())
    assert body == {"error": "y: field required", "code": "invalid_input"}


def test_the_stamp_of_lockstep_comes_back() -> None:
    refusal = Refusal("not today", RefusalCode.BUSY, "ground\tg1\t7\t12\t99")
    assert decode_refusal(refusal.encode()) == refusal


@pytest.mark.parametrize(
    ("payload", "text"),
    [
        (b"Timeout", "Timeout"),
        (b"", ""),
        (b"[1]", "[1]"),
        (b"7", "7"),
        (b'{"code": "busy"}', '{"code": "busy"}'),
        (b'{"error": "of an older server"}', "of an older server"),
        (b'{"error": "of a newer server", "code": "thermal"}', "of a newer server"),
        (b'{"error": "odd", "code": ["busy"]}', "odd"),
        (b"x" * 1000, "x" * 200),
        (b"\xff\xfe", "\ufffd\ufffd"),
    ],
)
def test_an_error_reply_of_another_form_or_an_unknown_code_is_internal(payload: bytes, text: str) -> None:
    assert decode_refusal(payload) == Refusal(text, RefusalCode.INTERNAL)
