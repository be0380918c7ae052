"""Paths to the ground that a tree did not reach."""

from __future__ import annotations

import numpy as np
import pytest

from he3.frames import FloatArray, SiteGrid, path_length
from services.ground.planners.routes import RouteFinder
from services.ground.planners.traversability import OpenGround
from services.ground.planners.trees import GrowthSettings, Tree, exploration_tree
from services.ground.planners.unreached import MOST_PLACES, with_paths_further

GRID = SiteGrid(60, 60, 100.0)
START = (550.0, 550.0)


def behind_a_passage() -> OpenGround:
    """Two rooms, joined by a passage of one cell with three bends."""
    open_cells = np.ones(GRID.shape, dtype=np.bool_)
    open_cells[:, 18:25] = False
    open_cells[40, 18:22] = open_cells[35:41, 21] = open_cells[35, 21:25] = True
    return OpenGround(GRID, open_cells, 0.8)


def tree_over(ground: OpenGround) -> Tree:
    return exploration_tree(ground, START, iterations=300, seed=3, growth=GrowthSettings().coarser(120.0))


def farthest(tree: Tree) -> FloatArray:
    return np.hypot(*(tree.nodes_m - START).T)


def test_a_tree_that_misses_a_passage_gets_paths_to_what_lies_behind_it() -> None:
    ground = behind_a_passage()
    tree = tree_over(ground)
    assert tree.nodes_m[:, 0].max() < 2200.0
    further = with_paths_further(tree, ground, 120.0)
    assert further.nodes_m[:, 0].max() > 5500.0
    assert further.nodes_m[:, 1].max() > 5500.0
    parents = further.parents[1:]
    assert ground.segments_free(further.nodes_m[parents], further.nodes_m[1:]).all()
    assert np.array_equal(further.nodes_m[: len(tree.nodes_m)], tree.nodes_m)
    place = np.empty(len(further.order), dtype=int)
    place[further.order] = np.arange(len(further.order))
    assert (place[parents] < place[1:]).all()
    ends = np.setdiff1d(np.arange(len(tree.nodes_m), len(further.nodes_m)), further.parents)
    assert 20 < len(ends) <= MOST_PLACES
    for node in ends:
        assert path_length(further.path_to(int(node))) == pytest.approx(further.cost_m[node])


def test_a_tree_that_reaches_nearly_all_ground_stays_as_it_is() -> None:
    ground = OpenGround(GRID, np.ones(GRID.shape, dtype=np.bool_))
    tree = exploration_tree(ground, START, iterations=3000, seed=3, growth=GrowthSettings().coarser(120.0))
    assert with_paths_further(tree, ground, 120.0) is tree


def test_ground_that_is_cut_off_is_none_that_a_tree_could_reach() -> None:
    open_cells = np.ones(GRID.shape, dtype=np.bool_)
    open_cells[:, 50] = False
    ground = OpenGround(GRID, open_cells)
    tree = exploration_tree(ground, START, iterations=4000, seed=3, growth=GrowthSettings().coarser(120.0))
    assert with_paths_further(tree, ground, 120.0) is tree


def test_routes_to_many_places_are_those_to_each_of_them() -> None:
    ground = behind_a_passage()
    finder = RouteFinder(ground)
    ends = np.array([[5550.0, 5550.0], [550.0, 5550.0], [3050.0, 150.0], [2950.0, 3350.0]])
    for end, route in zip(ends, finder.routes(START, ends), strict=True):
        assert np.array_equal(route, finder.route((end[0], end[1]), START)[::-1])
        assert ground.segments_free(route[:-1], route[1:]).all()
