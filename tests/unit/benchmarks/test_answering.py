"""Scripts of other software's environments answer one request, and do not outlive the benchmark that asks."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.peer_environments import PEERS
from tests.processes import run, start
from tests.waiting import until

SCRIPT = f"import os, sys, time; sys.path.insert(0, {str(PEERS)!r}); from answering import answer; "
ASKING = "import subprocess, sys; subprocess.run([sys.executable, '-c', sys.argv[1]], input='{}', text=True)"


def test_what_a_library_prints_does_not_get_into_the_answer() -> None:
    loud = SCRIPT + "answer(lambda request: (print('loud'), os.system('echo louder'), request['a'] + 1)[2])"
    done = run([sys.executable, "-c", loud], input='{"a": 2}', stdin=None)
    assert json.loads(done.stdout) == 3
    assert sorted(done.stderr.split()) == ["loud", "louder"]


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel of Linux ends the script")
def test_a_script_ends_when_the_benchmark_that_asks_is_killed() -> None:
    slow = SCRIPT + "answer(lambda _: (print(os.getpid(), flush=True), time.sleep(600)))"
    with start([sys.executable, "-c", ASKING, slow], stderr=subprocess.PIPE, text=True) as asking:
        assert asking.stderr is not None
        script = int(asking.stderr.readline())
        try:
            asking.kill()
            until(lambda: not Path(f"/proc/{script}").exists(), f"the end of process {script}")
        finally:
            if Path(f"/proc/{script}").exists():
                os.kill(script, signal.SIGKILL)
