"""TOML files that another person may have written: parsed within bounds, and without text that steers a terminal."""

from __future__ import annotations

import re
import tomllib
from typing import TYPE_CHECKING, Any, Final

from he3.errors import InvalidInput

if TYPE_CHECKING:
    from pathlib import Path

MAX_DEPTH: Final = 32
"""Tables and arrays within one another; ours have five."""
MAX_PLACE: Final = 80
"""Characters of the place that an error's line names."""
STEERING: Final = r"\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069"
"""Characters on which a terminal acts, and those that change the direction of what follows, for a class of `re`."""
_STEERS: Final = re.compile(rf"(?![\x00\n\r\t])[{STEERING}]")


def parsed_toml(content: bytes, path: Path) -> dict[str, Any]:
    """The document of that content. Raises InvalidInput, in one line that begins with `path`, for anything else."""
    try:
        # Some editors write a byte order mark before UTF-8 text, where it has no meaning.
        document = tomllib.loads(content.decode("utf-8-sig").replace("\r\n", "\n"))
    except UnicodeDecodeError:
        raise InvalidInput(f"{path}: expected UTF-8 text, got other bytes") from None
    except (ValueError, RecursionError) as error:  # also for a number of thousands of digits
        raise InvalidInput(f"{path}: expected TOML, got a syntax error: {error}") from None
    _expect_plain(document, path)
    return document


def _expect_plain(document: dict[str, Any], path: Path) -> None:
    """Raise InvalidInput for a document that is too deep, and for a text that would steer a terminal."""
    waiting: list[tuple[str, int, Any]] = [("", 0, document)]
    while waiting:
        place, depth, value = waiting.pop()
        if depth > MAX_DEPTH:
            raise InvalidInput(f"{path}: expected at most {MAX_DEPTH} tables within one another, got more")
        if isinstance(value, dict):
            waiting += [(f"{place}.{key}".lstrip(".")[:MAX_PLACE], depth + 1, part) for key, part in value.items()]
            waiting += [("a key", depth + 1, key) for key in value]
        elif isinstance(value, list):
            waiting += [(place, depth + 1, part) for part in value]
        elif isinstance(value, str) and (found := _STEERS.search(value)) is not None:
            raise InvalidInput(f"{path}: {place}: expected printable text, got {found[0]!a} in it")
