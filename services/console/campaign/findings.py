"""What a campaign's rows teach: distributions, comparisons, what explains the spread, worst cases."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any, Final

import numpy as np

from he3.errors import InvalidInput
from he3.frames import FloatArray
from services.console.campaign.statistics import (
    QUANTILES,
    Paired,
    Share,
    Summary,
    bins_of,
    distinct,
    is_drawn,
    paired,
    summary_of,
    variance_share,
)
from services.console.campaign.table import SEED, Kind, Table, kind_of

ALL: Final = "all"
"""The group of a report that compares nothing."""
MOST_GROUPS: Final = 6
MOST_PAIRS: Final = 10
WORST: Final = 5
MOST_ERRORS: Final = 20
MOST_TRENDS: Final = 3
MIN_IN_BIN: Final = 5
LEAST_SHARE: Final = 0.01
"""Of the variance, for a parameter to get a diagram."""


@dataclass(frozen=True, slots=True)
class Trend:
    """A figure over a parameter, for one group."""

    parameter: str
    group: str
    places: list[float]
    median: list[float]
    low: list[float]
    """The 10 % quantile in each bin."""
    high: list[float]
    """The 90 % quantile in each bin."""


@dataclass(frozen=True, slots=True)
class Case:
    """One mission that a reader may want to fly again."""

    value: float | None
    why: str
    labels: dict[str, Any]
    command: str


@dataclass(frozen=True, slots=True, eq=False)
class FigureFindings:
    """Everything about one figure."""

    name: str
    kind: Kind
    summaries: dict[str, Summary]
    """By group."""
    sorted_values: dict[str, FloatArray]
    """(n,) by group, ascending, for the distribution function."""
    comparisons: list[Paired]
    shares: dict[str, list[Share]]
    """By group, the largest first."""
    trends: list[Trend]
    worst: list[Case]

    def document(self) -> dict[str, Any]:
        """As JSON, without the single values."""
        summaries = {
            group: {**asdict(one), "quantiles": dict(zip(map(str, QUANTILES), one.quantiles, strict=True))}
            for group, one in self.summaries.items()
        }
        return {
            "figure": self.name,
            "summaries": summaries,
            "comparisons": [asdict(one) for one in self.comparisons],
            "shares": {group: [asdict(one) for one in shares] for group, shares in self.shares.items()},
            "trends": [asdict(one) for one in self.trends],
            "worst": [asdict(one) for one in self.worst],
        }


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """Everything that a report shows."""

    rows: int
    failed: int
    incomplete: int
    """Missions that came to an end without what was asked for."""
    compared: str | None
    """The label whose values are compared."""
    groups: list[str]
    counts: dict[str, tuple[int, int]]
    """Rows and completed ones, by group."""
    figures: list[FigureFindings]
    cases: list[Case]
    """Missions that failed or were not completed."""

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "rows": self.rows,
            "failed": self.failed,
            "incomplete": self.incomplete,
            "compared": self.compared,
            "groups": {name: {"rows": rows, "completed": whole} for name, (rows, whole) in self.counts.items()},
            "figures": [one.document() for one in self.figures],
            "not_completed": [asdict(one) for one in self.cases],
        }


def findings_of(table: Table, figures: Sequence[str], compare: str | None = None) -> Findings:
    """What the table teaches about those figures.

    compare: the label whose values are compared; None: the first with a few names for values. Raises InvalidInput for a
    label that the rows do not have, or an empty table.
    """
    if not len(table):
        raise InvalidInput("expected one row at least in the store, got none")
    compare = _compared(table, compare)
    members = _members(table, compare)
    partners = _pairs(table, compare, members)
    failed = table.failed
    return Findings(
        rows=len(table),
        failed=int(failed.sum()),
        incomplete=int((~table.completed & ~failed).sum()),
        compared=compare,
        groups=list(members),
        counts={group: (len(rows), int(table.completed[rows].sum())) for group, rows in members.items()},
        figures=[_figure(table, name, compare, members, partners) for name in figures],
        cases=[_case(table, index, None, why) for index, why in list(table.errors.items())[:MOST_ERRORS]],
    )


def _compared(table: Table, wanted: str | None) -> str | None:
    if wanted is not None and wanted not in table.labels:
        raise InvalidInput(f"--compare: expected one of {', '.join(table.labels)}, got '{wanted}'")
    if wanted is not None:
        return wanted
    for name in table.varied():
        kinds = set(map(distinct, table.labels[name]))
        if len(kinds) <= MOST_GROUPS and all(isinstance(value, str) for value in table.labels[name]):
            return name
    return None


def _members(table: Table, compare: str | None) -> dict[str, Any]:
    """The rows of each group."""
    if compare is None:
        return {ALL: np.arange(len(table))}
    rows: dict[str, list[int]] = defaultdict(list)
    for index, value in enumerate(table.labels[compare]):
        rows[str(value)].append(index)
    if len(rows) > MOST_GROUPS:
        raise InvalidInput(f"--compare {compare}: expected at most {MOST_GROUPS} values, got {len(rows)}")
    return {name: np.array(rows[name]) for name in sorted(rows)}


def _pairs(table: Table, compare: str | None, members: dict[str, Any]) -> dict[tuple[str, str], Any]:
    """(2, n) rows that differ in nothing but the compared label, for each two groups."""
    if compare is None:
        return {}
    others = [column for name, column in table.labels.items() if name != compare]
    by_rest = {
        group: {tuple(distinct(column[row]) for column in others): row for row in rows.tolist()}
        for group, rows in members.items()
    }
    found = {}
    for first, second in list(combinations(members, 2))[:MOST_PAIRS]:
        both = [rest for rest in by_rest[first] if rest in by_rest[second]]
        if both:
            found[first, second] = np.array([[by_rest[group][rest] for rest in both] for group in (first, second)])
    return found


def _figure(
    table: Table, name: str, compare: str | None, members: dict[str, Any], partners: dict[tuple[str, str], Any]
) -> FigureFindings:
    kind = kind_of(name)
    values = table.figures[name] / kind.scale
    there = {group: rows[~np.isnan(values[rows])] for group, rows in members.items()}
    comparisons = []
    drawn = [name for name in table.varied() if name not in (compare, SEED) and is_drawn(table.labels[name])]
    for names, (one, other) in partners.items():
        if np.count_nonzero(~np.isnan(values[one] - values[other])) > 1:  # one pair shows no difference beyond chance
            seeds = [table.labels[SEED][row] for row in one.tolist()]
            draws = [tuple(table.labels[name][row] for name in drawn) for row in one.tolist()]
            comparisons.append(paired(values[one], values[other], names, seeds, draws))
    varied = [label for label in table.varied() if label not in (compare, SEED)]
    shares = {group: _shares(table, varied, rows, values) for group, rows in members.items()}
    if compare is not None:
        shares = {ALL: _shares(table, [compare, *varied], np.arange(len(table)), values), **shares}
    strongest = sorted(
        {
            share.parameter
            for of_group in shares.values()
            for share in of_group
            if share.counts and share.share > LEAST_SHARE
        }
        & set(varied),
        key=lambda label: -max(one.share for group in shares.values() for one in group if one.parameter == label),
    )
    return FigureFindings(
        name,
        kind,
        {group: summary_of(values[rows]) for group, rows in there.items() if len(rows)},
        {group: np.sort(values[rows]) for group, rows in there.items()},
        comparisons,
        shares,
        [
            trend
            for label in strongest[:MOST_TRENDS]
            for group, rows in there.items()
            if (trend := _trend(table, label, group, rows, values)) is not None
        ],
        _worst(table, values, kind),
    )


def _shares(table: Table, labels: Sequence[str], rows: Any, values: FloatArray) -> list[Share]:
    found = []
    for label in labels:
        column = table.labels[label]
        share = variance_share(label, [column[row] for row in rows.tolist()], values[rows])
        if share is not None:
            found.append(share)
    return sorted(found, key=lambda one: -one.share)


def _trend(table: Table, label: str, group: str, rows: Any, values: FloatArray) -> Trend | None:
    """The figure over that parameter; None for one that is no number, or has too few rows."""
    column = [table.labels[label][row] for row in rows.tolist()]
    if not column or not all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in column):
        return None
    bins, kinds = bins_of(column)
    trend = Trend(label, group, [], [], [], [])
    for number, place in enumerate(kinds):
        inside = values[rows][bins == number]
        if len(inside) >= MIN_IN_BIN:
            trend.places.append(float(place))
            for into, share in ((trend.low, 0.1), (trend.median, 0.5), (trend.high, 0.9)):
                into.append(float(np.quantile(inside, share)))
    return trend if len(trend.places) > 1 else None


def _worst(table: Table, values: FloatArray, kind: Kind) -> list[Case]:
    order = np.argsort(-values if kind.high_is_bad else values, kind="stable")
    return [
        _case(table, index, float(values[index]), table.errors.get(index, ""))
        for index in order[:WORST].tolist()
        if not np.isnan(values[index])
    ]


def _case(table: Table, index: int, value: float | None, why: str) -> Case:
    labels = {name: column[index] for name, column in table.labels.items()}
    return Case(value, why, labels, table.command(index))
