"""Region files with arrays of every kind: loaded as a region whose every value is physical, or refused in one line."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from benchmarks.fuzzing import values
from benchmarks.fuzzing.surface import one_line
from he3.errors import InvalidInput
from services.mission.regions import load_region

KEYS = (
    "he3_ppb",
    "elevation_m",
    "traversable",
    "orbital_ppb",
    "resolution_m",
    "origin_lat_deg",
    "origin_lon_deg",
    "provenance",
)
SENTINELS = (
    -9999.0,
    -32768.0,
    32767.0,
    65535.0,
    -3.4028226550889045e38,
    1e20,
    1e31,
    np.nan,
    np.inf,
    -np.inf,
    0.0,
    255.0,
)


class RegionFiles:
    """The region loader, fed with files in a separate folder."""

    name = "region"

    def __init__(self, folder: Path) -> None:
        self._path = folder / "fuzzed.npz"

    def close(self) -> None:
        """Nothing to end."""

    def example(self, rng: Random) -> tuple[str, str | None]:
        """One file: the change made in it, and a line on its fault, None if there was none."""
        arrays, what = _arrays(rng)
        payload = _packed(arrays)
        if rng.random() < 0.1:
            payload, what = _damaged(rng, payload), what + "; damaged bytes"
        self._path.write_bytes(payload)
        seed = values.integer(rng) if rng.random() < 0.1 else None
        try:
            region = load_region(str(self._path), seed)
        except InvalidInput as error:
            return what, one_line(str(error))
        held = {"he3_ppb": region.he3_ppb, "slope_deg": region.slope_deg, "elevation_m": region.elevation_m}
        for key, layer in held.items():
            if layer is None:
                continue
            sound = layer[region.known] if hasattr(region, "known") and region.known is not None else layer
            if not np.isfinite(sound).all():
                return what, f"accepted, and {key} holds values that are not finite"
            if np.abs(sound).max(initial=0.0) > 1e7:
                return what, f"accepted, and {key} reaches {np.abs(sound).max():g}"
        return what, None


def _arrays(rng: Random) -> tuple[dict[str, Any], str]:
    rows, columns = rng.choice(((12, 12), (4, 4), (5, 40), (30, 9)))
    y, x = np.mgrid[0:rows, 0:columns].astype(float)
    arrays: dict[str, Any] = {
        "he3_ppb": 8 + np.sin(x / 3) + np.cos(y / 4),
        "elevation_m": 0.05 * x,
        "traversable": np.ones((rows, columns), bool),
        "orbital_ppb": 8 + np.sin(x / 3),
        "resolution_m": 1.0,
    }
    for key in ("elevation_m", "traversable", "orbital_ppb"):
        if rng.random() < 0.3 and not (key == "traversable" and "elevation_m" not in arrays):
            del arrays[key]
    changes = []
    for _ in range(rng.choice((0, 1, 1, 1, 2))):
        key = rng.choice(KEYS)
        change = rng.choice((_with_sentinels, _of_another_kind, _of_another_shape, _scaled, _replaced, _left_out))
        changes.append(f"{key} {change(rng, arrays, key)}")
    return arrays, "; ".join(changes) or "unchanged"


def _with_sentinels(rng: Random, arrays: dict[str, Any], key: str) -> str:
    if np.ndim(arrays.get(key)) != 2:
        return "unchanged"
    layer = np.array(arrays[key], dtype=np.float64)
    count = min(rng.choice((1, 1, 3, layer.size)), layer.size)
    value = rng.choice(SENTINELS)
    layer.flat[rng.sample(range(layer.size), count)] = value
    arrays[key] = layer
    return f"with {count} cells of {value:g}"


def _of_another_kind(rng: Random, arrays: dict[str, Any], key: str) -> str:
    kind = rng.choice(("f2", "f4", "i1", "u2", "i8", "c16", "?", "U4", "S3", "O", "M8[s]", ">f8"))
    try:
        arrays[key] = np.asarray(arrays.get(key, 1.0)).astype(kind)
    except (ValueError, TypeError, OverflowError):
        return "unchanged"
    return f"as {kind}"


def _of_another_shape(rng: Random, arrays: dict[str, Any], key: str) -> str:
    shape = rng.choice(((0,), (0, 0), (1, 1), (3, 3), (12, 13), (12, 12, 1), (144,), ()))
    arrays[key] = np.ones(shape)
    return f"of shape {shape}"


def _scaled(rng: Random, arrays: dict[str, Any], key: str) -> str:
    if np.asarray(arrays.get(key)).dtype.kind != "f":
        return "unchanged"
    factor = values.number(rng)
    with np.errstate(all="ignore"):
        arrays[key] = arrays[key] * factor
    return f"times {factor:g}"


def _replaced(rng: Random, arrays: dict[str, Any], key: str) -> str:
    value = rng.choice((values.integer(rng), values.number(rng), values.text(rng)[:200]))
    if isinstance(value, str):
        value = value.encode("utf-8", "replace").decode()
    arrays[key] = np.array(value if not isinstance(value, int) or abs(value) < 2**63 else float(value))
    return f"replaced by {str(value)[:40]!r}"


def _left_out(_rng: Random, arrays: dict[str, Any], key: str) -> str:
    arrays.pop(key, None)
    return "left out"


def _packed(arrays: dict[str, Any]) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def _damaged(rng: Random, payload: bytes) -> bytes:
    match rng.choice(("cut", "flip", "empty", "text", "names")):
        case "cut":
            return payload[: rng.randrange(len(payload))]
        case "flip":
            changed = bytearray(payload)
            for _ in range(rng.choice((1, 5, 50))):
                changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
            return bytes(changed)
        case "empty":
            return b""
        case "text":
            return b"he3_ppb = [[1, 2], [3, 4]]\n"
        case _:
            stream = io.BytesIO()
            with zipfile.ZipFile(stream, "w") as archive:
                archive.writestr(rng.choice(("../he3_ppb.npy", "he3_ppb", "he3_ppb.npy")), payload[:500])
            return stream.getvalue()
