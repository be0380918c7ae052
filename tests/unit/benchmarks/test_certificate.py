"""The certificate's benchmark: designs of one small field, tables, pieces of fields, and what is promised of blocks."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import certificate, kept
from benchmarks.covers import CoverTask, _order, rows_of
from benchmarks.exam_fields import load_field
from benchmarks.promises import GRID, Promise, errors_of, identity, piece, scenario_of
from he3.errors import InvalidInput
from services.console.cli.benchmarks import described
from services.ground.planners.tour import covering


@pytest.fixture
def data(tmp_path):
    """A folder with one small field of two waves."""
    x, y = np.meshgrid(np.arange(70.0), np.arange(60.0))
    np.save(tmp_path / "waves.npy", np.sin(x / 16.0) + 0.7 * np.cos(y / 13.0))
    return tmp_path


def row(method, metres, holds=True):
    return {"field": "f", "ratio": 0.7, "method": method, "samples": 9, "metres": metres, "holds": holds, "note": ""}


def test_the_benchmark_is_a_command_and_knows_its_names():
    assert "certificate" in described()
    with pytest.raises(InvalidInput, match="expected names among t1, t2; got mars"):
        certificate.run(fields=("mars",))
    with pytest.raises(InvalidInput, match="expected ratios and a share between 0 and 1"):
        certificate.run(fields=("t1",), ratios=(1.2,))


def test_our_design_holds_and_is_shorter_than_the_greedy_one_and_what_is_done_is_not_done_again(data, monkeypatch):
    monkeypatch.setattr(covering, "ROW_SPACINGS", (0.8,))
    monkeypatch.setattr(covering, "FAILURES", 1)
    task = CoverTask(load_field("waves.npy", data))
    ours, greedy = rows_of(task, [0.6], [])
    assert ours["holds"]
    assert greedy["holds"]
    assert ours["metres"] < greedy["metres"]
    file = data / "kept.json"
    said = []
    other = [one | {"seed": 2, "metres": 1.0} for one in (ours, greedy)]  # of another run: neither shown nor lost
    kept.write(file, {"designs": [ours, greedy, *other], "missions": []})
    found = certificate.run(data, ["waves.npy"], [0.6], (), json=file, say=said.append)
    assert found["designs"] == [ours, greedy]
    assert kept.read(file, "designs")["designs"] == [ours, greedy, *other]
    assert f"{ours['metres'] / greedy['metres']:.3f}" in "\n".join(said)
    kept.write(file, {"designs": [ours, greedy], "missions": [], "fields": {"waves.npy": "another"}})
    with pytest.raises(InvalidInput, match=r"kept\.json: expected results of waves\.npy as it is now, got those"):
        certificate.run(data, ["waves.npy"], [0.6], (), json=file, say=said.append)


def test_ours_is_compared_with_the_best_whose_certificate_holds():
    cells = {one["method"]: one for one in (row("tour", 80.0), row("a", 60.0, False), row("b", 100.0),
                                            row("b loosened", 90.0))}  # fmt: skip
    assert certificate.compared(cells, False) == pytest.approx(0.8)
    assert certificate.compared(cells, True) == pytest.approx(80.0 / 90.0)
    assert certificate.compared({"tour": row("tour", 80.0)}, False) is None
    assert certificate.compared(cells | {"tour": row("tour", 80.0, False)}, False) is None


def test_the_table_says_in_how_many_cases_ours_fails() -> None:
    rows = [row("tour", 80.0), row("a", 100.0), row("tour", 90.0, False) | {"ratio": 0.5}]
    said = certificate.table(rows)
    assert "mean of x against the planners as they are: 0.800 over 1, at most 0.800" in said
    assert "tour has no tour with a certificate in 1 of 2 cases, which the means leave out" in said
    assert not any("leave out" in line for line in certificate.table(rows[:2]))


def test_of_a_peers_designs_the_shortest_that_holds_and_has_a_way_is_taken():
    no_way = row("a", None)
    assert min([no_way, row("a", 60.0, False), row("a", 90.0), row("a", 80.0)], key=_order)["metres"] == 80.0
    assert not _order(row("a", 60.0, False)) < _order(no_way)


def test_a_mission_is_told_from_one_with_another_probability_or_other_rounds(data):
    asked = Promise(data, "waves.npy", 1, "tour", 0.5, 100.0, 0.95, 4)
    same = {"field": "waves.npy", "seed": 1, "planner": "tour", "share": 0.5, "blocks_m": 100.0, "probability": 0.95}
    assert identity(same | {"rounds": 4, "samples": 20}) == asked.identity
    assert asked.identity not in {identity(same), identity(same | {"rounds": 5})}


def test_a_piece_has_the_spread_of_soils_and_follows_from_its_seed(data):
    first, again, other = (piece("waves.npy", data, seed).he3_ppb for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert first.shape == GRID.shape
    assert (first.mean(), first.std()) == pytest.approx((7.5, 1.7))


def test_what_is_promised_of_blocks_is_the_error_of_their_means(data):
    region = piece("waves.npy", data, 1)
    aside = np.where(np.arange(50) % 2, 1.0, -1.0)[None, :] + np.zeros((50, 1))
    aside[:10, :10] += 0.5
    blocks = scenario_of(Promise(data, "waves.npy", 1, "tour", 0.5, 100.0, 0.95, 4))
    missed = errors_of(region, region.he3_ppb + aside, blocks)
    assert missed.shape == (25,)
    assert missed[0] == pytest.approx(0.5)
    assert missed[1:].max() == pytest.approx(0.0, abs=1e-9)
    # Blocks of 249 m leave strips of 2 m, which have no cell of their own.
    odd = errors_of(
        region, region.he3_ppb + aside, scenario_of(Promise(data, "waves.npy", 1, "tour", 0.5, 249.0, 0.95, 4))
    )
    assert odd.shape == (4,)
    assert np.isfinite(odd).all()
    everywhere = scenario_of(Promise(data, "waves.npy", 1, "tour", 0.5, None, 0.95, 4))
    assert errors_of(region, region.he3_ppb + aside, everywhere).min() >= 0.5


def test_the_table_counts_only_promises_of_missions_that_reached_their_goal():
    common = {"field": "f", "samples": 40, "metres": 900.0}
    rows = [
        common | {"reached": True, "within": 0.97, "kept": True},
        common | {"reached": True, "within": 0.93, "kept": False},
        common | {"reached": False, "within": None, "kept": False},
    ]
    assert certificate.promise_table(rows)[-1].split() == ["all", "3", "2", "1", "93.0%", "40.0", "900"]
