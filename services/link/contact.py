"""When the two sides see each other: always, in listed windows, or during part of every period.

All times are integer nanoseconds of mission time. A window holds from its opening until just before its closing.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import NamedTuple

from schemas.link import LinkConditions
from services.runtime.node import MissionTime, seconds


class Span(NamedTuple):
    """A stretch of contact [opens, closes); `closes` None: it does not end."""

    opens: MissionTime
    closes: MissionTime | None

    def fits(self, begins: MissionTime, duration: int) -> bool:
        """Whether something that takes so long [ns] and begins then ends before contact does."""
        return begins >= self.opens and (self.closes is None or begins + duration <= self.closes)


ALWAYS = Span(0, None)


@dataclass(frozen=True, slots=True)
class Contact:
    """Contact over time. Without windows and period there always is; `forced` overrides the schedule either way."""

    windows: tuple[Span, ...] = ()
    """In order, not touching each other; empty: see `period`."""
    period: int | None = None
    """Length of a cycle [ns]; None: the windows are all there is, or there is always contact."""
    share: int = 0
    """Contact at the beginning of each cycle [ns]."""
    phase: MissionTime = 0
    """Some time at which a cycle begins."""
    forced: bool | None = None

    @classmethod
    def of(cls, conditions: LinkConditions, start: MissionTime, forced: bool | None = None) -> Contact:
        """The contact that conditions state, for a mission that began at `start` [ns]."""
        if conditions.duty_cycle is not None:
            cycle = conditions.duty_cycle
            period = max(1, seconds(cycle.period_s))
            share = min(period, max(1, seconds(cycle.contact_s)))
            return cls(period=period, share=share, phase=start + seconds(cycle.offset_s), forced=forced)
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
        return not self.windows and (self.period is None or self.share == self.period)

    def span_from(self, time: MissionTime) -> Span | None:
        """The contact that holds at `time`, else the next one; None when there is none any more."""
        if self._always:
            return ALWAYS
        if self.forced is False:
            return None
        if self.period is not None:
            opens = time - (time - self.phase) % self.period
            opens = opens if time < opens + self.share else opens + self.period
            return Span(opens, opens + self.share)
        index = bisect_right(self.windows, time, key=lambda span: span.closes or 0)
        return self.windows[index] if index < len(self.windows) else None

    def open_at(self, time: MissionTime) -> bool:
        """Whether there is contact at that time."""
        span = self.span_from(time)
        return span is not None and span.opens <= time

    def changes_at(self, time: MissionTime) -> MissionTime | None:
        """When, after `time`, contact begins or ends next; None: it stays as it is."""
        span = self.span_from(time)
        if span is None:
            return None
        return span.opens if span.opens > time else span.closes

    def longest_from(self, time: MissionTime) -> int | None:
        """The longest uninterrupted contact [ns] from `time` on; None: it never ends."""
        span = self.span_from(time)
        if span is None:
            return 0
        if span.closes is None:
            return None
        if self.period is not None:
            return self.share
        index = self.windows.index(span)
        left = span.closes - max(time, span.opens)
        return max([left, *((later.closes or 0) - later.opens for later in self.windows[index + 1 :])])

    def after(self, time: MissionTime, duration: int) -> MissionTime | None:
        """When so much contact [ns] has passed since `time`, pauses left out; None: never."""
        span = self.span_from(time)
        while span is not None:
            begins = max(time, span.opens)
            if span.closes is None or begins + duration <= span.closes:
                return begins + duration
            duration -= span.closes - begins
            if self.period is not None:
                cycles, rest = divmod(duration, self.share)
                if rest == 0:
                    return span.closes + cycles * self.period
                return span.opens + (cycles + 1) * self.period + rest
            time = span.closes
            span = self.span_from(time)
        return None
