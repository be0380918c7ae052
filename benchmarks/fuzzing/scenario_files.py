"""Scenario files with every key at random values: accepted and then run for a while, or refused in one line."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from pydantic import BaseModel

from benchmarks.fuzzing import values
from benchmarks.fuzzing.surface import one_line
from he3.errors import He3Error, InvalidInput
from he3.kernels import AUTO, KERNELS
from services.mission.in_process import InProcessMission
from services.mission.scenario import PLANNER_NAMES, Scenario, load_scenario

INSTANTS = 300
"""How many instants of an accepted mission are run: enough for a plan, a drive, a sample and its way to the map."""


def keys_of(model: type[BaseModel], above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Every key that a scenario can have, as a path of names."""
    for name, field in model.model_fields.items():
        section = field.annotation
        if isinstance(section, type) and issubclass(section, BaseModel):
            yield from keys_of(section, (*above, name))
        else:
            yield (*above, name)


class ScenarioFiles:
    """The scenario loader and the nodes that are built from what it accepts."""

    name = "scenario"

    def __init__(self, folder: Path) -> None:
        self._path = folder / "fuzzed.toml"
        self._region = folder / "region.npz"
        self._keys = list(keys_of(Scenario))
        y, x = np.mgrid[0:20, 0:20].astype(float)
        np.savez(
            self._region, he3_ppb=8 + np.sin(x / 5) + np.cos(y / 6), traversable=np.ones((20, 20), bool),
            orbital_ppb=8 + np.sin(x / 5), resolution_m=1.0,
        )  # fmt: skip

    def close(self) -> None:
        """Nothing to end."""

    def example(self, rng: Random) -> tuple[str, str | None]:
        """One scenario file: the changed keys, and a line on its fault, None if there was none."""
        document = self._ordinary()
        changes = []
        for _ in range(rng.choice((0, 1, 1, 1, 2, 3))):
            path = rng.choice(self._keys)
            value = _value(rng, path[-1])
            _put(document, path, value)
            changes.append(f"{'.'.join(path)} = {str(value)[:60]!r}")
        payload = _toml(document).encode("utf-8", "surrogatepass")
        if rng.random() < 0.08:
            payload = _damaged(rng, payload)
            changes.append("damaged bytes")
        self._path.write_bytes(payload)
        return "; ".join(changes) or "unchanged", self._wrong()

    def _wrong(self) -> str | None:
        try:
            scenario = load_scenario(self._path)
            mission = InProcessMission(scenario)
        except InvalidInput as error:
            return one_line(str(error))
        for _ in range(INSTANTS):
            if mission.end is not None:
                return None
            try:
                if not mission.simulation.step():
                    return "accepted, and the mission stands still"
            except He3Error as error:
                return f"accepted, and refused during the mission: {error}"
        return None

    def _ordinary(self) -> dict[str, Any]:
        return {
            "name": "fuzzed", "region": str(self._region), "rounds": 2, "samples_per_round": 2, "start_m": [5.0, 5.0],
            "ground": {"planning_s": 1.0, "planner": "rrtstar", "clearance_m": 1.0},
        }  # fmt: skip


def _value(rng: Random, key: str) -> Any:
    kind = rng.random()
    if key == "kernel" and kind < 0.7:
        return rng.choice((*KERNELS, AUTO))
    if key == "planner" and kind < 0.7:
        return rng.choice(PLANNER_NAMES)
    if (key.endswith("_m") or "polygon" in key) and kind < 0.3:
        corners = [[rng.uniform(-5, 25), rng.uniform(-5, 25)] for _ in range(rng.choice((2, 3, 4, 5)))]
        return rng.choice(([corners], corners, corners[0]))
    if kind < 0.45:
        return rng.choice((values.number(rng), abs(values.number(rng)), 10 ** rng.uniform(-4, 6)))
    if kind < 0.7:
        return rng.choice((values.integer(rng), rng.randint(0, 50)))
    return values.document(rng, 1)


def _put(document: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
    for name in path[:-1]:
        below = document.get(name)
        if not isinstance(below, dict):
            below = document[name] = {}
        document = below
    document[path[-1]] = value


def _toml(document: dict[str, Any]) -> str:
    """The document as TOML: scalars and arrays first, then each table as an inline table."""
    return "".join(f"{_key(name)} = {_toml_value(value)}\n" for name, value in document.items())


def _key(name: str) -> str:
    return json.dumps(name, ensure_ascii=False)


def _toml_value(value: Any) -> str:
    match value:
        case None:
            return '"none"'
        case bool():
            return "true" if value else "false"
        case str():
            return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
        case float():
            return repr(value)
        case list():
            return f"[{', '.join(_toml_value(each) for each in value)}]"
        case dict():
            return f"{{{', '.join(f'{_key(name)} = {_toml_value(each)}' for name, each in value.items())}}}"
    return str(value)


def _damaged(rng: Random, payload: bytes) -> bytes:
    match rng.choice(("cut", "flip", "bom", "utf-16", "zeros", "huge", "twice")):
        case "cut":
            return payload[: rng.randrange(len(payload))]
        case "flip":
            changed = bytearray(payload)
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
            return bytes(changed)
        case "bom":
            return b"\xef\xbb\xbf" + payload
        case "utf-16":
            return payload.decode("utf-8", "replace").encode("utf-16")
        case "zeros":
            return b"\0" * 1000
        case "huge":
            return payload + b"#" * 2_000_000
        case _:
            return payload + payload
