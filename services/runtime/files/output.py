"""Files that a mission writes: for their owner alone, and never through a symbolic link that another user could plant.

Processes run with a umask of 077 (`services.runtime.entry`), so files have mode 0600 and folders 0700. This module
opens them. Its functions raise OSError; the caller reports what could not be written.
"""

from __future__ import annotations

import errno
import os
import secrets
import stat
from contextlib import suppress
from pathlib import Path
from typing import IO

from he3.errors import He3Error, InvalidInput

MAY_PASS = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EMFILE, errno.ENFILE)
"""Errors of the system that are no mistake of the operator's, and that may be gone at the next start."""

_FLAGS = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC


def open_output(path: Path, *, append: bool = False, new: bool = False, buffering: int = -1) -> IO[bytes]:
    """The file, opened to write bytes: emptied, for appending, or with `new` refused if it exists.

    Raises OSError (ELOOP) for a symbolic link outside /dev.
    """
    flags = _FLAGS | (os.O_APPEND if append else os.O_EXCL if new else os.O_TRUNC)
    if not _is_system_link(path):
        flags |= os.O_NOFOLLOW
    descriptor = os.open(path, flags, 0o600)
    return os.fdopen(descriptor, "ab" if append else "wb", buffering=buffering)


def write_output(path: Path, content: bytes) -> None:
    """Write that file; an earlier one is emptied first."""
    with open_output(path) as stream:
        stream.write(content)


def replace_output(path: Path, content: bytes) -> None:
    """Write a file in place of an earlier one, in one step: a reader sees the old file or the new one, after a power
    failure, too.
    """
    scratch = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    try:
        with open_output(scratch, new=True) as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        scratch.replace(path)
        sync_folder(path.parent)
    except BaseException:
        scratch.unlink(missing_ok=True)
        raise


def sync_folder(folder: Path) -> None:
    """Make the names in that folder, and its own name, safe from a power failure, where the file system can do that.

    A network file system may refuse, and the parent folder may belong to another user: neither is an error.
    """
    for each in (folder, folder.parent):
        with suppress(OSError):
            descriptor = os.open(each, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)


def require_own(found: os.stat_result, path: Path) -> None:
    """Raise OSError unless that is a file or folder of this user with one name."""
    if found.st_uid != os.getuid() or (stat.S_ISREG(found.st_mode) and found.st_nlink > 1):
        raise OSError(errno.EPERM, "expected a file of this user with one name", str(path))


def failed(what: str, error: OSError) -> He3Error:
    """The error, in one line, of a process that cannot go on; InvalidInput if the same command meets it again."""
    kind = He3Error if error.errno in MAY_PASS else InvalidInput
    return kind(f"{what}: {error.strerror or type(error).__name__}")


def _is_system_link(path: Path) -> bool:
    """Whether that is a link such as /dev/stdout, in a folder where only the administrator can make one."""
    return path.parent == Path("/dev")
