"""The report of a campaign as one HTML page that needs nothing else: no script, no network, light and dark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from he3.frames import FloatArray
from services.console.campaign.drawing import Axis, Bar, Diagram, axis_of, bars, number, steps
from services.console.campaign.findings import ALL, Case, FigureFindings, Findings, Trend
from services.console.campaign.statistics import FEW, LEVEL, QUANTILES, RESAMPLES, Paired, Share

_POINTS = 240
"""Points of a distribution function at most."""

_ARROWS = {True: " ↑", False: " ↓"}

STYLE = """
:root { color-scheme: light dark; --paper: #fff; --card: #f6f7f9; --ink: #1b1f24; --soft: #5b6470; --rule: #d9dde2;
  --s0: #1f7a8c; --s1: #c2410c; --s2: #5b4bb5; --s3: #5b8e4e; --s4: #a8741a; --s5: #b03a6f; --bad: #b3261e; }
@media (prefers-color-scheme: dark) { :root { --paper: #14171b; --card: #1d2126; --ink: #e7eaee; --soft: #a3adb8;
  --rule: #3a4149; --s0: #5cc3d6; --s1: #f2915a; --s2: #a99bf0; --s3: #93cf84; --s4: #e2b458; --s5: #ee8fb8;
  --bad: #ff8a80; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.2rem clamp(.8rem, 3vw, 2.5rem) 3rem; max-width: 82rem; background: var(--paper);
  color: var(--ink); font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; margin: .4rem 0 .2rem; } h2 { font-size: 1.25rem; margin: 2.2rem 0 .6rem;
  border-top: 1px solid var(--rule); padding-top: 1.2rem; } h3 { font-size: .95rem; margin: 0 0 .4rem; }
p { margin: .4rem 0; max-width: 60rem; } .soft { color: var(--soft); } .bad { color: var(--bad); }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 21rem), 1fr)); gap: 1rem;
  margin: .8rem 0; }
.card { background: var(--card); border-radius: .5rem; padding: .8rem .9rem; min-width: 0; }
.card svg { display: block; width: 100%; height: auto; }
.wide { overflow-x: auto; margin: .8rem 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .92rem; }
th, td { padding: .28rem .8rem .28rem 0; text-align: right; white-space: nowrap; border-bottom: 1px solid var(--rule); }
th { color: var(--soft); font-weight: 600; } th:first-child, td:first-child, td.text, th.text { text-align: left; }
.legend { display: flex; flex-wrap: wrap; gap: .2rem 1.2rem; }
.legend span::before { content: ""; display: inline-block; width: 1.1rem; height: .28rem; margin-right: .45rem;
  vertical-align: middle; border-radius: 2px; background: var(--c); }
.s0 { --c: var(--s0); } .s1 { --c: var(--s1); } .s2 { --c: var(--s2); } .s3 { --c: var(--s3); } .s4 { --c: var(--s4); }
.s5 { --c: var(--s5); } .s6 { --c: var(--soft); }
svg text { fill: var(--soft); font: 11.5px system-ui, sans-serif; } svg .title { fill: var(--ink); }
.grid { stroke: var(--rule); stroke-width: .7; } .line { fill: none; stroke: var(--c); stroke-width: 2; }
line.s1, .line.s1 { stroke-dasharray: 7 3; } .line.s2 { stroke-dasharray: 2 3; } .mark { fill: var(--c); }
.band { fill: var(--c); opacity: .16; } .bar { fill: var(--c); } .noise { stroke: var(--ink); stroke-width: 1; }
details { margin: .6rem 0; } summary { cursor: pointer; } li { margin: .5rem 0; }
code { font: 12.5px ui-monospace, monospace; background: var(--card); padding: .1rem .3rem; border-radius: .25rem;
  overflow-wrap: anywhere; display: inline-block; }
"""


def page_of(findings: Findings, title: str, about: str, facts: Sequence[tuple[str, str]]) -> str:
    """The page. facts: names and texts of a few more things about the campaign, such as its software."""
    colours = {group: index for index, group in enumerate(findings.groups)}
    parts = [
        '<!doctype html><html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>",
        f"<h1>{escape(title)}</h1>",
        f'<p class="soft">{escape(about)}</p>' if about else "",
        f"<p>{_counts(findings)}</p>",
        _groups(findings),
        _overview(findings),
        *(_section(one, findings, colours) for one in findings.figures),
        _not_completed(findings.cases),
        "<h2>About this page</h2>",
        _notes(findings),
        "".join(f'<p class="soft">{escape(name)}: <code>{escape(text)}</code></p>' for name, text in facts),
        "</body></html>\n",
    ]
    return "".join(parts)


def _counts(findings: Findings) -> str:
    whole = findings.rows - findings.failed - findings.incomplete
    text = f"<strong>{findings.rows:,}</strong> missions, {whole:,} of them completed"
    if findings.incomplete:
        text += f', <span class="bad">{findings.incomplete:,} not completed</span>'
    if findings.failed:
        text += f', <span class="bad">{findings.failed:,} failed</span>'
    return text + "."


def _groups(findings: Findings) -> str:
    if findings.compared is None:
        return ""
    rows = "".join(
        f"<tr><td>{escape(group)}</td><td>{rows:,}</td><td>{whole:,}</td><td>{whole / rows:.1%}</td></tr>"
        for group, (rows, whole) in findings.counts.items()
    )
    head = f"<th>{escape(findings.compared)}</th><th>missions</th><th>completed</th><th>share</th>"
    return f'<div class="wide"><table><tr>{head}</tr>{rows}</table></div>'


def _overview(findings: Findings) -> str:
    """The comparisons of all figures in one table."""
    rows = [(figure, one) for figure in findings.figures for one in figure.comparisons]
    if not rows:
        return ""
    head = (
        '<tr><th>figure</th><th class="text">pair</th><th>pairs</th><th>seeds</th><th>mean difference</th>'
        f"<th>{LEVEL:.0%} interval</th><th>ratio</th><th>{LEVEL:.0%} interval</th>"
        "<th>first lower</th></tr>"
    )
    body = "".join(
        f'<tr><td>{escape(_titled(figure))}</td><td class="text">{escape(one.first)} − {escape(one.second)}</td>'
        f"<td>{one.pairs:,}</td><td>{one.seeds:,}</td><td>{_signed(one.difference)}</td>"
        f"<td>{_signed(one.low)} to {_signed(one.high)}</td><td>{one.ratio:.3f}</td>"
        f"<td>{one.ratio_low:.3f} to {one.ratio_high:.3f}</td><td>{one.first_lower:.0%}{_equal(one)}</td></tr>"
        for figure, one in rows
    )
    return f'<h2>Pair by pair</h2>{_sentences(rows)}<div class="wide"><table>{head}{body}</table></div>'


def _equal(one: Paired) -> str:
    return f", equal {one.equal:.0%}" if one.equal else ""


def _sentences(rows: Sequence[tuple[FigureFindings, Paired]]) -> str:
    """What the comparisons come to, in words."""
    clear = [(figure, one) for figure, one in rows if one.low > 0 or one.high < 0]
    words = [
        f"{escape(figure.kind.title)} is {'higher' if one.difference > 0 else 'lower'} with {escape(one.first)} than "
        f"with {escape(one.second)}, by {number(abs(one.difference))}&nbsp;{escape(figure.kind.unit)}".removesuffix(
            "&nbsp;"
        )
        for figure, one in clear
    ]
    open_ones = [escape(figure.kind.title) for figure, one in rows if one.low <= 0 <= one.high]
    text = f"<p>{_capital('; '.join(words))}.</p>" if words else ""
    if any(one.seeds == 1 for _, one in rows):
        text = f"<p>All pairs have one seed: with another one, all this may be otherwise.</p>{text}"
    return text + (f"<p>No difference beyond chance: {', '.join(open_ones)}.</p>" if open_ones else "")


def _section(figure: FigureFindings, findings: Findings, colours: Mapping[str, int]) -> str:
    cards = [("Distribution", _distribution(figure, colours))]
    if any(figure.shares.values()):
        cards.append(("What explains the spread", _sensitivity(figure.shares, colours)))
    for parameter in dict.fromkeys(trend.parameter for trend in figure.trends):
        of_it = [trend for trend in figure.trends if trend.parameter == parameter]
        cards.append((f"Over {parameter}: median, 10 to 90 %", _trends(figure, of_it, colours)))
    legend = "".join(f'<span class="s{colours[group]}">{escape(group)}</span>' for group in findings.groups)
    if len(findings.groups) > 1:
        legend += f'<span class="s6">{ALL} together</span>'
    return (
        f"<h2>{escape(_capital(_titled(figure)))}</h2>"
        + (f'<div class="legend">{legend}</div>' if len(findings.groups) > 1 else "")
        + f'<div class="cards">{"".join(f"<div class=card><h3>{escape(name)}</h3>{svg}</div>" for name, svg in cards)}'
        + f"</div>{_summaries(figure)}{_worst(figure)}"
    )


def _distribution(figure: FigureFindings, colours: Mapping[str, int]) -> str:
    curves = {group: _thinned(values) for group, values in figure.sorted_values.items() if len(values)}
    x = axis_of([value for places, _ in curves.values() for value in places], _titled(figure))
    diagram = Diagram(x, Axis(0.0, 1.0, "share of missions below"), f"Distribution of {figure.kind.title}")
    for group, (places, shares) in curves.items():
        diagram.curve(colours[group], *steps(places, shares))
    return diagram.text()


def _thinned(values: FloatArray) -> tuple[list[float], list[float]]:
    """Values and the share of values up to each, at most _POINTS of them."""
    ranks = np.unique(np.linspace(0, len(values) - 1, min(len(values), _POINTS)).round().astype(int))
    return values[ranks].tolist(), ((ranks + 1) / len(values)).tolist()


def _sensitivity(shares: Mapping[str, Sequence[Share]], colours: Mapping[str, int]) -> str:
    names: dict[str, list[Bar]] = {}
    for group, found in shares.items():
        for one in found:
            arrow = _ARROWS[one.rank_correlation > 0] if one.counts and one.rank_correlation is not None else ""
            names.setdefault(one.parameter, []).append(Bar(colours.get(group, 6), one.share, one.noise, arrow))
    ordered = sorted(names.items(), key=lambda item: -max(bar.share for bar in item[1]))
    return bars(ordered, "Share of the variance that each parameter explains") + (
        '<p class="soft">Share of the variance that each parameter explains alone; up to the mark it may be chance. '
        "An arrow says whether the figure rises or falls with it.</p>"
    )


def _trends(figure: FigureFindings, trends: Sequence[Trend], colours: Mapping[str, int]) -> str:
    x = axis_of([place for trend in trends for place in trend.places], trends[0].parameter, log=True)
    y = axis_of([value for trend in trends for value in (*trend.low, *trend.high)], _titled(figure))
    diagram = Diagram(x, y, f"{figure.kind.title} over {trends[0].parameter}")
    for trend in trends:
        diagram.band(colours[trend.group], trend.places, trend.low, trend.high)
    for trend in trends:
        diagram.curve(colours[trend.group], trend.places, trend.median, marks=True)
    return diagram.text()


def _summaries(figure: FigureFindings) -> str:
    head = "".join(f"<th>{share:.0%}</th>" for share in QUANTILES)
    body = "".join(
        f"<tr><td>{escape(group)}</td><td>{one.count:,}</td><td>{number(one.mean)}</td><td>{number(one.std)}</td>"
        + "".join(f"<td>{number(value)}</td>" for value in one.quantiles)
        + "</tr>"
        for group, one in figure.summaries.items()
    )
    top = f"<tr><th>quantiles</th><th>missions</th><th>mean</th><th>std</th>{head}</tr>"
    return f'<div class="wide"><table>{top}{body}</table></div>'


def _worst(figure: FigureFindings) -> str:
    which = "highest" if figure.kind.high_is_bad else "lowest"
    return f"<details><summary>The {which}, and how to fly them again</summary>{_cases(figure.worst)}</details>"


def _not_completed(cases: Sequence[Case]) -> str:
    if not cases:
        return ""
    about = "Missions that failed or ended without what was asked for" + (f", {len(cases)} of them" if cases else "")
    return f"<h2>Not completed</h2><details open><summary>{about}</summary>{_cases(cases)}</details>"


def _cases(cases: Sequence[Case]) -> str:
    items = []
    for case in cases:
        value = "" if case.value is None else f"<strong>{number(case.value)}</strong> "
        labels = ", ".join(f"{name} {_label(value)}" for name, value in case.labels.items())
        why = f' <span class="bad">{escape(case.why)}</span>' if case.why else ""
        command = f"<br><code>{escape(case.command)}</code>" if case.command else ""
        items.append(f"<li>{value}{escape(labels)}{why}{command}</li>")
    return f"<ol>{''.join(items)}</ol>"


def _label(value: object) -> str:
    return number(value) if isinstance(value, float) else str(value)


def _notes(findings: Findings) -> str:
    notes = [
        "A pair is two missions that differ in the compared value alone: same seed, same draw. Intervals are "
        f"percentiles of a bootstrap over seeds and draws, {RESAMPLES:,} resamples; of fewer than {FEW} of them they "
        "follow from Student's t. Where all pairs have one seed they say nothing of other seeds.",
        "The share of the variance is of first order: bins of the parameter by rank, without what so many bins explain "
        "by chance. What all shares together leave is the seed and what parameters do together.",
    ]
    if findings.compared is None:
        notes = notes[1:]
    return "".join(f'<p class="soft">{note}</p>' for note in notes)


def _titled(figure: FigureFindings) -> str:
    return f"{figure.kind.title} [{figure.kind.unit}]" if figure.kind.unit else figure.kind.title


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _signed(value: float) -> str:
    size = abs(value)
    return f"{'−' if value < 0 else '+'}{f'{size:.3g}' if 1e-3 <= size < 1000 else number(size)}"
