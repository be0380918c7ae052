"""The mission's report from what operators can query: the same queries to one process and to several."""

from __future__ import annotations

import base64
import contextlib
import platform
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from he3.driving import J_PER_WH, DrivenGround
from he3.driving_cost import cost_unit
from he3.errors import He3Error, PeerUnreachable
from he3.kernels import AUTO
from schemas.ground import GoalStatus, GroundStatus, MissionPhase, MissionTrack
from schemas.maps import CrossValidation, CrossValidationFigures, MapLayer, MapRaster, MapScore, RegionLayer
from schemas.report import (
    ClosedGroundReport,
    DrivingReport,
    MessageCounts,
    MissionReport,
    ReportSample,
)
from services.console.report.learned import kernel_weights, learned
from services.mission.mission_time import SECOND
from services.runtime.files.output import write_output
from services.runtime.heartbeat import software_version

if TYPE_CHECKING:
    from he3.provenance import LayerOrigin
    from schemas.link import LinkStatus
    from services.ground.closed_ground import ClosedGround
    from services.mission.scenario import Scenario


class Answers(Protocol):
    """A mission that answers an operator's queries, such as `MissionClient`; each method raises He3Error if refused."""

    def track(self) -> MissionTrack: ...

    def link(self) -> LinkStatus: ...

    def raster(self, layer: MapLayer) -> MapRaster: ...

    def score(self) -> MapScore: ...

    def cross_validation(self) -> CrossValidation: ...


@dataclass(frozen=True, slots=True)
class Run:
    """How a mission was run: the facts that its nodes do not know."""

    driver: str
    """in-process, zenoh or lockstep."""
    rate: float | None
    region_note: str
    mission_time_s: float
    wall_time_s: float
    region_layers: tuple[LayerOrigin, ...] = ()
    ground: DrivenGround | None = None
    """The terrain, and the vehicle that drove over it."""
    closed: ClosedGround | None = None
    """How much of the site is closed, and why."""


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """A finished mission: its report and its map."""

    report: MissionReport
    track: MissionTrack
    mean_ppb: NDArray[np.float32]
    """(rows, columns) belief."""
    std_ppb: NDArray[np.float32]
    """(rows, columns) its standard deviation."""
    resolution_m: float


def gather(mission: Answers, scenario: Scenario, status: GroundStatus, run: Run) -> Outcome:
    """Report and map of a mission that is over; raises He3Error when it refuses a query."""
    track, link = mission.track(), mission.link()
    mean, std = mission.raster(MapLayer.MEAN), mission.raster(MapLayer.STD)
    score = mission.score() if scenario.ground.score else None
    checked = None
    if track.samples:
        with contextlib.suppress(PeerUnreachable):  # that of thousands of samples may take too long
            checked = mission.cross_validation()
    report = build_report(scenario, run, status, track, link, score, checked)
    return Outcome(report, track, array_of(mean), array_of(std), mean.resolution_m)


def _kernel(scenario: Scenario, status: GroundStatus) -> str:
    """The scenario's kernel; with `auto` and one kernel taken for certain, that one."""
    if status.kernel is None or (scenario.ground.kernel == AUTO and status.kernel.alternatives):
        return scenario.ground.kernel
    return status.kernel.name


def _goal(status: GroundStatus) -> GoalStatus | None:
    """The goal as it stands; without what was foreseen of samples to come, once none is to come."""
    goal = status.goal
    if goal is None or goal.forecast is None or status.phase is not MissionPhase.COMPLETED:
        return goal
    return goal.model_copy(update={"forecast": None, "text": goal.text.removesuffix(f"; {goal.forecast.text}")})


def build_report(
    scenario: Scenario,
    run: Run,
    status: GroundStatus,
    track: MissionTrack,
    link: LinkStatus,
    score: MapScore | None,
    checked: CrossValidation | None = None,
) -> MissionReport:
    """The report; everything but `wall_time_s` and `host` follows from scenario, seed and driver.

    checked: the cross-validation of the final map, if there is one.
    """
    samples = tuple(
        ReportSample(
            sample_id=sample.sample_id,
            round=sample.round,
            x_m=sample.x_m,
            y_m=sample.y_m,
            helium3_ppb=sample.helium3_ppb,
            measured_at_s=(sample.measured_at - scenario.start_ns) / SECOND,
        )
        for sample in track.samples
    )
    return MissionReport(
        scenario=scenario.name,
        region=scenario.region,
        region_note=run.region_note,
        region_layers=tuple(RegionLayer(**asdict(origin)) for origin in run.region_layers),
        planner=scenario.ground.planner,
        kernel=_kernel(scenario, status),
        kernel_weights=kernel_weights(status.kernel),
        seed=scenario.seed,
        driver=run.driver,
        rate=run.rate,
        completed=status.phase is MissionPhase.COMPLETED,
        detail=status.detail,
        rounds=status.round,
        samples=status.samples,
        samples_wanted=status.samples_total,
        rmse_ppb=None if score is None else score.rmse_ppb,
        rmse_history=track.score_history,
        coverage_68=None if score is None else score.coverage_68,
        coverage_95=None if score is None else score.coverage_95,
        within_reach=None if score is None else score.within_reach,
        cross_validation=None if checked is None else _figures_of(checked),
        path_length_m=status.driven_m,
        driving=_driving(scenario, run, track),
        closed_ground=None if run.closed is None else ClosedGroundReport(**asdict(run.closed)),
        learned=learned(status.kernel, scenario.field.noise_std_ppb),
        goal=_goal(status),
        drilled_m=round(sum(sample.depth_m for sample in track.samples), 9),
        mission_time_s=run.mission_time_s,
        wall_time_s=run.wall_time_s,
        messages=count_messages(link),
        sample_table=samples,
        path_m=track.driven_path_m,
        one_way_light_time_s=link.conditions.down.one_way_light_time_s,
        version=software_version(),
        host=platform.node(),
    )


def _figures_of(checked: CrossValidation) -> CrossValidationFigures:
    """The figures alone: a report has its samples elsewhere."""
    return CrossValidationFigures(**{name: getattr(checked, name) for name in CrossValidationFigures.model_fields})


def _driving(scenario: Scenario, run: Run, track: MissionTrack) -> DrivingReport | None:
    if run.ground is None:
        return None
    figures, unit = run.ground.figures(track.driven_path_m), cost_unit(scenario.ground.cost, run.ground)
    return DrivingReport(
        cost=unit.kind,
        unit=unit.unit,
        spent=unit.of(figures),
        duration_h=figures.duration_s / 3600.0,
        energy_wh=figures.energy_j / J_PER_WH,
        motion_wh=figures.motion_j / J_PER_WH,
        climb_m=figures.climb_m,
        steepest_deg=figures.steepest_deg,
    )


def count_messages(link: LinkStatus) -> MessageCounts:
    """Counts of the link's messages, both directions together."""
    both = (link.up, link.down)
    return MessageCounts(
        sent=sum(counts.offered for counts in both),
        delivered=sum(counts.delivered for counts in both),
        retransmitted=sum(counts.repeated for counts in both),
        lost=sum(counts.lost + counts.dropped_out_of_contact + counts.dropped_queue_full for counts in both),
        up=link.up,
        down=link.down,
    )


def array_of(raster: MapRaster) -> NDArray[Any]:
    """The layer as an array (rows, columns), row 0 in the south; raises He3Error when its bytes do not fill it."""
    data = base64.b64decode(raster.data_base64, validate=True)
    values = np.frombuffer(data, dtype=np.dtype(raster.dtype))
    if values.size != raster.rows * raster.columns:
        raise He3Error(
            f"layer {raster.layer.value}: expected {raster.rows} x {raster.columns} cells, got {values.size} values"
        )
    return values.reshape(raster.rows, raster.columns)


def remove_part(path: Path) -> None:
    """Remove a partly written file; an error of the removal is ignored."""
    with contextlib.suppress(OSError):
        if path.is_file() and not path.is_symlink():
            path.unlink()


def write_report(report: MissionReport, path: Path) -> None:
    """Write the report as one JSON document; raises He3Error if it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_output(path, f"{report.model_dump_json(indent=2)}\n".encode())
    except OSError as error:
        remove_part(path)
        raise He3Error(f"{path}: cannot write the report: {error.strerror}") from None
