"""Who an operator's session acts for."""

from __future__ import annotations

import getpass
import os
import socket
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from services.runtime.trust.identity import Identity


class Acting:
    """The part of `MissionClient` that says who makes its requests."""

    identity: Identity | None = None
    as_name: str | None = None
    """The name under which this client acts where nothing proves one; None: the user and the machine."""

    @property
    def person(self) -> str:
        """Who acts: the identity's common name, else the name that was given, else the user and the machine."""
        return self.identity.common_name if self.identity is not None else self.as_name or user_and_machine()


def user_and_machine() -> str:
    """The user and the machine of this process, as user@host: what it says of itself, which nothing proves."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):
        user = f"uid-{os.getuid()}"
    return f"{user}@{socket.gethostname()}"[:100]
