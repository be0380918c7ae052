"""Queries of the rover's instruments to the field service, and the replies."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from schemas.wire import Identifier, PositionM, Wire


class MeasurementRequest(Wire):
    """Query for the analysis of regolith drilled at a place. Equal sample ids have equal replies."""

    sample_id: Identifier
    x_m: PositionM
    y_m: PositionM
    depth_m: Annotated[float, Field(gt=0, le=3)]


class MeasurementReply(Wire):
    """Helium-3 abundance of the sample by mass, with sensor noise."""

    sample_id: Identifier
    x_m: PositionM
    y_m: PositionM
    helium3_ppb: float
    noise_std_ppb: Annotated[float, Field(ge=0)]


class TerrainRequest(Wire):
    """Query for the terrain at up to 512 places, along the path ahead of the rover."""

    points_m: Annotated[tuple[tuple[PositionM, PositionM], ...], Field(min_length=1, max_length=512)]


class TerrainReply(Wire):
    """The terrain at those places, in their order; places outside the region are not traversable."""

    elevation_m: tuple[float, ...]
    slope_deg: tuple[float, ...]
    traversable: tuple[bool, ...]

    @model_validator(mode="after")
    def _one_of_each_per_place(self) -> TerrainReply:
        if not len(self.elevation_m) == len(self.slope_deg) == len(self.traversable):
            raise ValueError("expected one elevation, slope and traversability per place")
        return self
