"""What a process tells the service manager that started it, if one did: that it is ready, that it lives, that it ends.

systemd names a socket in NOTIFY_SOCKET, and in WATCHDOG_USEC how often it wants to hear (sd_notify(3),
sd_watchdog_enabled(3)). A main loop says that it lives: where it hangs, the service is started again.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Mapping
from contextlib import suppress


class ServiceManager:
    """The end of this process; without a service manager its methods do nothing."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        watched = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        micros = environment.get("WATCHDOG_USEC", "")
        self._every_s = int(micros) / 3e6 if watched and micros.isascii() and micros.isdigit() else 0.0
        self._told_at_s = 0.0

    def ready(self) -> None:
        """The service does its work from now on."""
        self._tell("READY=1")

    def alive(self) -> None:
        """The main loop turns; call it in each turn."""
        now = time.monotonic()
        if self._every_s and now - self._told_at_s >= self._every_s:
            self._told_at_s = now
            self._tell("WATCHDOG=1")

    def stopping(self) -> None:
        """The service has been told to end, and does."""
        self._tell("STOPPING=1")

    def _tell(self, state: str) -> None:
        if not self._address:
            return
        # The service goes on if its manager does not listen.
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as said:
            said.setblocking(False)
            said.sendto(state.encode(), self._address)
