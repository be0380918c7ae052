"""The rover as a node: hears plans, telecommands and instruments, and tells samples, events and its state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Final

from he3 import constants
from he3.frames import Place, SiteGrid
from schemas.telemetry import RoverMode
from schemas.topics import COMMAND, MEASURE, PLAN, STATE, TERRAIN, Side
from services.mission.regions import EMBEDDED, load_region
from services.mission.scenario import RoverConfig, Scenario
from services.rover import command_handlers as orders
from services.rover.executive import CHARGED, STEP, WATCHDOG, Executive
from services.rover.geometry import Area
from services.rover.instruments import RETRY
from services.runtime.node import (
    Effect,
    Event,
    Interface,
    MissionTime,
    QueryFailed,
    QueueDepthChanged,
    Received,
    ReplyReceived,
    Send,
    SetTimer,
    Started,
    TimerFired,
    seconds,
)

TELL_STATE: Final = "state"


class RoverNode:
    """Executes plans on the Moon, on its own as long as it has rounds on board."""

    def __init__(
        self,
        config: RoverConfig,
        site: SiteGrid,
        start_m: Place,
        start: MissionTime,
        keep_outs: Mapping[str, Sequence[Place]] | None = None,
    ) -> None:
        """keep_outs: corners [m] of the areas closed from the beginning, by their ids."""
        self._queue_depth = 0
        self._config = config
        self._executive = Executive(config, site, start_m, start)
        self._executive.areas = {area_id: Area.within(polygon) for area_id, polygon in (keep_outs or {}).items()}
        self._executive.at_safe_point = partial(orders.carry_out_waiting, self._executive)
        self._told: RoverMode | None = None
        self._awake = False

    @property
    def interface(self) -> Interface:
        return Interface(name="rover", sides=(Side.MOON,), subscribes=(PLAN, COMMAND), reports_queue_depth=True)

    def handle(self, event: Event, now: MissionTime) -> list[Effect]:
        """What the rover does upon the event; its state follows whenever its mode has changed."""
        executive = self._executive
        executive.out.clear()
        match event:
            case Received():
                self._receive(event, now)
            case ReplyReceived():
                if event.topic == TERRAIN:
                    executive.seen(event.query, event.reply, now)
                elif event.topic == MEASURE:
                    executive.measured(event.query, event.reply, now)
            case QueryFailed():
                executive.unanswered(event.topic, event.query, event.why, event.detail, now)
            case TimerFired():
                self._wake(event.timer, now)
            case QueueDepthChanged(depth):
                self._queue_depth = depth
            case Started():
                self._start(now)
        if self._told is not executive.mode:
            self._tell_state(now)
        return executive.out.copy()

    def _start(self, now: MissionTime) -> None:
        """Tells its state; timers and questions of an earlier start still stand."""
        self._tell_state(now)
        if not self._awake:
            self._awake = True
            self._executive.out.append(SetTimer(TELL_STATE, now + seconds(self._config.state_period_s)))
            self._executive.watch(now)

    def _receive(self, event: Received, now: MissionTime) -> None:
        self._executive.watch(now)
        if event.topic == PLAN:
            self._executive.take_plan(event.body, now)
        elif event.topic == COMMAND:
            orders.take(self._executive, event.body, event.header, now)

    def _wake(self, timer: str, now: MissionTime) -> None:
        if timer == STEP:
            self._executive.step_over(now)
        elif timer == TELL_STATE:
            self._tell_state(now)
            self._executive.out.append(SetTimer(TELL_STATE, now + seconds(self._config.state_period_s)))
        elif timer == RETRY:
            self._executive.retry(now)
        elif timer == CHARGED:
            self._executive.charged(now)
        elif timer == WATCHDOG:
            self._executive.unheard(now)

    def _tell_state(self, now: MissionTime) -> None:
        self._told = self._executive.mode
        self._executive.out.append(Send(STATE, self._executive.state(now, self._queue_depth)))


def build_node(scenario: Scenario, site: SiteGrid | None = None) -> RoverNode:
    """The rover of that scenario; the extent of its site may be handed in, else it is the region's."""
    if site is None:
        site = _site_of(scenario)
    return RoverNode(scenario.rover, site, scenario.start_m, scenario.start_ns, scenario.ground.keep_outs)


def _site_of(scenario: Scenario) -> SiteGrid:
    # Its extent is all that a rover knows of the region beforehand; the rest it sees.
    if scenario.region in EMBEDDED:
        return SiteGrid(constants.SITE_CELLS, constants.SITE_CELLS, constants.SITE_RESOLUTION_M)
    return load_region(scenario.region).grid
