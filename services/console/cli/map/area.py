"""``he3 map resource``: how much helium-3 an area holds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from services.console.cli.coordinates import Corners, polygon
from services.console.cli.flag_groups import with_flags
from services.console.cli.map.options import AsOf
from services.console.cli.options import MAX_PPB, AsJson, within
from services.console.cli.session import Session
from services.console.client.words import counted

if TYPE_CHECKING:
    from schemas.maps import Interval, ResourceEstimate

MIN_PROBABILITY, MAX_PROBABILITY = 1e-6, 1 - 1e-6


@with_flags
def resource(
    session: Session,
    corners: Corners = None,
    cutoff: Annotated[
        float,
        typer.Option("--cutoff", metavar="PPB", help="Cut-off abundance: the area above it is estimated.",
                     callback=within(0, MAX_PPB)),
    ] = 8.0,
    probability: Annotated[
        float,
        typer.Option("--probability", metavar="P", help="Probability of the intervals (between 0 and 1).",
                     callback=within(MIN_PROBABILITY, MAX_PROBABILITY)),
    ] = 0.9,
    as_of: AsOf = None,
    json: AsJson = False,
) -> None:  # fmt: skip
    """Helium-3 in an area (without corners: the whole site), with intervals from the joint posterior."""
    with session.join() as client:
        found = client.resource(
            polygon(corners) if corners else None, cutoff_ppb=cutoff, probability=probability, as_of=as_of
        )
    typer.echo(found.model_dump_json(indent=2) if json else "\n".join(_lines(found)))


def _lines(found: ResourceEstimate) -> list[str]:
    rows = [
        ("area", f"{found.area_m2:,.0f} m2, {found.cells:,} cells"),
        ("helium-3", f"{_between(found.mean_ppb, 3)} ppb on average"),
        ("mass", f"{_between(found.mass_kg_per_m, 4)} kg a metre deep, at {found.bulk_density_kg_m3:g} kg/m3"),
        (f"> {found.cutoff_ppb:g} ppb", f"{_between(found.area_above_m2, 0)} m2"),
        ("certain", f"{found.confident_area_m2:,.0f} m2 are each above with {found.probability:.0%} probability"),
        ("intervals", f"{found.probability:.0%}, from the joint posterior; integrated to {_error(found)} ppb"),
        ("map", f"revision {found.revision}, {counted(found.samples, 'sample')}"),
    ]
    return [f"{name:<11} {text}" for name, text in rows]


def _error(found: ResourceEstimate) -> str:
    return f"{max(found.quadrature_error_ppb, 1e-6):.1g}"


def _between(interval: Interval, digits: int) -> str:
    return f"{interval.expected:,.{digits}f} ({interval.low:,.{digits}f} to {interval.high:,.{digits}f})"
