"""The displays of a mission, for which its services wait at its end, so that each of them has the last map.

A display declares a liveliness token while it follows the mission, and ends the token when it has what it shows of the
end. A command that ends the services with the mission, as ``he3 run`` does, waits a moment until all tokens are gone. A
display that dies takes its token with it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from schemas.topics import DISPLAYS, Side

if TYPE_CHECKING:
    from services.runtime.transport.client import Client


class Displays:
    """The displays that do not have the end of the mission yet."""

    def __init__(self) -> None:
        self._names: set[str] = set()
        self._changed = threading.Condition()

    def seen(self, name: str, here: bool) -> None:
        """Note that the display of that name appeared or disappeared."""
        with self._changed:
            (self._names.add if here else self._names.discard)(name)
            self._changed.notify_all()

    def wait_until_gone(self, within_s: float) -> tuple[str, ...]:
        """Wait until no display is left, for that wall time [s] at most; the names of those that are."""
        until = time.monotonic() + within_s
        with self._changed:
            self._changed.wait_for(lambda: not self._names, max(0.0, until - time.monotonic()))
            return tuple(sorted(self._names))


class Displaying:
    """The part of `MissionClient` that concerns displays."""

    _session: Client

    def declare_display(self) -> Callable[[], None]:
        """Say that this client needs the services to the mission's end.

        Returns the function that takes it back, when the client has what it shows of the end; the end of the session
        does so, too.
        """
        return self._session.declare_display()

    def displays(self) -> Displays:
        """The displays that follow the mission, kept up to date from now on."""
        displays = Displays()
        self._session.watch_alive(Side.EARTH, displays.seen, DISPLAYS)
        return displays
