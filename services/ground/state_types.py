"""The types in the ground station's state, beside plain values.

They are those that a checkpoint may hold, and those of the computations that it has under way and of their results.
"""

from __future__ import annotations

from typing import Final

from he3.certificate import Certificate, Targets
from he3.driving_cost import TerrainCost
from he3.frames import SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.hyperprior import Hyperprior
from he3.intervals import Intervals
from he3.kernels import Matern12, Matern32, Matern52, SmoothPlusRough, SquaredExponential, Stretched
from he3.local_amplitude import LocalAmplitude, LocallyScaled
from he3.posterior.grid import PosteriorMap
from he3.trend import CovariateTrend, UnknownConstant, UnknownLevel
from he3.warping import Warp
from schemas.authority import AuthorityState
from schemas.commands import CommandStatus, Telecommand
from schemas.ground import GoalForecast, GoalStatus, InterestArea, KeepOutArea, MissionPhase
from schemas.link import LinkConditions
from schemas.maps import MapRegion, MapScore, ReachScore
from schemas.mission_log import HeardEvent, LogEntry, ModeChange
from schemas.plans import RoundPlan
from schemas.telemetry import RoverState, SampleReport
from services.ground.fitting import FitRequest
from services.ground.map.snapshot import MapSnapshot
from services.ground.observation import Observation
from services.ground.planners.interface import PlannedRound, PlannerOptions, PlanningGoal, PlanningRequest
from services.ground.round_plans import PlanningTask, ProposedRound

STATE_TYPES: Final[tuple[type, ...]] = (
    AuthorityState,
    Certificate,
    CommandStatus,
    FitRequest,
    GaussianProcess,
    GoalForecast,
    GoalStatus,
    HeardEvent,
    Hyperparameters,
    Hyperprior,
    InterestArea,
    Intervals,
    KeepOutArea,
    LinkConditions,
    LocalAmplitude,
    LocallyScaled,
    LogEntry,
    MapRegion,
    MapScore,
    MapSnapshot,
    Matern12,
    Matern32,
    Matern52,
    MissionPhase,
    ModeChange,
    Observation,
    CovariateTrend,
    PlannedRound,
    PlannerOptions,
    PlanningGoal,
    PlanningRequest,
    PlanningTask,
    PosteriorMap,
    ProposedRound,
    ReachScore,
    RoundPlan,
    RoverState,
    SampleReport,
    SiteGrid,
    SmoothPlusRough,
    SquaredExponential,
    Stretched,
    Targets,
    Telecommand,
    TerrainCost,
    UnknownConstant,
    UnknownLevel,
    Warp,
)
