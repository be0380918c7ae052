"""Files that only their owner may read: written whole or not at all, and refused if others could use them.

Symbolic links are not followed at the last step of a path.
"""

from __future__ import annotations

import os
import secrets
import stat
from pathlib import Path

from he3.errors import InvalidInput
from services.runtime.files.output import failed

MAX_BYTES = 8_388_608
"""Longest file that this system writes; a longer one is refused."""
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


def make_private_folder(path: Path) -> Path:
    """The folder, made for its owner alone if it does not exist; its parents are made as usual.

    Raises InvalidInput if it exists and others may enter it, and as `failed` if it cannot be made.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.mkdir(mode=0o700, exist_ok=True)
    except FileExistsError:
        raise InvalidInput(f"{path}: expected a folder, got a file") from None
    except OSError as error:
        raise failed(f"{path}: cannot make the folder", error) from None
    require_private_folder(path)
    return path


def require_private_folder(path: Path) -> None:
    """Raise InvalidInput unless that is a folder of this user, or of root, that others may not enter."""
    try:
        found = path.stat()
    except OSError as error:
        raise InvalidInput(f"{path}: expected a folder of keys: {error.strerror}") from None
    if not stat.S_ISDIR(found.st_mode):
        raise InvalidInput(f"{path}: expected a folder of keys, got a file")
    _require_owner(path, found, "0700")


def write_private(path: Path, content: bytes) -> None:
    """Write that file, mode 0600, in place of an earlier one; a reader sees the old file or the new one.

    Raises as `failed` if it cannot be written.
    """
    scratch = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    try:
        descriptor = os.open(scratch, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            scratch.replace(path)
        except BaseException:
            scratch.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise failed(f"{path}: cannot write", error) from None


def read_private(path: Path) -> bytes:
    """The content of that file; raises InvalidInput if it cannot be read, or if others could read or change it."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
        with os.fdopen(descriptor, "rb") as file:
            found = os.fstat(descriptor)
            if not stat.S_ISREG(found.st_mode):
                raise InvalidInput(f"{path}: expected a file")
            _require_owner(path, found, "0600")
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise InvalidInput(f"{path}: cannot read: {error.strerror}") from None
    if len(content) > MAX_BYTES:
        raise InvalidInput(f"{path}: expected at most {MAX_BYTES} bytes, got more")
    return content


def _require_owner(path: Path, found: os.stat_result, expected: str) -> None:
    if found.st_uid not in (os.getuid(), 0):
        raise InvalidInput(f"{path}: expected it to belong to this user, got one of user {found.st_uid}")
    # systemd gives credentials to a service as files of root with an access list, which shows as read for the group.
    allowed = stat.S_IRGRP | stat.S_IXGRP if found.st_uid == 0 != os.getuid() else 0
    if found.st_mode & _OTHERS & ~allowed:
        raise InvalidInput(
            f"{path}: expected mode {expected}, got {stat.S_IMODE(found.st_mode):04o}: others may use it"
        )
