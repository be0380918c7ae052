"""The account of a mission's region that operators can ask for: where it lies, and where its layers come from."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from schemas.maps import MapRegion, RegionLayer
from services.mission.embedded_regions import EMBEDDED
from services.mission.region_folder import file_sha256

if TYPE_CHECKING:
    from he3.reference import Region
    from services.mission.scenario import Scenario


def region_account(scenario: Scenario, region: Region) -> MapRegion:
    """The region of that scenario as a message."""
    name = scenario.region
    return MapRegion(
        name=region.name,
        title=region.title,
        location=name if name in EMBEDDED else str(Path(name).absolute()),
        field_seed=scenario.field.field_seed,
        provenance=region.provenance,
        rows=region.grid.rows,
        columns=region.grid.columns,
        resolution_m=region.grid.resolution_m,
        origin_lat_deg=region.origin_lat_deg,
        origin_lon_deg=region.origin_lon_deg,
        crs=region.crs,
        origin_x_m=region.origin_x_m,
        origin_y_m=region.origin_y_m,
        layers=tuple(RegionLayer(**asdict(origin)) for origin in region.layers),
        file_sha256=file_sha256(name),
    )
