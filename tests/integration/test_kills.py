"""Real processes killed with `kill -9`, one service after the other: nothing is lost, nothing doubled."""

from __future__ import annotations

import pytest

from benchmarks import kills
from tests.waiting import PATIENCE_S


@pytest.mark.exhaustive
def test_each_service_is_killed_in_turn_and_every_sample_is_in_the_map_exactly_once(tmp_path):
    said: list[str] = []
    row = kills.run(
        kills=1, rounds=2, rate=2000.0, seed=3, within=PATIENCE_S, settings=["ground.pipeline=1"],
        json=tmp_path / "kills.json", say=said.append,
    )  # fmt: skip

    assert row["kills"] == 4
    assert (row["lost"], row["doubled"], row["unequal"]) == (0, 0, 0)
    assert len(said) == row["missions"] + 4
