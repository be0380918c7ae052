"""Pictures of a mission: reference, map, its standard deviation and its error; error over samples.

Drawn without a display, in metres, with colour maps that are perceptually uniform, and readable in print and with
colour blindness: one for abundance, on the same scale for reference and map; one for uncertainty; one with a neutral
middle for the error. Scales end at percentiles, so that a few extreme cells do not flatten everything else; the ends of
a colour bar are pointed where cells lie beyond.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from schemas.maps import MapLayer, MapRaster, MapScore
from services.console.report.mission_report import array_of, remove_part
from services.runtime.files.output import failed, open_output

if TYPE_CHECKING:
    from he3.frames import Place
    from he3.reference import Region
    from schemas.ground import MissionTrack
    from schemas.report import ReportSample
    from schemas.telemetry import SampleReport

ABUNDANCE = "viridis"
UNCERTAINTY = "magma"
ERROR = "RdBu_r"
INK = "#1b1f24"
QUIET = "#5b6570"
PATH_COLOUR = "#ffffff"
SAMPLE_COLOUR = "#ff5a36"
START_COLOUR = "#ffd23f"
DPI = 160
ABUNDANCE_PERCENTILES = (0.5, 99.5)
STD_PERCENTILES = (10.0, 99.5)
"""Ends of the colour scale of a standard deviation: the small values close to samples would stretch it."""

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.edgecolor": QUIET,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "text.color": INK,
    "text.parse_math": False,  # titles and notes are the words of others: a dollar sign begins no formula
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
    """Reference field; None if there is none: then the belief is shown alone."""
    mean_ppb: NDArray[Any]
    std_ppb: NDArray[Any]
    traversable: NDArray[np.bool_] | None
    resolution_m: float
    path_m: NDArray[np.float64]
    """(K, 2) driven [m]; may be empty."""
    samples_m: NDArray[np.float64]
    """(N, 2) drilled [m]; may be empty."""
    start_m: tuple[float, float]
    keep_outs_m: Sequence[Sequence[tuple[float, float]]] = ()
    """Corners [m] of each area that was closed to the rover at the end."""


def map_figure(picture: MapPicture) -> Figure:
    """The map's picture: four panels of the same extent in two rows, or two panels where the truth is not known."""
    with rc_context(STYLE):
        panels = _panels(picture)
        rows = (len(panels) + 1) // 2
        figure = Figure(
            figsize=_size(picture.mean_ppb, columns=2, rows=rows, beside=1.2),
            dpi=DPI,
            layout=ConstrainedLayoutEngine(w_pad=0.05, h_pad=0.06, wspace=0.03, hspace=0.02),
        )
        FigureCanvasAgg(figure)
        axes = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False)
        for index, (axis, panel) in enumerate(zip(axes.flat, panels, strict=True)):
            _draw_panel(figure, axis, panel, picture, with_scale=index == 0)
            axis.label_outer()
            if index % 2 == 0:
                axis.set_ylabel("north [m]")
        figure.suptitle(fill(picture.title, 88), fontsize=12.0, fontweight="bold", x=0.012, ha="left")
        figure.supxlabel(fill(picture.note, 88), fontsize=7.5, color=QUIET, x=0.012, ha="left")
        figure.legend(handles=_legend(picture), loc="outside lower right", ncols=4, fontsize=8.5, handlelength=1.8)
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
        *([Line2D([], [], **_KEEP_OUT, label="keep-out")] if picture.keep_outs_m else []),
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
    ppb = "helium-3 [ppb]"
    reference, mean, std = picture.reference_ppb, picture.mean_ppb, picture.std_ppb
    low, high = _scale(mean if reference is None else reference, *ABUNDANCE_PERCENTILES)
    map_panel = _Panel("Map: posterior mean", mean, ABUNDANCE, low, high, ppb, SAMPLE_COLOUR, True)
    spread = _Panel(
        "Map: standard deviation", std, UNCERTAINTY, *_scale(std, *STD_PERCENTILES), "std [ppb]", "#4fd1ff", False
    )
    if reference is None:
        return [map_panel, spread]
    truth = _Panel("Reference field", reference, ABUNDANCE, low, high, ppb, "", False)
    error = mean - reference
    most = max(float(np.nanpercentile(np.abs(error), 99.0)), 1e-6)
    difference = _Panel("Error: map minus reference", error, ERROR, -most, most, "error [ppb]", "", False)
    return [truth, map_panel, spread, difference]


def _size(values: NDArray[Any], columns: int, beside: float, rows: int = 1) -> tuple[float, float]:
    """Width and height [inch] of a figure of maps, with extra height for title and caption."""
    height, width = values.shape
    return 4.8 * columns, beside + rows * max(2.0, 0.3 + 3.75 * height / width)


def _scale(values: NDArray[Any], first: float, last: float) -> tuple[float, float]:
    """The ends of a scale at two percentiles of the values; at least 1 % of the upper end apart."""
    low, high = (float(end) for end in np.nanpercentile(values, (first, last)))
    if high - low >= 0.01 * abs(high) and high > low:
        return low, high
    return (0.0, high) if high > 0 else (low - 0.5, high + 0.5)


def _draw_panel(
    figure: Figure,
    axis: Any,
    panel: _Panel,
    picture: MapPicture,
    with_start: bool = True,
    with_scale: bool = True,
) -> None:
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
        axis.plot(*picture.path_m.T, color=PATH_COLOUR, lw=0.7, alpha=0.75, solid_joinstyle="round", label="driven")
    if panel.dots and len(picture.samples_m):
        axis.scatter(
            *picture.samples_m.T, s=9, c=panel.dots, edgecolors="white", linewidths=0.4, zorder=3, label="samples"
        )
    if with_start:
        axis.plot(*picture.start_m, marker="*", ms=11, mfc=START_COLOUR, mec=INK, mew=0.7, ls="none", zorder=4)
    if with_scale:
        _scale_bar(axis, width, height)
    axis.set(xlim=(0, width), ylim=(0, height), xlabel="east [m]")
    axis.set_aspect("equal")
    axis.set_title(panel.title, loc="left", pad=5)
    ends = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
    beyond = ends[bool(panel.values.min() < panel.low), bool(panel.values.max() > panel.high)]
    bar = figure.colorbar(image, cax=axis.inset_axes([1.025, 0.0, 0.035, 1.0]), extend=beyond, extendfrac=0.03)
    bar.set_label(panel.label)
    bar.outline.set_linewidth(0.5)


_KEEP_OUT: Final[dict[str, Any]] = {"color": "#ff8f3f", "lw": 1.5, "ls": (0, (4, 1.5))}


def _mark_obstacles(axis: Any, picture: MapPicture) -> None:
    """Hatch the ground that the rover may not enter: shading would be read as abundance. Keep-outs are outlined."""
    halo = [withStroke(linewidth=2.8, foreground=INK, alpha=0.6)]
    for corners in picture.keep_outs_m:
        x, y = np.array([*corners, corners[0]]).T
        axis.plot(x, y, **_KEEP_OUT, path_effects=halo, zorder=4)
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
    """The largest of 1, 2, 5 times a power of ten that is not above `wanted`."""
    power = 10.0 ** math.floor(math.log10(wanted))
    return float(power * max(step for step in (1, 2, 5) if step * power <= wanted))


LAYER_LABELS = {
    MapLayer.MEAN: "helium-3 [ppb]",
    MapLayer.STD: "std [ppb]",
    MapLayer.INFORMATION: "information of one measurement [nat]",
    MapLayer.EXCEEDANCE: "probability of more than the threshold",
    MapLayer.TRAVERSABLE: "open to the rover (1) or closed (0)",
    MapLayer.ELEVATION: "elevation [m]",
    MapLayer.SLOPE: "slope [deg]",
    MapLayer.SHADE: "brightness of the relief",
    MapLayer.REFERENCE: "helium-3, simulation only [ppb]",
    MapLayer.ERROR: "error of the mean, simulation only [ppb]",
}
"""What the colours of each layer mean, with the unit."""


def places_and_path(
    samples: Sequence[SampleReport | ReportSample], path_m: Sequence[Place]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places of the samples (n, 2) and the path (K, 2) [m], as pictures take them."""
    places = np.array([(sample.x_m, sample.y_m) for sample in samples], dtype=np.float64).reshape(-1, 2)
    return places, np.array(path_m, dtype=np.float64).reshape(-1, 2)


def layer_figure(raster: MapRaster, track: MissionTrack) -> Figure:
    """One layer of the live map, with the path driven and the samples."""
    values = array_of(raster)
    samples, path = places_and_path(track.samples, track.driven_path_m)
    uncertain = raster.layer is MapLayer.STD
    low, high = _scale(values, *STD_PERCENTILES) if uncertain else (float(values.min()), float(values.max()))
    panel = _Panel(
        title=raster.layer.value,
        values=values,
        colours=UNCERTAINTY if uncertain else ABUNDANCE,
        low=low,
        high=high if high > low else low + 1.0,
        label=LAYER_LABELS[raster.layer],
        dots="#4fd1ff" if uncertain else SAMPLE_COLOUR,
        with_path=not uncertain,
    )
    start = (float(path[0, 0]), float(path[0, 1])) if len(path) else (0.0, 0.0)
    picture = MapPicture("", "", None, values, values, None, raster.resolution_m, path, samples, start)
    with rc_context(STYLE):
        figure = Figure(figsize=_size(values, columns=1, beside=0.2), dpi=DPI, layout="constrained")
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
    if region.known is not None:
        he3 = np.where(region.known, he3, np.nan)
    picture = MapPicture("", "", None, he3, height, region.traversable, cell, nothing, nothing, (0.0, 0.0))
    (low, high), base, top = _scale(he3, *ABUNDANCE_PERCENTILES), float(height.min()), float(height.max())
    panels = (
        _Panel("Reference field", he3, ABUNDANCE, low, high, "helium-3 [ppb]", "", False),
        _Panel("Elevation", height, "cividis", base, max(top, base + 1.0), "elevation [m]", "", False),
    )
    with rc_context(STYLE):
        figure = Figure(figsize=_size(he3, columns=2, beside=1.0), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(1, 2, sharex=True, sharey=True)
        for axis, panel in zip(axes, panels, strict=True):
            _draw_panel(figure, axis, panel, picture, with_start=False)
        axes[0].set_ylabel("north [m]")
        figure.suptitle(region.title, fontsize=12.5, fontweight="bold", x=0.015, ha="left")
        figure.supxlabel(fill(region.provenance, 180), fontsize=7.5, color=QUIET, x=0.015, ha="left")
    return figure


def rmse_figure(title: str, note: str, history: Sequence[MapScore]) -> Figure:
    """Root-mean-square error and the mean posterior standard deviation, over the number of samples."""
    with rc_context(STYLE):
        figure = Figure(figsize=(6.8, 4.3), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        axis = figure.add_subplot()
        samples = [score.samples for score in history]
        rmse = [score.rmse_ppb for score in history]
        claimed = [score.mean_std_ppb for score in history]
        axis.plot(samples, rmse, color="#1f6f8b", lw=1.9, marker="o", ms=3.2, label="RMSE against the reference")
        axis.plot(samples, claimed, color="#c8553d", lw=1.5, ls=(0, (5, 2)), label="mean posterior std")
        if history:
            end, last = (samples[-1], rmse[-1]), f"{rmse[-1]:.3f} ppb"
            look: dict[str, Any] = {"color": "#1f6f8b", "fontweight": "bold", "ha": "right"}
            away = -16 if claimed[-1] > rmse[-1] else 8  # clear of the other curve
            axis.annotate(last, end, xytext=(-2, away), textcoords="offset points", **look)
            least, most = min(*rmse, *claimed), max(*rmse, *claimed)
            axis.set_ylim(0 if least < 0.4 * most else 0.8 * least, most * 1.08)
            axis.set_xlim(0, max(samples[-1], 1) * 1.02)
        axis.set(xlabel="samples", ylabel="helium-3 [ppb]")
        axis.grid(color="#d8dde2", lw=0.6)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(loc="upper right")
        figure.suptitle(title, fontsize=11.5, fontweight="bold", x=0.015, ha="left")
        figure.supxlabel(fill(note, 118), fontsize=7.5, color=QUIET, x=0.015, ha="left")
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write the figure as PNG, the same bytes for the same figure.

    Raises He3Error if it cannot be written, InvalidInput where the path is at fault.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open_output(path) as stream:
            figure.savefig(stream, format="png", metadata={"Software": "he3-seeker"})
    except OSError as error:
        remove_part(path)
        raise failed(f"{path}: cannot write the picture", error) from None
