"""The live map as files that geographic tools open: the part of `MissionClient` that exports it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from he3.errors import NotFound
from schemas.commands import NoParameters
from schemas.maps import BELIEF, MapLayer, MapRegion
from schemas.topics import MAP_REGION
from services.console.client.map_queries import AsOf, MapQueries
from services.console.map_export.contents import MapContents, RasterLayer, belief_layer
from services.runtime.heartbeat import software_version

if TYPE_CHECKING:
    from services.console.map_export.folder import Exported

CUTOFF_PPB = 8.0
"""Threshold of the exceedance, if none is given; the cut-off of the queries of areas."""


class MapFiles(MapQueries):
    """The part of `MissionClient` that writes the map as files."""

    mission: str

    def region(self) -> MapRegion:
        """The region under the map: its place on the Moon, and where its layers come from."""
        found: MapRegion = self._session.query(MAP_REGION, NoParameters())
        return found

    def export_maps(
        self,
        folder: str | Path,
        *,
        threshold_ppb: float = CUTOFF_PPB,
        as_of: AsOf = None,
        region: str | None = None,
        pds4: bool = False,
        progress: Callable[[str], None] = lambda line: None,
    ) -> Exported:
        """Write the map into a folder: GeoTIFF, GeoPackage, GeoJSON, CSV and a STAC item (docs/maps-out.md).

        threshold_ppb: of the exceedance. region: where the mission's region is on this machine, for elevation, slope
        and, of a simulated Moon, the reference; None: where the ground has it. pds4: rasters with PDS4 labels as well.
        Raises He3Error that names the extra `geo` if it is not installed.
        """
        from services.console.map_export.folder import export_folder

        with export_folder(Path(folder)) as target:
            return target.write(self._contents(threshold_ppb, as_of, region), pds4=pds4, progress=progress)

    def _contents(self, threshold_ppb: float, as_of: AsOf, location: str | None) -> MapContents:
        from services.console.map_export.region_layers import loaded_region, region_layers

        account = self.region()
        loaded = loaded_region(account, location)
        mean = self.layer(MapLayer.MEAN, as_of=as_of)
        revision, simulated = mean.revision, self._is_simulated()
        layers = [self._layer(layer, account, threshold_ppb, revision) for layer in BELIEF]
        if not isinstance(loaded, str):
            layers += region_layers(loaded, account, mean.values, simulated)
        return MapContents(
            mission=self.mission, region=account, revision=revision, mission_time_ns=mean.about.mission_time_ns,
            layers=tuple(layers), track=self.track(revision),
            simulated=simulated, software=software_version(),
            notes=(loaded,) if isinstance(loaded, str) else (),
        )  # fmt: skip

    def _layer(self, layer: MapLayer, account: MapRegion, threshold_ppb: float, revision: int) -> RasterLayer:
        threshold = threshold_ppb if layer is MapLayer.EXCEEDANCE else None
        found = self.layer(layer, threshold=threshold, as_of=revision)
        return belief_layer(layer, found.values, found.unit, found.about.samples, account, threshold)

    def _is_simulated(self) -> bool:
        try:
            self.score()
        except NotFound:
            return False
        return True
