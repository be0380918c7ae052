"""The benchmark of lockstep prints all its figures, with the in-process driver for comparison."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.lockstep_speed import run
from services.mission.deployment import find_scenario


@pytest.mark.exhaustive
def test_the_benchmark_has_a_row_for_each_driver_and_their_events_are_the_same(tmp_path: Path) -> None:
    said: list[str] = []
    shorter = tmp_path / "shorter.toml"
    shorter.write_text(find_scenario("short").read_text().replace("rounds = 3", "rounds = 1"))
    rows = run(scenario=str(shorter), json=tmp_path / "speed.json", say=said.append)
    assert json.loads((tmp_path / "speed.json").read_text()) == {"rows": rows}
    assert [row["driver"] for row in rows] == ["in-process", "lockstep"]
    assert all(row["identical"] for row in rows)
    assert rows[0]["mission_h"] == pytest.approx(rows[1]["mission_h"])
    for row in rows:
        assert row["events"] == rows[0]["events"] > 500
        assert 0 < row["planning_s"] < row["wall_s"]
        assert row["events_per_s"] == pytest.approx(row["events"] / (row["wall_s"] - row["planning_s"]))
        assert row["wall_s_per_mission_h"] == pytest.approx(row["wall_s"] / row["mission_h"])
    assert len(said) == 3
