"""A plug-in planner is found by its name, and an answer that is not valid is refused in one line."""

import sys
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
import pytest

from benchmarks.missions import run_mission
from he3.errors import InvalidInput, NoRoute
from he3.frames import SiteGrid
from he3.hyperparameters import Hyperparameters
from he3.kernels import SquaredExponential
from services.ground.planner_process import PlannerProcess
from services.ground.planners import PLANNERS, planner_named
from services.ground.planners.interface import PlanningRequest
from services.ground.planners.traversability import OpenGround
from services.mission.regions import load_region
from services.mission.scenario import load_scenario

CHECKOUT = Path(__file__).resolve().parents[3]
EXAMPLE = "examples.most_uncertain:most_uncertain"
GRID = SiteGrid(60, 60, 1.0)
MODULE = """
import numpy as np
from he3.errors import NoRoute
from services.ground.planners.interface import PlannedRound

def to(*places, samples=None):
    def planner(request):
        path = np.vstack(([request.start_m], places))
        return PlannedRound(path, path[1:] if samples is None else np.array(samples, dtype=float), 1.0)
    return planner

good = to([40.5, 10.5])
jumps = lambda request: PlannedRound(np.array([[30.5, 10.5], [40.5, 10.5]]), np.array([[40.5, 10.5]]), 1.0)
through = to([10.5, 50.5])
leaves = to([70.5, 10.5])
beside = to([40.5, 10.5], samples=[[20.5, 14.5]])
many = to([20.5, 10.5], [30.5, 10.5], [40.5, 10.5])
long = to([55.5, 10.5], [5.5, 10.5])
nowhere = to([float("nan"), 10.5])
nothing = lambda request: None
number = 7
backwards = to([30.5, 10.5], [40.5, 10.5], samples=[[40.5, 10.5], [30.5, 10.5]])
winding = to(*([20.5 + k % 2, 10.5] for k in range(5000)), samples=[[20.5, 10.5]])

def answering(**more):
    return lambda request: PlannedRound(**{
        "path_m": [list(request.start_m), [40.5, 10.5]], "samples_m": [[40.5, 10.5]], "information_nats": 1, **more
    })

lists = answering()
unsure = answering(information_nats=-5.0)
wordy = answering(information_nats="many")
flat = answering(outlook_m=np.zeros(3))
astray = answering(outlook_m=[[700.0, 10.0]])

def exits(request):
    raise SystemExit(0)

def leaves_a_process(request):
    import os, time
    if os.fork() == 0:
        time.sleep(600)
        os._exit(0)
    print("this is not part of the answer")
    return lists(request)

def breaks(request):
    return 1 / 0

def gives_up(request):
    raise NoRoute("there is no way")
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A working directory with plug-in planners."""
    (tmp_path / "user_planner.py").write_text(MODULE)
    (tmp_path / "leaving.py").write_text("raise SystemExit(3)\n")
    (tmp_path / "broken.py").write_text("def planner(:\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield tmp_path
    for name in ("user_planner", "broken", "leaving"):
        sys.modules.pop(name, None)


@pytest.fixture
def request_m() -> PlanningRequest:
    traversable = np.ones(GRID.shape, dtype=bool)
    traversable[30:33] = False
    return PlanningRequest(
        grid=GRID,
        traversable=traversable,
        start_m=(10.5, 10.5),
        observed_m=np.zeros((0, 2)),
        std_ppb=np.ones(GRID.shape, dtype=np.float32),
        hyperparameters=Hyperparameters(SquaredExponential(1.0, 20.0)),
        samples=2,
        samples_left=4,
        budget_m=60.0,
        seed=1,
    )


def test_a_planner_in_the_working_directory_is_found_by_its_name(here, request_m):
    planned = planner_named("user_planner:good")(request_m)
    assert planned.length_m == pytest.approx(30.0)


def test_a_planner_on_the_path_leaves_the_working_directory_off_it(here, request_m, tmp_path_factory, monkeypatch):
    installed = tmp_path_factory.mktemp("installed")
    (installed / "user_planner.py").write_text(MODULE)
    monkeypatch.syspath_prepend(installed)
    assert planner_named("user_planner:good")(request_m).length_m == pytest.approx(30.0)
    assert str(here) not in sys.path


def test_a_planner_in_the_working_directory_takes_the_place_of_no_other_module(here, request_m, monkeypatch):
    (here / "random.py").write_text("raise SystemExit('my own script, not for import')\n")
    (here / "helping.py").write_text("GOOD = 'user_planner beside it'\n")
    (here / "user_planner.py").write_text(MODULE + "\nimport random, helping\nrandom.random\n")
    monkeypatch.delitem(sys.modules, "random")
    assert planner_named("user_planner:good")(request_m).length_m == pytest.approx(30.0)
    assert sys.modules.pop("helping").GOOD == "user_planner beside it"


def test_it_also_plans_in_the_process_that_plans_for_a_service(here, request_m):
    with PlannerProcess(parallel=1) as planners:
        assert planners.plan("user_planner:good", request_m).result().length_m == pytest.approx(30.0)
        refused = planners.plan("user_planner:through", request_m)
        with pytest.raises(InvalidInput, match="through closed cells"):
            refused.result()


@pytest.mark.parametrize(
    ("name", "expected"),
    {
        "jumps": r"expected a path from \(10.5, 10.5\), got \(30.5, 10.5\)",
        "through": r"expected legs over open ground, got one from \(10.5, 10.5\) to \(10.5, 50.5\) m",
        "leaves": r"expected a path within the region, got \(70.5, 10.5\)",
        "beside": r"expected samples on the path, got one at \(20.5, 14.5\) m, 4.0 m from it",
        "many": "expected 1 to 4096 vertices and 1 to 2 samples, got 4 and 3",
        "winding": "expected 1 to 4096 vertices and 1 to 2 samples, got 5001 and 1",
        "backwards": r"in the order in which the path reaches them, got one at \(30.5, 10.5\) m after one beyond it",
        "unsure": "expected information_nats of 0 or more, got -5.0",
        "wordy": "expected information_nats of 0 or more, got 'many'",
        "flat": "outlook_m: InvalidInput: expected",
        "astray": "expected outlook_m within the region",
        "exits": "expected a PlannedRound or NoRoute, got SystemExit: 0",
        "long": "expected 60.0 m at most, got 95.0 m",
        "nowhere": "expected finite coordinates",
        "nothing": "expected a PlannedRound, got NoneType",
        "breaks": r"got ZeroDivisionError: division by zero \(user_planner.py, line \d+\)",
    }.items(),
)
def test_an_answer_that_a_rover_could_not_drive_is_refused(here, request_m, name, expected):
    with pytest.raises(InvalidInput, match=expected):
        planner_named(f"user_planner:{name}")(request_m)


def test_lists_are_as_good_as_arrays(here, request_m):
    planned = planner_named("user_planner:lists")(request_m)
    assert planned.samples_m.tolist() == [[40.5, 10.5]]
    assert planned.information_nats == 1.0


def test_what_a_planner_starts_and_prints_does_not_get_in_the_way(here, request_m, capfd):
    with PlannerProcess(parallel=1) as planners:
        assert planners.plan("user_planner:leaves_a_process", request_m).result().length_m == pytest.approx(30.0)
    assert capfd.readouterr().out == ""


def test_a_planner_that_finds_no_way_says_so_as_ours_do(here, request_m):
    with pytest.raises(NoRoute, match="there is no way"):
        planner_named("user_planner:gives_up")(request_m)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("absent:planner", "got ModuleNotFoundError: No module named 'absent'"),
        ("broken:planner", "got SyntaxError"),
        ("user_planner:absent", "expected a function absent in user_planner, got none"),
        ("user_planner:number", "expected a function number in user_planner, got int"),
        ("leaving:planner", "got SystemExit: 3"),
        (":planner", "expected a planner as module:function, got ':planner'"),
        ("luck", f"expected a planner among {', '.join(PLANNERS)}, or module:function; got 'luck'"),
    ],
)
def test_a_planner_that_is_not_there_is_refused_in_one_line(here, name, expected):
    with pytest.raises(InvalidInput, match=expected) as refusal:
        planner_named(name)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", ["luck", "a b:c", "module:", ":function", "module:function()", "../module:f"])
def test_a_scenario_takes_names_of_planners_only(tmp_path, name):
    path = tmp_path / "mine.toml"
    path.write_text(f'name = "mine"\nregion = "t1"\n[ground]\nplanner = "{name}"\n')
    with pytest.raises(InvalidInput, match=rf"ground.planner: .*expected {', '.join(PLANNERS)} or module:fun"):
        load_scenario(path)
    path.write_text(f'name = "mine"\nregion = "t1"\n[ground]\nplanner = "{EXAMPLE}"\n')
    assert load_scenario(path).ground.planner == EXAMPLE


def test_the_example_drives_on_open_ground_within_its_budget(quarter_of_t1, monkeypatch):
    monkeypatch.chdir(CHECKOUT)
    region = load_region(quarter_of_t1)
    mission = run_mission(region, planner_named(EXAMPLE), "matern52", 1, rounds=4, samples=3, budget_m=inf)
    assert mission.row["samples"] == 12
    assert OpenGround(region.grid, mission.traversable).segments_free(mission.path_m[1:-1], mission.path_m[2:]).all()
    short = run_mission(region, planner_named(EXAMPLE), "matern52", 1, rounds=4, samples=3, budget_m=400.0)
    assert 300.0 < short.row["path_length_m"] <= 400.0, "what is within reach is sampled, not given up"


def test_the_example_says_when_no_place_can_be_reached(request_m, monkeypatch):
    monkeypatch.chdir(CHECKOUT)
    closed = np.zeros(GRID.shape, dtype=bool)
    closed[10, 10] = True
    walled_in = replace(request_m, traversable=closed)
    with pytest.raises(NoRoute, match="no place to sample"):
        planner_named(EXAMPLE)(walled_in)
