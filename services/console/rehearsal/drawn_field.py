"""A Moon whose field is a draw from the posterior: each measurement follows from the belief and the ones before it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from he3.constants import HELIUM3_MAX_PPB
from schemas.measurement import MeasurementReply, MeasurementRequest
from schemas.topics import MEASURE
from services.runtime.node import QueryReceived, SendReply

if TYPE_CHECKING:
    from he3.gp import GaussianProcess
    from services.field.node import FieldNode
    from services.mission.mission_time import MissionTime
    from services.runtime.node import Effect, Event, Interface


class DrawnField:
    """Serves the terrain of a field's node, and measurements drawn one after another.

    A draw of the whole field at the places that are measured is the product of such conditional draws, so all
    measurements together have the posterior's joint distribution, exactly.
    """

    def __init__(
        self, field: FieldNode, belief: GaussianProcess, noise_std_ppb: float, random: np.random.Generator
    ) -> None:
        self._field = field
        self._belief = belief
        self._noise_std_ppb = noise_std_ppb
        self._random = random
        self._drawn: dict[str, float] = {}

    @property
    def interface(self) -> Interface:
        return self._field.interface

    def handle(self, event: Event, now: MissionTime) -> list[Effect]:
        """The reply to a measurement or to a terrain query."""
        if not (isinstance(event, QueryReceived) and event.topic is MEASURE):
            return self._field.handle(event, now)
        asked: MeasurementRequest = event.request
        return [
            SendReply(
                event.token,
                MeasurementReply(
                    sample_id=asked.sample_id,
                    x_m=asked.x_m,
                    y_m=asked.y_m,
                    helium3_ppb=self._value_ppb(asked),
                    noise_std_ppb=self._noise_std_ppb,
                ),
            )
        ]

    def _value_ppb(self, asked: MeasurementRequest) -> float:
        """The measured value; the same one for a sample that is asked for again."""
        if asked.sample_id not in self._drawn:
            place_m = (asked.x_m, asked.y_m)
            self._drawn[asked.sample_id], self._belief = self._belief.drawn(place_m, self._measured_ppb)
        return self._drawn[asked.sample_id]

    def _measured_ppb(self, mean_ppb: float, std_ppb: float) -> float:
        known = self._belief.hyperparameters
        noise = max(self._noise_std_ppb, known.noise_std_ppb)  # it may be learned
        if known.warp is None:
            value = self._random.normal(mean_ppb, np.hypot(std_ppb, noise))
        else:  # the moments are of the latent field, and so is noise beside the instrument's
            learned = np.sqrt(max(0.0, noise**2 - self._noise_std_ppb**2))
            latent = np.array(self._random.normal(mean_ppb, np.hypot(std_ppb, learned)))
            value = self._random.normal(float(known.warp.field(latent)), self._noise_std_ppb)
        return float(np.clip(value, 0.0, HELIUM3_MAX_PPB))
