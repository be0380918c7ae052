"""Reading of plain GeoTIFF layers without GDAL: one band, strips or tiles, uncompressed or deflate, classic or BigTIFF.

With it the core reads the folders that `he3 region build` writes, without an extra. It also computes where the blocks
of a raster lie in its file, so that a download takes only the blocks of a window.
Source of the format: TIFF 6.0 (Adobe, 1992), BigTIFF (the libtiff specification of 2011).
"""

from __future__ import annotations

import math
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from html import unescape
from io import SEEK_END
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray

from he3.errors import InvalidInput

ReadAt = Callable[[int, int], bytes]
"""(offset, length) -> bytes of a file."""

_WIDTH, _LENGTH, _BITS, _COMPRESSION, _SAMPLES, _PREDICTOR, _FORMAT = 256, 257, 258, 259, 277, 317, 339
_STRIPS, _ROWS_PER_STRIP, _STRIP_BYTES = 273, 278, 279
_TILE_WIDTH, _TILE_LENGTH, _TILES, _TILE_BYTES = 322, 323, 324, 325
_NO_DATA: Final = 42113  # text, GDAL's
_METADATA: Final = 42112  # XML, GDAL's
_SUBFILE, _IS_MASK = 254, 4
_PIXEL_SCALE, _TIE_POINT, _MATRIX, _GEO_KEYS, _RASTER_TYPE, _IS_POINT = 33550, 33922, 34264, 34735, 1025, 2
_MODEL_TYPE, _IS_GEOGRAPHIC = 1024, 2
_MAX_DIRECTORIES: Final = 64  # of overviews and masks
_KINDS: Final = {1: "B", 2: "B", 3: "H", 4: "I", 5: "Q", 7: "B", 11: "f", 12: "d", 13: "I", 16: "Q", 17: "q", 18: "Q"}
_DTYPES: Final = {
    (1, 8): "u1",
    (1, 16): "u2",
    (1, 32): "u4",
    (2, 16): "i2",
    (2, 32): "i4",
    (3, 32): "f4",
    (3, 64): "f8",
}
_MAX_VALUES: Final = 50_000_000  # of a tag: blocks of the largest lunar mosaic, with a margin
_MAX_PIXELS: Final = 100_000_000


@dataclass(frozen=True, slots=True)
class Block:
    """A strip or tile: its first row and column, its shape, and the position of its bytes in the file."""

    row: int
    column: int
    rows: int
    columns: int
    offset: int
    length: int


@dataclass(frozen=True, slots=True, eq=False)
class TiffLayout:
    """The layout in the first directory of a TIFF file."""

    rows: int
    columns: int
    dtype: str
    compression: int
    predictor: int
    block_rows: int
    block_columns: int
    offsets: NDArray[np.int64]
    lengths: NDArray[np.int64]
    little_endian: bool

    def blocks(self, row: int, column: int, rows: int, columns: int) -> Iterator[Block]:
        """The blocks of the window that begins at (row, column)."""
        across = -(-self.columns // self.block_columns)
        for down in range(row // self.block_rows, -(-(row + rows) // self.block_rows)):
            for right in range(column // self.block_columns, -(-(column + columns) // self.block_columns)):
                index = down * across + right
                top, left = down * self.block_rows, right * self.block_columns
                tiled = self.block_columns != self.columns
                height = self.block_rows if tiled else min(self.block_rows, self.rows - top)
                where = int(self.offsets[index]), int(self.lengths[index])
                yield Block(top, left, height, self.block_columns, *where)


class NotPlain(Exception):
    """The file is a TIFF of a kind that this reader does not support."""


def _within(stream: IO[bytes]) -> ReadAt:
    """Reads bytes of that file; of a place or a length beyond its end, what there is, and no memory is taken for it."""
    size = stream.seek(0, SEEK_END)

    def read_at(offset: int, length: int) -> bytes:
        if not 0 <= offset < size or length <= 0:
            return b""
        stream.seek(offset)
        return stream.read(min(length, size - offset))

    return read_at


def read_tiff(path: Path) -> NDArray[Any]:
    """The raster of a plain TIFF file, (rows, columns), row 0 as in the file.

    Raises NotPlain for a TIFF of another kind, InvalidInput for a file that is no TIFF.
    """
    try:
        with path.open("rb") as stream:
            read_at = _within(stream)
            layout = tiff_layout(read_at, str(path))
            return _read_blocks(layout, read_at, str(path))
    except OSError as error:
        raise InvalidInput(f"{path}: cannot read the raster: {error.strerror}") from None


@dataclass(frozen=True, slots=True)
class TiffFacts:
    """What a TIFF file says of its raster beside the values."""

    no_data: float | None
    """The number that marks missing values, by GDAL's tag."""
    masked: bool
    """Whether a mask, in the file or beside it, hides pixels."""
    place: tuple[float, float, float, float] | None
    """(x, y) of the outer north-west corner, width and height of a pixel, in the raster's projection; None without."""
    degrees: bool
    """Whether that place is in degrees of longitude and latitude."""
    scale: float
    """Value = number * scale + offset."""
    offset: float
    unit: str
    """Unit of the values; empty where the file does not say it."""


def facts_of(path: Path) -> TiffFacts:
    """What that TIFF file says of its raster; raises InvalidInput for a file that is no TIFF."""
    try:
        with path.open("rb") as stream:
            read_at = _within(stream)
            directories = [tags for tags, _ in _directories(read_at)]
    except OSError as error:
        raise InvalidInput(f"{path}: cannot read the raster: {error.strerror}") from None
    except (struct.error, IndexError, KeyError, ValueError):
        raise InvalidInput(f"{path}: expected a TIFF file, got other or damaged bytes") from None
    masked = any(int(tags.get(_SUBFILE, (0,))[0]) & _IS_MASK for tags in directories)
    try:
        no_data = float(bytes(directories[0][_NO_DATA]).split(b"\0")[0])
    except (KeyError, ValueError):
        no_data = None
    said = _metadata(directories[0])
    return TiffFacts(
        no_data, masked or path.with_name(f"{path.name}.msk").exists(), _place(directories[0]),
        any(key[0] == _MODEL_TYPE and key[3] == _IS_GEOGRAPHIC for key in _geo_keys(directories[0])),
        _number(said.get("scale"), 1.0), _number(said.get("offset"), 0.0), said.get("unittype", ""),
    )  # fmt: skip


def _metadata(tags: dict[int, Any]) -> dict[str, str]:
    """What GDAL says of the first band, by role: scale, offset, unittype, description."""
    text = bytes(tags.get(_METADATA, b"")).split(b"\0")[0].decode("utf-8", "replace")
    items = re.finditer(r'<Item name="[^"]*" sample="0" role="(\w+)">([^<]*)</Item>', text)
    return {item.group(1): unescape(item.group(2)) for item in items}


def _number(text: str | None, default: float) -> float:
    try:
        return default if text is None else float(text)
    except ValueError:
        return math.nan


def _geo_keys(tags: dict[int, Any]) -> NDArray[np.int64]:
    """The GeoKeys (n, 4), without the head of their directory."""
    keys = np.asarray(tags.get(_GEO_KEYS, ()), dtype=np.int64)
    return keys[: len(keys) // 4 * 4].reshape(-1, 4)[1:]


def _place(tags: dict[int, Any]) -> tuple[float, float, float, float] | None:
    """The place of a raster with a scale and one tie point, or a matrix (GeoTIFF 1.1, OGC 19-008r4, section 7.3).

    Where row 0 is in the south, the height of a pixel is negative; NaN where the raster is rotated.
    """
    if len(tags.get(_MATRIX, ())) == 16:
        a, b, _, west, d, e, _, north = (float(each) for each in tags[_MATRIX][:8])
        return (west, north, a, -e) if b == d == 0.0 else (west, north, math.nan, math.nan)
    if len(tags.get(_PIXEL_SCALE, ())) < 2 or len(tags.get(_TIE_POINT, ())) != 6:
        return None
    width, height = (float(each) for each in tags[_PIXEL_SCALE][:2])
    column, row, _, x, y, _ = (float(each) for each in tags[_TIE_POINT])
    if any(
        key[0] == _RASTER_TYPE and key[3] == _IS_POINT for key in _geo_keys(tags)
    ):  # the tie point is a pixel's centre
        column, row = column + 0.5, row + 0.5
    return x - column * width, y + row * height, width, height


def tiff_layout(read_at: ReadAt, name: str) -> TiffLayout:
    """The layout of the first raster in a TIFF file; raises InvalidInput if it is damaged or no TIFF file."""
    try:
        tags, little = _tags(read_at)
    except (struct.error, IndexError, KeyError, ValueError):
        raise InvalidInput(f"{name}: expected a TIFF file, got other or damaged bytes") from None
    try:
        rows, columns = int(tags[_LENGTH][0]), int(tags[_WIDTH][0])
        bits, form = int(tags[_BITS][0]), int(tags.get(_FORMAT, (1,))[0])
        tiled = _TILES in tags
        offsets, lengths = (_TILES, _TILE_BYTES) if tiled else (_STRIPS, _STRIP_BYTES)
        block = (
            (int(tags[_TILE_LENGTH][0]), int(tags[_TILE_WIDTH][0]))
            if tiled
            else (min(rows, int(tags.get(_ROWS_PER_STRIP, (rows,))[0])), columns)
        )
        if min(rows, columns, *block) < 1:
            raise InvalidInput(f"{name}: expected a raster with rows and columns, got {rows} x {columns}")
        if int(tags.get(_SAMPLES, (1,))[0]) != 1 or (form, bits) not in _DTYPES:
            raise NotPlain(f"{name}: several bands, or values of {bits} bits in format {form}")
        layout = TiffLayout(
            rows, columns, _DTYPES[form, bits], int(tags.get(_COMPRESSION, (1,))[0]),
            int(tags.get(_PREDICTOR, (1,))[0]), *block,
            np.asarray(tags[offsets], dtype=np.int64), np.asarray(tags[lengths], dtype=np.int64), little,
        )  # fmt: skip
    except KeyError as error:
        raise InvalidInput(f"{name}: expected a TIFF file with tag {error}, got none") from None
    blocks = -(-rows // block[0]) * -(-columns // block[1])
    if layout.offsets.size != blocks or layout.lengths.size != blocks:
        raise InvalidInput(f"{name}: expected {blocks} blocks, got {layout.offsets.size}")
    return layout


def _tags(read_at: ReadAt) -> tuple[dict[int, Any], bool]:
    """Tag -> values of the first directory, and whether numbers are little-endian."""
    return next(_directories(read_at))


def _directories(read_at: ReadAt) -> Iterator[tuple[dict[int, Any], bool]]:
    """Tag -> values of each directory, in the order of the file, and whether numbers are little-endian."""
    head = read_at(0, 16)
    order = {b"II": "<", b"MM": ">"}[head[:2]]
    (magic,) = struct.unpack(order + "H", head[2:4])
    if magic == 42:
        (start,) = struct.unpack(order + "I", head[4:8])
        count_kind, entry, inline = "H", 12, 4
    elif magic == 43:
        (start,) = struct.unpack(order + "Q", head[8:16])
        count_kind, entry, inline = "Q", 20, 8
    else:
        raise ValueError(magic)
    size = struct.calcsize(order + count_kind)
    for _ in range(_MAX_DIRECTORIES):
        (count,) = struct.unpack(order + count_kind, read_at(start, size))
        if count > 4096:
            raise ValueError(count)
        directory = read_at(start + size, count * entry)
        tags: dict[int, Any] = {}
        for index in range(count):
            field = directory[index * entry : (index + 1) * entry]
            tag, kind = struct.unpack(order + "HH", field[:4])
            (values,) = struct.unpack(order + ("I" if inline == 4 else "Q"), field[4 : entry - inline])
            if kind not in _KINDS or values == 0:  # a tag without a value says nothing
                continue
            if values > _MAX_VALUES:
                raise ValueError(values)
            dtype = np.dtype(order + _KINDS[kind].replace("B", "u1").replace("H", "u2").replace("I", "u4")
                             .replace("Q", "u8").replace("q", "i8").replace("f", "f4").replace("d", "f8"))  # fmt: skip
            length = int(values) * dtype.itemsize
            data = field[entry - inline :]
            if length > inline:
                (offset,) = struct.unpack(order + ("I" if inline == 4 else "Q"), data)
                data = read_at(offset, length)
            if len(data) < length:
                raise ValueError(length)
            tags[tag] = np.frombuffer(data[:length], dtype=dtype)
        yield tags, order == "<"
        (start,) = struct.unpack(order + ("I" if inline == 4 else "Q"), read_at(start + size + count * entry, inline))
        if start == 0:
            return


def _read_blocks(layout: TiffLayout, read_at: ReadAt, name: str) -> NDArray[Any]:
    if layout.compression not in (1, 8, 32946) or layout.predictor != 1:
        raise NotPlain(f"{name}: compression {layout.compression}, predictor {layout.predictor}")
    for rows, columns in ((layout.rows, layout.columns), (layout.block_rows, layout.block_columns)):
        if rows * columns > _MAX_PIXELS:
            raise InvalidInput(f"{name}: expected at most {_MAX_PIXELS} pixels, got {rows} x {columns}")
    dtype = np.dtype(("<" if layout.little_endian else ">") + layout.dtype)
    raster = np.zeros((layout.rows, layout.columns), dtype=dtype.newbyteorder("="))
    for block in layout.blocks(0, 0, layout.rows, layout.columns):
        wanted = block.rows * block.columns * dtype.itemsize
        # Deflate makes no block much longer than its values; a block that says it has the whole file would be slow.
        data = read_at(block.offset, min(block.length, wanted + wanted // 100 + 1024))
        if layout.compression != 1:
            try:
                data = zlib.decompressobj().decompress(data, wanted)
            except zlib.error as error:
                raise InvalidInput(f"{name}: expected deflate blocks, got damaged bytes: {error}") from None
        if len(data) < wanted:
            raise InvalidInput(f"{name}: expected {wanted} bytes in a block, got {len(data)}: the file is cut off")
        values = np.frombuffer(data[:wanted], dtype=dtype).reshape(block.rows, block.columns)
        part = raster[block.row : block.row + block.rows, block.column : block.column + block.columns]
        part[...] = values[: part.shape[0], : part.shape[1]]
    return raster
