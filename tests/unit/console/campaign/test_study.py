"""Studies: which missions follow from a TOML file, and what is refused."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from he3.errors import InvalidInput
from services.console.campaign.study import Study, load_study
from services.console.campaign.task import Task
from services.mission.deployment import deployment

WHOLE = """
name = "whole"
scenarios = ["short"]
seeds = "draws"
[set]
rounds = 1
[parameters.planner]
keys = ["ground.planner"]
values = ["rrt", "tour"]
[parameters.light_time]
keys = ["link.up.one_way_light_time_s", "link.down.one_way_light_time_s"]
low = 0.5
high = 50.0
scale = "log"
[parameters.boulders]
keys = ["field.hidden_hazards"]
low = 0
high = 3
integer = true
[draws]
count = 8
"""


def read(tmp_path: Path, text: str, **options: bool) -> Study:
    file = tmp_path / "study.toml"
    file.write_text(text)
    return load_study(file, **options)


def test_a_latin_hypercube_crosses_the_grid_and_has_a_seed_for_each_draw(tmp_path: Path) -> None:
    study = read(tmp_path, WHOLE)
    tasks = list(study.tasks())
    assert len(tasks) == study.size == 16
    pairs = [(task.labels["seed"], task.labels["parameters"]["light_time"]) for task in tasks]
    assert Counter(pairs) == dict.fromkeys(pairs, 2), "each draw meets every planner"
    assert [seed for seed, _ in pairs[::2]] == list(range(1, 9))
    times = sorted({time for _, time in pairs})
    # One in each eighth of two decades: that is what a Latin hypercube is.
    assert all(0.5 * 100 ** (k / 8) <= time <= 0.5 * 100 ** ((k + 1) / 8) * 1.00001 for k, time in enumerate(times))
    assert Counter(task.labels["parameters"]["boulders"] for task in tasks[::2]) == {0: 2, 1: 2, 2: 2, 3: 2}
    link = tasks[0].arguments["scenario"]["link"]
    assert link["up"]["one_way_light_time_s"] == link["down"]["one_way_light_time_s"] == pairs[0][1]
    assert tasks[0].arguments["scenario"]["rounds"] == 1


def test_the_same_study_has_the_same_keys_and_any_change_of_content_has_others(tmp_path: Path) -> None:
    first, again = ([task.key for task in read(tmp_path, WHOLE).tasks()] for _ in range(2))
    assert first == again
    assert len(set(first)) == 16
    assert not {task.key for task in read(tmp_path, WHOLE.replace("rounds = 1", "rounds = 2")).tasks()} & set(first)
    task = next(read(tmp_path, WHOLE).tasks())
    renamed = Task(task.work, task.arguments, task.software, {"scenario": "another name for it"})
    assert renamed.key == task.key
    assert Task(task.work, task.arguments, "another version").key != task.key
    assert Task(task.work, {**task.arguments, "region_sha256": "0"}, task.software).key != task.key
    assert Task(task.work, {**task.arguments, "planner_sha256": "0"}, task.software).key != task.key


def test_the_study_that_ships_has_two_thousand_missions_in_pairs() -> None:
    study = load_study(deployment("studies", "hardship.toml"))
    assert study.size == 2000
    tasks = study.tasks()
    first, second = next(tasks), next(tasks)
    one, other = first.labels["parameters"], second.labels["parameters"]
    differing = {name for name in one if one[name] != other[name]}
    assert differing == {"planner"}
    assert first.labels["seed"] == second.labels["seed"]


def test_points_of_a_list_are_flown_as_they_stand_with_every_seed(tmp_path: Path) -> None:
    text = """
name = "listed"
scenarios = ["short"]
seeds = [7, 9]
points = [{ planner = "rrt", charge = 300.0 }, { planner = "tour", charge = 600.0 }]
[parameters]
planner = { keys = ["ground.planner"] }
charge = { keys = ["rover.capacity_wh"] }
"""
    found = [(task.labels["seed"], *task.labels["parameters"].values()) for task in read(tmp_path, text).tasks()]
    assert found == [(7, "rrt", 300.0), (7, "tour", 600.0), (9, "rrt", 300.0), (9, "tour", 600.0)]


def test_a_plug_in_planner_needs_a_word_and_its_source_is_part_of_the_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine_of_a_study.py").write_text("def plan(request): ...\n")
    text = 'name = "plugin"\nscenarios = ["short"]\n[set]\n"ground.planner" = "mine_of_a_study:plan"\n'
    with pytest.raises(InvalidInput, match="expected --allow-plugin"):
        list(read(tmp_path, text).tasks())
    (first,) = read(tmp_path, text, allow_plugin=True).tasks()
    (tmp_path / "mine_of_a_study.py").write_text("def plan(request): return None\n")
    (second,) = read(tmp_path, text, allow_plugin=True).tasks()
    assert first.key != second.key


@pytest.mark.parametrize(
    ("old", "new", "refusal"),
    [
        ("count = 8", "count = 0", "draws.count"),
        ("low = 0.5\n", "", "expected both of low and high"),
        ("high = 50.0", "high = 0.1", "expected low below high"),
        ('values = ["rrt", "tour"]', "values = []", "parameters.planner.values"),
        ('values = ["rrt", "tour"]', "", "expected values, a range, or points for parameter planner"),
        ('"ground.planner"]', '"ground.planer"]', "expected a key of the scenario, got 'ground.planer'"),
        ('"tour"]', '"teleport"]', "ground.planner"),
        ('["short"]', '["long"]', "expected a scenario file or one of"),
        ('"field.hidden_hazards"', '"ground.planner"', "expected every key of the scenario once"),
        ('"field.hidden_hazards"', '"seed"', "expected seeds in the key seeds"),
        ("[draws]\ncount = 8", "", "expected a table draws"),
        ("[set]", "[sets]", "sets"),
        ("[set]", "[set", "expected TOML"),
    ],
)
def test_a_study_that_cannot_be_flown_is_refused_in_one_line(tmp_path: Path, old: str, new: str, refusal: str) -> None:
    assert old in WHOLE
    with pytest.raises(InvalidInput) as refused:
        list(read(tmp_path, WHOLE.replace(old, new)).tasks())
    assert refusal in str(refused.value)
    assert "\n" not in str(refused.value)
