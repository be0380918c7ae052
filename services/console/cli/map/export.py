"""``he3 map export``: the whole map with its samples, of a running mission or of a recording, as files."""

from __future__ import annotations

import json as json_format
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.console.cli.flag_groups import with_flags
from services.console.cli.map.options import AsOf
from services.console.cli.options import MAX_PPB, AsJson, Quiet, within
from services.console.cli.session import Session

if TYPE_CHECKING:
    from services.console.map_export.folder import Exported


@with_flags
def export(
    session: Session,
    target: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="A folder; or a file .npz (layers and samples) or .csv (x, y, mean, std)."),
    ],
    threshold: Annotated[
        float,
        typer.Option("--threshold", metavar="PPB", help="Abundance for the probability of exceedance.",
                     callback=within(0, MAX_PPB)),
    ] = 8.0,
    as_of: AsOf = None,
    region: Annotated[
        str | None,
        typer.Option("--region", metavar="REGION", help="The mission's region, where it is elsewhere on this machine."),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option("--recording", metavar="FILE", help="The map of that recording, instead of a running mission's."),
    ] = None,
    pds4: Annotated[bool, typer.Option("--pds4", help="Rasters with PDS4 labels as well, in DIR/pds4.")] = False,
    quiet: Quiet = False,
    json: AsJson = False,
) -> None:  # fmt: skip
    """The whole map for geographic tools: GeoTIFF, GeoPackage, GeoJSON, CSV and a STAC item, in a folder."""
    from he3.errors import InvalidInput
    from services.console.report.export import WRITERS

    if recording is not None and (session.mission is not None or session.earth is not None):
        raise InvalidInput("--recording and --mission or --earth: expected one of them, got both")
    if recording is not None and target.suffix in WRITERS:
        raise InvalidInput(f"map export {target}: expected a folder with --recording, got '{target.suffix}'")
    if target.suffix in WRITERS:
        if region is not None or pds4:
            raise InvalidInput(f"map export {target}: expected a folder with --region or --pds4, got a file")
        _export_file(target, session, as_of, json)
        return
    if target.suffix and not target.is_dir():
        expected = f"a folder (one with a dot in its name has to exist), or a file name with {' or '.join(WRITERS)}"
        raise InvalidInput(f"map export {target}: expected {expected}, got '{target.suffix}'")
    progress = _silent if quiet or json else partial(typer.echo, err=True)
    if recording is None:
        with session.join() as client:
            done = client.export_maps(
                target, threshold_ppb=threshold, as_of=as_of, region=region, pds4=pds4, progress=progress
            )
    else:
        from services.console.map_export.folder import export_folder
        from services.console.report.recorded_map import recorded_map

        with export_folder(target) as folder:
            contents = recorded_map(recording, threshold_ppb=threshold, as_of=as_of, region=region)
            done = folder.write(contents, pds4=pds4, progress=progress)
    _report(done, json)


def _silent(line: str) -> None:
    """No progress."""


def _report(done: Exported, json: bool) -> None:
    if json:
        typer.echo(json_format.dumps({**asdict(done), "folder": str(done.folder)}, indent=2))
        return
    typer.echo(f"written to {done.folder}: {len(done.files)} files, revision {done.revision}, {done.samples} samples")
    typer.echo(f"frame         {done.frame}")
    for note in done.notes:
        typer.echo(f"note          {note}")


def _export_file(file: Path, session: Session, as_of: str | None, json: bool) -> None:
    from schemas.maps import MapLayer
    from services.console.report.export import EXPORTED, WRITERS, Export
    from services.console.report.mission_report import array_of

    with session.join() as client:
        mean = client.raster(MapLayer.MEAN, as_of=as_of)
        rasters = {layer: client.raster(layer, as_of=mean.revision) for layer in EXPORTED}
        track = client.track(mean.revision)
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
    if json:
        done = {"file": str(file), "revision": mean.revision, "samples": len(track.samples)}
        typer.echo(json_format.dumps(done, indent=2))
        return
    typer.echo(
        f"written to {file}: {mean.rows} x {mean.columns} cells, revision {mean.revision}, {len(track.samples)} samples"
    )
