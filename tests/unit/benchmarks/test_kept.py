"""The file that a benchmark writes row by row: what it has is found again, and it is replaced whole."""

from __future__ import annotations

import re
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from benchmarks import kept
from he3.errors import He3Error, InvalidInput


@contextmanager
def limited_file_size(size: int) -> Iterator[None]:
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))


def test_rows_are_found_again_with_what_else_the_file_has(tmp_path):
    file = tmp_path / "folder" / "rows.json"
    assert kept.read(file, "rows", "more") == {"rows": [], "more": []}
    document = {"rows": [{"seed": 1}], "more": [], "scenario": "t1"}
    kept.write(file, document)
    assert kept.read(file, "rows", "more") == document
    kept.write(None, document)
    assert kept.read(None, "rows") == {"rows": []}


@pytest.mark.parametrize("text", ["", "[]", '{"rows": 3}', '{"rows": [1]}', "{}", "\xff"])
def test_a_file_of_anything_else_is_refused_by_name(tmp_path, text):
    file = tmp_path / "rows.json"
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(InvalidInput, match=re.escape(f"{file}: expected a file of this benchmark, got ")):
        kept.read(file, "rows")


def test_a_link_and_a_device_are_refused_and_not_replaced(tmp_path):
    link = tmp_path / "rows.json"
    link.symlink_to(tmp_path / "other.json")
    for place in (link, Path("/dev/full")):
        with pytest.raises(InvalidInput, match=f"{place}: expected a plain file"):
            kept.read(place, "rows")


def test_a_disk_that_is_full_leaves_the_earlier_rows(tmp_path):
    file = tmp_path / "rows.json"
    kept.write(file, {"rows": [{"seed": 1}]})
    told = f"{file}: expected a file that can be written, got File too large; it has the earlier rows"
    with limited_file_size(20), pytest.raises(He3Error, match=re.escape(told)):
        kept.write(file, {"rows": [{"seed": k} for k in range(1000)]})
    assert kept.read(file, "rows") == {"rows": [{"seed": 1}]}
    assert [path.name for path in tmp_path.iterdir()] == ["rows.json"]
