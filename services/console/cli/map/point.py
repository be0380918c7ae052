"""``he3 map at`` and ``he3 map score``: the belief at a place, and how good the whole map is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from services.console.cli.coordinates import X, Y
from services.console.cli.flag_groups import with_flags
from services.console.cli.map.options import AsOf, Threshold
from services.console.cli.options import AsJson
from services.console.cli.session import Session
from services.console.report.summary import reach_in_words

if TYPE_CHECKING:
    from schemas.maps import MapPoint


@with_flags
def at(
    session: Session,
    x: X,
    y: Y,
    threshold: Threshold = None,
    as_of: AsOf = None,
    json: AsJson = False,
) -> None:
    """The belief at one place: helium-3 abundance with its uncertainty."""
    with session.join() as client:
        point = client.point(x, y, threshold, as_of)
    if json:
        typer.echo(point.model_dump_json(indent=2))
        return
    rows = [
        ("helium-3", f"{point.mean_ppb:.3f} ppb, std {point.std_ppb:.3f} ppb"),
        *_intervals(point),
        ("place", f"({point.x_m:g}, {point.y_m:g}) m, {'traversable' if point.traversable else 'not traversable'}"),
    ]
    if point.exceedance is not None:
        rows.append(("exceedance", f"more than {threshold:g} ppb with probability {point.exceedance:.3f}"))
    if point.information_nats is not None:
        rows.append(("information", f"{point.information_nats:.3f} nat from one sample"))
    rows.append(("map", f"revision {point.revision}, {point.samples} samples"))
    typer.echo("\n".join(f"{name:<11} {text}" for name, text in rows))


def _intervals(point: MapPoint) -> list[tuple[str, str]]:
    """The central intervals that the ground gives; none if it gives none."""
    each = ("68.3 %", point.low_68_ppb, point.high_68_ppb), ("95.4 %", point.low_95_ppb, point.high_95_ppb)
    told = [f"{name}: {low:.3f} to {high:.3f} ppb" for name, low, high in each if low is not None and high is not None]
    return [("intervals", ", ".join(told))] if told else []


@with_flags
def score(
    session: Session,
    json: AsJson = False,
) -> None:
    """Error of the map against the reference field, which only a simulated Moon can tell."""
    with session.join() as client:
        figures = client.score()
    if json:
        typer.echo(figures.model_dump_json(indent=2))
        return
    typer.echo(f"RMSE        {figures.rmse_ppb:.4f} ppb over all cells with a reference")
    typer.echo(f"mean std    {figures.mean_std_ppb:.4f} ppb")
    typer.echo(
        f"coverage    {figures.coverage_68:.1%} within the intervals of 68.3 %, "
        f"{figures.coverage_95:.1%} within those of 95.4 %"
    )
    if figures.within_reach is not None:
        typer.echo(f"in reach    {reach_in_words(figures.within_reach)}")
    typer.echo(f"map         revision {figures.revision}, {figures.samples} samples")
