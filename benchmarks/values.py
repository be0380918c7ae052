"""The arguments and results of a benchmark's tasks as JSON, and back: dataclasses, enums, arrays, paths, tuples.

A campaign's tasks and rows are JSON. What JSON does not have is a dict of one entry, whose name begins with `~`. A type
is given as ``module:name``, and only dataclasses and enums are made of it.
"""

from __future__ import annotations

import base64
import math
import sys
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from he3.errors import InvalidInput


def encoded(value: Any) -> Any:
    """The value as JSON; raises InvalidInput for one of a type that is not known here."""
    if isinstance(value, Enum):  # first: a member may be a text or a number, too
        return {"~enum": [_name(type(value)), value.name]}
    if value is None or isinstance(value, (bool, str)) or (type(value) in (int, float) and math.isfinite(value)):
        return value
    if isinstance(value, np.generic):
        return encoded(value.item())
    if isinstance(value, float):
        return {"~float": repr(value)}
    if isinstance(value, list):
        return [encoded(each) for each in value]
    if isinstance(value, (tuple, range)):
        return {"~tuple": [encoded(each) for each in value]}
    if isinstance(value, Mapping):
        return {"~dict": [[encoded(key), encoded(each)] for key, each in value.items()]}
    if isinstance(value, Path):
        return {"~path": str(value)}
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        content = np.ascontiguousarray(value)
        return {"~array": [content.dtype.str, list(content.shape), base64.b64encode(content.tobytes()).decode()]}
    if is_dataclass(value) and not isinstance(value, type):
        inside = {each.name: encoded(getattr(value, each.name)) for each in fields(value) if each.init}
        return {"~data": [_name(type(value)), inside]}
    if isinstance(value, partial):
        return {"~partial": [_name(value.func), encoded(value.args), encoded(value.keywords)]}
    if callable(value):
        return {"~function": _name(value)}
    raise InvalidInput(f"expected a value that a task can have, got {type(value).__name__}")


def decoded(value: Any) -> Any:
    """The value of that JSON; raises InvalidInput for JSON that `encoded` does not make."""
    if isinstance(value, list):
        return [decoded(each) for each in value]
    if not isinstance(value, dict):
        return value
    ((kind, content),) = value.items()
    match kind:
        case "~float":
            return float(content)
        case "~tuple":
            return tuple(decoded(each) for each in content)
        case "~dict":
            return {decoded(key): decoded(each) for key, each in content}
        case "~path":
            return Path(content)
        case "~array":
            dtype, shape, data = content
            return np.frombuffer(base64.b64decode(data), dtype=np.dtype(dtype)).reshape(shape).copy()
        case "~enum":
            return _found(content[0], Enum)[content[1]]
        case "~data":
            return _found(content[0])(**{name: decoded(each) for name, each in content[1].items()})
        case "~function":
            return _found(content)
        case "~partial":
            return partial(_found(content[0]), *decoded(content[1]), **decoded(content[2]))
    raise InvalidInput(f"expected a task's value, got {kind!r}")


def _name(of: Any) -> str:
    if "." in of.__qualname__:
        raise InvalidInput(f"expected a function or type of a module, got {of.__qualname__}")
    module = of.__module__
    if module == "__main__":  # a benchmark that was started as a module
        module = getattr(sys.modules[module].__spec__, "name", module)
    return f"{module}:{of.__qualname__}"


def _found(name: str, base: type | None = None) -> Any:
    module, _, attribute = name.partition(":")
    found = getattr(import_module(module), attribute)
    if base is not None and not (isinstance(found, type) and issubclass(found, base)):
        raise InvalidInput(f"expected a {base.__name__}, got {name}")
    return found
