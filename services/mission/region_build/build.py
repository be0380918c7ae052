"""Builds a region's folder from a recipe."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from he3 import constants
from he3.errors import InvalidInput
from he3.frames import BoolArray, FloatArray, SiteGrid
from he3.nodata import expect_measured, expect_no_walls
from he3.provenance import LayerOrigin, OriginKind, summary
from he3.terrain import relief_m, slope_deg, traversable
from he3.vehicle_ground import VehicleLimits, judged
from services.mission.region_build.chemistry import chemistry_of, laid_over
from services.mission.region_build.plausible import ROCKS_BEYOND
from services.mission.region_build.projection import SitePlane, site_plane
from services.mission.region_build.recipe import Recipe
from services.mission.region_build.sampling import Sampled, sample
from services.mission.region_build.sources import opened
from services.mission.region_build.writing import write_folder
from services.mission.region_folder import FORMAT_VERSION, RegionDocument
from services.mission.regions import load_window

_DESCRIPTIONS = {
    "he3_ppb": "helium-3, reference field [ppb]", "orbital_ppb": "helium-3 as an orbiter maps it [ppb]",
    "elevation_m": "height above the sphere of 1737.4 km [m]", "traversable": "1: a rover may drive here",
    "iron_wt": "FeO [wt %]", "maturity": "OMAT", "titanium_wt": "TiO2 [wt %]",
    "rock_abundance": "share of the ground under rocks", "filled": "1: a hole was filled here",
}  # fmt: skip
_GROUND = ("elevation_m", "rock_abundance")


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """The ground of a site, row 0 south."""

    elevation_m: FloatArray
    traversable: BoolArray
    rule: str


def build_region(
    recipe: Recipe, base: Path, out: Path, progress: Callable[[str], None] = lambda line: None
) -> RegionDocument:
    """Build the region of a recipe into the folder ``out``, and return its document.

    base: folder of relative paths in the recipe. Raises InvalidInput, in one line, before anything is written.
    """
    grid = SiteGrid(recipe.rows, recipe.columns, recipe.resolution_m)
    plane = site_plane(recipe.centre_lat_deg, recipe.centre_lon_deg, grid, recipe.projection)
    margin = margin_cells(recipe)
    sampled: dict[str, Sampled] = {}
    origins: list[LayerOrigin] = []
    for layer, table in recipe.layers.items():
        name = str(layer)
        progress(f"reading {name} from {table.file}")
        with opened(name, table, base) as source:
            found = sample(source, plane, margin if name == "elevation_m" else 0, slopes=name == "elevation_m")
            sampled[name] = found
            how = "not known" if table.mask_holes else "filled"
            holes = f"; {found.filled.mean():.2%} of it {how}" if found.filled.any() else ""
            origins.append(LayerOrigin(
                layer=name, kind=OriginKind(table.kind), file=source.name, sha256=found.sha256, window=found.window,
                product_id=source.product_id, citation=table.citation,
                source=f"{table.source}, pixels of {found.pixel_m:.4g} m{holes}",
            ))  # fmt: skip
    masked = {str(layer): sampled[layer].filled for layer, table in recipe.layers.items() if table.mask_holes}
    rocks = _rock_abundance(sampled.get("rock_abundance"), masked.pop("rock_abundance", None))
    terrain = _terrain(recipe, sampled["elevation_m"], margin, rocks)
    measured: dict[str, FloatArray] = {name: found.values for name, found in sampled.items() if name not in _GROUND}
    for name, values in measured.items():
        expect_measured(f"layer {name}", values, -1e3, constants.HELIUM3_MAX_PPB)
    pixel_m = max((found.pixel_m for name, found in sampled.items() if name not in _GROUND), default=0.0)
    if recipe.chemistry.lay_over is not None:
        layers, over, pixel_m = laid_over(load_window(recipe.chemistry.lay_over), grid)
        measured |= layers
        origins += over
    centre = recipe.centre_lat_deg, recipe.centre_lon_deg
    chemistry = chemistry_of(recipe.chemistry, measured, pixel_m, grid, centre)
    origins += chemistry.origins
    origins.append(LayerOrigin(layer="traversable", kind=OriginKind.DERIVED, source=terrain.rule))
    maps: dict[str, Any] = {
        "he3_ppb": chemistry.he3_ppb, "orbital_ppb": chemistry.orbital_ppb, "elevation_m": terrain.elevation_m,
        "traversable": terrain.traversable, **chemistry.layers,
    }  # fmt: skip
    if rocks is not None:
        maps["rock_abundance"] = rocks
    if masked:
        unknown = np.logical_or.reduce(list(masked.values()))
        if unknown.all():
            raise InvalidInput("expected values of the field somewhere in the site, got missing ones alone")
        maps["he3_ppb"] = np.where(unknown, np.nan, chemistry.he3_ppb)
        maps["traversable"] = terrain.traversable & ~unknown
        maps |= {name: np.where(holes, np.nan, maps[name]) for name, holes in masked.items() if name in maps}
    filled = _filled(
        {str(name): sampled[name] for name, table in recipe.layers.items() if not table.mask_holes}, margin
    )
    if filled.any():
        maps["filled"] = filled
        origins.append(LayerOrigin(layer="filled", kind=OriginKind.DERIVED, source="cells that rest on filled holes"))
    document = _document(recipe, plane, tuple(origins))
    progress(f"writing {out}")
    corner = plane.x_m, plane.y_m + grid.height_m
    return write_folder(out, document, maps, plane.crs, corner, grid.resolution_m, _DESCRIPTIONS)


def margin_cells(recipe: Recipe) -> int:
    """Cells around the site that its terrain is read in: half a relief window, for relief and slopes at the edge."""
    if recipe.resolution_m >= constants.RELIEF_WINDOW_M:
        return 1
    return math.ceil(constants.RELIEF_WINDOW_M / 2 / recipe.resolution_m)


def _rock_abundance(sampled: Sampled | None, unknown: BoolArray | None) -> FloatArray | None:
    """Share of each cell under rocks, 0 to 1, NaN where it is not known; None without the layer."""
    if sampled is None:
        return None
    expect_measured("layer rock_abundance", sampled.values, -ROCKS_BEYOND, 1.0 + ROCKS_BEYOND)
    rocks: FloatArray = np.clip(sampled.values, 0.0, 1.0)
    return rocks if unknown is None else np.where(unknown, np.nan, rocks)


def _terrain(recipe: Recipe, sampled: Sampled, margin: int, rocks: FloatArray | None) -> Terrain:
    """Elevation, and where a rover may drive: by the recipe's rule, and by the raster's own slopes."""
    cell, limit = recipe.resolution_m, recipe.slope_limit_deg
    heights = sampled.values
    expect_measured("layer elevation_m", heights, constants.ELEVATION_MIN_M, constants.ELEVATION_MAX_M, "m")
    expect_no_walls("layer elevation_m", heights, cell)
    cut = slice(margin, -margin)
    assert sampled.source_slope_deg is not None  # elevation is sampled with slopes
    steep = np.maximum(slope_deg(heights, cell), sampled.source_slope_deg)
    whole_rocks = None
    if rocks is not None:
        whole_rocks = np.full(heights.shape, np.nan)
        whole_rocks[cut, cut] = rocks
    if recipe.terrain_rule == "vehicle":
        limits = VehicleLimits(limit, recipe.step_limit_m, recipe.roughness_limit_m, recipe.rock_limit)
        ground = judged(
            heights, cell, limits, slope=steep, rock_abundance=whole_rocks, pixel_m=sampled.pixel_m, margin=margin
        )
        open_cells, rule = ground.open_cells, f"{ground.rule}; slopes also in the raster's own pixels"
    else:
        open_cells, rule = _by_relief(heights, steep[cut, cut], cell, limit, cut)
    if not open_cells.any():
        raise InvalidInput(f"expected ground to drive on somewhere in the site, got none by the rule: {rule}")
    return Terrain(heights[cut, cut].copy(), open_cells, rule)


def _by_relief(heights: FloatArray, steep: FloatArray, cell: float, limit: float, cut: slice) -> tuple[BoolArray, str]:
    """Open cells and a line on it by the paper's rule, where cells are small enough for relief."""
    with_relief = cell < constants.RELIEF_WINDOW_M
    relief = relief_m(heights, cell)[cut, cut] if with_relief else np.zeros_like(steep)
    rule = f"slope of at most {limit:g} deg in the site and in its raster" + (", and relief" if with_relief else
           ", without relief, as cells are too large for it")  # fmt: skip
    # The closing of the paper's rule closes gaps; it opens nothing, but at the edge a steep cell must stay closed.
    return traversable(steep, relief, limit) & (steep <= limit), rule


def _filled(sampled: dict[str, Sampled], margin: int) -> BoolArray:
    cut = slice(margin, -margin)
    masks = [found.filled[cut, cut] if name == "elevation_m" else found.filled for name, found in sampled.items()]
    filled: BoolArray = np.logical_or.reduce(masks)
    return filled


def _document(recipe: Recipe, plane: SitePlane, origins: tuple[LayerOrigin, ...]) -> dict[str, Any]:
    latitude, longitude = plane.corner_deg()
    layers = {}
    for origin in origins:
        table = asdict(origin)
        layers[table.pop("layer")] = {
            "kind": origin.kind.value, "source": origin.source, "source_file": origin.file,
            "source_sha256": origin.sha256, "window": origin.window, "product_id": origin.product_id,
            "citation": origin.citation,
        }  # fmt: skip
    return {
        "format": "he3-region", "version": FORMAT_VERSION, "kind": "site", "name": recipe.name, "title": recipe.title,
        "provenance": summary(origins)[:1000], "resolution_m": recipe.resolution_m,
        "origin_lat_deg": latitude if plane.has_origin else None,
        "origin_lon_deg": longitude if plane.has_origin else None,
        "crs": plane.crs, "origin_x_m": plane.x_m, "origin_y_m": plane.y_m, "layers": layers,
    }  # fmt: skip
