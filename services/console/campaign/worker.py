"""The worker process: reads a task a line, computes it, writes its reply on a line.

`worker_process` starts it as ``python -m services.console.campaign.worker``, on every engine alike, with an environment
of one BLAS thread, a fixed hash seed and the C locale: nothing that a host sets changes a result.
"""

from __future__ import annotations

import os
import sys

from services.runtime.child import ROOT
from services.runtime.entry import forget_working_directory, prepare_process

if __name__ == "__main__":
    forget_working_directory()
    prepare_process()

import gc
import json
import platform
import signal
import time
from importlib import import_module
from typing import Any, TextIO

from he3.errors import He3Error
from services.console.campaign.identity import software_identity
from services.console.campaign.task import DONE, FAILED, REFUSED, canonical


def serve(tasks: TextIO, replies: TextIO) -> None:
    """Compute every task that comes, one after the other, until its end of the pipe is closed."""
    for number, line in enumerate(tasks):
        replies.write(f"{canonical(answered(line))}\n")
        replies.flush()
        gc.collect()  # the parts of a mission refer to one another, and hold maps of dozens of megabytes
        if number == 0:
            gc.freeze()  # modules and what tasks share: looked through each time, they would cost 50 ms a task


def answered(line: str) -> dict[str, Any]:
    """The reply to a task's line of text, as a JSON object."""
    task = json.loads(line)
    worker = f"{platform.node()}/{os.getpid()}"
    here = software_identity(task["work"].partition(".")[0])
    if here != task["software"]:
        error = f"worker {worker}: expected the campaign's software, {task['software']}; got {here}"
        return {"status": REFUSED, "error": error, "worker": worker}
    began = time.perf_counter()
    reply: dict[str, Any]
    try:
        module, _, name = task["work"].partition(":")
        result = getattr(import_module(module), name)(task["arguments"])
        canonical(result)  # what has no JSON is an error of this task, not of the worker
        reply = {"status": DONE, "result": result}
    except He3Error as error:
        reply = {"status": FAILED, "error": str(error)}
    except Exception as error:  # noqa: BLE001 - a defect that one task meets is a row, never the campaign's end
        reply = {"status": FAILED, "error": f"{type(error).__name__}: {error}"}
    return {**reply, "wall_s": round(time.perf_counter() - began, 6), "worker": worker}


def main() -> None:
    """Serve standard input and output; whatever else prints goes to standard error."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C is for the runner to judge
    if ROOT not in sys.path:
        sys.path.append(ROOT)  # a checkout's benchmarks lie beside our packages
    replies = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="ascii")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    with replies:
        serve(sys.stdin, replies)


if __name__ == "__main__":
    main()
    # Whatever the tasks have started ends with this process; there is nothing to wait for.
    os._exit(0)
