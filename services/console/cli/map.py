"""``he3 map``: the live map, at a place, as a picture, as numbers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.console.cli import mapparts
from services.console.cli.options import AsJson, Earth, Mission

if TYPE_CHECKING:
    from schemas.ground import MissionTrack
    from schemas.maps import MapRaster
    from schemas.wire import Wire

EXAMPLES = """\b
Examples:
  he3 map at 120 340
  he3 map show mean
  he3 map show std --png std.png
  he3 map show exceedance --threshold 10
  he3 map export belief.npz
  he3 map score --json
  he3 map box mean 100 100 200 200 --resolution 5
  he3 map save exceedance rich.tif --threshold 9
  he3 map resource 100,100 200,100 150,200 --cutoff 9
  he3 map samples --csv
  he3 map show mean --as-of 12
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

LayerName = Annotated[
    str, typer.Argument(metavar="LAYER", help="mean, std, information, exceedance (with --threshold) or traversable.")
]
Threshold = Annotated[
    float | None, typer.Option("--threshold", metavar="PPB", help="Probability of more helium-3 than that.")
]
AsOf = Annotated[
    str | None, typer.Option("--as-of", metavar="WHEN", help="An earlier map: revision, or time 2030-01-01T06:00:00Z.")
]


@app.command("at", epilog=EXAMPLES, context_settings={"ignore_unknown_options": True})
def at(
    x: Annotated[float, typer.Argument(metavar="X", help="Metres east of the south-west corner.")],
    y: Annotated[float, typer.Argument(metavar="Y", help="Metres north of it.")],
    threshold: Threshold = None,
    as_of: AsOf = None,
    mission: Mission = None,
    earth: Earth = None,
    json: AsJson = False,
) -> None:
    """The belief at one place: how much helium-3, and how sure."""
    from schemas.maps import MapPoint, MapPointQuery
    from schemas.topics import MAP_POINT
    from services.console.client.session import join

    request = _checked(MapPointQuery, "at", x=x, y=y, threshold=threshold, as_of=as_of)
    with join(mission, earth) as client:
        point: MapPoint = client.query(MAP_POINT, request)
    if json:
        typer.echo(point.model_dump_json(indent=2))
        return
    low, high = point.mean_ppb - 2 * point.std_ppb, point.mean_ppb + 2 * point.std_ppb
    typer.echo(f"helium-3    {point.mean_ppb:.3f} ppb, std {point.std_ppb:.3f} ppb (95 %: {low:.3f} to {high:.3f})")
    typer.echo(
        f"place       ({point.x_m:g}, {point.y_m:g}) m, {'traversable' if point.traversable else 'not traversable'}"
    )
    if point.exceedance is not None:
        typer.echo(f"more        than {threshold:g} ppb with probability {point.exceedance:.3f}")
    if point.information_nats is not None:
        typer.echo(f"worth       {point.information_nats:.3f} nat to drill there")
    typer.echo(f"map         revision {point.revision}, {point.samples} samples")


def _checked(query: type[Wire], command: str, **values: Any) -> Any:
    """The query of those values; raises InvalidInput with one line."""
    from pydantic import ValidationError

    from he3.errors import InvalidInput
    from schemas.codec import one_line

    try:
        return query(**values)
    except ValidationError as error:
        raise InvalidInput(f"map {command}: {one_line(error)}") from None


@app.command("show", epilog=EXAMPLES)
def show(
    layer: LayerName,
    png: Annotated[Path | None, typer.Option("--png", metavar="FILE", help="Write a picture instead.")] = None,
    width: Annotated[int, typer.Option("--width", metavar="N", help="Characters across.", min=10, max=250)] = 72,
    threshold: Threshold = None,
    as_of: AsOf = None,
    mission: Mission = None,
    earth: Earth = None,
    json: AsJson = False,
) -> None:
    """A whole layer, drawn in the terminal; with --png as a picture, with --json as the reply itself."""
    from schemas.commands import NoParameters
    from schemas.topics import MAP_LAYER, TRACK
    from services.console.client.session import join

    request = _layer(layer, threshold, as_of)
    with join(mission, earth) as client:
        raster: MapRaster = client.query(MAP_LAYER, request)
        track: MissionTrack | None = client.query(TRACK, NoParameters()) if png is not None else None
    if png is not None and track is not None:
        from services.console.report.pictures import layer_figure, save

        save(layer_figure(raster, track), png)
        typer.echo(f"written to {png}")
    elif json:
        typer.echo(raster.model_dump_json(indent=2))
    else:
        from services.console.cli.terminal import drawn
        from services.console.report.mission_report import array_of

        typer.echo("\n".join(drawn(array_of(raster), raster, width)))


def _layer(name: str, threshold: float | None, as_of: str | None) -> Any:
    from he3.errors import InvalidInput
    from schemas.maps import RASTERS, MapLayerQuery

    layers = {layer.value: layer for layer in RASTERS}
    if name not in layers:
        raise InvalidInput(f"map show: expected a layer out of {', '.join(layers)}; got '{name}'")
    if (name == "exceedance") != (threshold is not None):
        raise InvalidInput(f"map show: expected --threshold with exceedance, and only there; got layer {name}")
    return _checked(MapLayerQuery, "show", layer=layers[name], threshold=threshold, as_of=as_of)


@app.command("export", epilog=EXAMPLES)
def export(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help=".npz (all layers and samples) or .csv (x, y, mean, std).")
    ],
    mission: Mission = None,
    earth: Earth = None,
) -> None:
    """The whole map and the samples, as numbers in a file."""
    from he3.errors import InvalidInput
    from schemas.commands import NoParameters
    from schemas.maps import MapLayer, MapLayerQuery
    from schemas.topics import MAP_LAYER, TRACK
    from services.console.client.session import join
    from services.console.report.export import EXPORTED, WRITERS, Export
    from services.console.report.mission_report import array_of

    if file.suffix not in WRITERS:
        raise InvalidInput(f"map export {file}: expected a file name with {' or '.join(WRITERS)}, got '{file.suffix}'")
    with join(mission, earth) as client:
        rasters = {layer: client.query(MAP_LAYER, MapLayerQuery(layer=layer)) for layer in EXPORTED}
        track = client.query(TRACK, NoParameters())
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


@app.command("score", epilog=EXAMPLES)
def score(mission: Mission = None, earth: Earth = None, json: AsJson = False) -> None:
    """How the map compares with the reference field, which only a simulated Moon can tell."""
    from schemas.commands import NoParameters
    from schemas.maps import MapScore
    from schemas.topics import MAP_SCORE
    from services.console.client.session import join

    with join(mission, earth) as client:
        figures: MapScore = client.query(MAP_SCORE, NoParameters())
    if json:
        typer.echo(figures.model_dump_json(indent=2))
        return
    typer.echo(f"RMSE        {figures.rmse_ppb:.4f} ppb over all cells, mean std {figures.mean_std_ppb:.4f} ppb")
    typer.echo(
        f"coverage    {figures.coverage_68:.1%} within 1 std (nominal 68.3 %), "
        f"{figures.coverage_95:.1%} within 2 std (nominal 95.4 %)"
    )
    typer.echo(f"map         revision {figures.revision}, {figures.samples} samples")


mapparts.add_to(app, EXAMPLES)
