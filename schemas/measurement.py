"""What the rover's instruments ask the Moon, and what it answers."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from schemas.wire import Identifier, PositionM, Wire


class MeasurementRequest(Wire):
    """Analyse the regolith drilled at a place. The same sample id gives the same number, however often it is asked."""

    sample_id: Identifier
    x_m: PositionM
    y_m: PositionM
    depth_m: Annotated[float, Field(gt=0, le=3)]


class MeasurementReply(Wire):
    """Helium-3 abundance of the sample by mass, sensor noise included."""

    sample_id: Identifier
    x_m: PositionM
    y_m: PositionM
    helium3_ppb: float
    noise_std_ppb: Annotated[float, Field(ge=0)]


class TerrainRequest(Wire):
    """Look at the terrain at up to 512 places, as a rover looks along the way ahead."""

    points_m: Annotated[tuple[tuple[PositionM, PositionM], ...], Field(min_length=1, max_length=512)]


class TerrainReply(Wire):
    """The terrain at those places, in their order; a place outside the region is not traversable."""

    elevation_m: tuple[float, ...]
    slope_deg: tuple[float, ...]
    traversable: tuple[bool, ...]

    @model_validator(mode="after")
    def _one_of_each_per_place(self) -> TerrainReply:
        if not len(self.elevation_m) == len(self.slope_deg) == len(self.traversable):
            raise ValueError("expected one elevation, slope and traversability per place")
        return self
