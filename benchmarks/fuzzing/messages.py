"""Messages and queries on every topic, mutated from real ones, fed to the real nodes of a mission in virtual time.

No input over the wire may raise in a node. A message that is refused is counted and leaves the state of every
node as it was; one that is accepted may change the mission, but the mission continues.
"""

from __future__ import annotations

import json
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from benchmarks.fuzzing import values
from benchmarks.fuzzing.surface import one_line
from schemas.topics import MAP_FEED, TOPICS, Crosses, Query, Side, Topic
from services.mission.in_process import InProcessMission
from services.mission.scenario import Scenario, checked_scenario

MISSION = "fuzzed"
RENEWED_AFTER = 200
"""Number of examples per mission; a new mission drops the effects of accepted messages."""
NODES = ("field", "rover", "link", "ground")


class Messages:
    """A mission of a few samples, its nodes in this process, and the messages that were seen in it."""

    name = "messages"

    def __init__(self, folder: Path) -> None:
        region = folder / "region.npz"
        _, x = np.mgrid[0:20, 0:20].astype(float)
        np.savez(region, he3_ppb=8 + np.sin(x / 5), traversable=np.ones((20, 20), bool), resolution_m=1.0)
        self._scenario: Scenario = checked_scenario(
            {
                "name": MISSION, "region": str(region), "rounds": 6, "samples_per_round": 3, "start_m": [5.0, 5.0],
                "ground": {"planning_s": 1.0, "planner": "rrtstar", "clearance_m": 1.0, "pipeline": 1},
            },
            "fuzzing",
        )  # fmt: skip
        self._seen: dict[str, bytes] = {}
        self._left = 0
        self._keeping = False
        self._topics = [topic for topic in TOPICS if topic is not MAP_FEED]

    def close(self) -> None:
        """Nothing to end."""

    def example(self, rng: Random) -> tuple[str, str | None]:
        """One message or query: topic and bytes, and a line on its fault, None if there was none."""
        if self._left == 0:
            self._begin(rng)
        self._left -= 1
        simulation = self._mission.simulation
        for _ in range(rng.choice((0, 0, 1, 5))):
            simulation.step()
        topic = rng.choice(self._topics)
        side = rng.choice(topic.sides) if rng.random() < 0.9 else rng.choice(list(Side))
        payload = self._payload(rng, topic)
        what = f"{topic.name} on {side.value}: {payload[:300]!r}"
        try:
            wrong = self._put(topic, side, payload)
            simulation.step()
        except BaseException:
            self._left = 0  # the next example begins a fresh mission, so that each fault stands for itself
            raise
        return what, wrong

    def _begin(self, rng: Random) -> None:
        self._mission = InProcessMission(self._scenario)
        self._mission.simulation.tap(self._keep)
        self._left = RENEWED_AFTER
        self._keeping = True
        for _ in range(rng.randint(1, 400)):
            self._mission.simulation.step()
        self._keeping = False  # what follows is of our own making

    def _keep(self, topic: Topic, _side: Side, payload: bytes, _now: int) -> None:
        if self._keeping:
            self._seen[topic.name] = payload

    def _put(self, topic: Topic, side: Side, payload: bytes) -> str | None:
        simulation = self._mission.simulation
        before = self._counts()
        if isinstance(topic.service, Query):
            served = any(topic in simulation.host(name).interface.serves for name in NODES)
            if not served:
                return None
            answer = simulation.ask_raw(topic, payload)
            refused = isinstance(answer, str)
            if refused and (wrong := one_line(str(answer))) is not None:
                return wrong
            return None
        simulation.inject(topic, side, payload)
        simulation.run(until=simulation.now)
        after = self._counts()
        for name in NODES:
            events, refusals = (now - then for now, then in zip(after[name], before[name], strict=True))
            if refusals > 1 or (refusals and events > _others(topic, name)):
                return f"{name} refused it and handled {events} events of it"
        return None

    def _counts(self) -> dict[str, tuple[int, int]]:
        hosts = {name: self._mission.simulation.host(name) for name in NODES}
        return {name: (host.events, host.refused) for name, host in hosts.items()}

    def _payload(self, rng: Random, topic: Topic) -> bytes:
        """A mutated message of that topic."""
        return mutated_message(rng, topic, self._seen, MISSION, self._mission.simulation.now)


def mutated_message(rng: Random, topic: Topic, genuine: dict[str, bytes], mission: str, now: int) -> bytes:
    """A message of that topic with random changes: of a genuine one if there is one, else of one made from its schema.

    genuine: a message of each topic that was seen, by the topic's name; at least one. now: mission time [ns].
    """
    seen = genuine.get(topic.name)
    if seen is None or rng.random() < 0.2:
        other = genuine.get(rng.choice(list(genuine)))
        seen = other if other is not None and rng.random() < 0.2 else None
    tree: Any
    if seen is not None:
        tree = json.loads(seen)
        tree["header"].pop("checksum", None)
    else:
        tree = {
            "header": {"mission": mission, "source": "stranger", "incarnation": 1, "sequence": 0, "made_at": now},
            "body": _example(rng, topic.payload.model_json_schema()),
        }
    for _ in range(rng.choice((0, 1, 1, 1, 2, 3))):
        part = rng.choice(("header", "body", "body", "body"))
        if isinstance(tree, dict) and part in tree and rng.random() < 0.95:
            tree[part] = values.mutated(rng, tree[part])
        else:
            tree = values.mutated(rng, tree)
    payload = json.dumps(tree, ensure_ascii=rng.random() < 0.5, separators=(",", ":")).encode("utf-8", "surrogatepass")
    return _damaged(rng, payload) if rng.random() < 0.12 else payload


def _others(topic: Topic, _name: str) -> int:
    """How many events another node's reaction at the same instant may add."""
    return 3 if topic.crosses is not Crosses.NEVER else 1


def _example(rng: Random, schema: dict[str, Any], definitions: dict[str, Any] | None = None, depth: int = 4) -> Any:
    """A random value that fits the schema more often than not."""
    definitions = schema.get("$defs", {}) if definitions is None else definitions
    if "$ref" in schema:
        return _example(rng, definitions[schema["$ref"].rsplit("/", 1)[-1]], definitions, depth)
    if "const" in schema:
        return schema["const"]
    if "enum" in schema:
        return rng.choice(schema["enum"])
    if "anyOf" in schema:
        return _example(rng, rng.choice(schema["anyOf"]), definitions, depth)
    match schema.get("type"):
        case "object":
            properties = schema.get("properties", {})
            required = schema.get("required", [])
            return {
                name: _example(rng, below, definitions, depth - 1)
                for name, below in properties.items()
                if name in required or (depth > 0 and rng.random() < 0.4)
            }
        case "array" if "prefixItems" in schema:
            return [_example(rng, each, definitions, depth - 1) for each in schema["prefixItems"]]
        case "array":
            count = max(schema.get("minItems", 0), rng.choice((0, 1, 3)) if depth > 0 else 0)
            return [_example(rng, schema.get("items", {}), definitions, depth - 1) for _ in range(count)]
        case "integer":
            low = schema.get("minimum", schema.get("exclusiveMinimum", -1) + 1)
            return rng.choice((low, low + 1, schema.get("maximum", low + 7), values.integer(rng)))
        case "number":
            low = float(schema.get("minimum", schema.get("exclusiveMinimum", 0.0)))
            high = float(schema.get("maximum", schema.get("exclusiveMaximum", low + 10.0)))
            return rng.choice((rng.uniform(low, high), rng.uniform(low, high), low, high, values.number(rng)))
        case "boolean":
            return rng.random() < 0.5
        case "string":
            return rng.choice(("rover", "ground", "a1", "plan-1", values.text(rng)))
    return None


def _damaged(rng: Random, payload: bytes) -> bytes:
    match rng.choice(("cut", "flip", "empty", "noise", "deep", "huge number", "doubled")):
        case "cut":
            return payload[: rng.randrange(len(payload))]
        case "flip":
            changed = bytearray(payload)
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
            return bytes(changed)
        case "empty":
            return b""
        case "noise":
            return rng.randbytes(rng.randint(1, 200))
        case "deep":
            return b"[" * 20_000
        case "huge number":
            return payload.replace(b":1", b":" + b"9" * 5_000, 1)
        case _:
            return payload + payload
