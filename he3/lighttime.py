"""One-way light time between Earth and Moon, by distance and by named case."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Final

from he3.constants import MOON_DISTANCE_MEAN_M, SPEED_OF_LIGHT_M_S
from he3.errors import InvalidInput


def light_time_s(distance_m: float) -> float:
    """One-way light time [s] over a distance [m]; raises InvalidInput for a negative or infinite distance."""
    if not (math.isfinite(distance_m) and distance_m >= 0):
        raise InvalidInput(f"expected a finite distance of at least 0 m, got {distance_m}")
    return distance_m / SPEED_OF_LIGHT_M_S


NOMINAL_LIGHT_TIME_S: Final = 1.28  # s, one way, mean distance of 384,400 km (1.2822 s), as usually quoted

# One-way light time [s] of each named case. Round trips studied by agencies: 6 and 8 s (NASA), 10 s (CSA).
PRESET_LIGHT_TIMES_S: Final = MappingProxyType(
    {
        "nominal": NOMINAL_LIGHT_TIME_S,
        "zero": 0.0,
        "agency-6s": 3.0,  # half of a 6 s round trip
        "agency-8s": 4.0,  # half of an 8 s round trip
        "csa-10s": 5.0,  # half of a 10 s round trip
        "farside-relay": 1.7,  # through a halo orbiter beyond the Moon
        "polar-window": NOMINAL_LIGHT_TIME_S,  # the distance is nominal, the contact is not
        "lossy": NOMINAL_LIGHT_TIME_S,  # the distance is nominal, the channel is not
        "mars": 1200.0,  # 20 min, a stress case
    }
)


def preset_light_time_s(name: str) -> float:
    """One-way light time [s] of a named case; raises InvalidInput, listing the names, for an unknown one."""
    try:
        return PRESET_LIGHT_TIMES_S[name]
    except KeyError:
        known = ", ".join(PRESET_LIGHT_TIMES_S)
        raise InvalidInput(f"expected a light-time preset among {known}, got {name!r}") from None


MEAN_LIGHT_TIME_S: Final = light_time_s(MOON_DISTANCE_MEAN_M)  # s, one way at the mean distance
