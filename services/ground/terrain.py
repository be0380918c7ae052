"""The ground's map of where the rover's centre may be: orbital terrain less keep-outs and obstacles met.

The rover has a width. On small cells, those that it might touch a closed one from are closed, too. On cells of which it
covers little, that would close a hundred metres for a rover of less than two, and every passage of one cell; there legs
keep its radius from closed cells instead (``margin_m``).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from math import ceil, hypot
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from he3.errors import InvalidInput
from he3.polygons import outline_objection
from services.ground.planners.traversability import MOST_MARGIN, OpenGround, open_ground

if TYPE_CHECKING:
    from he3.frames import BoolArray, FloatArray, Place, SiteGrid
    from services.runtime.node import SavedState

Outline = tuple["Place", ...]
"""Corners of a polygon [m]."""

_BOUNDARY_STEP_CELLS = 0.25  # step along a polygon's edge; it can miss only the corner of a cell
BESIDE_TRACK_M = 2.5  # distance from the end of its known track within which the rover is taken to stand on it
_FLAT_M = 1e-6  # distance from a line within which corners count as lying on it


class GroundTerrain:
    """The ground's own map of where the rover may go; keep-outs and obstacles are added as they become known."""

    def __init__(
        self,
        grid: SiteGrid,
        open_cells: BoolArray,
        footprint_radius_m: float = 0.0,
        keep_outs: Mapping[str, Sequence[Place]] | None = None,
    ) -> None:
        if open_cells.shape != grid.shape:
            raise InvalidInput(f"terrain: expected open cells of shape {grid.shape}, got {open_cells.shape}")
        self.grid = grid
        self._orbital = np.array(open_cells, dtype=np.bool_)
        narrow = footprint_radius_m <= MOST_MARGIN * grid.resolution_m
        self.margin_m = footprint_radius_m if narrow else 0.0
        """Distance that legs are to keep from closed cells [m]; 0 where ``traversable`` allows for the footprint."""
        self._footprint = _footprint(0.0 if narrow else footprint_radius_m / grid.resolution_m)
        self._areas: dict[str, BoolArray] = {
            area_id: cells_touched(grid, polygon) for area_id, polygon in (keep_outs or {}).items()
        }
        self._outlines: dict[str, tuple[Outline, ...]] = {
            area_id: (tuple(polygon),) for area_id, polygon in (keep_outs or {}).items()
        }
        self._obstacles: dict[tuple[float, float, float], BoolArray] = {}
        self._met = np.zeros_like(self._orbital)
        self._bare: BoolArray = self._orbital
        self._open: BoolArray = self._orbital
        self._recompute()

    @property
    def traversable(self) -> BoolArray:
        """(rows, columns), read-only: cells in which the rover's centre may be, its footprint allowed for.

        With a ``margin_m``, legs over them must keep that distance from the others.
        """
        return self._open

    def for_legs(self) -> OpenGround:
        """The open ground, prepared for checks of legs."""
        return open_ground(self.grid, self._open, self.margin_m)

    @property
    def areas(self) -> Mapping[str, BoolArray]:
        """The cells of each keep-out area in force, by its id."""
        return self._areas

    @property
    def outlines(self) -> Mapping[str, tuple[Outline, ...]]:
        """The polygons [m] of each keep-out area in force, by its id."""
        return self._outlines

    def set_keep_out(self, area_id: str, polygons_m: Iterable[Sequence[Place]]) -> bool:
        """Close the cells that any of the polygons covers, in place of those that the id closed before.

        Returns whether any open cell was closed. Without a polygon the area is open again.
        """
        before = self._areas.pop(area_id, np.zeros_like(self._orbital))
        area = np.zeros_like(self._orbital)
        self._outlines.pop(area_id, None)
        outlines: tuple[Outline, ...] = tuple(tuple(polygon) for polygon in polygons_m)
        for polygon in outlines:
            area |= cells_touched(self.grid, polygon)
        if area.any():
            self._areas[area_id], self._outlines[area_id] = area, outlines
        if not np.array_equal(area, before):
            self._recompute()
        return bool((area & ~before).any())

    def block(self, met_m: Place, radius_m: float, seen_from_m: Place | None = None) -> None:
        """Close a disc at an obstacle that was met: it begins there and lies behind it, as seen by the rover.

        Without `seen_from_m` the disc is centred on the place.
        """
        self._met[cell_of(self.grid, met_m)] = True
        centre = met_m
        if seen_from_m is not None and (away := hypot(met_m[0] - seen_from_m[0], met_m[1] - seen_from_m[1])) > 0.0:
            centre = (
                met_m[0] + (met_m[0] - seen_from_m[0]) / away * radius_m,
                met_m[1] + (met_m[1] - seen_from_m[1]) / away * radius_m,
            )
        self._obstacles[(*centre, radius_m)] = within(self.grid, centre, radius_m)
        self._recompute()

    def objection_to_drive(self, start_m: Place, target_m: Place) -> str | None:
        """One line on which closed ground the straight way to the target leads over; None if it is open, or off site.

        The rover may stand where its centre should not be; ground is closed to it once it has been on open ground.
        """
        if not self.grid.contains(np.array([target_m]))[0]:
            return None  # the command's own check says so
        if not self._open[cell_of(self.grid, target_m)]:
            x, y = target_m
            return f"expected a target on open ground, got ({x:g}, {y:g}) m, which the map knows as closed"
        been_on_open = False
        for place in along((start_m, target_m), _BOUNDARY_STEP_CELLS * self.grid.resolution_m):
            is_open = bool(self._open[cell_of(self.grid, place)])
            if been_on_open and not is_open:
                return (
                    f"expected open ground on the straight way from ({start_m[0]:.1f}, {start_m[1]:.1f}) m, where the "
                    f"rover was last heard of, got closed ground at ({place[0]:.1f}, {place[1]:.1f}) m"
                )
            been_on_open = been_on_open or is_open
        return None

    def closed_on(self, path_m: Sequence[Place]) -> int:
        """How many closed cells the polyline leads over."""
        step_m = _BOUNDARY_STEP_CELLS * self.grid.resolution_m
        on_site = np.array(list(along(path_m, step_m)), dtype=np.float64)
        on_site = on_site[self.grid.contains(on_site)]
        if not len(on_site):
            return 0
        rows, columns = self.grid.cells_of(on_site)
        cells = np.unique(np.column_stack((rows, columns)), axis=0)
        return int((~self._open[cells[:, 0], cells[:, 1]]).sum())

    def open_in_region(self, place_m: Place) -> bool:
        """Whether the region is open at the place, whatever obstacles and keep-outs close."""
        return bool(self._orbital[cell_of(self.grid, place_m)])

    def open_from(self, start_m: Place) -> BoolArray:
        """(rows, columns), read-only: where the rover may go from the place where it stands.

        A rover may stand where its centre should not be: beside an obstacle that it met, or in an area just closed.
        Then cells are opened for it to leave: cells that are open without the margin of its footprint, then those that
        only an obstacle closed, up to the nearest place from which it can continue.
        """
        cell = cell_of(self.grid, start_m)
        if self._open[cell]:
            return self._open
        way_out: BoolArray | None = None
        for lent in (self._bare, self._orbital & ~self._met, self._orbital, np.ones_like(self._orbital)):
            if way_out is None and lent[cell]:
                way_out = self._nearest_way_out(start_m, lent)
        if way_out is None:
            return self._open
        way_out.setflags(write=False)
        return way_out

    def way_back(self, start_m: Place, came_by_m: Sequence[Place]) -> FloatArray | None:
        """The way (k, 2) [m] back along the driven polyline from where the rover stands to where it may go on.

        The rover has scanned and driven that way, so it leads past every obstacle that it met since. It is needed where
        the rover stands on closed ground: it ends on the first open ground. It is needed, too, on open ground that an
        obstacle, met behind the rover, cut off: it ends on a larger part of the open ground, unless it leads through a
        keep-out, which may be there to confine the rover. None where it is not needed, or where there is none: the
        polyline does not end at the rover, or leads nowhere.
        """
        if not came_by_m or hypot(came_by_m[-1][0] - start_m[0], came_by_m[-1][1] - start_m[1]) > BESIDE_TRACK_M:
            return None
        cell = cell_of(self.grid, start_m)
        if not self._open[cell]:
            return self._back_to(self._open, start_m, came_by_m, np.zeros_like(self._open))
        labels, parts = ndimage.label(self._open)
        if parts == 1:
            return None
        sizes = np.bincount(labels.ravel(), minlength=parts + 1)
        sizes[0] = 0
        kept_out = np.zeros_like(self._open)
        for area in self._areas.values():
            kept_out |= area
        return self._back_to(sizes[labels] > sizes[labels[cell]], start_m, came_by_m, kept_out)

    def _back_to(
        self, to: BoolArray, start_m: Place, came_by_m: Sequence[Place], kept_out: BoolArray
    ) -> FloatArray | None:
        """The way (k, 2) [m] back to the first of the cells `to`, unless it leads off the site or into `kept_out`."""
        way = [start_m]
        for begin, end in pairwise((start_m, *reversed(came_by_m))):
            for place in along((begin, end), _BOUNDARY_STEP_CELLS * self.grid.resolution_m):
                if not self.grid.contains(np.array([place]))[0]:
                    return None
                cell = cell_of(self.grid, place)
                if to[cell]:
                    return np.array([*way, place] if place != way[-1] else way, dtype=np.float64)
                if kept_out[cell]:
                    return None
            if end != way[-1]:
                way.append(end)
        return None

    def _nearest_way_out(self, start_m: Place, lent: BoolArray) -> BoolArray | None:
        """The open cells and the nearest of the lent ones that join the start to them; None if they lead to none."""
        if not self._open.any():
            return None
        x, y = np.meshgrid(self.grid.x_m, self.grid.y_m)
        away = np.hypot(x - start_m[0], y - start_m[1])
        cell = cell_of(self.grid, start_m)
        radius = float(away[self._open].min()) + self.grid.resolution_m
        while radius < 2.0 * max(self.grid.width_m, self.grid.height_m):
            joined = self._open | (lent & (away <= radius))
            labels, _ = ndimage.label(joined)
            if bool((self._open & (labels == labels[cell])).any()):
                return joined
            radius *= 1.5
        return None

    def _recompute(self) -> None:
        bare = self._orbital.copy()
        for closed in (*self._areas.values(), *self._obstacles.values(), self._met):
            bare &= ~closed
        self._bare = bare
        self._open = ~ndimage.binary_dilation(~bare, structure=self._footprint) if self._footprint.size > 1 else bare
        self._open.setflags(write=False)

    # --- checkpoints ------------------------------------------------------------------------------------------------

    def checkpoint(self) -> SavedState:
        """All closures that are not part of the region, as named parts."""
        return {
            "areas": dict(self._areas),
            "outlines": dict(self._outlines),
            "obstacles": dict(self._obstacles),
            "met": self._met,
            "bare": self._bare,
            "open": self._open,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the terrain from this state."""
        self._areas, self._outlines = state["areas"], state["outlines"]
        self._obstacles, self._met = state["obstacles"], state["met"]
        self._bare, self._open = state["bare"], state["open"]


def cell_of(grid: SiteGrid, place_m: Place) -> tuple[int, int]:
    """Row and column of the cell that holds the place; raises OutsideRegion."""
    rows, columns = grid.cells_of(np.array([place_m], dtype=np.float64))
    return int(rows[0]), int(columns[0])


def within(grid: SiteGrid, place_m: Place, radius_m: float) -> BoolArray:
    """(rows, columns): the cells whose centre lies within the radius [m] of the place."""
    disc: BoolArray = np.hypot(grid.x_m[None, :] - place_m[0], grid.y_m[:, None] - place_m[1]) <= radius_m
    return disc


def cells_touched(grid: SiteGrid, polygon_m: Sequence[Place]) -> BoolArray:
    """(rows, columns): the cells that the polygon covers in whole or in part (even-odd rule, its edge included)."""
    corners = np.asarray(polygon_m, dtype=np.float64)
    covered = cells_inside(grid, polygon_m)
    following = np.roll(corners, -1, axis=0)
    for (ax, ay), (bx, by) in zip(corners, following, strict=True):
        steps = ceil(np.hypot(bx - ax, by - ay) / (grid.resolution_m * _BOUNDARY_STEP_CELLS)) + 1
        share = np.linspace(0.0, 1.0, max(steps, 2))
        edge = np.column_stack((ax + share * (bx - ax), ay + share * (by - ay)))
        edge = edge[grid.contains(edge)]
        if len(edge):
            covered[grid.cells_of(edge)] = True
    return covered


def cells_inside(grid: SiteGrid, polygon_m: Sequence[Place]) -> BoolArray:
    """(rows, columns): the cells whose centre lies in the polygon, by the even-odd rule."""
    x, y = grid.x_m[None, :], grid.y_m[:, None]
    covered = np.zeros(grid.shape, dtype=np.bool_)
    ax, ay = polygon_m[-1]
    for bx, by in polygon_m:
        if ay != by:
            spans = (ay > y) != (by > y)
            # From its southern end, so that an edge that two areas share is rounded alike in both.
            (px, py), (qx, qy) = ((ax, ay), (bx, by)) if ay < by else ((bx, by), (ax, ay))
            covered ^= spans & (x < px + (y - py) / (qy - py) * (qx - px))
        ax, ay = bx, by
    return covered


def keep_out_objection(grid: SiteGrid, polygon_m: Sequence[Place]) -> str | None:
    """One line on why the polygon is none, or closes no ground of the site; None if it closes some."""
    corners = np.asarray(polygon_m, dtype=np.float64)
    if np.linalg.matrix_rank(corners - corners[0], tol=_FLAT_M) < 2:
        return "expected corners around some ground, got all of them in one line"
    if (why := outline_objection(polygon_m)) is not None:
        return why
    return None if cells_touched(grid, polygon_m).any() else _off_site(grid, corners)


def interest_area_objection(grid: SiteGrid, polygon_m: Sequence[Place]) -> str | None:
    """One line on why the polygon is none, or holds the centre of no cell of the site; None if it holds one."""
    if (why := outline_objection(polygon_m)) is not None:
        return why
    if cells_inside(grid, polygon_m).any():
        return None
    if cells_touched(grid, polygon_m).any():
        return (
            f"expected an area that holds the centre of a cell of {grid.resolution_m:g} m, got one too small for that"
        )
    return _off_site(grid, np.asarray(polygon_m, dtype=np.float64))


def _off_site(grid: SiteGrid, corners: FloatArray) -> str:
    (west, south), (east, north) = corners.min(axis=0), corners.max(axis=0)
    return (
        f"expected an area of the site, which is 0..{grid.width_m:g} m east and 0..{grid.height_m:g} m north, "
        f"got one at {west:g}..{east:g} m east and {south:g}..{north:g} m north"
    )


def interest_weights(grid: SiteGrid, regions: Sequence[tuple[Sequence[Place], float]]) -> NDArray[np.float32] | None:
    """(rows, columns) weight of each cell's uncertainty: 1, or that of the last region which holds its centre.

    None without regions.
    """
    if not regions:
        return None
    weights = np.ones(grid.shape, dtype=np.float32)
    for polygon, weight in regions:
        weights[cells_inside(grid, polygon)] = weight
    weights.setflags(write=False)
    return weights


def interest_objection(weights: NDArray[np.float32] | None, open_cells: BoolArray) -> str | None:
    """One line on why these weights leave nothing to measure: every open cell has 0; None if one has more."""
    if weights is None or bool((weights[open_cells] > 0).any()):
        return None
    return "expected a weight above 0 somewhere on open ground, got 0 everywhere"


def leads_through(grid: SiteGrid, path_m: Sequence[Place], area: BoolArray) -> bool:
    """Whether the polyline leads through a cell of the area (rows, columns)."""
    return any(area[cell_of(grid, place)] for place in along(path_m, 0.5 * grid.resolution_m))


def along(path_m: Sequence[Place], step_m: float) -> Iterator[Place]:
    """Places along the polyline from its first vertex on, no further apart than the step."""
    yield path_m[0]
    for (ax, ay), (bx, by) in pairwise(path_m):
        steps = max(1, ceil(hypot(bx - ax, by - ay) / step_m))
        for number in range(1, steps):
            yield ax + (bx - ax) * number / steps, ay + (by - ay) * number / steps
        yield bx, by


def _footprint(radius_cells: float) -> BoolArray:
    """The neighbours of a closed cell from any place of which a rover of that radius [cells] might touch it."""
    reach = ceil(radius_cells)
    gap = np.maximum(np.abs(np.arange(-reach, reach + 1)) - 1.0, 0.0)
    touching: BoolArray = np.hypot(gap[:, None], gap[None, :]) < radius_cells
    touching[reach, reach] = True
    return touching
