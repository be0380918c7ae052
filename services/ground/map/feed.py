"""The map's feed: a key frame to begin with, then only what has changed. Every reader ends with the same bytes.

A frame on the wire: 4 bytes 'HE3F', the length of the head (4 bytes, little-endian), the head (JSON of
``schemas.maps.MapFrame``), and the numbers. Those are zlib of three planes one after the other: mean and std as
little-endian float32 with their bytes sorted by significance (all first bytes, all second, ...), traversable as bytes;
rows from the south. In a delta each plane is the exclusive or with the frame before: equal bytes are zero, and take
almost no room when compressed. A beat has no numbers; it gives the newest sequence, so that a reader that missed the
last frame notices.

Writer and reader do no I/O: frames are handed to them and taken from them as bytes.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from he3.errors import InvalidInput
from schemas.maps import MAX_CELLS, FrameKind, MapFrame
from schemas.validation import one_line

if TYPE_CHECKING:
    from he3.frames import BoolArray, Float32Array
    from services.mission.mission_time import MissionTime

MAGIC: Final = b"HE3F"
_LENGTH: Final = struct.Struct("<I")
MAX_HEAD_BYTES: Final = 4096
LEVEL: Final = 1  # of zlib: low bytes are noise, high bytes zeros; a higher level gains 2 %


@dataclass(frozen=True, slots=True, eq=False)
class FeedMap:
    """The map after one frame of the feed; arrays are (rows, columns), row 0 in the south, read-only."""

    mean_ppb: Float32Array
    std_ppb: Float32Array
    traversable: BoolArray
    resolution_m: float
    revision: int
    samples: int
    mission_time_ns: MissionTime

    def planes(self) -> bytes:
        """All numbers, in the order in which they are compressed."""
        floats = (_sorted_bytes(np.asarray(values, dtype="<f4")) for values in (self.mean_ppb, self.std_ppb))
        return b"".join((*floats, self.traversable.astype(np.uint8).tobytes()))

    def checksum(self) -> int:
        """CRC-32 of the numbers in memory order."""
        crc = zlib.crc32(np.ascontiguousarray(self.mean_ppb, dtype="<f4").data)
        crc = zlib.crc32(np.ascontiguousarray(self.std_ppb, dtype="<f4").data, crc)
        return zlib.crc32(np.ascontiguousarray(self.traversable).view(np.uint8).data, crc)


class FeedWriter:
    """Makes the frames; `epoch` distinguishes one start of the feed from another."""

    def __init__(self, epoch: int) -> None:
        self._epoch = epoch
        self._sequence = 0
        self._map: FeedMap | None = None
        self._planes: bytes | None = None
        self._key: bytes | None = None

    def take(self, current: FeedMap, wanted: bool) -> bytes | None:
        """The frame that updates readers to that map; None if no frame is needed or the map has not changed."""
        before, planes = self._map, self._planes
        if before is not None and before.revision == current.revision:
            return None
        self._map, self._planes, self._key = current, None, None
        self._sequence += 1
        if not wanted:
            return None
        self._planes = current.planes()
        if before is None or before.mean_ppb.shape != current.mean_ppb.shape:
            return self.key()
        delta = np.bitwise_xor(
            np.frombuffer(planes or before.planes(), dtype=np.uint8), np.frombuffer(self._planes, dtype=np.uint8)
        )
        return self._frame(FrameKind.DELTA, delta.tobytes())

    def key(self) -> bytes | None:
        """The whole map as a frame; None while there is none."""
        if self._map is not None and self._key is None:
            self._planes = self._planes or self._map.planes()
            self._key = self._frame(FrameKind.KEY, self._planes)
        return self._key

    def beat(self) -> bytes | None:
        """A frame with the newest sequence and no numbers; None before the first map."""
        return None if self._map is None else self._frame(FrameKind.BEAT, b"")

    def _frame(self, kind: FrameKind, planes: bytes) -> bytes:
        current = self._map
        assert current is not None, "frames are made once there is a map"
        rows, columns = current.mean_ppb.shape
        head = MapFrame(
            kind=kind,
            epoch=self._epoch,
            sequence=self._sequence,
            rows=rows,
            columns=columns,
            resolution_m=current.resolution_m,
            revision=current.revision,
            samples=current.samples,
            mission_time_ns=current.mission_time_ns,
            checksum=current.checksum() if planes else 0,
        )
        text = head.model_dump_json().encode()
        return MAGIC + _LENGTH.pack(len(text)) + text + (zlib.compress(planes, LEVEL) if planes else b"")


@dataclass(slots=True)
class FeedReader:
    """Puts the frames together. When frames are lost, doubled or late, it asks for a key frame with `needs_key`."""

    map: FeedMap | None = None
    needs_key: bool = True
    """Ask for a key frame, and hand it to `take` as well."""
    _planes: bytes = b""
    _at: tuple[int, int] = (-1, -1)
    """Epoch and sequence of the map."""
    _waiting: dict[tuple[int, int], bytes] = field(default_factory=dict)
    """Deltas that came before the key frame that they build on."""

    def take(self, frame: bytes) -> bool:
        """Apply a frame; returns whether the map changed. Raises InvalidInput, without a change, for other bytes."""
        head, packed = read_head(frame)
        at = (head.epoch, head.sequence)
        if head.kind is FrameKind.BEAT:
            self.needs_key = self.needs_key or at != self._at
            return False
        if head.kind is FrameKind.KEY:
            if at[0] == self._at[0] and at[1] <= self._at[1]:
                # Late: the map is as new already. A later delta may still wait for the one in between.
                self.needs_key = self.needs_key and at[1] < max((key[1] for key in self._waiting), default=0)
                return False
            self._adopt(head, _unpacked(head, packed))
            return True
        if at[0] == self._at[0] and at[1] <= self._at[1]:
            return False
        if at != (self._at[0], self._at[1] + 1) or self.map is None:
            if len(self._waiting) < 64:
                self._waiting[at] = frame
            self.needs_key = True
            return False
        self._apply(head, packed)
        return True

    def _apply(self, head: MapFrame, packed: bytes) -> None:
        change = np.frombuffer(_unpacked(head, packed), dtype=np.uint8)
        planes = np.frombuffer(self._planes, dtype=np.uint8)
        if planes.size != change.size:
            self.needs_key = True
            return
        self._adopt(head, np.bitwise_xor(planes, change).tobytes())

    def _adopt(self, head: MapFrame, planes: bytes) -> None:
        current = _map_of(head, planes)
        if current.checksum() != head.checksum:
            self.needs_key = True
            raise InvalidInput(f"map feed: expected checksum {head.checksum}, got {current.checksum()}: damaged")
        self.map, self._planes, self._at = current, planes, (head.epoch, head.sequence)
        self.needs_key = False
        for at in [at for at in self._waiting if at[0] != head.epoch or at[1] <= head.sequence]:
            del self._waiting[at]
        following = self._waiting.pop((head.epoch, head.sequence + 1), None)
        if following is not None:
            self._apply(*read_head(following))
        elif self._waiting:
            self.needs_key = True


def read_head(frame: bytes) -> tuple[MapFrame, bytes]:
    """Head and compressed numbers of a frame; raises InvalidInput for other bytes."""
    start = len(MAGIC) + _LENGTH.size
    if frame[: len(MAGIC)] != MAGIC or len(frame) < start:
        raise InvalidInput(f"map feed: expected a frame that begins with {MAGIC!r}, got {frame[:8]!r}")
    (length,) = _LENGTH.unpack_from(frame, len(MAGIC))
    if length > MAX_HEAD_BYTES or len(frame) < start + length:
        raise InvalidInput(f"map feed: expected a head of at most {MAX_HEAD_BYTES} bytes, got {length}")
    try:
        head = MapFrame.model_validate_json(frame[start : start + length])
    except ValidationError as error:
        raise InvalidInput(f"map feed: {one_line(error)}") from None
    if not 0 < head.rows * head.columns <= MAX_CELLS:
        raise InvalidInput(f"map feed: expected 1 to {MAX_CELLS} cells, got {head.rows} x {head.columns}")
    return head, frame[start + length :]


def _unpacked(head: MapFrame, packed: bytes) -> bytes:
    expected = head.rows * head.columns * 9
    unpacker = zlib.decompressobj()
    try:
        planes = unpacker.decompress(packed, expected + 1)
    except zlib.error as error:
        raise InvalidInput(f"map feed: expected packed numbers, got damaged ones: {error}") from None
    if len(planes) != expected:
        raise InvalidInput(f"map feed: expected {expected} bytes of numbers, got {len(planes)}")
    return planes


def _map_of(head: MapFrame, planes: bytes) -> FeedMap:
    cells, shape = head.rows * head.columns, (head.rows, head.columns)
    floats: list[Float32Array] = []
    for start in (0, 4 * cells):
        by_significance = np.frombuffer(planes, dtype=np.uint8, count=4 * cells, offset=start).reshape(4, cells)
        values = np.ascontiguousarray(by_significance.T).view("<f4").reshape(shape)
        values.setflags(write=False)
        floats.append(values)
    open_cells = np.frombuffer(planes, dtype=np.uint8, offset=8 * cells).reshape(shape).astype(np.bool_)
    open_cells.setflags(write=False)
    mean, std = floats
    return FeedMap(mean, std, open_cells, head.resolution_m, head.revision, head.samples, head.mission_time_ns)


def _sorted_bytes(values: NDArray[np.float32]) -> bytes:
    return np.ascontiguousarray(values).view(np.uint8).reshape(-1, 4).T.tobytes()
