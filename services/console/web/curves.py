"""The curves of the page's charts: values over mission time, thinned so that a long mission stays small."""

from __future__ import annotations

MAX_POINTS = 1500
"""Points of a curve; when there are more, every second one is left out."""
TAIL = 200
"""Points that are sent when a curve has grown; the browser replaces what overlaps."""
NAMES = ("energy_wh", "queue", "mean_std_ppb", "rmse_ppb")

Point = tuple[float, float]


class Curves:
    """Points (seconds since the mission's beginning, value) of each curve, in the order of time."""

    def __init__(self) -> None:
        self._points: dict[str, list[Point]] = {name: [] for name in NAMES}

    def add(self, name: str, at_s: float, value: float) -> bool:
        """Append a point; whether the curve has grown. The last of three equal values only moves."""
        points = self._points[name]
        if points and points[-1][0] >= at_s:
            return False
        if len(points) > 1 and points[-1][1] == value == points[-2][1]:
            points[-1] = (at_s, value)
            return False
        points.append((at_s, value))
        if len(points) > MAX_POINTS:
            del points[1:-1:2]
        return True

    def prepend(self, past: Curves) -> None:
        """Put those points that are earlier than a curve's first before it."""
        for name, points in self._points.items():
            first = points[0][0] if points else float("inf")
            points[:0] = [point for point in past._points[name] if point[0] < first]

    def tail(self, name: str) -> list[Point]:
        """The last points of a curve."""
        return self._points[name][-TAIL:]

    def document(self) -> dict[str, list[Point]]:
        """As the page reads them."""
        return {name: list(points) for name, points in self._points.items()}
