"""The rasters of the region under the map: terrain and, of a simulated Moon, the reference field.

They are read when they are first asked for, in the query process: no sample changes them, so snapshots do not carry
them, and a mission without viewers keeps none.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from he3.errors import NotFound
from he3.terrain import hillshade
from services.mission.region_identity import is_region
from services.mission.regions import load_region

if TYPE_CHECKING:
    from he3.frames import BoolArray, Float32Array
    from schemas.maps import MapRegion
    from services.ground.map.snapshot import MapSnapshot

_reading = threading.Lock()  # two threads answer; one of them reads


@dataclass(frozen=True, slots=True, eq=False)
class RegionRasters:
    """Each (rows, columns), row 0 in the south, read-only."""

    elevation_m: Float32Array
    slope_deg: Float32Array
    shade: Float32Array
    """Brightness of the relief, 0 to 1."""
    reference_ppb: Float32Array
    known: BoolArray | None
    """Where the reference is known; it is that of the nearest such cell elsewhere. None where it is everywhere."""

    @property
    def has_terrain(self) -> bool:
        """Whether the region has an elevation; without one it is 0 everywhere."""
        return bool(self.elevation_m.any())


def region_rasters(snapshot: MapSnapshot) -> RegionRasters:
    """The rasters of the snapshot's region. Raises NotFound if it has none, He3Error if it cannot be read."""
    account = snapshot.region
    if account is None:
        raise NotFound("map: there is no account of the region, and so neither terrain nor reference")
    with _reading:
        return _read(account)


@lru_cache(maxsize=1)
def _read(account: MapRegion) -> RegionRasters:
    region = load_region(account.location, account.field_seed)
    if not is_region(region, account, account.location):
        raise NotFound(
            f"map: expected the mission's region '{account.name}' at {account.location}, got one that was built anew "
            "or changed since"
        )
    rasters: Final = RegionRasters(
        elevation_m=region.elevation_m.astype(np.float32),
        slope_deg=region.slope_deg.astype(np.float32),
        shade=hillshade(region.elevation_m, region.grid.resolution_m).astype(np.float32),
        reference_ppb=region.he3_ppb.astype(np.float32),
        known=region.known,
    )
    for raster in (rasters.elevation_m, rasters.slope_deg, rasters.shade, rasters.reference_ppb):
        raster.setflags(write=False)
    return rasters
