"""The figures of the comparisons: error over samples, trajectories, maps, and the frontier of error against metres."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from benchmarks.flights import Flight, region_named
from benchmarks.missions import Mission

matplotlib.use("Agg")
from matplotlib import pyplot as plt

COLOURS = ("#8a8f98", "#1b1f24", "#2a7f9e", "#d1495b", "#e08e45", "#5b8e4e", "#9d78b5", "#c2a33a")
_SETTLED = 10
"""Number of samples after which a curve's error sets the upper limit of the axis."""
STYLE: dict[str, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e7eb",
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "savefig.dpi": 200,
    "figure.constrained_layout.use": True,
}


def paper_figures(
    missions: dict[Flight, Mission], regions: Sequence[str], planners: Sequence[str], out: Path
) -> list[Path]:
    """The paper's three figures, drawn into that folder."""
    out.mkdir(parents=True, exist_ok=True)
    with plt.rc_context(STYLE):
        return [
            _errors(missions, regions, planners, out / "paper-rmse.png"),
            _trajectories(missions, regions, planners, out / "paper-trajectories.png"),
            _maps(missions, regions, planners, out / "paper-maps.png"),
        ]


def _of(missions: dict[Flight, Mission], region: str, name: str) -> list[Mission]:
    return [mission for flight, mission in missions.items() if (flight.region, flight.name) == (region, name)]


def _errors(missions: dict[Flight, Mission], regions: Sequence[str], planners: Sequence[str], path: Path) -> Path:
    figure, axes = plt.subplots(1, len(regions), figsize=(5.2 * len(regions), 3.6), squeeze=False)
    for axis, region in zip(axes[0], regions, strict=True):
        for colour, planner in zip(cycle(COLOURS), planners, strict=False):
            flown = [mission for mission in _of(missions, region, planner) if mission.rmse_history]
            if not flown:
                continue
            shortest = min(len(mission.rmse_history) for mission in flown)
            curves = np.array([mission.rmse_history[:shortest] for mission in flown])
            samples = np.arange(1, shortest + 1)
            middle, spread = curves.mean(axis=0), curves.std(axis=0)
            axis.plot(samples, middle, color=colour, lw=1.6, label=planner)
            axis.fill_between(samples, middle - spread, middle + spread, color=colour, alpha=0.13, lw=0)
        axis.set(title=region_named(region).title, xlabel="samples", ylabel="RMSE over all cells [ppb]")
        late = [m.rmse_history for f, m in missions.items() if f.region == region]
        late = [curve for curve in late if len(curve) >= _SETTLED]
        if late:
            highest = 1.15 * float(np.median([curve[_SETTLED - 1] for curve in late]))
            axis.set_ylim(0.9 * min(min(curve) for curve in late), highest)
    axes[0][-1].legend(ncols=2, fontsize=8)
    return _saved(figure, path)


def _trajectories(missions: dict[Flight, Mission], regions: Sequence[str], planners: Sequence[str], path: Path) -> Path:
    shape = (len(regions), len(planners))
    figure, axes = plt.subplots(*shape, figsize=(2.5 * shape[1], 2.9 * shape[0]), squeeze=False)
    for region, line in zip(regions, axes, strict=True):
        site = region_named(region)
        extent = (0, site.grid.width_m, 0, site.grid.height_m)
        for planner, axis in zip(planners, line, strict=True):
            axis.set(xticks=[], yticks=[], aspect="equal")
            axis.grid(visible=False)
            axis.imshow(site.he3_ppb, origin="lower", extent=extent, cmap="Greys", alpha=0.35)
            axis.contourf(site.traversable, levels=[-0.5, 0.5], extent=extent, colors=["#3b4048"], alpha=0.55)
            flown = _of(missions, region, planner)
            if flown:
                mission = flown[0]
                axis.plot(*mission.path_m.T, color="#2a7f9e", lw=0.6)
                axis.plot(*mission.samples_m.T, "o", color="#d1495b", ms=1.6, mew=0)
                axis.plot(*mission.path_m[0], "*", color="#e0a800", ms=8, mec="black", mew=0.4)
                metres = mission.row["path_length_m"] / 1000
                axis.set_title(f"{planner}\n{metres:.1f} km, {mission.row['rmse_ppb']:.3f} ppb", fontsize=8)
        line[0].set_ylabel(site.name.upper())
    return _saved(figure, path)


def _maps(missions: dict[Flight, Mission], regions: Sequence[str], planners: Sequence[str], path: Path) -> Path:
    shown = [name for name in planners if name in ("rrtstar", "informative", "tour") or ":" in name]
    figure, axes = plt.subplots(
        len(regions), 1 + len(shown), figsize=(2.9 * (1 + len(shown)), 2.9 * len(regions)), squeeze=False
    )
    for region, line in zip(regions, axes, strict=True):
        site = region_named(region)
        extent = (0, site.grid.width_m, 0, site.grid.height_m)
        low, high = np.percentile(site.he3_ppb, [0.5, 99.5])
        panels = [("reference", site.he3_ppb)]
        for name in shown:
            flown = _of(missions, region, name)
            if flown:
                panels.append((f"{name}, {flown[0].row['rmse_ppb']:.3f} ppb", flown[0].mean_ppb))
        for axis, (title, layer) in zip(line, panels, strict=False):
            image = axis.imshow(layer, origin="lower", extent=extent, cmap="viridis", vmin=low, vmax=high)
            axis.set_title(title, fontsize=9)
            axis.locator_params(nbins=3)
            axis.grid(visible=False)
        line[0].set_ylabel("north [m]")
        figure.colorbar(image, ax=list(line), shrink=0.9, label="helium-3 [ppb]")
    for axis in axes[-1]:
        axis.set_xlabel("east [m]")
    return _saved(figure, path)


def frontier_figure(
    curves: dict[str, dict[str, list[tuple[float, float, float]]]],
    floors: dict[str, list[tuple[float, float]]],
    path: Path,
) -> Path:
    """RMSE against driven metres, drawn to that file.

    curves: region -> name -> (metres, mean RMSE, its standard deviation); floors: region -> (metres, RMSE).
    """
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, len(curves), figsize=(5.2 * len(curves), 3.8), squeeze=False)
        for axis, (region, named) in zip(axes[0], curves.items(), strict=True):
            for colour, (name, points) in zip(COLOURS[1:], named.items(), strict=False):
                metres, rmse, spread = (np.array(column) for column in zip(*sorted(points), strict=True))
                axis.errorbar(metres / 1000, rmse, yerr=spread, marker="o", ms=4, lw=1.6, capsize=2, color=colour,
                              label=name)  # fmt: skip
            if floors.get(region):
                metres, rmse = (np.array(column) for column in zip(*sorted(floors[region]), strict=True))
                axis.plot(metres / 1000, rmse, "--", color="#5b8e4e", lw=1.4, label="floor: true covariance, offline")
            axis.set(title=region_named(region).title, xlabel="driven [km]", ylabel="RMSE over all cells [ppb]")
            axis.legend(fontsize=8)
        return _saved(figure, path)


def _saved(figure: Any, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    plt.close(figure)
    return path
