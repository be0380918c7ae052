"""Run files: each running mission has a small file in a folder of this user, so that commands find it."""

from __future__ import annotations

import errno
import os
import re
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from he3.errors import He3Error, InvalidInput, PeerUnreachable
from services.runtime.files.output import replace_output

MAX_FILE_BYTES = 65_536
MAX_PORT = 65_535
_NO_HOME = (errno.ENOENT, errno.ENOTDIR, errno.EACCES, errno.EPERM, errno.EROFS)
"""Errors of the system where a home does not exist or may not be written."""
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,47}")
_ENDPOINT = re.compile(r"(?:tcp|tls|quic)/[^\s/]+:\d{1,5}(?:[?#]\S*)?|unixsock-stream/\S+")


@dataclass(frozen=True, slots=True)
class RunningMission:
    """The data needed to join a mission that runs on this machine."""

    mission: str
    scenario: str
    """Path of the scenario, or its name."""
    moon: str
    earth: str
    pid: int
    """The process that started the services and ends them."""
    services: dict[str, int]
    """Process id of each service."""
    viewer: str = ""
    """Folder of an identity that may read, with which this user's commands join; empty for a mission without TLS."""
    insecure: bool = False
    """Whether its user has allowed endpoints off loopback without TLS."""
    recording: str = ""
    """The recording that is served in place of a running mission; empty for one that runs."""


def folder() -> Path:
    """The folder of the run files, which only this user may enter: in XDG_RUNTIME_DIR, else in the user's cache, else,
    for a user without a home, in the folder of temporary files.

    Raises He3Error if it is another user's, open to others, or no folder.
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    try:
        place = Path(runtime) / "he3-seeker" if runtime and Path(runtime).is_dir() else _cache() / "he3-seeker"
        found = _made(place)
    except (OSError, RuntimeError) as error:
        if isinstance(error, OSError) and error.errno not in _NO_HOME:
            raise He3Error(f"{error.filename}: cannot make the folder of the run files: {error.strerror}") from None
        place = Path(tempfile.gettempdir()) / f"he3-seeker-{os.getuid()}"
        try:
            found = _made(place)
        except OSError as other:
            raise He3Error(
                f"{place}: cannot make the folder of the run files: {other.strerror}; XDG_RUNTIME_DIR names another"
            ) from None
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
        raise He3Error(f"{place}: expected a folder of this user, got a link, a file or another user's folder")
    if found.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise He3Error(f"{place}: expected mode 0700, got {stat.S_IMODE(found.st_mode):04o}: others may use it")
    return place


def _cache() -> Path:
    """The user's cache; raises RuntimeError for a user without a home."""
    cache = os.environ.get("XDG_CACHE_HOME")
    return Path(cache) if cache and Path(cache).is_absolute() else Path.home() / ".cache"


def _made(place: Path) -> os.stat_result:
    """What that folder is, made for its owner alone if it does not exist."""
    place.parent.mkdir(parents=True, exist_ok=True)
    place.mkdir(mode=0o700, exist_ok=True)
    return place.lstat()


@contextmanager
def announced(running: RunningMission) -> Iterator[Path]:
    """The run file, which exists while the mission runs."""
    import json

    path = folder() / f"{running.mission}-{running.pid}.json"
    replace_output(path, json.dumps(asdict(running)).encode())
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
            if (content := _own_content(path)) is None:
                continue
            try:
                running = RunningMission(**json.loads(content))
            except (ValueError, TypeError):
                continue
            if not (isinstance(running.pid, int) and _NAME.fullmatch(str(running.mission))):
                continue
            if _alive(running.pid):
                found.append((path.stat().st_mtime, running))
            else:
                path.unlink(missing_ok=True)
    return [running for _, running in sorted(found, key=lambda entry: entry[0], reverse=True)]


def announced_as(earth: str, mission: str) -> RunningMission | None:
    """The announcement on this machine of the mission with that name and Earth endpoint; None if there is none."""
    return next((each for each in running_missions() if (each.earth, each.mission) == (earth, mission)), None)


def find(mission: str | None = None, earth: str | None = None) -> tuple[str, str]:
    """Earth endpoint and name of a mission: as given, else as announced on this machine.

    A name stands for a mission only if one mission of that name runs. Raises InvalidInput for an endpoint or a name
    that is invalid, or when several missions fit; PeerUnreachable when none does.
    """
    if earth is not None and not _ENDPOINT.fullmatch(earth):
        raise InvalidInput(
            f"--earth: expected an endpoint as PROTO/HOST:PORT, such as tcp/10.0.0.2:7448, got '{earth[:100]}'"
        )
    port = re.search(r":(\d+)(?:[?#]|$)", earth or "")
    if port is not None and not 0 < int(port[1]) <= MAX_PORT:
        raise InvalidInput(f"--earth: expected a port from 1 to {MAX_PORT}, got '{earth}'")
    if mission is not None and not _NAME.fullmatch(mission):
        raise InvalidInput(f"--mission: expected at most 48 of a-z, 0-9, '-' and '_', got '{mission[:80]}'")
    if mission is not None and earth is not None:
        return earth, mission
    running = [each for each in running_missions() if mission in (None, each.mission) and earth in (None, each.earth)]
    if not running and earth is not None:
        raise PeerUnreachable(
            f"no mission of this machine is at {earth}; for a mission of another machine give its name with --mission"
        )
    if not running:
        wanted = f"mission '{mission}'" if mission else "mission"
        raise PeerUnreachable(
            f"no running {wanted} found on this machine: start one with 'he3 up t1', "
            f"or name another machine's with --earth and --mission"
        )
    if len(running) > 1:
        raise _ambiguous(running)
    return running[0].earth, running[0].mission


def _ambiguous(running: list[RunningMission]) -> InvalidInput:
    listed = ", ".join(
        sorted(f"'{each.mission}' at {each.earth}{', a recording' if each.recording else ''}" for each in running)
    )
    if len({each.mission for each in running}) == len(running):
        flag = "--mission"
    elif len({each.earth for each in running}) == len(running):
        flag = "--earth"
    else:
        flag = "--earth and --mission"
    return InvalidInput(f"expected one mission, got {len(running)}: choose one with {flag} ({listed})")


def _own_content(path: Path) -> bytes | None:
    """The content of a file of this user; None for any other, and for a link."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(descriptor, "rb") as stream:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_uid != os.getuid():
            return None
        return stream.read(MAX_FILE_BYTES)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
