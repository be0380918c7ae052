"""A journal in memory, with exactly the bytes that a process would have on its disk after a power failure."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

from services.runtime.checkpoint_file import Mark
from services.runtime.input_codec import decode_input
from services.runtime.journal import JournalReader, JournalWriter

if TYPE_CHECKING:
    from services.mission.mission_time import MissionTime
    from services.runtime.inputs import Input
    from services.runtime.node import SavedState
    from services.runtime.state_codec import StateCodec


class SimulatedJournal:
    """The journal of one start of a node."""

    def __init__(self, identity: dict[str, str], codec: StateCodec) -> None:
        self.identity = identity
        self._codec = codec
        self._stream = io.BytesIO()
        self._on_disk = 0
        self._writer = JournalWriter(self._stream, identity, codec, self._keep, sync=self._sync)
        self._torn = b""
        self._mark = Mark()
        self._state: bytes | None = None

    @property
    def has_checkpoint(self) -> bool:
        """Whether a state is kept."""
        return self._state is not None

    def state(self) -> SavedState:
        """The state of the last checkpoint, decoded; `has_checkpoint` must hold."""
        assert self._state is not None, "there is no checkpoint"
        state: SavedState = self._codec.decode(self._state)
        return state

    def append(self, now: MissionTime, inputs: Sequence[Input]) -> None:
        self._writer.append(now, inputs)

    def checkpoint(self, state: SavedState) -> None:
        self._writer.checkpoint(state)

    def _sync(self) -> None:
        self._on_disk = self._stream.tell()

    def _keep(self, mark: Mark, _starts: int, state: bytes) -> None:
        self._mark, self._state = mark, state

    def tear(self, tail: bytes) -> None:
        """Put the beginning of an unfinished record at the end."""
        self._torn = tail

    def entries(self, since_checkpoint: bool = False) -> list[tuple[MissionTime, Input]]:
        """The inputs kept, or only those after the last checkpoint, read back from the bytes."""
        stream = io.BytesIO(self._stream.getvalue()[: self._on_disk] + self._torn)
        reader = JournalReader(stream, self.identity, "journal", self._mark if since_checkpoint else Mark())
        return [(record.now, decode_input(record.channel, record.data, self._codec)) for record in reader]
