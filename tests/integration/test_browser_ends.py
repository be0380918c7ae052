"""A browser that a test, a benchmark or a script has started ends with it, whatever ends that."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from services.runtime.child import ROOT
from tests.waiting import until

pytestmark = pytest.mark.skipif(
    not Path("/proc").is_dir() or not all(map(shutil.which, ("chromium", "chromedriver"))),
    reason="no browser: apt-get install chromium chromium-driver",
)
OPENS = """
import signal
from benchmarks.browser import chromium

with chromium() as driver:
    print(driver.capabilities["chrome"]["userDataDir"], flush=True)
    signal.pause()
"""


def users_of(profile: str) -> list[str]:
    """Command lines of the processes that name the profile; a zombie has none."""
    found = []
    for each in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = each.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except (FileNotFoundError, ProcessLookupError):
            continue
        if profile in words:
            found.append(words)
    return found


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT], ids=["killed", "interrupted"])
def test_no_browser_driver_or_profile_is_left_by_an_owner_that_was(number: signal.Signals) -> None:
    pytest.importorskip("selenium.webdriver", reason="no selenium: pip install selenium")
    with subprocess.Popen([sys.executable, "-c", OPENS], stdout=subprocess.PIPE, text=True, cwd=ROOT) as owner:
        assert owner.stdout is not None
        profile = owner.stdout.readline().strip()
        assert profile
        assert any("--user-data-dir" in words for words in users_of(profile))
        owner.send_signal(number)
        owner.wait()
    until(lambda: users_of(profile) == [], lambda: f"the end of {users_of(profile)}")
    until(lambda: not Path(profile).exists(), "the end of the profile")
