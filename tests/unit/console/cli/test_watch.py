"""The screen of he3 watch shows every word, also on a narrow terminal."""

from __future__ import annotations

import pytest
from rich.console import Console

from services.console.cli.watch import lines_of, table_of

ROWS = [
    ("phase", "executing: round 7 ended early: closed terrain ahead of the rover, the way is planned anew"),
    ("rover", "safe mode at (1234.5, 987.6) m"),
    ("link", "NO CONTACT, one-way light time 1.282 s"),
]


@pytest.mark.parametrize("width", [30, 50, 120])
def test_no_word_is_lost_on_a_terminal_of_any_width(width: int) -> None:
    console = Console(width=width, color_system=None)
    with console.capture() as shown:
        console.print(table_of(ROWS))
    lines = shown.get().splitlines()

    assert all(len(line) <= width for line in lines)
    assert lines_of(table_of(ROWS), width) == len(lines)
    words = " ".join(lines).split()
    assert [word for word in words if word not in dict(ROWS)] == [word for _, text in ROWS for word in text.split()]
