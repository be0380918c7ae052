"""The map as operators see it at one moment: immutable, so that any thread may answer from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from he3.hyperparameters import DEFAULT_NOISE_STD_PPB

if TYPE_CHECKING:
    from he3.frames import Float32Array, SiteGrid
    from he3.gp import GaussianProcess
    from he3.intervals import Intervals
    from schemas.ground import InterestArea, KeepOutArea
    from schemas.maps import MapRegion, MapScore
    from schemas.plans import Waypoint
    from schemas.telemetry import SampleReport
    from services.mission.mission_time import MissionTime


@dataclass(frozen=True, eq=False)
class MapSnapshot:
    """One revision of the map, with samples and paths. Arrays are (rows, columns), read-only."""

    grid: SiteGrid
    mean_ppb: NDArray[np.float32]
    std_ppb: NDArray[np.float32]
    traversable: NDArray[np.bool_]
    """The ground's map of where the rover's centre may be."""
    samples: tuple[SampleReport, ...]
    """Every measurement in the map, in the order in which they arrived."""
    driven_path_m: tuple[Waypoint, ...]
    """The known driven parts of planned paths."""
    planned_path_m: tuple[Waypoint, ...]
    """The planned path ahead, from the last known place of the rover."""
    plan_ends: MissionTime | None
    """Expected time at which the rover has done all planned rounds."""
    revision: int
    """Grows by one with every change of the map; track, plan and areas of interest may change without."""
    mission_time_ns: MissionTime
    """Mission time of that revision."""
    score: MapScore | None
    score_history: tuple[MapScore, ...]
    """Scores, one entry per round."""
    process: GaussianProcess | None = None
    """The belief that the arrays were computed from, for answers about several cells at once."""
    origin_deg: tuple[float, float] | None = None
    """Latitude and longitude of the site's south-west corner; None if the region does not give them."""
    intervals: Intervals | None = None
    """The central intervals of the belief; None where it is normal in every cell."""
    provenance: str = ""
    """Of the region's data, in one line."""
    region: MapRegion | None = None
    """The region under the map; None where there is none, as in tests of the map alone."""
    keep_outs: tuple[KeepOutArea, ...] = ()
    """The keep-out areas in force."""
    interests: tuple[InterestArea, ...] = ()
    """The areas of interest."""
    earlier: tuple[MapSnapshot, ...] = ()
    """Revisions before this one that are still held, oldest first; they hold none themselves."""

    @cached_property
    def mean_std_ppb(self) -> float:
        """Mean over the cells of the standard deviation [ppb]."""
        return float(self.std_ppb.mean(dtype=np.float64))

    def ends_at(self, part: Any) -> list[Float32Array] | None:
        """Ends of the intervals in those cells, an index of the arrays; None where the belief is normal."""
        return None if self.intervals is None else [end[part] for end in self.intervals.on(self.grid)]

    @property
    def noise_std_ppb(self) -> float:
        """Standard deviation of a measurement, as the belief has it."""
        if self.process is None:
            return DEFAULT_NOISE_STD_PPB
        return float(self.process.hyperparameters.noise_variance_ppb2**0.5)
