"""The picture of a cross-validation: measured over expected values, and where the samples lie that surprise."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from services.console.report.pictures import DPI, ERROR, INK, QUIET, STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from schemas.maps import CrossValidation

FARTHEST = 3.0  # 1, score at which the colours end


def cross_validation_figure(found: CrossValidation) -> Figure:
    """Two panels: each sample's measured over its expected value, with one standard deviation; the scores in place."""
    with rc_context(STYLE):
        figure = Figure(figsize=(9.4, 4.7), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        left, right = figure.subplots(1, 2)
        _draw_values(left, found)
        _draw_places(figure, right, found)
        title = f"Each of {len(found.samples)} samples as all others predict it"
        figure.suptitle(title, fontsize=12.0, fontweight="bold", x=0.012, ha="left")
        note = (
            f"Error {found.rmse_ppb:.3g} ppb RMSE, mean {found.bias_ppb:+.2g} ppb. Within the intervals of 68.3 and "
            f"95.4 %: {found.within_68:.1%} and {found.within_95:.1%}. Scores {found.score_rms:.2f} RMS; 1 is honest, "
            f"more is too certain. Map revision {found.revision}."
        )
        figure.supxlabel(fill(note, 150), fontsize=7.5, color=QUIET, x=0.012, ha="left")
    return figure


def _draw_values(axis: Axes, found: CrossValidation) -> None:
    expected = np.array([sample.expected_ppb for sample in found.samples])
    measured = np.array([sample.measured_ppb for sample in found.samples])
    std = np.array([sample.std_ppb for sample in found.samples])
    low, high = min(expected.min(), measured.min()), max(expected.max(), measured.max())
    room = 0.06 * max(high - low, 1e-3)
    ends = (low - room, high + room)
    axis.plot(ends, ends, color=QUIET, lw=1.0, ls=(0, (5, 3)), label="as expected")
    axis.errorbar(
        expected, measured, xerr=std, fmt="o", ms=4.0, mfc="#1f6f8b", mec="white", mew=0.4, ecolor="#9bbfcb",
        elinewidth=0.8, label="sample, +- 1 std of the prediction",
    )  # fmt: skip
    axis.set(xlim=ends, ylim=ends, xlabel="expected from all others [ppb]", ylabel="measured [ppb]")
    axis.set_aspect("equal")
    axis.grid(color="#d8dde2", lw=0.6)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(loc="best", fontsize=8.0)
    axis.set_title("Measured and expected")


def _draw_places(figure: Figure, axis: Axes, found: CrossValidation) -> None:
    places = np.array([(sample.x_m, sample.y_m) for sample in found.samples])
    scores = np.array([sample.score for sample in found.samples])
    drawn = axis.scatter(
        places[:, 0], places[:, 1], c=scores, cmap=ERROR, vmin=-FARTHEST, vmax=FARTHEST, s=34, edgecolors=INK,
        linewidths=0.4,
    )  # fmt: skip
    axis.set_aspect("equal")
    axis.margins(0.06)
    axis.set(xlabel="east [m]", ylabel="north [m]")
    axis.set_title("Score: measured less expected, in std")
    beyond = "both" if scores.min() < -FARTHEST and scores.max() > FARTHEST else "neither"
    if beyond == "neither":
        beyond = "min" if scores.min() < -FARTHEST else "max" if scores.max() > FARTHEST else "neither"
    figure.colorbar(drawn, ax=axis, extend=beyond, shrink=0.86)
