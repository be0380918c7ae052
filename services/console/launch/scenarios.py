"""The scenario of a command with the changes of its flags, and the same flags for the services' processes."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from schemas.topics import Side
from services.console.launch.keys import LaunchKeys, launch_keys
from services.runtime.trust.endpoint_policy import check_endpoint, with_tls

if TYPE_CHECKING:
    from services.mission.scenario import Scenario


@dataclass(frozen=True, slots=True)
class Chosen:
    """A scenario as chosen on the command line."""

    scenario: Scenario
    path: Path
    flags: tuple[str, ...]
    """The flags with which a service loads the same scenario."""
    keys: LaunchKeys | None = None
    """Identities of the processes; None: a mission without TLS."""
    insecure: bool = False
    """Whether endpoints off loopback may be without TLS."""

    def endpoint(self, side: Side) -> str:
        """The endpoint of that side's router as the scenario has it, with TLS if there are keys.

        Raises InvalidInput for one that may not be used without keys.
        """
        network = self.scenario.network
        endpoint = network.moon if side is Side.MOON else network.earth
        if self.keys is not None:
            endpoint = with_tls(endpoint)
        check_endpoint(endpoint, identified=self.keys is not None, insecure=self.insecure)
        return endpoint


def choose(
    reference: str,
    *,
    seed: int | None = None,
    planner: str | None = None,
    rate: float | None = None,
    settings: Iterable[str] = (),
    allow_plugin: bool = False,
    keys: Path | None = None,
    insecure: bool = False,
) -> Chosen:
    """The scenario of a file or of a shipped name, with seed, planner, rate and ``section.key=value`` changed.

    allow_plugin: import a plug-in planner that the scenario's file names. keys: the mission's folder of keys. Raises
    InvalidInput with one line for a scenario, a key or a value that is not valid, and for a folder without the
    identities that the processes need.
    """
    from services.mission.deployment import find_scenario
    from services.mission.scenario import load_scenario
    from services.runtime.options import parse_setting, require_plugin_allowed, with_settings

    path = find_scenario(reference)
    texts = [*settings]
    for key, value in (("seed", seed), ("ground.planner", planner), ("rate", rate)):
        if value is not None:
            texts.append(f"{key}={json.dumps(value)}")
    changes, loaded = [parse_setting(text) for text in texts], load_scenario(path)
    require_plugin_allowed(loaded, changes, allow_plugin)
    flags = (*(word for text in texts for word in ("--set", text)), *(("--allow-plugin",) if allow_plugin else ()))
    identities = None if keys is None else launch_keys(keys)
    return Chosen(with_settings(loaded, changes), path.resolve(), flags, identities, insecure)
