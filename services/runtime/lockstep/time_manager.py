"""The time keeper's core: conservative synchronisation by counting messages, without I/O.

Virtual time goes in steps. A step is one instant and those who act at it; each of them is granted it together with the
number of inputs, by sender, that it must have taken in first. They report what they sent, and from that follows who
acts in the next step. Time moves only when every process is idle and every message has been received, and then to the
earliest instant at which anybody wants to act. So no grant is ever early, and nothing that a process could still
receive lies before the time it is granted.

Every input is handled in the step after the one in which it was sent. So what is counted never outlives a step, and
what a process that is gone has left behind is never mistaken for what its successor sends.
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
    """What it has been sent in the last step, by sender."""
    finished: str | None = None

    @property
    def wants_now(self) -> bool:
        """Whether it has to act in the very next step."""
        return self.poked or bool(self.inputs)


class TimeManager:
    """Who takes part, where each stands, and what the next step is."""

    def __init__(self, now: MissionTime, required: frozenset[str], identity: str = "keeper") -> None:
        """required: time does not move while one of these does not take part. identity: of this start of it."""
        self._identity = identity
        self.now = now
        self.step = 0
        self.required = required
        self.members: dict[str, Member] = {}
        self.outstanding: set[str] = set()
        """Who has been granted the present step and has not finished it."""
        self._candidates: dict[str, Join] = {}
        self._starts: dict[str, list[str]] = {}
        self._given_up: Counter[str] = Counter()

    # --- who takes part -----------------------------------------------------------------------------------------

    def join(self, joining: Join) -> bool:
        """A process wants to take part, or asks whether it still does; `admit` takes it in between two steps.

        False if it obeys grants of another term, of a time keeper that is gone or from before it was given up: it may
        still act upon those, and what it says of itself be out of date before it is taken in.

        An earlier process of that name is given up. Raises InvalidInput for that earlier process, should it wake up
        and ask, and when somebody else serves what it serves: nobody could say then whom a question reaches.
        """
        latest = self._starts.get(joining.name, [joining.process])[-1]
        if joining.process != latest and joining.process in self._starts[joining.name]:
            raise InvalidInput(f"another process has taken part as {joining.name} since: {latest}")
        for other in self.members.values():
            both = other.serves & frozenset(joining.serves)
            if other.name != joining.name and both:
                topic, side = min(both)
                raise InvalidInput(
                    f"{joining.name}: expected to serve what nobody serves, got {topic} on {side}, "
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
        """Take in everybody who wants to take part, unless a step is under way; returns whom to tell so.

        Only between two steps is it certain which messages reach a newcomer: all of those sent from now on.
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
        """Which grants that process has to obey."""
        return f"{self._identity}/{self._given_up[process]}"

    def answer(self, joining: Join, admitted: bool) -> Joined:
        """What to tell a process that was taken in, or that obeys another term."""
        return Joined(
            term=self.term(joining.process),
            admitted=admitted,
            now=self.now,
            step=self.step,
            starts=len(self._starts.get(joining.name, ())),
        )

    def leave(self, process: str) -> str | None:
        """That process is gone: nobody waits for it any more. Its name, or None if it did not take part.

        What it sent in a step that it did not finish nobody has counted. It is there before whatever comes next, so
        everybody acts in the next step, and handles it then.
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
        """That one only looks on: time need not wait for it."""
        self.required -= {name}

    def missing(self) -> list[str]:
        """Who is required and does not take part."""
        return sorted(self.required - self.members.keys())

    # --- steps --------------------------------------------------------------------------------------------------

    def poke(self, name: str, process: str) -> None:
        """Something that nobody has counted waits for that process."""
        member = self.members.get(name)
        if member is not None and member.process == process:
            member.poked = True

    def done(self, report: StepDone) -> bool:
        """Take in what a process did in the present step. Whether that was expected of it.

        If not, it was given up before; everybody acts once more, so that what it sent all the same does not lie about.
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
                # A question does not outlive the connection of either; then its answer goes nowhere.
                if asker.process == process and step > max(asker.since, member.since):
                    asker.inputs[report.name] += 1
        return True

    def next_instant(self) -> MissionTime | None:
        """When the next step can be: now, later, or None while a step is under way, somebody is missing, or no one
        wants to act ever again."""
        if self.outstanding or self.missing():
            return None
        if any(member.wants_now for member in self.members.values()):
            return self.now
        wakes = [member.next_wake for member in self.members.values() if member.next_wake is not None]
        return max(self.now, min(wakes)) if wakes else None

    def advance(self, to: MissionTime) -> None:
        """Let time pass in which nothing happens, up to the next instant at most."""
        instant = self.next_instant()
        if not self.outstanding:
            self.now = max(self.now, to if instant is None else min(to, instant))

    def grant(self, at: MissionTime) -> dict[str, Grant]:
        """Begin the next step at that instant, which `next_instant` named: what to tell whom."""
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
        """Who has to take the question in; the asker himself, to whom silence comes, if nobody serves it."""
        return next((other for other in self.members.values() if query in other.serves), asker)
