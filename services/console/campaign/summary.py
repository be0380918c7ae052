"""The findings of a campaign as a few lines of plain text."""

from __future__ import annotations

from services.console.campaign.drawing import number
from services.console.campaign.findings import ALL, LEAST_SHARE, FigureFindings, Findings
from services.console.campaign.statistics import LEVEL, QUANTILES, Paired

_SHOWN = (0.05, 0.5, 0.95)
MOST_SHARES = 4


def summary_lines(name: str, findings: Findings) -> list[str]:
    """The findings in aligned lines."""
    whole = findings.rows - findings.failed - findings.incomplete
    lines = [
        f"study        {name}",
        f"missions     {findings.rows}: {whole} completed, {findings.incomplete} not, {findings.failed} failed",
    ]
    for figure in findings.figures:
        lines += ["", *_figure_lines(figure)]
    return lines


def _equal(pair: Paired) -> str:
    return f" and equal in {pair.equal:.0%}" if pair.equal else ""


def _seeds(pair: Paired) -> str:
    """Over how many seeds the interval is, where that is not the number of pairs."""
    if pair.seeds == pair.pairs:
        return ""
    return ", all of one seed" if pair.seeds == 1 else f" with {pair.seeds} seeds"


def _figure_lines(figure: FigureFindings) -> list[str]:
    unit = f" [{figure.kind.unit}]" if figure.kind.unit else ""
    head = "".join(f"{share:>10.0%}" for share in _SHOWN)
    lines = [f"{figure.kind.title + unit:<28}{'n':>7}{'mean':>10}{'std':>10}{head}"]
    for group, one in figure.summaries.items():
        shown = "".join(f"{number(one.quantiles[QUANTILES.index(share)]):>10}" for share in _SHOWN)
        lines.append(f"  {group:<26}{one.count:>7}{number(one.mean):>10}{number(one.std):>10}{shown}")
    lines += [
        f"  {pair.first} - {pair.second}: {pair.difference:+.4g} ({LEVEL:.0%}: {pair.low:+.4g} to {pair.high:+.4g}), "
        f"ratio {pair.ratio:.3f}, lower in {pair.first_lower:.0%}{_equal(pair)} of {pair.pairs}{_seeds(pair)}"
        for pair in figure.comparisons
    ]
    for group, shares in figure.shares.items():
        counted = [f"{one.parameter} {one.share:.0%}" for one in shares if one.counts and one.share > LEAST_SHARE][
            :MOST_SHARES
        ]
        if counted:
            lines.append(f"  spread{'' if group == ALL else f' of {group}'}: {', '.join(counted)}")
    return lines
