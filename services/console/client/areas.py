"""Areas of a mission, keep-outs and those of interest: listed, and named so that none replaces another unasked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from schemas.commands import CommandStage
from services.console.client.commands import Commanding
from services.console.client.map_queries import MapQueries

if TYPE_CHECKING:
    from he3.frames import Place
    from schemas.commands import CommandStatus


class AreaKind(StrEnum):
    KEEP_OUT = "keep-out"
    """The rover may not enter it."""
    INTEREST = "interest"
    """Its uncertainty counts more, or less, when rounds are planned."""


class AreaState(StrEnum):
    """Whether the rover, as far as Earth knows, has what an operator has sent of the area."""

    IN_FORCE = "in force"
    ON_ITS_WAY = "on its way to the rover"
    """The rover has not reported that it keeps out of this outline; new rounds are planned around it already."""
    UNCONFIRMED = "not confirmed by the rover"
    """The rover has rejected it, or it expired or was lost on its way; the ground goes on to plan around it."""
    BEING_REMOVED = "being removed"
    """The rover has not reported that it may enter the area again."""


@dataclass(frozen=True, slots=True)
class Area:
    """An area that is set, or on its way to the rover."""

    kind: AreaKind
    name: str
    polygon_m: tuple[Place, ...]
    """Corners [m]."""
    weight: float | None = None
    """Of an area of interest."""
    state: AreaState = AreaState.IN_FORCE

    def document(self) -> dict[str, Any]:
        """The area as JSON values."""
        corners = [list(corner) for corner in self.polygon_m]
        return {
            "kind": self.kind.value, "name": self.name, "polygon_m": corners, "weight": self.weight,
            "state": self.state.value,
        }  # fmt: skip


class Areas(Commanding, MapQueries):
    """The part of `MissionClient` that knows the areas; `set_interest` and the command `set-keep-out` set them."""

    def areas(self) -> tuple[Area, ...]:
        """All areas, keep-outs first: those in force at the ground, and those that an operator has just sent."""
        return tuple(area for kind in AreaKind for area in self.areas_of(kind))

    def areas_of(self, kind: AreaKind) -> tuple[Area, ...]:
        """The areas of one kind."""
        if kind is AreaKind.INTEREST:
            return tuple(Area(kind, each.area_id, each.polygon_m, each.weight) for each in self.set_interest())
        known = {each.area_id: Area(kind, each.area_id, each.polygon_m) for each in self.track().keep_outs}
        return tuple(with_commanded(known, self.commands()).values())

    def name_objection(self, kind: AreaKind, name: str | None, command_id: str | None = None) -> str | None:
        """One line on why a new area cannot have that name: one of its kind has it. None if it can.

        command_id: of the command that is to set it; one that is sent again sets nothing new.
        """
        if name is None or all(area.name != name for area in self.areas_of(kind)):
            return None
        if command_id is not None and any(each.command.command_id == command_id for each in self.commands()):
            return None
        of = "a keep-out" if kind is AreaKind.KEEP_OUT else "an area of interest"
        return f"expected a new name, got that of {of} that is set: {name}"


def with_commanded(known: Mapping[str, Area], commands: Iterable[CommandStatus]) -> dict[str, Area]:
    """Name -> keep-out: those of the ground's map, changed by the commands that are, or may come, in force.

    known: the keep-outs of the map, which is a moment behind the commands. commands: oldest first.
    """
    found = dict(known)
    for status in commands:
        command, end = status.command, status.end
        name = command.area_id
        if name is None:
            continue
        if end is not None and end.stage is not CommandStage.COMPLETED:
            only_known = found.get(name)
            if only_known is not None and only_known is known.get(name) and only_known.polygon_m == command.polygon_m:
                found[name] = replace(only_known, state=AreaState.UNCONFIRMED)
        elif command.polygon_m is not None:
            state = AreaState.ON_ITS_WAY if end is None else AreaState.IN_FORCE
            found[name] = Area(AreaKind.KEEP_OUT, name, command.polygon_m, state=state)
        elif end is not None:
            found.pop(name, None)
        elif name in found:
            found[name] = replace(found[name], state=AreaState.BEING_REMOVED)
    return found
