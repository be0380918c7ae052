"""``he3 map show`` and ``he3 map box``: a layer, or a part of one, in the terminal or as a file."""

from __future__ import annotations

import json as json_format
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.console.cli.coordinates import XMax, XMin, YMax, YMin
from services.console.cli.flag_groups import with_flags
from services.console.cli.map.files import form_of, indented, written
from services.console.cli.map.options import MIN_WIDTH, AsOf, LayerName, Threshold, Width, check_threshold
from services.console.cli.options import MAX_POSITION_M, AsJson, within
from services.console.cli.session import Session

if TYPE_CHECKING:
    from schemas.maps import MapRaster


@with_flags
def show(
    session: Session,
    layer: LayerName,
    png: Annotated[
        Path | None, typer.Option("--png", metavar="FILE", help="Write a picture with samples and paths instead.")
    ] = None,
    width: Width = None,
    threshold: Threshold = None,
    as_of: AsOf = None,
    json: AsJson = False,
) -> None:
    """A whole layer in the terminal; with --png as a picture, with --json as the reply itself, or what was written."""
    check_threshold(layer, threshold)
    with session.join() as client:
        raster = client.raster(layer, threshold=threshold, as_of=as_of)
        track = client.track(as_of) if png is not None else None
    if png is not None and track is not None:
        from services.console.report.pictures import layer_figure, save

        save(layer_figure(raster, track), png)
        done = {"written": str(png), "layer": layer, "revision": raster.revision, "samples": raster.samples}
        typer.echo(json_format.dumps(done, indent=2) if json else f"written to {png}")
    elif json:
        typer.echo(raster.model_dump_json(indent=2))
    else:
        _draw(raster, width or usual_width(72))


@with_flags
def box(
    session: Session,
    layer: LayerName,
    x_min: XMin,
    y_min: YMin,
    x_max: XMax,
    y_max: YMax,
    resolution: Annotated[
        float | None,
        typer.Option("--resolution", metavar="M", help="Side of a cell [m]; the map's own if not given.",
                     callback=within(0, MAX_POSITION_M, above=True)),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="File to write: .npy, .png, .tif or .csv.")
    ] = None,
    width: Width = None,
    threshold: Threshold = None,
    as_of: AsOf = None,
    json: AsJson = False,
) -> None:  # fmt: skip
    """A part of a layer in the terminal, as a file, or with --json as the reply itself, of a file its description."""
    from schemas.maps import MapRaster

    check_threshold(layer, threshold)
    form = "json" if out is None else form_of(out)
    with session.join() as client:
        payload, about = client.box_picture(
            layer, (x_min, x_max), (y_min, y_max), form, resolution_m=resolution, threshold=threshold, as_of=as_of
        )
    if out is not None:
        line = written(out, payload)
        typer.echo(indented(about) if json else line)
    elif json:
        typer.echo(indented(payload))
    else:
        _draw(MapRaster.model_validate_json(payload), width or usual_width(60))


def usual_width(most: int) -> int:
    """Characters across a layer: what a terminal has room for, `MIN_WIDTH` at least and `most` at most."""
    return max(MIN_WIDTH, min(most, shutil.get_terminal_size((most, 24)).columns))


def _draw(raster: MapRaster, width: int) -> None:
    from services.console.cli.terminal import drawn
    from services.console.report.mission_report import array_of

    typer.echo("\n".join(drawn(array_of(raster), raster, width)))
