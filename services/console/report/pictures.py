"""Pictures of a mission: reference, belief and its standard deviation side by side; error over samples.

Drawn without a display, in metres, with colour maps that are even to the eye and readable in print and to the
colour-blind: one for abundance, the same scale for reference and belief, another for uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from he3.errors import He3Error
from he3.reference import Region
from schemas.ground import MissionTrack
from schemas.maps import MapLayer, MapRaster, MapScore
from services.console.report.mission_report import array_of

ABUNDANCE = "viridis"
UNCERTAINTY = "magma"
INK = "#1b1f24"
QUIET = "#5b6570"
PATH_COLOUR = "#ffffff"
SAMPLE_COLOUR = "#ff5a36"
START_COLOUR = "#ffd23f"
DPI = 160

_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.edgecolor": QUIET,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": QUIET,
    "ytick.color": QUIET,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
}


@dataclass(frozen=True, slots=True, eq=False)
class MapPicture:
    """Everything that the map's picture shows. Maps are (rows, columns), row 0 in the south."""

    title: str
    note: str
    reference_ppb: NDArray[Any] | None
    """None where nobody knows the truth: then the belief stands alone."""
    mean_ppb: NDArray[Any]
    std_ppb: NDArray[Any]
    traversable: NDArray[np.bool_] | None
    resolution_m: float
    path_m: NDArray[np.float64]
    """(K, 2) driven [m]; may be empty."""
    samples_m: NDArray[np.float64]
    """(N, 2) drilled [m]; may be empty."""
    start_m: tuple[float, float]


def map_figure(picture: MapPicture) -> Figure:
    """The map's picture: two or three panels of the same extent, each with its colour bar."""
    with rc_context(_STYLE):
        panels = _panels(picture)
        figure = Figure(
            figsize=(4.3 * len(panels) + 0.3, 5.75),
            dpi=DPI,
            layout=ConstrainedLayoutEngine(w_pad=0.06, h_pad=0.05, wspace=0.03),
        )
        FigureCanvasAgg(figure)
        axes = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
        for index, (axis, panel) in enumerate(zip(axes, panels, strict=True)):
            _draw_panel(figure, axis, panel, picture)
            if index == 0:
                axis.set_ylabel("north [m]")
        figure.suptitle(picture.title, fontsize=12.5, fontweight="bold", x=0.012, ha="left")
        figure.supxlabel(picture.note, fontsize=7.5, color=QUIET, x=0.012, ha="left")
        figure.legend(handles=_legend(picture), loc="outside upper right", ncols=4, fontsize=8.5, handlelength=1.8)
    return figure


def _legend(picture: MapPicture) -> list[Any]:
    star = Line2D([], [], marker="*", ms=10, mfc=START_COLOUR, mec=INK, mew=0.7, ls="none", label="start")
    driven = Line2D([], [], color="#9aa4ad", lw=1.6, label="driven")
    drilled = Line2D([], [], marker="o", ms=4.5, mfc=SAMPLE_COLOUR, mec="white", mew=0.4, ls="none", label="sample")
    closed = Patch(facecolor="#c9d0d6", edgecolor="white", hatch="//////", label="not traversable")
    return [
        star,
        *([driven] if len(picture.path_m) else []),
        *([drilled] if len(picture.samples_m) else []),
        *([] if picture.traversable is None or picture.traversable.all() else [closed]),
    ]


@dataclass(frozen=True, slots=True, eq=False)
class _Panel:
    title: str
    values: NDArray[Any]
    colours: str
    low: float
    high: float
    label: str
    dots: str
    with_path: bool


def _panels(picture: MapPicture) -> list[_Panel]:
    shared = picture.mean_ppb if picture.reference_ppb is None else picture.reference_ppb
    low, high = float(np.min(shared)), float(np.max(shared))
    if not high > low:
        low, high = low - 0.5, high + 0.5
    ppb = "helium-3 [ppb]"
    belief = _Panel("Belief: posterior mean", picture.mean_ppb, ABUNDANCE, low, high, ppb, SAMPLE_COLOUR, True)
    top = float(np.max(picture.std_ppb)) or 1.0
    std = _Panel("Belief: standard deviation", picture.std_ppb, UNCERTAINTY, 0.0, top, "std [ppb]", "#4fd1ff", False)
    if picture.reference_ppb is None:
        return [belief, std]
    truth = _Panel("Reference field", picture.reference_ppb, ABUNDANCE, low, high, ppb, "", False)
    return [truth, belief, std]


def _draw_panel(figure: Figure, axis: Any, panel: _Panel, picture: MapPicture, with_start: bool = True) -> None:
    rows, columns = panel.values.shape
    width, height = columns * picture.resolution_m, rows * picture.resolution_m
    image = axis.imshow(
        panel.values,
        origin="lower",
        extent=(0, width, 0, height),
        cmap=panel.colours,
        vmin=panel.low,
        vmax=panel.high,
        interpolation="nearest" if rows < 250 else "antialiased",
    )
    _mark_obstacles(axis, picture)
    if panel.with_path and len(picture.path_m):
        axis.plot(*picture.path_m.T, color=INK, lw=1.5, alpha=0.55, solid_joinstyle="round")
        axis.plot(*picture.path_m.T, color=PATH_COLOUR, lw=0.75, alpha=0.95, solid_joinstyle="round", label="driven")
    if panel.dots and len(picture.samples_m):
        axis.scatter(
            *picture.samples_m.T, s=11, c=panel.dots, edgecolors="white", linewidths=0.45, zorder=3, label="samples"
        )
    if with_start:
        axis.plot(*picture.start_m, marker="*", ms=11, mfc=START_COLOUR, mec=INK, mew=0.7, ls="none", zorder=4)
    _scale_bar(axis, width, height)
    axis.set(xlim=(0, width), ylim=(0, height), xlabel="east [m]")
    axis.set_aspect("equal")
    axis.set_title(panel.title, loc="left", pad=5)
    out_of_scale = "both" if panel.values.min() < panel.low or panel.values.max() > panel.high else "neither"
    bar = figure.colorbar(image, ax=axis, location="bottom", shrink=0.97, aspect=34, pad=0.02, extend=out_of_scale)
    bar.set_label(panel.label)
    bar.outline.set_linewidth(0.5)


def _mark_obstacles(axis: Any, picture: MapPicture) -> None:
    """Hatch the ground that the rover may not enter: shading would be read as abundance."""
    if picture.traversable is None or picture.traversable.all():
        return
    closed = ~picture.traversable
    rows, columns = closed.shape
    x, y = (np.arange(columns) + 0.5) * picture.resolution_m, (np.arange(rows) + 0.5) * picture.resolution_m
    with rc_context({"hatch.linewidth": 0.45, "hatch.color": (1, 1, 1, 0.55)}):
        axis.contourf(x, y, closed, levels=[0.5, 1.5], colors="none", hatches=["//////"])
        axis.contour(x, y, closed, levels=[0.5], colors=[(1, 1, 1, 0.6)], linewidths=0.5)


def _scale_bar(axis: Any, width: float, height: float) -> None:
    length = _round_length(width / 5)
    x, y = width * 0.965 - length, height * 0.045
    halo = [withStroke(linewidth=2.6, foreground=INK, alpha=0.7)]
    axis.plot([x, x + length], [y, y], color="white", lw=2.2, solid_capstyle="butt", path_effects=[*halo], zorder=5)
    axis.text(
        x + length / 2, y + height * 0.015, f"{length:g} m", color="white", ha="center", va="bottom", fontsize=8,
        fontweight="bold", path_effects=halo, zorder=5,
    )  # fmt: skip


def _round_length(wanted: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above what is wanted."""
    power = 10.0 ** math.floor(math.log10(wanted))
    return float(power * max(step for step in (1, 2, 5) if step * power <= wanted))


_LABELS = {
    MapLayer.MEAN: "helium-3 [ppb]",
    MapLayer.STD: "std [ppb]",
    MapLayer.INFORMATION: "information of one measurement [nat]",
    MapLayer.EXCEEDANCE: "probability of more than the threshold",
    MapLayer.TRAVERSABLE: "open to the rover (1) or closed (0)",
}


def layer_figure(raster: MapRaster, track: MissionTrack) -> Figure:
    """One layer of the live map, with the path driven and the samples."""
    values = array_of(raster)
    samples = np.array([(sample.x_m, sample.y_m) for sample in track.samples], dtype=np.float64).reshape(-1, 2)
    path = np.array(track.driven_path_m, dtype=np.float64).reshape(-1, 2)
    low, high = float(values.min()), float(values.max())
    uncertain = raster.layer is MapLayer.STD
    panel = _Panel(
        title=raster.layer.value,
        values=values,
        colours=UNCERTAINTY if uncertain else ABUNDANCE,
        low=0.0 if uncertain else low,
        high=high if high > low else low + 1.0,
        label=_LABELS[raster.layer],
        dots="#4fd1ff" if uncertain else SAMPLE_COLOUR,
        with_path=not uncertain,
    )
    start = (float(path[0, 0]), float(path[0, 1])) if len(path) else (0.0, 0.0)
    picture = MapPicture("", "", None, values, values, None, raster.resolution_m, path, samples, start)
    with rc_context(_STYLE):
        figure = Figure(figsize=(5.0, 5.6), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        axis = figure.add_subplot()
        _draw_panel(figure, axis, panel, picture)
        axis.set_ylabel("north [m]")
        axis.set_title(f"{raster.layer.value}: revision {raster.revision}, {raster.samples} samples", loc="left", pad=5)
    return figure


def region_figure(region: Region) -> Figure:
    """The reference field of a region, its terrain, and where the rover may not go."""
    nothing = np.empty((0, 2))
    he3, height, cell = region.he3_ppb, region.elevation_m, region.grid.resolution_m
    picture = MapPicture("", "", None, he3, height, region.traversable, cell, nothing, nothing, (0.0, 0.0))
    low, high, base, top = float(he3.min()), float(he3.max()), float(height.min()), float(height.max())
    panels = (
        _Panel("Reference field", he3, ABUNDANCE, low, high, "helium-3 [ppb]", "", False),
        _Panel("Elevation", height, "cividis", base, max(top, base + 1.0), "elevation [m]", "", False),
    )
    with rc_context(_STYLE):
        figure = Figure(figsize=(8.9, 5.75), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(1, 2, sharex=True, sharey=True)
        for axis, panel in zip(axes, panels, strict=True):
            _draw_panel(figure, axis, panel, picture, with_start=False)
        axes[0].set_ylabel("north [m]")
        figure.suptitle(region.title, fontsize=12.5, fontweight="bold", x=0.015, ha="left")
        figure.supxlabel(region.provenance, fontsize=7.5, color=QUIET, x=0.015, ha="left")
    return figure


def rmse_figure(title: str, note: str, history: Sequence[MapScore]) -> Figure:
    """Root-mean-square error, and the standard deviation that the belief itself claims, over the samples taken."""
    with rc_context(_STYLE):
        figure = Figure(figsize=(6.8, 4.3), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        axis = figure.add_subplot()
        samples = [score.samples for score in history]
        rmse = [score.rmse_ppb for score in history]
        claimed = [score.mean_std_ppb for score in history]
        axis.plot(samples, rmse, color="#1f6f8b", lw=1.9, marker="o", ms=3.2, label="RMSE against the reference")
        axis.plot(
            samples, claimed, color="#c8553d", lw=1.5, ls=(0, (5, 2)), label="mean posterior std (what it claims)"
        )
        if history:
            end, last = (samples[-1], rmse[-1]), f"{rmse[-1]:.3f} ppb"
            look: dict[str, Any] = {"color": "#1f6f8b", "fontweight": "bold", "ha": "right"}
            axis.annotate(last, end, xytext=(-2, 8), textcoords="offset points", **look)
            axis.set_ylim(0, max(*rmse, *claimed) * 1.08)
            axis.set_xlim(0, samples[-1] * 1.02)
        axis.set(xlabel="samples", ylabel="helium-3 [ppb]")
        axis.grid(color="#d8dde2", lw=0.6)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(loc="upper right")
        figure.suptitle(title, fontsize=11.5, fontweight="bold", x=0.015, ha="left")
        figure.supxlabel(fill(note, 118), fontsize=7.5, color=QUIET, x=0.015, ha="left")
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write the figure as PNG, the same bytes for the same figure; raises He3Error when that cannot be done."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, format="png", metadata={"Software": "he3-seeker"})
    except OSError as error:
        raise He3Error(f"{path}: cannot write the picture: {error.strerror}") from None
