"""A layer in a terminal is as wide as the terminal has room for, unless a width is asked for."""

from __future__ import annotations

import pytest

from services.console.cli.map.layer import usual_width


@pytest.mark.parametrize(("columns", "width"), [("40", 40), ("72", 72), ("200", 72), ("3", 10), ("", 72)])
def test_a_layer_is_drawn_no_wider_than_the_terminal(columns: str, width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    assert usual_width(72) == width
