"""``he3 map save``: a layer as a file."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import Annotated

import typer

from services.console.cli.flag_groups import with_flags
from services.console.cli.map.options import AsOf, LayerName, Threshold, check_threshold
from services.console.cli.options import AsJson
from services.console.cli.session import Session

FORMS = {".npy": "npy", ".png": "png", ".tif": "tiff", ".tiff": "tiff", ".csv": "csv"}
"""Formats in which the ground writes a layer, by the suffix of the file."""


@with_flags
def save(
    session: Session,
    layer: LayerName,
    file: Annotated[Path, typer.Argument(metavar="FILE", help=".npy, .png, .tif (GeoTIFF) or .csv.")],
    threshold: Threshold = None,
    as_of: AsOf = None,
    json: AsJson = False,
) -> None:
    """A whole layer as a file: NumPy, picture, GeoTIFF or table; --json prints its description."""
    check_threshold(layer, threshold)
    form = form_of(file)
    with session.join() as client:
        payload, about = client.picture(layer, form, threshold=threshold, as_of=as_of)
    line = written(file, payload)
    typer.echo(about.model_dump_json(indent=2) if json else line)


def form_of(file: Path) -> str:
    """The format of a file of that name; raises InvalidInput for a suffix it does not know."""
    from he3.errors import InvalidInput

    form = FORMS.get(file.suffix.lower())
    if form is None:
        raise InvalidInput(f"{file}: expected a file name with {', '.join(FORMS)}; got '{file.suffix}'")
    return form


def written(file: Path, payload: bytes) -> str:
    """Write the file; returns a line that reports it. Raises He3Error if it cannot be written."""
    from services.runtime.files.output import failed, write_output

    try:
        write_output(file, payload)
    except OSError as error:
        raise failed(f"{file}: cannot write", error) from None
    return f"written to {file}: {len(payload):,} bytes"


def indented(payload: bytes) -> str:
    """A JSON document for people."""
    return json_format.dumps(json_format.loads(payload), indent=2)
