"""Whether a region that is read now is the one that a mission has."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from he3.frames import SiteGrid
from schemas.maps import RegionLayer
from services.mission.region_folder import file_sha256

if TYPE_CHECKING:
    from he3.reference import Region
    from schemas.maps import MapRegion


def is_region(region: Region, account: MapRegion, location: str = "") -> bool:
    """Whether that is the region of the account, by its name, grid, place and the provenance of its layers.

    location: of a region in one file, whose checksum counts as well.
    """
    if location and account.file_sha256 and file_sha256(location) != account.file_sha256:
        return False
    grid = SiteGrid(account.rows, account.columns, account.resolution_m)
    layers = tuple(RegionLayer(**asdict(origin)) for origin in region.layers)
    place = (region.origin_lat_deg, region.origin_lon_deg, region.crs, region.origin_x_m, region.origin_y_m)
    stated = (account.origin_lat_deg, account.origin_lon_deg, account.crs, account.origin_x_m, account.origin_y_m)
    return (region.name, region.provenance, region.grid, layers, place) == (
        account.name, account.provenance, grid, account.layers, stated,
    )  # fmt: skip
