"""``he3 map cross-validation``: each sample as all the others predict it."""

from __future__ import annotations

import csv as csv_format
import io
from typing import TYPE_CHECKING

from services.console.cli.flag_groups import with_flags
from services.console.cli.map.answers import Png, show
from services.console.cli.map.options import AsCsv, AsOf
from services.console.cli.options import AsJson, check_one_format
from services.console.cli.session import Session
from services.console.client.words import counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from schemas.maps import CrossValidation

SHOWN = 5
"""Samples that the table lists: those that surprise most."""


@with_flags
def cross_validation(
    session: Session,
    png: Png = None,
    csv: AsCsv = False,
    as_of: AsOf = None,
    json: AsJson = False,
) -> None:
    """How good the map is, told by its samples alone: each one as all the others predict it.

    It needs no reference field. The scores are where the measured values lie in their predictions, in standard
    deviations: their root mean square is 1 if the map's uncertainty is honest, and more if the map is too certain.
    """
    check_one_format(csv, json)
    with session.join() as client:
        found = client.cross_validation(as_of)
    show(found, lines=lines_of, table=table_of, figure=_figure, png=png, csv=csv, json=json)


def _figure(found: CrossValidation) -> Figure:
    from services.console.report.cross_validation_picture import cross_validation_figure

    return cross_validation_figure(found)


def table_of(found: CrossValidation) -> str:
    """All samples as comma-separated values, with a line of names."""
    text = io.StringIO()
    rows = [sample.model_dump() for sample in found.samples]
    writer = csv_format.DictWriter(text, rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def lines_of(found: CrossValidation) -> list[str]:
    """The summary, and the samples that surprise most."""
    lines = [
        f"error       {found.rmse_ppb:.4f} ppb RMSE, {found.bias_ppb:+.4f} ppb on average",
        f"coverage    {found.within_68:.1%} within the intervals of 68.3 %, "
        f"{found.within_95:.1%} within those of 95.4 %",
        f"scores      {found.score_rms:.2f} RMS; 1 is honest, more is too certain",
        f"map         revision {found.revision}, {counted(len(found.samples), 'sample')}",
        "",
        f"{'sample':<10} {'east m':>8} {'north m':>8} {'measured':>9} {'expected':>9} {'std':>7} {'score':>6}",
    ]
    lines += (
        f"{each.sample_id:<10} {each.x_m:>8.1f} {each.y_m:>8.1f} {each.measured_ppb:>9.3f} "
        f"{each.expected_ppb:>9.3f} {each.std_ppb:>7.3f} {each.score:>+6.1f}"
        for each in sorted(found.samples, key=lambda sample: -abs(sample.score))[:SHOWN]
    )
    if len(found.samples) > SHOWN:
        lines.append(f"the {SHOWN} of the largest scores, in ppb; --csv and --json list all")
    return lines
