"""The routers' access rules as files with comments: ``python -m services.runtime.trust.zenoh_files [FOLDER]``.

`deploy/zenoh` has them for the mission `t1` and the names that `he3 keys init` issues; the files there are generated,
and a test compares them. The link does not read them: it makes the same rules from its roster when it starts.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from schemas.roles import PROCESS_ROLES, Role
from schemas.topics import Side
from services.runtime.trust.access_control import access_control, names_of
from services.runtime.trust.roster import Roster

EXAMPLE_MISSION = "t1"
EXAMPLE_NAMES: dict[Role, tuple[str, ...]] = {
    **{role: (f"{role.value}.main",) for role in PROCESS_ROLES},
    Role.VIEWER: ("viewer.launcher",),
    Role.OPERATOR: ("operator.anna",),
    Role.CONTROLLER: ("controller.ben",),
}

_HEAD = """\
// Access rules of the {title} router for the mission '{mission}': generated, do not edit.
//   {command}
// The link makes the same rules from its roster when it is started with --identity. This file is for reading, and for
// the configuration of a zenohd that stands in for the {side} router, beside `transport/link/tls` with `enable_mtls`.
// Everything is denied that is not allowed here. A rule is about one role, one right and one direction: what goes in
// from the peer (ingress), or comes out to it (egress). Who has a role is known by the common name of its certificate.
"""


def access_file(side: Side, mission: str, names: Mapping[Role, tuple[str, ...]], command: str) -> str:
    """The text of the file for that side's router. command: the command that generates it, named in its first lines."""
    rules = access_control(side, mission, names)
    head = _HEAD.format(title=side.value.title(), mission=mission, command=command, side=side.value)
    return f"{head}{{\n  access_control: {{\n{_body(rules)}  }},\n}}\n"


def _body(rules: dict[str, Any]) -> str:
    lines = ["    enabled: true,", f'    default_permission: "{rules["default_permission"]}",', "", "    rules: ["]
    role = None
    for rule in rules["rules"]:
        if (own := rule["id"].split("-")[0]) != role:
            role = own
            lines.append(f"      // {role}")
        lines += [
            "      {",
            f'        id: "{rule["id"]}", permission: "{rule["permission"]}", flows: {json.dumps(rule["flows"])},',
            f"        messages: {json.dumps(rule['messages'])},",
            "        key_exprs: [",
            *(f'          "{key}",' for key in rule["key_exprs"]),
            "        ],",
            "      },",
        ]
    lines += ["    ],", "", "    // Common names of each role.", "    subjects: ["]
    lines += [
        f'      {{ id: "{each["id"]}", cert_common_names: {json.dumps(each["cert_common_names"])} }},'
        for each in rules["subjects"]
    ]
    lines += ["    ],", "", "    policies: ["]
    for each in rules["policies"]:
        lines += [
            f"      {{ subjects: {json.dumps(each['subjects'])}, rules: [",
            *(f'          "{rule}",' for rule in each["rules"]),
            "      ] },",
        ]
    return "\n".join([*lines, "    ],"]) + "\n"


def write_access_files(folder: Path, mission: str, roster: Roster) -> list[Path]:
    """Write both routers' files for that mission and roster; returns their paths."""
    command = f"he3 keys zenoh DIR {mission}"
    return _write(folder, {side: access_file(side, mission, names_of(roster), command) for side in Side})


def example_files() -> dict[Side, str]:
    """The files that ship with the system."""
    command = "python -m services.runtime.trust.zenoh_files deploy/zenoh"
    return {side: access_file(side, EXAMPLE_MISSION, EXAMPLE_NAMES, command) for side in Side}


def _write(folder: Path, texts: dict[Side, str]) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for side, text in texts.items():
        written.append(folder / f"{side.value}-access.json5")
        written[-1].write_text(text)
    return written


if __name__ == "__main__":
    _write(Path(sys.argv[1] if len(sys.argv) > 1 else "deploy/zenoh"), example_files())
