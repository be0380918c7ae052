"""A wall clock that a benchmark can set, for the processes that it starts and for no other.

The library is compiled from `wall_clock.c` with the system's C compiler. libfaketime is not used: under it every
`time.sleep` of Python 3.11 raises OSError (EINVAL), because Python sleeps until a time of the monotonic clock.
[measured: libfaketime 0.9.10]
"""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
from pathlib import Path

from he3.errors import He3Error

SOURCE = Path(__file__).with_suffix(".c")
COMPILERS = ("cc", "gcc", "clang")
SECOND_NS = 1_000_000_000


def compiled(folder: Path) -> Path | None:
    """The library, compiled into that folder; None where there is no C compiler. Raises He3Error if it fails."""
    compiler = next((path for name in COMPILERS if (path := shutil.which(name)) is not None), None)
    if compiler is None:
        return None
    library = folder / "wall_clock.so"
    command = [compiler, "-O2", "-shared", "-fPIC", "-o", str(library), str(SOURCE)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise He3Error(f"{SOURCE}: cannot be compiled: {(done.stderr.strip().splitlines() or ['no reason given'])[0]}")
    return library


class WallClock:
    """The wall clock of the processes that are started with its `environment`."""

    def __init__(self, library: Path, path: Path) -> None:
        """path: a file that the processes read the step from."""
        self._path = path
        path.write_bytes(bytes(8))
        self.environment = {"LD_PRELOAD": str(library), "HE3_WALL_CLOCK": str(path)}

    def set(self, ahead_s: float) -> None:
        """Show so much more than the machine's own wall clock [s] from now on."""
        file = os.open(self._path, os.O_WRONLY)
        try:
            os.pwrite(file, struct.pack("=q", round(ahead_s * SECOND_NS)), 0)
        finally:
            os.close(file)
