"""`tour` beside the better of two others: the same samples under scikit-learn's best process, and SGP-Tools.

Both are compared on the surveys that all three have. `tour` has more metres than SGP-Tools where the latter leaves some
of its budget; `tour-matched` never has.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from he3.frames import FloatArray

PEER = "sgptools"
TRIPLES = tuple((name, f"{name}+sklearn", PEER) for name in ("tour", "tour-matched"))
"""A planner of ours, the same samples with scikit-learn's map, and the peer."""

Row = dict[str, Any]


def comparisons(rows: Sequence[Row]) -> list[str]:
    """Lines for each of ``TRIPLES`` that has surveys, an empty one after each."""
    return [line for triple in TRIPLES for line in comparison(rows, triple)]


def comparison(rows: Sequence[Row], names: tuple[str, str, str]) -> list[str]:
    """Lines: mean error and density of the three, their ratios, and our metres over those of the last.

    rows: those of field and seed that lack one of the three are left out. No lines if none is left.
    """
    by = {(row["field"], row["seed"], row["method"]): row for row in rows}
    common = sorted({key[:2] for key in by if all((*key[:2], name) in by for name in names)})
    if not common:
        return []
    fields = sorted({field for field, _ in common})

    def column(key: str) -> FloatArray:
        """That figure (surveys, 3)."""
        return np.array([[by[*survey, name][key] for name in names] for survey in common], dtype=np.float64)

    def by_field(figures: FloatArray) -> FloatArray:
        """Means over seeds (fields, 3)."""
        return np.array([figures[[survey[0] == field for survey in common]].mean(axis=0) for field in fields])

    error, density, metres, samples = (column(key) for key in ("nrmse", "nlpd", "metres", "samples"))
    errors, densities = by_field(error), by_field(density)
    means = errors.mean(axis=0)
    ratios = errors[:, 0] / errors[:, 1:].min(axis=1)
    fewer = (densities[:, :1] < densities[:, 1:]).all(axis=1).sum()
    lower = (density[:, :1] < density[:, 1:]).sum(axis=0)
    share, more = metres[:, 0] / metres[:, 2], (metres[:, 0] > metres[:, 2]).sum()
    ours, mapped, peer = names
    return [
        f"{ours} / {mapped} / {peer}: {len(common)} surveys of {len(fields)} fields",
        f"  nrmse   {_three(means)}: {means[0] / means[1:].min():.3f} of the better mean; of the better on each field "
        f"{ratios.mean():.3f} on average, {ratios.min():.3f} to {ratios.max():.3f}",
        f"  nlpd    {_three(densities.mean(axis=0))}: lower than both on {fewer} of {len(fields)} fields; in single "
        f"surveys lower than {mapped} in {lower[0]}, than {peer} in {lower[1]}",
        f"  metres  {share.mean():.4f} of those of {peer} on average, {share.min():.4f} to {share.max():.4f}; "
        f"more than it in {more} surveys; samples {samples[:, 0].min():.0f} to {samples[:, 0].max():.0f}",
        "",
    ]


def _three(values: FloatArray) -> str:
    return " / ".join(f"{value:.3f}" for value in values)
