"""The one table of the processes of a mission: the name of each, its side of the link, and the processes it needs.

The launcher, `--wait-for`, `he3 status`, the benchmarks, the tests and the documentation follow from it. A process's
name is also its node's name, the name in its heartbeats and liveliness tokens, and its package's in `services`.
`python -m services.mission` prints the table as it stands in docs/architecture.md.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from schemas.topics import Side


@dataclass(frozen=True, slots=True)
class ProcessSpec:
    """One row of the table."""

    name: str
    sides: tuple[Side, ...]
    """The networks that it joins."""
    purpose: str
    needs: tuple[str, ...] = ()
    """Processes that it needs and waits for; all may be started in any order."""
    vital: bool = True
    """Whether a mission fails without it. A process that is not vital only subscribes, and may be left out."""
    completes_file: bool = False
    """Whether it completes a file when it is told to end, and so is given more time to end."""

    @property
    def module(self) -> str:
        """The module that is run as a program."""
        return f"services.{self.name}"


LINK = ProcessSpec(
    "link",
    (Side.MOON, Side.EARTH),
    "is the only path between the sides; owns both Zenoh routers and the mission's clock",
)
FIELD = ProcessSpec(
    "field",
    (Side.MOON,),
    "is the Moon itself: answers the rover's instruments with measurements and terrain",
    needs=("link",),
)
ROVER = ProcessSpec(
    "rover",
    (Side.MOON,),
    "drives, drills, analyses, reports; goes into safe mode when it must",
    needs=("link", "field"),
)
GROUND = ProcessSpec(
    "ground",
    (Side.EARTH,),
    "keeps the map, plans rounds, directs the rover, answers operators",
    needs=("link", "rover"),
)
RECORDER = ProcessSpec(
    "recorder",
    (Side.EARTH,),
    "writes everything that reached Earth into one MCAP file",
    needs=("link",),
    vital=False,
    completes_file=True,
)
CONSOLE = ProcessSpec(
    "console",
    (Side.EARTH,),
    "is the operator: the command `he3`, the web page, the Python client",
    needs=("link", "ground"),
    vital=False,
)
"""Started by a person, as often as wanted."""

PROCESSES: tuple[ProcessSpec, ...] = (LINK, FIELD, ROVER, GROUND, RECORDER)
"""The processes that a launcher starts, in this order: each after those that it needs."""

VITAL: tuple[str, ...] = tuple(each.name for each in PROCESSES if each.vital)
"""Names of the processes without which a mission fails."""


def waited_for(names: Iterable[str]) -> tuple[str, ...]:
    """The processes for which the link holds mission time when `names` are started: all but the link."""
    return tuple(name for name in names if name != LINK.name)


def vital_on(side: Side) -> frozenset[str]:
    """Names of the vital processes on that side."""
    return frozenset(each.name for each in PROCESSES if each.vital and side in each.sides)


def process_table() -> str:
    """The table in Markdown."""
    rows = [
        "| process | side | what it does | needs | a mission without it | package |",
        "|---|---|---|---|---|---|",
    ]
    for each in (*PROCESSES, CONSOLE):
        sides = " and ".join(side.value.title() for side in each.sides)
        needs = ", ".join(f"`{name}`" for name in each.needs)
        without = "fails" if each.vital else "continues"
        package = each.module.replace(".", "/")
        rows.append(f"| `{each.name}` | {sides} | {each.purpose} | {needs} | {without} | `{package}` |")
    return "\n".join(rows) + "\n"
