"""When to send a message again: the round trip as measured, the waits that follow from it, and suspended timers.

The wait for an acknowledgement is one round trip, the time to send the bytes queued ahead, and a margin. It is doubled
with each repetition of its stream that brings no answer. Times are integer nanoseconds of mission time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from services.mission.mission_time import MissionTime, seconds
from services.runtime.custody.protocol import CustodyConfig, transmission_time

if TYPE_CHECKING:
    from services.runtime.custody.stream import SendStream, Transmission
    from services.runtime.node import SavedState

MAX_DOUBLINGS: Final = 5
"""A wait grows 32-fold at most: on this link, noise loses more messages than full queues do."""
MAX_SURPRISE: Final = 4
"""A measured round trip is limited to this many waits, so that one that spans a blackout does not spoil the mean."""


class RoundTrip:
    """The time [ns] from a message's last bit to its acknowledgement: mean and variation, smoothed as in RFC 6298."""

    def __init__(self, estimate: MissionTime, margin: MissionTime) -> None:
        self.mean = estimate
        self._variation: MissionTime = 0
        self._margin = margin

    @property
    def wait(self) -> MissionTime:
        """How long to wait for an acknowledgement [ns]."""
        return self.mean + max(self._margin, 4 * self._variation)

    def measured(self, round_trip: MissionTime) -> None:
        """Include one measurement [ns]."""
        self._variation += (abs(self.mean - round_trip) - self._variation) // 4
        self.mean += (round_trip - self.mean) // 8

    def checkpoint(self) -> SavedState:
        """The measured mean and variation, as named parts."""
        return {"mean": self.mean, "variation": self._variation}

    def restore(self, state: SavedState) -> None:
        """Restore the round trip from this state."""
        self.mean, self._variation = state["mean"], state["variation"]


class RetransmissionTimer:
    """The sender's timers: one for each stream while there is contact, one for the probe while there is none."""

    def __init__(self, config: CustodyConfig) -> None:
        self._round_trip = RoundTrip(seconds(config.round_trip_s), seconds(config.margin_s))
        self._rate_bit_s = config.rate_bit_s
        self._max_wait = seconds(config.max_wait_s)
        self._probe_pause = seconds(config.probe_s)
        self._silent_repetitions = config.silent_repetitions
        self._idle_at: MissionTime = 0
        """When the last bit of everything sent so far leaves."""
        self._probe_at: MissionTime | None = None

    # --- contact ------------------------------------------------------------------------------------------------

    @property
    def probe_at(self) -> MissionTime | None:
        """When one message is to be sent although the other side is silent; None while there is contact."""
        return self._probe_at

    @property
    def suspended(self) -> bool:
        """Whether the timers are suspended because nothing has been received for a long time."""
        return self._probe_at is not None

    def suspend(self, now: MissionTime) -> None:
        """Suspend the timers; also when a probe was sent, until the next one."""
        self._probe_at = now + max(self._probe_pause, 2 * self._round_trip.mean)

    def resume(self) -> None:
        """Let the timers run: there is contact."""
        self._probe_at = None

    # --- one stream's timer -------------------------------------------------------------------------------------

    def deadline(self, stream: SendStream, ahead_bytes: int) -> MissionTime | None:
        """When the stream's oldest message under way is to be repeated; None if none is under way.

        ahead_bytes: size of that message and of all under way that leave before it.
        """
        message = stream.oldest_sent
        if message is None:
            return None
        queued = transmission_time(ahead_bytes, self._rate_bit_s)
        wait = (self._round_trip.wait + queued) << stream.doublings
        longest = max(self._max_wait, 2 * self._round_trip.wait + queued)
        return max(stream.waits_since, message.last_sent_at) + min(wait, longest)

    def elapsed(self, stream: SendStream) -> bool:
        """Double the stream's next wait; returns whether so many were unanswered that contact is lost."""
        stream.doublings = min(MAX_DOUBLINGS, stream.doublings + 1)
        stream.unanswered += 1
        return stream.unanswered > self._silent_repetitions

    # --- measuring ----------------------------------------------------------------------------------------------

    def transmit(self, size_bytes: int, now: MissionTime) -> MissionTime:
        """When the last bit of a message that is sent now leaves, behind everything sent before it."""
        self._idle_at = max(now, self._idle_at) + transmission_time(size_bytes, self._rate_bit_s)
        return self._idle_at

    def acknowledged(self, stream: SendStream, transmission: Transmission, now: MissionTime) -> None:
        """Measure the round trip by the transmission whose arrival was acknowledged."""
        longest = MAX_SURPRISE * self._round_trip.wait
        self._round_trip.measured(min(longest, max(0, now - transmission.last_bit_at)))
        stream.doublings = 0

    # --- checkpoints --------------------------------------------------------------------------------------------

    def checkpoint(self) -> SavedState:
        """The round trip and whether timers are suspended, as named parts."""
        return {"round_trip": self._round_trip.checkpoint(), "idle_at": self._idle_at, "probe_at": self._probe_at}

    def restore(self, state: SavedState) -> None:
        """Restore the timer from this state."""
        self._round_trip.restore(state["round_trip"])
        self._idle_at, self._probe_at = state["idle_at"], state["probe_at"]
