"""The exam's picture: each method's error on each field with its interval, and its coverage over all fields."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.exam_scores import PROBABILITIES, mean_and_interval
from benchmarks.figures import STYLE, plt

OURS, COVER, PEERS = "#2a7f9e", "#8a8f98", "#d1495b"
LABELS = (
    (OURS, "our planner, our map"),
    (COVER, "cover or chance, our map"),
    (PEERS, "the paper's, or other software"),
)
_COVERS = ("boustrophedon", "hexagonal", "random")
_PEERS = ("sgptools", "pypolo", "rrtstar")
_WIDEST = 1.6
"""Normalised error beyond which an axis does not reach: it is worse than the field's mean by far."""


def draw(rows: Sequence[dict[str, Any]], fields: Sequence[str], path: Path) -> Path:
    """The picture of these rows, written to that file."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    there = [field for field in fields if any(row["field"] == field for row in rows)]
    columns = min(4, len(there) + 1)
    lines = -(-(len(there) + 1) // columns)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(
            lines,
            columns,
            figsize=(1.6 + 2.7 * columns, (0.9 + 0.21 * len(methods)) * lines),
            squeeze=False,
            sharey=True,
        )
        panels = list(axes.flat)
        at = np.arange(len(methods))[::-1]
        for axis, field in zip(panels, there, strict=False):
            for y, method in zip(at, methods, strict=True):
                values = [row["nrmse"] for row in rows if (row["field"], row["method"]) == (field, method)]
                if values:
                    _dot(axis, y, values, _colour(method))
            axis.set(title=field, xlabel="RMSE / std of the field")
            left, right = axis.get_xlim()
            axis.set_xlim(max(0.0, left), min(right, _WIDEST))
        _coverage(panels[len(there)], rows, methods, at)
        for axis in panels[len(there) + 1 :]:
            axis.set_visible(False)
        for line in axes:
            line[0].set_yticks(at, methods)
            line[0].set_ylim(-0.5, len(methods) - 0.5)  # room for whole marks, also of a few methods
        marks = [plt.Line2D([], [], color=colour, marker="o", ls="", ms=4.5, label=label) for colour, label in LABELS]
        figure.legend(handles=marks, loc="outside lower center", ncols=len(marks))
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)
        plt.close(figure)
    return path


def _dot(axis: Any, y: float, values: Sequence[float], colour: str) -> None:
    mean, half = mean_and_interval(values)
    axis.plot(values, [y] * len(values), "|", color=colour, ms=6, alpha=0.5)
    axis.errorbar(mean, y, xerr=None if isnan(half) else half, fmt="o", ms=4.5, lw=1.4, color=colour)


def _coverage(axis: Any, rows: Sequence[dict[str, Any]], methods: Sequence[str], at: Any) -> None:
    """Mean coverage over fields and seeds beside the nominal one."""
    for probability, marker in zip(PROBABILITIES, "vos", strict=True):
        key = f"coverage_{probability * 100:.0f}"
        axis.axvline(probability, color="#1b1f24", lw=0.8, ls="--")
        for y, method in zip(at, methods, strict=True):
            share = float(np.mean([row[key] for row in rows if row["method"] == method]))
            axis.plot(share, y, marker, ms=4.5, color=_colour(method))
    axis.set(title="coverage, all fields", xlabel="share within 50 % (▼), 68 % (●), 95 % (■)", xlim=(0, 1))


def _colour(method: str) -> str:
    if method in _COVERS:
        return COVER
    return PEERS if method.startswith(_PEERS) or method.endswith("sklearn") else OURS
