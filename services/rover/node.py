"""The rover's node: routes plans, telecommands, replies and timers to the executive, and reports the state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from he3 import constants
from he3.frames import Place, SiteGrid
from schemas.telemetry import RoverMode
from schemas.topics import COMMAND, MEASURE, PLAN, STATE, TERRAIN, Side
from services.mission.embedded_regions import EMBEDDED
from services.mission.mission_time import MissionTime, seconds
from services.rover.executive import STEP, Executive
from services.rover.instruments import RETRY
from services.rover.operating_state import CHARGED
from services.rover.state_types import STATE_TYPES
from services.rover.watchdog import WATCHDOG
from services.runtime.node import (
    Effect,
    Event,
    Interface,
    QueryFailed,
    QueueDepthChanged,
    Received,
    ReplyReceived,
    Send,
    SetTimer,
    Started,
    TimerFired,
)

if TYPE_CHECKING:
    from schemas.telemetry import RoverState
    from services.mission.scenario import RoverConfig, Scenario
    from services.runtime.node import SavedState

REPORT_STATE: Final = "state"
"""Timer: report the state again."""

WORK: Final = frozenset({RoverMode.DRIVING, RoverMode.DRILLING, RoverMode.ANALYSING})
"""Modes between which the rover changes as it works, several times a sample."""


class RoverNode:
    """Executes plans on the Moon, without the ground as long as it has rounds on board."""

    def __init__(
        self,
        config: RoverConfig,
        site: SiteGrid,
        start_m: Place,
        start: MissionTime,
        keep_outs: Mapping[str, Sequence[Place]] | None = None,
        reports_steps: bool = True,
    ) -> None:
        """keep_outs: corners [m] of the areas closed from the beginning, by their ids.

        reports_steps: whether the state is reported between one step of the work and the next, too.
        """
        self._reports_steps = reports_steps
        self._queue_depth = 0
        """Messages not yet acknowledged by the ground."""
        self._config = config
        self._executive = Executive(config, site, start_m, start, keep_outs)
        self._reported: RoverMode | None = None
        self._running = False

    @property
    def interface(self) -> Interface:
        return Interface(name="rover", sides=(Side.MOON,), subscribes=(PLAN, COMMAND), reports_queue_depth=True)

    def handle(self, event: Event, now: MissionTime) -> list[Effect]:
        """Effects of the event; a change of mode is followed by a report of the state."""
        executive = self._executive
        executive.effects.clear()
        match event:
            case Received():
                self._receive(event, now)
            case ReplyReceived():
                if event.topic == TERRAIN:
                    executive.terrain_received(event.query, event.reply, now)
                elif event.topic == MEASURE:
                    executive.value_received(event.query, event.reply, now)
            case QueryFailed():
                executive.query_failed(event.topic, event.query, event.why, event.detail, now)
            case TimerFired():
                self._timer_fired(event.timer, now)
            case QueueDepthChanged(depth):
                self._queue_depth = depth
            case Started():
                self._start(now)
        if self._reported is not executive.mode:
            if self._reports_steps or self._reported not in WORK or executive.mode not in WORK:
                self._report_state(now)
            self._reported = executive.mode
        return executive.effects.copy()

    def state(self, now: MissionTime) -> RoverState:
        """The state at that time, as it would be reported."""
        return self._executive.report_state(now, self._queue_depth)

    def _start(self, now: MissionTime) -> None:
        """Reports the state. After a restart the timers and queries of the earlier start still stand."""
        self._report_state(now)
        if not self._running:
            self._running = True
            self._executive.effects.append(SetTimer(REPORT_STATE, now + seconds(self._config.state_period_s)))
            self._executive.ground_heard(now)

    def _receive(self, event: Received, now: MissionTime) -> None:
        self._executive.ground_heard(now)
        if event.topic == PLAN:
            self._executive.plan_received(event.body, now)
        elif event.topic == COMMAND:
            self._executive.command_received(event.body, event.header, now)

    def _timer_fired(self, timer: str, now: MissionTime) -> None:
        if timer == STEP:
            self._executive.step_ended(now)
        elif timer == REPORT_STATE:
            self._report_state(now)
            self._executive.effects.append(SetTimer(REPORT_STATE, now + seconds(self._config.state_period_s)))
        elif timer == RETRY:
            self._executive.retry(now)
        elif timer == CHARGED:
            self._executive.charged(now)
        elif timer == WATCHDOG:
            self._executive.watchdog_expired(now)

    def _report_state(self, now: MissionTime) -> None:
        self._reported = self._executive.mode
        self._executive.effects.append(Send(STATE, self.state(now)))

    # --- checkpoints ----------------------------------------------------------------------------------------------

    @property
    def state_types(self) -> tuple[type, ...]:
        """The types in the state, beside plain values."""
        return STATE_TYPES

    @property
    def functions(self) -> dict[str, Callable[..., Any]]:
        """None: the rover's node starts no computations."""
        return {}

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "executive": self._executive.checkpoint(),
            "queue_depth": self._queue_depth,
            "reported": self._reported,
            "running": self._running,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the rover from this state."""
        self._executive.restore(state["executive"])
        self._queue_depth, self._reported, self._running = state["queue_depth"], state["reported"], state["running"]


def build_node(scenario: Scenario, site: SiteGrid | None = None, *, reports_steps: bool = True) -> RoverNode:
    """The rover of that scenario. site: the extent of its region, read from the region if it is not given.

    reports_steps: see `RoverNode`.
    """
    if site is None:
        site = _site_of(scenario)
    keep_outs = scenario.ground.keep_outs
    return RoverNode(scenario.rover, site, scenario.start_m, scenario.start_ns, keep_outs, reports_steps)


def _site_of(scenario: Scenario) -> SiteGrid:
    # The extent is all that the rover knows of the region beforehand; it scans the rest.
    if scenario.region in EMBEDDED:
        return SiteGrid(constants.SITE_CELLS, constants.SITE_CELLS, constants.SITE_RESOLUTION_M)
    # What reads a region takes longer to import than all else of the rover.
    from services.mission.regions import load_region

    return load_region(scenario.region).grid
