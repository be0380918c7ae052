"""The identity with which an operator's command joins a mission: the named one, or one found on this machine."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from services.console.client.run_file import announced_as
from services.runtime.trust.endpoint_policy import check_endpoint, is_encrypted

if TYPE_CHECKING:
    from services.runtime.trust.identity import Identity

IDENTITY = "HE3_IDENTITY"
"""Environment variable with the folder of the identity, for missions with TLS."""


@dataclass(frozen=True, slots=True)
class Credentials:
    """The identity that a client presents to the router."""

    identity: Identity | None
    """The identity for TLS; None for a mission without TLS."""
    warning: str | None
    """One line of warning if every client that reaches the mission may command it; else None."""
    recording: str = ""
    """The recording that is served in place of a running mission, by its announcement here; empty for one that runs."""


def credentials_for(earth: str, mission: str, identity: Path | None = None, *, insecure: bool = False) -> Credentials:
    """The credentials for that Earth endpoint and mission.

    identity: a folder; else that of `HE3_IDENTITY`, else the viewer's of a mission that this user runs on this machine.
    The latter two count only for an endpoint with TLS. Raises InvalidInput for a folder without a valid identity,
    and for an endpoint that may not be used.
    """
    running = announced_as(earth, mission)
    folder = identity
    if folder is None and is_encrypted(earth):
        named = os.environ.get(IDENTITY) or ("" if running is None else running.viewer)
        folder = Path(named) if named else None
    allowed = insecure or (running is not None and running.insecure)
    warning = check_endpoint(earth, identified=folder is not None, insecure=allowed)
    if warning is None and running is not None and running.insecure:
        warning = check_endpoint(running.moon, identified=bool(running.viewer), insecure=True)
    recording = "" if running is None else running.recording
    if folder is None:
        return Credentials(None, warning, recording)
    from services.runtime.trust.identity import load_identity

    return Credentials(load_identity(folder), warning, recording)
