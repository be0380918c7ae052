"""Foxglove's messages, made of each of ours: the map, the samples, the paths, the rover, its position, a log.

Foxglove and Rerun show the last message of each topic at the time that is looked at. So each message but a marker and
a log line is whole: it needs none before it. Its time stamp and its publish time are those at which our message was
made, in mission time; its log time is when our message was received on Earth.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from schemas.commands import CommandStage
from schemas.ground import MissionPhase
from schemas.telemetry import EventKind
from schemas.topics import COMMAND_STATUS, EVENT, GROUND_STATUS, LINK_STATUS, MAP_OVERVIEW, PLAN, SAMPLE, STATE
from services.recorder.foxglove import scene
from services.recorder.foxglove.path import DrivenPath
from services.recorder.foxglove.picture import picture
from services.recorder.foxglove.position import Site
from services.recorder.foxglove.schemas import encoded

if TYPE_CHECKING:
    from he3.frames import Float32Array, Place
    from schemas.commands import CommandStatus
    from schemas.ground import GroundStatus, KeepOutArea, MapOverview, MapValues, MissionTrack
    from schemas.link import LinkStatus
    from schemas.plans import MissionPlan
    from schemas.telemetry import RoverEvent, RoverState, SampleReport
    from schemas.topics import Topic
    from schemas.wire import Header
    from services.mission.mission_time import MissionTime

CHANNELS: Final[dict[str, str]] = {
    "/map/mean": "Grid",
    "/map/std": "Grid",
    "/map/open": "Grid",
    "/map/picture": "CompressedImage",
    "/keep_outs": "SceneUpdate",
    "/samples": "PointCloud",
    "/samples/markers": "SceneUpdate",
    "/plan": "SceneUpdate",
    "/rover": "SceneUpdate",
    "/rover/path": "SceneUpdate",
    "/rover/position": "LocationFix",
    "/tf/moon": "FrameTransform",
    "/tf/rover": "FrameTransform",
    "/log": "Log",
}
"""The schema of each topic."""

MOON: Final = "moon"
"""The frame that turns with the Moon, from its centre: x towards (0, 0), z towards the north pole."""
ROVER: Final = "rover"
"""The rover's frame: x forward, z up."""

STEP_PPB: Final = 2.0**-10
"""Mean and standard deviation in the grids are multiples of it, which halves their size in a file. Our own message
beside them has every digit."""

_INFO, _WARNING, _ERROR = 2, 3, 4
_LEVELS: Final = {
    EventKind.SAFE_MODE_ENTERED: _ERROR,
    **dict.fromkeys(
        (
            EventKind.PLAN_REJECTED, EventKind.ROUND_ABORTED, EventKind.SAMPLE_SKIPPED, EventKind.BLOCKED,
            EventKind.LOW_ENERGY, EventKind.INSTRUMENT_SILENT,
        ),
        _WARNING,
    ),
}  # fmt: skip
_UNHAPPY: Final = frozenset({CommandStage.REJECTED, CommandStage.FAILED, CommandStage.EXPIRED, CommandStage.LOST})

_PATH: Final[scene.Colour] = (1.0, 1.0, 1.0, 0.9)
_PLANNED: Final[scene.Colour] = (0.25, 0.7, 1.0, 0.9)
_KEEP_OUT: Final[scene.Colour] = (1.0, 0.25, 0.2, 1.0)
_ROVER: Final[scene.Colour] = (1.0, 0.75, 0.1, 1.0)
_LINE_M, _PLAN_UP_M, _PATH_UP_M, _SAMPLE_M = 0.6, 0.3, 0.5, 3.0  # sizes that are seen from above a site of 500 m


@dataclass(frozen=True, slots=True)
class Derived:
    """One message in a schema of Foxglove's."""

    topic: str
    """One of ``CHANNELS``."""
    payload: bytes
    made_at: MissionTime


class Derivation:
    """What is known of a mission from its messages; each of them may add some of Foxglove's."""

    def __init__(self) -> None:
        self._site: Site | None = None
        self._path = DrivenPath()
        self._rover_at = (0, -1)  # start of the rover, and mission time
        self._samples: dict[str, SampleReport] = {}
        self._plan_revision = 0
        self._map_revision = -1
        self._keep_outs: tuple[KeepOutArea, ...] | None = None
        self._events: set[tuple[int, int]] = set()
        self._stages: dict[str, int] = {}
        self._phase: MissionPhase | None = None
        self._contact: bool | None = None
        self._makers: dict[Topic, Callable[[Any, Header], Iterator[Derived]]] = {
            STATE: self._of_state,
            SAMPLE: self._of_sample,
            EVENT: self._of_event,
            PLAN: self._of_plan,
            MAP_OVERVIEW: self._of_overview,
            COMMAND_STATUS: self._of_command,
            GROUND_STATUS: self._of_ground,
            LINK_STATUS: self._of_link,
        }

    def of(self, topic: Topic, header: Header, body: Any) -> Iterator[Derived]:
        """The messages that follow from that one; none from one that is repeated or overtaken."""
        made = self._makers.get(topic)
        return iter(()) if made is None else made(body, header)

    def of_track(self, track: MissionTrack, made_at: MissionTime) -> Iterator[Derived]:
        """The messages that follow from the ground's account of the mission so far: for a reader who joins late.

        Its path stands for all reports before, if there were none yet; its plan takes the place of an earlier one.
        """
        if self._path.is_empty:
            for number, place in enumerate(track.driven_path_m):  # before every report, whose times are in nanoseconds
                self._path.add(number, place)
            yield from self._whole_path(made_at)
        new = [sample for sample in track.samples if sample.sample_id not in self._samples]
        self._samples |= {sample.sample_id: sample for sample in new}
        if new:
            yield from self._cloud(made_at)
            yield from (self._marker(sample, made_at) for sample in new)
        line = scene.line(track.planned_path_m, _PLAN_UP_M, _PLANNED, _LINE_M)
        planned = scene.entity("plan", made_at, lines=[line] if track.planned_path_m else [])
        yield _derived("/plan", made_at, {"entities": [planned]})

    # --- the rover ---------------------------------------------------------------------------------------------------

    def _of_state(self, state: RoverState, header: Header) -> Iterator[Derived]:
        made_at = header.made_at
        if (header.incarnation, made_at) <= self._rover_at:
            return
        self._rover_at = (header.incarnation, made_at)
        place = (state.x_m, state.y_m)
        turn = scene.heading(state.heading_deg)
        yield _derived("/tf/rover", made_at, {
            "timestamp": scene.timestamp(made_at), "parent_frame_id": scene.SITE, "child_frame_id": ROVER,
            "translation": {"x": place[0], "y": place[1]}, "rotation": turn,
        })  # fmt: skip
        yield from self._position(place, state.heading_deg, made_at)
        yield from self._drove(made_at, place, made_at)
        yield _derived("/rover", made_at, {"entities": [self._rover(state, place, turn, made_at)]})

    def _rover(self, state: RoverState, place: Place, turn: scene.Fields, made_at: MissionTime) -> scene.Fields:
        body = {"pose": scene.pose(place, 0.8, turn), "size": {"x": 3.0, "y": 2.0, "z": 1.6}}
        arrow = {"pose": scene.pose(place, 2.0, turn), "shaft_length": 4.0, "shaft_diameter": 0.6, "head_length": 2.0}
        shown = {"color": scene.colour(_ROVER)}
        lines = [scene.line(self._path.new, _PATH_UP_M, _PATH, _LINE_M)] if len(self._path.new) > 1 else []
        about = {
            "mode": state.mode.value, "round": state.round, "driven_m": f"{state.driven_m:.1f}",
            "energy_wh": f"{state.energy_wh:.0f}", "samples": state.samples_done,
        }  # fmt: skip
        return scene.entity(
            ROVER, made_at, about, cubes=[body | shown], arrows=[arrow | {"head_diameter": 1.6} | shown], lines=lines,
            texts=[scene.text(state.mode.value, place, 6.0, scene.WHITE)],
        )  # fmt: skip

    def _position(self, place: Place, heading_deg: float, made_at: MissionTime) -> Iterator[Derived]:
        if self._site is not None:
            latitude, longitude = self._site.degrees(place)
            yield _derived("/rover/position", made_at, {
                "timestamp": scene.timestamp(made_at), "frame_id": ROVER, "latitude": latitude, "longitude": longitude,
                "heading": np.radians(heading_deg),
            })  # fmt: skip

    def _drove(self, at: MissionTime, place: Place, made_at: MissionTime) -> Iterator[Derived]:
        self._path.add(at, place)
        return self._whole_path(made_at)

    def _whole_path(self, made_at: MissionTime) -> Iterator[Derived]:
        path = self._path.whole()
        if path is not None:
            line = scene.line(path, _PATH_UP_M, _PATH, _LINE_M)
            yield _derived("/rover/path", made_at, {"entities": [scene.entity("path", made_at, lines=[line])]})

    def _of_sample(self, sample: SampleReport, header: Header) -> Iterator[Derived]:
        if sample.sample_id in self._samples:
            return
        self._samples[sample.sample_id] = sample
        yield from self._drove(sample.measured_at, (sample.x_m, sample.y_m), header.made_at)
        yield from self._cloud(header.made_at)
        yield self._marker(sample, header.made_at)

    def _cloud(self, made_at: MissionTime) -> Iterator[Derived]:
        known = self._samples.values()
        places, values = [(each.x_m, each.y_m) for each in known], [each.helium3_ppb for each in known]
        yield _derived("/samples", made_at, scene.cloud(made_at, places, _PATH_UP_M, "helium3_ppb", values))

    def _marker(self, sample: SampleReport, made_at: MissionTime) -> Derived:
        values = [each.helium3_ppb for each in self._samples.values()]
        shade = scene.shade(sample.helium3_ppb, min(values), max(values), "viridis")
        ball = scene.sphere((sample.x_m, sample.y_m), _SAMPLE_M, shade)
        about = {
            "helium3_ppb": f"{sample.helium3_ppb:.3f}", "noise_std_ppb": f"{sample.noise_std_ppb:g}",
            "depth_m": f"{sample.depth_m:g}", "round": sample.round, "measured_at_ns": sample.measured_at,
        }  # fmt: skip
        marker = scene.entity(sample.sample_id, made_at, about, spheres=[ball])
        return _derived("/samples/markers", made_at, {"entities": [marker]})

    def _of_event(self, event: RoverEvent, header: Header) -> Iterator[Derived]:
        key = (header.incarnation, header.sequence)
        if key in self._events:
            return  # repeated, as custody does until it is acknowledged
        self._events.add(key)
        yield from self._drove(event.at, (event.x_m, event.y_m), header.made_at)
        what = [event.kind.value.replace("_", " ")]
        what += [f"round {event.round}"] if event.round else []
        what += [f"sample {event.sample_id}"] if event.sample_id else []
        what += [event.detail] if event.detail else []
        yield _log(header.made_at, _LEVELS.get(event.kind, _INFO), ROVER, ": ".join(what))

    def _of_plan(self, plan: MissionPlan, header: Header) -> Iterator[Derived]:
        if plan.revision <= self._plan_revision:
            return
        self._plan_revision, made_at = plan.revision, header.made_at
        lines = [scene.line(each.path_m, _PLAN_UP_M, _PLANNED, _LINE_M) for each in plan.rounds]
        balls = [
            scene.sphere((sample.x_m, sample.y_m), _SAMPLE_M / 2, _PLANNED)
            for each in plan.rounds
            for sample in each.samples
        ]
        about = {"revision": plan.revision, "rounds": len(plan.rounds), "first_round": plan.rounds[0].round}
        planned = scene.entity("plan", made_at, about, lines=lines, spheres=balls)
        yield _derived("/plan", made_at, {"entities": [planned]})

    # --- the map -----------------------------------------------------------------------------------------------------

    def _of_overview(self, overview: MapOverview, header: Header) -> Iterator[Derived]:
        if overview.revision <= self._map_revision:
            return
        self._map_revision, made_at = overview.revision, header.made_at
        yield from self._place(overview, made_at)
        if overview.values is not None:
            yield from self._layers(overview.values, overview.step * overview.resolution_m, made_at)
        if overview.keep_outs != self._keep_outs:
            self._keep_outs = overview.keep_outs
            lines = [
                scene.line(area.polygon_m, _PATH_UP_M, _KEEP_OUT, _LINE_M, scene.LINE_LOOP)
                for area in overview.keep_outs
            ]
            about = {"areas": ", ".join(dict.fromkeys(area.area_id for area in overview.keep_outs))}
            yield _derived(
                "/keep_outs", made_at, {"entities": [scene.entity("keep-outs", made_at, about, lines=lines)]}
            )

    def _layers(self, values: MapValues, cell_m: float, made_at: MissionTime) -> Iterator[Derived]:
        shape = values.rows, values.columns
        mean, std = (_rounded(layer).reshape(shape) for layer in (values.mean_base64, values.std_base64))
        is_open = np.frombuffer(base64.b64decode(values.traversable_base64), dtype=np.uint8).reshape(shape)
        for topic, field, kind, layer in (
            ("/map/mean", "mean_ppb", scene.FLOAT32, mean),
            ("/map/std", "std_ppb", scene.FLOAT32, std),
            ("/map/open", "open", scene.UINT8, is_open),
        ):
            fields = scene.grid(made_at, values.columns, cell_m, field, kind, layer.tobytes())
            yield _derived(topic, made_at, fields)
        image = picture(mean, is_open > 0)
        if image is not None:
            fields = {"timestamp": scene.timestamp(made_at), "frame_id": scene.SITE, "format": "png", "data": image}
            yield _derived("/map/picture", made_at, fields)

    def _place(self, overview: MapOverview, made_at: MissionTime) -> Iterator[Derived]:
        latitude, longitude = overview.origin_lat_deg, overview.origin_lon_deg
        if self._site is not None or latitude is None or longitude is None:
            return
        self._site = Site(latitude, longitude, overview.rows * overview.resolution_m)
        # The site is the root of the frames, so that a viewer begins there, and not in the middle of the Moon.
        yield _derived("/tf/moon", made_at, {
            "timestamp": scene.timestamp(made_at), "parent_frame_id": scene.SITE, "child_frame_id": MOON,
            "translation": dict(zip("xyz", self._site.moon_centre_m, strict=True)),
            "rotation": dict(zip("xyzw", self._site.moon_turn, strict=True)),
        })  # fmt: skip

    # --- the log -----------------------------------------------------------------------------------------------------

    def _of_command(self, status: CommandStatus, header: Header) -> Iterator[Derived]:
        command, logged = status.command, self._stages.get(status.command.command_id, 0)
        self._stages[command.command_id] = max(logged, len(status.stages))
        for report in status.stages[logged:]:
            words = f"command {command.kind.value}: {report.stage.value}" + (f": {report.why}" if report.why else "")
            level = _WARNING if report.stage in _UNHAPPY else _INFO
            yield _log(header.made_at, level, "ground", f"{words} ({command.by})" if command.by else words)

    def _of_ground(self, status: GroundStatus, header: Header) -> Iterator[Derived]:
        if status.phase is self._phase:
            return
        self._phase = status.phase
        level = _ERROR if status.phase is MissionPhase.FAILED else _INFO
        words = f"mission {status.phase.value}" + (f": {status.detail}" if status.detail else "")
        yield _log(header.made_at, level, "ground", words)

    def _of_link(self, status: LinkStatus, header: Header) -> Iterator[Derived]:
        before, self._contact = self._contact, status.contact
        if before is not None and before is not status.contact:
            yield _log(header.made_at, _INFO if status.contact else _WARNING, "link", _CONTACT[status.contact])


_CONTACT: Final = {True: "contact", False: "no contact"}


def _rounded(layer_base64: str) -> Float32Array:
    """The values of a layer, rounded to whole steps of `STEP_PPB`."""
    values = np.frombuffer(base64.b64decode(layer_base64), dtype="<f4")
    return np.asarray(np.round(values / STEP_PPB) * STEP_PPB, dtype="<f4")


def _derived(topic: str, made_at: MissionTime, fields: scene.Fields) -> Derived:
    return Derived(topic, encoded(CHANNELS[topic], fields), made_at)


def _log(made_at: MissionTime, level: int, name: str, words: str) -> Derived:
    fields = {"timestamp": scene.timestamp(made_at), "level": level, "message": words, "name": name}
    return _derived("/log", made_at, fields)
