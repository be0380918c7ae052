"""The flags that choose the mission that a command flies: its scenario with changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from services.console.cli.flag_groups import FlagGroup
from services.console.cli.options import AllowPlugin, Keys, Planner, Rate, Seed, Settings
from services.console.cli.session import Insecure

if TYPE_CHECKING:
    from services.console.launch.scenarios import Chosen


@dataclass(frozen=True, slots=True)
class MissionFlags(FlagGroup):
    """What is changed of a scenario, and who may reach its processes."""

    rate: Rate = None
    seed: Seed = None
    planner: Planner = None
    settings: Settings = None
    allow_plugin: AllowPlugin = False
    keys: Keys = None
    insecure: Insecure = False

    def chosen(self, scenario: str) -> Chosen:
        """That scenario, a file or the name of a shipped one, with the changes. Raises InvalidInput."""
        from services.console.launch.scenarios import choose

        return choose(
            scenario,
            seed=self.seed,
            planner=self.planner,
            rate=self.rate,
            settings=self.settings or (),
            allow_plugin=self.allow_plugin,
            keys=self.keys,
            insecure=self.insecure,
        )
