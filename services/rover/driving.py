"""Driving: along the current leg, section by section. Each section is scanned before it is driven."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from schemas.measurement import TerrainReply, TerrainRequest
from schemas.telemetry import EventKind
from schemas.topics import TERRAIN
from services.rover.drive import drive_over
from services.rover.path_scan import PathSection, ScanPattern, obstacles, scan_planner
from services.rover.states import Hold, Trigger

if TYPE_CHECKING:
    from he3.frames import Place, SiteGrid
    from services.mission.mission_time import MissionTime
    from services.mission.scenario import RoverConfig
    from services.rover.activities import Activity
    from services.rover.energy_guard import EnergyGuard
    from services.rover.instruments import Instruments
    from services.rover.keep_outs import KeepOuts
    from services.rover.operating_state import OperatingState
    from services.rover.reporter import Reporter
    from services.rover.schedule import Schedule
    from services.rover.vehicle import Vehicle
    from services.runtime.node import SavedState


@dataclass(frozen=True, slots=True)
class Scan:
    """A section that waits for the reply to its scan."""

    section: PathSection
    pattern: ScanPattern


class Driving:
    """Scans and drives the sections of a leg; a section that is closed ends the activity in safe mode."""

    def __init__(
        self,
        config: RoverConfig,
        site: SiteGrid,
        *,
        vehicle: Vehicle,
        keep_outs: KeepOuts,
        operating: OperatingState,
        energy: EnergyGuard,
        schedule: Schedule,
        instruments: Instruments,
        reporter: Reporter,
    ) -> None:
        self._config = config
        self._cell_m = site.resolution_m
        self._planner = scan_planner(config, site)
        self._vehicle = vehicle
        self._keep_outs = keep_outs
        self._operating = operating
        self._energy = energy
        self._schedule = schedule
        self._instruments = instruments
        self._reporter = reporter
        self._scan: Scan | None = None

    def advance(self, activity: Activity, now: MissionTime) -> bool:
        """Scans the next section of the activity's leg; False if the rover is at the leg's end already."""
        leg = activity.current_leg
        while True:
            section = self._planner.next_section(self._vehicle.standing_m, leg.path_m, activity.vertex)
            if section.length_m > 0:
                self._scan_section(activity, section, now)
                return True
            activity.vertex += section.vertices
            if activity.vertex >= len(leg.path_m):
                return False

    def _scan_section(self, activity: Activity, section: PathSection, now: MissionTime) -> None:
        activity.exempt_keep_outs &= self._keep_outs.around(section.points_m[0])
        entered = self._keep_outs.first_entered(section.points_m, activity.exempt_keep_outs)
        if entered is not None:
            name, place = entered
            self._stop_before(activity, now, f"the way enters keep-out {name}", place)
            return
        pattern = self._planner.pattern(section)
        self._scan = Scan(section, pattern)
        self._operating.enter(Trigger.SCAN, now)
        self._instruments.ask(TERRAIN, TerrainRequest(points_m=pattern.points_m))

    def terrain_received(self, query: str, terrain: TerrainReply, now: MissionTime) -> MissionTime | None:
        """Drives the section if its terrain is clear; returns when the drive ends, None if the rover stays."""
        activity, scan = self._schedule.current, self._scan
        if not self._instruments.expects(query) or scan is None or activity is None:
            return None
        asked, came = len(scan.pattern.points_m), len(terrain.traversable)
        if asked != came:
            self._instruments.failed(TERRAIN, now, f"{asked} places asked for, {came} answered")
            return None
        self._instruments.answered(TERRAIN)
        here = self._vehicle.standing_m
        closed = obstacles(scan.pattern, terrain, self._config, self._cell_m, here)
        if closed:
            x, y = nearest = min(closed, key=partial(math.dist, here))
            self._stop_before(activity, now, f"closed terrain ahead, nearest at ({x:.2f}, {y:.2f})", nearest)
            return None
        drive = drive_over(scan.section, scan.pattern, terrain, self._config, now)
        if not self._energy.affords(drive.load_w, drive.duration_s, now):
            return None
        activity.vertex += scan.section.vertices
        self._scan = None
        self._operating.enter(Trigger.PATH_CLEAR, now, drive.load_w)
        self._vehicle.set_off(drive)
        return drive.ends_at

    def _stop_before(self, activity: Activity, now: MissionTime, why: str, obstacle_m: Place) -> None:
        self._scan = None
        self._reporter.report_activity(EventKind.BLOCKED, activity, now, why, obstacle_m)
        self._schedule.abandon(now, why)
        self._operating.hold_for(Hold.TERRAIN, now, why)

    def checkpoint(self) -> SavedState:
        """The section that waits for its scan, as a named part."""
        return {"scan": self._scan}

    def restore(self, state: SavedState) -> None:
        """Restore the driving from this state."""
        self._scan = state["scan"]
