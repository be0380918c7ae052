"""Queries of the live map: a place, a layer, a part of one, an area, earlier maps; they return arrays and messages."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from he3.errors import InvalidInput
from schemas.commands import NoParameters
from schemas.ground import InterestArea, InterestChange, InterestList, MissionTrack
from schemas.maps import (
    CrossValidation,
    GradeTonnage,
    MapAbout,
    MapHistory,
    MapLayer,
    MapLayerQuery,
    MapPoint,
    MapRaster,
    MapRealisations,
    MapScore,
    ResourceEstimate,
)
from schemas.topics import (
    LIST_INTERESTS,
    MAP_BOX,
    MAP_CROSS_VALIDATION,
    MAP_GRADE_TONNAGE,
    MAP_HISTORY,
    MAP_LAYER,
    MAP_POINT,
    MAP_REALISATIONS,
    MAP_RESOURCE,
    MAP_SCORE,
    SET_INTEREST,
    TRACK,
    Topic,
)
from schemas.validation import one_line
from services.console.client.person import Acting

if TYPE_CHECKING:
    from services.runtime.transport.client import Client

Polygon = Sequence[tuple[float, float]]
AsOf = int | str | None
AREA_WITHIN_S = 30.0
"""The integral over an area, and the cross-validation of a thousand samples, take longer than all other answers."""


@dataclass(frozen=True, slots=True, eq=False)
class LayerArray:
    """A layer of the map: values (rows, columns), row 0 in the south, at the centres x_m (columns,) and y_m (rows,)."""

    values: NDArray[Any]
    x_m: NDArray[np.floating]
    y_m: NDArray[np.floating]
    about: MapAbout

    @property
    def unit(self) -> str:
        return self.about.unit

    @property
    def revision(self) -> int:
        return self.about.revision

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """West, east, south, north [m]: what matplotlib's ``imshow(..., origin="lower", extent=...)`` wants."""
        half = self.about.resolution_m / 2
        return (
            float(self.x_m[0] - half),
            float(self.x_m[-1] + half),
            float(self.y_m[0] - half),
            float(self.y_m[-1] + half),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Realisations:
    """Fields drawn from the belief: values (count, rows, columns) [ppb], row 0 south, at the centres x_m and y_m."""

    values: NDArray[np.float32]
    x_m: NDArray[np.floating]
    y_m: NDArray[np.floating]
    resolution_m: float
    revision: int
    samples: int


class MapQueries(Acting):
    """The part of `MissionClient` that asks for the map."""

    _session: Client

    def point(self, x: float, y: float, threshold: float | None = None, as_of: AsOf = None) -> MapPoint:
        """The posterior at a place [m]; with a threshold [ppb], also the probability of more than that."""
        payload, _ = self._session.fetch(MAP_POINT, {"x": x, "y": y, "threshold": threshold, "as_of": as_of})
        return MapPoint.model_validate_json(payload)

    def layer(
        self, layer: str, *, threshold: float | None = None, as_of: AsOf = None, step: int | None = None
    ) -> LayerArray:
        """A whole layer: mean, std, information, exceedance (with a threshold [ppb]) or traversable."""
        payload, about = self.picture(layer, "npy", threshold=threshold, as_of=as_of, step=step)
        return _array(payload, about)

    def raster(
        self,
        layer: MapLayer | str,
        *,
        threshold: float | None = None,
        as_of: AsOf = None,
        step: int = 1,
        timeout_s: float = 10.0,
    ) -> MapRaster:
        """A whole layer as the message that the ground answers with."""
        try:
            query = MapLayerQuery(
                layer=MapLayer(layer), step=step, threshold=threshold, as_of=None if as_of is None else str(as_of)
            )
        except ValidationError as error:
            raise InvalidInput(f"map: {one_line(error)}") from None
        except ValueError:
            known = ", ".join(each.value for each in MapLayer)
            raise InvalidInput(f"map: expected a layer out of {known}; got '{layer}'") from None
        raster: MapRaster = self._session.query(MAP_LAYER, query, timeout_s)
        return raster

    def box(
        self,
        layer: str,
        x: tuple[float, float],
        y: tuple[float, float],
        *,
        resolution_m: float | None = None,
        threshold: float | None = None,
        as_of: AsOf = None,
    ) -> LayerArray:
        """A part of a layer, between those edges [m], at that resolution."""
        payload, about = self.box_picture(
            layer, x, y, "npy", resolution_m=resolution_m, threshold=threshold, as_of=as_of
        )
        return _array(payload, MapAbout.model_validate_json(about))

    def box_picture(
        self,
        layer: str,
        x: tuple[float, float],
        y: tuple[float, float],
        form: str = "png",
        *,
        resolution_m: float | None = None,
        threshold: float | None = None,
        as_of: AsOf = None,
    ) -> tuple[bytes, bytes]:
        """A part of a layer as a file's bytes (json, npy, png, tiff or csv), and its description as JSON."""
        parameters = {
            "layer": layer, "x_min": x[0], "x_max": x[1], "y_min": y[0], "y_max": y[1],
            "resolution_m": resolution_m, "threshold": threshold, "as_of": as_of, "format": form,
        }  # fmt: skip
        return self._session.fetch(MAP_BOX, parameters)

    def picture(
        self,
        layer: str,
        form: str = "png",
        *,
        threshold: float | None = None,
        as_of: AsOf = None,
        step: int | None = None,
    ) -> tuple[bytes, MapAbout]:
        """A whole layer as a file's bytes (npy, png, tiff or csv), and its description as JSON."""
        parameters = {"layer": layer, "format": form, "threshold": threshold, "as_of": as_of, "step": step}
        payload, about = self._session.fetch(MAP_LAYER, parameters)
        if not about:
            raise InvalidInput(f"layer '{layer}' is a table: see table(), samples() and track()")
        return payload, MapAbout.model_validate_json(about)

    def table(self, layer: str, form: str = "json", *, as_of: AsOf = None) -> bytes:
        """A layer that is a table (samples or plan) as JSON or CSV text."""
        return self._session.fetch(MAP_LAYER, {"layer": layer, "format": form, "as_of": as_of})[0]

    def resource(
        self,
        polygon_m: Polygon | None = None,
        *,
        cutoff_ppb: float = 8.0,
        probability: float = 0.9,
        as_of: AsOf = None,
    ) -> ResourceEstimate:
        """Helium-3 in an area (the whole site without a polygon), with intervals from the joint posterior."""
        parameters = {
            "polygon": None if polygon_m is None else polygon_text(polygon_m),
            "cutoff_ppb": cutoff_ppb, "probability": probability, "as_of": as_of,
        }  # fmt: skip
        payload, _ = self._session.fetch(MAP_RESOURCE, parameters, timeout_s=AREA_WITHIN_S)
        return ResourceEstimate.model_validate_json(payload)

    def track(self, as_of: AsOf = None) -> MissionTrack:
        """Samples, driven and planned path."""
        payload, _ = self._session.fetch(TRACK, {"as_of": as_of})
        return MissionTrack.model_validate_json(payload)

    def samples(self, as_of: AsOf = None) -> np.recarray[Any, Any]:
        """The measurements as a table: sample_id, round, x_m, y_m, depth_m, helium3_ppb, noise_std_ppb, measured_at."""
        rows = [
            (s.sample_id, s.round, s.x_m, s.y_m, s.depth_m, s.helium3_ppb, s.noise_std_ppb, s.measured_at)
            for s in self.track(as_of).samples
        ]
        kinds = [
            ("sample_id", "U64"), ("round", np.int64), ("x_m", np.float64), ("y_m", np.float64),
            ("depth_m", np.float64), ("helium3_ppb", np.float64), ("noise_std_ppb", np.float64),
            ("measured_at", "datetime64[ns]"),
        ]  # fmt: skip
        return np.array(rows, dtype=kinds).view(np.recarray)

    def history(self) -> MapHistory:
        """The site, and the revisions that `as_of` can name."""
        return MapHistory.model_validate_json(self._session.fetch(MAP_HISTORY, {})[0])

    def score(self) -> MapScore:
        """How the map compares with the reference field, which exists only for a simulated Moon."""
        score: MapScore = self._session.query(MAP_SCORE, NoParameters())
        return score

    def cross_validation(self, as_of: AsOf = None) -> CrossValidation:
        """Each sample as all the others predict it: how good the map is where there is no reference field."""
        payload, _ = self._session.fetch(MAP_CROSS_VALIDATION, {"as_of": as_of}, timeout_s=AREA_WITHIN_S)
        return CrossValidation.model_validate_json(payload)

    def grade_tonnage(
        self,
        polygon_m: Polygon | None = None,
        *,
        cutoffs_ppb: Sequence[float] | None = None,
        probability: float = 0.9,
        as_of: AsOf = None,
    ) -> GradeTonnage:
        """How much ground of an area lies above each cut-off, and what it holds, with intervals."""
        parameters = {
            "polygon": None if polygon_m is None else polygon_text(polygon_m),
            "cutoffs": None if cutoffs_ppb is None else ",".join(f"{each:.9g}" for each in cutoffs_ppb),
            "probability": probability, "as_of": as_of,
        }  # fmt: skip
        payload, _ = self._session.fetch(MAP_GRADE_TONNAGE, parameters, timeout_s=AREA_WITHIN_S)
        return GradeTonnage.model_validate_json(payload)

    def realisations(self, count: int = 100, as_of: AsOf = None) -> Realisations:
        """Fields that the samples leave possible, drawn from the joint posterior of the whole site (1 to 1,000)."""
        payload, _ = self._session.fetch(MAP_REALISATIONS, {"count": count, "as_of": as_of}, timeout_s=AREA_WITHIN_S)
        found = MapRealisations.model_validate_json(payload)
        shape, cell = (found.count, found.rows, found.columns), found.resolution_m
        values = np.frombuffer(base64.b64decode(found.data_base64), dtype="<f4").reshape(shape)
        x, y = ((np.arange(cells) + 0.5) * cell for cells in (found.columns, found.rows))
        return Realisations(values, x, y, cell, found.revision, found.samples)

    def set_interest(
        self, area_id: str | None = None, polygon_m: Polygon | None = None, weight: float = 2.0
    ) -> tuple[InterestArea, ...]:
        """Weight the uncertainty in an area by `weight` when rounds are planned; without a polygon the area is removed.

        Returns all areas of interest; without an area id nothing is changed.
        """
        try:
            change = InterestChange(
                area_id=area_id,
                polygon_m=None if polygon_m is None else tuple((float(x), float(y)) for x, y in polygon_m),
                weight=float(weight),
                by=self.person,
            )
        except ValidationError as error:
            raise InvalidInput(f"interest: {one_line(error)}") from None
        listed: InterestList = (
            self._session.query(LIST_INTERESTS, NoParameters())
            if area_id is None and polygon_m is None
            else self._session.query(SET_INTEREST, change)
        )
        return listed.areas

    def passed_on(self, topic: Topic, parameters: dict[str, str]) -> tuple[bytes, bytes]:
        """The unchanged reply, and its attachment, to a map query given as selector parameters.

        For a gateway such as the page's server. Raises InvalidInput for parameters that the ground refuses.
        """
        return self._session.fetch(topic, parameters, timeout_s=AREA_WITHIN_S)


def polygon_text(polygon_m: Polygon) -> str:
    """Corners as a selector has them."""
    return ",".join(f"{float(value):.6g}" for corner in polygon_m for value in corner)


def _array(payload: bytes, about: MapAbout) -> LayerArray:
    values = np.load(io.BytesIO(payload), allow_pickle=False)
    x = about.x_min_m + (np.arange(about.columns) + 0.5) * about.resolution_m
    y = about.y_min_m + (np.arange(about.rows) + 0.5) * about.resolution_m
    return LayerArray(values, x, y, about)
