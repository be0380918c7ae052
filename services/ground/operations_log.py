"""The operators' log: events and modes of the rover, the expected times of each plan, and what people changed.

Every entry is published as it is made, so that it is recorded; all of the log is answered on request, so that a display
that joins late knows what happened before.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import isfinite
from typing import TYPE_CHECKING, Any

from schemas.authority import AuthorityAction
from schemas.mission_log import (
    MAX_ENTRIES,
    MAX_EVENTS,
    MAX_MODES,
    AlarmAction,
    AlarmMark,
    HeardEvent,
    LogEntry,
    LogKind,
    MissionLog,
    ModeChange,
    mode_change,
)
from schemas.plans import PlanVerdict
from schemas.topics import LOG_ENTRY
from services.ground.budget import Committed
from services.mission.mission_time import seconds
from services.runtime.node import Effect, RefuseQuery, Send, SendReply

if TYPE_CHECKING:
    from schemas.authority import AuthorityChange
    from schemas.ground import InterestChange
    from schemas.plans import MissionPlan, PlanDecision
    from schemas.telemetry import RoverEvent, RoverState
    from services.ground.budget import Budget
    from services.ground.round_log import RoundLog
    from services.mission.mission_time import MissionTime
    from services.runtime.node import SavedState

_DECIDED = {
    PlanVerdict.APPROVE: "approved",
    PlanVerdict.SEND_BACK: "sent back",
    PlanVerdict.REVISE: "revised",
}
_DONE = {AlarmAction.ACKNOWLEDGE: "acknowledged", AlarmAction.SHELVE: "shelved", AlarmAction.UNSHELVE: "unshelved"}


class OperationsLog:
    """Keeps the newest of everything, oldest first."""

    def __init__(self, round_log: RoundLog, budget: Budget, light_time_up_s: float) -> None:
        """light_time_up_s: of the scenario; a round that nothing precedes begins when its plan has arrived."""
        self._round_log = round_log
        self._budget = budget
        self._light_up = seconds(light_time_up_s)
        self._number = 0
        self._entries: list[LogEntry] = []
        self._events: list[HeardEvent] = []
        self._modes: list[ModeChange] = []
        self._reported_at: MissionTime | None = None

    def listed(self) -> MissionLog:
        """All that is kept."""
        return MissionLog(entries=tuple(self._entries), events=tuple(self._events), modes=tuple(self._modes))

    def happened(self, event: RoverEvent, now: MissionTime) -> None:
        """Keep an event of the rover that has just arrived."""
        self._events.append(HeardEvent(event=event, received_at=now))
        del self._events[:-MAX_EVENTS]

    def reported(self, state: RoverState, made_at: MissionTime, now: MissionTime) -> None:
        """Keep the rover's mode if it is another than before, or the first after a silence."""
        last = self._modes[-1] if self._modes else None
        change = mode_change(last, self._reported_at, state.mode, made_at, now)
        self._reported_at = max(made_at, self._reported_at or 0)
        if change is not None:
            self._modes.append(change)
            del self._modes[:-MAX_MODES]

    def planned(self, plan: MissionPlan, now: MissionTime) -> Effect:
        """Log the newest round of a plan that is sent, with the times at which it is expected to begin and to end."""
        number = plan.rounds[-1].round
        metres, samples, rounds, earlier_s, lasts_s = 0.0, 0, 0, 0.0, 0.0
        for record in self._round_log.open_rounds:
            earlier_s = lasts_s
            metres, samples, rounds = metres + record.to_drive_m, samples + len(record.pending), rounds + 1
            lasts_s = self._budget.lasts_s(Committed(metres, samples, rounds))
        arrives = now + self._light_up
        times: dict[str, Any] = {}
        if isfinite(lasts_s):
            begins = max(arrives, now + seconds(earlier_s))
            times = {"begins_at": begins, "ends_at": begins + seconds(lasts_s - earlier_s)}
        text = f"round {number} planned: {len(plan.rounds[-1].samples)} samples, plan {plan.revision}"
        return self._note(LogKind.PLAN, text, now, round=number, **times)

    def mark(self, mark: AlarmMark, token: int, now: MissionTime) -> Iterable[Effect]:
        """Answer what a person does about an alarm with its entry, and log it."""
        if mark.until is not None and mark.until <= now:
            yield RefuseQuery(token, "alarm: expected a time ahead until which it is shelved, got one that has passed")
            return
        until = "" if mark.until is None else f" for {(mark.until - now) / seconds(60.0):,.0f} min"
        why = f": {mark.why}" if mark.why else ""
        entry = self._note(
            LogKind.ALARM,
            f"{mark.kind.value.replace('_', '-')} {_DONE[mark.action]}{until}{why}",
            now,
            by=mark.by,
            mark=mark,
        )
        yield SendReply(token, entry.body)
        yield entry

    def interest(self, change: InterestChange, now: MissionTime) -> Effect:
        """Log an area of interest that was set or removed."""
        done = "removed" if change.polygon_m is None else f"set with weight {change.weight:g}"
        return self._note(LogKind.INTEREST, f"area of interest {change.area_id} {done}", now, by=change.by or "")

    def authority(self, change: AuthorityChange, now: MissionTime) -> Effect:
        """Log command authority that changed hands."""
        done = "taken" if change.action is AuthorityAction.TAKE else "released"
        over = "" if change.over_from is None else f" over from {change.over_from}"
        return self._note(LogKind.AUTHORITY, f"command authority {done}{over}", now, by=change.by)

    def goal(self, text: str, now: MissionTime) -> Effect:
        """Log that the goal holds, or that it cannot be reached."""
        return self._note(LogKind.GOAL, text, now)

    def decision(self, decision: PlanDecision, now: MissionTime) -> Effect:
        """Log what an operator decided on a plan."""
        done = _DECIDED[decision.verdict]
        if decision.places_m:
            done += f": {len(decision.places_m)} places to sample"
        dropped = f" without {', '.join(decision.drop)}" if decision.drop else ""
        why = f": {decision.why}" if decision.why else ""
        text = f"proposal {decision.proposal} {done}{dropped}{why}"
        return self._note(LogKind.DECISION, text, now, by=decision.by)

    def _note(self, kind: LogKind, text: str, now: MissionTime, by: str = "", **fields: Any) -> Send:
        entry = LogEntry(number=self._number, at=now, kind=kind, text=text[:500], by=by, **fields)
        self._number += 1
        self._entries.append(entry)
        del self._entries[:-MAX_ENTRIES]
        return Send(LOG_ENTRY, entry)

    # --- checkpoints ------------------------------------------------------------------------------------------------

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "number": self._number,
            "entries": list(self._entries),
            "events": list(self._events),
            "modes": list(self._modes),
            "reported_at": self._reported_at,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the log from this state."""
        self._number = state["number"]
        self._entries, self._events, self._modes = list(state["entries"]), list(state["events"]), list(state["modes"])
        self._reported_at = state["reported_at"]
