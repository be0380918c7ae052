"""The contents of a map that is exported: rasters over the site, samples, paths and areas, and their provenance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from numpy.typing import NDArray

from he3.frames import SiteGrid
from schemas.maps import MapLayer

if TYPE_CHECKING:
    from schemas.ground import MissionTrack
    from schemas.maps import MapRegion

SIMULATION_ONLY: Final = "simulation only"
"""Said of a layer that no real mission has: it rests on the reference field of a simulated Moon."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RasterLayer:
    """One raster over the site. values: float32, NaN where there is none, or uint8 for classes; (rows, columns), row 0
    in the south.
    """

    name: str
    """Name of its file, without suffix."""
    title: str
    unit: str
    values: NDArray[Any]
    kind: str
    """real, derived, assumed or synthetic; unknown where the region does not say."""
    source: str
    """Where the values come from, in one line."""
    colours: str
    """Name of its colour map, see `styles`."""
    span: tuple[float, float] | None = None
    """Values of the first and the last colour; None: the lowest and the highest value."""
    classes: Mapping[int, str] = field(default_factory=dict)
    """Meaning of each value of a layer of classes."""
    simulation_only: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapContents:
    """A map of one revision, with everything that is exported of it."""

    mission: str
    region: MapRegion
    revision: int
    mission_time_ns: int
    layers: tuple[RasterLayer, ...]
    track: MissionTrack
    software: str = ""
    """Version of this software."""
    simulated: bool = False
    """Whether the measurements are of a simulated Moon with a reference field."""
    notes: tuple[str, ...] = ()
    """One line on each part that is left out."""

    @property
    def grid(self) -> SiteGrid:
        return SiteGrid(self.region.rows, self.region.columns, self.region.resolution_m)


def belief_layer(
    layer: MapLayer, values: NDArray[Any], unit: str, samples: int, region: MapRegion, threshold_ppb: float | None
) -> RasterLayer:
    """A layer of the live map as it is exported. samples: measurements in the map."""
    title, colours, span = _BELIEF[layer]
    if threshold_ppb is not None:
        title = f"{title} {threshold_ppb:g} ppb"
    if layer is MapLayer.TRAVERSABLE:
        source = f"the region's terrain less keep-outs and obstacles met; region: {region.provenance}"
    else:
        source = f"Gaussian process over {samples} samples; region: {region.provenance}"
    return RasterLayer(
        name=layer.value, title=title, unit=unit, values=values, kind="derived", source=source, colours=colours,
        span=span, classes=OPEN_CLASSES if layer is MapLayer.TRAVERSABLE else {},
    )  # fmt: skip


OPEN_CLASSES: Final = MappingProxyType({0: "closed", 1: "open"})
_BELIEF: Final[Mapping[MapLayer, tuple[str, str, tuple[float, float] | None]]] = {
    MapLayer.MEAN: ("helium-3, posterior mean", "viridis", None),
    MapLayer.STD: ("helium-3, posterior standard deviation", "magma", None),
    MapLayer.INFORMATION: ("information of one measurement at the place about the field", "magma", None),
    MapLayer.EXCEEDANCE: ("probability of more helium-3 than", "viridis", (0.0, 1.0)),
    MapLayer.TRAVERSABLE: ("where the rover's centre may be", "open", None),
}
