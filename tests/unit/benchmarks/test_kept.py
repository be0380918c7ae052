"""The file that a benchmark writes row by row: what it has is found again, and it is replaced whole."""

from __future__ import annotations

import json
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


def test_what_is_written_at_the_end_may_go_to_a_device_or_a_folder_that_is_not_there_yet(tmp_path):
    file = tmp_path / "folder" / "rows.json"
    kept.write_whole(str(file), [{"seed": 1}])
    assert json.loads(file.read_text()) == [{"seed": 1}]
    kept.write_whole(Path("/dev/null"), [])
    kept.write_whole(None, [])


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has a device that is always full")
def test_a_disk_that_is_full_at_the_end_is_told_with_the_name_of_the_file():
    with pytest.raises(He3Error, match=r"^/dev/full: expected a file that can be written, got No space left"):
        kept.write_whole(Path("/dev/full"), [{"seed": 1}])


WRITES = re.compile(r"\.write_text\(\s*json|json(_format)?\.dump\(")


def test_no_benchmark_writes_its_results_but_through_this_module():
    """A full disk would be told without the name of the file."""
    folder = Path(kept.__file__).parent
    found = [path.name for path in folder.glob("*.py") if WRITES.search(path.read_text(encoding="utf-8"))]
    assert [name for name in found if name != "kept.py"] == []
