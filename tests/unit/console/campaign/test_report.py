"""The report: statistics with known answers, and the page."""

from __future__ import annotations

import csv
import json
import re
import shlex
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from he3.errors import InvalidInput
from services.console.__main__ import main
from services.console.campaign.drawing import Axis
from services.console.campaign.findings import findings_of
from services.console.campaign.page import page_of
from services.console.campaign.statistics import paired, summary_of, variance_share
from services.console.campaign.store import Row, Store
from services.console.campaign.summary import summary_lines
from services.console.campaign.table import Table, shown_figures, table_of, write_csv, write_parquet
from services.console.campaign.task import DONE, FAILED, Reply, Task
from services.mission.deployment import find_scenario
from services.mission.scenario import load_scenario
from services.runtime.options import parse_setting, with_settings


def rows(count: int = 400) -> list[Row]:
    """Pairs of missions: `tour` drives 1,000 m less, light time alone decides on the mission's time, one fails."""
    rng, found = np.random.default_rng(1), []
    for seed in range(1, count + 1):
        light_time, metres = float(rng.random() * 100), float(rng.normal(3000, 50))
        for planner in ("rrtstar", "tour"):
            labels: dict[str, Any] = {
                "scenario": "short",
                "seed": seed,
                "parameters": {"planner": planner, "light_time": light_time},
                "settings": {"ground.planner": planner, "link.up.one_way_light_time_s": light_time},
            }
            key = f"{seed:05d}{planner}"
            if seed == 1 and planner == "tour":
                found.append(Row(key, FAILED, labels, None, "it stands <still>", 1.0))
                continue
            result = {
                "completed": seed != 2,
                "detail": "too few samples" if seed == 2 else "",
                "path_length_m": metres - (1000 if planner == "tour" else 0),
                "mission_time_s": 3600 * (10 + light_time),
                "samples": 9,
                "map_sha256": "0",
            }
            found.append(Row(key, DONE, labels, result, "", 1.0))
    return found


@pytest.fixture(name="table", scope="module")
def _table() -> Table:
    return table_of(rows())


@pytest.mark.parametrize(
    ("result", "completed"),
    [
        ({"samples": 30, "samples_wanted": 30}, True),
        ({"samples": 21, "samples_wanted": 30, "detail": "40 rounds in a row brought no sample"}, False),
        ({"samples": 21, "samples_wanted": 30, "goal_holds": True}, True),
        ({"samples": 21, "samples_wanted": 30, "goal_holds": False}, False),
    ],
)
def test_a_mission_with_fewer_samples_than_asked_for_is_not_completed_unless_its_goal_holds(
    result: dict[str, Any], completed: bool
) -> None:
    table = table_of([Row("1", DONE, {"seed": 1, "settings": {}}, {"completed": True, **result}, "", 1.0)])
    assert table.completed.tolist() == [completed]
    assert list(table.errors.values()) == ([] if completed else [result.get("detail", "not completed")])


def test_a_summary_has_mean_deviation_and_quantiles_of_what_is_there() -> None:
    one = summary_of(np.array([*range(101), np.nan]))
    assert (one.count, one.mean) == (101, 50.0)
    assert one.std == pytest.approx(np.sqrt(101 * 102 / 12))
    assert one.quantiles == (1, 5, 25, 50, 75, 95, 99)


@pytest.mark.parametrize("count", [300, 6000])
def test_a_bootstrap_interval_is_that_of_the_normal_distribution_for_many_pairs(count: int) -> None:
    rng = np.random.default_rng(7)
    second = rng.normal(100, 20, count)
    first = second + rng.normal(3, 5, count)
    one = paired(first, second, ("a", "b"))
    spread = float((first - second).std(ddof=1)) / np.sqrt(count)
    assert one.difference == pytest.approx(float((first - second).mean()))
    assert one.low == pytest.approx(one.difference - 1.96 * spread, abs=0.2 * spread)
    assert one.high == pytest.approx(one.difference + 1.96 * spread, abs=0.2 * spread)
    assert one.ratio == pytest.approx(first.mean() / second.mean())
    assert one.ratio_low < one.ratio < one.ratio_high
    assert paired(first, second, ("a", "b")) == one, "the same rows have the same interval"


@pytest.mark.parametrize("count", [2, 3, 5, 12])
def test_few_pairs_that_differ_by_chance_alone_seldom_have_an_interval_without_zero(count: int) -> None:
    rng = np.random.default_rng(11)
    found = []
    for _ in range(400):
        second = rng.normal(100, 20, count)
        found.append(paired(second + rng.normal(0, 5, count), second, ("a", "b")))
    assert np.mean([one.low <= 0 <= one.high for one in found]) == pytest.approx(0.95, abs=0.03)
    assert np.mean([one.ratio_low <= 1 <= one.ratio_high for one in found]) == pytest.approx(0.95, abs=0.03)


@pytest.mark.parametrize(("seeds", "draws"), [(5, 40), (12, 10), (40, 10)])
def test_many_draws_of_the_same_seeds_do_not_make_an_interval_narrower_than_the_seeds_allow(
    seeds: int, draws: int
) -> None:
    rng = np.random.default_rng(13)
    found = []
    for _ in range(200):
        second = rng.normal(100, 20, seeds * draws)
        by_seed = np.repeat(rng.normal(0, 5, seeds), draws)  # the difference is the seed's, whatever the draw
        order = rng.permutation(seeds * draws)
        first = second + by_seed + rng.normal(0, 0.1, seeds * draws)
        names = np.repeat(np.arange(seeds), draws)
        found.append(paired(first[order], second[order], ("a", "b"), names[order].tolist()))
    assert np.mean([one.low <= 0 <= one.high for one in found]) == pytest.approx(0.95, abs=0.05)
    assert np.mean([one.ratio_low <= 1 <= one.ratio_high for one in found]) == pytest.approx(0.95, abs=0.05)
    assert {(one.pairs, one.seeds) for one in found} == {(seeds * draws, seeds)}


@pytest.mark.parametrize(("seeds", "draws"), [(20, 50), (40, 40), (5, 20)])
def test_where_seeds_and_draws_are_crossed_the_interval_counts_both(seeds: int, draws: int) -> None:
    rng = np.random.default_rng(19)
    of_seed, of_draw = (grid.ravel() for grid in np.mgrid[:seeds, :draws])
    found = []
    for _ in range(200):
        second = rng.normal(100, 20, seeds * draws)
        effect = rng.normal(0, 3, seeds)[of_seed] + rng.normal(0, 5, draws)[of_draw]
        found.append(paired(second + effect, second, ("a", "b"), of_seed.tolist(), of_draw.tolist()))
    assert np.mean([one.low <= 0 <= one.high for one in found]) >= 0.9
    assert np.mean([one.ratio_low <= 1 <= one.ratio_high for one in found]) >= 0.9


def test_pairs_that_have_a_seed_each_or_all_the_same_one_count_singly() -> None:
    rng = np.random.default_rng(17)
    second = rng.normal(100, 20, 50)
    first = second + rng.normal(0, 5, 50)
    alone = paired(first, second, ("a", "b"))
    each = paired(first, second, ("a", "b"), list(range(50)))
    same = paired(first, second, ("a", "b"), [1] * 50)
    assert alone == each == replace(same, seeds=50)
    assert same.seeds == 1


def test_of_one_pair_there_is_no_interval() -> None:
    with pytest.raises(ValueError, match="two pairs at least, got 1"):
        paired(np.array([1.0, np.nan]), np.array([2.0, 3.0]), ("a", "b"))


def test_pairs_that_are_equal_count_as_lower_for_neither() -> None:
    one = paired(np.array([1.0, 2.0, 3.0, 4.0]), np.array([2.0, 2.0, 3.0, 3.0]), ("a", "b"))
    assert (one.first_lower, one.equal) == (0.25, 0.5)
    both = paired(np.ones(4), np.ones(4), ("a", "b"))
    assert (both.first_lower, both.equal) == (0.0, 1.0)


def test_the_share_of_the_variance_is_that_of_the_linear_model() -> None:
    rng = np.random.default_rng(1)
    x, y, nothing = rng.random(4000), rng.random(4000), rng.random(4000)
    figure = 3 * x + y + rng.normal(0, 0.5, 4000)
    whole = 9 / 12 + 1 / 12 + 0.25
    for values, share in ((x, 9 / 12 / whole), (y, 1 / 12 / whole), (nothing, 0.0)):
        found = variance_share("one", values.tolist(), figure)
        assert found is not None
        assert found.share == pytest.approx(share, abs=0.02)
        assert found.counts == (share > 0)
    names = ["a" if each < 0.5 else "b" for each in x]
    of_names = variance_share("name", names, figure)
    assert of_names is not None
    assert of_names.rank_correlation is None
    assert of_names.share == pytest.approx(9 / 16 / whole, abs=0.03)


def test_a_parameter_without_effect_is_above_the_mark_of_chance_in_five_of_a_hundred_studies() -> None:
    rng = np.random.default_rng(11)
    found = [variance_share("x", rng.random(200).tolist(), rng.normal(size=200)) for _ in range(300)]
    assert 0.02 < np.mean([one is not None and one.counts for one in found]) < 0.09


def test_findings_say_what_the_rows_were_made_to_say(table: Table) -> None:
    findings = findings_of(table, shown_figures(table))
    assert (findings.rows, findings.failed, findings.incomplete) == (800, 1, 2)
    assert findings.compared == "planner"
    assert findings.counts == {"rrtstar": (400, 399), "tour": (400, 398)}
    metres, hours = findings.figures
    assert [metres.name, hours.name] == ["path_length_m", "mission_time_s"]
    (pair,) = metres.comparisons
    assert (pair.first, pair.second, pair.pairs) == ("rrtstar", "tour", 399)
    assert pair.low == pytest.approx(1000) == pair.high
    assert hours.shares["tour"][0].parameter == "light_time"
    assert hours.shares["tour"][0].share > 0.95
    assert hours.shares["all"][-1].parameter == "planner"
    assert {trend.parameter for trend in hours.trends} == {"light_time"}
    assert hours.worst[0].value == hours.sorted_values["tour"][-1]
    assert "compared" in json.dumps(findings.document(), allow_nan=False)
    lines = summary_lines("made", findings)
    assert any("rrtstar - tour: +1000 (95%: +1000 to +1000), ratio" in line for line in lines)


def test_the_worst_case_s_command_flies_that_mission(table: Table) -> None:
    worst = findings_of(table, ["mission_time_s"]).figures[0].worst[0]
    words = shlex.split(worst.command)
    assert words[:4] == ["he3", "run", "short", "--in-process"]
    changes = [parse_setting(text) for flag, text in pairwise(words) if flag == "--set"]
    scenario = with_settings(load_scenario(find_scenario(words[2])), changes)
    assert scenario.link.up.one_way_light_time_s == worst.labels["light_time"]
    assert scenario.ground.planner == worst.labels["planner"]


def test_the_page_needs_no_other_file_and_says_what_is_not_complete(table: Table) -> None:
    page = page_of(findings_of(table, shown_figures(table)), "a <study>", "about it", [("software", "this")])
    assert not re.search(r"<script|<link|src=|url\(|https?:", page)
    assert "a &lt;study&gt;" in page
    assert "it stands &lt;still&gt;" in page
    assert "Path length is higher with rrtstar than with tour, by 1000&nbsp;m" in page
    assert page.count("<svg") == page.count("</svg>") == 5
    assert "NaN" not in page
    assert "nan" not in page


def test_a_report_on_one_seed_says_that_it_says_nothing_of_others(table: Table) -> None:
    of_one = replace(table, labels={**table.labels, "seed": [1] * len(table)})
    for rows, said in ((table, False), (of_one, True)):
        findings = findings_of(rows, shown_figures(rows))
        assert ("All pairs have one seed" in page_of(findings, "a study", "about it", [])) == said
        assert any(line.endswith(", all of one seed") for line in summary_lines("made", findings)) == said


def test_rows_come_out_as_csv_and_parquet(table: Table, tmp_path: Path) -> None:
    write_csv(table, tmp_path / "rows.csv")
    lines = list(csv.DictReader((tmp_path / "rows.csv").read_text().splitlines()))
    assert len(lines) == 800
    assert float(lines[5]["mission_time_s"]) == table.figures["mission_time_s"][5]
    assert lines[1] | {"key": ""} == lines[1] | {"key": "", "path_length_m": "", "error": "it stands <still>"}
    parquet = pytest.importorskip("pyarrow.parquet")
    write_parquet(table, tmp_path / "rows.parquet")
    read = parquet.read_table(tmp_path / "rows.parquet").to_pydict()
    assert read["light_time"] == table.labels["light_time"]
    assert read["completed"] == table.completed.tolist()


def test_what_the_rows_do_not_have_is_refused(table: Table) -> None:
    with pytest.raises(InvalidInput, match="--figures: expected some of"):
        shown_figures(table, ["charm"])
    with pytest.raises(InvalidInput, match="--compare: expected one of scenario, seed"):
        findings_of(table, ["mission_time_s"], "charm")
    with pytest.raises(InvalidInput, match="expected at most 6 values, got 400"):
        findings_of(table, ["mission_time_s"], "seed")
    with pytest.raises(InvalidInput, match="expected one row at least"):
        findings_of(table_of([]), [])
    with pytest.raises(InvalidInput, match="expected one row at least"):
        shown_figures(table_of([]), ["rmse_ppb"])


def test_ticks_are_round_and_within_the_axis() -> None:
    assert Axis(0.13, 0.97, "x").ticks() == pytest.approx([0.2, 0.4, 0.6, 0.8])
    assert Axis(0.5, 40.0, "x", log=True).ticks() == [0.5, 1, 2, 5, 10, 20]
    assert Axis(0.1, 1200.0, "x", log=True).ticks() == pytest.approx([0.1, 1, 10, 100, 1000])
    assert Axis(3.0, 3.0, "x").share(3.0) == 0.5


@pytest.mark.parametrize(
    ("labels", "command"),
    [
        ({"scenario": "t1", "seed": 3}, "he3 run t1 --in-process --seed 3"),
        ({"scenario": "t1", "seed": "1; rm -rf ~"}, "he3 run t1 --in-process --seed '1; rm -rf ~'"),
        (
            {"scenario": "t1", "seed": 1, "settings": {"a.b=$(id)": "`id`"}},
            "he3 run t1 --in-process --seed 1 --set 'a.b=$(id)=`id`'",
        ),
        ({"scenario": "--allow-plugin", "seed": 1}, ""),
        ({"scenario": "t1\x1b[201~", "seed": 1}, ""),
        ({"scenario": "t1"}, ""),
    ],
)
def test_a_command_to_copy_has_nothing_of_a_store_that_a_shell_would_act_on(
    labels: dict[str, Any], command: str
) -> None:
    assert table_of([Row("1", DONE, labels, {}, "", 1.0)]).command(0) == command


def test_the_texts_of_a_store_do_not_steer_the_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "s.sqlite"
    with Store(path, write=True) as store:
        store.describe(study="\x1b]0;mine\x07", description="", software="")
        store.write(Task("some:work", {}, "this", {"seed": 1}), Reply(DONE, {"rmse_ppb": 1.0}))
    assert main(["campaign", "report", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "\\x1b]0;mine" in shown
    assert "\x1b" not in shown
