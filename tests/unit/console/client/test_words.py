"""Numbers of things in words."""

from __future__ import annotations

import pytest

from services.console.client.words import counted


@pytest.mark.parametrize(
    ("number", "words"), [(0, "0 samples"), (1, "1 sample"), (2, "2 samples"), (1500, "1,500 samples")]
)
def test_one_thing_is_singular_and_every_other_number_plural(number: int, words: str) -> None:
    assert counted(number, "sample") == words
