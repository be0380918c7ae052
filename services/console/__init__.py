"""The operator: command line, pictures and web page; `MissionClient` for whoever asks from Python."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from services.console.client.mission_client import MissionClient

__all__ = ["MissionClient"]


def __getattr__(name: str) -> Any:
    # Only on demand: the command line starts with what it needs.
    if name == "MissionClient":
        from services.console.client.mission_client import MissionClient

        return MissionClient
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
