"""The state codec: every value is decoded unchanged, and only registered types are decoded."""

from __future__ import annotations

import json
import math
import pickle
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from he3.errors import InvalidInput
from schemas.link import LinkChange
from schemas.topics import BY_NAME, SAMPLE, Topic, addressed
from schemas.wire import Header
from services.runtime.state_codec import MAGIC, StateCodec


class Colour(Enum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True, slots=True)
class Pair:
    left: Any
    right: Any = None
    total: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "total", 7)


@dataclass
class Mutable:
    value: int = 0


def double(value: int) -> int:
    return 2 * value


CODEC = StateCodec([Colour, Pair, Header, LinkChange], {"double": double})


def again(state: Any) -> Any:
    return CODEC.decode(CODEC.encode(state))


plain = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text() | st.binary()
keys = st.text() | st.integers() | st.none() | st.sampled_from(Colour) | st.tuples(st.text(), st.integers())
states = st.recursive(
    plain | st.sampled_from(Colour) | st.sampled_from([*BY_NAME.values()]),
    lambda inner: (
        st.lists(inner)
        | st.lists(inner).map(tuple)
        | st.lists(inner).map(deque)
        | st.dictionaries(keys, inner)
        | st.builds(Pair, inner, inner)
        | st.sets(keys)
        | st.frozensets(keys)
    ),
    max_leaves=30,
)


def alike(a: Any, b: Any) -> bool:
    """Equal and of equal types, all the way down: 1, 1.0 and True are three different values."""
    if type(a) is not type(b) or a != b:
        return False
    if isinstance(a, dict):
        return [*map(type, a)] == [*map(type, b)] and all(
            alike(*pair) for pair in zip(a.values(), b.values(), strict=True)
        )
    if isinstance(a, list | tuple | deque):
        return all(alike(*pair) for pair in zip(a, b, strict=True))
    if isinstance(a, Pair):
        return alike(a.left, b.left) and alike(a.right, b.right)
    return repr(a) == repr(b) or isinstance(a, set | frozenset)


@given(states)
def test_every_value_comes_back_equal_and_of_its_type(state: Any) -> None:
    assert alike(again(state), state)


@given(states)
def test_equal_states_are_encoded_to_equal_bytes(state: Any) -> None:
    assert CODEC.encode(again(state)) == CODEC.encode(state)


@pytest.mark.parametrize("number", [math.inf, -math.inf, math.nan, -0.0, 5e-324, 0.1, 1e300])
def test_a_number_comes_back_to_the_bit(number: float) -> None:
    assert np.float64(again([number])[0]).tobytes() == np.float64(number).tobytes()


@pytest.mark.parametrize("dtype", ["?", "u1", "<i8", ">i4", "<f4", "<f8", "<c16"])
@pytest.mark.parametrize("shape", [(), (0,), (7,), (3, 5), (2, 0, 3)])
@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("writeable", [True, False])
def test_an_array_comes_back_to_the_byte_with_its_layout_and_its_write_flag(
    dtype: str, shape: tuple[int, ...], order: Any, writeable: bool
) -> None:
    array = np.asarray(np.random.default_rng(1).normal(size=shape) * 100).astype(dtype, order=order)
    array.setflags(write=writeable)
    (back,) = again((array,))

    assert (back.dtype, back.shape, back.tobytes("A")) == (array.dtype, array.shape, array.tobytes("A"))
    assert back.flags.f_contiguous == array.flags.f_contiguous
    assert back.flags.writeable == writeable
    assert back.flags.aligned


def test_numpy_scalars_stay_numpy_scalars() -> None:
    for scalar in (np.float32(0.1), np.float64(0.1), np.int64(-3), np.bool_(True)):
        (back,) = again([scalar])
        assert (type(back), back) == (type(scalar), scalar)


def test_an_object_that_stood_in_two_places_is_one_object_again() -> None:
    array, row = np.arange(3.0), (1.5, 2.5)
    pair, header = Pair(array, row), Header(mission="m", source="rover", incarnation=1, sequence=2, made_at=3)
    state = {"a": [pair, array, header], "b": {"c": (pair, row, header)}}
    back = again(state)

    first, again_array, again_header = back["a"]
    second, again_row, header_too = back["b"]["c"]
    assert first is second
    assert first.left is again_array
    assert first.right is again_row
    assert again_header is header_too
    assert len(CODEC.encode([array] * 10)) < len(CODEC.encode([array])) + 200


def test_a_set_of_tuples_does_not_confuse_what_stood_in_two_places() -> None:
    rows = [(float(n), str(n)) for n in range(20)]
    Random(3).shuffle(rows)
    back = again({"set": set(rows), "rows": rows})
    assert back == {"set": set(rows), "rows": rows}


def test_a_message_comes_back_with_the_fields_that_were_set_and_no_others() -> None:
    change = LinkChange(loss=0.25)
    back = again([change])[0]
    assert back == change
    assert back.model_fields_set == change.model_fields_set == {"loss"}


def test_derived_fields_are_derived_again_and_functions_are_those_of_the_codec() -> None:
    back = again({"pair": Pair(1), "call": double})
    assert back["pair"].total == 7
    assert back["call"] is double
    assert b"total" not in CODEC.encode(Pair(1))


@pytest.mark.parametrize(
    ("value", "named"),
    [
        (Mutable(), "Mutable"),
        (object(), "object"),
        (Random(1), "Random"),
        (Exception("x"), "Exception"),
        (len, "builtin_function_or_method"),
        (np.array([object()]), "ndarray"),
        (np.array(["text"]), "ndarray"),
        (addressed(SAMPLE, "somebody"), "Topic"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_the_codec_was_not_given_is_refused_with_its_place(value: Any, named: str) -> None:
    with pytest.raises(InvalidInput, match=rf"state: node\.parts\.1\.left: expected a plain value .*, got {named}"):
        CODEC.encode({"node": {"parts": [0, Pair(value)]}})


def test_only_enums_frozen_dataclasses_and_messages_can_be_given_and_each_name_once() -> None:
    for kind in (Mutable, dict, Topic.__class__):
        with pytest.raises(InvalidInput, match="expected enums, frozen dataclasses and messages"):
            StateCodec([kind])
    other = dataclass(frozen=True)(type("Pair", (), {}))
    with pytest.raises(InvalidInput, match="one type named Pair"):
        StateCodec([Pair, other])


def forged(tree: Any, blobs: Any = ()) -> bytes:
    head = json.dumps({"state": tree, "blobs": list(blobs)}).encode()
    return MAGIC + len(head).to_bytes(8, "little") + head


@pytest.mark.parametrize(
    "data",
    [
        b"",
        MAGIC,
        pickle.dumps({"a": 1}),
        forged({"$enum": ["Pair", "left"]}),
        forged({"$enum": ["Colour", "GREEN"]}),
        forged({"$data": ["Mutable", {}]}),
        forged({"$data": ["Pair", {"no": 1}]}),
        forged({"$data": ["Header", {"mission": 3}]}),
        forged({"$message": ["Header", "{}"]}),
        forged({"$message": ["Colour", "{}"]}),
        forged({"$function": "eval"}),
        forged({"$topic": "no/topic"}),
        forged({"$other": 1}),
        forged({"$same": 0}),
        forged({"$bytes": 0}),
        forged(None, [{"bytes": 5}]),
        forged({"$array": 0}, [{"bytes": 0, "dtype": "O", "shape": [0], "order": "C", "writeable": True}]),
        forged({"$array": 0}, [{"bytes": 0, "dtype": "<f8", "shape": [10**9], "order": "C", "writeable": True}]),
    ],
)
def test_bytes_that_are_no_state_are_refused_in_one_line(data: bytes) -> None:
    with pytest.raises(InvalidInput, match="state: expected one that this program has encoded") as refusal:
        CODEC.decode(data)
    assert "\n" not in str(refusal.value)


@given(st.integers(0, 10**6))
def test_no_damage_brings_anything_but_a_refusal_or_a_state(seed: int) -> None:
    dice = Random(seed)
    data = bytearray(CODEC.encode({"pair": Pair(np.arange(4.0), b"bytes"), "set": {1, 2}, "topic": SAMPLE}))
    for _ in range(dice.randint(1, 3)):
        data[dice.randrange(len(data))] = dice.randrange(256)
    with suppress(InvalidInput):
        CODEC.decode(bytes(data))
