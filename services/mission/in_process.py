"""A whole mission in one process: all nodes of a scenario over the simulation driver, and replies to queries."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from he3.errors import He3Error
from schemas.ground import MissionPhase
from services.mission.mission_time import SECOND
from services.runtime.drivers.simulation import Simulation
from services.runtime.node import Node

if TYPE_CHECKING:
    from he3.reference import Region
    from schemas.ground import GroundStatus
    from schemas.topics import Topic
    from schemas.wire import Wire
    from services.ground.map.publisher import MapUse
    from services.mission.scenario import Scenario
    from services.runtime.host import EventSink
    from services.runtime.scheduler import Executor

GROUND = "ground"
"""The node whose end is the end of the mission."""

RECORDING_FLUSH_S = 3600.0
"""Mission time between flushes of an in-process recording, which no other process reads while it runs [s]."""


def build_nodes(scenario: Scenario, region: Region | None = None, map_use: MapUse = "always") -> tuple[Node, ...]:
    """The nodes of a scenario, built as each process builds its own.

    region: the scenario's, where it is loaded already. map_use: when the ground computes its map; no choice of it
    changes a mission's course or its last map. Raises InvalidInput for a scenario that no mission can have.
    """
    from services.field.node import build_node as build_field
    from services.ground.node import build_node as build_ground
    from services.link.node import build_node as build_link
    from services.rover.node import build_node as build_rover

    return (
        build_field(scenario, region),
        build_rover(scenario, None if region is None else region.grid),
        build_link(scenario),
        build_ground(scenario, region, map_use=map_use),
    )


class InProcessMission:
    """A mission in virtual time: run it, and query it as an operator would."""

    def __init__(
        self,
        scenario: Scenario,
        executor: Executor | None = None,
        event_sink: EventSink | None = None,
        nodes: Iterable[Node] | None = None,
        passes_objects: bool = True,
    ) -> None:
        """passes_objects: see `Simulation`."""
        self.scenario = scenario
        built = build_nodes(scenario) if nodes is None else tuple(nodes)
        self.simulation = Simulation(
            built, scenario.name, scenario.start_ns, executor, event_sink, scenario.link, passes_objects
        )

    @property
    def status(self) -> GroundStatus | None:
        """The ground's status now; None while no ground station runs."""
        from services.ground.node import GroundNode

        ground = self.simulation.node(GROUND)
        return ground.status if isinstance(ground, GroundNode) else None

    @property
    def mission_time_s(self) -> float:
        """Mission time since the start [s]."""
        return (self.simulation.now - self.scenario.start_ns) / SECOND

    @property
    def end(self) -> MissionPhase | None:
        """The phase in which the mission ended, completed or failed; None while it runs."""
        end = self.simulation.finished.get(GROUND)
        if end is None:
            return None
        return MissionPhase.COMPLETED if end.ok else MissionPhase.FAILED

    def run(self, watch: Callable[[], None] = lambda: None, until_s: float | None = None) -> MissionPhase:
        """Run the mission to its end and return the phase in which it ended; `watch` is called after every instant.

        Raises He3Error if the mission stalls, or is not over `until_s` seconds after its beginning.
        """
        while self.end is None:
            if not self.simulation.step():
                raise He3Error(
                    f"the mission stands still {self.mission_time_s:.0f} s after its beginning: {self.why()}"
                )
            if until_s is not None and self.mission_time_s > until_s:
                raise He3Error(f"the mission is not over {until_s:.0f} s after its beginning: {self.why()}")
            watch()
        return self.end

    def why(self) -> str:
        """The state of the mission in a few words, for an error message."""
        if self.status is None:
            return "the ground has not reported anything"
        detail = f" ({self.status.detail})" if self.status.detail else ""
        return f"{self.status.phase.value}, {self.status.samples} of {self.status.samples_total} samples{detail}"

    def ask(self, topic: Topic, request: Wire) -> Any:
        """The reply to an operator's query; raises He3Error with the refusal."""
        return self.simulation.ask(topic, request)
