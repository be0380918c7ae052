"""What operators ask of the live map, and what it answers. Stock Zenoh clients put the parameters in the selector."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field

from schemas.wire import MissionTimeNs, PositionM, Wire

Count = Annotated[int, Field(ge=0)]


class MapPointQuery(Wire):
    """The belief at one place."""

    x: PositionM
    y: PositionM


class MapPoint(Wire):
    """Posterior of the helium-3 abundance at one place, from the map of that revision."""

    x_m: PositionM
    y_m: PositionM
    mean_ppb: float
    std_ppb: Annotated[float, Field(ge=0)]
    traversable: bool
    revision: Count
    """Grows by one with every change of the map."""
    samples: Count
    """Measurements that the map holds."""
    mission_time_ns: MissionTimeNs
    """Mission time of that revision."""


class MapLayer(StrEnum):
    MEAN = "mean"
    STD = "std"
    TRAVERSABLE = "traversable"


class MapLayerQuery(Wire):
    """A whole layer, or every `step`-th cell of it."""

    layer: MapLayer
    step: Annotated[int, Field(ge=1, le=500)] = 1


class MapRaster(Wire):
    """A layer as numbers: base64 of little-endian values, row 0 in the south, [row, column] = [y, x]."""

    layer: MapLayer
    rows: Annotated[int, Field(ge=1, le=4096)]
    columns: Annotated[int, Field(ge=1, le=4096)]
    resolution_m: Annotated[float, Field(gt=0)]
    dtype: Literal["<f4", "|u1"]
    data_base64: Annotated[str, Field(max_length=24_000_000)]
    unit: str
    revision: Count
    samples: Count
    mission_time_ns: MissionTimeNs


class MapScore(Wire):
    """How the belief compares with the reference field, over all cells; only a simulated Moon can tell."""

    rmse_ppb: Annotated[float, Field(ge=0)]
    coverage_68: Annotated[float, Field(ge=0, le=1)]
    """Share of the cells within 1 posterior standard deviation of the truth (nominal: 0.683)."""
    coverage_95: Annotated[float, Field(ge=0, le=1)]
    """Share of the cells within 2 posterior standard deviations of the truth (nominal: 0.954)."""
    mean_std_ppb: Annotated[float, Field(ge=0)]
    revision: Count
    samples: Count
    mission_time_ns: MissionTimeNs
