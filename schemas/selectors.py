"""Requests from the parameters of a selector, such as ``x=120;y=340``: how any Zenoh client asks without a body."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from pydantic import ValidationError

from schemas.wire import Refused, Wire, one_line

Request = TypeVar("Request", bound=Wire)


def request_from_parameters(model: type[Request], parameters: Mapping[str, str]) -> Request:
    """The request that the parameters spell; raises Refused with one line that names the parameter.

    Numbers are decimal, flags ``true`` or ``false``; nothing unknown, nothing missing, no NaN or infinity.
    """
    known = model.model_fields
    for name, text in parameters.items():
        if name not in known:
            expected = ", ".join(known) or "no parameters"
            raise Refused(f"selector: expected {expected}, got '{name[:40]}'")
        if not text:
            raise Refused(f"selector: {name}: expected a value, got nothing")
    try:
        return model.model_validate_strings(dict(parameters), strict=True)
    except ValidationError as error:
        raise Refused(f"selector: {one_line(error)}") from None
