"""Bytes from the state of a node and the state from bytes: a JSON head, then the contents of arrays and byte strings.

A state consists of named parts: plain values (None, bool, int, float, str, bytes), lists, tuples, sets, deques and
dicts of these, numpy arrays and scalars, topics of the table, and instances of the enums, frozen dataclasses and
messages that the codec was given. Anything else is refused, when it is encoded and when it is decoded: decoding runs no
code but the constructors of those types. A decoded state is equal to the encoded one, arrays to the byte, with their
layout and their write flag. An immutable object or an array that stood in several places is one object again.

    file    = MAGIC, length of the head (8 bytes, little endian), head, the blobs, one after the other
    head    = {"state": VALUE, "blobs": [BLOB, ...]}
    BLOB    = {"bytes": n}, and for an array {"bytes": n, "dtype", "shape", "order": "C" or "F", "writeable"}
    VALUE   = null, true, false, integer, finite number, text, [VALUE, ...] for a list, {name: VALUE, ...} for a dict
            | {"$float": "inf"}                        a number that JSON does not have
            | {"$tuple" | "$set" | "$frozenset" | "$deque": [VALUE, ...]}
            | {"$dict": [[VALUE, VALUE], ...]}         a dict whose keys are not plain names
            | {"$bytes" | "$array" | "$scalar": i}     the blob of that number
            | {"$topic": name} | {"$function": name}   a row of the table of topics; a function the codec was given
            | {"$enum": [type, member]} | {"$message": [type, JSON text]} | {"$data": [type, {field: VALUE, ...}]}
            | {"$same": i}                             the i-th tuple, dataclass or message to have been completed
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from he3.errors import InvalidInput
from schemas.topics import BY_NAME, Topic

MAGIC: Final = b"he3state1\n"
_LENGTH_BYTES: Final = 8
_NUMERIC: Final = frozenset("biufc")
"""Kinds of the arrays that are encoded: booleans and numbers, no objects."""


class _NotEncodable(Exception):
    """A value that the codec does not know, and the path to it, innermost last."""

    def __init__(self, value: object) -> None:
        super().__init__(type(value).__name__)
        self.path: list[str] = []


class StateCodec:
    """Encodes and decodes states made of the given types."""

    def __init__(self, types: Iterable[type] = (), functions: Mapping[str, Callable[..., Any]] | None = None) -> None:
        """types: enums, frozen dataclasses and messages. functions: those that a state may refer to, by name.

        Raises InvalidInput for another kind of type, or for two types of one name.
        """
        self._types: dict[str, type] = {}
        self._functions = dict(functions or {})
        for each in types:
            if not (issubclass(each, Enum | BaseModel) or _is_frozen(each)):
                raise InvalidInput(f"state: expected enums, frozen dataclasses and messages, got {each.__name__}")
            if self._types.setdefault(each.__name__, each) is not each:
                raise InvalidInput(f"state: expected one type named {each.__name__}, got two")

    def encode(self, state: object) -> bytes:
        """The state as bytes; raises InvalidInput, naming the place, for a value that is not of the codec's types."""
        encoder = _Encoder(self._types, self._functions)
        try:
            tree = encoder.tree(state)
        except _NotEncodable as error:
            raise InvalidInput(
                f"state: {'.'.join(error.path) or 'top'}: expected a plain value or a registered type, got {error}"
            ) from None
        head = json.dumps({"state": tree, "blobs": encoder.descriptions}, separators=(",", ":")).encode()
        return b"".join((MAGIC, len(head).to_bytes(_LENGTH_BYTES, "little"), head, *encoder.blobs))

    def decode(self, data: bytes) -> Any:
        """The state that was encoded; raises InvalidInput for bytes that are no state of the codec's types."""
        start = len(MAGIC) + _LENGTH_BYTES
        try:
            if not data.startswith(MAGIC):
                raise ValueError(f"begins with {data[: len(MAGIC)]!r}")
            end = start + int.from_bytes(data[len(MAGIC) : start], "little")
            head = json.loads(data[start:end])
            decoder = _Decoder(self._types, self._functions, _blobs(memoryview(data)[end:], head["blobs"]))
            return decoder.value(head["state"])
        except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError) as error:
            line = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InvalidInput(f"state: expected one that this program has encoded, got other bytes: {line}") from None


class _Encoder:
    """One encoding: the blobs so far, and the numbers of the objects completed."""

    def __init__(self, types: Mapping[str, type], functions: Mapping[str, Callable[..., Any]]) -> None:
        self._types = types
        self._functions = functions
        self.descriptions: list[dict[str, Any]] = []
        self.blobs: list[bytes] = []
        self._blob_of: dict[int, int] = {}
        self._completed: dict[int, int] = {}

    def tree(self, value: Any) -> Any:
        """The value as a tree of JSON values."""
        kind = type(value)
        if value is None or kind in (bool, int, str):
            return value
        if kind is float:
            return value if math.isfinite(value) else {"$float": repr(value)}
        if kind is list:
            return self._items(value)
        if kind is dict:
            return self._dict(value)
        if isinstance(value, bytes):  # a message that was passed on in this process, too
            return {"$bytes": self._blob(value, lambda: ({}, value))}
        if kind is np.ndarray:
            return {"$array": self._blob(value, lambda: _described(value))}
        if (number := self._completed.get(id(value))) is not None:
            return {"$same": number}
        return self._other(kind, value)

    def _other(self, kind: type, value: Any) -> Any:
        if kind is tuple:
            return self._complete(value, {"$tuple": self._items(value)})
        if kind is set or kind is frozenset:
            return {f"${kind.__name__}": self._items(sorted(value, key=repr))}
        if kind is deque:
            return {"$deque": self._items(value)}
        if isinstance(value, Topic) and BY_NAME.get(value.name) is value:
            return {"$topic": value.name}
        if self._types.get(kind.__name__) is kind:
            return self._registered(kind, value)
        if isinstance(value, np.generic):
            return {"$scalar": self._blob(value, lambda: _described(np.asarray(value)))}
        for name, function in self._functions.items():
            if function == value:
                return {"$function": name}
        raise _NotEncodable(value)

    def _registered(self, kind: type, value: Any) -> Any:
        if isinstance(value, Enum):
            return {"$enum": [kind.__name__, value.name]}
        if isinstance(value, BaseModel):
            # Fields that were never set stay so: they have their defaults again.
            text = value.model_dump_json(exclude_unset=True)
            return self._complete(value, {"$message": [kind.__name__, text]})
        kept = {each.name: self._at(each.name, getattr(value, each.name)) for each in _init_fields(kind)}
        return self._complete(value, {"$data": [kind.__name__, kept]})

    def _items(self, values: Iterable[Any]) -> list[Any]:
        return [self._at(str(number), value) for number, value in enumerate(values)]

    def _dict(self, value: dict[Any, Any]) -> Any:
        if all(type(key) is str and not key.startswith("$") for key in value):
            return {key: self._at(key, part) for key, part in value.items()}
        return {"$dict": [[self._at("key", key), self._at(str(key), part)] for key, part in value.items()]}

    def _at(self, name: str, value: Any) -> Any:
        try:
            return self.tree(value)
        except _NotEncodable as error:
            error.path.insert(0, name)
            raise

    def _complete(self, value: object, tree: Any) -> Any:
        self._completed[id(value)] = len(self._completed)
        return tree

    def _blob(self, value: object, described: Callable[[], tuple[dict[str, Any], bytes]]) -> int:
        number = self._blob_of.get(id(value))
        if number is None:
            description, content = described()
            number = self._blob_of[id(value)] = len(self.blobs)
            self.descriptions.append({"bytes": len(content), **description})
            self.blobs.append(content)
        return number


class _Decoder:
    """One decoding: the blobs, and the objects completed so far."""

    def __init__(
        self,
        types: Mapping[str, type],
        functions: Mapping[str, Callable[..., Any]],
        blobs: list[bytes | NDArray[Any]],
    ) -> None:
        self._types = types
        self._functions = functions
        self._blobs = blobs
        self._completed: list[Any] = []

    def value(self, tree: Any) -> Any:
        """The value that the tree stands for."""
        if isinstance(tree, list):
            return [self.value(item) for item in tree]
        if not isinstance(tree, dict):
            return tree
        if len(tree) == 1:
            ((tag, content),) = tree.items()
            if tag.startswith("$"):
                return self._tagged(tag, content)
        return {key: self.value(part) for key, part in tree.items()}

    def _tagged(self, tag: str, content: Any) -> Any:
        match tag:
            case "$float":
                return float(content)
            case "$tuple":
                return self._complete(tuple([self.value(item) for item in content]))
            case "$set":
                return {self.value(item) for item in content}
            case "$frozenset":
                return frozenset([self.value(item) for item in content])
            case "$deque":
                return deque(self.value(item) for item in content)
            case "$dict":
                return {self.value(key): self.value(part) for key, part in content}
            case "$bytes" | "$array":
                return self._blobs[content]
            case "$scalar":
                return self._blobs[content][()]
            case "$topic":
                return BY_NAME[content]
            case "$function":
                return self._functions[content]
            case "$same":
                return self._completed[content]
            case "$enum":
                return self._type(content[0], Enum)[content[1]]
            case "$message":
                return self._complete(self._type(content[0], BaseModel).model_validate_json(content[1]))
            case "$data":
                kind = self._type(content[0], object)
                return self._complete(kind(**{name: self.value(part) for name, part in content[1].items()}))
        raise ValueError(f"tag {tag!r}")

    def _type(self, name: str, base: type) -> Any:
        kind = self._types[name]
        if not issubclass(kind, base):
            raise ValueError(f"{name} is no {base.__name__}")
        return kind

    def _complete(self, value: Any) -> Any:
        self._completed.append(value)
        return value


def _is_frozen(kind: type) -> bool:
    return dataclasses.is_dataclass(kind) and kind.__dataclass_params__.frozen  # type: ignore[attr-defined]


def _init_fields(kind: type) -> list[dataclasses.Field[Any]]:
    """The fields that the constructor takes; it derives the others from them."""
    return [each for each in dataclasses.fields(kind) if each.init]


def _described(array: NDArray[Any]) -> tuple[dict[str, Any], bytes]:
    if array.dtype.kind not in _NUMERIC:
        raise _NotEncodable(array)
    order: Literal["C", "F"] = "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"
    description = {
        "dtype": array.dtype.str,
        "shape": list(array.shape),
        "order": order,
        "writeable": bool(array.flags.writeable),
    }
    return description, array.tobytes(order=order)


def _blobs(content: memoryview, descriptions: list[dict[str, Any]]) -> list[bytes | NDArray[Any]]:
    """Byte strings and arrays, each in memory of its own; raises ValueError where lengths do not fit."""
    found: list[bytes | NDArray[Any]] = []
    begin = 0
    for description in descriptions:
        end = begin + description["bytes"]
        if end > len(content):
            raise ValueError(f"{end} bytes of arrays are announced, {len(content)} are there")
        part = bytes(content[begin:end])
        found.append(_array(part, description) if "dtype" in description else part)
        begin = end
    if begin != len(content):
        raise ValueError(f"{len(content) - begin} bytes too many")
    return found


def _array(part: bytes, description: dict[str, Any]) -> NDArray[Any]:
    dtype = np.dtype(description["dtype"])
    if dtype.kind not in _NUMERIC:
        raise ValueError(f"array of {dtype}")
    flat = np.frombuffer(part, dtype)
    array = flat.reshape(description["shape"], order=description["order"]).copy(order="K")
    array.setflags(write=description["writeable"])
    return array
