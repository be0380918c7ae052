"""Helium-3 in an area, with credible intervals from the joint posterior."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from he3.constants import REGOLITH_BULK_DENSITY_KG_M3
from he3.errors import InvalidInput, NotReady, OutsideRegion
from he3.polygons import outline_objection
from he3.resource import area_mean, drawn_fields, grade_tonnage, share_above
from schemas.maps import (
    GradeTonnage,
    GradeTonnagePoint,
    GradeTonnageQuery,
    Interval,
    ResourceEstimate,
    ResourceQuery,
)
from services.ground.map.layers import exceedance
from services.ground.terrain import cells_inside

if TYPE_CHECKING:
    from he3.frames import Place, SiteGrid
    from services.ground.map.snapshot import MapSnapshot

PPB = 1e-9
DRAWS = 2000
MAX_CORNERS = 256
MOST_STEPS = 20
MAX_CUTOFFS = 40


def corners_of(text: str) -> tuple[Place, ...]:
    """The corners of 'x,y,x,y,...' [m]; raises InvalidInput for other text, and for too few or too many corners."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise InvalidInput(f"polygon: expected numbers as x,y,x,y,..., got '{text[:60]}'") from None
    if len(numbers) % 2 or not 3 <= len(numbers) // 2 <= MAX_CORNERS or not np.isfinite(numbers).all():
        raise InvalidInput(
            f"polygon: expected 3 to {MAX_CORNERS} corners as x,y,x,y,... [m], got {len(numbers)} numbers"
        )
    return tuple(zip(numbers[::2], numbers[1::2], strict=True))


def area_of(text: str | None, grid: SiteGrid) -> NDArray[np.bool_]:
    """The cells (rows, columns) whose centre lies in the polygon; all of them without one."""
    if text is None:
        return np.ones(grid.shape, dtype=np.bool_)
    corners = corners_of(text)
    outside = ~grid.contains(np.array(corners))
    if outside.any():
        x, y = corners[int(np.argmax(outside))]
        raise OutsideRegion(
            f"polygon: expected corners within 0..{grid.width_m:g} m east and 0..{grid.height_m:g} m north, "
            f"got ({x:g}, {y:g})"
        )
    if (why := outline_objection(corners)) is not None:
        raise InvalidInput(f"polygon: {why}")
    area = cells_inside(grid, corners)
    if not area.any():
        raise InvalidInput("polygon: expected one that holds the centre of a cell at least, got a smaller one")
    return area


def estimate(request: ResourceQuery, snapshot: MapSnapshot) -> ResourceEstimate:
    """Mean, mass a metre and area above the cut-off, each with its credible interval."""
    if snapshot.process is None:
        raise NotReady("map resource: there is no belief yet to integrate; ask again in a moment")
    grid = snapshot.grid
    area = area_of(request.polygon, grid)
    over = area_mean(snapshot.process, grid, snapshot.mean_ppb, area)
    area_m2 = over.cells * grid.resolution_m**2
    # kg of helium-3 in a metre of ground, for each ppb by mass of its mean
    kg_per_ppb = PPB * REGOLITH_BULK_DENSITY_KG_M3 * area_m2
    reach = float(ndtri(0.5 + request.probability / 2)) * over.std_ppb
    low, high = max(0.0, over.mean_ppb - reach), over.mean_ppb + reach  # there is no less than no helium-3
    mean, std = snapshot.mean_ppb[area], snapshot.std_ppb[area]
    above = exceedance(mean, std, request.cutoff_ppb, snapshot.ends_at(area))
    # Equal queries of one revision have equal answers: the draws are seeded by both.
    seed = zlib.crc32(f"{snapshot.revision} {request.polygon}".encode())
    shares = share_above(snapshot.process, grid, area, request.cutoff_ppb, np.random.default_rng(seed), DRAWS)
    tail = (1 - request.probability) / 2
    share_low, share_high = np.quantile(shares, (tail, 1 - tail))
    expected_share = float(above.mean(dtype=np.float64))
    return ResourceEstimate(
        area_m2=area_m2,
        cells=over.cells,
        mean_ppb=Interval(expected=over.mean_ppb, low=low, high=high),
        mean_std_ppb=over.std_ppb,
        mass_kg_per_m=Interval(expected=kg_per_ppb * over.mean_ppb, low=kg_per_ppb * low, high=kg_per_ppb * high),
        bulk_density_kg_m3=REGOLITH_BULK_DENSITY_KG_M3,
        cutoff_ppb=request.cutoff_ppb,
        area_above_m2=Interval(
            expected=area_m2 * expected_share,
            low=area_m2 * min(float(share_low), expected_share),
            high=area_m2 * max(float(share_high), expected_share),
        ),
        confident_area_m2=float((above >= request.probability).sum()) * grid.resolution_m**2,
        probability=request.probability,
        quadrature_m=over.spacing_m,
        quadrature_error_ppb=over.std_error_ppb,
        revision=snapshot.revision,
        samples=len(snapshot.samples),
        mission_time_ns=snapshot.mission_time_ns,
    )


def grade_tonnage_curve(request: GradeTonnageQuery, snapshot: MapSnapshot) -> GradeTonnage:
    """The ground above each cut-off, its mean abundance and its helium-3, each with its credible interval."""
    if snapshot.process is None:
        raise NotReady("map grade-tonnage: there is no belief yet to draw from; ask again in a moment")
    grid, area = snapshot.grid, area_of(request.polygon, snapshot.grid)
    # Equal queries of one revision have equal answers, and other cut-offs are judged by the same fields.
    seed = zlib.crc32(f"grade-tonnage {snapshot.revision} {request.polygon}".encode())
    fields, weights = drawn_fields(snapshot.process, grid, area, np.random.default_rng(seed), DRAWS)
    fields = np.maximum(fields, 0.0)  # there is no less than no helium-3
    cutoffs = _even_cutoffs(fields) if request.cutoffs is None else _cutoffs_of(request.cutoffs)
    shares, grades = grade_tonnage(fields, weights, cutoffs)
    area_m2 = float(area.sum()) * grid.resolution_m**2
    kg_per_ppb = PPB * REGOLITH_BULK_DENSITY_KG_M3 * area_m2
    tail = (1 - request.probability) / 2

    def interval(values: NDArray[np.floating]) -> Interval:
        low, high = np.quantile(values, (tail, 1 - tail))
        expected = float(values.mean())
        return Interval(expected=expected, low=min(float(low), expected), high=max(float(high), expected))

    curve = []
    for number, cutoff in enumerate(cutoffs):
        share, grade = shares[:, number], grades[:, number]
        some = ~np.isnan(grade)
        curve.append(
            GradeTonnagePoint(
                cutoff_ppb=float(cutoff),
                area_m2=interval(area_m2 * share),
                mean_ppb=interval(grade[some]) if some.any() else None,
                mass_kg_per_m=interval(kg_per_ppb * np.where(some, share * grade, 0.0)),
            )
        )
    return GradeTonnage(
        area_m2=area_m2,
        curve=tuple(curve),
        bulk_density_kg_m3=REGOLITH_BULK_DENSITY_KG_M3,
        probability=request.probability,
        draws=DRAWS,
        block_m=float(np.sqrt(area_m2 / len(weights))),
        revision=snapshot.revision,
        samples=len(snapshot.samples),
        mission_time_ns=snapshot.mission_time_ns,
    )


def _cutoffs_of(text: str) -> NDArray[np.float64]:
    """Cut-offs [ppb] of 'a,b,...', in rising order; raises InvalidInput for other text and for too many or impossible
    values.
    """
    try:
        cutoffs = np.array([float(part) for part in text.split(",")])
    except ValueError:
        raise InvalidInput(f"cutoffs: expected numbers as a,b,... [ppb], got '{text[:60]}'") from None
    if not (np.isfinite(cutoffs).all() and (cutoffs >= 0).all()):
        raise InvalidInput(f"cutoffs: expected abundances from 0 ppb on, got '{text[:60]}'")
    if len(cutoffs) > MAX_CUTOFFS:
        raise InvalidInput(f"cutoffs: expected at most {MAX_CUTOFFS} abundances, got {len(cutoffs)}")
    return np.unique(cutoffs)


def _even_cutoffs(fields_ppb: NDArray[np.floating]) -> NDArray[np.float64]:
    """Cut-offs in round steps [ppb], at most `MOST_STEPS`, over all but the outermost values of drawn fields."""
    low, high = np.quantile(fields_ppb, (0.001, 0.999))
    step = 10.0 ** np.floor(np.log10(max(high - low, 1e-3) / MOST_STEPS))
    for factor in (1.0, 2.0, 5.0, 10.0):
        first, last = np.floor(low / (factor * step)), np.ceil(high / (factor * step))
        if last - first < MOST_STEPS:
            break
    cutoffs: NDArray[np.float64] = np.round(np.arange(first, last + 1) * factor * step, 9)
    return cutoffs
