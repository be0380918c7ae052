"""Log lines: one line each, for any content of a message."""

import io

import pytest

from schemas.wire import printable
from services.runtime.log import Log


@pytest.mark.parametrize("text", ["\x1b[31mred", "two\nlines", "a\tb", "\ufeffmark", "lone \udcff", "bell\x07"])
def test_a_text_from_outside_cannot_steer_a_terminal_or_begin_a_new_line(text: str) -> None:
    shown = printable(text)
    assert shown.isprintable()
    stream = io.StringIO()
    Log("ground", lambda: None, stream=stream).warning("refused", why=text)
    (line,) = stream.getvalue().splitlines()
    assert line.isprintable()


def test_a_text_in_any_language_is_shown_as_it_is() -> None:
    assert printable("Ångström, 3 ppb; 月") == "Ångström, 3 ppb; 月"
