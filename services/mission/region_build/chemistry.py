"""Helium-3 of a site from measured layers, or from those of a stand-in laid over it. Arrays in, arrays out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from he3 import constants
from he3.errors import InvalidInput
from he3.frames import FloatArray, SiteGrid
from he3.provenance import LayerOrigin, OriginKind
from he3.randomfield import correlated, layer_correlation, unit_fields
from he3.reference import METRES_PER_DEGREE, OrbitalWindow, orbital_view, resample
from he3.regolith import RegolithModel, solar_wind_flux
from services.mission.region_build.recipe import ChemistryTable

_RELATIONS: Final = {
    "paper": (RegolithModel(), "TiO2 = 10^(0.06 FeO - 0.54), the paper's relation"),
    "apollo-17-soils": (
        RegolithModel(titanium_slope=0.0816, titanium_intercept=-0.441),
        "TiO2 = 10^(0.0816 FeO - 0.441), a fit to the soils of Apollo 17 in the Lunar Sample Compendium",
    ),
}
_COARSE: Final = LayerOrigin(layer="orbital_ppb", kind=OriginKind.DERIVED, source="as he3_ppb, without variation")
_SEEN_FROM_ORBIT: Final = LayerOrigin(
    layer="orbital_ppb", kind=OriginKind.DERIVED, source="he3_ppb in means over footprints of 59 m or 4 cells"
)
_STANDIN_USABLE_M: Final = 1400.0  # m, width of a stand-in's window without what bicubic resampling needs around


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chemistry:
    """Maps of the site: the reference field, its map from orbit, and the layers from which both were computed."""

    he3_ppb: FloatArray
    orbital_ppb: FloatArray
    layers: dict[str, FloatArray]
    origins: tuple[LayerOrigin, ...]


def chemistry_of(
    table: ChemistryTable,
    measured: dict[str, FloatArray],
    pixel_m: float,
    grid: SiteGrid,
    centre_deg: tuple[float, float],
) -> Chemistry:
    """The chemistry from measured layers on the site's cells. pixel_m: pixel size of the coarsest raster [m].

    Raises InvalidInput for values that no soil has, and for the far side without a solar-wind flux.
    """
    if "he3_ppb" in measured:
        field = np.clip(measured["he3_ppb"], 0.0, constants.HELIUM3_MAX_PPB)
        return Chemistry(he3_ppb=field, orbital_ppb=orbital_view(field, grid), layers={}, origins=(_SEEN_FROM_ORBIT,))
    origins: list[LayerOrigin] = []
    model, relation = _RELATIONS[table.titanium]
    iron = measured.get("iron_wt")
    maturity = measured.get("maturity")
    if maturity is None:
        assert table.assumed_maturity is not None  # the recipe is checked
        maturity = np.full(grid.shape, table.assumed_maturity)
        assumed = f"OMAT {table.assumed_maturity:g} everywhere, not measured here"
        origins.append(LayerOrigin(layer="maturity", kind=OriginKind.ASSUMED, source=assumed))
    titanium = measured.get("titanium_wt")
    if titanium is None:
        origins.append(LayerOrigin(layer="titanium_wt", kind=OriginKind.DERIVED, source=f"from FeO, {relation}"))
    maturity = np.maximum(maturity, constants.OMAT_MIN)
    if iron is not None:
        iron = np.clip(iron, constants.IRON_MIN_WT, constants.IRON_MAX_WT)
    flux = _flux(table, centre_deg)
    perturbed = table.perturbation > 0 and pixel_m > 2 * grid.resolution_m
    base = iron if iron is not None else titanium
    assert base is not None  # the recipe is checked
    factors = _variation(table, np.stack([base, maturity]), grid) if perturbed else np.ones((2, *grid.shape))

    def helium(first: FloatArray | float, second: FloatArray | float) -> FloatArray:
        wt = titanium * first if titanium is not None else model.titanium_wt(base * first)
        return model.helium3_ppb(np.maximum(wt, 0.0), np.maximum(maturity * second, constants.OMAT_MIN), flux)

    within = f", varied by {table.perturbation:.0%} within pixels of {pixel_m:.0f} m" if perturbed else ""
    origins.append(LayerOrigin(layer="he3_ppb", kind=OriginKind.DERIVED,
                               source=f"from TiO2, OMAT and a solar-wind flux of {flux:.3g}{within}"))  # fmt: skip
    layers = {"maturity": maturity, "titanium_wt": titanium if titanium is not None else model.titanium_wt(base)}
    field = helium(factors[0], factors[1])
    # Without variation, the map of the pixels would be the field itself, which a rover is to find.
    orbital = helium(1.0, 1.0) if perturbed else orbital_view(field, grid)
    origins.append(_COARSE if perturbed else _SEEN_FROM_ORBIT)
    layers |= {} if iron is None else {"iron_wt": iron}
    return Chemistry(he3_ppb=field, orbital_ppb=orbital, layers=layers, origins=tuple(origins))


def laid_over(window: OrbitalWindow, grid: SiteGrid) -> tuple[dict[str, FloatArray], tuple[LayerOrigin, ...], float]:
    """FeO and OMAT of a stand-in over the site, their origin, and their pixel size [m].

    They are stretched over a site that is larger than the stand-in's window.
    """
    stretch = max(1.0, max(grid.width_m, grid.height_m) / _STANDIN_USABLE_M)
    small = SiteGrid(grid.rows, grid.columns, grid.resolution_m / stretch)
    rows, columns = window.iron_wt.shape
    middle = (
        window.south_deg + rows / 2 / window.pixels_per_degree,
        window.west_deg + columns / 2 / window.pixels_per_degree,
    )
    east = METRES_PER_DEGREE * math.cos(math.radians(middle[0]))
    moved = replace(
        window,
        origin_lat_deg=middle[0] - small.height_m / 2 / METRES_PER_DEGREE,
        origin_lon_deg=middle[1] - small.width_m / 2 / east,
    )
    how = f", stretched {stretch:.3g} times" if stretch > 1 else ""
    layers = {name: resample(moved, getattr(window, name), small) for name in ("iron_wt", "maturity")}
    origins = tuple(
        LayerOrigin(layer=name, kind=OriginKind.SYNTHETIC,
                    source=f"of the stand-in {window.name}, laid over this place, not measured here{how}")
        for name in layers
    )  # fmt: skip
    return layers, origins, METRES_PER_DEGREE / window.pixels_per_degree * stretch


def _flux(table: ChemistryTable, centre_deg: tuple[float, float]) -> float:
    if table.solar_wind_flux is not None:
        return table.solar_wind_flux
    longitude = (centre_deg[1] + 180.0) % 360.0 - 180.0
    try:
        flux = solar_wind_flux(centre_deg[0], longitude)
    except InvalidInput:
        raise InvalidInput(
            f"chemistry.solar_wind_flux: expected a value for a place on the far side, {longitude:g} deg, got none"
        ) from None
    if not flux > 1e-3:
        raise InvalidInput("chemistry.solar_wind_flux: expected a value for a place at a pole, got none")
    return flux


def _variation(table: ChemistryTable, measured: FloatArray, grid: SiteGrid) -> FloatArray:
    """Factors of both layers, (2, rows, columns), with the layers' own correlation where both vary."""
    random = np.random.default_rng(table.seed)
    independent = unit_fields(2, grid.shape, (grid.resolution_m,) * 2, table.correlation_length_m, random)
    flat = measured.reshape(2, -1).std(axis=1) < 1e-9
    correlation = np.eye(2) if flat.any() else layer_correlation(measured)
    factors: FloatArray = 1.0 + table.perturbation * correlated(independent, correlation)
    return factors
