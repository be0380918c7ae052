"""The picture of realisations: the map's mean, and a few fields that the samples leave possible, on one scale."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from services.console.report.pictures import ABUNDANCE, DPI, QUIET, STYLE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

SHOWN = 5
PERCENTILES = (0.5, 99.5)
"""Ends of the colour scale, of all values of the realisations that are shown."""


def realisations_figure(
    fields_ppb: NDArray[Any],
    mean_ppb: NDArray[Any],
    extent_m: Sequence[float],
    places_m: NDArray[Any],
    note: str,
) -> Figure:
    """The mean (rows, columns) [ppb] with the samples' places (n, 2) [m], and up to five of the fields beside it.

    fields_ppb: (count, rows, columns). Row 0 is in the south; extent_m: west, east, south, north of all of them.
    """
    shown = fields_ppb[:SHOWN]
    low, high = np.percentile(shown, PERCENTILES)
    with rc_context(STYLE):
        figure = Figure(figsize=(9.6, 6.7), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(2, 3, sharex=True, sharey=True)
        panels = [("Mean of the map", mean_ppb)]
        panels += [(f"Realisation {number + 1}", field) for number, field in enumerate(shown)]
        for axis, (title, values) in zip(axes.flat, panels, strict=False):
            west, east, south, north = extent_m
            drawn = axis.imshow(
                values, origin="lower", extent=(west, east, south, north), cmap=ABUNDANCE, vmin=low, vmax=high,
                interpolation="nearest",
            )  # fmt: skip
            axis.set_title(title)
        axes.flat[0].plot(*places_m.T, ls="none", marker="o", ms=2.6, mfc="#ff5a36", mec="white", mew=0.3)
        for axis in list(axes.flat)[len(panels) :]:
            axis.remove()
        for axis in axes[:, 0]:
            axis.set_ylabel("north [m]")
        for axis in axes[1]:
            axis.set_xlabel("east [m]")
        used = list(axes.flat)[: len(panels)]
        figure.colorbar(drawn, ax=used, label="helium-3 [ppb]", extend="both", shrink=0.7)
        title = "Fields that the samples leave possible"
        figure.suptitle(title, fontsize=12.0, fontweight="bold", x=0.012, ha="left")
        figure.supxlabel(fill(note, 150), fontsize=7.5, color=QUIET, x=0.012, ha="left")
    return figure
