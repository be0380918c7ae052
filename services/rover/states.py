"""The executive's state machine, whole: what the rover may turn to from what it is doing.

Each row reads: in this phase, upon this, go to that phase. What is not in the table is a mistake of the program's and
never a reaction to anything that came from outside.
"""

from __future__ import annotations

from enum import Enum, StrEnum
from typing import Final

from schemas.telemetry import RoverMode


class Phase(StrEnum):
    """What the rover is doing, finer than the mode that it reports."""

    IDLE = "idle"
    """Landed, and never given a plan."""
    LOOKING = "looking"
    """Standing, waiting for the terrain ahead."""
    DRIVING = "driving"
    DRILLING = "drilling"
    ANALYSING = "analysing"
    """The oven is at work."""
    MEASURING = "measuring"
    """Waiting for the instrument's number."""
    PAUSED = "paused"
    CHARGING = "charging"
    """Safe for want of energy; goes on by itself."""
    SAFE = "safe"
    PARKED = "parked"


class Trigger(StrEnum):
    """What makes the rover turn to something else."""

    LOOK = "look at the way ahead"
    WAY_CLEAR = "the way ahead is clear"
    DRILL = "drill a bite"
    HOLE_DONE = "the hole is deep enough"
    ANALYSED = "the analysis is over"
    PAUSE = "pause"
    RUN_LOW = "energy would run low"
    DANGER = "go safe"
    NOTHING_LEFT = "nothing is left to do"


HELD: Final = frozenset({Phase.PAUSED, Phase.CHARGING, Phase.SAFE})
"""Where something keeps the rover from going on with what it was about."""

STANDING: Final = HELD | {Phase.IDLE, Phase.PARKED}
"""Where it stands still until something new comes."""

INTERRUPTIBLE: Final = STANDING | {Phase.LOOKING, Phase.MEASURING}
"""Where it need not finish anything before it carries out a telecommand."""

SAFE_POINTS: Final = INTERRUPTIBLE | {Phase.DRIVING, Phase.DRILLING, Phase.ANALYSING}
"""Where it may turn to something else: anywhere, since a piece, a bite and an analysis are left at their end only."""

TABLE: Final[dict[tuple[Phase, Trigger], Phase]] = {
    # A piece of way: after the last one, after a hole, out of a hold, and from any safe point when an errand comes.
    **{(phase, Trigger.LOOK): Phase.LOOKING for phase in SAFE_POINTS},
    (Phase.LOOKING, Trigger.WAY_CLEAR): Phase.DRIVING,
    # A hole: on arrival, bite after bite, again after a hold, or right where the last one was.
    **{(phase, Trigger.DRILL): Phase.DRILLING for phase in STANDING},
    (Phase.DRIVING, Trigger.DRILL): Phase.DRILLING,
    (Phase.DRILLING, Trigger.DRILL): Phase.DRILLING,
    (Phase.MEASURING, Trigger.DRILL): Phase.DRILLING,
    # Its analysis, and the number that comes of it; after a hold, where they were left.
    (Phase.DRILLING, Trigger.HOLE_DONE): Phase.ANALYSING,
    **{(phase, Trigger.HOLE_DONE): Phase.ANALYSING for phase in HELD},
    (Phase.ANALYSING, Trigger.ANALYSED): Phase.MEASURING,
    (Phase.MEASURING, Trigger.ANALYSED): Phase.MEASURING,
    **{(phase, Trigger.ANALYSED): Phase.MEASURING for phase in HELD},
    # Holds. Safe mode is stronger than a pause.
    **{(phase, Trigger.PAUSE): Phase.PAUSED for phase in SAFE_POINTS - {Phase.SAFE}},
    **{(phase, Trigger.RUN_LOW): Phase.CHARGING for phase in SAFE_POINTS - {Phase.CHARGING}},
    **{(phase, Trigger.DANGER): Phase.SAFE for phase in SAFE_POINTS},
    # The end of what there was to do.
    **{(phase, Trigger.NOTHING_LEFT): Phase.PARKED for phase in SAFE_POINTS},
}

MODES: Final[dict[Phase, RoverMode]] = {
    Phase.IDLE: RoverMode.IDLE,
    Phase.LOOKING: RoverMode.DRIVING,
    Phase.DRIVING: RoverMode.DRIVING,
    Phase.DRILLING: RoverMode.DRILLING,
    Phase.ANALYSING: RoverMode.ANALYSING,
    Phase.MEASURING: RoverMode.ANALYSING,
    Phase.PAUSED: RoverMode.PAUSED,
    Phase.CHARGING: RoverMode.CHARGING,
    Phase.SAFE: RoverMode.SAFE,
    Phase.PARKED: RoverMode.PARKED,
}
"""What the rover reports for each phase."""


class Hold(Enum):
    """Why the rover stands still although it may have something to do."""

    PAUSE = "pause"
    ENERGY = "low energy"
    COMMAND = "told to be safe"
    TERRAIN = "terrain contradicts the plan"
    SILENCE = "no word from the ground"
    SPENT = "a step needs more energy than there will be"


ENDED_BY_PLAN: Final = frozenset({Hold.TERRAIN, Hold.SILENCE, Hold.SPENT})
"""Safe modes that a newer plan ends; what an operator ordered, only an operator ends."""

HOLD_TRIGGERS: Final[dict[Hold, Trigger]] = {
    Hold.PAUSE: Trigger.PAUSE,
    Hold.ENERGY: Trigger.RUN_LOW,
    Hold.COMMAND: Trigger.DANGER,
    Hold.TERRAIN: Trigger.DANGER,
    Hold.SILENCE: Trigger.DANGER,
    Hold.SPENT: Trigger.DANGER,
}


class IllegalTransition(Exception):
    """The program asked for what the table does not hold: a mistake in it, not a reaction to input."""


def after(phase: Phase, trigger: Trigger) -> Phase:
    """The phase that follows; raises IllegalTransition, naming phase and trigger, when the table holds none."""
    try:
        return TABLE[phase, trigger]
    except KeyError:
        raise IllegalTransition(f"rover: phase '{phase}' does not admit '{trigger}'") from None
