"""A mission from Python: the map as arrays, samples as a table, commands with their stages, news as they come.

    from services.console import MissionClient

    with MissionClient() as mission:                      # the one that runs on this machine; else earth=, mission=
        mission.point(120, 340)                           # posterior at a place
        mean = mission.layer("mean")                      # .values (rows, columns), .x_m, .y_m, .unit, .revision
        rich = mission.layer("exceedance", threshold=9)
        mission.samples()                                 # a NumPy record array, a row a measurement
        mission.resource([(100, 100), (200, 100), (150, 200)], cutoff_ppb=9)
        mission.command("pause").wait("completed")        # staged acknowledgement, light time and all
        for news in mission.live(timeout_s=60):           # status, samples, events, command stages
            ...

Everything asked here is asked over Zenoh as any client may (docs/map-queries.md); nothing holds the mission up.
"""

from __future__ import annotations

import io
import json
import queue
import time
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from he3.errors import He3Error, InvalidInput
from schemas.codec import one_line
from schemas.commands import CommandKind, CommandList, CommandStatus, NoParameters, Telecommand
from schemas.ground import GroundStatus, InterestArea, InterestChange, InterestList, MissionTrack
from schemas.link import ClockMode, ClockState, LinkChange, LinkStatus
from schemas.maps import MapAbout, MapHistory, MapPoint, MapScore, ResourceEstimate
from schemas.topics import (
    COMMAND_STATUS,
    EARTH_CLOCK,
    EVENT,
    GROUND_STATUS,
    ISSUE_COMMAND,
    LINK_SET,
    LINK_STATUS,
    LIST_COMMANDS,
    MAP_BOX,
    MAP_FEED,
    MAP_HISTORY,
    MAP_LAYER,
    MAP_POINT,
    MAP_RESOURCE,
    MAP_SCORE,
    SAMPLE,
    SET_INTEREST,
    STATE,
    TRACK,
    Topic,
)
from schemas.wire import Header, Wire
from services.console.client.command_handle import CommandHandle
from services.console.client.run_file import find
from services.ground.map.feed import FeedMap, FeedReader
from services.runtime.clock import mission_time
from services.runtime.node import MissionTime, seconds
from services.runtime.transport.client import Client

NEWS: tuple[Topic, ...] = (GROUND_STATUS, SAMPLE, EVENT, STATE, COMMAND_STATUS, LINK_STATUS)

Polygon = Sequence[tuple[float, float]]
AsOf = int | str | None


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


@dataclass(frozen=True, slots=True)
class News:
    """Something that was said: by whom, when [ns of mission time], and what."""

    topic: str
    source: str
    made_at: MissionTime
    body: Wire


class MissionClient:
    """A session with a running mission. Use it in a `with` statement; its methods may be called from any thread."""

    def __init__(self, earth: str | None = None, mission: str | None = None, name: str = "operator") -> None:
        """Joins the mission that runs on this machine, or the one named.

        Raises PeerUnreachable when there is none, InvalidInput when there are several.
        """
        self.earth, self.mission = find(mission, earth)
        self._client = Client(self.earth, self.mission, name)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self._client.close()

    @property
    def client(self) -> Client:
        """The session itself, for topics that have no method here."""
        return self._client

    # --- the mission ------------------------------------------------------------------------------------------------

    def status(self) -> GroundStatus:
        """The mission as the ground sees it."""
        status: GroundStatus = self._client.latest(GROUND_STATUS)[1]
        return status

    def link(self) -> LinkStatus:
        """The link, with what is on its way."""
        status: LinkStatus = self._client.latest(LINK_STATUS)[1]
        return status

    def clock(self) -> ClockState:
        """The mission's clock."""
        state: ClockState = self._client.latest(EARTH_CLOCK)[1]
        return state

    def now(self) -> MissionTime:
        """Mission time [ns]; in lockstep that of the last word of the ground."""
        header, clock = self._client.latest(EARTH_CLOCK)
        if clock.mode is ClockMode.LOCKSTEP:
            return header.made_at
        return mission_time(clock, time.time_ns())

    def set_link(self, **change: Any) -> LinkStatus:
        """Change conditions, such as ``one_way_light_time_s=3`` or ``loss=0.1``; returns the link as it is then."""
        return self.set_link_from_json(change)

    def set_link_from_json(self, change: dict[str, Any]) -> LinkStatus:
        """The same for values as JSON has them, where enumerations are words."""
        try:
            wanted = LinkChange.model_validate_json(json.dumps(change))
        except ValidationError as error:
            raise InvalidInput(f"link: {one_line(error)}") from None
        status: LinkStatus = self._client.query(LINK_SET, wanted)
        return status

    # --- the map ----------------------------------------------------------------------------------------------------

    def point(self, x: float, y: float, threshold: float | None = None, as_of: AsOf = None) -> MapPoint:
        """The posterior at a place [m]; with a threshold [ppb], also the probability of more than that."""
        payload, _ = self._client.fetch(MAP_POINT, {"x": x, "y": y, "threshold": threshold, "as_of": as_of})
        return MapPoint.model_validate_json(payload)

    def layer(
        self, layer: str, *, threshold: float | None = None, as_of: AsOf = None, step: int | None = None
    ) -> LayerArray:
        """A whole layer: mean, std, information, exceedance (with a threshold [ppb]) or traversable."""
        payload, about = self.picture(layer, "npy", threshold=threshold, as_of=as_of, step=step)
        return _array(payload, about)

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
        parameters = {
            "layer": layer, "x_min": x[0], "x_max": x[1], "y_min": y[0], "y_max": y[1],
            "resolution_m": resolution_m, "threshold": threshold, "as_of": as_of, "format": "npy",
        }  # fmt: skip
        payload, about = self._client.fetch(MAP_BOX, parameters)
        return _array(payload, MapAbout.model_validate_json(about))

    def picture(
        self,
        layer: str,
        form: str = "png",
        *,
        threshold: float | None = None,
        as_of: AsOf = None,
        step: int | None = None,
    ) -> tuple[bytes, MapAbout]:
        """A whole layer as a file's bytes (npy, png, tiff or csv), and what it shows."""
        parameters = {"layer": layer, "format": form, "threshold": threshold, "as_of": as_of, "step": step}
        payload, about = self._client.fetch(MAP_LAYER, parameters)
        if not about:
            raise InvalidInput(f"layer '{layer}' is a table: see samples() and track()")
        return payload, MapAbout.model_validate_json(about)

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
        payload, _ = self._client.fetch(MAP_RESOURCE, parameters, timeout_s=30.0)
        return ResourceEstimate.model_validate_json(payload)

    def track(self, as_of: AsOf = None) -> MissionTrack:
        """Samples, driven and planned path."""
        payload, _ = self._client.fetch(TRACK, {"as_of": as_of})
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
        return MapHistory.model_validate_json(self._client.fetch(MAP_HISTORY, {})[0])

    def score(self) -> MapScore:
        """How the map compares with the truth, which only a simulated Moon can tell."""
        return MapScore.model_validate_json(self._client.fetch(MAP_SCORE, {})[0])

    # --- commands ---------------------------------------------------------------------------------------------------

    def command(
        self,
        kind: CommandKind | str,
        *,
        target_m: tuple[float, float] | None = None,
        area_id: str | None = None,
        polygon_m: Polygon | None = None,
        expires_in_s: float | None = None,
        command_id: str | None = None,
    ) -> CommandHandle:
        """Send a telecommand; what comes back follows it through its stages. Equal ids execute once.

        Raises InvalidInput or He3Error, in one line, for one that cannot go up.
        """
        try:
            command = Telecommand(
                command_id=command_id or f"op-{uuid.uuid4().hex[:10]}",
                kind=CommandKind(str(kind).replace("-", "_")),
                expires_at=None if expires_in_s is None else self.now() + seconds(expires_in_s),
                target_m=target_m,
                area_id=area_id,
                polygon_m=None if polygon_m is None else tuple((float(x), float(y)) for x, y in polygon_m),
            )
        except ValidationError as error:
            raise InvalidInput(f"command: {one_line(error)}") from None
        except ValueError:
            known = ", ".join(each.value for each in CommandKind)
            raise InvalidInput(f"command: expected one of {known}; got '{kind}'") from None
        return CommandHandle(self._client, self._client.query(ISSUE_COMMAND, command))

    def set_interest(
        self, area_id: str | None = None, polygon_m: Polygon | None = None, weight: float = 2.0
    ) -> tuple[InterestArea, ...]:
        """Make an area worth `weight` times as much to the planner, or take it back (no polygon); returns all of them.

        Without an area it only asks.
        """
        try:
            change = InterestChange(
                area_id=area_id,
                polygon_m=None if polygon_m is None else tuple((float(x), float(y)) for x, y in polygon_m),
                weight=float(weight),
            )
        except ValidationError as error:
            raise InvalidInput(f"interest: {one_line(error)}") from None
        listed: InterestList = self._client.query(SET_INTEREST, change)
        return listed.areas

    def commands(self) -> tuple[CommandStatus, ...]:
        """All commands with the stages they passed, oldest first."""
        listed: CommandList = self._client.query(LIST_COMMANDS, NoParameters())
        return listed.commands

    # --- as it happens ----------------------------------------------------------------------------------------------

    def live(self, *topics: Topic, timeout_s: float | None = None) -> Iterator[News]:
        """What is said from now on, as it comes; ends after `timeout_s` of wall time, never without one.

        topics: what to listen to (`NEWS` without any). Whoever reads slowly misses the oldest, and holds nobody up.
        """
        heard: queue.Queue[News] = queue.Queue(maxsize=10_000)

        def keep(name: str, header: Header, body: Wire) -> None:
            while True:
                try:
                    heard.put_nowait(News(name, header.source, header.made_at, body))
                    return
                except queue.Full:
                    heard.get_nowait()

        ends = [self._client.subscribe(topic, partial(keep, topic.name)) for topic in topics or NEWS]
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        try:
            while deadline is None or time.monotonic() < deadline:
                try:
                    yield heard.get(timeout=0.2)
                except queue.Empty:
                    continue
        finally:
            for end in ends:
                end()

    def maps(self, timeout_s: float | None = None) -> Iterator[FeedMap]:
        """The map with every change, from the feed: equal to the ground's to the byte. Ends after `timeout_s`."""
        reader = FeedReader()
        frames: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        end = self._client.subscribe_raw(MAP_FEED, frames.put)
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        try:
            while deadline is None or time.monotonic() < deadline:
                if reader.needs_key:
                    self._ask_for_key(frames)
                try:
                    changed = reader.take(frames.get(timeout=0.2))
                except (queue.Empty, InvalidInput):
                    continue  # nothing, a stranger's or a damaged one: a key frame follows
                if changed and reader.map is not None:
                    yield reader.map
        finally:
            end()

    def _ask_for_key(self, frames: queue.SimpleQueue[bytes]) -> None:
        try:
            frames.put(self._client.fetch(MAP_FEED, {})[0])
        except He3Error:
            time.sleep(0.2)  # there is no map yet, or nobody is there; what comes meanwhile is kept


def polygon_text(polygon_m: Polygon) -> str:
    """Corners as a selector has them."""
    return ",".join(f"{float(value):.6g}" for corner in polygon_m for value in corner)


def _array(payload: bytes, about: MapAbout) -> LayerArray:
    values = np.load(io.BytesIO(payload), allow_pickle=False)
    x = about.x_min_m + (np.arange(about.columns) + 0.5) * about.resolution_m
    y = about.y_min_m + (np.arange(about.rows) + 0.5) * about.resolution_m
    return LayerArray(values, x, y, about)
