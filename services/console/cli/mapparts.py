"""More of ``he3 map``: parts of layers, areas, tables, earlier maps, files of the ground's own making, the feed."""

from __future__ import annotations

import json as json_format
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.console.cli.options import AsJson, Earth, Mission

if TYPE_CHECKING:
    from schemas.maps import Interval
    from services.console.client.mission_client import MissionClient

AsOf = Annotated[
    str | None,
    typer.Option("--as-of", metavar="WHEN", help="An earlier map: a revision, or a time as 2030-01-01T06:00:00Z."),
]
Threshold = Annotated[float | None, typer.Option("--threshold", metavar="PPB", help="Of the layer exceedance.")]
LayerName = Annotated[str, typer.Argument(metavar="LAYER", help="mean, std, information, exceedance or traversable.")]
IGNORING = {"ignore_unknown_options": True}
"""So that negative numbers are arguments."""


def box(
    layer: LayerName,
    x_min: Annotated[float, typer.Argument(metavar="X_MIN", help="Western edge [m].")],
    y_min: Annotated[float, typer.Argument(metavar="Y_MIN", help="Southern edge [m].")],
    x_max: Annotated[float, typer.Argument(metavar="X_MAX", help="Eastern edge [m].")],
    y_max: Annotated[float, typer.Argument(metavar="Y_MAX", help="Northern edge [m].")],
    resolution: Annotated[
        float | None, typer.Option("--resolution", metavar="M", help="Side of a cell; the map's own if not given.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help=".npy, .png, .tif or .csv.")] = None,
    width: Annotated[int, typer.Option("--width", metavar="N", help="Characters across.", min=10, max=250)] = 60,
    threshold: Threshold = None,
    as_of: AsOf = None,
    mission: Mission = None,
    earth: Earth = None,
    json: AsJson = False,
) -> None:
    """A part of a layer: drawn in the terminal, as a file, or as the reply itself."""
    from schemas.maps import MapRaster
    from schemas.topics import MAP_BOX
    from services.console.cli.terminal import drawn
    from services.console.report.mission_report import array_of

    asked = {
        "layer": layer, "x_min": x_min, "y_min": y_min, "x_max": x_max, "y_max": y_max,
        "resolution_m": resolution, "threshold": threshold, "as_of": as_of,
    }  # fmt: skip
    with _joined(mission, earth) as client:
        payload, _ = client.client.fetch(MAP_BOX, {**asked, "format": "json" if out is None else _format_of(out)})
    if out is not None:
        _write(out, payload)
    elif json:
        typer.echo(_indented(payload))
    else:
        raster = MapRaster.model_validate_json(payload)
        typer.echo("\n".join(drawn(array_of(raster), raster, width)))


def save(
    layer: LayerName,
    file: Annotated[Path, typer.Argument(metavar="FILE", help=".npy, .png, .tif (GeoTIFF) or .csv.")],
    threshold: Threshold = None,
    as_of: AsOf = None,
    mission: Mission = None,
    earth: Earth = None,
    json: AsJson = False,
) -> None:
    """A whole layer as a file: NumPy, picture, GeoTIFF or table; --json says what it shows."""
    form = _format_of(file)
    with _joined(mission, earth) as client:
        payload, about = client.picture(layer, form, threshold=threshold, as_of=as_of)
    _write(file, payload, quiet=json)
    if json:
        typer.echo(about.model_dump_json(indent=2))


def resource(
    polygon: Annotated[
        list[str] | None, typer.Argument(metavar="[X,Y ...]", help="Corners [m], three or more; none: the whole site.")
    ] = None,
    cutoff: Annotated[float, typer.Option("--cutoff", metavar="PPB", help="What is worth digging.")] = 8.0,
    probability: Annotated[float, typer.Option("--probability", metavar="P", help="Of the intervals.")] = 0.9,
    as_of: AsOf = None,
    mission: Mission = None,
    earth: Earth = None,
    json: AsJson = False,
) -> None:
    """How much helium-3 there is in an area, with intervals from the joint posterior."""
    from he3.errors import InvalidInput

    corners = None if not polygon else [_corner(text) for text in polygon]
    if corners is not None and len(corners) < 3:
        raise InvalidInput(f"map resource: expected three corners or more, or none, got {len(corners)}")
    with _joined(mission, earth) as client:
        found = client.resource(corners, cutoff_ppb=cutoff, probability=probability, as_of=as_of)
    if json:
        typer.echo(found.model_dump_json(indent=2))
        return
    rows = [
        ("area", f"{found.area_m2:,.0f} m2, {found.cells:,} cells"),
        ("helium-3", f"{_between(found.mean_ppb, 3)} ppb on average"),
        ("mass", f"{_between(found.mass_kg_per_m, 4)} kg a metre deep, at {found.bulk_density_kg_m3:g} kg/m3"),
        (f"> {found.cutoff_ppb:g} ppb", f"{_between(found.area_above_m2, 0)} m2"),
        ("certain", f"{found.confident_area_m2:,.0f} m2 are each above with {found.probability:.0%} probability"),
        ("intervals", f"{found.probability:.0%}, from the joint posterior; integrated to {_error(found)} ppb"),
        ("map", f"revision {found.revision}, {found.samples} samples"),
    ]
    typer.echo("\n".join(f"{name:<11} {text}" for name, text in rows))


def _error(found: Any) -> str:
    return f"{max(found.quadrature_error_ppb, 1e-6):.1g}"


def _listed(
    layer: str, csv: bool, as_of: str | None, mission: str | None, earth: str | None, json: bool
) -> dict[str, Any] | None:
    """The reply to a query of a layer that is a list; None when it was printed as it is, as --csv or --json asked."""
    from schemas.topics import MAP_LAYER

    with _joined(mission, earth) as client:
        form = "csv" if csv else "json"
        payload, _ = client.client.fetch(MAP_LAYER, {"layer": layer, "format": form, "as_of": as_of})
    if csv or json:
        typer.echo(payload.decode().rstrip() if csv else _indented(payload))
        return None
    document: dict[str, Any] = json_format.loads(payload)
    return document


def samples(
    csv: Annotated[bool, typer.Option("--csv", help="As comma-separated values.")] = False,
    as_of: AsOf = None,
    mission: Mission = None,
    earth: Earth = None,
    json: AsJson = False,
) -> None:
    """What was measured, and where."""
    from services.console.cli.link import clock_text

    document = _listed("samples", csv, as_of, mission, earth, json)
    if document is None:
        return
    rows = document["samples"]
    typer.echo(f"{'sample':<10} {'round':>5} {'east m':>8} {'north m':>8} {'ppb':>8}  measured")
    for row in rows:
        typer.echo(
            f"{row['sample_id']:<10} {row['round']:>5} {row['x_m']:>8.1f} {row['y_m']:>8.1f} "
            f"{row['helium3_ppb']:>8.3f}  {clock_text(row['measured_at'])}"
        )


def plan(
    csv: Annotated[bool, typer.Option("--csv", help="As comma-separated values.")] = False,
    as_of: AsOf = None,
    mission: Mission = None,
    earth: Earth = None,
    json: AsJson = False,
) -> None:
    """Where the rover has driven, and where it is to drive."""
    import numpy as np

    from he3.frames import path_length

    paths = _listed("plan", csv, as_of, mission, earth, json)
    if paths is None:
        return
    for name, key in (("driven", "driven_path_m"), ("planned", "planned_path_m")):
        corners = np.array(paths[key], dtype=np.float64).reshape(-1, 2)
        end = f", to ({corners[-1, 0]:.1f}, {corners[-1, 1]:.1f}) m" if len(corners) else ""
        typer.echo(f"{name:<11} {path_length(corners):,.0f} m over {len(corners)} corners{end}")


def history(mission: Mission = None, earth: Earth = None, json: AsJson = False) -> None:
    """The maps that --as-of can name."""
    from services.console.cli.link import clock_text

    with _joined(mission, earth) as client:
        found = client.history()
    if json:
        typer.echo(found.model_dump_json(indent=2))
        return
    typer.echo(f"{'revision':>8} {'samples':>8} {'mean std ppb':>13}  since")
    for each in found.revisions:
        typer.echo(
            f"{each.revision:>8} {each.samples:>8} {each.mean_std_ppb:>13.4f}  {clock_text(each.mission_time_ns)}"
        )


def follow(
    seconds: Annotated[
        float | None, typer.Option("--seconds", metavar="S", help="Leave after so long; else on Ctrl-C.")
    ] = None,
    mission: Mission = None,
    earth: Earth = None,
    json: AsJson = False,
) -> None:
    """The map's feed: a line for each change as it comes, key frame first."""
    began = time.monotonic()
    with _joined(mission, earth) as client:
        for current in client.maps(timeout_s=seconds):
            figures = {
                "revision": current.revision,
                "samples": current.samples,
                "mean_ppb": float(current.mean_ppb.mean(dtype=float)),
                "mean_std_ppb": float(current.std_ppb.mean(dtype=float)),
                "checksum": f"{current.checksum():08x}",
                "mission_time_ns": current.mission_time_ns,
            }
            if json:
                typer.echo(json_format.dumps(figures))
            else:
                typer.echo(
                    f"{time.monotonic() - began:8.2f} s  revision {current.revision}, {current.samples} samples, "
                    f"mean {figures['mean_ppb']:.4f} ppb, std {figures['mean_std_ppb']:.4f} ppb, {figures['checksum']}"
                )


COMMANDS: dict[str, Callable[..., None]] = {
    "box": box, "save": save, "resource": resource, "samples": samples, "plan": plan, "history": history,
    "follow": follow,
}  # fmt: skip


def add_to(app: typer.Typer, examples: str) -> None:
    """Make these commands part of ``he3 map``."""
    for name, command in COMMANDS.items():
        settings = IGNORING if command in (box, resource) else {}
        app.command(name, epilog=examples, context_settings=settings)(command)


# --- inside ---------------------------------------------------------------------------------------------------------


def _joined(mission: str | None, earth: str | None) -> MissionClient:
    from services.console.client.mission_client import MissionClient

    return MissionClient(earth, mission)


def _format_of(file: Path) -> str:
    from he3.errors import InvalidInput

    forms = {".npy": "npy", ".png": "png", ".tif": "tiff", ".tiff": "tiff", ".csv": "csv"}
    if file.suffix.lower() not in forms:
        raise InvalidInput(f"{file}: expected a file name with {', '.join(forms)}; got '{file.suffix}'")
    return forms[file.suffix.lower()]


def _write(file: Path, payload: bytes, quiet: bool = False) -> None:
    from he3.errors import He3Error

    try:
        file.write_bytes(payload)
    except OSError as error:
        raise He3Error(f"{file}: cannot write: {error.strerror}") from None
    if not quiet:
        typer.echo(f"written to {file}: {len(payload):,} bytes")


def _indented(payload: bytes) -> str:
    return json_format.dumps(json_format.loads(payload), indent=2)


def _corner(text: str) -> tuple[float, float]:
    from he3.errors import InvalidInput

    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise InvalidInput(f"map resource: expected a corner as X,Y in metres, got '{text}'") from None
    return x, y


def _between(interval: Interval, digits: int) -> str:
    return f"{interval.expected:,.{digits}f} ({interval.low:,.{digits}f} to {interval.high:,.{digits}f})"
