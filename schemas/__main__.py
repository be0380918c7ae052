"""Prints or writes the JSON Schema of every message on the wire: ``python -m schemas [FOLDER]``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from schemas.report import MissionReport
from schemas.topics import TOPICS
from schemas.wire import Envelope, Wire

USAGE = "usage: python -m schemas [FOLDER]   (without a folder: one JSON document on standard output)"


def json_schemas() -> dict[str, dict[str, Any]]:
    """JSON Schema of each topic's message as it travels, of each reply, and of the mission report, by name."""
    schemas: dict[str, dict[str, Any]] = {}
    for topic in TOPICS:
        schemas[topic.name.replace("/", ".")] = _travelling(topic.payload)
        if topic.reply is not None:
            schemas[topic.name.replace("/", ".") + ".reply"] = _travelling(topic.reply)
    schemas["report"] = MissionReport.model_json_schema()
    return schemas


def _travelling(body: type[Wire]) -> dict[str, Any]:
    return Envelope[body].model_json_schema()  # type: ignore[valid-type]


def main(arguments: list[str]) -> int:
    if len(arguments) > 1 or arguments[:1] in (["-h"], ["--help"]):
        sys.stderr.write(USAGE + "\n")
        return 0 if arguments[:1] in (["-h"], ["--help"]) else 2
    schemas = json_schemas()
    if not arguments:
        sys.stdout.write(json.dumps(schemas, indent=2) + "\n")
        return 0
    folder = Path(arguments[0])
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, schema in schemas.items():
            (folder / f"{name}.schema.json").write_text(json.dumps(schema, indent=2) + "\n")
    except OSError as error:
        sys.stderr.write(f"python -m schemas: cannot write to {folder}: {error.strerror}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
