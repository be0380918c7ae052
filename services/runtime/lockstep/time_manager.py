"""The time manager, without I/O: conservative synchronisation by counting messages.

Virtual time goes in steps. A step is an instant and the processes that act at it. The time manager grants the step to
each of them, together with the number of inputs, by sender, that the process must have received first. They report
what they sent, and from that follows which processes act in the next step. Time moves only when every process is idle
and every message has been received, and then to the earliest instant at which a process wants to act. So no grant is
early: a process never receives anything from before the time that it was granted.

An input is handled in the step after the one in which it was sent. So a count is never kept for longer than a step, and
what a process that is gone has sent is not mistaken for what its successor sends.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from he3.errors import InvalidInput
from schemas.lockstep import Grant, Join, Joined, StepDone

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime


@dataclass(slots=True)
class Member:
    """A process that takes part."""

    name: str
    process: str
    hears: frozenset[tuple[str, str]]
    serves: frozenset[tuple[str, str]]
    since: int
    """The step after which it takes part."""
    next_wake: MissionTime | None
    poked: bool = True
    inputs: Counter[str] = field(default_factory=Counter)
    """How many inputs were sent to it in the last step, by sender."""
    finished: str | None = None

    @property
    def wants_now(self) -> bool:
        """Whether it has to act in the next step."""
        return self.poked or bool(self.inputs)


class TimeManager:
    """The processes that take part, and the steps that they are granted."""

    def __init__(self, now: MissionTime, required: frozenset[str], identity: str = "manager") -> None:
        """required: time stands while one of these does not take part. identity: of this start of the time manager."""
        self._identity = identity
        self.now = now
        self.step = 0
        self.required = required
        self.members: dict[str, Member] = {}
        self.outstanding: set[str] = set()
        """The processes that have a grant for the present step and have not finished it."""
        self._candidates: dict[str, Join] = {}
        self._starts: dict[str, list[str]] = {}
        self._given_up: Counter[str] = Counter()

    # --- members ------------------------------------------------------------------------------------------------

    def join(self, joining: Join) -> bool:
        """Handle a request to take part, or the question whether it still does; `admit` admits it between two steps.

        False if the process obeys an outdated term: of an ended time manager, or of a membership that was given up. It
        may still act on a grant of that term, so its own data may be out of date when it is admitted.

        An earlier process of that name is given up. Raises InvalidInput for that earlier process, if it asks later, and
        for a process that serves a query which another one serves: a query must have one server.
        """
        latest = self._starts.get(joining.name, [joining.process])[-1]
        if joining.process != latest and joining.process in self._starts[joining.name]:
            raise InvalidInput(f"another process has taken part as {joining.name} since: {latest}")
        for other in self.members.values():
            both = other.serves & frozenset(joining.serves)
            if other.name != joining.name and both:
                topic, side = min(both)
                raise InvalidInput(
                    f"{joining.name}: expected to serve what no other process serves, got {topic} on {side}, "
                    f"which {other.name} serves"
                )
        member = self.members.get(joining.name)
        if member is not None and member.process != joining.process:
            self.leave(member.process)
        if joining.term != self.term(joining.process):
            return False
        self._candidates[joining.name] = joining
        return True

    def admit(self) -> list[Join]:
        """Admit the processes that have asked, unless a step is under way; returns their requests.

        Only between two steps is it certain which messages reach a new member: all that are sent from now on.
        """
        if self.outstanding:
            return []
        admitted = list(self._candidates.values())
        self._candidates.clear()
        new: list[Member] = []
        for joining in admitted:
            if joining.name in self.members:
                continue
            self.now, self.step = max(self.now, joining.now), max(self.step, joining.step)
            self.members[joining.name] = Member(
                name=joining.name,
                process=joining.process,
                hears=frozenset(joining.hears),
                serves=frozenset(joining.serves),
                since=0,
                next_wake=joining.next_wake,
            )
            processes = self._starts.setdefault(joining.name, [])
            if joining.process not in processes:
                processes.append(joining.process)
            new.append(self.members[joining.name])
        for member in new:
            member.since = self.step
        return admitted

    def term(self, process: str) -> str:
        """The term whose grants that process has to obey."""
        return f"{self._identity}/{self._given_up[process]}"

    def answer(self, joining: Join, admitted: bool) -> Joined:
        """The answer to a process that was admitted, or that obeys another term."""
        return Joined(
            term=self.term(joining.process),
            admitted=admitted,
            now=self.now,
            step=self.step,
            starts=len(self._starts.get(joining.name, ())),
        )

    def leave(self, process: str) -> str | None:
        """Remove a process that is gone; returns its name, or None if it did not take part.

        What it sent in a step that it did not finish is not counted. It arrives before anything that is sent later, so
        every process acts in the next step and handles it then.
        """
        for joining in [each for each in self._candidates.values() if each.process == process]:
            del self._candidates[joining.name]
        member = next((each for each in self.members.values() if each.process == process), None)
        if member is None:
            return None
        del self.members[member.name]
        self._given_up[process] += 1
        self.outstanding.discard(member.name)
        for other in self.members.values():
            other.poked = True
        return member.name

    def excuse(self, name: str) -> None:
        """Make the process an onlooker: time does not wait for it."""
        self.required -= {name}

    def missing(self) -> list[str]:
        """Names of the required processes that do not take part."""
        return sorted(self.required - self.members.keys())

    # --- steps --------------------------------------------------------------------------------------------------

    def poke(self, name: str, process: str) -> None:
        """Let the process act in the next step, because an uncounted input waits for it."""
        member = self.members.get(name)
        if member is not None and member.process == process:
            member.poked = True

    def done(self, report: StepDone) -> bool:
        """Handle the report of a process on the present step; returns whether it was expected.

        If not, the process was given up before. Every process acts once more then, to handle what it sent all the same.
        """
        member = self.members.get(report.name)
        expected = report.step == self.step and report.name in self.outstanding
        if member is None or member.process != report.process or not expected:
            for other in self.members.values():
                other.poked = True
            return False
        self.outstanding.discard(report.name)
        member.next_wake = report.next_wake
        member.finished = report.finished
        for topic, side, count in report.published:
            for other in self.members.values():
                if other is not member and (topic, side) in other.hears:
                    other.inputs[report.name] += count
        for query in report.asked:
            self._server_of(query, member).inputs[report.name] += 1
        for process, step in report.answered:
            for asker in self.members.values():
                # A query ends with the connection of its sender or of its server; then its reply goes nowhere.
                if asker.process == process and step > max(asker.since, member.since):
                    asker.inputs[report.name] += 1
        return True

    def next_instant(self) -> MissionTime | None:
        """When the next step can be, now or later.

        None while a step is under way, while a required process is missing, or when no process wants to act again.
        """
        if self.outstanding or self.missing():
            return None
        if any(member.wants_now for member in self.members.values()):
            return self.now
        wakes = [member.next_wake for member in self.members.values() if member.next_wake is not None]
        return max(self.now, min(wakes)) if wakes else None

    def advance(self, to: MissionTime) -> None:
        """Let time pass up to the next instant at most, without a step."""
        instant = self.next_instant()
        if not self.outstanding:
            self.now = max(self.now, to if instant is None else min(to, instant))

    def grant(self, at: MissionTime) -> dict[str, Grant]:
        """Begin the next step at that instant, which `next_instant` returned; returns the grants by name."""
        self.now = at
        self.step += 1
        grants = {}
        for name, member in self.members.items():
            if member.wants_now or (member.next_wake is not None and member.next_wake <= at):
                grants[name] = Grant(
                    term=self.term(member.process),
                    step=self.step,
                    at=at,
                    process=member.process,
                    expects=dict(member.inputs),
                )
                member.inputs.clear()
                member.poked = False
        self.outstanding = set(grants)
        return grants

    def _server_of(self, query: tuple[str, str], asker: Member) -> Member:
        """The process that receives an input from that query: its server, or its sender if there is no server."""
        return next((other for other in self.members.values() if query in other.serves), asker)
