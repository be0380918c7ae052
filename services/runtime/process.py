"""One service's process, from its command line to its exit code."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Sequence

from he3.errors import He3Error
from services.runtime.drivers.wall_clock import Process, Service, Stop
from services.runtime.lockstep.process import LockstepProcess
from services.runtime.options import parse_options

ENDS_WITHIN_S = 1.4
"""From the signal on: a call that hangs in the network then no longer keeps the process alive."""
SWITCH_INTERVAL_S = 0.0005
"""A thread that computes hands over after this time, so that a query waits no longer for it than for the network."""


def serve(
    service: Service,
    arguments: Sequence[str] | None = None,
    on_wall_clock: type[Process] = Process,
    in_lockstep: type[Process] = LockstepProcess,
) -> int:
    """Run the service until it is told to stop; the process's exit code. One line on standard error if it cannot."""
    stop = Stop()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    _end_in_time()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    try:
        options = parse_options(service.name, sys.argv[1:] if arguments is None else arguments)
        process = in_lockstep if options.lockstep and not service.onlooker else on_wall_clock
        return process(service, options, stop).run()
    except He3Error as error:
        sys.stderr.write(f"he3 {service.name}: {error}\n")
        return 2


def _end_in_time() -> None:
    """See to it that a process that was told to end does, even where it hangs in a call that no signal interrupts."""
    told, tell = socket.socketpair()
    tell.setblocking(False)
    signal.set_wakeup_fd(tell.fileno(), warn_on_full_buffer=False)

    def wait(_tell: socket.socket = tell) -> None:
        told.recv(1)
        time.sleep(ENDS_WITHIN_S)
        os._exit(0)

    threading.Thread(target=wait, name="ending", daemon=True).start()
