"""A Chromium for tests, pictures and measurements of the page, which ends with the process that started it.

chromedriver outlives a killed owner, and the browser outlives chromedriver. So both run under a guard, this module run
as a program: it ends when its owner ends, and ends all that came of its command before.
"""

from __future__ import annotations

from services.runtime.entry import end_with_parent

if __name__ == "__main__":
    end_with_parent()

import ctypes
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any

from he3.errors import He3Error
from services.runtime.child import child_environment, python_command

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-component-update",
    "--disable-background-networking", "--disable-sync",
)  # fmt: skip
"""No window, and no requests of the browser's own."""

_PR_SET_CHILD_SUBREAPER = 36  # Linux, prctl(2)


@contextmanager
def chromium(*flags: str, logged: dict[str, str] | None = None) -> Iterator[Any]:
    """A selenium driver of a headless Chromium with a fresh profile and these flags besides.

    logged: what it logs for ``get_log``, as goog:loggingPrefs. Raises He3Error without Chromium, chromedriver or
    selenium.
    """
    binary, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if binary is None or driver is None:
        raise He3Error("expected chromium and chromedriver on the path, got none (Debian: chromium chromium-driver)")
    try:
        from selenium import webdriver
    except ImportError:
        raise He3Error("expected selenium, got none: pip install selenium") from None

    profile = tempfile.mkdtemp(prefix="he3-chromium-")

    class Guarded(webdriver.ChromeService):
        def command_line_args(self) -> list[str]:
            return [*python_command(__name__)[1:], profile, driver, *super().command_line_args()]

    options = webdriver.ChromeOptions()
    options.binary_location = binary
    if logged is not None:
        options.set_capability("goog:loggingPrefs", logged)
    for flag in (*FLAGS, f"--user-data-dir={profile}", *flags):
        options.add_argument(flag)
    try:
        browser = webdriver.Chrome(options=options, service=Guarded(sys.executable, env=child_environment()))
        try:
            yield browser
        finally:
            browser.quit()
    finally:
        shutil.rmtree(profile, ignore_errors=True)


def guard(profile: str, command: list[str]) -> int:
    """Run the command; when it ends, or this process gets SIGTERM, kill what it has left, and remove the profile.

    Returns the command's exit code.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)  # orphans of the command become children of this process
    signal.signal(signal.SIGTERM, _leave)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # from a terminal it reaches the owner, too, who ends this process
    try:
        return subprocess.call(command)
    finally:
        while found := _children():
            for pid in found:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            with suppress(ChildProcessError):
                os.waitpid(-1, 0)
        shutil.rmtree(profile, ignore_errors=True)


def _leave(number: int, _frame: FrameType | None) -> None:
    signal.signal(number, signal.SIG_IGN)
    raise SystemExit(128 + number)


def _children() -> list[int]:
    """Processes whose parent is this one; on systems without /proc none are found."""
    tasks = Path("/proc/self/task")
    return [int(pid) for each in tasks.glob("*/children") for pid in each.read_text().split()]


if __name__ == "__main__":
    sys.exit(guard(sys.argv[1], sys.argv[2:]))
