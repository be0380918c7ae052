"""The containers of deploy/container: built from the locks, one for each process, each able to do little."""

from __future__ import annotations

import re

from services.mission.deployment import deployment
from services.mission.processes import PROCESSES

COMPOSE = deployment("container", "compose.yaml").read_text()
CONTAINERFILE = deployment("container", "Containerfile").read_text()


def test_the_image_is_built_from_the_locks_without_tools_of_development() -> None:
    assert CONTAINERFILE.count("--require-hashes -r requirements") == 2
    assert "requirements-dev" not in CONTAINERFILE
    assert re.search(r"^USER 10001:10001$", CONTAINERFILE, re.MULTILINE)
    installed = re.findall(r"pip install (?!--no-cache-dir (?:--require-hashes|--no-deps))", CONTAINERFILE)
    assert installed == []


def test_there_is_a_container_for_each_process_and_for_the_page() -> None:
    names = re.findall(r"^  ([a-z]+):\n    <<: \*service$", COMPOSE, re.MULTILINE)
    assert set(names) == {each.name for each in PROCESSES} | {"web"}
    assert COMPOSE.count('"--identity", "/identity"') == len(names)


def test_who_commands_and_changes_a_mission_in_containers_is_written_down() -> None:
    for name in ("link", "ground", "rover"):
        command = COMPOSE.partition(f'command: ["services.{name}",')[2].partition("]")[0]
        assert '"--audit", "/var/lib/he3/audit.jsonl"' in command


def test_a_container_writes_to_its_volume_alone_and_has_no_capability() -> None:
    shared = COMPOSE.partition("\nservices:\n")[0]
    for line in (
        "read_only: true",
        "cap_drop: [ALL]",
        'security_opt: ["no-new-privileges:true"]',
        'user: "10001:10001"',
    ):
        assert line in shared
    assert not re.search(r"privileged|cap_add|network_mode|/var/run|docker\.sock", COMPOSE)
    mounts = re.findall(r'"(\./[^"]+)"', COMPOSE)
    assert all(each.endswith(":ro") for each in mounts)
