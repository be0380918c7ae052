"""Whether what a display shows of a mission is still true, and if not, what has fallen silent."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from services.console.client.staleness import PROCESS_SILENT_S, stale_after_s
from services.console.client.time_format import duration
from services.mission.mission_time import SECOND

if TYPE_CHECKING:
    from services.console.client.mission_state import MissionState

LINK, GROUND = "link", "ground"


class Condition(StrEnum):
    """What a display can rely on; the first that holds, in this order, but for `LIVE`."""

    OVER = "over"
    """The mission is over: nothing changes any more."""
    ENDED = "ended"
    """The mission is over, and its services have ended: mission time and contact are not known any more."""
    MISSION_SILENT = "mission silent"
    """Nothing is heard of any process."""
    LINK_SILENT = "link silent"
    """Mission time and the state of the link are not known."""
    GROUND_SILENT = "ground silent"
    """The map, the status and the commands are not known."""
    OUT_OF_CONTACT = "out of contact"
    """What is shown of the rover is of before the contact ended."""
    ROVER_OVERDUE = "rover overdue"
    """The rover has not reported for longer than it should."""
    LIVE = "live"
    """All of it is as new as light allows."""


@dataclass(frozen=True, slots=True)
class Liveness:
    """A condition, and one line about it for the operator."""

    condition: Condition
    text: str


def liveness(state: MissionState) -> Liveness:
    """The mission's condition now, from what this session has heard."""
    if state.status is not None and state.status.is_over:
        if state.silent_s > PROCESS_SILENT_S:
            return Liveness(Condition.ENDED, "mission over, services ended")
        return Liveness(Condition.OVER, "mission over")
    if state.silent_s > PROCESS_SILENT_S:
        return Liveness(Condition.MISSION_SILENT, f"nothing heard of the mission for {state.silent_s:.0f} s")
    for name, condition in ((LINK, Condition.LINK_SILENT), (GROUND, Condition.GROUND_SILENT)):
        silent_s = state.process_silent_s(name)
        if silent_s is not None and silent_s > PROCESS_SILENT_S:
            return Liveness(condition, f"{name} silent for {silent_s:.0f} s")
    link = state.link
    if link is not None and not link.contact:
        until = link.contact_changes_at
        if link.contact_forced is not None or until is None:
            return Liveness(Condition.OUT_OF_CONTACT, "out of contact, no end is known")
        ahead_s = max(0.0, (until - state.time.now()) / SECOND)
        return Liveness(Condition.OUT_OF_CONTACT, f"out of contact for another {duration(ahead_s)}")
    age_s = state.rover_age_s
    if age_s is not None and age_s > stale_after_s(state.report_period_s, link, state.time.recent_rate):
        return Liveness(Condition.ROVER_OVERDUE, f"no report of the rover for {duration(age_s)}")
    light_s = 0.0 if link is None else link.conditions.down.one_way_light_time_s
    return Liveness(Condition.LIVE, f"live, {light_s:.3g} s of light time" if light_s else "live")
