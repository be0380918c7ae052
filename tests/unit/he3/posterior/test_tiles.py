"""Every cell of a grid is in one tile, and values survive reordering by tile and back."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from he3.frames import SiteGrid
from he3.posterior.tiles import TILE_EDGE, TiledGrid

lengths = st.integers(1, 60)


@given(lengths, lengths, st.integers(1, 40))
def test_every_cell_is_in_one_tile_and_no_edge_is_too_long(rows: int, columns: int, edge: int) -> None:
    tiled = TiledGrid(SiteGrid(rows, columns, 2.0), edge)
    seen = np.zeros((rows, columns), dtype=int)
    follows = 0
    for number, tile in enumerate(tiled.tiles):
        seen[tile.rows, tile.columns] += 1
        assert tile.number == number
        assert tile.cells == slice(follows, follows + tile.size)
        assert max(tile.shape) <= edge
        follows = tile.cells.stop
    assert (seen == 1).all()
    assert follows == tiled.cells == rows * columns


@given(lengths, lengths, st.integers(1, 40))
def test_values_in_tile_order_are_those_of_the_grid(rows: int, columns: int, edge: int) -> None:
    tiled = TiledGrid(SiteGrid(rows, columns), edge)
    values = np.arange(rows * columns)
    ordered = tiled.in_tile_order(values)
    np.testing.assert_array_equal(tiled.on_grid(ordered), values.reshape(rows, columns))
    for tile in tiled.tiles:
        np.testing.assert_array_equal(
            ordered[tile.cells].reshape(tile.shape), values.reshape(rows, columns)[tile.rows, tile.columns]
        )
    points = tiled.in_tile_order(tiled.grid.points())
    np.testing.assert_array_equal(tiled.on_grid(points[:, 1]), tiled.grid.points()[:, 1].reshape(rows, columns))


@given(lengths, lengths, st.integers(1, 500))
def test_parts_are_whole_rows_of_a_tile_one_after_the_other(rows: int, columns: int, cells: int) -> None:
    (tile,) = TiledGrid(SiteGrid(rows, columns), 60).tiles
    parts = list(tile.parts(cells))
    assert parts[0].cells.start == tile.cells.start
    assert parts[-1].cells.stop == tile.cells.stop
    for part, following in pairwise(parts):
        assert (part.cells.stop, part.rows.stop) == (following.cells.start, following.rows.start)
    for part in parts:
        assert (part.number, part.columns) == (tile.number, tile.columns)
        assert part.cells.stop - part.cells.start == part.size <= max(cells, columns)


@given(lengths, lengths, st.integers(1, 40), st.floats(-50, 200), st.floats(-50, 200))
def test_the_tile_near_a_place_holds_the_cell_nearest_to_it(
    rows: int, columns: int, edge: int, x: float, y: float
) -> None:
    tiled = TiledGrid(SiteGrid(rows, columns, 2.0), edge)
    tile = tiled.tile_near(np.array([x, y]))
    row = min(max(int(np.floor(y / 2.0)), 0), rows - 1)
    column = min(max(int(np.floor(x / 2.0)), 0), columns - 1)
    assert tile.rows.start <= row < tile.rows.stop
    assert tile.columns.start <= column < tile.columns.stop


def test_a_site_smaller_than_a_tile_is_one_tile() -> None:
    assert len(TiledGrid(SiteGrid(TILE_EDGE, 3)).tiles) == 1
    assert len(TiledGrid(SiteGrid(TILE_EDGE + 1, 3)).tiles) == 2
