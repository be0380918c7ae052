"""Trees grown by OMPL: free legs, reproducible, the paper's radius, nothing left behind."""

import gc
import subprocess
import sys
import threading

import numpy as np
import pytest

from he3.frames import SiteGrid, path_length
from he3.gp import Hyperparameters
from he3.kernels import KERNELS, kernel_from
from services.ground.planners import trees
from services.ground.planners.informative import places_on_paths, shares_inside, with_least_length_scale
from services.ground.planners.polyline import places_along
from services.ground.planners.traversability import OpenGround
from services.ground.planners.trees import GrowthSettings, Tree, exploration_tree, tree_from_parents, tree_path


@pytest.fixture(scope="module")
def ground():
    mask = np.ones((300, 300), dtype=bool)
    mask[:200, 140:160] = False
    mask[150:170, 200:] = False
    return OpenGround(SiteGrid(300, 300), mask)


def grown(ground, *, optimal, seed=1, refine=0, **growth):
    return tree_path(
        ground, (20.0, 20.0), (280.0, 20.0), optimal=optimal, iterations=5000, refine=refine, seed=seed,
        growth=GrowthSettings(**growth),
    )  # fmt: skip


@pytest.mark.parametrize("optimal", [False, True])
def test_a_path_leads_from_the_start_to_within_tolerance_of_the_target_over_free_legs(ground, optimal):
    path, reached = grown(ground, optimal=optimal)
    assert reached
    assert path[0].tolist() == [20.0, 20.0]
    assert np.hypot(*(path[-1] - (280.0, 20.0))) <= 10.0
    assert ground.segments_free(path[:-1], path[1:]).all()


def test_rrt_extends_by_the_step_and_rrtstar_rewires_within_fifty_metres(ground):
    steps = [np.hypot(*np.diff(grown(ground, optimal=optimal)[0], axis=0).T) for optimal in (False, True)]
    assert steps[0].max() <= 10.0 + 1e-9
    assert 10.0 < steps[1].max() <= 50.0
    near, _ = grown(ground, optimal=True, rewire_most_m=15.0)
    assert np.hypot(*np.diff(near, axis=0).T).max() <= 15.0


def test_over_cells_twenty_times_as_large_a_tree_is_the_same_but_for_its_size(ground):
    fine, _ = grown(ground, optimal=True)
    coarse, reached = tree_path(
        OpenGround(SiteGrid(300, 300, 20.0), ground.open), (400.0, 400.0), (5600.0, 400.0), optimal=True,
        iterations=5000, refine=0, seed=1, growth=GrowthSettings(goal_tolerance_m=200.0).coarser(200.0),
    )  # fmt: skip
    assert reached
    np.testing.assert_allclose(coarse, 20.0 * fine, atol=1e-6)


def test_rewiring_and_further_growth_make_paths_shorter(ground):
    def mean_length(**how):
        return np.mean([path_length(grown(ground, seed=seed, **how)[0]) for seed in range(6)])

    assert mean_length(optimal=True) < 0.93 * mean_length(optimal=False)
    assert mean_length(optimal=True, refine=3000) < mean_length(optimal=True)


def test_a_target_behind_walls_gives_the_path_that_came_nearest():
    mask = np.ones((60, 60), dtype=bool)
    mask[:, 30] = False
    path, reached = tree_path(
        OpenGround(SiteGrid(60, 60), mask), (5.0, 5.0), (55.0, 5.0), optimal=True, iterations=300, refine=0, seed=0,
        growth=GrowthSettings(goal_tolerance_m=3.0),
    )  # fmt: skip
    assert not reached
    assert 20.0 < path[-1, 0] < 30.0


def test_a_tree_with_no_room_to_grow_stays_in_its_cell():
    mask = np.zeros((60, 60), dtype=bool)
    mask[5, 5] = True
    tree = exploration_tree(
        OpenGround(SiteGrid(60, 60), mask), (5.5, 5.5), iterations=200, seed=0, growth=GrowthSettings()
    )
    assert tree.nodes_m[0].tolist() == [5.5, 5.5]
    assert (np.floor(tree.nodes_m) == 5.0).all()


def test_an_exploration_tree_has_one_root_free_legs_and_the_lengths_of_its_paths(ground):
    tree = exploration_tree(ground, (20.0, 20.0), iterations=1500, seed=3, growth=GrowthSettings(rewire_scale_m=400.0))
    assert len(tree.nodes_m) > 1000
    assert tree.nodes_m[0].tolist() == [20.0, 20.0]
    assert np.flatnonzero(tree.parents < 0).tolist() == [0]
    assert ground.segments_free(tree.nodes_m[1:], tree.nodes_m[tree.parents[1:]]).all()
    for node in range(0, len(tree.nodes_m), 97):
        assert tree.cost_m[node] == pytest.approx(path_length(tree.path_to(node)))
    position = np.argsort(tree.order)
    assert (position[tree.parents[1:]] < position[1:]).all()


def test_places_on_all_paths_at_once_are_those_on_each_path_alone(ground):
    tree = exploration_tree(ground, (20.0, 20.0), iterations=600, seed=3, growth=GrowthSettings())
    nodes = np.arange(1, len(tree.nodes_m))
    for count in (1, 5):
        batch = places_on_paths(tree, nodes, count)
        for node, places in zip(nodes, batch, strict=True):
            np.testing.assert_allclose(places, places_along(tree.path_to(node), count), atol=1e-9)


def test_a_tree_is_renumbered_so_that_its_root_comes_first():
    nodes = np.array([[2.0, 0.0], [1.0, 0.0], [0.0, 0.0], [2.0, 1.0]])
    tree = tree_from_parents(nodes, np.array([1, 2, -1, 0]), 2)
    assert isinstance(tree, Tree)
    assert tree.path_to(3).tolist() == [[0, 0], [1, 0], [2, 0], [2, 1]]
    assert tree.cost_m[3] == 3.0


def test_the_same_seed_grows_the_same_tree_in_any_thread_and_after_any_other(ground):
    expected = grown(ground, optimal=True, seed=7)[0]
    answers = []

    def grow():
        for seed in (3, 7, 11):
            answers.append((seed, grown(ground, optimal=True, seed=seed)[0]))  # noqa: PERF401

    threads = [threading.Thread(target=grow) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert len(answers) == 9
    for seed, path in answers:
        assert np.array_equal(path, expected) == (seed == 7)


def test_a_process_grows_the_tree_that_another_one_grew(ground):
    script = (
        "import numpy as np, sys\n"
        "from he3.frames import SiteGrid\n"
        "from services.ground.planners.traversability import OpenGround\n"
        "from services.ground.planners.trees import GrowthSettings, tree_path\n"
        "ground = OpenGround(SiteGrid(80, 80), np.ones((80, 80), bool))\n"
        "more = dict(optimal=True, iterations=5000, refine=0, seed=5, growth=GrowthSettings())\n"
        "path, _ = tree_path(ground, (5., 5.), (70., 60.), **more)\n"
        "sys.stdout.write(path.tobytes().hex())\n"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    other = np.frombuffer(bytes.fromhex(run.stdout)).reshape(-1, 2)
    empty = OpenGround(SiteGrid(80, 80), np.ones((80, 80), dtype=bool))
    tree_path(empty, (1.0, 1.0), (70.0, 60.0), optimal=False, iterations=50, refine=0, seed=1, growth=GrowthSettings())
    path, _ = tree_path(
        empty, (5.0, 5.0), (70.0, 60.0), optimal=True, iterations=5000, refine=0, seed=5, growth=GrowthSettings()
    )
    np.testing.assert_array_equal(path, other)
    assert "leaked" not in run.stderr


def test_trees_leave_nothing_behind(ground):
    def count():
        gc.collect()
        return sum(isinstance(thing, trees._LegValidator) for thing in gc.get_objects())

    grown(ground, optimal=True)
    before = count()
    for seed in range(20):
        grown(ground, optimal=True, seed=seed)
        exploration_tree(ground, (20.0, 20.0), iterations=50, seed=seed, growth=GrowthSettings())
    assert count() <= before


@pytest.mark.parametrize("name", sorted(KERNELS))
def test_a_raised_length_scale_keeps_half_the_correlation_at_the_given_distance(name):
    kernel = kernel_from(name)
    parameters = {
        k: 2.0 if k in ("length_scale_m", "rough_length_scale_m") else v for k, v in kernel.parameters().items()
    }
    parameters |= {"smooth_variance": 1e-12} if name == "smooth+rough" else {}
    far = with_least_length_scale(Hyperparameters(kernel_from(name, parameters)), 40.0).kernel
    correlation = far.of_squared_distance(np.array([0.0, 40.0**2]))
    assert correlation[1] / correlation[0] == pytest.approx(0.5, abs=1e-3)
    assert with_least_length_scale(Hyperparameters(far), 30.0).kernel is far


def test_a_sample_at_an_edge_of_the_site_tells_about_it_with_one_half_and_in_a_corner_with_one_quarter():
    grid = SiteGrid(40, 60, 10.0)  # 600 m east, 400 m north
    places = np.array(
        [[[300.0, 200.0], [0.0, 200.0]], [[600.0, 400.0], [25.0, 200.0]], [[50.0, 370.0], [550.0, 200.0]]]
    )
    np.testing.assert_allclose(shares_inside(grid, places, 100.0), [[1.0, 0.5], [0.25, 0.75], [0.8, 1.0]])
    wide = shares_inside(grid, np.array([[300.0, 200.0], [0.0, 200.0], [600.0, 0.0]]), 5000.0)
    np.testing.assert_allclose(wide, [1.0, 0.5, 0.25])
