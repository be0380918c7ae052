"""Properties of the rover for any plan, terrain and telecommands."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from he3.reference import Region
from schemas.commands import CommandKind
from schemas.plans import RoundPlan
from schemas.telemetry import RoverMode
from services.rover.activities import SAMPLE_TOLERANCE_M
from tests.unit.rover.simulated_moon import DAY_S, GRID, START, WEAK_BATTERY, Moon, plan_of, region, round_plan, wall

inner = st.floats(1.0, 59.0)


@st.composite
def rough_regions(draw: st.DrawFn) -> Region:
    boulders = draw(st.lists(st.tuples(inner, inner, st.floats(0.3, 6)), max_size=12))

    def closed(x: float, y: float) -> bool:
        if math.dist((x, y), START) < 2.5:
            return False
        return any(math.dist((x, y), (bx, by)) <= radius for bx, by, radius in boulders)

    return region(closed)


@st.composite
def any_rounds(draw: st.DrawFn) -> list[RoundPlan]:
    place, rounds = START, []
    for number in range(1, draw(st.integers(1, 3)) + 1):
        path = [place, *draw(st.lists(st.tuples(inner, inner), min_size=1, max_size=5))]
        vertices = sorted(draw(st.sets(st.integers(0, len(path) - 1), max_size=3)))
        rounds.append(round_plan(number, path, *(path[k] for k in vertices)))
        place = path[-1]
    return rounds


@settings(max_examples=60)
@given(rough_regions(), any_rounds(), st.floats(0.1, 1.0))
def test_the_rover_never_enters_closed_terrain_and_its_odometer_is_the_length_of_its_path(land, rounds, radius):
    moon = Moon(land=land, state_period_s=4.0, footprint_radius_m=radius, drill_s_per_m=10.0, analysis_s=1.0)
    moon.plan(plan_of(1, *rounds, last=True))
    for until_s in range(500, 12_000, 500):
        if moon.run(until_s).finished or moon.states[-1].mode is RoverMode.SAFE:
            break
    right = np.radians([state.heading_deg + 90 for state in moon.states])
    middle = np.array([(state.x_m, state.y_m) for state in moon.states])
    for side in (-0.9, 0.0, 0.9):
        covered = middle + side * radius * np.column_stack((np.sin(right), np.cos(right)))
        assert land.traversable[GRID.cells_of(np.clip(covered, 0, 60))].all()
    way = [START, *[vertex for planned in rounds for vertex in planned.path_m]]
    length = sum(math.dist(a, b) for a, b in itertools.pairwise(way))
    count = sum(len(planned.samples) for planned in rounds)
    # A sample may be taken where the path first comes near to it; then the rover drives there and back.
    detours_m = 2 * SAMPLE_TOLERANCE_M * count
    if moon.finished:
        assert -1e-6 <= moon.state.driven_m - length <= detours_m + 1e-6
        assert len(moon.samples) == count
    else:
        assert moon.state.mode is RoverMode.SAFE
        assert moon.state.driven_m < length + detours_m
    drilled = {(sample.x_m, sample.y_m) for sample in moon.samples}
    assert drilled <= {(s.x_m, s.y_m) for planned in rounds for s in planned.samples}


KINDS = [kind.value for kind in CommandKind]


@settings(max_examples=60)
@given(
    any_rounds(),
    st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 6000), st.integers(0, 6000), inner, inner), max_size=15),
    st.booleans(),
)
def test_every_command_ends_once_and_no_sample_is_taken_twice_for_any_commands(rounds, commands, hungry):
    moon = Moon(wall, **(WEAK_BATTERY if hungry else {}))
    moon.plan(plan_of(1, *rounds, last=True))
    for k, (kind, at, made, x, y) in enumerate(commands):
        fields: dict[str, Any] = {}
        if kind == "go_to":
            fields = {"target_m": (x, y)}
        elif kind == "set_keep_out":
            fields = {"area_id": "a", "polygon_m": ((x, y), (x + 4, y), (x, y + 4))}
        moon.command(kind, at, f"c{k}", made_s=made, **fields)
    moon.run(20 * DAY_S)
    ends = {"completed", "failed", "rejected", "expired"}
    for k in range(len(commands)):
        stages = moon.stages(f"c{k}")
        under_hold = moon.state.mode in (RoverMode.PAUSED, RoverMode.SAFE)
        assert sum(stage in ends for stage in stages) == 1 or (under_hold and stages[-1] == "started"), stages
        assert stages[0] == "received"
    ids = [sample.sample_id for sample in moon.samples]
    assert len(ids) == len(set(ids))
    assert moon.state.mode in (RoverMode.PARKED, RoverMode.PAUSED, RoverMode.SAFE)
