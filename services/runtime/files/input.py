"""Files that a process has kept for its next start: read only if they are this user's own.

Who may write into a folder can put a file of their own there. A journal of another user's making would tell a process
what to do, so it is not read, and neither is one behind a symbolic link. The administrator is trusted.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import IO, Final

MAX_KEPT_BYTES: Final = 8 * 1024 * 1024
"""Longest file that `read_own` reads: a link's conditions with all contact windows that fit have about 1 MB."""


def open_own(path: Path) -> IO[bytes]:
    """The file, opened to read bytes. Raises OSError for a symbolic link, and unless it is a file of this user or of
    root.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        if error.errno != errno.ELOOP:
            raise
        raise OSError(errno.ELOOP, "expected a file, got a symbolic link", str(path)) from None
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EPERM, "expected a file, got something else", str(path))
        if found.st_uid not in (os.getuid(), 0):
            raise OSError(errno.EPERM, f"expected a file of this user, got one of user {found.st_uid}", str(path))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_own(path: Path) -> bytes:
    """The content of a file that `open_own` opens. Raises OSError as that does, and for one beyond `MAX_KEPT_BYTES`."""
    with open_own(path) as stream:
        content = stream.read(MAX_KEPT_BYTES + 1)
    if len(content) > MAX_KEPT_BYTES:
        raise OSError(errno.EFBIG, f"expected at most {MAX_KEPT_BYTES} bytes, got more", str(path))
    return content
