"""The picture of a grade-tonnage curve: ground above each cut-off, and its mean abundance, with intervals."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from services.console.report.pictures import DPI, QUIET, STYLE

if TYPE_CHECKING:
    from schemas.maps import GradeTonnage, Interval

AREA_COLOUR = "#1f6f8b"
GRADE_COLOUR = "#c8553d"


def grade_tonnage_figure(found: GradeTonnage) -> Figure:
    """Share of the area above each cut-off on the left axis, mean abundance there on the right, with intervals."""
    with rc_context(STYLE):
        figure = Figure(figsize=(6.8, 4.5), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        left = figure.add_subplot()
        right = left.twinx()
        cutoffs = np.array([point.cutoff_ppb for point in found.curve])
        some = np.array([point.mean_ppb is not None for point in found.curve])
        area = _ends([point.area_m2 for point in found.curve]) * (100.0 / found.area_m2)
        grade = _ends([point.mean_ppb for point in found.curve if point.mean_ppb is not None])
        for axis, x, (expected, low, high), colour in (
            (left, cutoffs, area, AREA_COLOUR),
            (right, cutoffs[some], grade, GRADE_COLOUR),
        ):
            axis.fill_between(x, low, high, color=colour, alpha=0.18, lw=0)
            axis.plot(x, expected, color=colour, lw=1.9, marker="o", ms=3.0)
            axis.tick_params(axis="y", labelcolor=colour)
            axis.spines["top"].set_visible(False)
        left.set(xlabel="cut-off [ppb]", ylim=(0.0, 104.0))
        left.set_ylabel("ground above the cut-off [% of the area]", color=AREA_COLOUR)
        right.set_ylabel("mean abundance of that ground [ppb]", color=GRADE_COLOUR)
        left.grid(color="#d8dde2", lw=0.6)
        left.set_axisbelow(True)
        title = f"Grade and tonnage of {found.area_m2:,.0f} m²"
        figure.suptitle(title, fontsize=12.0, fontweight="bold", x=0.015, ha="left")
        note = (
            f"Lines are expectations, bands intervals of {found.probability:.0%} from {found.draws:,} fields drawn "
            f"from the joint posterior, at places {found.block_m:.3g} m apart. Map revision {found.revision}, "
            f"{found.samples} samples."
        )
        figure.supxlabel(fill(note, 112), fontsize=7.5, color=QUIET, x=0.015, ha="left")
    return figure


def _ends(intervals: list[Interval]) -> np.ndarray:
    """Expectations, lower and upper ends (3, n)."""
    return np.array([(each.expected, each.low, each.high) for each in intervals]).reshape(-1, 3).T
