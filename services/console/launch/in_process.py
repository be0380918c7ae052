"""A whole mission in this process, with its progress and its files."""

from __future__ import annotations

import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING

from he3.errors import InvalidInput
from schemas.commands import NoParameters
from schemas.link import LinkStatus
from schemas.maps import CrossValidation, CrossValidationQuery, MapLayer, MapLayerQuery, MapRaster, MapScore
from schemas.topics import LINK_SHOW, MAP_CROSS_VALIDATION, MAP_LAYER, MAP_SCORE, TRACK
from services.console.interruption import end_if_told
from services.console.launch.terrain_facts import terrain_facts
from services.console.report.mission_report import Outcome, Run, gather
from services.console.report.outputs import Outputs, Written, claimed, write_outcome
from services.console.report.progress import Moment, Progress, moment_of
from services.mission.in_process import RECORDING_FLUSH_S, InProcessMission, build_nodes
from services.runtime.event_log import EventLog, lacks_of_merged

if TYPE_CHECKING:
    from he3.reference import Region
    from schemas.ground import MissionTrack
    from services.link.node import LinkNode
    from services.mission.scenario import Scenario
    from services.runtime.node import Node


def run_in_process(
    scenario: Scenario, where: Outputs, progress: Progress, events: Path | None = None, *, scores_rounds: bool = True
) -> Written:
    """The report of the mission, run to its end, and the files written. events: where the event log goes.

    scores_rounds: whether the map is computed and scored after every round, not only at the end.

    A mission that fails has a report too. Raises InvalidInput before anything is written.
    """
    from services.mission.regions import load_region

    if scenario.ground.approval == "operator":
        raise InvalidInput(
            'ground.approval: expected "auto" for a mission in one process, which no operator can reach, got "operator"'
        )
    region = load_region(scenario.region, scenario.field.field_seed)
    seen = where.recording is not None or events is not None
    nodes = build_nodes(scenario, region, map_use="always" if seen else "rounds" if scores_rounds else "asked")
    with claimed(where, events):
        outcome, problems = _run_in_process(scenario, region, nodes, where, progress, events)
        return write_outcome(outcome, region, where, events, problems)


def _run_in_process(
    scenario: Scenario, region: Region, nodes: tuple[Node, ...], where: Outputs, progress: Progress, events: Path | None
) -> tuple[Outcome, list[str]]:
    """The outcome of the mission, and one line on each output that could not be written while it ran."""
    from services.ground.pure_tasks import MissionExecutor
    from services.link.node import LinkNode
    from services.recorder.about import about
    from services.recorder.files import open_recording
    from services.recorder.node import build_node as build_recorder
    from services.recorder.sink import RecordingSink

    began = time.monotonic()
    sink: RecordingSink | None = None
    problems: list[str] = []
    link = next(node for node in nodes if isinstance(node, LinkNode))
    with ExitStack() as stack:
        if where.recording is not None:
            recording = open_recording(where.recording)
            sink = stack.enter_context(RecordingSink(recording, scenario.name, about=about(scenario)))
            nodes = (*nodes, build_recorder(scenario, sink, RECORDING_FLUSH_S))
        executor = stack.enter_context(MissionExecutor())
        log = None if events is None else stack.enter_context(closing(EventLog(events)))
        mission = InProcessMission(scenario, executor, log, nodes)
        stack.enter_context(progress)

        def watch() -> None:
            end_if_told()
            progress.show(lambda: _moment(mission, link))

        mission.run(watch)
        if log is not None and events is not None:
            log.close()  # the queries for the report are no part of the mission
            problems += lacks_of_merged([events], events, [] if log.problem is None else [log.problem])
        assert mission.status is not None, "the run ends only after the ground has reported its status"
        wall_time_s = time.monotonic() - began
        run = Run(
            "in-process",
            None,
            region.provenance,
            mission.mission_time_s,
            wall_time_s,
            region.layers,
            *terrain_facts(scenario, region),
        )
        outcome = gather(_Asked(mission), scenario, mission.status, run)
    if sink is not None and sink.problem is not None:
        problems.append(sink.problem)
    return outcome, problems


class _Asked:
    """The queries for the report, put to a mission in this process."""

    def __init__(self, mission: InProcessMission) -> None:
        self._mission = mission

    def track(self) -> MissionTrack:
        track: MissionTrack = self._mission.ask(TRACK, NoParameters())
        return track

    def link(self) -> LinkStatus:
        status: LinkStatus = self._mission.ask(LINK_SHOW, NoParameters())
        return status

    def raster(self, layer: MapLayer) -> MapRaster:
        raster: MapRaster = self._mission.ask(MAP_LAYER, MapLayerQuery(layer=layer))
        return raster

    def cross_validation(self) -> CrossValidation:
        found: CrossValidation = self._mission.ask(MAP_CROSS_VALIDATION, CrossValidationQuery())
        return found

    def score(self) -> MapScore:
        score: MapScore = self._mission.ask(MAP_SCORE, NoParameters())
        return score


def _moment(mission: InProcessMission, link: LinkNode) -> Moment:
    return moment_of(mission.status, mission.mission_time_s, link.in_flight)
