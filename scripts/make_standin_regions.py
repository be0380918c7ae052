"""Make the coarse rasters of the embedded regions: a SYNTHETIC STAND-IN for orbital data, seeded and reproducible.

The real rasters (Kaguya MI mineral maps, SLDEM2015) are tens of gigabytes. What is made here has their grid (512 pixels
a degree, north up) and statistics tuned so that the finished regions agree with the published figures: helium-3 range
and mean, and the share that is not traversable. The places are real; the rasters are not. No pixel here was measured.

    python scripts/make_standin_regions.py [--out DIR]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from he3 import constants
from he3.randomfield import correlated, unit_fields
from he3.reference import METRES_PER_DEGREE
from services.mission.region_build.writing import write_folder
from services.mission.region_folder import FORMAT_VERSION

FloatArray = NDArray[np.float64]

PIXELS = 32  # pixels on a side of a window: about 1.8 km, for a region of 0.5 km
MOON_LON_LAT = "IAU_2015:30100"
SUBSAMPLES = 9  # points per pixel and axis over which an elevation is averaged, as by an orbiter's footprint
PROVENANCE = "SYNTHETIC STAND-IN made by scripts/make_standin_regions.py; not measured data"


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Parameters of one stand-in. Lengths in metres, x east and y north of the region's south-west corner."""

    folder: str
    name: str
    title: str
    centre_lat_deg: float
    centre_lon_deg: float
    flux: float
    chemistry_seed: int
    iron_wt: float  # mean FeO over the window
    iron_spread: float  # its relative standard deviation between pixels
    maturity: float  # mean OMAT
    maturity_spread: float
    chemistry_correlation: float  # between FeO and OMAT
    chemistry_length_m: float  # shorter than a pixel: neighbouring pixels are almost independent
    terrain_seed: int
    base_m: float
    roughness_m: float  # standard deviation of the rolling ground
    roughness_length_m: float
    tilt: tuple[float, float]  # rise per metre east and north
    craters: int  # at random places of the window
    crater_diameters_m: tuple[float, float]
    landform: Callable[[FloatArray, FloatArray], FloatArray]
    variation_seed: int  # of the perturbation for which the published figures hold


def crater(x: FloatArray, y: FloatArray, cx: float, cy: float, diameter: float, freshness: float) -> FloatArray:
    """Height [m] of a simple crater: a bowl, a fifth of its diameter deep when fresh, and a rim."""
    r = np.hypot(x - cx, y - cy) / (diameter / 2)
    depth, rim = 0.20 * freshness * diameter, 0.04 * freshness * diameter
    bowl = -depth + (depth + rim) * r**2
    height: FloatArray = np.where(r < 1, bowl, rim * np.maximum(r, 1e-9) ** -3.0)
    return height


def no_landform(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.zeros_like(x)


def rille(x: FloatArray, y: FloatArray) -> FloatArray:
    """Height [m] of the upper edge of a winding rille in the north-west: ground descends beyond a curved rim."""
    along, beyond = x * 0.77 + y * 0.64, (y - 395) * 0.77 - x * 0.64
    beyond += 16 * np.sin(along / 70)
    return -0.47 * 12 * np.logaddexp(0, beyond / 12)


RECIPES = (
    Recipe(
        folder="t1_taurus_littrow_synthetic_standin",
        name="t1",
        title="Taurus-Littrow (synthetic stand-in)",
        centre_lat_deg=20.190,
        centre_lon_deg=30.772,
        flux=constants.PUBLISHED_FLUX["apollo-17"],
        chemistry_seed=1704,
        iron_wt=17.2,
        iron_spread=0.029,
        maturity=0.14131,
        maturity_spread=0.080,
        chemistry_correlation=-0.08,
        chemistry_length_m=15.0,
        terrain_seed=142,
        base_m=-2630.0,
        roughness_m=5.0,
        roughness_length_m=160.0,
        tilt=(0.012, -0.02),
        craters=30,
        crater_diameters_m=(70.0, 190.0),
        landform=no_landform,
        variation_seed=7,
    ),
    Recipe(
        folder="t2_hadley_rille_synthetic_standin",
        name="t2",
        title="Hadley Rille (synthetic stand-in)",
        centre_lat_deg=26.132,
        centre_lon_deg=3.633,
        flux=constants.PUBLISHED_FLUX["apollo-15"],
        chemistry_seed=1502,
        iron_wt=16.4,
        iron_spread=0.028,
        maturity=0.20868,
        maturity_spread=0.080,
        chemistry_correlation=-0.10,
        chemistry_length_m=15.0,
        terrain_seed=209,
        base_m=-1930.0,
        roughness_m=4.0,
        roughness_length_m=160.0,
        tilt=(-0.01, 0.015),
        craters=24,
        crater_diameters_m=(70.0, 150.0),
        landform=rille,
        variation_seed=23,
    ),
)


def make(recipe: Recipe) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """The document of one stand-in, and its layers iron_wt, maturity and elevation_m, row 0 in the south."""
    pixel_deg = 1.0 / constants.ORBITAL_PIXELS_PER_DEGREE
    side_m = constants.SITE_CELLS * constants.SITE_RESOLUTION_M
    metres_east = METRES_PER_DEGREE * math.cos(math.radians(recipe.centre_lat_deg))
    origin_lat = recipe.centre_lat_deg - side_m / 2 / METRES_PER_DEGREE
    origin_lon = recipe.centre_lon_deg - side_m / 2 / metres_east
    # The window lies on the product's own lattice of whole pixels, so the region does not begin at a pixel's edge.
    south = (math.floor(recipe.centre_lat_deg / pixel_deg) - PIXELS // 2) * pixel_deg
    west = (math.floor(recipe.centre_lon_deg / pixel_deg) - PIXELS // 2) * pixel_deg
    iron, maturity = _chemistry(recipe, (pixel_deg * METRES_PER_DEGREE, pixel_deg * metres_east))
    sub = (np.arange(PIXELS * SUBSAMPLES) + 0.5) / SUBSAMPLES * pixel_deg
    x, y = np.meshgrid((west + sub - origin_lon) * metres_east, (south + sub - origin_lat) * METRES_PER_DEGREE)
    elevation = _elevation(recipe, x, y)
    layers = {"iron_wt": iron, "maturity": maturity, "elevation_m": elevation}
    document: dict[str, Any] = {
        "format": "he3-region",
        "version": FORMAT_VERSION,
        "kind": "window",
        "name": recipe.name,
        "title": recipe.title,
        "provenance": PROVENANCE,
        "origin_lat_deg": origin_lat,
        "origin_lon_deg": origin_lon,
        "window": {
            "north_deg": south + PIXELS * pixel_deg,
            "west_deg": west,
            "pixels_per_degree": float(constants.ORBITAL_PIXELS_PER_DEGREE),
            "solar_wind_flux": recipe.flux,
            "seed": recipe.variation_seed,
        },
        "layers": {
            name: {"kind": "synthetic", "source": "drawn by scripts/make_standin_regions.py"} for name in layers
        },
    }
    return document, layers


def _chemistry(recipe: Recipe, spacing_m: tuple[float, float]) -> FloatArray:
    """FeO and OMAT (2, rows, columns): correlated, with exactly the recipe's mean, spread and correlation."""
    random = np.random.default_rng(recipe.chemistry_seed)
    fields = unit_fields(2, (PIXELS, PIXELS), spacing_m, recipe.chemistry_length_m, random)
    flat = fields.reshape(2, -1) - fields.reshape(2, -1).mean(axis=1, keepdims=True)
    white = np.linalg.solve(np.linalg.cholesky(flat @ flat.T / flat.shape[1]), flat).reshape(fields.shape)
    rho = recipe.chemistry_correlation
    iron, maturity = correlated(white, np.array([[1.0, rho], [rho, 1.0]]))
    return np.stack(
        [recipe.iron_wt * (1 + recipe.iron_spread * iron), recipe.maturity * (1 + recipe.maturity_spread * maturity)]
    )


def _elevation(recipe: Recipe, x: FloatArray, y: FloatArray) -> FloatArray:
    """Height [m] (rows, columns), each pixel the mean over its footprint of rolling ground, craters and landform."""
    random = np.random.default_rng(recipe.terrain_seed)
    ground = recipe.base_m + recipe.tilt[0] * x + recipe.tilt[1] * y + recipe.landform(x, y)
    spacing = (float(y[1, 0] - y[0, 0]), float(x[0, 1] - x[0, 0]))
    ground += recipe.roughness_m * unit_fields(1, x.shape, spacing, recipe.roughness_length_m, random)[0]
    for _ in range(recipe.craters):
        cx, cy = random.uniform(x.min(), x.max()), random.uniform(y.min(), y.max())
        smallest, largest = recipe.crater_diameters_m
        diameter = smallest * (1 - random.uniform(0, 1 - (smallest / largest) ** 2)) ** -0.5  # as N(>D) ~ D^-2
        ground += crater(x, y, cx, cy, diameter, random.uniform(0.2, 0.8))
    pixels: FloatArray = ground.reshape(PIXELS, SUBSAMPLES, PIXELS, SUBSAMPLES).mean(axis=(1, 3))
    return pixels


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(__file__).parent.parent / "services" / "mission" / "region_data"
    parser.add_argument("--out", type=Path, default=default, help="folder to write to (default: the package's)")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    for recipe in RECIPES:
        document, layers = make(recipe)
        window = document["window"]
        corner = window["west_deg"], window["north_deg"]
        write_folder(out / recipe.folder, document, layers, MOON_LON_LAT, corner, 1 / window["pixels_per_degree"], {
            "iron_wt": "FeO [wt %]", "maturity": "OMAT", "elevation_m": "height above the sphere of 1737.4 km [m]"
        })  # fmt: skip
        print(f"wrote {out / recipe.folder}: {PROVENANCE}")


if __name__ == "__main__":
    main()
