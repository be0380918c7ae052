"""Where a running mission lives: a small file a run, in a folder of this user's alone, so that commands find it."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from he3.errors import He3Error, InvalidInput, PeerUnreachable

_ENDPOINT = re.compile(r"(?:tcp|tls|quic)/[^\s/]+:\d{1,5}(?:[?#]\S*)?|unixsock-stream/\S+")


@dataclass(frozen=True, slots=True)
class RunningMission:
    """What it takes to join a mission that runs on this machine."""

    mission: str
    scenario: str
    """Path of the scenario, or its name."""
    moon: str
    earth: str
    pid: int
    """The process that started the services and ends them."""
    services: dict[str, int]
    """Process id of each service."""


def folder() -> Path:
    """The folder of the run files, made for this user alone."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and Path(runtime).is_dir():
        place = Path(runtime) / "he3-seeker"
    else:
        place = Path(tempfile.gettempdir()) / f"he3-seeker-{os.getuid()}"
    place.mkdir(mode=0o700, exist_ok=True)
    if place.stat().st_uid != os.getuid() or place.is_symlink():
        raise He3Error(f"{place}: expected a folder of this user's, got somebody else's")
    return place


@contextmanager
def announced(running: RunningMission) -> Iterator[Path]:
    """The run file, there for as long as the mission runs."""
    import json

    path = folder() / f"{running.mission}-{running.pid}.json"
    scratch = path.with_suffix(".new")
    scratch.write_text(json.dumps(asdict(running)))
    scratch.replace(path)
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)


def running_missions() -> list[RunningMission]:
    """The missions that run on this machine now, the latest first; files of those that were killed are removed."""
    import json

    found: list[tuple[float, RunningMission]] = []
    for path in folder().glob("*.json"):
        with suppress(OSError):
            try:
                running = RunningMission(**json.loads(path.read_text()))
            except (ValueError, TypeError):
                continue
            if _alive(running.pid):
                found.append((path.stat().st_mtime, running))
            else:
                path.unlink(missing_ok=True)
    return [running for _, running in sorted(found, key=lambda entry: entry[0], reverse=True)]


def find(mission: str | None = None, earth: str | None = None) -> tuple[str, str]:
    """Earth endpoint and name of the mission that is meant: as given, else as announced on this machine.

    Raises InvalidInput for an endpoint that is none, or when several run and none was named; PeerUnreachable when none
    runs.
    """
    if earth is not None and not _ENDPOINT.fullmatch(earth):
        raise InvalidInput(
            f"--earth: expected an endpoint as PROTO/HOST:PORT, such as tcp/10.0.0.2:7448, got '{earth}'"
        )
    if mission is not None and earth is not None:
        return earth, mission
    running = [each for each in running_missions() if mission in (None, each.mission) and earth in (None, each.earth)]
    if not running and earth is not None:
        raise PeerUnreachable(
            f"nobody answers at {earth}: no mission of this machine is there, and another machine's needs its name, "
            f"with --mission"
        )
    if not running:
        wanted = f"mission '{mission}'" if mission else "mission"
        raise PeerUnreachable(
            f"no running {wanted} found on this machine: start one with 'he3 up t1', "
            f"or name another machine's with --earth and --mission"
        )
    names = {each.mission for each in running}
    if len(names) > 1:
        raise InvalidInput(f"several missions run ({', '.join(sorted(names))}): expected one of them with --mission")
    return running[0].earth, running[0].mission


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
