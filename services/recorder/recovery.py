"""The records of an MCAP file, also of one that is cut off or damaged: every chunk that is whole is read.

The file is read record by record. Where a record is damaged, reading continues at the next chunk whose checksum is
correct; chunks are found by the bytes that precede the compressed data of each. The summary at the end of the file
repeats the schemas, the channels and the number of messages. It is read first, so that the loss of a chunk can be
counted.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from mmap import MADV_DONTNEED, PAGESIZE, mmap
from typing import Any, Final

import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC as MAGIC

MAX_RECORD_BYTES: Final = 64 * 1024 * 1024  # of a record, and of the content of a chunk; ours have less than 1 MB

BLOCK_BYTES: Final = 16 * 1024 * 1024  # of a file that are held in memory while it is read, and not more by much

_FRAME: Final = struct.Struct("<BQ")  # opcode and length, before the content of each record
_FOOTER: Final = struct.Struct("<BQQQI")  # a whole record: opcode, length, summary start, offset start, checksum
_COMPRESSION: Final = struct.pack("<I4s", 4, b"zstd")
_COMPRESSION_AT: Final = _FRAME.size + 8 + 8 + 8 + 4  # in a chunk's record, behind two times, a size and a checksum

_UNREADABLE: Final = (McapError, struct.error, ValueError, EOFError, OverflowError, MemoryError)
"""Exceptions of the library for a damaged record."""

_TYPES: Final[dict[int, Any]] = {
    Opcode.HEADER: records.Header,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.CHUNK: records.Chunk,
    Opcode.MESSAGE_INDEX: records.MessageIndex,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
    Opcode.ATTACHMENT: records.Attachment,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex,
    Opcode.STATISTICS: records.Statistics,
    Opcode.METADATA: records.Metadata,
    Opcode.METADATA_INDEX: records.MetadataIndex,
    Opcode.SUMMARY_OFFSET: records.SummaryOffset,
    Opcode.DATA_END: records.DataEnd,
}

Content = (
    records.Header
    | records.Schema
    | records.Channel
    | records.Message
    | records.Attachment
    | records.Metadata
    | records.Statistics
)
"""Types of the records that contain messages and describe them."""


@dataclass(frozen=True, slots=True)
class Fault:
    """A part of the file that is damaged or missing."""

    start: int
    """First byte of the part."""
    end: int
    """One past its last byte; equal to `start` where the file ends and more was expected."""
    what: str
    at_end: bool = False
    """Whether only the end of the file is missing or damaged, as in a file that was not closed: no whole record is."""


class _Content(ReadDataStream):
    """The content of one record; reading beyond it raises EOFError."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) < length:
            raise EOFError
        return data


class _Damaged(Exception):
    """A chunk that cannot be unpacked; the text says why."""


@dataclass(frozen=True, slots=True)
class _Summary:
    content: tuple[Content, ...]
    start: int


def read_records(data: bytes | mmap) -> Iterator[Content | Fault]:
    """The content of an MCAP file in the order of the file, with a Fault for each part that is not whole.

    The schemas, channels and statistics of the summary come first: messages can then be assigned to their channels even
    if the chunk is lost that introduces them.
    """
    summary = _read_summary(data)
    if summary is not None:
        yield from summary.content
    if data[: len(MAGIC)] != MAGIC:
        yield Fault(0, min(len(data), len(MAGIC)), "the file does not begin as an MCAP file does")
    yield from _read_data_section(data, summary)
    if summary is not None and data[-len(MAGIC) :] != MAGIC:
        yield Fault(len(data) - len(MAGIC), len(data), "the file does not end as an MCAP file does")


def _read_data_section(data: bytes | mmap, summary: _Summary | None) -> Iterator[Content | Fault]:
    end = len(data) if summary is None else summary.start
    position, released, whole = len(MAGIC), 0, True
    while position < end:
        if position - released >= BLOCK_BYTES:
            released = _release(data, released, position)
        record, behind = _record_at(data, position, end)
        if isinstance(record, records.DataEnd):
            if whole and record.data_section_crc not in (0, _checksum(data, 0, position)):
                yield Fault(0, position, "the checksum of the file is wrong, although each chunk is whole")
            if summary is None:
                yield Fault(behind, len(data), "the summary is damaged or cut off; it holds no messages", True)
            return
        if isinstance(record, records.Chunk):
            try:
                yield from _unpack(record)
            except _Damaged as damage:
                whole = False
                yield Fault(position, behind, f"a damaged chunk ({damage})")
        elif isinstance(record, Content) and not isinstance(record, records.Statistics):
            yield record
        elif record is None:
            whole = False
            found = _next_chunk(data, position, end)
            if found is None:
                yield Fault(position, end, "a damaged record") if summary else _cut_off(data, position, end)
                return
            start, content, behind = found
            if start == position:
                yield Fault(position, behind, "a chunk whose frame is damaged; its messages are whole")
            else:
                yield Fault(position, start, "damaged records")
            yield from content
        position = behind
    if summary is None:
        yield Fault(end, end, "the file ends early: it was not closed, or it is cut off", True)
    else:
        yield Fault(end, end, "the end of the data is not marked")


def _cut_off(data: bytes | mmap, position: int, end: int) -> Fault:
    if end - position >= _FRAME.size:
        opcode, length = _FRAME.unpack_from(data, position)
        if opcode not in _TYPES or position + _FRAME.size + length <= end:
            return Fault(position, end, "damaged records, up to the end of the file")
    return Fault(position, end, "the file ends early, within a record", True)


def _record_at(data: bytes | mmap, position: int, end: int) -> tuple[Any, int]:
    """The record at that position, and the position behind it; (None, 0) unless its length fits its content."""
    if end - position < _FRAME.size:
        return None, 0
    opcode, length = _FRAME.unpack_from(data, position)
    begin = position + _FRAME.size
    if length > min(MAX_RECORD_BYTES, end - begin) or (opcode not in _TYPES and opcode != Opcode.MESSAGE):
        return None, 0
    stream = _Content(BytesIO(data[begin : begin + length]))
    try:
        if opcode == Opcode.MESSAGE:
            record: Any = records.Message.read(stream, length)
        else:
            record = _TYPES[opcode].read(stream)
    except _UNREADABLE:
        return None, 0
    return (record, begin + length) if stream.count == length else (None, 0)


def _unpack(chunk: records.Chunk) -> list[Content]:
    """The schemas, channels and messages of a chunk; raises _Damaged."""
    content, behind = chunk.data, len(chunk.data)
    if chunk.compression == "zstd":
        content, behind = _decompress(chunk.data, chunk.uncompressed_size)
    elif chunk.compression != "":
        raise _Damaged(f"expected compression zstd or none, got {chunk.compression[:20]!r}")
    if behind != len(chunk.data):
        raise _Damaged("it is longer than its content")
    return _content(content, chunk.uncompressed_crc)


def _content(content: bytes, checksum: int) -> list[Content]:
    """The schemas, channels and messages in the uncompressed content of a chunk; raises _Damaged."""
    if checksum not in (0, zlib.crc32(content)):
        raise _Damaged("its checksum is wrong")
    found: list[Content] = []
    position = 0
    while position < len(content):
        record, position = _record_at(content, position, len(content))
        if record is None:
            raise _Damaged("expected records of the lengths that they state")
        if isinstance(record, records.Schema | records.Channel | records.Message):
            found.append(record)
    return found


def _decompress(data: bytes, size: int) -> tuple[bytes, int]:
    """The content of that size of the Zstandard frame that the data begin with, and the length of the frame."""
    try:
        found = zstandard.frame_content_size(data)
        if found != size or size > MAX_RECORD_BYTES:
            raise _Damaged(f"expected {size} bytes of content, got {found}")
        decompressor = zstandard.ZstdDecompressor().decompressobj()
        content = decompressor.decompress(data)
    except (zstandard.ZstdError, MemoryError):
        raise _Damaged("it cannot be decompressed") from None
    if not decompressor.eof:
        raise _Damaged("it is cut off")
    return content, len(data) - len(decompressor.unused_data)


def _next_chunk(data: bytes | mmap, position: int, end: int) -> tuple[int, list[Content], int] | None:
    """Start, content and end of the first whole chunk from that position on. Its opcode and lengths are not trusted."""
    at = data.find(_COMPRESSION, position + _COMPRESSION_AT, end)
    while at >= 0:
        size, checksum = struct.unpack_from("<QI", data, at - 12)
        begin = at + len(_COMPRESSION) + 8
        try:
            content, length = _decompress(data[begin : min(end, begin + MAX_RECORD_BYTES)], size)
            return at - _COMPRESSION_AT, _content(content, checksum), begin + length
        except _Damaged:
            at = data.find(_COMPRESSION, at + 1, end)
    return None


def _read_summary(data: bytes | mmap) -> _Summary | None:
    """The summary; None if it is missing, cut off or damaged."""
    footer_at = len(data) - len(MAGIC) - _FOOTER.size
    if footer_at < len(MAGIC):
        return None
    opcode, length, start, _, checksum = _FOOTER.unpack_from(data, footer_at)
    if (opcode, length) != (Opcode.FOOTER, _FOOTER.size - _FRAME.size) or start > footer_at:
        return None
    start = start or footer_at
    if checksum not in (0, _checksum(data, start, footer_at + _FOOTER.size - 4)):
        return None
    content: list[Content] = []
    position = start
    while position < footer_at:
        record, position = _record_at(data, position, footer_at)
        if record is None:
            return None
        if isinstance(record, records.Schema | records.Channel | records.Statistics):
            content.append(record)
    return _Summary(tuple(content), start)


def _checksum(data: bytes | mmap, start: int, end: int) -> int:
    checksum = 0
    for begin in range(start, end, BLOCK_BYTES):
        stop = min(begin + BLOCK_BYTES, end)
        with memoryview(data) as view, view[begin:stop] as part:
            checksum = zlib.crc32(part, checksum)
        _release(data, begin, stop)
    return checksum


def _release(data: bytes | mmap, start: int, end: int) -> int:
    """Let go of the memory of that part of a file, which is read again if it is needed; the end of what is let go."""
    start, end = -(-start // PAGESIZE) * PAGESIZE, end // PAGESIZE * PAGESIZE
    if isinstance(data, mmap) and end > start:
        data.madvise(MADV_DONTNEED, start, end - start)
    return max(start, end)
