"""What the region adds to a map: elevation, slope, the orbital map; of a simulated Moon, reference and error."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from he3.errors import He3Error, InvalidInput
from services.console.map_export.contents import SIMULATION_ONLY, RasterLayer
from services.mission.region_identity import is_region
from services.mission.regions import load_region

if TYPE_CHECKING:
    from he3.reference import Region
    from schemas.maps import MapRegion


def loaded_region(account: MapRegion, location: str | None = None) -> Region | str:
    """The region of that account, or one line on why it cannot be had on this machine.

    location: where it is, instead of where the account says. Then a region that cannot be read, or that is another one,
    is refused with InvalidInput.
    """
    place = account.location if location is None else location
    try:
        region = load_region(place, account.field_seed)
        if not is_region(region, account, place):
            raise InvalidInput(f"{place}: expected the mission's region '{account.name}', got another region")
    except He3Error as error:
        if location is not None:
            raise
        return f"elevation, slope, orbital map and reference are left out: {error}"
    return region


def region_layers(region: Region, account: MapRegion, mean_ppb: NDArray[Any], simulated: bool) -> Iterator[RasterLayer]:
    """The rasters that the region adds to a map with that mean (rows, columns) [ppb].

    simulated: whether the mission measures this region's reference field, which is then exported with the error.
    """
    if np.any(region.elevation_m):  # a region without elevation has zeros
        yield _layer("elevation", "elevation", "m", region.elevation_m, *_origin(account, "elevation_m"), "grey")
        yield _layer("slope", "steepest slope", "deg", region.slope_deg, *_slope_origin(account), "magma")
    orbital = _origin(account, "orbital_ppb", "he3_ppb")
    yield _layer("orbital", "helium-3 as an orbiter maps it", "ppb", region.orbital_ppb, *orbital, "viridis")
    if simulated:
        reference = _origin(account, "he3_ppb")
        # Where nothing is known of the field, the region has that of the nearest known cell, which is no reference.
        truth = region.he3_ppb if region.known is None else np.where(region.known, region.he3_ppb, np.nan)
        span = float(np.nanmin(truth)), float(np.nanmax(truth))
        yield _layer(
            "simulation_reference",
            "helium-3, reference field",
            "ppb",
            truth,
            *reference,
            "viridis",
            span,
            True,
        )
        error = mean_ppb - truth.astype(np.float32)
        largest = float(np.nanmax(np.abs(error))) or 1.0
        derived = ("derived", f"posterior mean less reference field; {reference[0]} {reference[1]}")
        yield _layer(
            "simulation_error", "helium-3, error of the mean", "ppb", error, *derived, "difference",
            (-largest, largest), True,
        )  # fmt: skip


def _layer(
    name: str, title: str, unit: str, values: NDArray[Any], kind: str, source: str, colours: str,
    span: tuple[float, float] | None = None, simulation_only: bool = False,
) -> RasterLayer:  # fmt: skip
    return RasterLayer(
        name=name, title=f"{title} ({SIMULATION_ONLY})" if simulation_only else title, unit=unit,
        values=values.astype(np.float32), kind=kind, source=source, colours=colours, span=span,
        simulation_only=simulation_only,
    )  # fmt: skip


def _origin(account: MapRegion, *names: str) -> tuple[str, str]:
    """Kind and source of the first of those layers that the region gives an account of."""
    for name in names:
        for layer in account.layers:
            if layer.layer == name:
                parts = (("product", layer.product_id), ("file", layer.file), ("window", layer.window),
                         ("cite", layer.citation), ("sha256", layer.sha256))  # fmt: skip
                return layer.kind, ", ".join([layer.source, *(f"{key} {text}" for key, text in parts if text)])
    return "unknown", f"the region does not say; {account.provenance}"


def _slope_origin(account: MapRegion) -> tuple[str, str]:
    return "derived", f"from elevation: {' '.join(_origin(account, 'elevation_m'))}"
