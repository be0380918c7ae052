"""``he3 map grade-tonnage``: how much ground of an area lies above each cut-off, and what it holds."""

from __future__ import annotations

import csv as csv_format
import io
from typing import TYPE_CHECKING, Annotated

import typer

from services.console.cli.coordinates import Corners, polygon
from services.console.cli.flag_groups import with_flags
from services.console.cli.map.answers import Png, show
from services.console.cli.map.area import MAX_PROBABILITY, MIN_PROBABILITY
from services.console.cli.map.options import AsCsv, AsOf
from services.console.cli.options import AsJson, check_one_format, checked, within
from services.console.cli.session import Session
from services.console.client.words import counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from schemas.maps import GradeTonnage, Interval

NAMES = ("area_m2", "mean_ppb", "mass_kg_per_m")


def _cutoffs(text: str) -> list[float]:
    from he3.errors import InvalidInput

    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InvalidInput(f"expected numbers as 7,8,9 [ppb], got '{text}'") from None


def _checked(text: str) -> str:
    _cutoffs(text)
    return text


@with_flags
def grade_tonnage(
    session: Session,
    corners: Corners = None,
    cutoffs: Annotated[
        str | None,
        typer.Option("--cutoffs", metavar="PPB,...", help="Cut-off abundances; round steps if not given.",
                     callback=checked(_checked)),
    ] = None,
    probability: Annotated[
        float,
        typer.Option("--probability", metavar="P", help="Probability of the intervals (between 0 and 1).",
                     callback=within(MIN_PROBABILITY, MAX_PROBABILITY)),
    ] = 0.9,
    png: Png = None,
    csv: AsCsv = False,
    as_of: AsOf = None,
    json: AsJson = False,
) -> None:  # fmt: skip
    """The grade-tonnage curve of an area (without corners: of the site), with intervals from the joint posterior.

    For each cut-off: the area of the ground above it, that ground's mean abundance, and its helium-3 a metre deep. The
    abundance is that of places, not a mean over what a machine would mine at once.
    """
    check_one_format(csv, json)
    with session.join() as client:
        found = client.grade_tonnage(
            polygon(corners) if corners else None,
            cutoffs_ppb=None if cutoffs is None else _cutoffs(cutoffs),
            probability=probability,
            as_of=as_of,
        )
    show(found, lines=lines_of, table=table_of, figure=_figure, png=png, csv=csv, json=json)


def _figure(found: GradeTonnage) -> Figure:
    from services.console.report.grade_tonnage_picture import grade_tonnage_figure

    return grade_tonnage_figure(found)


def table_of(found: GradeTonnage) -> str:
    """A line for each cut-off; expectation, lower and upper end of each figure, empty where there is none."""
    text = io.StringIO()
    writer = csv_format.writer(text, lineterminator="\n")
    writer.writerow(["cutoff_ppb", *(f"{name}{end}" for name in NAMES for end in ("", "_low", "_high"))])
    for point in found.curve:
        row: list[float | str] = [point.cutoff_ppb]
        for interval in (point.area_m2, point.mean_ppb, point.mass_kg_per_m):
            row += ["", "", ""] if interval is None else [interval.expected, interval.low, interval.high]
        writer.writerow(row)
    return text.getvalue()


def lines_of(found: GradeTonnage) -> list[str]:
    """The curve as a table, and what it is of."""
    lines = [f"{'> ppb':>7}  {'area':>22}  {'mean ppb':>22}  {'helium-3 kg a metre deep':>26}"]
    for point in found.curve:
        share = _between(point.area_m2, 1, 100.0 / found.area_m2, "%")
        mean = "" if point.mean_ppb is None else _between(point.mean_ppb, 2)
        lines.append(f"{point.cutoff_ppb:>7g}  {share:>22}  {mean:>22}  {_between(point.mass_kg_per_m, 3):>26}")
    return [
        *lines,
        f"area        {found.area_m2:,.0f} m2 in all",
        f"intervals   {found.probability:.0%}, from {found.draws:,} fields at places {found.block_m:.3g} m apart",
        f"map         revision {found.revision}, {counted(found.samples, 'sample')}",
    ]


def _between(interval: Interval, digits: int, times: float = 1.0, unit: str = "") -> str:
    expected, low, high = (f"{times * value:.{digits}f}" for value in (interval.expected, interval.low, interval.high))
    return f"{expected} ({low} to {high}){unit and ' ' + unit}"
