"""The sender's window: which message is sent next, and how many may be under way at a time."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from services.runtime.custody.protocol import CustodyConfig
    from services.runtime.custody.stream import KeptMessage, SendStream


class SendWindow:
    """Two queues, each in order of priority, then of offering. Repetitions go first and are not limited."""

    def __init__(self, config: CustodyConfig) -> None:
        self._max_messages = config.window_messages
        self._max_bytes = config.window_bytes
        self._new: list[KeptMessage] = []
        self._repetitions: list[KeptMessage] = []
        self._under_way = 0
        self._under_way_bytes = 0

    def enqueue(self, message: KeptMessage) -> None:
        """Let the message wait for its turn."""
        message.queued = True
        insort(self._queue_of(message), message, key=_turn)

    def dequeue(self, message: KeptMessage) -> None:
        """Take the message out of its queue, if it is in one."""
        if message.queued:
            message.queued = False
            queue = self._queue_of(message)
            del queue[bisect_left(queue, message.turn, key=_turn)]

    def take_next(self) -> KeptMessage | None:
        """The next message to send, taken out of its queue; None if none may be sent now."""
        queue = self._repetitions or self._new
        if not queue or (queue is self._new and not self._admits(queue[0])):
            return None
        message = queue[0]
        self.dequeue(message)
        return message

    def open(self, stream_part: dict[int, KeptMessage], message: KeptMessage) -> None:
        """Count the message as under way, in that part (`sent` or `held`) of its stream."""
        stream_part[message.sequence] = message
        self._under_way += 1
        self._under_way_bytes += len(message.payload)

    def close(self, stream: SendStream, message: KeptMessage) -> None:
        """Count the message as under way no longer, if it was."""
        if stream.sent.pop(message.sequence, None) or stream.held.pop(message.sequence, None):
            self._under_way -= 1
            self._under_way_bytes -= len(message.payload)

    def restore(self, streams: Iterable[SendStream]) -> None:
        """Rebuild the window from these streams: each message records whether it is queued or under way."""
        self._new, self._repetitions = [], []
        self._under_way = self._under_way_bytes = 0
        for stream in streams:
            for message in stream.kept.values():
                if message.queued:
                    self.enqueue(message)
            for message in (*stream.sent.values(), *stream.held.values()):
                self._under_way += 1
                self._under_way_bytes += len(message.payload)

    def _queue_of(self, message: KeptMessage) -> list[KeptMessage]:
        return self._repetitions if message.transmissions else self._new

    def _admits(self, message: KeptMessage) -> bool:
        return self._under_way == 0 or (
            self._under_way < self._max_messages and self._under_way_bytes + len(message.payload) <= self._max_bytes
        )


def _turn(message: KeptMessage) -> tuple[int, int]:
    return message.turn
