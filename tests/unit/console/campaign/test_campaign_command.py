"""``he3 campaign`` from study to report, and its missions beside those of ``he3 run``."""

from __future__ import annotations

import json
import logging
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from he3.errors import InvalidInput
from services.console.__main__ import main
from services.console.campaign.engines import DaskEngine
from services.console.campaign.runner import run
from services.console.campaign.store import Store
from services.console.campaign.study import load_study
from services.console.campaign.task import REFUSED, Task
from tests.waiting import PATIENCE_S, expect_within, until

STRANGER_S = 2.0
"""Time in which a client that is not let in gives up."""

STUDY = """
name = "small"
scenarios = ["short"]
seeds = [3]
[set]
rounds = 1
samples_per_round = 1
[parameters.planner]
keys = ["ground.planner"]
values = ["rrt"]
[parameters.light_time]
keys = ["link.up.one_way_light_time_s", "link.down.one_way_light_time_s"]
low = 1.0
high = 2.0
[draws]
count = 1
"""
MORE = STUDY.replace("count = 1", "count = 3").replace('["rrt"]', '["rrt", "tour"]')


def he3(capsys: pytest.CaptureFixture[str], *words: str, expect: int = 0) -> str:
    assert main(words) == expect
    return capsys.readouterr().out


def test_a_study_is_flown_once_and_reported_on_in_words_with_units_and_as_a_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = tmp_path / "small.toml"
    study.write_text(STUDY)
    lines = he3(capsys, "campaign", "run", str(study), "--workers", "1", "--quiet").splitlines()
    again = json.loads(he3(capsys, "campaign", "run", str(study), "--workers", "1", "--json"))
    assert (again["kept"], again["flown"], again["failed"]) == (1, 0, 0)
    (means,) = [line for line in lines if line.startswith("on average")]
    assert re.fullmatch(r"on average   map RMSE [\d.]+ ppb, path length [\d.,]+ m, mission time [\d.]+ h", means)
    store, page = tmp_path / "small.sqlite", tmp_path / "small.html"
    found = json.loads(
        he3(capsys, "campaign", "report", str(store), "--json", "--out", str(page), "--figures", "rmse_ppb")
    )
    assert page.read_text().startswith("<!doctype html>")
    (worst,) = found["figures"][0]["worst"]
    assert worst["value"] == found["figures"][0]["summaries"]["all"]["mean"]
    assert (found["rows"], found["failed"], found["incomplete"]) == (1, 0, 0)


def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in (("run", "none.toml"), ("report", "none.sqlite")):
        assert main(["campaign", *words]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    study = tmp_path / "small.toml"
    study.write_text(STUDY)
    assert main(["campaign", "run", str(study), "--engine", "grid"]) == 2
    assert "expected local, dask or dask:ADDRESS" in capsys.readouterr().err


def results(path: Path) -> list[tuple[str, Any]]:
    with Store(path, write=False) as store:
        return [(row.key, row.result) for row in store.rows()]


def kept_by(path: Path) -> list[tuple[str, Any]]:
    """The results in the store as far as it is made."""
    try:
        return results(path)
    except InvalidInput:
        return []


@pytest.mark.exhaustive
def test_ctrl_c_ends_in_time_and_keeps_the_rows(tmp_path: Path) -> None:
    study, store = tmp_path / "small.toml", tmp_path / "small.sqlite"
    study.write_text(STUDY.replace("count = 1", "count = 1000"))
    command = [sys.executable, "-m", "services.console", "campaign", "run", str(study), "--workers", "1"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, process_group=0) as process:
        until(lambda: kept_by(store), "the first row")
        began = time.monotonic()
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does it
        _, said = process.communicate(timeout=PATIENCE_S)
        elapsed_s = time.monotonic() - began
    expect_within(2.0, elapsed_s, "the end of a study")
    assert process.returncode == 130
    assert said.splitlines()[-1] == "he3: interrupted"
    assert kept_by(store)
    with Store(store, write=True):
        pass  # its lock is free


def test_no_other_program_of_the_machine_runs_code_in_a_dask_cluster_made_here() -> None:
    """A scheduler runs what any client sends it, and its port is open to every user of the machine."""
    distributed = pytest.importorskip("distributed")
    logging.getLogger("distributed.comm.tcp").setLevel(logging.CRITICAL)  # it tells of each stranger that it refuses
    with DaskEngine(None, 1) as engine:
        address = engine._address
        bare = address.replace("tls://", "tcp://")
        workers = [*engine._client.scheduler_info()["workers"]]
        assert workers
        assert all(each.startswith("tls://127.0.0.1:") for each in (address, *workers))
        strangers: list[tuple[str, Any]] = [(bare, None), (address, distributed.Security.temporary())]
        for where, keys in strangers:
            with pytest.raises((OSError, TypeError)):
                distributed.Client(where, timeout=STRANGER_S, security=keys, set_as_default=False)
        engine.submit(Task("no_such_module:none", {}, "software", {}))
        (_, reply), *_ = until(lambda: engine.replies(0.1), "the reply to the owner's own task")
        assert reply.status == REFUSED


@pytest.mark.exhaustive
def test_local_workers_a_dask_cluster_and_a_run_by_hand_give_the_same_results_to_the_byte(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed")
    study = tmp_path / "more.toml"
    study.write_text(MORE)
    local = tmp_path / "local.sqlite"
    he3(capsys, "campaign", "run", str(study), "--workers", "2", "--store", str(local))
    with Store(tmp_path / "dask.sqlite", write=True) as store, DaskEngine(None, 2) as engine:
        done = run(list(load_study(study).tasks()), store, engine)
    assert (done.done, done.failed) == (6, 0)
    assert results(tmp_path / "dask.sqlite") == results(local)
    found = json.loads(he3(capsys, "campaign", "report", str(local), "--json", "--figures", "path_length_m"))
    worst = found["figures"][0]["worst"][0]
    report: dict[str, Any] = json.loads(he3(capsys, *shlex.split(worst["command"])[1:], "--quiet", "--json"))
    assert report["path_length_m"] == worst["value"]
