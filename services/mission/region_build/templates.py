"""Example recipes, one for each kind of source: `he3 region template KIND`."""

from __future__ import annotations

from typing import Final

_HEAD: Final = """\
format = "he3-region-recipe"
version = 1
name = "{name}"
title = "{title}"
centre_lat_deg = {lat}
centre_lon_deg = {lon}         # -180..180 and 0..360 are both understood
rows = 500
columns = 500
resolution_m = 1.0
# projection = "IAU_2015:30135"  # local by default: equirectangular, beyond 65 deg polar stereographic
# slope_limit_deg = 15.0         # ground that is steeper, in the site or in the raster itself, is closed
# step_limit_m = 0.25            # so are higher steps and rougher ground, where cells and pixels are 2 m or less
# roughness_limit_m = 0.1
# rock_limit = 0.05              # and ground with more rocks, with a layer rock_abundance (share of the ground, 0 to 1)
# terrain_rule = "vehicle"       # or "paper": hollows and hummocks by 1.5 standard deviations of relief
"""
_LAY_OVER: Final = """
[chemistry]
lay_over = "t1"                  # no chemistry was measured here: a stand-in's, and every output says so
"""
_ASSUMED: Final = """
[chemistry]
titanium = "paper"               # or "apollo-17-soils": TiO2 from FeO where no layer titanium_wt is given
assumed_maturity = 0.2           # OMAT, where no layer maturity is given, and every output says so
# solar_wind_flux = 0.5          # by default from latitude and longitude, near side alone
# perturbation = 0.05            # relative standard deviation of the variation within pixels
# seed = 1
"""
_KAGUYA: Final = """
[chemistry]
titanium = "paper"

[layers.iron_wt]
file = "Lunar_Kaguya_MIMap_MineralDeconv_FeOWeightPercent_50N50S.tif"   # or https://..., read by range requests
source = "FeO of Kaguya MI"
citation = "Lemelin et al. 2016, LPSC 47, 2994"

[layers.maturity]
file = "Lunar_Kaguya_MIMap_MineralDeconv_OpticalMaturityIndex_50N50S.tif"
source = "OMAT of Kaguya MI"
citation = "Lemelin et al. 2016, LPSC 47, 2994"
"""


def _head(name: str, title: str, lat: float, lon: float) -> str:
    return _HEAD.format(name=name, title=title, lat=lat, lon=lon)


def _terrain(file: str, source: str, more: str = "") -> str:
    return f'\n[layers.elevation_m]\nfile = "{file}"\nsource = "{source}"\n{more}'


TEMPLATES: Final = {
    "dem": _head("apollo-17", "Apollo 17, LROC NAC terrain", 20.19, 30.772)
    + _LAY_OVER
    + _terrain("NAC_DTM_APOLLO17.TIF", "LROC NAC DTM", "# fill_holes = true   # and marks where\n"),
    "kaguya": _head("taurus-littrow", "Taurus-Littrow, Kaguya MI and SLDEM2015", 20.19, 30.772)
    + _KAGUYA
    + _terrain("SLDEM2015_512_00N_30N_000_045_FLOAT.IMG", "SLDEM2015"),
    "sldem": _head("mare", "SLDEM2015 by its PDS3 label", 8.5, 31.4)
    + _LAY_OVER
    + _terrain("SLDEM2015_512_00N_30N_000_045_FLOAT.LBL", "SLDEM2015", '# unit = "km"   # by default the label\'s\n'),
    "polar": _head("south-pole", "LOLA polar DEM", -89.45, 222.7)
    + _LAY_OVER
    + "solar_wind_flux = 0.05\n"
    + _terrain("LDEM_80S_20MPP_ADJ.TIF", "LOLA polar DEM"),
    "npy": _head("array", "An array of one's own", 20.19113, 30.77229)
    + _LAY_OVER
    + _terrain("dem_5m.npy", "derived from the LROC NAC DTM",
               "\n[layers.elevation_m.grid]     # row 0 is north\ncentre_lat_deg = 20.19113\n"
               "centre_lon_deg = 30.77229\nresolution_m = 5.0\n"),
    "multiband": _head("herodotus", "Mons Herodotus", 27.49, -52.957)
    + _ASSUMED
    + _terrain("hsr.tif", "QuickMap DEM stack", 'band = "qts_demstack"   # by name; a number works, too\n')
    + '\n[layers.iron_wt]\nfile = "clino_feo_tio_plagio.tif"\nband = "lk_feo"\nsource = "FeO of Kaguya MI"\n'
    + '\n[layers.titanium_wt]\nfile = "clino_feo_tio_plagio.tif"\nband = "wac_tio2_gray"\n'
    + 'source = "TiO2 of LROC WAC"\n# zero_is_missing = true   # below the limit of detection\n# fill_holes = true\n',
}  # fmt: skip
