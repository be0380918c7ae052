"""``he3 map samples``, ``plan`` and ``history``: what is measured, driven and planned, and earlier maps."""

from __future__ import annotations

import json as json_format
from typing import Any

import typer

from services.console.cli.flag_groups import with_flags
from services.console.cli.map.files import indented
from services.console.cli.map.options import AsCsv, AsOf
from services.console.cli.options import AsJson, check_one_format
from services.console.cli.session import Session


@with_flags
def samples(
    session: Session,
    csv: AsCsv = False,
    as_of: AsOf = None,
    json: AsJson = False,
) -> None:
    """The samples: where each was taken, and what it holds."""
    from services.console.client.time_format import utc

    document = _table(session, "samples", csv, as_of, json)
    if document is None:
        return
    typer.echo(f"{'sample':<10} {'round':>5} {'east m':>8} {'north m':>8} {'ppb':>8}  measured")
    for row in document["samples"]:
        typer.echo(
            f"{row['sample_id']:<10} {row['round']:>5} {row['x_m']:>8.1f} {row['y_m']:>8.1f} "
            f"{row['helium3_ppb']:>8.3f}  {utc(row['measured_at'])}"
        )


@with_flags
def plan(
    session: Session,
    csv: AsCsv = False,
    as_of: AsOf = None,
    json: AsJson = False,
) -> None:
    """The path that the rover has driven, and the path that is planned."""
    import numpy as np

    from he3.frames import path_length

    paths = _table(session, "plan", csv, as_of, json)
    if paths is None:
        return
    for name, key in (("driven", "driven_path_m"), ("planned", "planned_path_m")):
        corners = np.array(paths[key], dtype=np.float64).reshape(-1, 2)
        end = f", to ({corners[-1, 0]:.1f}, {corners[-1, 1]:.1f}) m" if len(corners) else ""
        typer.echo(f"{name:<11} {path_length(corners):,.0f} m over {len(corners)} corners{end}")


@with_flags
def history(
    session: Session,
    json: AsJson = False,
) -> None:
    """The maps that --as-of can name."""
    from services.console.client.time_format import utc

    with session.join() as client:
        found = client.history()
    if json:
        typer.echo(found.model_dump_json(indent=2))
        return
    typer.echo(f"{'revision':>8} {'samples':>8} {'mean std ppb':>13}  since")
    for each in found.revisions:
        typer.echo(f"{each.revision:>8} {each.samples:>8} {each.mean_std_ppb:>13.4f}  {utc(each.mission_time_ns)}")


def _table(session: Session, layer: str, csv: bool, as_of: str | None, json: bool) -> dict[str, Any] | None:
    """The table as a document; None if it was already printed for --csv or --json."""
    check_one_format(csv, json)
    with session.join() as client:
        payload = client.table(layer, "csv" if csv else "json", as_of=as_of)
    if csv or json:
        typer.echo(payload.decode().rstrip() if csv else indented(payload))
        return None
    document: dict[str, Any] = json_format.loads(payload)
    return document
