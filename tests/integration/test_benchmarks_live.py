"""Short runs of the benchmarks of services: their output and files, and bounds that hold on a busy machine."""

from __future__ import annotations

import json
import shutil

import pytest

from benchmarks import flood, link_timing, page, query_latency
from he3.errors import InvalidInput
from tests.waiting import expect_within


def test_the_link_s_light_time_is_measured_each_way_before_and_after_a_live_change(tmp_path):
    lines: list[str] = []
    link_timing.run(messages=40, interval_s=0.01, changed_to_s=0.5, json=tmp_path / "link.json", say=lines.append)
    document = json.loads((tmp_path / "link.json").read_text())
    assert (document["owlt_s"], document["messages"]) == (1.282, 80)
    shown = [(row["owlt_s"], row["direction"], row["messages"]) for row in document["rows"]]
    assert shown == [
        (1.282, "up", 40),
        (1.282, "down", 40),
        (1.282, "both", 80),
        (0.5, "up", 40),
        (0.5, "down", 40),
        (0.5, "both", 80),
    ]
    for row in [document, *document["rows"]]:
        assert 0 < row["error_p50_s"] <= row["error_p99_s"] <= row["error_max_s"]
        expect_within(0.05, row["error_p50_s"], "the median error of the light time")
    assert len(lines) == 7


@pytest.mark.exhaustive
def test_a_map_query_while_planning_is_measured_beside_a_bare_queryable(tmp_path):
    lines: list[str] = []
    query_latency.run(
        queries=40, scenario="short", rate=20_000.0, plans=1, json=tmp_path / "query.json", say=lines.append
    )
    row = json.loads((tmp_path / "query.json").read_text())
    assert row["queries"] == 40
    assert row["plans"] >= 1
    assert row["missions"] >= 1
    assert 0 < row["point_p50_s"] <= row["point_p99_s"]
    assert 0 < row["bare_p50_s"] <= row["bare_p99_s"]
    assert row["ratio"] < 10, "a plan being computed must never delay a query"
    assert "ratio of the medians" in lines[-1]


@pytest.mark.exhaustive
def test_when_a_mission_ends_before_enough_map_queries_were_asked_the_next_one_starts(tmp_path):
    row = query_latency.run(queries=4, scenario="short", rate=20_000.0, plans=4, say=[].append)
    assert (row["queries"], row["plans"]) == (4, 4)
    assert row["missions"] >= 2, "a mission of three rounds computes two plans after its first"


@pytest.mark.exhaustive
def test_the_page_s_bytes_clicks_and_work_are_measured_in_a_browser(tmp_path):
    if shutil.which("chromium") is None or shutil.which("chromedriver") is None:
        pytest.skip("no browser: apt-get install chromium chromium-driver")
    lines: list[str] = []
    row = page.run(pages=2, seconds=6.0, clicks=3, json=tmp_path / "page.json", say=lines.append)
    assert json.loads((tmp_path / "page.json").read_text()) == row
    assert 0 < row["bytes_per_s_median"] <= row["bytes_per_s_most"] <= page.MOST_BYTES_S
    assert 0 < row["click_ms_median"] <= row["click_ms_most"]
    assert 0 < row["main_thread_share_at_rest"] < 1
    assert "load of the machine" in lines[-1]


@pytest.mark.exhaustive
def test_a_flood_makes_no_process_grow_or_fail_and_leaves_the_mission_undisturbed(tmp_path):
    lines: list[str] = []
    flood.run(messages=2000, requests=400, json=tmp_path / "flood.json", say=lines.append)
    document = json.loads((tmp_path / "flood.json").read_text())
    assert (document["faults"], document["defects"], document["differences"]) == ([], {}, [])
    assert set(document["growth"]) == {"link", "field", "rover", "ground", "queries", "recorder", "page"}
    assert lines[-1].endswith("the mission has ended as an undisturbed one")


@pytest.mark.parametrize(
    ("benchmark_run", "figures"),
    [
        (link_timing.run, {"messages": 0}),
        (link_timing.run, {"interval_s": -1.0}),
        (link_timing.run, {"changed_to_s": float("nan")}),
        (flood.run, {"messages": 0}),
        (flood.run, {"page_rate": 0.0}),
        (query_latency.run, {"queries": 0}),
        (query_latency.run, {"rate": 0.0}),
        (query_latency.run, {"scenario": "t9-nominal"}),
    ],
)
def test_figures_that_make_no_sense_are_refused_before_anything_is_started(benchmark_run, figures):
    with pytest.raises(InvalidInput):
        benchmark_run(**figures)
