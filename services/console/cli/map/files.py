"""``he3 map save`` and ``he3 map export``: a layer, or the whole map with its samples, as a file."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import Annotated

import typer

from services.console.cli.map.options import AsOf, LayerName, Threshold, check_threshold, joined
from services.console.cli.options import AsJson, Earth, IdentityFolder, Insecure, Mission

FORMS = {".npy": "npy", ".png": "png", ".tif": "tiff", ".tiff": "tiff", ".csv": "csv"}
"""Formats in which the ground writes a layer, by the suffix of the file."""


def save(
    layer: LayerName,
    file: Annotated[Path, typer.Argument(metavar="FILE", help=".npy, .png, .tif (GeoTIFF) or .csv.")],
    threshold: Threshold = None,
    as_of: AsOf = None,
    mission: Mission = None,
    earth: Earth = None,
    identity: IdentityFolder = None,
    insecure: Insecure = False,
    json: AsJson = False,
) -> None:
    """A whole layer as a file: NumPy, picture, GeoTIFF or table; --json prints its description."""
    check_threshold(layer, threshold)
    form = form_of(file)
    with joined(mission, earth, identity, insecure) as client:
        payload, about = client.picture(layer, form, threshold=threshold, as_of=as_of)
    line = written(file, payload)
    typer.echo(about.model_dump_json(indent=2) if json else line)


def export(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help=".npz (all layers and samples) or .csv (x, y, mean, std).")
    ],
    mission: Mission = None,
    earth: Earth = None,
    identity: IdentityFolder = None,
    insecure: Insecure = False,
) -> None:
    """The whole map and the samples, as numbers in a file."""
    from he3.errors import InvalidInput
    from schemas.maps import MapLayer
    from services.console.report.export import EXPORTED, WRITERS, Export
    from services.console.report.mission_report import array_of

    if file.suffix not in WRITERS:
        raise InvalidInput(f"map export {file}: expected a file name with {' or '.join(WRITERS)}, got '{file.suffix}'")
    with joined(mission, earth, identity, insecure) as client:
        rasters = {layer: client.raster(layer) for layer in EXPORTED}
        track = client.track()
    mean = rasters[MapLayer.MEAN]
    WRITERS[file.suffix](
        Export(
            mean_ppb=array_of(mean),
            std_ppb=array_of(rasters[MapLayer.STD]),
            traversable=array_of(rasters[MapLayer.TRAVERSABLE]).astype(bool),
            resolution_m=mean.resolution_m,
            samples=track.samples,
        ),
        file,
    )
    typer.echo(f"written to {file}: {mean.rows} x {mean.columns} cells, {len(track.samples)} samples")


def form_of(file: Path) -> str:
    """The format of a file of that name; raises InvalidInput for a suffix it does not know."""
    from he3.errors import InvalidInput

    form = FORMS.get(file.suffix.lower())
    if form is None:
        raise InvalidInput(f"{file}: expected a file name with {', '.join(FORMS)}; got '{file.suffix}'")
    return form


def written(file: Path, payload: bytes) -> str:
    """Write the file; returns a line that reports it. Raises He3Error if it cannot be written."""
    from he3.errors import He3Error
    from services.runtime.files.output import write_output

    try:
        write_output(file, payload)
    except OSError as error:
        raise He3Error(f"{file}: cannot write: {error.strerror}") from None
    return f"written to {file}: {len(payload):,} bytes"


def indented(payload: bytes) -> str:
    """A JSON document for people."""
    return json_format.dumps(json_format.loads(payload), indent=2)
