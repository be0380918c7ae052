"""``he3 stack``: where its text comes from, and what is no text of a stack."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from he3.errors import InvalidInput
from services.console.cli.stack import MAX_BYTES, _text

STDIN = Path("-")


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"\xff\xfe\x00", "stack: -: cannot read: it is no text in UTF-8"),
        (b"pause\n" * (MAX_BYTES // 6 + 1), "stack: -: expected at most 1,000,000 bytes, got more"),
    ],
)
def test_standard_input_is_held_to_what_a_file_is_held_to(
    content: bytes, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))
    with pytest.raises(InvalidInput) as refusal:
        _text(STDIN, None)
    assert str(refusal.value) == why


def test_a_stack_comes_from_a_file_from_standard_input_or_from_flags(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = tmp_path / "hold.stack"
    written.write_bytes(b"pause\n")
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"resume\n")))
    assert _text(written, None) == "pause\n"
    assert _text(STDIN, None) == "resume\n"
    assert _text(None, ["pause", "resume"]) == "pause\nresume"
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(InvalidInput, match="expected a stack on standard input, which is closed"):
        _text(STDIN, None)
