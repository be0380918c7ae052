"""The services: separate processes that talk over Eclipse Zenoh, built as cores without I/O inside thin shells."""

import os
import signal
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy reads it; why is said in he3/__init__.py


def _end(*_: object) -> None:
    os._exit(0)


if sys.argv[:1] == ["-m"] and "services.console" not in sys.orig_argv:
    # `python -m services.NAME` is only reading its code yet. Until `serve` takes the signals over there is nothing to
    # put in order, and nobody wants to see where in the imports it was.
    for _number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(_number, _end)
