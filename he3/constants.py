"""Physical constants and published figures, each with its unit and where it comes from.

Sources:
  BIPM       the SI Brochure, 9th edition, exact by definition
  IAU        IAU Working Group on Cartographic Coordinates and Rotational Elements (IAU_2015:30100, the lunar sphere)
  ALMANAC    the Moon's distance over a lunation, centre to centre, as in the astronomical almanacs
  PRODUCTS   the labels of the Kaguya MI mineral maps and of SLDEM2015, which share a grid
  LOLA       Smith et al., Geophys. Res. Lett. 37, L18204 (2010): the Moon's heights run from -9.1 to 10.8 km
  FA-JIN     Fa and Jin, regression of helium-3 on TiO2, solar wind and maturity, as the paper uses it
  SOURCEBOOK Carrier, Olhoeft and Mendell in the Lunar Sourcebook (1991), section 9.1.4
  PAPER      the publication whose system this project rebuilds
  ASSUMED    a working figure that is not verified
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

SPEED_OF_LIGHT_M_S: Final = 299_792_458.0  # m/s, exact, BIPM

MOON_RADIUS_M: Final = 1_737_400.0  # m, reference sphere, IAU
ELEVATION_MIN_M: Final = -9_500.0  # m above the reference sphere, with a margin, LOLA
ELEVATION_MAX_M: Final = 11_000.0  # m above the reference sphere, with a margin, LOLA
MOON_DISTANCE_MEAN_M: Final = 384_400e3  # m, mean, centre to centre, ALMANAC

ORBITAL_PIXELS_PER_DEGREE: Final = 512  # 1/deg, grid of the orbital maps, about 59 m a pixel, PRODUCTS
SITE_CELLS: Final = 500  # cells on a side of a finished region, PAPER
MAX_SAMPLES: Final = 4000  # 1, on a map: their covariance's Cholesky factor takes 128 MB, ASSUMED
SITE_RESOLUTION_M: Final = 1.0  # m, cell of a finished region, PAPER

TITANIUM_SLOPE: Final = 0.06  # dex per wt % of FeO, PAPER; a fit to Apollo 17 soils alone gives 0.0816
TITANIUM_INTERCEPT: Final = -0.54  # dex of wt %, PAPER; a fit to Apollo 17 soils alone gives -0.441
HELIUM3_GAIN_PPB: Final = 0.56  # ppb per (wt % of TiO2 x flux / OMAT), FA-JIN
HELIUM3_OFFSET_PPB: Final = 1.62  # ppb, FA-JIN
HELIUM3_MAX_PPB: Final = 1e6  # ppb, a thousandth of the soil's mass; anything above is a mistake, ASSUMED
HELIUM3_LEAST_PPB: Final = 0.05  # ppb, highest of a site, or it is in another unit: soils hold 1 to 30, ASSUMED
IRON_MIN_WT: Final = 1e-3  # wt %, FeO that no product resolves; 0 or less marks missing values, ASSUMED
IRON_MAX_WT: Final = 40.0  # wt %, FeO of no soil; lunar ones hold up to 25, ASSUMED
TITANIUM_MAX_WT: Final = 35.0  # wt %, TiO2 of no soil; lunar ones hold up to 14, ilmenite itself 53, ASSUMED
ABUNDANCE_ERROR: Final = 1.0  # wt % or ppb below 0 that the error of a retrieval may lead to, ASSUMED
OMAT_MAX: Final = 2.0  # 1, OMAT of no soil; valid data lie at about 0.1 to 0.3, ASSUMED
OMAT_MIN: Final = 0.05  # 1, below it the helium-3 relation blows up; valid data lie at about 0.1 to 0.3, FA-JIN

MAGNETOTAIL_HALF_ANGLE_DEG: Final = 27.0  # deg of orbit, half the magnetotail's passage; 25 to 30 in use, ASSUMED
# Solar-wind flux at the landing sites, 1 at normal incidence with no shielding, PAPER.
PUBLISHED_FLUX: Final = MappingProxyType({"apollo-11": 0.50, "apollo-15": 0.51, "apollo-16": 0.48, "apollo-17": 0.50})

PERTURBATION: Final = 0.05  # 1, relative standard deviation of the sub-pixel variation of FeO and OMAT, PAPER
CORRELATION_LENGTH_M: Final = 25.0  # m, e-folding length of that variation, PAPER

# Mean over the upper 60 cm. It is 1500 in the upper 15 cm and 1740 between 30 and 60 cm, each give or take 50.
REGOLITH_BULK_DENSITY_KG_M3: Final = 1660.0  # kg/m^3, SOURCEBOOK

ROVER_SLOPE_NOMINAL_DEG: Final = 15.0  # deg, what a VIPER-like rover is planned on, ASSUMED
ROVER_WIDTH_M: Final = 2.0  # m, length and width of such a rover, with a margin, ASSUMED
ROVER_STEP_M: Final = 0.25  # m, half of a wheel of 0.5 m, ASSUMED
ROVER_ROUGHNESS_M: Final = 0.1  # m, standard deviation of heights below such a rover, half of its clearance, ASSUMED
ROVER_ROCK_ABUNDANCE: Final = 0.05  # 1, share of the ground under rocks; 0.004 on average, young craters above, ASSUMED
RELIEF_WINDOW_M: Final = 100.0  # m, side of the moving mean that relief is measured against, PAPER
RELIEF_SIGMAS: Final = 1.5  # standard deviations of relief beyond which a hollow or hummock is an obstacle, PAPER
HUMMOCK_MAX_FRACTION: Final = 0.05  # 1, share of the region from which on a rise is landscape, not an obstacle, PAPER
RELIEF_FLOOR_M: Final = 0.2  # m, relief over 100 m that hinders no rover, however even the ground around, ASSUMED
