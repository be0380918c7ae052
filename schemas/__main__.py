"""Print or write the JSON Schema of every message on the wire: ``python -m schemas [FOLDER]``.

``python -m schemas --table`` prints the topics as docs/zenoh.md has them, ``--access`` who may do what with them, as in
docs/lock-down.md.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from schemas.report import MissionReport
from schemas.roles import PERSON_ROLES, Role
from schemas.topics import KEY_ROOT, TOPICS, Crosses, Custody, Latest, Topic
from schemas.wire import Envelope, Wire

USAGE = """usage: python -m schemas [FOLDER | --table | --access]
without a folder: one JSON document on standard output; --table, --access: the topics as Markdown"""


def json_schemas() -> dict[str, dict[str, Any]]:
    """JSON Schemas by name: of each topic's message as sent, of each reply, and of the mission report."""
    schemas: dict[str, dict[str, Any]] = {}
    for topic in TOPICS:
        schemas[topic.name.replace("/", ".")] = _travelling(topic.payload)
        if topic.reply is not None:
            schemas[topic.name.replace("/", ".") + ".reply"] = _travelling(topic.reply)
    schemas["report"] = MissionReport.model_json_schema()
    return schemas


def _travelling(body: type[Wire]) -> dict[str, Any]:
    return Envelope[body].model_json_schema()  # type: ignore[valid-type]


def topic_table() -> str:
    """The topics as a Markdown table, one row each, in the order of ``TOPICS``."""
    rows = [
        f"Keys begin with `{KEY_ROOT}/{{mission}}/`; sizes are the longest message and the longest answer.",
        "",
        "| key | payload | answer | way | service | kept by | at most |",
        "|---|---|---|---|---|---|---|",
    ]
    return "\n".join([*rows, *(_row(topic) for topic in TOPICS)]) + "\n"


def _row(topic: Topic) -> str:
    way = {
        Crosses.UP: "Earth to Moon",
        Crosses.DOWN: "Moon to Earth",
        Crosses.NEVER: f"on the {topic.sides[0].title()}",
    }
    match topic.service:
        case Custody(priority):
            service = f"custody, priority {priority}"
        case Latest(_, distinct):
            service = f"latest of each {', '.join(distinct)}" if distinct else "latest"
        case _:
            service = "query"
    keepers = [name for name, keeps in (("recorder", topic.recorded), ("sender", topic.kept)) if keeps]
    most = [_size(topic.max_bytes), *([_size(topic.max_reply_bytes)] if topic.reply is not None else [])]
    cells = (
        f"`{topic.name}`",
        f"`{topic.payload.__name__}`",
        "" if topic.reply is None else f"`{topic.reply.__name__}`",
        way[topic.crosses],
        service,
        ", ".join(keepers),
        ", ".join(most),
    )
    return f"| {' | '.join(cells)} |"


def access_table() -> str:
    """Which roles may do what with each topic, as a Markdown table, one row a topic and side."""
    rows = ["| side | key | publish | subscribe | query | answer |", "|---|---|---|---|---|---|"]
    for topic in TOPICS:
        for side in topic.sides:
            given = topic.access_on(side)
            cells = (
                side.title(),
                f"`{topic.name}`",
                *map(_roles, (given.publish, given.subscribe, given.query, given.answer)),
            )
            rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def _roles(roles: tuple[Role, ...]) -> str:
    if set(PERSON_ROLES) <= set(roles):
        roles = tuple(role for role in roles if role not in PERSON_ROLES)
        return ", ".join([*roles, "people"])
    return ", ".join(roles)


def _size(count: int) -> str:
    return f"{count >> 20} MiB" if count >= 1 << 20 else f"{count >> 10} KiB"


def main(arguments: list[str]) -> int:
    if len(arguments) > 1 or arguments[:1] in (["-h"], ["--help"]):
        sys.stderr.write(USAGE + "\n")
        return 0 if arguments[:1] in (["-h"], ["--help"]) else 2
    if arguments == ["--table"]:
        sys.stdout.write(topic_table())
        return 0
    if arguments == ["--access"]:
        sys.stdout.write(access_table())
        return 0
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
