"""The field's node: answers the rover's instruments from the reference field and the true terrain.

It has no state: every reply is a function of the query, the region and the seed, so a field that was restarted answers
as before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from he3.errors import OutsideRegion
from he3.measurement import sample_noise
from schemas.measurement import MeasurementReply, MeasurementRequest, TerrainReply, TerrainRequest
from schemas.refusal import RefusalCode
from schemas.topics import MEASURE, TERRAIN, Side
from services.field.hazards import covered, hazard_places
from services.mission.regions import load_region
from services.runtime.node import Effect, Event, Interface, QueryReceived, RefuseQuery, SendReply

if TYPE_CHECKING:
    from he3.reference import Region
    from services.mission.mission_time import MissionTime
    from services.mission.scenario import FieldConfig, Scenario


class FieldNode:
    """Serves measurements with sensor noise, and terrain with the hidden hazards."""

    def __init__(self, region: Region, config: FieldConfig, seed: int, start_m: tuple[float, float]) -> None:
        self._region = region
        self._config = config
        self._seed = seed
        self.hazards_m = hazard_places(region.grid, config.hidden_hazards, config.hazard_radius_m, seed, start_m)
        """Centres (x, y) [m] of the hidden hazards, for tests and pictures; the ground does not know them."""
        self._traversable = region.traversable & ~covered(region.grid, self.hazards_m, config.hazard_radius_m)

    @property
    def interface(self) -> Interface:
        return Interface(name="field", sides=(Side.MOON,), serves=(MEASURE, TERRAIN), custody=False)

    def handle(self, event: Event, now: MissionTime) -> list[Effect]:
        """One reply or refusal to a query; no effect of any other event. The result does not depend on the time."""
        if not isinstance(event, QueryReceived):
            return []
        if event.topic == MEASURE:
            return [self._measured(event.token, event.request)]
        if event.topic == TERRAIN:
            return [SendReply(event.token, self._terrain(event.request))]
        return [
            RefuseQuery(event.token, f"expected a query on {MEASURE.name} or {TERRAIN.name}, got {event.topic.name}")
        ]

    def _measured(self, token: int, request: MeasurementRequest) -> Effect:
        try:
            rows, columns = self._region.grid.cells_of(np.array([[request.x_m, request.y_m]]))
        except OutsideRegion as error:
            return RefuseQuery(token, f"sample {request.sample_id}: {error}", RefusalCode.OUTSIDE_REGION)
        noise = sample_noise(self._seed, request.sample_id, self._config.noise_std_ppb)
        return SendReply(
            token,
            MeasurementReply(
                sample_id=request.sample_id,
                x_m=request.x_m,
                y_m=request.y_m,
                helium3_ppb=float(self._region.he3_ppb[rows[0], columns[0]]) + noise,
                noise_std_ppb=self._config.noise_std_ppb,
            ),
        )

    def _terrain(self, request: TerrainRequest) -> TerrainReply:
        """The values of the cells; a place outside the region has those of the nearest cell and is not traversable."""
        grid, points = self._region.grid, np.array(request.points_m)
        cells = np.maximum(points // grid.resolution_m, 0)
        columns = np.minimum(cells[:, 0], grid.columns - 1).astype(np.intp)
        rows = np.minimum(cells[:, 1], grid.rows - 1).astype(np.intp)
        return TerrainReply(
            elevation_m=tuple(self._region.elevation_m[rows, columns].tolist()),
            slope_deg=tuple(self._region.slope_deg[rows, columns].tolist()),
            traversable=tuple((self._traversable[rows, columns] & grid.contains(points)).tolist()),
        )


def build_node(scenario: Scenario, region: Region | None = None) -> FieldNode:
    """The field of that scenario. region: loaded from the scenario if it is not given."""
    if region is None:
        region = load_region(scenario.region, scenario.field.field_seed)
    return FieldNode(region, scenario.field, scenario.seed, scenario.start_m)
