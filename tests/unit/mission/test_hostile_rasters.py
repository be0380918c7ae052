"""A GeoTIFF of which another person has written each byte is a raster or one line, and takes little memory."""

from __future__ import annotations

import struct
import zlib
from contextlib import suppress
from pathlib import Path
from tempfile import NamedTemporaryFile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from he3.errors import InvalidInput
from services.mission.tiff import NotPlain, facts_of, read_tiff

ROWS, COLUMNS = 4, 6
VALUES = np.arange(ROWS * COLUMNS, dtype="<u2").reshape(ROWS, COLUMNS)
WIDTH, LENGTH, BITS, COMPRESSION, OFFSETS, ROWS_PER_STRIP, BYTES = 256, 257, 258, 259, 273, 278, 279
SHORT, LONG, LONG8 = 3, 4, 16


def tiff(*, deflate: bool = False, big: bool = False, changes: dict[int, tuple[int, int, int]] | None = None) -> bytes:
    """A TIFF of one strip. big: with offsets of eight bytes. changes: kind, count and value of a tag, by its number."""
    data = VALUES.tobytes()
    data = zlib.compress(data) if deflate else data
    start = 16 if big else 8
    tags = {
        WIDTH: (SHORT, 1, COLUMNS), LENGTH: (SHORT, 1, ROWS), BITS: (SHORT, 1, 16),
        COMPRESSION: (SHORT, 1, 8 if deflate else 1), OFFSETS: (LONG, 1, start), ROWS_PER_STRIP: (SHORT, 1, ROWS),
        BYTES: (LONG, 1, len(data)), **(changes or {}),
    }  # fmt: skip
    directory = start + len(data)
    head = struct.pack("<2sHHHQ", b"II", 43, 8, 0, directory) if big else struct.pack("<2sHI", b"II", 42, directory)
    entry = "<HHQQ" if big else "<HHII"
    entries = b"".join(struct.pack(entry, tag, *field) for tag, field in sorted(tags.items()))
    count, end = (struct.pack("<Q", len(tags)), bytes(8)) if big else (struct.pack("<H", len(tags)), bytes(4))
    return head + data + count + entries + end


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("deflate", [False, True])
def test_a_plain_one_is_read(deflate: bool, big: bool, tmp_path: Path) -> None:
    (tmp_path / "a.tif").write_bytes(tiff(deflate=deflate, big=big))
    np.testing.assert_array_equal(read_tiff(tmp_path / "a.tif"), VALUES)


@pytest.mark.parametrize(
    "changes",
    [
        {COMPRESSION: (SHORT, 0, 0)},
        {BITS: (SHORT, 0, 0)},
        {OFFSETS: (LONG8, 1, 2**64 - 1), BYTES: (LONG8, 1, 2**63)},
        {BYTES: (LONG8, 1, 2**62)},
        {OFFSETS: (LONG8, 2**62, 8)},
        {LENGTH: (LONG, 1, 2**32 - 1), ROWS_PER_STRIP: (LONG, 1, 2**32 - 1)},
        {WIDTH: (LONG, 1, 2**32 - 1), LENGTH: (LONG, 1, 2**32 - 1), ROWS_PER_STRIP: (LONG, 1, 2**32 - 1)},
    ],
)
def test_tags_without_values_and_sizes_beyond_the_file_are_no_defect(
    changes: dict[int, tuple[int, int, int]], tmp_path: Path
) -> None:
    for deflate in (False, True):
        (tmp_path / "a.tif").write_bytes(tiff(big=True, deflate=deflate, changes=changes))
        for read in (read_tiff, facts_of):
            with suppress(InvalidInput, NotPlain):
                found = read(tmp_path / "a.tif")
                assert read is facts_of or np.array_equal(found, VALUES)  # type: ignore[arg-type]


@settings(deadline=None)
@given(st.booleans(), st.booleans(), st.data())
def test_no_change_of_its_bytes_is_a_defect(deflate: bool, big: bool, data: st.DataObject) -> None:
    content = bytearray(tiff(deflate=deflate, big=big))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at : at + 4] = data.draw(st.sampled_from([b"\xff" * 4, bytes(4), b"\xff", b"\x01\x00", b""]))
    with NamedTemporaryFile(suffix=".tif") as file:
        file.write(content)
        file.flush()
        for read in (read_tiff, facts_of):
            with suppress(InvalidInput, NotPlain):
                read(Path(file.name))
