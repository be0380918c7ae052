"""An answer of the map as text, as a table or as JSON, and as a picture beside it."""

from __future__ import annotations

import json as json_format
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from schemas.wire import Wire

    Found = TypeVar("Found", bound=Wire)

Png = Annotated[Path | None, typer.Option("--png", metavar="FILE", help="Write a picture, too.")]


def show(
    found: Found,
    *,
    lines: Callable[[Found], Sequence[str]],
    table: Callable[[Found], str],
    figure: Callable[[Found], Figure],
    png: Path | None,
    csv: bool,
    json: bool,
) -> None:
    """Print the answer as one of lines, table or JSON, and write its picture if a file is given for it.

    Raises He3Error if the picture cannot be written.
    """
    if png is not None:
        from services.console.report.pictures import save

        save(figure(found), png)
    if json:
        document = found.model_dump(mode="json")
        typer.echo(json_format.dumps(document if png is None else {**document, "written": str(png)}, indent=2))
    elif csv:
        typer.echo(table(found).rstrip())
    else:
        typer.echo("\n".join([*lines(found), *([] if png is None else [f"written to {png}"])]))
