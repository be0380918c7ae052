"""The rover's state machine, whole: a table of (state, trigger) -> state, and the reasons that hold the rover.

A transition that the table does not hold is an error in the program. No input from outside can ask for one.
"""

from __future__ import annotations

from enum import Enum, StrEnum
from typing import Final

from schemas.telemetry import RoverMode


class State(StrEnum):
    """The rover's internal state, in more detail than the mode that it reports."""

    IDLE = "idle"
    """Landed, and no plan accepted yet."""
    SCANNING = "scanning"
    """Standing, waiting for the terrain ahead."""
    DRIVING = "driving"
    DRILLING = "drilling"
    ANALYSING = "analysing"
    """The oven heats the cuttings."""
    MEASURING = "measuring"
    """Waiting for the instrument's value."""
    PAUSED = "paused"
    CHARGING = "charging"
    """Safe because energy is low; continues by itself."""
    SAFE = "safe"
    PARKED = "parked"


class Trigger(StrEnum):
    """The causes of a change of state."""

    SCAN = "scan the path ahead"
    PATH_CLEAR = "the path ahead is clear"
    DRILL = "drill a bite"
    DEPTH_REACHED = "the hole has reached its depth"
    ANALYSIS_DONE = "the analysis is done"
    PAUSE = "pause"
    LOW_ENERGY = "energy is low"
    ENTER_SAFE_MODE = "enter safe mode"
    QUEUE_EMPTY = "nothing is left to do"


HELD: Final = frozenset({State.PAUSED, State.CHARGING, State.SAFE})
"""States in which a hold keeps the rover from continuing its activity."""

STANDING: Final = HELD | {State.IDLE, State.PARKED}
"""States in which the rover stands until a new input arrives."""

INTERRUPTIBLE: Final = STANDING | {State.SCANNING, State.MEASURING}
"""States in which a telecommand is executed at once: no step has to be finished first."""

SAFE_POINTS: Final = INTERRUPTIBLE | {State.DRIVING, State.DRILLING, State.ANALYSING}
"""States that can be left for another activity. That is every state: a drive, a bite and an analysis are left only at
their end."""

TRANSITIONS: Final[dict[tuple[State, Trigger], State]] = {
    # A path section: after the last one, after a hole, after a hold, and from any safe point for a commanded drive.
    **{(state, Trigger.SCAN): State.SCANNING for state in SAFE_POINTS},
    (State.SCANNING, Trigger.PATH_CLEAR): State.DRIVING,
    # A hole: on arrival, bite after bite, again after a hold, or at the place of the last hole.
    **{(state, Trigger.DRILL): State.DRILLING for state in STANDING},
    (State.DRIVING, Trigger.DRILL): State.DRILLING,
    (State.DRILLING, Trigger.DRILL): State.DRILLING,
    (State.MEASURING, Trigger.DRILL): State.DRILLING,
    # The analysis and the measurement of its cuttings; after a hold they continue where they were left.
    (State.DRILLING, Trigger.DEPTH_REACHED): State.ANALYSING,
    **{(state, Trigger.DEPTH_REACHED): State.ANALYSING for state in HELD},
    (State.ANALYSING, Trigger.ANALYSIS_DONE): State.MEASURING,
    (State.MEASURING, Trigger.ANALYSIS_DONE): State.MEASURING,
    **{(state, Trigger.ANALYSIS_DONE): State.MEASURING for state in HELD},
    # Holds. A held state lasts until the next step, also after its hold was released: then any other hold may follow.
    # That a pause does not override safe mode is a matter of the hold, and of the telecommand.
    **{(state, Trigger.PAUSE): State.PAUSED for state in SAFE_POINTS},
    **{(state, Trigger.LOW_ENERGY): State.CHARGING for state in SAFE_POINTS},
    **{(state, Trigger.ENTER_SAFE_MODE): State.SAFE for state in SAFE_POINTS},
    # Nothing is left to do.
    **{(state, Trigger.QUEUE_EMPTY): State.PARKED for state in SAFE_POINTS},
}

MODES: Final[dict[State, RoverMode]] = {
    State.IDLE: RoverMode.IDLE,
    State.SCANNING: RoverMode.DRIVING,
    State.DRIVING: RoverMode.DRIVING,
    State.DRILLING: RoverMode.DRILLING,
    State.ANALYSING: RoverMode.ANALYSING,
    State.MEASURING: RoverMode.ANALYSING,
    State.PAUSED: RoverMode.PAUSED,
    State.CHARGING: RoverMode.CHARGING,
    State.SAFE: RoverMode.SAFE,
    State.PARKED: RoverMode.PARKED,
}
"""The mode that is reported for each state."""


class Hold(Enum):
    """Why the rover stands although it may have something to do."""

    PAUSE = "pause"
    ENERGY = "low energy"
    COMMAND = "commanded"
    TERRAIN = "terrain contradicts the plan"
    SILENCE = "no message from the ground"
    SPENT = "a step needs more energy than there will be"


ENDED_BY_PLAN: Final = frozenset({Hold.TERRAIN, Hold.SILENCE, Hold.SPENT})
"""Safe modes that a newer plan ends. Only an operator ends a hold that an operator commanded."""

HOLD_TRIGGERS: Final[dict[Hold, Trigger]] = {
    Hold.PAUSE: Trigger.PAUSE,
    Hold.ENERGY: Trigger.LOW_ENERGY,
    Hold.COMMAND: Trigger.ENTER_SAFE_MODE,
    Hold.TERRAIN: Trigger.ENTER_SAFE_MODE,
    Hold.SILENCE: Trigger.ENTER_SAFE_MODE,
    Hold.SPENT: Trigger.ENTER_SAFE_MODE,
}


class IllegalTransition(Exception):
    """The program asked for a transition that the table does not hold: an error in the program, not in its input."""


def next_state(state: State, trigger: Trigger) -> State:
    """The state that follows; raises IllegalTransition, naming state and trigger, if the table holds none."""
    try:
        return TRANSITIONS[state, trigger]
    except KeyError:
        raise IllegalTransition(f"rover: state '{state}' does not admit '{trigger}'") from None
