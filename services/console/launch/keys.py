"""The identities of the processes that a launcher starts, found in a mission's folder of keys."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from he3.errors import InvalidInput
from schemas.roles import PROCESS_ROLES, Role

if TYPE_CHECKING:
    from services.runtime.trust.authority import Authority
    from services.runtime.trust.roster import RosterEntry

PROCESS_NAME = "main"
"""Name of the processes' identities that `he3 keys init` issues."""
LAUNCHER_NAME = "launcher"
"""Name of the viewer as which a launcher follows its mission."""
DEMO_NAME = "demo"
"""Name of the people in temporary keys."""
TEMPORARY = timedelta(days=30)
"""Validity of temporary keys."""


@dataclass(frozen=True, slots=True)
class LaunchKeys:
    """Folders of identities."""

    processes: dict[str, Path]
    """Identities by the name of the process."""
    viewer: Path
    """The identity with which the mission is followed until its end."""


def issue_for_processes(authority: Authority, valid_for: timedelta) -> list[Path]:
    """The folders of new identities for all processes of a mission, and for the viewer that follows it."""
    from services.runtime.trust.certificates import Subject

    wanted = [(role, PROCESS_NAME) for role in PROCESS_ROLES] + [(Role.VIEWER, LAUNCHER_NAME)]
    return [authority.issue(Subject(role, name), valid_for) for role, name in wanted]


@contextmanager
def temporary_keys() -> Iterator[Path]:
    """A folder of keys for one mission: its processes, an operator and a controller `demo`; deleted at the end."""
    from services.runtime.trust.authority import Authority
    from services.runtime.trust.certificates import Subject

    with tempfile.TemporaryDirectory(prefix="he3-keys-") as place:
        authority = Authority.create(Path(place) / "keys", TEMPORARY)
        issue_for_processes(authority, TEMPORARY)
        for role in (Role.OPERATOR, Role.CONTROLLER):
            authority.issue(Subject(role, DEMO_NAME), TEMPORARY)
        yield authority.folder


def launch_keys(folder: Path) -> LaunchKeys:
    """The identities for one mission's processes; raises InvalidInput, in one line, if one is missing or invalid."""
    from services.runtime.trust.authority import Authority

    authority = Authority(folder)
    entries = [each for each in authority.roster.entries if each.revoked_at is None]
    found = {
        role: _identity(authority, role, PROCESS_NAME, [each for each in entries if each.role is role])
        for role in PROCESS_ROLES
    }
    viewers = [each for each in entries if each.role is Role.VIEWER]
    return LaunchKeys(
        {role.value: path for role, path in found.items()}, _identity(authority, Role.VIEWER, LAUNCHER_NAME, viewers)
    )


def _identity(authority: Authority, role: Role, usual: str, entries: list[RosterEntry]) -> Path:
    """The folder of the identity of the usual name, else of the only one of that role; read once, so it is valid."""
    from services.runtime.trust.certificates import parse_common_name
    from services.runtime.trust.identity import load_identity

    chosen = [each for each in entries if each.name == usual] or entries
    if len(chosen) != 1:
        got = ", ".join(each.common_name for each in chosen) or "none"
        raise InvalidInput(
            f"{authority.folder}: expected one identity of role {role}, got {got}: he3 keys issue {role} {usual}"
        )
    path = authority.folder_of(parse_common_name(chosen[0].common_name))
    load_identity(path)
    return path
