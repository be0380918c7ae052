"""Diagrams as SVG text: curves with bands and bars, in the colours of the page's style sheet."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise
from math import ceil, floor, isfinite, log10

WIDTH, HEIGHT = 400, 250
LEFT, RIGHT, TOP, BOTTOM = 52, 12, 12, 40


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis: its range, and whether it is logarithmic."""

    low: float
    high: float
    title: str
    log: bool = False

    def share(self, value: float) -> float:
        """Where a value lies, 0 to 1 in the range."""
        low, high, value = (log10(each) if self.log else each for each in (self.low, self.high, value))
        return (value - low) / (high - low) if high > low else 0.5

    def ticks(self) -> list[float]:
        """Round numbers in the range."""
        if self.log:
            powers = range(floor(log10(self.low)), ceil(log10(self.high)) + 1)
            wide = log10(self.high / self.low) > 2
            found = [10.0**power * step for power in powers for step in ((1,) if wide else (1, 2, 5))]
        else:
            step = _round_step((self.high - self.low) / 5)
            first = ceil(self.low / step - 1e-9)
            found = [step * number for number in range(first, floor(self.high / step + 1e-9) + 1)]
        return [value for value in found if -1e-9 <= self.share(value) <= 1 + 1e-9]


def _round_step(step: float) -> float:
    """The round number, 1, 2 or 5 times a power of ten, at or above a step."""
    if not step > 0 or not isfinite(step):
        return 1.0
    power = 10.0 ** floor(log10(step))
    return next(power * factor for factor in (1, 2, 5, 10) if power * factor >= step * (1 - 1e-9))


def axis_of(values: Iterable[float], title: str, *, log: bool = False) -> Axis:
    """An axis over those values, with a little room beside them unless it is logarithmic.

    log: make it logarithmic if the values lie evenly on one, over a factor of 20 at least.
    """
    finite = sorted(value for value in values if isfinite(value))
    low, high = (finite[0], finite[-1]) if finite else (0.0, 1.0)
    if log and low > 0 and high / low > 20:
        middle = finite[len(finite) // 2]
        if abs(log10(middle / low) / log10(high / low) - 0.5) < abs((middle - low) / (high - low) - 0.5):
            return Axis(low, high, title, log=True)
    room = (high - low) * 0.04 or abs(high) * 0.1 or 1.0
    return Axis(low - room, high + room, title)


@dataclass(slots=True)
class Diagram:
    """A diagram that is being drawn; each series has the colour of its number."""

    x: Axis
    y: Axis
    about: str
    """What it shows, for readers who do not see it."""
    _parts: list[str] = field(default_factory=list)

    def curve(self, number: int, xs: Sequence[float], ys: Sequence[float], *, marks: bool = False) -> None:
        """A line through those points."""
        places = self._places(xs, ys)
        self._parts.append(f'<polyline class="line s{number}" points="{_joined(places)}"/>')
        if marks:
            self._parts += [f'<circle class="mark s{number}" cx="{x:.1f}" cy="{y:.1f}" r="2.6"/>' for x, y in places]

    def band(self, number: int, xs: Sequence[float], lows: Sequence[float], highs: Sequence[float]) -> None:
        """An area between two lines."""
        outline = self._places(xs, lows) + self._places(xs, highs)[::-1]
        self._parts.append(f'<polygon class="band s{number}" points="{_joined(outline)}"/>')

    def text(self) -> str:
        """The SVG element."""
        right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM
        parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(self.about)}">']
        for tick in self.x.ticks():
            x = self._x(tick)
            parts.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{bottom}"/>')
            parts.append(f'<text class="tick" x="{x:.1f}" y="{bottom + 15}" text-anchor="middle">{number(tick)}</text>')
        for tick in self.y.ticks():
            y = self._y(tick)
            parts.append(f'<line class="grid" x1="{LEFT}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}"/>')
            parts.append(f'<text class="tick" x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{number(tick)}</text>')
        middle = (LEFT + right) / 2, (TOP + bottom) / 2
        parts.append(
            f'<text class="title" x="{middle[0]}" y="{HEIGHT - 6}" text-anchor="middle">{escape(self.x.title)}</text>'
            f'<text class="title" transform="translate(11 {middle[1]}) rotate(-90)" text-anchor="middle">'
            f"{escape(self.y.title)}</text>"
        )
        return "".join((*parts, *self._parts, "</svg>"))

    def _x(self, value: float) -> float:
        return LEFT + (WIDTH - RIGHT - LEFT) * self.x.share(value)

    def _y(self, value: float) -> float:
        return HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP) * self.y.share(value)

    def _places(self, xs: Sequence[float], ys: Sequence[float]) -> list[tuple[float, float]]:
        return [(self._x(x), self._y(y)) for x, y in zip(xs, ys, strict=True)]


@dataclass(frozen=True, slots=True)
class Bar:
    """One bar: the number of its series, a share, and the mark below which it may be chance, both 0 to 1."""

    series: int
    share: float
    noise: float
    text: str = ""
    """Shown after the share."""


def bars(rows: Sequence[tuple[str, Sequence[Bar]]], about: str) -> str:
    """Horizontal bars as an SVG element: rows of a name and its bars."""
    thick, gap, left, right = 13, 9, 96, 46
    height = sum(len(series) * thick + gap for _, series in rows) + 12
    scale = WIDTH - left - right
    parts = [f'<svg viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{escape(about)}">']
    y = 6.0
    for name, series in rows:
        middle = y + len(series) * thick / 2 + 4
        parts.append(f'<text class="tick" x="{left - 8}" y="{middle:.1f}" text-anchor="end">{escape(name)}</text>')
        for bar in series:
            share, noise = bar.share, bar.noise
            parts.append(
                f'<rect class="bar s{bar.series}" x="{left}" y="{y:.1f}" width="{max(share * scale, 0.5):.1f}" '
                f'height="{thick - 2}"/>'
                f'<line class="noise" x1="{left + noise * scale:.1f}" x2="{left + noise * scale:.1f}" y1="{y:.1f}" '
                f'y2="{y + thick - 2:.1f}"/>'
                f'<text class="tick" x="{left + max(share, noise) * scale + 5:.1f}" y="{y + thick - 3:.1f}">'
                f"{share:.0%}{bar.text}</text>"
            )
            y += thick
        y += gap
    return "".join((*parts, "</svg>"))


def steps(xs: Sequence[float], ys: Sequence[float]) -> tuple[list[float], list[float]]:
    """The points of a staircase through those points."""
    across, up = [xs[0]], [ys[0]]
    for (_, before), (x, y) in pairwise(zip(xs, ys, strict=True)):
        across += [x, x]
        up += [before, y]
    return across, up


def number(value: float) -> str:
    """A number in a few digits."""
    if value == 0:
        return "0"
    if abs(value) >= 10_000:
        return f"{value:,.0f}"
    return f"{value:.4g}" if abs(value) >= 1e-3 else f"{value:.0e}"


def _joined(places: Iterable[tuple[float, float]]) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
