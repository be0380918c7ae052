"""The map of a recording, on all its cells: rebuilt from the recorded samples, for the files of `map_export`.

The belief is computed again as `verification` does, up to the revision that is asked for, and has to agree with the
recorded overview of it. The terrain is computed again from the scenario's region, the keep-outs of that revision and
the obstacles that the rover has reported.
"""

from __future__ import annotations

import base64
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, Final

import numpy as np

from he3.errors import He3Error, InvalidInput
from he3.frames import SiteGrid
from schemas.ground import MissionTrack
from schemas.maps import BELIEF, MapLayer, MapLayerQuery
from schemas.topics import EVENT, GROUND_STATUS, INTERESTS, MAP_OVERVIEW, SAMPLE, STATE
from services.console.map_export.contents import MapContents, RasterLayer, belief_layer
from services.console.map_export.region_layers import region_layers
from services.console.report.verification import TOLERANCE_AFTER_LOSS_PPB, Evidence, RebuiltBelief, difference
from services.ground.map.history import revision_at
from services.ground.map.layers import whole_layer
from services.ground.map.overview import reduced
from services.ground.map.region_account import region_account
from services.ground.map.snapshot import MapSnapshot
from services.ground.node import terrain_of
from services.ground.obstacles import MetObstacles
from services.mission.region_folder import is_recorded
from services.mission.regions import load_region
from services.recorder.about import REGION_RECORD
from services.recorder.foxglove.path import DrivenPath
from services.recorder.reader import Recording
from services.runtime.heartbeat import software_version

if TYPE_CHECKING:
    from pathlib import Path

    from he3.frames import BoolArray
    from he3.reference import Region
    from schemas.ground import InterestArea, MapOverview, MapValues
    from schemas.telemetry import RoverEvent
    from services.mission.scenario import Scenario

OF_REPORTS: Final = "the driven path is straight between the reports of the rover; a planned path is left out"


def recorded_map(
    path: Path, *, threshold_ppb: float, as_of: str | None = None, region: str | None = None
) -> MapContents:
    """The map of that recording, for an export.

    as_of: a revision or a mission time; None: the last one. region: where the mission's region is on this machine, if
    it is not where the scenario says. Raises InvalidInput for a recording without overviews of the map or without its
    scenario and for another region, He3Error where the map cannot be rebuilt.
    """
    evidence = Evidence(path, region)
    scenario = evidence.scenario
    heads = [overview.model_copy(update={"values": None}) for overview, _ in evidence.overviews()]
    if scenario is None or not heads:
        missing = "its scenario" if scenario is None else f"overviews of the map ({MAP_OVERVIEW.name})"
        raise InvalidInput(f"{path}: expected a recording with {missing}, got none")
    loaded = _region(scenario, evidence.about.get(REGION_RECORD), heads[0])
    overview, belief = _rebuilt(evidence, revision_at(heads, as_of).revision)
    facts = _Facts(path, overview)
    open_cells, notes = _open_cells(scenario, loaded, overview, facts)
    current = belief.belief.map
    account = region_account(scenario, loaded)
    samples = tuple(report for name, report in evidence.samples.items() if name in belief.belief)
    snapshot = MapSnapshot(
        grid=belief.belief.grid, mean_ppb=current.mean_ppb, std_ppb=current.std_ppb, traversable=open_cells,
        samples=samples, driven_path_m=tuple(facts.path.corners), planned_path_m=(), plan_ends=None,
        revision=overview.revision, mission_time_ns=overview.mission_time_ns, score=None, score_history=(),
        process=belief.belief.process, intervals=belief.belief.intervals,
    )  # fmt: skip

    interests = evidence.interests_at_first() if facts.interests is None else facts.interests

    def layer(name: MapLayer) -> RasterLayer:
        threshold = threshold_ppb if name is MapLayer.EXCEEDANCE else None
        cells = whole_layer(MapLayerQuery(layer=name, threshold=threshold), snapshot)
        return belief_layer(name, cells.values, cells.unit, len(samples), account, threshold)

    return MapContents(
        mission=facts.mission, region=account, revision=overview.revision, mission_time_ns=overview.mission_time_ns,
        layers=(*map(layer, BELIEF), *region_layers(loaded, account, current.mean_ppb, facts.simulated)),
        track=MissionTrack(
            samples=samples, driven_path_m=snapshot.driven_path_m, planned_path_m=(), score_history=(),
            keep_outs=overview.keep_outs, interests=interests,
        ),
        software=software_version(), simulated=facts.simulated, notes=(OF_REPORTS, *notes, *evidence.problems),
    )  # fmt: skip


class _Facts:
    """What the recording has up to one revision of the map, besides samples and plans."""

    def __init__(self, path: Path, overview: MapOverview) -> None:
        self.path = DrivenPath()
        self.events: list[RoverEvent] = []
        self.simulated = False
        """Whether the ground had a reference field to score the map with."""
        self.interests: tuple[InterestArea, ...] | None = None
        """The areas of interest when that revision was last shown; None if none had been set until then."""
        recording = Recording(path)
        seen: set[tuple[int, int]] = set()
        shown = True  # until the next revision came
        for message in recording.messages():
            body, header = message.body, message.header
            if message.topic is MAP_OVERVIEW:
                shown = shown and body.revision <= overview.revision
            elif message.topic is INTERESTS and shown:
                self.interests = body.areas
            if message.received_at > overview.mission_time_ns:
                continue
            if message.topic is STATE:
                self.path.add(header.made_at, (body.x_m, body.y_m))
            elif message.topic is SAMPLE:
                self.path.add(body.measured_at, (body.x_m, body.y_m))
            elif message.topic is EVENT and (header.incarnation, header.sequence) not in seen:
                seen.add((header.incarnation, header.sequence))
                self.path.add(body.at, (body.x_m, body.y_m))
                self.events.append(body)
            elif message.topic is GROUND_STATUS:
                self.simulated = self.simulated or body.score is not None
        self.mission = recording.mission


def _rebuilt(evidence: Evidence, revision: int) -> tuple[MapOverview, RebuiltBelief]:
    """The overview of that revision, and the belief rebuilt up to it; raises He3Error if they do not agree."""
    belief: RebuiltBelief | None = None
    for overview, values in evidence.overviews():
        if belief is None:
            belief = RebuiltBelief(overview, evidence)
        elif overview.revision <= belief.revision:
            continue  # a repetition
        belief.follow(overview)
        if overview.revision >= revision:
            if values is not None:
                _check(overview, values, belief)
            return overview, belief
    raise He3Error(f"expected an overview of revision {revision}, got none")


def _check(overview: MapOverview, values: MapValues, rebuilt: RebuiltBelief) -> None:
    """Raise He3Error unless mean and standard deviation are those of the overview."""
    current, shape = rebuilt.belief.map, (values.rows, values.columns)
    largest = max(
        difference(values.mean_base64, shape, reduced(current.mean_ppb, overview.step)),
        difference(values.std_base64, shape, reduced(current.std_ppb, overview.step)),
    )
    if largest > TOLERANCE_AFTER_LOSS_PPB:
        raise He3Error(
            f"revision {overview.revision}: the rebuilt map differs from the recorded one by {largest:.2g} ppb "
            "(see he3 replay --verify)"
        )


def _region(scenario: Scenario, recorded: dict[str, str] | None, overview: MapOverview) -> Region:
    """The region of that scenario; raises InvalidInput unless it has the map's grid and layers of the same origin."""
    found = load_region(scenario.region, scenario.field.field_seed)
    if not is_recorded(scenario.region, recorded) or found.grid != SiteGrid(
        overview.rows, overview.columns, overview.resolution_m
    ):
        raise InvalidInput(f"{scenario.region}: expected the mission's region, got another region")
    return found


def _open_cells(
    scenario: Scenario, region: Region, overview: MapOverview, facts: _Facts
) -> tuple[BoolArray, tuple[str, ...]]:
    """Where the rover's centre may be in that revision, and a line if the overview does not have the same."""
    terrain = terrain_of(scenario, region)
    obstacles = MetObstacles(terrain)
    for event in facts.events:
        obstacles.close_off(event)
    areas = {
        area_id: [area.polygon_m for area in group]
        for area_id, group in groupby(overview.keep_outs, key=attrgetter("area_id"))
    }
    for area_id in {*terrain.areas, *areas}:
        terrain.set_keep_out(area_id, areas.get(area_id, ()))
    if overview.values is None:
        return terrain.traversable, ()
    recorded = np.frombuffer(base64.b64decode(overview.values.traversable_base64), dtype=np.uint8) > 0
    differing = int(np.count_nonzero(recorded != reduced(terrain.traversable, overview.step).ravel()))
    note = f"open ground differs from the recorded overview in {differing} of {recorded.size} places"
    return terrain.traversable, (note,) if differing else ()
