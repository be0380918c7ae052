"""Random impairments of one direction: loss, jitter, reordering, duplication and corruption.

Every packet takes the same number of draws, so that a change of one condition leaves the draws for all others as they
were.
"""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING

from services.mission.mission_time import MissionTime, seconds

if TYPE_CHECKING:
    from schemas.link import DirectionConditions

_MAX_CORRUPTED_BYTES = 4  # of one payload


@dataclass(frozen=True, slots=True)
class Draws:
    """The random draws for one packet, each uniform in [0, 1); `corruption` seeds the changes of the payload."""

    corruption: int
    loss: float
    jitter: float
    reorder: float
    reorder_delay: float
    duplicate: float
    duplicate_delay: float
    corrupt: float

    @classmethod
    def of(cls, generator: Random) -> Draws:
        corruption = generator.getrandbits(64)
        return cls(corruption, *(generator.random() for _ in range(7)))


@dataclass(frozen=True, slots=True)
class Transit:
    """The passage of one packet that is not lost."""

    payload: bytes
    corrupted: bool
    reordered: bool
    """Whether later packets may overtake it."""
    delays: tuple[MissionTime, ...]
    """Delay of each copy, from its last bit sent to its last bit received [ns]."""


def transit(
    payload: bytes, conditions: DirectionConditions, draws: Draws, earliest_delay: MissionTime
) -> Transit | None:
    """The passage of a payload under those conditions and draws; None if it is lost.

    earliest_delay: with jitter, the shortest delay [ns] that does not overtake the packet before.
    """
    if draws.loss < conditions.loss:
        return None
    light_time = seconds(conditions.one_way_light_time_s)
    jitter = round(seconds(conditions.jitter_s) * (2 * draws.jitter - 1))
    delay = max(0, light_time + jitter)
    if conditions.jitter_s > 0:
        delay = max(delay, earliest_delay)
    corrupted = draws.corrupt < conditions.corrupt and bool(payload)
    if corrupted:
        payload = corrupt(payload, Random(draws.corruption))
    reordered = draws.reorder < conditions.reorder
    if reordered:
        delay += round(light_time * draws.reorder_delay)
    delays = [delay]
    if draws.duplicate < conditions.duplicate:
        delays.append(delay + round(light_time * draws.duplicate_delay))
    return Transit(payload, corrupted, reordered, tuple(delays))


def corrupt(payload: bytes, generator: Random) -> bytes:
    """The payload with one to four bytes changed."""
    changed = bytearray(payload)
    count = min(len(payload), generator.randint(1, _MAX_CORRUPTED_BYTES))
    for position in generator.sample(range(len(payload)), count):
        changed[position] ^= generator.randint(1, 255)
    return bytes(changed)
