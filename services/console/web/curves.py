"""The curves of the page's charts: values over mission time, thinned so that a long mission stays small."""

from __future__ import annotations

from bisect import bisect_left

MAX_POINTS = 1500
"""Most points of a curve; beyond it every second point is dropped."""
TAIL = 2
"""The last points of a curve, of which the very last may still move."""
NAMES = ("energy_wh", "queue", "mean_std_ppb", "rmse_ppb")

Point = tuple[float, float]


class Curves:
    """Points (seconds since the mission's beginning, value) of each curve, in the order of time."""

    def __init__(self) -> None:
        self._points: dict[str, list[Point]] = {name: [] for name in NAMES}

    def add(self, name: str, at_s: float, value: float) -> bool:
        """Append a point; returns whether the curve has changed. The last of three equal values only moves."""
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
        """Insert points that are earlier than the first point of their curve."""
        for name, points in self._points.items():
            first = points[0][0] if points else float("inf")
            points[:0] = [point for point in past._points[name] if point[0] < first]

    def tail(self, name: str) -> list[Point]:
        """The last two points of a curve."""
        return self._points[name][-TAIL:]

    def since(self, name: str, at_s: float) -> list[Point]:
        """The points of a curve from that time on; empty if the last two are of that time or earlier."""
        points = self._points[name]
        first = bisect_left(points, at_s, key=lambda point: point[0])
        return points[first:] if points and points[-1][0] > at_s else []

    def document(self) -> dict[str, list[Point]]:
        """The curves as a JSON document for the page."""
        return {name: list(points) for name, points in self._points.items()}
