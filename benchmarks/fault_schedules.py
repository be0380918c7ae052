"""Random fault schedules: the faults of a mission, their times and durations; pure and seeded.

A schedule is a list of faults in order of time. After the last fault nothing hinders the mission, so it must end with
every sample in the map exactly once.

A change of the clock's rate is not among the faults: in virtual time there is no rate. That the rate may change at any
time on the wall clock is tested with real processes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from schemas.commands import CommandKind, Telecommand
from schemas.link import AtEdge, LinkChange

SERVICES = ("rover", "ground", "link", "field")


class FaultKind(StrEnum):
    KILL = "kill"
    """A process ends at an instant, and is started again later."""
    CRASH = "crash"
    """A process ends right after it has written its journal, before it carries out the actions."""
    BLACKOUT = "blackout"
    LOSS = "loss"
    DUPLICATION = "duplication"
    REORDERING = "reordering"
    CORRUPTION = "corruption"
    THIN = "thin"
    """The rate collapses to a few hundred bit/s."""
    FAR = "far"
    """The light time grows."""
    COMMAND = "command"
    """An operator's command hinders the mission; a later one undoes it: resume, remove the keep-out."""


LINK_FAULTS = (
    FaultKind.BLACKOUT,
    FaultKind.LOSS,
    FaultKind.DUPLICATION,
    FaultKind.REORDERING,
    FaultKind.CORRUPTION,
    FaultKind.THIN,
    FaultKind.FAR,
)


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault, from `at_s` of mission time for `lasts_s`."""

    kind: FaultKind
    at_s: float
    lasts_s: float
    who: str = ""
    amount: float = 0.0
    torn: bool = False
    """The process leaves the beginning of an unfinished record in its journal."""
    place_m: tuple[float, float] | None = None
    """Target of a drive command, or centre of a keep-out with half width `amount` [m]."""

    def __str__(self) -> str:
        who = f" {self.who}" if self.who else ""
        amount = f" {self.amount:g}" if self.amount else ""
        place = f" ({self.place_m[0]:.1f}, {self.place_m[1]:.1f})" if self.place_m else ""
        lasts = f"at {self.at_s:.3f} s for {self.lasts_s:.3f} s"
        return f"{self.kind.value}{who}{amount}{place} {lasts}{' torn' * self.torn}"


Schedule = tuple[Fault, ...]


COMMANDS = tuple(CommandKind[name] for name in ("PAUSE", "SAFE", "ABORT_ROUND", "GO_TO", "RETURN_TO_START"))


def random_schedule(rng: np.random.Generator, horizon_s: float, extent_m: float, most: int = 8) -> Schedule:
    """Up to `most` faults that begin within `horizon_s` of mission time, in order of time.

    extent_m: of the site; where an operator may send the rover, or close an area to it.
    """
    faults = [_random_fault(rng, horizon_s, extent_m) for _ in range(int(rng.integers(1, most + 1)))]
    return tuple(sorted(faults, key=lambda fault: fault.at_s))


def _random_fault(rng: np.random.Generator, horizon_s: float, extent_m: float) -> Fault:
    at_s = float(rng.uniform(0, horizon_s))
    choice = rng.random()
    if choice < 0.5:
        kind = FaultKind.KILL if rng.random() < 0.6 else FaultKind.CRASH
        lasts_s = float(rng.choice([0.0, 1.0, 30.0, 600.0, 7200.0])) * float(rng.uniform(0.5, 1.5))
        return Fault(kind, at_s, lasts_s, who=str(rng.choice(SERVICES)), torn=bool(rng.random() < 0.5))
    if choice < 0.65:
        return _random_command(rng, at_s, extent_m)
    link_fault = LINK_FAULTS[int(rng.integers(len(LINK_FAULTS)))]
    lasts_s = float(rng.uniform(5, 7200))
    amounts = {
        FaultKind.LOSS: float(rng.uniform(0.05, 0.7)),
        FaultKind.DUPLICATION: float(rng.uniform(0.05, 0.5)),
        FaultKind.REORDERING: float(rng.uniform(0.05, 0.5)),
        FaultKind.CORRUPTION: float(rng.uniform(0.05, 0.5)),
        FaultKind.THIN: float(rng.choice([125.0, 700.0, 2000.0])),
        FaultKind.FAR: float(rng.choice([3.0, 10.0, 60.0])),
        FaultKind.BLACKOUT: float(rng.random() < 0.5),
    }
    return Fault(link_fault, at_s, lasts_s, amount=amounts[link_fault])


def _random_command(rng: np.random.Generator, at_s: float, extent_m: float) -> Fault:
    lasts_s = float(rng.uniform(10, 3600))
    place = (float(rng.uniform(0, extent_m)), float(rng.uniform(0, extent_m)))
    if rng.random() < 0.2:
        half_m = float(rng.uniform(2, 8))
        place = (
            float(np.clip(place[0], half_m, extent_m - half_m)),
            float(np.clip(place[1], half_m, extent_m - half_m)),
        )
        return Fault(FaultKind.COMMAND, at_s, lasts_s, CommandKind.SET_KEEP_OUT.value, half_m, place_m=place)
    kind = COMMANDS[int(rng.integers(len(COMMANDS)))]
    return Fault(FaultKind.COMMAND, at_s, lasts_s, kind.value, place_m=place if kind is CommandKind.GO_TO else None)


def telecommand(fault: Fault, begins: bool, command_id: str) -> Telecommand | None:
    """The operator's commands when that fault begins and ends; None: no command."""
    kind = CommandKind(fault.who)
    if kind is CommandKind.SET_KEEP_OUT and fault.place_m is not None:
        (x, y), half = fault.place_m, fault.amount
        corners = ((x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half))
        area = f"area-{fault.at_s:.0f}"
        return Telecommand(command_id=command_id, kind=kind, area_id=area, polygon_m=corners if begins else None)
    if begins:
        return Telecommand(command_id=command_id, kind=kind, target_m=fault.place_m)
    if kind in (CommandKind.PAUSE, CommandKind.SAFE):
        return Telecommand(command_id=command_id, kind=CommandKind.RESUME)
    return None


def link_change(fault: Fault, begins: bool, light_time_s: float) -> LinkChange:
    """The changes of the link when that fault begins and ends."""
    match fault.kind:
        case FaultKind.BLACKOUT:
            edge = AtEdge.DROP if begins and fault.amount else AtEdge.HOLD
            return LinkChange(contact=not begins, at_edge=edge)
        case FaultKind.LOSS:
            return LinkChange(loss=fault.amount if begins else 0.0)
        case FaultKind.DUPLICATION:
            return LinkChange(duplicate=fault.amount if begins else 0.0)
        case FaultKind.REORDERING:
            return LinkChange(reorder=fault.amount if begins else 0.0)
        case FaultKind.CORRUPTION:
            return LinkChange(corrupt=fault.amount if begins else 0.0)
        case FaultKind.THIN:
            return LinkChange(rate_bit_s=fault.amount) if begins else LinkChange(unlimited_rate=True)
        case FaultKind.FAR:
            return LinkChange(one_way_light_time_s=fault.amount if begins else light_time_s)
    raise ValueError(f"expected a fault of the link, got {fault.kind.value}")


def shrunk(schedule: Schedule, fails: Callable[[Schedule], bool]) -> Schedule:
    """The smallest schedule that still fails: without unneeded faults, the others as short as possible."""
    smaller = schedule
    for fault in schedule:
        without = tuple(other for other in smaller if other is not fault)
        if without and fails(without):
            smaller = without
    for fault in smaller:
        at_once = tuple(replace(other, lasts_s=0.0) if other is fault else other for other in smaller)
        if fault.lasts_s and fails(at_once):
            smaller = at_once
    return smaller
