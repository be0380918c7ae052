"""The ground's own map of where the rover may be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from he3.errors import InvalidInput, OutsideRegion
from he3.frames import SiteGrid
from services.ground.closed_ground import enclosure
from services.ground.planners.traversability import MOST_MARGIN
from services.ground.terrain import GroundTerrain, cells_inside, cells_touched, interest_weights

GRID = SiteGrid(40, 50)
ALL_OPEN = np.ones(GRID.shape, dtype=np.bool_)
TRIANGLE = ((10.0, 10.0), (30.0, 10.0), (20.0, 30.0))


def with_closed(*cells: tuple[int, int]) -> np.ndarray:
    open_cells = ALL_OPEN.copy()
    for cell in cells:
        open_cells[cell] = False
    return open_cells


def test_a_polygon_covers_half_of_what_a_triangle_of_its_base_and_height_would_have_as_a_box() -> None:
    assert cells_inside(GRID, TRIANGLE).sum() == pytest.approx(200, abs=10)
    assert cells_inside(GRID, TRIANGLE)[15, 20]
    assert not cells_inside(GRID, TRIANGLE)[28, 12]


def test_the_order_of_corners_does_not_matter_and_a_hole_is_left_by_the_even_odd_rule() -> None:
    assert np.array_equal(cells_inside(GRID, TRIANGLE), cells_inside(GRID, TRIANGLE[::-1]))
    bow_tie_twice = ((5.0, 5.0), (25.0, 5.0), (25.0, 25.0), (5.0, 25.0), (5.0, 5.0), (10.0, 10.0), (20.0, 10.0),
                     (20.0, 20.0), (10.0, 20.0), (10.0, 10.0))  # fmt: skip
    assert not cells_inside(GRID, bow_tie_twice)[15, 15]
    assert cells_inside(GRID, bow_tie_twice)[7, 15]


@pytest.mark.parametrize("far", [(450.0, 450.0), (700.0, 450.0), (352.5, 450.0), (449.9, 447.3)])
def test_areas_that_share_an_edge_share_no_cell_and_leave_none_between_them(far: tuple[float, float]) -> None:
    grid = SiteGrid(90, 140, 5.0)
    west = cells_inside(grid, ((0.0, 0.0), far, (0.0, 450.0)))
    east = cells_inside(grid, ((0.0, 0.0), (700.0, 0.0), far))
    whole = cells_inside(grid, ((0.0, 0.0), (700.0, 0.0), far, (0.0, 450.0)))
    assert not (west & east).any()
    assert np.array_equal(west | east, whole)


def test_an_area_too_thin_to_hold_a_cell_centre_still_closes_the_cells_it_crosses() -> None:
    sliver = ((5.0, 8.1), (30.0, 8.1), (30.0, 8.2))
    assert not cells_inside(GRID, sliver).any()
    assert cells_touched(GRID, sliver)[8, 5:30].all()


def test_an_area_partly_or_wholly_outside_the_region_closes_its_part_within() -> None:
    assert cells_touched(GRID, ((40.0, 30.0), (90.0, 30.0), (90.0, 90.0), (40.0, 90.0)))[35, 45]
    assert not cells_touched(GRID, ((60.0, 60.0), (90.0, 60.0), (90.0, 90.0))).any()


@settings(max_examples=60)
@given(
    radius=st.floats(MOST_MARGIN + 0.01, 3.0),
    angle=st.floats(0.0, 2 * np.pi),
    x=st.floats(12.0, 28.0),
    y=st.floats(12.0, 28.0),
)
def test_the_whole_footprint_is_on_open_ground_wherever_the_centre_may_be(
    radius: float, angle: float, x: float, y: float
) -> None:
    closed = with_closed((20, 20), (20, 21), (23, 14))
    terrain = GroundTerrain(GRID, closed, radius)
    if terrain.traversable[int(y), int(x)]:
        for share in (1.0, 0.5):
            rim_x, rim_y = x + share * radius * np.cos(angle), y + share * radius * np.sin(angle)
            assert closed[int(rim_y), int(rim_x)]


def test_on_cells_much_larger_than_the_rover_those_beside_closed_ones_stay_open_and_legs_keep_its_radius() -> None:
    closed = with_closed((5, 5), (20, 20))
    closed[30], closed[30, 17] = False, True
    grid = SiteGrid(*GRID.shape, 99.0)
    terrain = GroundTerrain(grid, closed, 0.8)
    assert np.array_equal(terrain.traversable, closed)
    ground = terrain.for_legs()
    assert ground.connected_to((50.0, 50.0)).sum() == closed.sum()  # through the passage of one cell, too
    along_m, edge_m = np.array([[300.0], [700.0]]), 6 * 99.0
    for away_m, free in ((0.7, False), (0.9, True)):
        begin, end = np.hstack((along_m, np.full((2, 1), edge_m + away_m)))[:, None]
        assert ground.segments_free(begin, end).tolist() == [free]


def test_a_rover_without_extent_may_be_wherever_the_ground_is_open() -> None:
    closed = with_closed((5, 5))
    assert np.array_equal(GroundTerrain(GRID, closed, 0.0).traversable, closed)


def test_a_keep_out_is_replaced_under_its_id_and_removed_without_a_polygon() -> None:
    terrain = GroundTerrain(GRID, ALL_OPEN, 0.0)
    corner = ((40.0, 2.0), (45.0, 2.0), (45.0, 6.0))
    assert terrain.set_keep_out("a", [TRIANGLE])
    assert not terrain.traversable[15, 20]
    assert terrain.set_keep_out("a", [TRIANGLE, corner])
    assert not terrain.traversable[15, 20]
    assert not terrain.traversable[3, 44]
    assert terrain.outlines == {"a": (TRIANGLE, corner)}
    assert not terrain.set_keep_out("a", [corner])
    assert terrain.traversable[15, 20]
    assert not terrain.traversable[3, 44]
    assert not terrain.set_keep_out("a", [])
    assert terrain.traversable.all()
    assert not terrain.areas
    assert not terrain.outlines


def test_a_keep_out_set_again_leaves_the_same_map_object() -> None:
    terrain = GroundTerrain(GRID, ALL_OPEN, 0.0, {"scenario-1": TRIANGLE})
    before = terrain.traversable
    assert not terrain.set_keep_out("scenario-1", [TRIANGLE])
    assert terrain.traversable is before
    assert terrain.outlines == {"scenario-1": (TRIANGLE,)}


def test_keep_outs_of_the_scenario_are_closed_from_the_beginning() -> None:
    assert not GroundTerrain(GRID, ALL_OPEN, 0.0, {"a": TRIANGLE}).traversable[15, 20]


def test_an_obstacle_closes_its_disc_and_at_least_its_own_cell() -> None:
    terrain = GroundTerrain(GRID, ALL_OPEN, 0.0)
    terrain.block((20.2, 10.9), 0.0)
    assert np.argwhere(~terrain.traversable).tolist() == [[10, 20]]
    terrain.block((20.5, 10.5), 2.0)
    assert (~terrain.traversable).sum() == 13


def test_a_mask_once_returned_is_read_only_and_never_changes() -> None:
    terrain = GroundTerrain(GRID, ALL_OPEN, 0.8)
    before = terrain.traversable
    terrain.block((20.0, 20.0), 1.0)
    assert before.all()
    assert not terrain.traversable.all()
    with pytest.raises(ValueError, match="read-only"):
        before[0, 0] = False


def test_a_rover_beside_an_obstacle_may_leave_but_not_through_the_obstacle() -> None:
    terrain = GroundTerrain(GRID, ALL_OPEN, 0.8)
    terrain.block((20.5, 20.5), 1.5)
    here = (18.5, 20.5)
    assert not terrain.traversable[20, 18]
    lent = terrain.open_from(here)
    assert lent[20, 18]
    assert lent[20, 16]
    assert not lent[20, 20]
    assert (lent & ~terrain.traversable).sum() < 12


def test_an_obstacle_is_closed_behind_the_place_where_it_was_met() -> None:
    terrain = GroundTerrain(GRID, ALL_OPEN, 0.0)
    terrain.block((20.5, 20.5), 3.0, seen_from_m=(15.5, 20.5))
    closed = ~terrain.traversable
    assert closed[20, 20:26].all()
    assert not closed[20, :20].any()


def test_a_rover_that_came_by_a_narrow_way_goes_back_over_it_to_the_first_open_ground() -> None:
    open_cells = ALL_OPEN.copy()
    open_cells[:, 10:30] = False
    open_cells[20, 10:30] = True  # a gap one cell wide, too narrow for the footprint: but it was driven
    terrain = GroundTerrain(GRID, open_cells, 0.8)
    here, track = (25.5, 20.5), ((5.5, 20.5), (15.5, 20.5), (25.5, 20.5))
    back = terrain.way_back(here, track)
    assert back is not None
    assert np.array_equal(back[:2], [here, (15.5, 20.5)])
    assert (back[:, 1] == 20.5).all()
    assert 8.0 < back[-1, 0] < 9.0  # the footprint reaches from there to the last open cell before the gap
    assert terrain.open_from(here)[20, 27]  # the nearest way out is the other one
    assert terrain.way_back(here, ((5.5, 20.5), (9.5, 20.5))) is None  # it is not known to have come by there
    assert terrain.way_back((5.5, 20.5), track[::-1]) is None  # it is on open ground


def bay_that_is_entered_by_its_mouth() -> np.ndarray:
    """A bay of 9 x 9 cells in closed ground, with a mouth three cells wide to the west."""
    open_cells = ALL_OPEN.copy()
    open_cells[10:30, 15:] = False
    open_cells[16:25, 20:29] = True
    open_cells[19:22, 15:20] = True
    return open_cells


TRACK_INTO_THE_BAY = ((5.5, 20.5), (24.5, 20.5))


def test_a_rover_in_a_bay_whose_mouth_an_obstacle_closed_may_go_back_the_way_it_came() -> None:
    terrain = GroundTerrain(GRID, bay_that_is_entered_by_its_mouth(), 0.8)
    terrain.block((17.5, 19.5), 0.4)  # beside the driven way, and nearer to it than the map's margin
    here = TRACK_INTO_THE_BAY[-1]
    assert terrain.traversable[20, 24]
    assert not terrain.traversable[20, 17]
    back = terrain.way_back(here, TRACK_INTO_THE_BAY)
    assert back is not None
    assert np.array_equal(back[0], here)
    assert (back[:, 1] == 20.5).all()
    assert back[-1, 0] < 16.5
    assert terrain.way_back(here, ()) is None
    assert terrain.way_back((5.5, 20.5), TRACK_INTO_THE_BAY[::-1]) is None  # it stands outside


def test_a_rover_that_a_keep_out_confines_stays_where_it_is() -> None:
    terrain = GroundTerrain(GRID, bay_that_is_entered_by_its_mouth(), 0.8)
    terrain.set_keep_out("gate", [((15.0, 18.0), (18.0, 18.0), (18.0, 23.0), (15.0, 23.0))])
    assert terrain.traversable[20, 24]
    assert terrain.way_back(TRACK_INTO_THE_BAY[-1], TRACK_INTO_THE_BAY) is None


def test_a_rover_within_an_area_just_closed_may_leave_it() -> None:
    terrain = GroundTerrain(GRID, ALL_OPEN, 0.8, {"a": ((10.0, 10.0), (20.0, 10.0), (20.0, 20.0), (10.0, 20.0))})
    lent = terrain.open_from((12.0, 15.0))
    assert lent[15, 12]
    assert not lent[15, 18]
    from scipy import ndimage

    labels, _ = ndimage.label(lent)
    assert labels[15, 12] == labels[35, 45]


def test_no_cell_is_opened_for_a_rover_that_stands_on_open_ground() -> None:
    terrain = GroundTerrain(GRID, with_closed((5, 5)), 0.8)
    assert terrain.open_from((30.0, 30.0)) is terrain.traversable


def test_a_place_outside_the_region_is_refused() -> None:
    with pytest.raises(OutsideRegion):
        GroundTerrain(GRID, ALL_OPEN, 0.8).open_from((51.0, 3.0))


def test_a_mask_of_another_shape_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"expected open cells of shape \(40, 50\), got \(3, 3\)"):
        GroundTerrain(GRID, np.ones((3, 3), dtype=np.bool_))


def test_interest_is_one_everywhere_but_in_its_regions_and_the_last_of_them_counts() -> None:
    assert interest_weights(GRID, []) is None
    box = ((0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0))
    weights = interest_weights(GRID, [(box, 3.0), (TRIANGLE, 0.5)])
    assert weights is not None
    assert (weights[2, 2], weights[12, 18], weights[35, 35]) == (3.0, 0.5, 1.0)


def test_a_start_on_ground_that_the_region_closes_is_named_with_the_nearest_open_place() -> None:
    hollow = ALL_OPEN.copy()
    hollow[10:20, 10:20] = False
    terrain = GroundTerrain(GRID, hollow, 0.0)
    x, y = 12.5 * GRID.resolution_m, 14.5 * GRID.resolution_m
    said = enclosure(terrain, (x, y))
    assert said == (
        f"the start ({x:g}, {y:g}) m is on closed ground, which the rover may be unable to leave; the nearest open "
        f"ground is at ({9.5 * GRID.resolution_m:g}, {y:g}) m"
    )
    terrain.set_keep_out("a", [[(0.0, 0.0), (5.0, 0.0), (5.0, 5.0), (0.0, 5.0)]])
    assert enclosure(terrain, (2.0, 2.0)) == ""


def test_a_start_from_which_little_can_be_reached_is_named_with_a_better_one() -> None:
    walled = ALL_OPEN.copy()
    walled[:, 10] = False  # 400 cells to the west of the wall, 1560 to the east
    assert enclosure(GroundTerrain(GRID, walled), (20.0, 20.0)) == ""
    said = enclosure(GroundTerrain(GRID, walled), (5.0, 20.0))
    assert said == (
        "from the start (5, 20) m only 20.4% of the open ground can be reached; from (11.5, 19.5) m it is 79.6%"
    )
    pieces = ALL_OPEN.copy()
    pieces[::4] = False  # ten strips alike, of three rows each
    said = enclosure(GroundTerrain(GRID, pieces), (5.0, 6.0))
    assert said.endswith(
        "only 10.0% of the open ground can be reached, the largest of 10 parts that closed ground keeps apart"
    )
