"""The contact schedule: always, in listed windows, or during part of every period.

All times are integer nanoseconds of mission time. A window includes its opening and excludes its closing.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from services.mission.mission_time import MissionTime, seconds

if TYPE_CHECKING:
    from schemas.link import LinkConditions


class Span(NamedTuple):
    """An interval of contact [opens, closes); `closes` None: it does not end."""

    opens: MissionTime
    closes: MissionTime | None

    def fits(self, begins: MissionTime, duration: int) -> bool:
        """Whether a transmission of that duration [ns] that begins then ends before contact does."""
        return begins >= self.opens and (self.closes is None or begins + duration <= self.closes)


ALWAYS = Span(0, None)


@dataclass(frozen=True, slots=True)
class Contact:
    """Contact over time. Without windows and period there is always contact; `forced` overrides the schedule."""

    windows: tuple[Span, ...] = ()
    """Windows of contact, in order and separate; empty: see `period`."""
    period: int | None = None
    """Length of a cycle [ns]; None: there are only the windows, or there is always contact."""
    open_ns: int = 0
    """Duration of contact at the beginning of each cycle [ns]."""
    phase: MissionTime = 0
    """A time at which a cycle begins."""
    forced: bool | None = None

    @classmethod
    def of(cls, conditions: LinkConditions, start: MissionTime, forced: bool | None = None) -> Contact:
        """The contact schedule of those conditions, for a mission that began at `start` [ns]."""
        if conditions.duty_cycle is not None:
            cycle = conditions.duty_cycle
            period = max(1, seconds(cycle.period_s))
            open_ns = min(period, max(1, seconds(cycle.contact_s)))
            return cls(period=period, open_ns=open_ns, phase=start + seconds(cycle.offset_s), forced=forced)
        spans: list[Span] = []
        for window in conditions.windows:
            opens, closes = start + seconds(window.opens_s), start + seconds(window.closes_s)
            if spans and spans[-1].closes == opens:
                spans[-1] = Span(spans[-1].opens, closes)
            elif closes > opens:
                spans.append(Span(opens, closes))
        return cls(windows=tuple(spans), forced=forced)

    @property
    def _always(self) -> bool:
        if self.forced is not None:
            return self.forced
        return not self.windows and (self.period is None or self.open_ns == self.period)

    def span_from(self, time: MissionTime) -> Span | None:
        """The contact at `time`, or else the next one; None if there is none any more."""
        if self._always:
            return ALWAYS
        if self.forced is False:
            return None
        if self.period is not None:
            opens = time - (time - self.phase) % self.period
            opens = opens if time < opens + self.open_ns else opens + self.period
            return Span(opens, opens + self.open_ns)
        index = bisect_right(self.windows, time, key=lambda span: span.closes or 0)
        return self.windows[index] if index < len(self.windows) else None

    def open_at(self, time: MissionTime) -> bool:
        """Whether there is contact at that time."""
        span = self.span_from(time)
        return span is not None and span.opens <= time

    def changes_at(self, time: MissionTime) -> MissionTime | None:
        """When contact begins or ends next after `time`; None if it does not change."""
        span = self.span_from(time)
        if span is None:
            return None
        return span.opens if span.opens > time else span.closes

    def longest_from(self, time: MissionTime) -> int | None:
        """The longest uninterrupted contact [ns] from `time` on; None if it never ends."""
        span = self.span_from(time)
        if span is None:
            return 0
        if span.closes is None:
            return None
        if self.period is not None:
            return self.open_ns
        index = self.windows.index(span)
        left = span.closes - max(time, span.opens)
        return max([left, *((later.closes or 0) - later.opens for later in self.windows[index + 1 :])])

    def after(self, time: MissionTime, duration: int) -> MissionTime | None:
        """When that duration [ns] of contact has passed since `time`, pauses not counted; None if it never does."""
        span = self.span_from(time)
        while span is not None:
            begins = max(time, span.opens)
            if span.closes is None or begins + duration <= span.closes:
                return begins + duration
            duration -= span.closes - begins
            if self.period is not None:
                cycles, rest = divmod(duration, self.open_ns)
                if rest == 0:
                    return span.closes + cycles * self.period
                return span.opens + (cycles + 1) * self.period + rest
            time = span.closes
            span = self.span_from(time)
        return None
