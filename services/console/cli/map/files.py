"""``he3 map save`` and ``he3 map export``: a layer, or the whole map with its samples, as a file."""

from __future__ import annotations

import json as json_format
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.console.cli.map.options import AsOf, LayerName, Threshold, check_threshold, joined
from services.console.cli.options import MAX_PPB, AsJson, Earth, IdentityFolder, Insecure, Mission, Quiet, within

if TYPE_CHECKING:
    from services.console.map_export.folder import Exported

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
    target: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="A folder; or a file .npz (layers and samples) or .csv (x, y, mean, std)."),
    ],
    threshold: Annotated[
        float,
        typer.Option("--threshold", metavar="PPB", help="Abundance of the layer exceedance.",
                     callback=within(-MAX_PPB, MAX_PPB)),
    ] = 8.0,
    as_of: AsOf = None,
    region: Annotated[
        str | None,
        typer.Option("--region", metavar="REGION", help="The mission's region, where it is elsewhere on this machine."),
    ] = None,
    pds4: Annotated[bool, typer.Option("--pds4", help="Rasters with PDS4 labels as well, in DIR/pds4.")] = False,
    quiet: Quiet = False,
    mission: Mission = None,
    earth: Earth = None,
    identity: IdentityFolder = None,
    insecure: Insecure = False,
    json: AsJson = False,
) -> None:  # fmt: skip
    """The whole map for geographic tools: GeoTIFF, GeoPackage, GeoJSON, CSV and a STAC item, in a folder."""
    from he3.errors import InvalidInput
    from services.console.report.export import WRITERS

    if target.suffix in WRITERS:
        _export_file(target, mission, earth, identity, insecure)
        return
    if target.suffix and not target.is_dir():
        expected = f"a folder (one with a dot in its name has to exist), or a file name with {' or '.join(WRITERS)}"
        raise InvalidInput(f"map export {target}: expected {expected}, got '{target.suffix}'")
    with joined(mission, earth, identity, insecure) as client:
        done = client.export_maps(
            target, threshold_ppb=threshold, as_of=as_of, region=region, pds4=pds4,
            progress=(lambda line: None) if quiet or json else partial(typer.echo, err=True),
        )  # fmt: skip
    _report(done, json)


def _report(done: Exported, json: bool) -> None:
    if json:
        typer.echo(json_format.dumps({**asdict(done), "folder": str(done.folder)}, indent=2))
        return
    typer.echo(f"written to {done.folder}: {len(done.files)} files, revision {done.revision}, {done.samples} samples")
    typer.echo(f"frame         {done.frame}")
    for note in done.notes:
        typer.echo(f"note          {note}")


def _export_file(file: Path, mission: str | None, earth: str | None, identity: Path | None, insecure: bool) -> None:
    from schemas.maps import MapLayer
    from services.console.report.export import EXPORTED, WRITERS, Export
    from services.console.report.mission_report import array_of

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
