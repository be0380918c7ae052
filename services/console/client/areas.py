"""Areas of a mission, keep-outs and those of interest: listed, and named so that none replaces another unasked."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
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


@dataclass(frozen=True, slots=True)
class Area:
    """An area that is set, or on its way to the rover."""

    kind: AreaKind
    name: str
    polygon_m: tuple[Place, ...]
    """Corners [m]."""
    weight: float | None = None
    """Of an area of interest."""

    def document(self) -> dict[str, Any]:
        """The area as JSON values."""
        corners = [list(corner) for corner in self.polygon_m]
        return {"kind": self.kind.value, "name": self.name, "polygon_m": corners, "weight": self.weight}


class Areas(Commanding, MapQueries):
    """The part of `MissionClient` that knows the areas; `set_interest` and the command `set-keep-out` set them."""

    def areas(self) -> tuple[Area, ...]:
        """All areas, keep-outs first: those in force at the ground, and those that an operator has just sent."""
        return tuple(area for kind in AreaKind for area in self.areas_of(kind))

    def areas_of(self, kind: AreaKind) -> tuple[Area, ...]:
        """The areas of one kind."""
        if kind is AreaKind.INTEREST:
            return tuple(Area(kind, each.area_id, each.polygon_m, each.weight) for each in self.set_interest())
        outlines = {each.area_id: each.polygon_m for each in self.track().keep_outs}
        outlines.update(commanded_keep_outs(self.commands()))
        return tuple(Area(kind, name, corners) for name, corners in outlines.items())

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


def commanded_keep_outs(commands: Iterable[CommandStatus]) -> dict[str, tuple[Place, ...]]:
    """Name -> corners [m] of the keep-outs that operators have set and that are, or may come, in force."""
    found: dict[str, tuple[Place, ...]] = {}
    for status in commands:
        command, end = status.command, status.end
        if command.area_id is None or (end is not None and end.stage is not CommandStage.COMPLETED):
            continue
        if command.polygon_m is not None:
            found[command.area_id] = command.polygon_m
        elif end is not None:
            found.pop(command.area_id, None)
    return found
