"""Open ground: a leg is free when every cell it touches is traversable, checked against exact rational geometry."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from he3.errors import InvalidInput, NoRoute, OutsideRegion
from he3.frames import SiteGrid, path_length
from services.ground.planners.routes import RouteFinder, shortened_path
from services.ground.planners.tour.paths import shortest_path
from services.ground.planners.traversability import MOST_MARGIN, TOUCH, OpenGround

SIZE = 7
BITS = 1 << np.arange(SIZE * SIZE, dtype=np.int64)
masks = st.integers(0, 2 ** (SIZE * SIZE) - 1).map(lambda bits: ((bits & BITS) != 0).reshape(SIZE, SIZE))
sparse_masks = st.sets(st.tuples(st.integers(0, SIZE - 1), st.integers(0, SIZE - 1)), max_size=4).map(
    lambda closed: np.array([[(r, c) not in closed for c in range(SIZE)] for r in range(SIZE)])
)
coordinates = st.one_of(
    st.floats(0, SIZE, allow_nan=False), st.integers(0, 2 * SIZE).map(lambda n: n / 2), st.floats(-0.5, SIZE + 0.5)
)
places = st.tuples(coordinates, coordinates)


def meets(a, b, row, column, grown):
    """Whether the leg from a to b meets the closed square of the cell, grown on all sides: exact (Liang and Barsky)."""
    low, high = Fraction(0), Fraction(1)
    for axis, cell in ((0, column), (1, row)):
        begin, step = Fraction(a[axis]), Fraction(b[axis]) - Fraction(a[axis])
        near, far = cell - Fraction(grown), cell + 1 + Fraction(grown)
        if step == 0:
            if not near <= begin <= far:
                return False
            continue
        first, second = sorted(((near - begin) / step, (far - begin) / step))
        low, high = max(low, first), min(high, second)
    return low <= high


@settings(max_examples=400)
@given(st.one_of(masks, sparse_masks), places, places, st.one_of(st.just(0.0), st.floats(0.0, MOST_MARGIN)))
@example(np.eye(SIZE, dtype=bool)[::-1] ^ True, (0.0, 0.0), (7.0, 7.0), 0.0)
@example(~np.eye(SIZE, dtype=bool), (0.5, 2.5), (2.5, 0.5), 0.0)
@example(np.ones((SIZE, SIZE), dtype=bool), (0.0, 0.0), (7.0, 7.0), MOST_MARGIN)
def test_a_leg_is_free_exactly_when_every_cell_that_it_touches_or_is_too_near_to_is_traversable(mask, a, b, margin):
    ground = OpenGround(SiteGrid(SIZE, SIZE), mask, margin)
    answer = bool(ground.segments_free(np.array([a]), np.array([b]))[0])
    inside = all(-0.5 * TOUCH <= v <= SIZE + 0.5 * TOUCH for v in (*a, *b))
    closed = [tuple(cell) for cell in np.argwhere(~mask).tolist()]
    if not inside or any(meets(a, b, r, c, margin) for r, c in closed):
        assert not answer
    elif not any(meets(a, b, r, c, margin + 3 * TOUCH) for r, c in closed):
        assert answer


@settings(max_examples=120)
@given(st.one_of(masks, sparse_masks), places, places, st.sampled_from([0.5, 1.0, 3.0]), st.sampled_from([0.0, 0.09]))
def test_one_leg_at_a_time_is_judged_as_many_are_and_alike_from_both_ends(mask, a, b, resolution, margin_m):
    ground = OpenGround(SiteGrid(SIZE, SIZE, resolution), mask, margin_m)
    a, b = np.array(a) * resolution, np.array(b) * resolution
    check = ground.segment_check()
    many = ground.segments_free(np.array([a, b]), np.array([b, a]))
    assert check(*a, *b) == check(*b, *a) == many[0] == many[1]


def test_a_leg_does_not_slip_between_two_closed_cells_that_meet_at_a_corner():
    mask = np.ones((4, 4), dtype=bool)
    mask[1, 2] = mask[2, 1] = False
    ground = OpenGround(SiteGrid(4, 4), mask)
    assert not ground.segments_free(np.array([[1.5, 1.5]]), np.array([[2.5, 2.5]]))[0]


def test_long_legs_over_a_large_field_agree_with_dense_sampling():
    rng = np.random.default_rng(3)
    mask = rng.random((200, 300)) > 0.002
    grid = SiteGrid(200, 300)
    ground = OpenGround(grid, mask)
    a = rng.uniform(0, 1, (500, 2)) * (300, 200)
    b = rng.uniform(0, 1, (500, 2)) * (300, 200)
    free = ground.segments_free(a, b)
    along = np.linspace(0, 1, 20001)[:, None]
    for i in range(len(a)):
        rows, columns = grid.cells_of(a[i] + along * (b[i] - a[i]))
        hits = not mask[rows, columns].all()
        assert not (hits and free[i])
        if not hits and not free[i]:  # it only grazed a cell between two of the sampled places
            near = np.array([mask[max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2].all() for r, c in zip(rows, columns)])  # noqa: B905
            assert not near.all()
    assert 50 < free.sum() < 450


def test_a_rover_in_a_closed_cell_is_told_that_it_cannot_move():
    mask = np.ones((10, 10), dtype=bool)
    mask[4, 4] = False
    ground = OpenGround(SiteGrid(10, 10), mask)
    with pytest.raises(NoRoute, match=r"may not cross: \(4.5, 4.5\)"):
        ground.footing((4.5, 4.5))
    with pytest.raises(OutsideRegion):
        ground.footing((10.5, 4.5))


def test_a_rover_on_the_edge_of_a_closed_cell_first_drives_to_the_centre_of_its_own():
    mask = np.ones((10, 10), dtype=bool)
    mask[4, 4] = False
    ground = OpenGround(SiteGrid(10, 10), mask)
    assert ground.footing((5.0, 4.2)) == (5.5, 4.5)
    assert ground.footing((6.0, 6.0)) == (6.0, 6.0)


@pytest.mark.parametrize("margin_m", [-0.1, 0.21, float("nan")])
def test_a_margin_of_more_than_a_fifth_of_a_cell_is_refused(margin_m):
    with pytest.raises(InvalidInput, match=r"margin of 0 to 0\.2 cells of 1 m, got"):
        OpenGround(SiteGrid(4, 5), np.ones((4, 5), dtype=bool), margin_m)


def test_a_mask_of_another_shape_is_refused():
    with pytest.raises(InvalidInput, match=r"\(4, 5\), got \(5, 4\)"):
        OpenGround(SiteGrid(4, 5), np.ones((5, 4), dtype=bool))


@settings(max_examples=60)
@given(masks, st.integers(0, SIZE * SIZE - 1), st.integers(0, SIZE * SIZE - 1))
def test_a_route_is_found_exactly_when_open_cells_connect_the_places(mask, i, j):
    begin, end = (divmod(k, SIZE) for k in (i, j))
    mask[begin] = True
    ground = OpenGround(SiteGrid(SIZE, SIZE), mask)
    a, b = (begin[1] + 0.5, begin[0] + 0.5), (end[1] + 0.5, end[0] + 0.5)
    if ground.connected_to(a)[end]:
        route = RouteFinder(ground).route(a, b)
        assert ground.segments_free(route[:-1], route[1:]).all()
        assert route[0].tolist() == list(a)
        assert route[-1].tolist() == list(b)
        assert path_length(route) <= RouteFinder(ground).distances_from(a)[end] + 1e-9
    else:
        with pytest.raises(NoRoute):
            RouteFinder(ground).route(a, b)


def test_a_route_around_a_wall_is_nearly_as_short_as_geometry_allows():
    mask = np.ones((100, 100), dtype=bool)
    mask[:80, 50] = False
    ground = OpenGround(SiteGrid(100, 100), mask)
    route = RouteFinder(ground).route((10.5, 20.5), (90.5, 20.5))
    shortest = np.hypot(39.5, 59.5) + 1.0 + np.hypot(39.5, 59.5)
    assert ground.segments_free(route[:-1], route[1:]).all()
    assert shortest <= path_length(route) < 1.02 * shortest


def test_shortening_a_route_never_makes_it_longer():
    rng = np.random.default_rng(0)
    ground = OpenGround(SiteGrid(60, 60), rng.random((60, 60)) > 0.1)
    cells = np.argwhere(ground.connected_to((30.5, 30.5)) if ground.open[30, 30] else ground.open)
    routes = RouteFinder(ground)
    for _ in range(20):
        a, b = (tuple((cells[k][::-1] + 0.5).tolist()) for k in rng.integers(0, len(cells), 2))
        if np.isfinite(routes.distances_from(a)[int(b[1]), int(b[0])]):
            route = routes.route(a, b)
            assert path_length(shortened_path(ground, route)) <= path_length(route) + 1e-9


@settings(max_examples=300)
@given(
    st.integers(2, 400), st.integers(2, 400), st.floats(0.01, 500.0), st.lists(st.floats(0, 1), min_size=3, max_size=3)
)
@example(13, 25, 214.023094, (0.2, 0.5, 0.9))
def test_places_on_the_far_edges_of_a_site_are_on_it_whatever_the_size_of_its_cells(rows, columns, cell_m, shares):
    """Rounding puts some of them, divided by the cells' size or seen from another corner, beyond the last cell."""
    grid = SiteGrid(rows, columns, cell_m)
    ground = OpenGround(grid, np.ones(grid.shape, dtype=bool))
    width, height = grid.width_m, grid.height_m
    along = np.array([[width, share * height] for share in shares] + [[share * width, height] for share in shares])
    along = np.vstack((along, [[width, height]]))
    assert grid.contains(along).all()
    assert ground.is_open(along).all()
    begins, ends = np.repeat(along, len(along), axis=0), np.tile(along, (len(along), 1))
    assert ground.segments_free(begins, ends).all()
    one = ground.segment_check()
    assert all(one(*begin, *end) for begin, end in zip(begins.tolist(), ends.tolist(), strict=True))
    for begin, end in zip(begins[::5], ends[::5], strict=True):
        np.testing.assert_array_equal(shortest_path(ground, begin, end), [begin, end])


def test_a_way_along_the_far_edge_of_a_site_leads_round_what_is_closed_there():
    rng = np.random.default_rng(1)
    for _ in range(60):
        grid = SiteGrid(*(int(n) for n in rng.integers(60, 90, 2)), float(rng.uniform(0.1, 300.0)))
        mask = np.ones(grid.shape, dtype=bool)
        mask[grid.rows // 2, -4:] = False
        ends = np.array([[grid.width_m, share * grid.height_m] for share in (0.45, 0.55)])
        path = shortest_path(OpenGround(grid, mask), *ends)
        np.testing.assert_array_equal(path[[0, -1]], ends)
        assert len(path) > 2
