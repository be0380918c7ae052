"""What `he3 status` says of the link."""

from __future__ import annotations

import re

import pytest

from schemas.link import DirectionCounts
from services.console.cli.status import _counts


@pytest.mark.parametrize(
    ("counts", "said"),
    [
        (
            DirectionCounts(offered=9, delivered=8, in_flight=1),
            "9 sent, 8 delivered, 1 in flight, 0 waiting, 0 lost",
        ),
        (
            DirectionCounts(
                offered=90, duplicated=6, delivered=50, lost=9, dropped_out_of_contact=2, dropped_queue_full=1,
                superseded=30, waiting=3, in_flight=1,
            ),
            "90 sent and 6 doubled, 50 delivered, 1 in flight, 3 waiting, 30 replaced by newer ones, 12 lost",
        ),
    ],
)  # fmt: skip
def test_the_counts_of_messages_add_up(counts: DirectionCounts, said: str) -> None:
    assert _counts(counts) == said
    sent, gone = said.split(" delivered")[0].rsplit(", ", 1)[0], said[said.index(",") :]
    assert sum(map(int, re.findall(r"\d+", sent))) == sum(map(int, re.findall(r"\d+", gone)))
