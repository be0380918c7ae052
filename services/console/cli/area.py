"""``he3 area``: the areas that the rover may not enter and those of interest: list, add, rename, remove."""

from __future__ import annotations

import json as json_format
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.console.cli.command import Area as AreaName
from services.console.cli.command import Replace, Yes, asks, checked_name, confirmed, expect_new_name
from services.console.cli.coordinates import NEGATIVE_NUMBERS, polygon
from services.console.cli.flag_groups import with_flags
from services.console.cli.options import AsJson, one_of, within
from services.console.cli.session import NamedSession, Session

if TYPE_CHECKING:
    from schemas.commands import CommandStatus
    from services.console.client.areas import Area
    from services.console.client.commands import CommandHandle
    from services.console.client.mission_client import MissionClient
    from services.console.client.previews import CommandOutlook

EXAMPLES = """\b
Examples:
  he3 area list
  he3 area add crater 100,100 150,100 125,150               # a keep-out; asks before it is sent
  he3 area add ridge 300,300 380,300 340,360 --interest --weight 3
  he3 area add crater 90,90 160,90 125,160 --replace        # another outline for it
  he3 area rename crater north-crater
  he3 area remove ridge --yes
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

KINDS = ("keep-out", "interest")


def _kind(word: str | None) -> str | None:
    if word is not None and word not in KINDS:
        raise typer.BadParameter(f"expected one of {', '.join(KINDS)}; got '{word}'")
    return word


Kind = Annotated[
    str | None,
    typer.Option("--kind", metavar="KIND", help="keep-out or interest, where both have an area of that name.",
                 callback=_kind, autocompletion=one_of(*KINDS)),
]  # fmt: skip
Weight = Annotated[
    float,
    typer.Option("--weight", metavar="W", help="Of an area of interest: how much its uncertainty counts.",
                 callback=within(0, 1000)),
]  # fmt: skip


@app.command("list", short_help="List the areas and the changes on their way to the rover.", epilog=EXAMPLES)
@with_flags
def list_areas(
    session: Session,
    json: AsJson = False,
) -> None:
    """List the areas, and say which changes are still on their way to the rover."""
    with session.join() as client:
        areas = client.areas()
    typer.echo(_document(areas) if json else "\n".join(area_lines(areas)) or "no area is set")


@app.command(epilog=EXAMPLES, context_settings=NEGATIVE_NUMBERS)
@with_flags
def add(
    session: NamedSession,
    name: AreaName,
    corners: Annotated[
        list[str], typer.Argument(metavar="X,Y", help="Corners of the area [m], three or more.")
    ],
    interest: Annotated[
        bool, typer.Option("--interest", help="An area of interest; without it, one that the rover may not enter.")
    ] = False,
    weight: Weight = 2.0,
    replace: Replace = False,
    yes: Yes = False,
    json: AsJson = False,
) -> None:  # fmt: skip
    """Add an area. Its name is new, unless --replace is given."""
    from services.console.client.areas import Area, AreaKind

    kind = AreaKind.INTEREST if interest else AreaKind.KEEP_OUT
    area = Area(kind, name, polygon(corners), weight if interest else None)
    with session.join() as client:
        if not replace:
            expect_new_name(client, kind, name)
        sent = _set(client, area, yes=yes)
        _print(client, sent, _said(area, f"{kind.value} {name}", "is set"), json)


@app.command(epilog=EXAMPLES)
@with_flags
def rename(
    session: NamedSession,
    name: Annotated[str, typer.Argument(metavar="OLD", help="Present name of the area.", callback=checked_name)],
    new_name: Annotated[str, typer.Argument(metavar="NEW", help="Its new name.", callback=checked_name)],
    kind: Kind = None,
    yes: Yes = False,
    json: AsJson = False,
) -> None:
    """Give an area a new name. A keep-out stays closed meanwhile; it takes two commands, and one question for both."""
    from dataclasses import replace as changed

    from he3.errors import InvalidInput

    with session.join() as client:
        area = _found(client.areas(), name, kind)
        objection = client.name_objection(area.kind, new_name)
        if objection is not None:
            raise InvalidInput(objection)
        sent = _rename(client, area, changed(area, name=new_name), yes=yes)
        _print(client, sent, _said(area, f"the new name {new_name} of {area.kind.value} {name}", "is set"), json)


@app.command(short_help="Remove an area.", epilog=EXAMPLES)
@with_flags
def remove(
    session: NamedSession,
    name: AreaName,
    kind: Kind = None,
    yes: Yes = False,
    json: AsJson = False,
) -> None:
    """Remove an area: the rover may enter it again, or it is worth no more than others."""
    with session.join() as client:
        area = _found(client.areas(), name, kind)
        sent = _remove(client, area, yes=yes)
        _print(client, sent, _said(area, f"the removal of {area.kind.value} {name}", "is done"), json)


def _print(client: MissionClient, sent: list[CommandHandle], text: str, json: bool) -> None:
    """Print the areas that are set now, with the telecommands that were sent, as a JSON document; or the text."""
    commands = [handle.status for handle in sent]
    typer.echo(_document(client.areas(), commands) if json else f"mission '{client.mission}': {text}")


def _document(areas: tuple[Area, ...], sent: list[CommandStatus] | None = None) -> str:
    """The areas as JSON text; after a change with the telecommands, which an area of interest does not need."""
    document: dict[str, Any] = {"areas": [area.document() for area in areas]}
    if sent is not None:
        document["commands"] = [status.model_dump(mode="json") for status in sent]
    return json_format.dumps(document, indent=2)


def _found(areas: tuple[Area, ...], name: str, kind: str | None) -> Area:
    """The area of that name; raises InvalidInput if there is none, or if there are two and no kind was given."""
    from he3.errors import InvalidInput

    found = [area for area in areas if area.name == name and kind in (None, area.kind)]
    if not found:
        known = ", ".join(area.name for area in areas) or "none"
        raise InvalidInput(f"expected the name of an area that is set ({known}), got '{name}'")
    if len(found) > 1:
        raise InvalidInput(f"expected --kind, as a keep-out and an area of interest have the name '{name}'; got none")
    return found[0]


def _said(area: Area, change: str, done: str) -> str:
    """What has become of a change: the ground has it at once, the rover gets a keep-out later."""
    return f"{change} {done}" if area.weight is not None else f"{change} is on its way to the rover (he3 area list)"


def _set(client: MissionClient, area: Area, *, yes: bool) -> list[CommandHandle]:
    """Set the area; the telecommands that were sent."""
    if area.weight is None:
        return [_command(client, {"area_id": area.name, "polygon_m": area.polygon_m}, yes=yes)]
    client.set_interest(area.name, area.polygon_m, area.weight)
    return []


def _remove(client: MissionClient, area: Area, *, yes: bool) -> list[CommandHandle]:
    """Remove the area; the telecommands that were sent."""
    if area.weight is None:
        return [_command(client, {"area_id": area.name}, yes=yes)]
    client.set_interest(area.name, None)
    return []


def _rename(client: MissionClient, area: Area, renamed: Area, *, yes: bool) -> list[CommandHandle]:
    """Set the area under its new name, then remove the old one; one question, before either is sent."""
    from he3.errors import He3Error

    if area.weight is None and asks("set-keep-out", yes=yes):
        outlook = client.preview("set-keep-out", area_id=renamed.name, polygon_m=renamed.polygon_m)
        then = ("then", f"removes keep-out {area.name}; its ground stays closed under the new name")
        _expect_consent(client, outlook, then)
    sent = _set(client, renamed, yes=True)
    try:
        return sent + _remove(client, area, yes=True)
    except He3Error as error:
        raise He3Error(f"{area.kind.value} {renamed.name} is set, and {area.name} not removed: {error}") from None


def _expect_consent(client: MissionClient, outlook: CommandOutlook, *further: tuple[str, str]) -> None:
    """Return once the operator has read what is to happen and sends it; ends the command if they do not."""
    if not confirmed(client, outlook, *further):
        typer.echo("he3: nothing was sent", err=True)
        raise typer.Exit(1)


def _command(client: MissionClient, what: dict[str, Any], *, yes: bool) -> CommandHandle:
    """Send the keep-out once the operator has read what it does; ends the command if they do not send it."""
    kind = "set-keep-out"
    if asks(kind, yes=yes):
        _expect_consent(client, client.preview(kind, **what))
    return client.command(kind, **what)


def area_lines(areas: tuple[Area, ...]) -> list[str]:
    """The areas in aligned lines of plain text: kind, name, weight, corners, and the state unless it is in force."""
    from services.console.client.areas import AreaState

    width = max((len(area.name) for area in areas), default=0)
    return [
        f"{area.kind.value:<9} {area.name:<{width}}  {'' if area.weight is None else f'weight {area.weight:g}  '}"
        + " ".join(f"{x:g},{y:g}" for x, y in area.polygon_m)
        + ("" if area.state is AreaState.IN_FORCE else f"  ({area.state.value})")
        for area in areas
    ]
