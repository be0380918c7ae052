"""The time keeper's core: conservative synchronisation by counting messages, without I/O.

Virtual time goes in steps. A grant names those who act at an instant, and how many messages each must have taken in
before it does; they report what they sent, from which follows who acts in the next step. Time moves only when every
process is idle and every message has been received, and then to the earliest instant at which anybody wants to act.
So no grant is ever early, and nothing that a process could still receive lies before the time it is granted.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from schemas.lockstep import Grant, Join, StepDone
from services.node import MissionTime


@dataclass(slots=True)
class _Member:
    process: str
    hears: frozenset[tuple[str, str]]
    serves: frozenset[str]
    next_wake: MissionTime | None
    expects: int = 0
    poked: bool = True
    finished: str | None = None


@dataclass(slots=True)
class TimeKeeper:
    """Who takes part, where each stands, and what the next step is."""

    now: MissionTime
    required: frozenset[str]
    """Time does not move before these have joined."""
    step: int = 0
    members: dict[str, _Member] = field(default_factory=dict)
    outstanding: set[str] = field(default_factory=set)
    """Who has been granted a step and has not finished it."""

    def join(self, joining: Join) -> None:
        """Take a process in, or take it in again after a restart; it acts in the next step."""
        member = self.members.get(joining.name)
        if member is not None and member.process == joining.process:
            return
        self.members[joining.name] = _Member(
            joining.process, frozenset(joining.hears), frozenset(joining.serves), joining.next_wake
        )
        self.outstanding.discard(joining.name)

    def leave(self, name: str) -> None:
        """A process is gone; nobody waits for it any more, and time stands until it is back if it is required."""
        self.members.pop(name, None)
        self.outstanding.discard(name)

    def poke(self, name: str) -> None:
        """Something from outside waits for that process."""
        if name in self.members:
            self.members[name].poked = True

    def done(self, report: StepDone) -> None:
        """Take in what a process did in the present step."""
        member = self.members.get(report.name)
        if member is None or report.step != self.step or report.name not in self.outstanding:
            return  # of a step that ended when the process was given up
        self.outstanding.discard(report.name)
        member.next_wake = report.next_wake
        member.finished = report.finished if report.finished is not None else member.finished
        for topic, side, count in report.published:
            for name, other in self.members.items():
                if name != report.name and (topic, side) in other.hears:
                    other.expects += count
        for topic in report.asked:
            server = next((name for name, other in self.members.items() if topic in other.serves), report.name)
            self.members[server].expects += 1
        for asker in report.answered:
            if asker in self.members:
                self.members[asker].expects += 1

    def missing(self) -> list[str]:
        """Who is required and has not joined."""
        return sorted(self.required - self.members.keys())

    def next_instant(self) -> MissionTime | None:
        """When the next step can be: now, later, or None while a step is under way, somebody is missing, or no one
        wants to act ever again."""
        if self.outstanding or self.missing():
            return None
        if any(member.expects or member.poked for member in self.members.values()):
            return self.now
        wakes = [member.next_wake for member in self.members.values() if member.next_wake is not None]
        return max(self.now, min(wakes)) if wakes else None

    def grant(self, at: MissionTime) -> Grant:
        """Begin the next step at that instant, which `next_instant` named."""
        self.now = at
        self.step += 1
        expects = {}
        for name, member in self.members.items():
            if member.expects or member.poked or (member.next_wake is not None and member.next_wake <= at):
                expects[name] = member.expects
                member.expects = 0
                member.poked = False
        self.outstanding = set(expects)
        return Grant(step=self.step, at=at, expects=expects)
