"""The operator's side: command line, web page and pictures, and `MissionClient` for Python programs.

`client` reaches a mission, `launch` starts one, `report` writes what it leaves, `cli` and `web` adapt these for people.
The console stands above all services and may import them; no service imports it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from services.console.client.mission_client import MissionClient

__all__ = ["MissionClient"]


def __getattr__(name: str) -> Any:
    # Imported on demand: the command line starts without Zenoh.
    if name == "MissionClient":
        from services.console.client.mission_client import MissionClient

        return MissionClient
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
