"""Trees over open ground, grown by OMPL: a path to one target, or a tree over everything within reach.

Determinism. OMPL draws from generators that take their seeds from one process-wide source. The source is seeded before
each tree, and every OMPL object that owns a generator is made after that and dropped with the tree; so a tree depends
on its arguments alone, not on earlier plans of the same process. (At the second seeding OMPL logs an error,
because existing generators would not be affected; none of ours exist then. Its log is silenced.) Growth ends after a
number of iterations, never after a time. A lock keeps two threads from seeding each other's trees.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import hypot, isfinite, pi, sqrt
from typing import TYPE_CHECKING

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from he3.frames import path_length
from services.ground.planners.routes import subdivided

if TYPE_CHECKING:
    from he3.driving_cost import TerrainCost
    from he3.frames import FloatArray, IntArray, Place
    from services.ground.planners.traversability import OpenGround, SegmentCheck

_SEEDING = threading.Lock()
_SEEDS = 2**31 - 1  # OMPL takes seeds from 1 up to what fits 32 bits
_STEPS_A_PATH = 10.0  # edges of a tree along the path that it is to improve
_SAME_PLACE_M = 1e-6  # m, within which a goal is reached that is one place


@dataclass(frozen=True, slots=True)
class Tree:
    """A tree of straight free legs, its root at node 0.

    nodes_m: (N, 2) [m]. parents: (N,) index of each node's parent, -1 for the root. cost_m: (N,) length of the path
    from the root [m]. order: (N,) the nodes in an order in which parents precede their children.
    """

    nodes_m: FloatArray
    parents: IntArray
    cost_m: FloatArray
    order: IntArray

    def summed(self, legs: FloatArray) -> FloatArray:
        """The sum (N,) over the path from the root to each node, of legs (N,): what comes in each node's last leg."""
        depth = np.zeros(len(legs), dtype=np.intp)
        for node in self.order.tolist():
            if self.parents[node] >= 0:
                depth[node] = depth[self.parents[node]] + 1
        costs = np.zeros(len(legs))
        for level in np.split(self.order, np.flatnonzero(np.diff(depth[self.order])) + 1)[1:]:
            costs[level] = costs[self.parents[level]] + legs[level]
        return costs

    def path_to(self, node: int) -> FloatArray:
        """Polyline (K, 2) [m] from the root to the node."""
        chain = [node]
        while self.parents[chain[-1]] >= 0:
            chain.append(int(self.parents[chain[-1]]))
        return self.nodes_m[chain[::-1]]


@dataclass(frozen=True, slots=True)
class GrowthSettings:
    """Parameters of a tree's growth."""

    step_m: float = 10.0
    """Longest edge by which the tree is extended [m]; rewiring makes longer ones."""
    goal_tolerance_m: float = 10.0
    """Distance within which the target counts as reached [m]."""
    goal_bias: float = 0.0
    """Share of iterations that aim at the target itself. The paper has none, as its path lengths confirm."""
    rewire_most_m: float = 50.0
    """Largest radius within which RRT* chooses parents and rewires [m]."""
    rewire_scale_m: float = 150.0
    """The radius shrinks as rewire_scale_m sqrt(log n / n) once the tree has n nodes [m]."""

    def coarser(self, step_m: float) -> GrowthSettings:
        """These settings for a longer step [m], as cells of many metres need: the radii grow in proportion.

        Radii below the step would let RRT* rewire nothing.
        """
        factor = max(1.0, step_m / self.step_m)
        return replace(
            self,
            step_m=step_m,
            rewire_most_m=self.rewire_most_m * factor,
            rewire_scale_m=self.rewire_scale_m * factor,
        )


def tree_path(
    ground: OpenGround, start_m: Place, target_m: Place, *, optimal: bool, iterations: int, refine: int, seed: int,
    growth: GrowthSettings, cost: TerrainCost | None = None,
) -> tuple[FloatArray, bool]:  # fmt: skip
    """The path (K, 2) [m] from start towards the target along the tree as it grew, and whether the target was reached.

    optimal: grow RRT* rather than RRT. cost: what RRT* keeps low; None: the length. iterations: bound on growth.
    refine: once the target is reached, RRT* continues to this many iterations, which makes the path shorter. If the
    target was not reached, the path leads to the node nearest to it; it is the start alone, (1, 2), if no node is
    nearer than the start.
    """
    with _SEEDING:
        growing = _tree_growth(ground, start_m, target_m, optimal=optimal, seed=seed, growth=growth, cost=cost)
        growing.solve(iterations, refine)
        problem = growing.problem
        if not problem.hasSolution():
            return np.array([start_m], dtype=np.float64), False
        states = problem.getSolutionPath().getStates()
        path = np.array([(state[0], state[1]) for state in states], dtype=np.float64)
        return path, bool(problem.hasExactSolution())


def exploration_tree(
    ground: OpenGround, start_m: Place, *, iterations: int, seed: int, growth: GrowthSettings,
    cost: TerrainCost | None = None,
) -> Tree:  # fmt: skip
    """The RRT* tree over everything reachable from the start, without a target, after that number of iterations.

    cost: what its paths keep low; None: their length.
    """
    with _SEEDING:
        growth = replace(growth, goal_bias=0.0)
        growing = _tree_growth(ground, start_m, start_m, optimal=True, seed=seed, growth=growth, cost=cost)
        information = growing.problem.getSpaceInformation()
        growing.problem.setGoal(_UnreachableGoal(information))
        growing.solve(iterations, iterations)
        data = ob.PlannerData(information)
        growing.planner.getPlannerData(data)
        return _tree_from_planner_data(data)


def cheaper_path(
    ground: OpenGround, cost: TerrainCost, known_m: FloatArray, *, iterations: int, seed: int
) -> FloatArray | None:
    """The cheapest path (K, 2) [m] that informed RRT* finds between the ends of the known one; None if it finds none.

    The tree takes in the known path (K, 2) [m] first, which is free; after as many more iterations it ends. Samples are
    drawn from the ellipse that holds all cheaper paths.
    """
    length_m = path_length(known_m)
    step_m = max(length_m / _STEPS_A_PATH, 2.0 * ground.grid.resolution_m)
    seeds = subdivided(known_m, 0.999 * step_m)[1:]
    with _SEEDING:
        information, _ = _space_information(ground, seed)
        problem = ob.ProblemDefinition(information)
        start = information.allocState()
        start[0], start[1] = known_m[0]
        problem.addStartState(start)
        goal = _GoalAfterSeeds(information, seeds.tolist())
        problem.setGoal(goal)
        problem.setOptimizationObjective(_TerrainObjective(information, cost))
        planner = og.InformedRRTstar(information)
        planner.setProblemDefinition(problem)
        planner.setRange(step_m)
        planner.setKNearest(False)
        planner.setGoalBias(1.0)
        planner.setup()
        grown = 0

        def enough() -> bool:
            nonlocal grown
            goal.seeding = grown < len(seeds)
            if grown == len(seeds):
                planner.setGoalBias(0.0)
            grown += 1
            return grown > len(seeds) + iterations

        planner.solve(ob.PlannerTerminationCondition(enough))
        if not problem.hasExactSolution():
            return None
        path = [(state[0], state[1]) for state in problem.getSolutionPath().getStates()]
        return np.array(path, dtype=np.float64)


class _GoalAfterSeeds(ob.GoalSampleableRegion):  # type: ignore[misc]
    """One place as the goal. While the tree is seeded, the places to seed it with are drawn in their order instead."""

    def __init__(self, space: ob.SpaceInformation, seeds_m: list[list[float]]) -> None:
        super().__init__(space)
        self.setThreshold(_SAME_PLACE_M)
        self.seeding = False
        self._seeds_m = seeds_m
        self._next = 0

    def distanceGoal(self, state: ob.State) -> float:  # noqa: N802
        x, y = self._seeds_m[-1]
        return hypot(state[0] - x, state[1] - y)

    def maxSampleCount(self) -> int:  # noqa: N802
        return 1

    def sampleGoal(self, state: ob.State) -> None:  # noqa: N802
        place = self._seeds_m[-1]
        if self.seeding and self._next < len(self._seeds_m):
            place = self._seeds_m[self._next]
            self._next += 1
        state[0], state[1] = place


class _TerrainObjective(ob.PathLengthOptimizationObjective):  # type: ignore[misc]
    """The cost of legs over terrain. It is at least their length, from which OMPL's bounds and ellipses follow."""

    def __init__(self, space: ob.SpaceInformation, cost: TerrainCost) -> None:
        super().__init__(space)
        self._leg = cost.leg_cost()

    def motionCost(self, a: ob.State, b: ob.State) -> ob.Cost:  # noqa: N802
        return ob.Cost(self._leg(a[0], a[1], b[0], b[1]))


class _UnreachableGoal(ob.GoalRegion):  # type: ignore[misc]
    """A goal that no state satisfies: the tree grows for all iterations."""

    def __init__(self, space: ob.SpaceInformation) -> None:
        super().__init__(space)
        self.setThreshold(0.0)

    def distanceGoal(self, state: ob.State) -> float:  # noqa: N802
        return 1.0


class _LegValidator(ob.MotionValidator):  # type: ignore[misc]
    """OMPL's motion validation by the exact check of legs over cells."""

    def __init__(self, space: ob.SpaceInformation, free: SegmentCheck) -> None:
        super().__init__(space)
        self._free = free
        self.on_check: Callable[[], None] | None = None

    def checkMotion(self, a: ob.State, b: ob.State, _last_valid: object = None) -> bool:  # noqa: N802
        if self.on_check is not None:
            self.on_check()
        return self._free(a[0], a[1], b[0], b[1])


@dataclass(slots=True)
class _TreeGrowth:
    """One OMPL problem and the planner that grows its tree."""

    problem: ob.ProblemDefinition
    planner: ob.Planner
    validator: _LegValidator
    growth: GrowthSettings
    optimal: bool

    def solve(self, iterations: int, refine: int) -> None:
        """Grow for ``iterations``, or up to ``refine`` iterations if RRT* has reached the target by then.

        OMPL's RRTstar has one "range", which is both the longest extension and the largest rewiring radius. The paper
        has 10 m for the one and up to 50 m for the other. So the range is the step while an iteration extends the tree,
        and the radius from the iteration's first leg check on, which OMPL makes for the extension.
        """
        planner, growth = self.planner, self.growth
        grown = 0

        def widen() -> None:
            planner.setRange(growth.rewire_most_m)
            self.validator.on_check = None

        def enough() -> bool:
            nonlocal grown
            grown += 1
            if not self.optimal:
                return grown > iterations
            planner.setRange(growth.step_m)
            self.validator.on_check = widen
            return grown > iterations or (grown > refine and isfinite(planner.bestCost().value()))

        planner.solve(ob.PlannerTerminationCondition(enough))
        # The callback refers to the planner and the planner to the validator: a cycle that is never freed.
        self.validator.on_check = None


def _space_information(ground: OpenGround, seed: int) -> tuple[ob.SpaceInformation, _LegValidator]:
    """The site as OMPL's space, and its exact check of legs; OMPL's generators are seeded first."""
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(seed % _SEEDS + 1)
    space = ob.RealVectorStateSpace(2)
    bounds = ob.RealVectorBounds(2)
    for axis, high in enumerate((ground.grid.width_m, ground.grid.height_m)):
        bounds.setLow(axis, 0.0)
        bounds.setHigh(axis, high)
    space.setBounds(bounds)
    information = ob.SpaceInformation(space)
    free = ground.segment_check()
    information.setStateValidityChecker(lambda state: free(state[0], state[1], state[0], state[1]))
    validator = _LegValidator(information, free)
    information.setMotionValidator(validator)
    information.setup()
    return information, validator


def _tree_growth(
    ground: OpenGround, start_m: Place, target_m: Place, *, optimal: bool, seed: int, growth: GrowthSettings,
    cost: TerrainCost | None = None,
) -> _TreeGrowth:  # fmt: skip
    information, validator = _space_information(ground, seed)
    problem = ob.ProblemDefinition(information)
    start, target = information.allocState(), information.allocState()
    start[0], start[1] = start_m
    target[0], target[1] = target_m
    problem.setStartAndGoalStates(start, target, growth.goal_tolerance_m)
    if cost is not None:
        problem.setOptimizationObjective(_TerrainObjective(information, cost))
    planner = (og.RRTstar if optimal else og.RRT)(information)
    planner.setProblemDefinition(problem)
    planner.setRange(growth.step_m)
    planner.setGoalBias(growth.goal_bias)
    if optimal:
        planner.setKNearest(False)
        # OMPL's radius is factor sqrt(2 (1 + 1/2) area / pi) sqrt(log n / n).
        area = ground.grid.width_m * ground.grid.height_m
        planner.setRewireFactor(growth.rewire_scale_m / sqrt(3.0 * area / pi))
    planner.setup()
    return _TreeGrowth(problem, planner, validator, growth, optimal)


def _tree_from_planner_data(data: ob.PlannerData) -> Tree:
    count = data.numVertices()
    nodes = np.empty((count, 2))
    parents = np.full(count, -1, dtype=np.intp)
    for i in range(count):
        state = data.getVertex(i).getState()
        nodes[i] = state[0], state[1]
        for child in data.getEdges(i):
            parents[child] = i
    return tree_from_parents(nodes, parents, int(data.getStartIndex(0)))


def tree_from_parents(nodes: FloatArray, parents: IntArray, root: int) -> Tree:
    """The tree of these nodes (N, 2) [m] and parents (N,), renumbered so that the root is node 0."""
    if root != 0:
        swap = np.arange(len(nodes))
        swap[[0, root]] = root, 0
        nodes, parents = nodes[swap], parents[swap]
        parents = np.where(parents >= 0, swap[parents], -1)
    depth = np.where(parents < 0, 0, 1)
    above = parents.copy()
    while (above >= 0).any():  # pointer doubling: depth of every node in log(height) rounds
        has = above >= 0
        depth[has] += depth[above[has]]
        above[has] = above[above[has]]
    order = np.argsort(depth, kind="stable")
    step = np.hypot(*(nodes - nodes[np.maximum(parents, 0)]).T)
    cost = np.zeros(len(nodes))
    for level in np.split(order, np.flatnonzero(np.diff(depth[order])) + 1)[1:]:
        cost[level] = cost[parents[level]] + step[level]
    return Tree(nodes, parents, cost, order)
