"""The rover's parts, each on its own: the table of phases, energy, geometry, way, hole, round, track, commands."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from he3.errors import InvalidInput
from he3.frames import SiteGrid
from schemas.commands import CommandKind, CommandStage, Telecommand
from schemas.measurement import TerrainReply
from schemas.plans import PlannedSample, RoundPlan
from schemas.wire import Header
from services.mission.scenario import RoverConfig
from services.rover.activities import legs_of
from services.rover.command_registry import CommandRegistry, IllegalStage
from services.rover.drill import bites_m
from services.rover.energy import Battery, full_battery
from services.rover.geometry import Area, inside, squared_distance
from services.rover.states import MODES, TABLE, IllegalTransition, Phase, Trigger, after
from services.rover.track import way_home
from services.rover.traverse import Corridor, Piece, corridor, drive, forbidden, heading_deg
from services.runtime.node import SECOND, seconds

SITE = SiteGrid(100, 100)
coordinates = st.floats(1, 99)
places = st.tuples(coordinates, coordinates)


# --- the table ----------------------------------------------------------------------------------------------------

LEGAL = {
    "idle": "look drill pause run_low danger nothing_left",
    "looking": "look way_clear pause run_low danger nothing_left",
    "driving": "look drill pause run_low danger nothing_left",
    "drilling": "look drill hole_done pause run_low danger nothing_left",
    "analysing": "look analysed pause run_low danger nothing_left",
    "measuring": "look drill analysed pause run_low danger nothing_left",
    "paused": "look drill hole_done analysed pause run_low danger nothing_left",
    "charging": "look drill hole_done analysed pause danger nothing_left",
    "safe": "look drill hole_done analysed run_low danger nothing_left",
    "parked": "look drill pause run_low danger nothing_left",
}
LEADS_TO = {
    "look": Phase.LOOKING,
    "way_clear": Phase.DRIVING,
    "drill": Phase.DRILLING,
    "hole_done": Phase.ANALYSING,
    "analysed": Phase.MEASURING,
    "pause": Phase.PAUSED,
    "run_low": Phase.CHARGING,
    "danger": Phase.SAFE,
    "nothing_left": Phase.PARKED,
}


@pytest.mark.parametrize(("phase", "trigger"), list(itertools.product(Phase, Trigger)))
def test_every_transition_is_the_one_intended_or_is_refused_by_both_names(phase, trigger):
    if trigger.name.lower() in LEGAL[phase.value].split():
        assert after(phase, trigger) is LEADS_TO[trigger.name.lower()]
    else:
        with pytest.raises(IllegalTransition, match=rf"'{phase.value}' does not admit '{trigger.value}'"):
            after(phase, trigger)


def test_every_phase_can_be_reached_and_left_and_has_a_mode():
    assert set(TABLE.values()) | {Phase.IDLE} == set(Phase)
    assert {phase for phase, _ in TABLE} == set(Phase) == set(MODES)


# --- energy -------------------------------------------------------------------------------------------------------


def battery(**changes: float) -> Battery:
    return full_battery(RoverConfig.model_validate({"capacity_wh": 1000.0, "initial_charge": 0.5} | changes), 0)


def test_charge_grows_by_what_the_sun_gives_beyond_the_loads():
    # 450 - 150 - 100 W for an hour are 200 Wh.
    assert battery().drawing(100.0, 0).charge_at(seconds(3600)) == pytest.approx(700.0)


def test_charge_falls_in_the_dark_and_ends_at_zero():
    dark = battery(solar_w=0.0)
    assert dark.charge_at(seconds(3600)) == pytest.approx(350.0)
    assert dark.charge_at(seconds(36000)) == 0.0


def test_charge_ends_at_the_capacity():
    assert battery().charge_at(seconds(1e6)) == 1000.0


def test_a_change_of_load_keeps_the_charge_of_the_moment():
    then = seconds(1800)
    assert battery().drawing(500.0, then).charge_at(then) == battery().charge_at(then)


@given(st.floats(0, 1), st.floats(1, 1000), st.floats(0, 1000))
def test_a_level_is_reached_when_it_is_said_to_be(share, level, load):
    cell = battery(initial_charge=share).drawing(load, 0)
    ready = cell.reaches(level, 0)
    if ready is None:
        assert load >= 300
        assert cell.charge_at(0) < level
    else:
        assert cell.charge_at(ready) >= level - 1e-9
        assert ready == 0 or cell.charge_at(ready - SECOND) < level


def test_a_step_takes_nothing_that_the_sun_bears():
    assert battery().need_wh(200.0, 3600) == 0.0
    assert battery().need_wh(400.0, 3600) == pytest.approx(100.0)


# --- plane geometry -----------------------------------------------------------------------------------------------

SQUARE = ((10.0, 10.0), (20.0, 10.0), (20.0, 20.0), (10.0, 20.0))
HOOK = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (8.0, 10.0), (8.0, 2.0), (0.0, 2.0))


def test_a_place_is_inside_a_polygon_by_the_even_odd_rule():
    assert inside(SQUARE, (15.0, 15.0))
    assert not inside(SQUARE, (25.0, 15.0))
    assert inside(HOOK, (9.0, 8.0))
    assert not inside(HOOK, (4.0, 8.0))


@pytest.mark.parametrize(
    ("a", "b", "margin", "near"),
    [
        ((0.0, 15.0), (30.0, 15.0), 0.0, True),  # straight through, both ends outside
        ((14.0, 14.0), (15.0, 15.0), 0.0, True),  # wholly within
        ((0.0, 9.0), (30.0, 9.0), 0.5, False),  # passes beside it
        ((0.0, 9.0), (30.0, 9.0), 1.5, True),  # too near
        ((0.0, 21.0), (9.0, 30.0), 3.0, False),  # within the box, clear of the corner
        ((21.0, 25.0), (25.0, 21.0), 4.2, False),  # the corner is sqrt(18) m away
        ((21.0, 25.0), (25.0, 21.0), 4.3, True),
    ],
)
def test_a_stretch_of_way_enters_an_area_when_it_comes_nearer_than_the_margin(a, b, margin, near):
    assert Area.within(SQUARE).is_near(a, b, margin) is near


@given(places, places, st.floats(0.1, 5))
def test_nearness_to_an_area_agrees_with_sampling_the_stretch(a, b, margin):
    area = Area.within(SQUARE)

    def gap(place: tuple[float, float]) -> float:
        dx = max(10 - place[0], 0.0, place[0] - 20)
        dy = max(10 - place[1], 0.0, place[1] - 20)
        return math.hypot(dx, dy)

    nearest = min(
        gap((a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))) for share in np.linspace(0, 1, 2001)
    )
    if nearest < margin:
        assert area.is_near(a, b, margin)
    elif nearest > margin + 0.1:
        assert not area.is_near(a, b, margin)


@given(places, places, places)
def test_distance_from_a_segment_agrees_with_sampling_it(p, a, b):
    sampled = min(math.dist(p, (a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]))) for s in np.linspace(0, 1, 501))
    exact = math.sqrt(squared_distance(p, a, b))
    assert exact <= sampled + 1e-9
    assert sampled <= exact + math.dist(a, b) / 500 + 1e-9


# --- pieces and looks ---------------------------------------------------------------------------------------------


def rover_corridor(radius: float = 0.8, look_ahead: float = 10.0, site: SiteGrid = SITE) -> Corridor:
    return corridor(RoverConfig(footprint_radius_m=radius, look_ahead_m=look_ahead), site)


def pieces(way: list[tuple[float, float]], strip: Corridor) -> list[Piece]:
    found, place, vertex = [], way[0], 1
    while vertex < len(way):
        piece = strip.cut(place, way, vertex)
        assert piece.vertices or piece.length_m > 0
        place, vertex = piece.points_m[-1], vertex + piece.vertices
        found.append(piece)
    return found


@given(st.lists(places, min_size=2, max_size=12), st.floats(0.5, 30))
def test_pieces_put_together_are_the_way(way, look_ahead):
    cut = pieces(way, rover_corridor(look_ahead=look_ahead))
    length = sum(math.dist(a, b) for a, b in itertools.pairwise(way))
    assert sum(piece.length_m for piece in cut) == pytest.approx(length, abs=1e-6)
    assert all(piece.length_m <= look_ahead + 1e-9 for piece in cut)
    for before, behind in itertools.pairwise(cut):
        assert before.points_m[-1] == behind.points_m[0]
    assert cut[-1].points_m[-1] == pytest.approx(way[-1], abs=1e-8)
    driven = [point for piece in cut for point in piece.points_m]
    assert all(any(math.dist(vertex, point) < 1e-8 for point in driven) for vertex in way)


@given(
    st.lists(places, min_size=2, max_size=40),
    st.floats(0, 0.9),
    st.floats(0.5, 500),
    st.sampled_from([0.1, 0.5, 1.0, 2.0, 5.0]),
)
def test_a_look_fits_one_question_whatever_the_way_vehicle_and_cells(way, radius, look_ahead, resolution):
    site = SiteGrid(round(100 / resolution), round(100 / resolution), resolution)
    strip = rover_corridor(radius, look_ahead, site)
    piece = strip.cut(way[0], way, 1)
    if piece.length_m > 0:
        assert 1 <= len(strip.look(piece).points_m) <= 512


def test_a_vehicle_wider_than_a_look_can_take_in_is_refused():
    with pytest.raises(InvalidInput, match=r"at most 9 cells of 0.1 m, got 1 m"):
        rover_corridor(1.0, site=SiteGrid(100, 100, 0.1))


@given(places, places, st.floats(0.2, 1.0))
def test_a_look_sees_every_cell_that_the_vehicle_would_cover(a, b, radius):
    strip = rover_corridor(radius, 50.0)
    piece = strip.cut(a, [a, b], 1)
    if piece.length_m < 0.01:
        return
    seen = {(math.floor(x), math.floor(y)) for x, y in strip.look(piece).points_m}
    end = piece.points_m[-1]
    ux, uy = (end[0] - a[0]) / piece.length_m, (end[1] - a[1]) / piece.length_m
    inner = radius - 1e-6
    for along in np.linspace(0, piece.length_m, 60):
        for beside in np.linspace(-inner, inner, 9):
            x, y = a[0] + ux * along - uy * beside, a[1] + uy * along + ux * beside
            if math.dist(a, (x, y)) <= radius:
                continue  # it stands there already
            if 0 <= x <= 100 and 0 <= y <= 100 and (x % 1) * (y % 1) > 1e-9:
                near_edge = min(x % 1, 1 - x % 1, y % 1, 1 - y % 1) < 1e-6
                assert near_edge or (math.floor(x), math.floor(y)) in seen


@given(places, places)
def test_the_middle_stretches_of_a_look_measure_the_piece(a, b):
    strip = rover_corridor(0.8, 20.0)
    piece = strip.cut(a, [a, b], 1)
    if piece.length_m == 0:
        return
    look = strip.look(piece)
    assert list(look.ends_m) == sorted(look.ends_m)
    assert look.ends_m[-1] == pytest.approx(piece.length_m, abs=1e-9)
    assert look.middle == len(look.ends_m)


def test_what_sticks_out_over_the_edge_of_the_site_is_not_looked_at():
    strip = rover_corridor(0.8)
    look = strip.look(strip.cut((0.2, 5.0), [(0.2, 15.0)], 0))
    assert all(0 <= x <= 100 for x, _ in look.points_m)
    assert any(x == pytest.approx(1.0) for x, _ in look.points_m)


def seen_as(points, closed=lambda x, y: False, slope=lambda x, y: 0.0, height=lambda x, y: 0.0) -> TerrainReply:
    return TerrainReply(
        elevation_m=tuple(height(x, y) for x, y in points),
        slope_deg=tuple(slope(x, y) for x, y in points),
        traversable=tuple(not closed(x, y) for x, y in points),
    )


CONFIG = RoverConfig()


def look_from(a: tuple[float, float], b: tuple[float, float]):
    strip = corridor(CONFIG, SITE)
    piece = strip.cut(a, [b], 0)
    return piece, strip.look(piece)


def test_closed_ground_in_the_way_is_forbidden():
    _, look = look_from((5.0, 5.5), (15.0, 5.5))
    found = forbidden(look, seen_as(look.points_m, lambda x, y: 10 <= x < 11 and 5 <= y < 6), CONFIG, 1.0, (5.0, 5.5))
    assert found
    assert all(10 <= x < 11 for x, _ in found)


def test_closed_ground_under_one_side_is_forbidden():
    _, look = look_from((5.0, 5.5), (15.0, 5.5))
    assert forbidden(look, seen_as(look.points_m, lambda x, y: 10 <= x < 11 and 6 <= y < 7), CONFIG, 1.0, (5.0, 5.5))
    assert not forbidden(
        look, seen_as(look.points_m, lambda x, y: 10 <= x < 11 and 7 <= y < 8), CONFIG, 1.0, (5.0, 5.5)
    )


def test_ground_steeper_than_the_limit_is_forbidden_though_it_is_open():
    _, look = look_from((5.0, 5.5), (15.0, 5.5))
    assert forbidden(look, seen_as(look.points_m, slope=lambda x, y: 20.1 if x > 10 else 0.0), CONFIG, 1.0, (5.0, 5.5))
    assert not forbidden(look, seen_as(look.points_m, slope=lambda x, y: 20.0), CONFIG, 1.0, (5.0, 5.5))


def test_bad_ground_that_the_rover_stands_on_does_not_hold_it_there():
    _, look = look_from((5.5, 5.5), (15.5, 5.5))
    assert not forbidden(look, seen_as(look.points_m, lambda x, y: x < 6), CONFIG, 1.0, (5.5, 5.5))


def test_bad_ground_after_the_first_good_is_forbidden_even_when_the_rover_stands_on_bad():
    _, look = look_from((5.5, 5.5), (15.5, 5.5))
    found = forbidden(look, seen_as(look.points_m, lambda x, y: x < 6 or 12 <= x < 13), CONFIG, 1.0, (5.5, 5.5))
    assert found
    assert all(x > 11 for x, _ in found)


def test_a_piece_on_the_flat_takes_its_length_over_its_speed():
    piece, look = look_from((5.0, 5.5), (15.0, 5.5))
    under_way = drive(piece, look, seen_as(look.points_m), CONFIG, 0)
    assert under_way.duration_s == pytest.approx(100.0)
    assert under_way.load_w * under_way.duration_s == pytest.approx(2400.0)


def test_a_slope_slows_the_rover_down():
    piece, look = look_from((5.0, 5.5), (15.0, 5.5))
    half_steep = seen_as(look.points_m, slope=lambda x, y: 20.0 if x > 10 else 0.0)
    under_way = drive(piece, look, half_steep, CONFIG, 0)
    assert under_way.duration_s == pytest.approx(50.0 + 100.0)
    assert under_way.driven_m(seconds(50)) == pytest.approx(5.0)
    assert under_way.driven_m(seconds(100)) == pytest.approx(7.5)
    assert under_way.place_m(seconds(100))[0] == pytest.approx((12.5, 5.5))


def test_climbing_takes_more_energy_and_descending_gives_none_back():
    piece, look = look_from((5.0, 5.5), (15.0, 5.5))
    ramp = seen_as(look.points_m, height=lambda x, y: math.floor(x) * 0.1)
    up = drive(piece, look, ramp, CONFIG, 0)
    assert up.load_w * up.duration_s == pytest.approx(2400.0 + 700.0 * 0.9)
    descent = seen_as(look.points_m, height=lambda x, y: -math.floor(x) * 0.1)
    down = drive(piece, look, descent, CONFIG, 0)
    assert down.load_w * down.duration_s == pytest.approx(2400.0)


@pytest.mark.parametrize(
    ("to", "heading"), [((0, 1), 0.0), ((1, 0), 90.0), ((0, -1), 180.0), ((-1, 0), 270.0), ((-1e-300, 1), 0.0)]
)
def test_heading_is_clockwise_from_north(to, heading):
    assert heading_deg((0.0, 0.0), to) == heading


# --- holes --------------------------------------------------------------------------------------------------------


@given(st.floats(0.001, 3), st.floats(0.01, 1))
def test_bites_make_up_the_depth_and_none_is_deeper_than_a_bite(depth, bite):
    bites = bites_m(depth, bite)
    assert sum(bites) == pytest.approx(depth)
    assert all(0 < taken <= bite + 1e-8 for taken in bites)
    assert len(bites) in (math.ceil(depth / bite), math.ceil(depth / bite) - 1)


def test_a_depth_that_is_whole_bites_takes_no_sliver_more():
    assert len(bites_m(0.3, 0.1)) == 3
    assert len(bites_m(1.0, 0.1)) == 10


# --- rounds -------------------------------------------------------------------------------------------------------


def planned(path, *samples: tuple[float, float]) -> RoundPlan:
    return RoundPlan(
        round=1,
        path_m=tuple(path),
        samples=tuple(
            PlannedSample(sample_id=f"s{k}", x_m=x, y_m=y, depth_m=0.1) for k, (x, y) in enumerate(samples, 1)
        ),
        information_nats=0.0,
    )


def stops(plan: RoundPlan):
    legs = legs_of(plan)
    assert not isinstance(legs, str), legs
    return [(leg.way_m[-1] if leg.way_m else None, leg.sample and leg.sample.sample_id) for leg in legs]


def test_a_path_is_cut_at_its_samples_and_goes_on_to_its_end():
    plan = planned([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)], (5.0, 0.0), (10.0, 4.0))
    assert stops(plan) == [((5.0, 0.0), "s1"), ((10.0, 4.0), "s2"), ((10.0, 10.0), None)]


def test_a_sample_at_the_end_of_the_path_is_the_last_stop():
    assert stops(planned([(0.0, 0.0), (10.0, 0.0)], (10.0, 0.0)))[0] == ((10.0, 0.0), "s1")


def test_a_sample_at_the_beginning_of_the_path_is_taken_there():
    assert stops(planned([(0.0, 0.0), (10.0, 0.0)], (0.0, 0.0)))[0] == ((0.0, 0.0), "s1")


def test_a_path_of_one_place_can_hold_samples():
    assert stops(planned([(3.0, 3.0)], (3.0, 3.0), (3.0, 3.0))) == [((3.0, 3.0), "s1"), ((3.0, 3.0), "s2")]


def test_on_a_path_that_comes_back_the_samples_are_taken_in_their_order():
    there_and_back = [(0.0, 0.0), (10.0, 0.0), (0.0, 0.0)]
    legs = legs_of(planned(there_and_back, (8.0, 0.0), (2.0, 0.0)))
    assert not isinstance(legs, str)
    assert legs[1].way_m == ((10.0, 0.0), (2.0, 0.0))


def test_a_sample_off_the_path_is_named():
    assert "sample s1 within 0.5 m" in str(legs_of(planned([(0.0, 0.0), (10.0, 0.0)], (5.0, 0.6))))
    assert not isinstance(legs_of(planned([(0.0, 0.0), (10.0, 0.0)], (5.0, 0.4))), str)


def test_samples_against_the_order_of_the_path_are_named():
    assert "sample s2" in str(legs_of(planned([(0.0, 0.0), (10.0, 0.0)], (8.0, 0.0), (2.0, 0.0))))


@given(st.lists(places, min_size=2, max_size=8), st.lists(st.floats(0, 1), max_size=6))
def test_samples_anywhere_on_a_path_leave_its_length_as_it_is(path, shares):
    lengths = [0.0, *itertools.accumulate(math.dist(a, b) for a, b in itertools.pairwise(path))]
    samples = []
    for share in sorted(shares):
        s = share * lengths[-1]
        k = max(0, min(len(path) - 2, next(i for i, end in enumerate(lengths) if end >= s) - 1))
        step = lengths[k + 1] - lengths[k]
        part = (s - lengths[k]) / step if step else 0.0
        (ax, ay), (bx, by) = path[k], path[k + 1]
        samples.append((ax + part * (bx - ax), ay + part * (by - ay)))
    legs = legs_of(planned(path, *samples))
    assert not isinstance(legs, str), legs
    way = [vertex for leg in legs for vertex in leg.way_m]
    # A path that passes a sample twice may be left for it a little earlier, never by more than the tolerance.
    driven = sum(math.dist(a, b) for a, b in itertools.pairwise(way))
    assert abs(driven - lengths[-1]) <= 1.0 * len(samples) + 1e-6
    assert [leg.sample.sample_id for leg in legs if leg.sample] == [f"s{k + 1}" for k in range(len(samples))]


# --- the way home -------------------------------------------------------------------------------------------------


def on_track(place: tuple[float, float], track: list[tuple[float, float]]) -> bool:
    return any(squared_distance(place, a, b) < 1e-10 for a, b in itertools.pairwise(track))


def test_the_way_home_is_the_track_backwards():
    assert way_home([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)]) == ((10.0, 0.0), (0.0, 0.0))


def test_the_way_home_leaves_out_a_loop():
    track = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (5.0, 10.0), (5.0, -5.0)]
    assert way_home(track) == ((5.0, 0.0), (0.0, 0.0))


def test_the_way_home_leaves_out_a_dead_end():
    assert way_home([(0.0, 0.0), (5.0, 0.0), (5.0, 9.0), (5.0, 0.0), (9.0, 0.0)]) == ((5.0, 0.0), (0.0, 0.0))


def test_half_way_back_the_way_home_goes_on():
    assert way_home([(0.0, 0.0), (10.0, 0.0), (4.0, 0.0)]) == ((0.0, 0.0),)


def test_at_home_there_is_no_way():
    assert way_home([(3.0, 4.0)]) == ()
    assert way_home([(3.0, 4.0), (9.0, 4.0), (3.0, 4.0)]) == ()


@given(st.lists(places, min_size=2, max_size=25))
def test_the_way_home_lies_on_the_track_ends_at_its_beginning_and_is_no_longer(track):
    home = [track[-1], *way_home(track)]
    assert home[-1] == pytest.approx(track[0], abs=1e-6)
    for a, b in itertools.pairwise(home):
        for share in np.linspace(0, 1, 9):
            assert on_track((a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])), track)
    length = sum(math.dist(a, b) for a, b in itertools.pairwise(home))
    assert length <= sum(math.dist(a, b) for a, b in itertools.pairwise(track)) + 1e-6


# --- telecommands' stages -----------------------------------------------------------------------------------------


def command(command_id: str = "c1", kind: CommandKind = CommandKind.PAUSE) -> Telecommand:
    return Telecommand(command_id=command_id, kind=kind)


def made(at: int, sequence: int = 0) -> Header:
    return Header(mission="m", source="ground", incarnation=1, sequence=sequence, made_at=at)


STAGE_ORDERS = {
    (CommandStage.RECEIVED, CommandStage.REJECTED),
    (CommandStage.RECEIVED, CommandStage.EXPIRED),
    (CommandStage.RECEIVED, CommandStage.ACCEPTED, CommandStage.EXPIRED),
    (CommandStage.RECEIVED, CommandStage.ACCEPTED, CommandStage.FAILED),
    (CommandStage.RECEIVED, CommandStage.ACCEPTED, CommandStage.STARTED, CommandStage.COMPLETED),
    (CommandStage.RECEIVED, CommandStage.ACCEPTED, CommandStage.STARTED, CommandStage.FAILED),
}


def admits(stages: tuple[CommandStage, ...]) -> bool:
    table = CommandRegistry()
    try:
        for at, stage in enumerate(stages):
            table.passed(command(), stage, at)
    except IllegalStage:
        return False
    return True


def test_a_command_passes_its_stages_in_order_only():
    for length in (1, 2, 3, 4):
        for stages in itertools.product(CommandStage, repeat=length):
            assert admits(stages) is any(stages == order[:length] for order in STAGE_ORDERS)


def test_a_stage_out_of_order_is_refused_by_both_names():
    table = CommandRegistry()
    table.passed(command(), CommandStage.RECEIVED, 0)
    with pytest.raises(IllegalStage, match="command c1 is received and cannot be completed next"):
        table.passed(command(), CommandStage.COMPLETED, 1)


def test_a_command_made_before_one_of_the_same_matter_is_overtaken():
    table = CommandRegistry()
    assert table.overtaken(command("c2", CommandKind.RESUME), made(20)) is None
    assert "resume c2 was made later" in str(table.overtaken(command("c1"), made(10)))
    assert table.overtaken(command("c3"), made(20, sequence=1)) is None


def test_the_memory_of_commands_is_bounded_and_keeps_those_that_are_not_over(monkeypatch):
    monkeypatch.setattr("services.rover.command_registry.MAX_REMEMBERED", 3)
    table = CommandRegistry()
    table.passed(command("open"), CommandStage.RECEIVED, 0)
    for k in range(10):
        table.passed(command(f"c{k}"), CommandStage.RECEIVED, k)
        table.passed(command(f"c{k}"), CommandStage.REJECTED, k)
    assert table.reported(command("open")) is not None
    assert table.reported(command("c9")) is not None
    assert table.reported(command("c0")) is None
