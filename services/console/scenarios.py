"""The scenario that a command means, with what its flags change."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from services.scenario import Scenario


def load(
    reference: str,
    *,
    seed: int | None = None,
    planner: str | None = None,
    rate: float | None = None,
    settings: Iterable[str] = (),
) -> Scenario:
    """The scenario of a file or of a shipped name, with seed, planner and ``section.key=value`` settings changed.

    Raises InvalidInput with one line for a scenario, a key or a value that is not right.
    """
    from services.deployment import find_scenario
    from services.options import parse_setting, with_settings
    from services.scenario import load_scenario

    scenario = load_scenario(find_scenario(reference))
    changes = [parse_setting(setting) for setting in settings]
    if seed is not None:
        changes.append(("top", "seed", seed))
    if rate is not None:
        changes.append(("top", "rate", rate))
    if planner is not None:
        changes.append(("ground", "planner", planner))
    return with_settings(scenario, changes)
