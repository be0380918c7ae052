"""Site coordinates on the command line: metres east and north of the south-west corner, negative ones included."""

from __future__ import annotations

from typing import Annotated

import typer

from services.console.cli.options import MAX_POSITION_M, within

NEGATIVE_NUMBERS = {"ignore_unknown_options": True}
"""Context settings of every command that takes coordinates: without them -5 is read as an option."""

_metres = within(-MAX_POSITION_M, MAX_POSITION_M)

X = Annotated[
    float, typer.Argument(metavar="X", help="Metres east of the south-west corner.", callback=_metres)
]  # fmt: skip
Y = Annotated[
    float, typer.Argument(metavar="Y", help="Metres north of the south-west corner.", callback=_metres)
]  # fmt: skip
XMin = Annotated[float, typer.Argument(metavar="X_MIN", help="Western edge [m].", callback=_metres)]
YMin = Annotated[float, typer.Argument(metavar="Y_MIN", help="Southern edge [m].", callback=_metres)]
XMax = Annotated[float, typer.Argument(metavar="X_MAX", help="Eastern edge [m].", callback=_metres)]
YMax = Annotated[float, typer.Argument(metavar="Y_MAX", help="Northern edge [m].", callback=_metres)]


def _corners(texts: list[str] | None) -> list[str] | None:
    if texts:
        polygon(texts)
    return texts


def polygon(texts: list[str]) -> tuple[tuple[float, float], ...]:
    """The corners of an area from texts such as 100,-5; raises typer.BadParameter for fewer than three."""
    corners = tuple(map(corner, texts))
    if len(corners) < 3:
        raise typer.BadParameter(f"expected a polygon of at least 3 corners, got {len(corners)}")
    return corners


def corner(text: str) -> tuple[float, float]:
    """The place [m] from a text such as 100,-5; raises typer.BadParameter for anything else."""
    return _place(text, "corner")


def points(texts: list[str]) -> tuple[tuple[float, float], ...]:
    """The places [m] from texts such as 100,-5; raises typer.BadParameter for anything else."""
    return tuple(_place(text, "place") for text in texts)


def _place(text: str, what: str) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"expected a {what} as X,Y in metres, got '{text}'") from None
    _metres([x, y])
    return x, y


Corners = Annotated[
    list[str] | None,
    typer.Argument(metavar="X,Y", help="Corners of the area [m], three or more.", callback=_corners),
]
