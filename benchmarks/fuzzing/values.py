"""Random values of every kind: ordinary ones, values at the edge of a range, and values of the wrong kind."""

from __future__ import annotations

import math
from random import Random
from typing import Any

EDGE_INTEGERS = (
    0,
    1,
    -1,
    2,
    7,
    255,
    4096,
    65_535,
    65_536,
    2**31 - 1,
    2**31,
    2**53,
    2**63 - 1,
    2**63,
    2**64,
    -(2**63),
    10**30,
)
EDGE_NUMBERS = (0.0, -0.0, 1e-320, 1e-12, 1e-3, 0.5, 1.0, 90.0, 1e3, 1e6, 1e12, 1e300, -1e-9, -1.0, -9999.0, -1e300,
                math.inf, -math.inf, math.nan)  # fmt: skip
EDGE_TEXTS = (
    "", " ", "-", "--", "-1", "nan", "inf", "1e999", "0x10", "1_000", "１２", "ä", "\ufeff", "\x00", "\x1b[31m", "a\nb",
    "a\tb", "../../etc/passwd", "/dev/zero", "/dev/full", "/proc/self/mem", "/", ".", "no/such/file", "*", "%s%n", "{}",
    "[]", "null", "true", "soon", "t1", "short", "mean", "std", "tm/sample", "x" * 300, "x" * 70_000, "\udcff", "😀",
)  # fmt: skip


def integer(rng: Random) -> int:
    """A small integer, or one at the edge of a machine's or the schema's ranges."""
    return rng.choice(EDGE_INTEGERS) if rng.random() < 0.6 else rng.randint(-20, 2_000)


def number(rng: Random) -> float:
    """A number over 24 orders of magnitude, or one at an edge; infinities and NaN among them."""
    if rng.random() < 0.5:
        return rng.choice(EDGE_NUMBERS)
    return rng.choice((-1.0, 1.0, 1.0)) * 10.0 ** rng.uniform(-12, 12)


def text(rng: Random) -> str:
    """A text from a list of known problem cases, or a random one."""
    if rng.random() < 0.8:
        return rng.choice(EDGE_TEXTS)
    return "".join(chr(rng.choice((rng.randint(1, 126), rng.randint(0xA0, 0x2FF)))) for _ in range(rng.randint(1, 12)))


def document(rng: Random, depth: int = 2) -> Any:
    """A value as JSON has them: a scalar of any kind, or a list or object of such."""
    kinds = ["integer", "number", "text", "flag", "none"] + (["list", "object"] if depth > 0 else [])
    match rng.choice(kinds):
        case "integer":
            return integer(rng)
        case "number":
            return number(rng)
        case "text":
            return text(rng)
        case "flag":
            return rng.random() < 0.5
        case "none":
            return None
        case "list":
            return [document(rng, depth - 1) for _ in range(rng.choice((0, 1, 2, 3, 300)))]
        case _:
            return {text(rng): document(rng, depth - 1) for _ in range(rng.randint(0, 3))}


def mutated(rng: Random, tree: Any) -> Any:
    """A copy of a JSON tree in which one place holds another value, is missing, is doubled or has a neighbour."""
    if isinstance(tree, dict) and tree and rng.random() < 0.85:
        key = rng.choice(list(tree))
        change = rng.random()
        if change < 0.08:
            return {name: value for name, value in tree.items() if name != key}
        if change < 0.14:
            return {**tree, text(rng): document(rng)}
        return {**tree, key: mutated(rng, tree[key])}
    if isinstance(tree, list) and tree and rng.random() < 0.7:
        index = rng.randrange(len(tree))
        if rng.random() < 0.2:
            return [*tree[: index + 1], *tree[index:]]
        return [*tree[:index], mutated(rng, tree[index]), *tree[index + 1 :]]
    if isinstance(tree, bool) or tree is None or isinstance(tree, str) or rng.random() < 0.3:
        return document(rng)
    return integer(rng) if isinstance(tree, int) and rng.random() < 0.7 else number(rng)
