"""Fields with the layers that are mapped with them: Mons Herodotus, and the stand-ins `t1` and `t2`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy import ndimage

from benchmarks.data_folder import expect_rasters
from benchmarks.exam_fields import load_field
from he3.errors import InvalidInput
from he3.frames import BoolArray, FloatArray
from he3.hyperparameters import DEFAULT_NOISE_STD_PPB
from he3.nodata import filled_with_nearest
from he3.reference import OrbitalWindow, Region, reference, resample
from he3.regolith import RegolithModel
from services.mission.regions import load_window

HERODOTUS = "herodotus-feo"
FIELDS = (HERODOTUS, "t1", "t2")
SHIFT_PIXELS = 2
"""Of the layers' own pixels, to the east."""

_FOLDER = "leggedrobotics+lunar_planner/user_data/map_data/Herodutus_Mons"
_LAYERS = (
    ("clino_feo_tio_plagio.tif", "wac_tio2_gray"),
    ("clino_feo_tio_plagio.tif", "lk_cli"),
    ("hsr.tif", "qts_demstack"),
)
"""Raster and band of TiO2, clinopyroxene and height, on the same pixels as FeO."""


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """A field, and what is mapped with it."""

    region: Region
    known: BoolArray
    """(rows, columns) cells that are scored."""
    noise_std_ppb: float
    layers: FloatArray
    """(k, rows, columns) in units of their own."""
    shifted_layers: FloatArray
    """The same, ``SHIFT_PIXELS`` off."""
    relation_ppb: FloatArray | None = None
    """What the published relation makes of the layers; None where it does not apply."""
    shifted_relation_ppb: FloatArray | None = None


def has_layers(data: Path | None) -> bool:
    """Whether the folder has the rasters of Mons Herodotus."""
    return data is not None and all(_path(data, name) is not None for name, _ in _LAYERS)


def expect_layers(data: Path | None) -> None:
    """Raise InvalidInput unless that is a folder with the rasters of Mons Herodotus, as they are or below ``real``."""
    if not has_layers(data):
        expect_rasters(data, "docs/exam.md", [f"{_FOLDER}/{name}" for name, _ in _LAYERS])


def survey_of(name: str, data: Path | None, seed: int) -> Survey:
    """The field of that name with its layers; of `t1` and `t2` the variation of that seed. Raises InvalidInput."""
    if name not in FIELDS:
        raise InvalidInput(f"expected a field out of {', '.join(FIELDS)}, got {name!r}")
    return _herodotus(data) if name == HERODOTUS else _standin(name, seed)


def _standin(name: str, seed: int) -> Survey:
    window = load_window(name)
    region = reference(window, seed)
    pixel_deg = SHIFT_PIXELS / window.pixels_per_degree
    # A map that is placed too far to the east shows here what lies to the west.
    shifted = replace(window, origin_lon_deg=window.origin_lon_deg - pixel_deg)
    aside = _relation(shifted, region)
    return Survey(
        region, np.ones(region.grid.shape, dtype=np.bool_), DEFAULT_NOISE_STD_PPB, _mapped(window, region),
        _mapped(shifted, region), region.orbital_ppb, aside,
    )  # fmt: skip


def _mapped(window: OrbitalWindow, region: Region) -> FloatArray:
    """FeO and OMAT (2, rows, columns), without the variation within pixels."""
    return np.stack([resample(window, layer, region.grid) for layer in (window.iron_wt, window.maturity)])


def _relation(window: OrbitalWindow, region: Region) -> FloatArray:
    model = RegolithModel()
    orbital = model.helium3_ppb(model.titanium_wt(window.iron_wt), window.maturity, window.solar_wind_flux)
    found: FloatArray = np.maximum(resample(window, orbital, region.grid), 0.0)
    return found


def _path(data: Path, name: str) -> Path | None:
    places = (data / _FOLDER / name, data / "real" / _FOLDER / name)
    return next((path for path in places if path.is_file()), None)


@cache
def _herodotus(data: Path | None) -> Survey:
    """FeO with the layers on its cells; a cell without a value takes that of the nearest one that has it."""
    expect_layers(data)
    assert data is not None
    field = load_field(HERODOTUS, data)
    layers = np.array([_band(data, *source) for source in _LAYERS])
    if layers.shape[1:] != field.region.grid.shape:
        raise InvalidInput(f"{HERODOTUS}: expected layers of shape {field.region.grid.shape}, got {layers.shape[1:]}")
    shifted = ndimage.shift(layers, (0, 0, SHIFT_PIXELS), order=0, mode="nearest")
    return Survey(field.region, field.known, field.noise_std_ppb, layers, shifted)


def _band(data: Path, name: str, band: str) -> FloatArray:
    """A band with row 0 south."""
    import rasterio  # of the extra 'geo', as load_field, which ran before, has checked

    path = _path(data, name)
    assert path is not None
    with rasterio.open(path) as raster:
        if band not in raster.descriptions:
            raise InvalidInput(f"{path}: expected a band {band}, got {', '.join(map(str, raster.descriptions))}")
        values = raster.read(1 + raster.descriptions.index(band), masked=True).astype(np.float64).filled(math.nan)
    values[~(np.abs(values) < 1e30)] = math.nan
    return filled_with_nearest(values[::-1])[0]
