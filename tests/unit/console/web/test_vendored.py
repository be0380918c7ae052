"""Libraries that the page brings along are those that the documentation names, unchanged."""

from __future__ import annotations

import hashlib
from pathlib import Path

ROOT = Path(__file__).parents[4]
VENDOR = ROOT / "services" / "console" / "web" / "static" / "vendor"


def test_every_vendored_file_has_its_checksum_in_the_documentation_and_its_licence_beside_it() -> None:
    page = (ROOT / "docs" / "operations.md").read_text()
    files = [path for path in VENDOR.rglob("*") if path.is_file() and path.name != "LICENSE"]
    assert files
    for path in files:
        assert f"| `{path.name}` | `{hashlib.sha256(path.read_bytes()).hexdigest()}` |" in page
        assert (path.parent / "LICENSE").is_file()
