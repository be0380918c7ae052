"""A TOML file that another person has written is a document or one line of refusal."""

from __future__ import annotations

from pathlib import Path

import pytest

from he3.errors import InvalidInput
from services.console.campaign.study import load_study
from services.mission.region_folder import load_toml
from services.mission.scenario import load_scenario
from services.mission.toml_files import parsed_toml

FILE = Path("its.toml")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("x = " + "[" * 5000 + "]" * 5000, "expected TOML, got a syntax error"),
        ("x = " + "[" * 40 + "]" * 40, "expected at most 32 tables within one another"),
        (".".join("a" * 5000) + " = 1", "expected at most 32 tables within one another"),
        ("x = " + "9" * 5000, "expected TOML, got a syntax error"),
        (r'description = "\u001b[2J"', r"description: expected printable text, got '\\x1b' in it"),
        (r'x.y = ["a", "\u009b2J"]', r"x\.y: expected printable text, got '\\x9b' in it"),
        (r'"\u202e" = 1', r"a key: expected printable text, got '\\u202e' in it"),
        ("x = 1 1", "expected TOML, got a syntax error"),
    ],
)
def test_what_is_no_plain_document_is_refused_in_one_line(text: str, why: str, tmp_path: Path) -> None:
    (tmp_path / FILE).write_text(text)
    for read in (load_scenario, load_study, load_toml):
        with pytest.raises(InvalidInput, match=rf"its\.toml: {why}") as refusal:
            read(tmp_path / FILE)
        assert str(refusal.value).isprintable()


def test_words_of_every_language_and_lines_are_plain() -> None:
    text = 'a = "Mönch – 月\u00a0§ $5"\nb = """\none\n\ttwo\r\n"""\n'
    assert parsed_toml(text.encode(), FILE) == {"a": "Mönch – 月\u00a0§ $5", "b": "one\n\ttwo\n"}
    assert parsed_toml(b"\xef\xbb\xbfa = 1\r\n", FILE) == {"a": 1}
    with pytest.raises(InvalidInput, match="expected UTF-8 text"):
        parsed_toml(b"\xff", FILE)
