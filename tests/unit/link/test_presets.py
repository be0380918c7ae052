"""The link presets and the shipped scenarios."""

from pathlib import Path

import pytest

from schemas.link import LinkStatus
from services.link.node import build_node
from services.mission.link_presets import PRESETS
from services.mission.scenario import load_scenario
from services.runtime.node import SendIfHeard, Started

SCENARIOS = Path(__file__).parents[3] / "deploy" / "scenarios"
NAMES = {"nominal": "t1", "zero": "t1-zero-delay"}


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_shipped_as_a_scenario_with_the_same_link(name: str) -> None:
    scenario = load_scenario(SCENARIOS / f"{NAMES.get(name, f't1-{name}')}.toml")
    assert scenario.link == PRESETS[name]


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.toml")), ids=lambda path: path.stem)
def test_the_link_of_every_shipped_scenario_starts_in_contact(path: Path) -> None:
    scenario = load_scenario(path)
    assert scenario.name == path.stem
    effects = list(build_node(scenario).handle(Started(1), scenario.start_ns))
    (status,) = [effect.make() for effect in effects if isinstance(effect, SendIfHeard)]
    assert isinstance(status, LinkStatus)
    assert status.contact
