"""Paths to the ground that a tree did not reach.

A tree that grows at random finds a passage of one cell late or never, and on a site of many kilometres such a passage
may lead to most of it. Where much of the ground is left, a search over all cells leads to places in it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from services.ground.planners.routes import RouteFinder
from services.ground.planners.trees import Tree

if TYPE_CHECKING:
    from he3.frames import FloatArray
    from services.ground.planners.traversability import OpenGround

ENOUGH: Final = 0.9
"""Share of the ground within reach that is enough for a tree."""
MOST_PLACES: Final = 40
"""Places that further paths lead to."""
_BLOCK_STEPS: Final = 2.0  # steps of the tree, the side of a block that a node stands for


def with_paths_further(tree: Tree, ground: OpenGround, step_m: float) -> Tree:
    """The tree, or that tree with paths to blocks of the ground that it did not reach, if they are many.

    step_m: its longest edge [m]. The ground is that connected to its root. The places lie evenly among those blocks.
    """
    root = (float(tree.nodes_m[0, 0]), float(tree.nodes_m[0, 1]))
    cells = np.argwhere(ground.connected_to(root))
    centres: FloatArray = (cells[:, ::-1].astype(np.float64) + 0.5) * ground.grid.resolution_m
    block_m = _BLOCK_STEPS * step_m
    left = ~np.isin(_blocks(centres, block_m), _blocks(tree.nodes_m, block_m))
    if np.count_nonzero(left) <= (1.0 - ENOUGH) * len(cells):
        return tree
    centres = centres[left]
    away = np.hypot(*(centres % block_m - 0.5 * block_m).T)
    nearest_first = np.lexsort((away, _blocks(centres, block_m)))
    centres = centres[nearest_first][np.unique(_blocks(centres, block_m)[nearest_first], return_index=True)[1]]
    chosen = np.unique(np.linspace(0, len(centres) - 1, min(MOST_PLACES, len(centres))).round().astype(int))
    return _joined(tree, RouteFinder(ground).routes(root, centres[chosen]))


def _blocks(places_m: FloatArray, block_m: float) -> FloatArray:
    """The block of each place (n, 2) [m], as one number (n,) in the order of rows and then columns."""
    columns, rows = np.floor(places_m / block_m).T
    numbers: FloatArray = rows * 1e6 + columns
    return numbers


def _joined(tree: Tree, paths_m: list[FloatArray]) -> Tree:
    """The tree with polylines (k, 2) [m] that begin at its root."""
    nodes, parents, costs = [tree.nodes_m], [tree.parents], [tree.cost_m]
    count = len(tree.nodes_m)
    for path in paths_m:
        added = len(path) - 1
        nodes.append(path[1:])
        parents.append(np.concatenate(([0], np.arange(count, count + added - 1))))
        costs.append(np.cumsum(np.hypot(*np.diff(path, axis=0).T)))
        count += added
    order = np.concatenate((tree.order, np.arange(len(tree.nodes_m), count)))
    return Tree(np.vstack(nodes), np.concatenate(parents), np.concatenate(costs), order)
