"""The page's requests: anything else is refused with one line and has no effect."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from he3.errors import InvalidInput
from services.console.web.requests import (
    AlarmRequest,
    CommandRequest,
    InterestRequest,
    PageRequest,
    document,
    parsed,
)

KINDS = (CommandRequest, InterestRequest, AlarmRequest)
BAD = {
    CommandRequest: [
        {},
        {"kind": "dance"},
        {"kind": 3},
        {"kind": "pause", "expires_in_s": "soon"},
        {"kind": "pause", "expires_in_s": -1},
        {"kind": "pause", "expires_in_s": [1]},
        {"kind": "pause", "expires_in_s": {"s": 1}},
        {"kind": "pause", "expires_in_s": 1e300},
        {"kind": "pause", "expires_in_s": True},
        {"kind": "go_to", "target_m": [1]},
        {"kind": "go_to", "target_m": [1, 2, 3]},
        {"kind": "go_to", "target_m": {"x": 1}},
        {"kind": "go_to", "target_m": ["1", "2"]},
        {"kind": "set_keep_out", "area_id": "a b"},
        {"kind": "set_keep_out", "area_id": "a", "polygon_m": [[0, 0], [1, 1]]},
        {"kind": "pause", "unknown": 1},
    ],
    InterestRequest: [
        {"weight": "3"},
        {"weight": -1},
        {"weight": None},
        {"area_id": 5},
        {"area_id": "a", "polygon_m": "0,0,1,1"},
    ],
    AlarmRequest: [
        {},
        {"kind": "lunch", "action": "acknowledge"},
        {"kind": "stale", "action": "forget"},
        {"kind": "stale", "action": "shelve"},
        {"kind": "stale", "action": "shelve", "shelve_s": 0},
        {"kind": "stale", "action": "acknowledge", "shelve_s": 60},
    ],
}


def _refusal(function: Callable[..., Any], *arguments: Any) -> str:
    """The text of the refusal; empty if there is none. Any other exception fails the test."""
    try:
        function(*arguments)
    except InvalidInput as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("kind", "content"), [(kind, content) for kind, cases in BAD.items() for content in cases])
def test_a_request_with_a_wrong_value_is_refused_with_one_line(kind: type[PageRequest], content: object) -> None:
    with pytest.raises(InvalidInput) as refusal:
        parsed(kind, json.dumps(content).encode())
    assert "\n" not in str(refusal.value)
    assert str(refusal.value)


@pytest.mark.parametrize(
    "body",
    [
        b"", b"nonsense", b"[]", b'"text"', b"null", b"\xff\xfe", b"[" * 60_000, b'{"a":' * 30_000,
        b'{"kind":"pause","expires_in_s":NaN}', b'{"kind":"pause","expires_in_s":Infinity}', b"9" * 20_000,
        b'{"kind":"\\ud800"}', b'{"\\ud800":1}',
    ],
)  # fmt: skip
def test_a_body_that_is_no_json_object_is_refused_with_one_line(body: bytes) -> None:
    for kind in KINDS:
        with pytest.raises(InvalidInput):
            parsed(kind, body)
    assert _refusal(document, body) or set(document(body)) == {"kind"}


@given(st.binary(max_size=200) | st.recursive(st.none() | st.booleans() | st.floats() | st.text(), st.lists).map(
    lambda value: json.dumps({"kind": "go_to", "target_m": value}).encode()))  # fmt: skip
def test_anything_else_is_a_request_or_refused(body: bytes) -> None:
    for kind in KINDS:
        assert "\n" not in _refusal(parsed, kind, body)


def test_a_good_request_is_read() -> None:
    area = parsed(CommandRequest, b'{"kind":"set_keep_out","area_id":"a","polygon_m":[[0,0],[1,0],[1,1]]}')
    assert area.polygon_m == ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))
    assert parsed(CommandRequest, b'{"kind":"pause","expires_in_s":60}').expires_in_s == 60.0
    assert parsed(InterestRequest, b"{}").weight == 2.0
