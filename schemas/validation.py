"""What a validation of pydantic found wrong, on one line for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

from schemas.wire import printable

if TYPE_CHECKING:
    from pydantic import ValidationError

MAX_PLACE = 120
MAX_SHOWN = 60
"""Most characters of a refusal's line for the place in a document, and for the value there."""


def one_line(error: ValidationError) -> str:
    """The first error of a validation on one line: 'WHERE: expected ..., got ...'; one of the whole has no WHERE."""
    found = error.errors(include_url=False, include_context=False)
    # A default that follows from a value that is wrong is no fault of its own.
    faults = [each for each in found if each["type"] != "default_factory_not_called"] or found
    first = faults[0]
    place = _clipped(printable(".".join(str(part) for part in first["loc"])), MAX_PLACE)
    message = first["msg"].splitlines()[0].removeprefix("Value error, ")
    # A rule over several values says itself what came; the whole table behind it would hide that.
    says_it = first["type"] in {"missing", "json_invalid"} or (first["type"] == "value_error" and ", got " in message)
    shown = "" if says_it else f", got {_short(first.get('input'))}"
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return f"{f'{place}: ' if place else ''}{printable(message[0].lower() + message[1:])}{shown}{more}"


def _short(value: object) -> str:
    return _clipped(printable(repr(value)), MAX_SHOWN)


def _clipped(text: str, limit: int) -> str:
    return text if len(text) <= limit else text[: limit - 3] + "..."
