"""The task of a campaign that flies one mission in one process."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cache
from typing import Any, Final

from he3.errors import InvalidInput
from schemas.commands import NoParameters
from schemas.maps import MapLayer, MapLayerQuery
from schemas.topics import LINK_SHOW, MAP_LAYER, MAP_SCORE, TRACK
from services.console.campaign.identity import kept_region, planner_checksum, region_checksum
from services.console.report.mission_report import Run, array_of, build_report
from services.ground.pure_tasks import MissionExecutor
from services.mission.in_process import InProcessMission, build_nodes
from services.mission.scenario import checked_scenario

_TAKEN: Final = (
    "completed", "detail", "rounds", "samples", "samples_wanted", "rmse_ppb", "coverage_68", "coverage_95",
    "path_length_m", "drilled_m", "mission_time_s",
)  # fmt: skip


def fly(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The figures of the mission of ``arguments["scenario"]``, and a checksum of its map and samples.

    They follow from the arguments and the software alone. Raises InvalidInput if this host has another region or
    another plug-in planner under the same name, He3Error if the mission stalls.
    """
    scenario = checked_scenario(dict(arguments["scenario"]), "task")
    _expect("region", scenario.region, arguments["region_sha256"], region_checksum(scenario.region))
    planner = scenario.ground.planner
    _expect("planner", planner, arguments["planner_sha256"], planner_checksum(planner))
    region = kept_region(scenario.region, scenario.field.field_seed)
    mission = InProcessMission(scenario, _executor(), None, build_nodes(scenario, region, map_use="asked"))
    mission.run()
    assert mission.status is not None, "the run ends only after the ground has reported its status"
    track, link = mission.ask(TRACK, NoParameters()), mission.ask(LINK_SHOW, NoParameters())
    score = mission.ask(MAP_SCORE, NoParameters()) if scenario.ground.score else None
    run = Run("in-process", None, region.provenance, mission.mission_time_s, 0.0)
    report = build_report(scenario, run, mission.status, track, link, score)
    mean, std = (
        array_of(mission.ask(MAP_LAYER, MapLayerQuery(layer=layer))) for layer in (MapLayer.MEAN, MapLayer.STD)
    )
    digest = hashlib.sha256(mean.tobytes() + std.tobytes())
    digest.update("\n".join(sample.model_dump_json() for sample in report.sample_table).encode())
    figures = {name: getattr(report, name) for name in _TAKEN}
    if report.within_reach is not None:
        figures["rmse_within_reach_ppb"] = report.within_reach.rmse_ppb
    if report.goal is not None:
        figures["goal_holds"] = report.goal.holds
    figures["mean_std_ppb"] = float(std.mean(dtype="float64"))
    figures.update({f"messages_{name}": getattr(report.messages, name) for name in ("sent", "retransmitted", "lost")})
    return {**figures, "map_sha256": digest.hexdigest()}


def _expect(what: str, name: str, wanted: str, found: str) -> None:
    if wanted != found:
        raise InvalidInput(
            f"{what} {name}: expected the campaign's, with the checksum {wanted[:12]}, got {found[:12]} on this host"
        )


@cache
def _executor() -> MissionExecutor:
    """What computes the fits and plans of this process's missions, none of which depends on one before it."""
    return MissionExecutor()
