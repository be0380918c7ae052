"""The rover's state table: every transition is the one intended, and no other is admitted."""

from __future__ import annotations

import itertools

import pytest

from services.rover.states import MODES, TRANSITIONS, IllegalTransition, State, Trigger, next_state

LEGAL = {
    "idle": "scan drill pause low_energy enter_safe_mode queue_empty",
    "scanning": "scan path_clear pause low_energy enter_safe_mode queue_empty",
    "driving": "scan drill pause low_energy enter_safe_mode queue_empty",
    "drilling": "scan drill depth_reached pause low_energy enter_safe_mode queue_empty",
    "analysing": "scan analysis_done pause low_energy enter_safe_mode queue_empty",
    "measuring": "scan drill analysis_done pause low_energy enter_safe_mode queue_empty",
    "paused": "scan drill depth_reached analysis_done pause low_energy enter_safe_mode queue_empty",
    "charging": "scan drill depth_reached analysis_done pause low_energy enter_safe_mode queue_empty",
    "safe": "scan drill depth_reached analysis_done pause low_energy enter_safe_mode queue_empty",
    "parked": "scan drill pause low_energy enter_safe_mode queue_empty",
}
LEADS_TO = {
    "scan": State.SCANNING,
    "path_clear": State.DRIVING,
    "drill": State.DRILLING,
    "depth_reached": State.ANALYSING,
    "analysis_done": State.MEASURING,
    "pause": State.PAUSED,
    "low_energy": State.CHARGING,
    "enter_safe_mode": State.SAFE,
    "queue_empty": State.PARKED,
}


@pytest.mark.parametrize(("state", "trigger"), list(itertools.product(State, Trigger)))
def test_every_transition_is_the_one_intended_or_is_refused_naming_state_and_trigger(state, trigger):
    if trigger.name.lower() in LEGAL[state.value].split():
        assert next_state(state, trigger) is LEADS_TO[trigger.name.lower()]
    else:
        with pytest.raises(IllegalTransition, match=rf"'{state.value}' does not admit '{trigger.value}'"):
            next_state(state, trigger)


def test_every_state_can_be_reached_and_left_and_has_a_mode():
    assert set(TRANSITIONS.values()) | {State.IDLE} == set(State)
    assert {state for state, _ in TRANSITIONS} == set(State) == set(MODES)
