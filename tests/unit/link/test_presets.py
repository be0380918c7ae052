"""The link presets and the shipped scenarios."""

from pathlib import Path

import pytest

from schemas.link import DirectionConditions, DutyCycle, LinkChange, LinkConditions, LinkStatus
from services.link.node import build_node
from services.link.relay import described
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


@pytest.mark.parametrize(
    ("preset", "said"),
    [
        ("nominal", "all conditions replaced (light time 1.282 s)"),
        ("zero", "all conditions replaced (light time 0 s)"),
        ("mars", "all conditions replaced (light time 1200 s"),
        ("lossy", "loss 0.3"),
    ],
)
def test_the_log_says_by_which_conditions_all_were_replaced(preset: str, said: str) -> None:
    assert said in described(LinkChange(conditions=PRESETS[preset]))


def test_conditions_that_differ_by_direction_and_their_contact_are_said() -> None:
    conditions = LinkConditions(
        up=DirectionConditions(rate_bit_s=2000.0),
        down=DirectionConditions(loss=0.1),
        duty_cycle=DutyCycle(period_s=7200.0, contact_s=3600.0),
    )
    assert described(LinkChange(conditions=conditions)) == (
        "all conditions replaced (up: light time 1.282 s, data rate 2,000 bit/s; down: light time 1.282 s, loss 0.1; "
        "contact 3,600 s of every 7,200 s)"
    )
