"""Link conditions by name: those that space agencies have used or studied, and stress cases.

[read]: read at its source; [calc]: computed; [assumed]: a working figure that is not verified.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

from he3.errors import InvalidInput
from he3.lighttime import MEAN_LIGHT_TIME_S, preset_light_time_s
from schemas.link import DirectionConditions, DutyCycle, LinkConditions

_DAY_S: Final = 86_400.0
_MEAN_S: Final = round(
    MEAN_LIGHT_TIME_S, 3
)  # s, 1.282 one way at the mean distance, as in the nominal scenarios [calc]
_AT_THE_MEAN: Final = frozenset({"nominal", "polar-window", "lossy"})
_VIPER_UP_BIT_S: Final = 2_000.0  # bit/s direct from Earth to a VIPER-like rover [assumed]
_VIPER_DOWN_BIT_S: Final = 256_000.0  # bit/s direct to Earth from a VIPER-like rover [assumed]
_CSA_DOWN_BIT_S: Final = 300_000.0  # bit/s, the most that the CSA's study allowed down [read]
_QUEQIAO_UP_BIT_S: Final = 125.0  # bit/s, Queqiao to a rover [read]
_QUEQIAO_DOWN_BIT_S: Final = 140_000.0  # bit/s, a rover's middle return rate to Queqiao (0.7, 140, 285 kbit/s) [read]
_SIDEREAL_MONTH_S: Final = (
    2_360_591.0  # s, 27.32166 days, in which the Moon's libration, and so the Earth's height, repeats
)
_POLAR_CONTACT: Final = 0.51  # share of the time that the best south-pole site sees the Earth [read]
_BEFORE_LOSS_S: Final = 1.0 * _DAY_S  # s of contact left at the start, so that the mission meets its end [assumed]


def _light_time_s(name: str) -> float:
    return _MEAN_S if name in _AT_THE_MEAN else preset_light_time_s(name)


def _both(name: str, up_bit_s: float | None = None, down_bit_s: float | None = None) -> LinkConditions:
    light_time_s = _light_time_s(name)
    return LinkConditions(
        up=DirectionConditions(one_way_light_time_s=light_time_s, rate_bit_s=up_bit_s),
        down=DirectionConditions(one_way_light_time_s=light_time_s, rate_bit_s=down_bit_s),
    )


def _lossy() -> LinkConditions:
    channel = DirectionConditions(
        one_way_light_time_s=_light_time_s("lossy"),
        jitter_s=0.05,
        loss=0.3,
        duplicate=0.05,
        reorder=0.1,
        corrupt=0.05,
    )
    return LinkConditions(up=channel, down=channel)


def _polar_window() -> LinkConditions:
    contact_s = float(round(_POLAR_CONTACT * _SIDEREAL_MONTH_S))
    cycle = DutyCycle(
        period_s=_SIDEREAL_MONTH_S, contact_s=contact_s, offset_s=_SIDEREAL_MONTH_S - contact_s + _BEFORE_LOSS_S
    )
    return _both("polar-window", _VIPER_UP_BIT_S, _VIPER_DOWN_BIT_S).model_copy(update={"duty_cycle": cycle})


PRESETS: Final = MappingProxyType(
    {
        "nominal": _both("nominal"),
        "zero": _both("zero"),
        "agency-6s": _both("agency-6s"),
        "agency-8s": _both("agency-8s"),
        "csa-10s": _both("csa-10s", down_bit_s=_CSA_DOWN_BIT_S),
        "farside-relay": _both("farside-relay", _QUEQIAO_UP_BIT_S, _QUEQIAO_DOWN_BIT_S),
        "polar-window": _polar_window(),
        "lossy": _lossy(),
        "mars": _both("mars"),
    }
)
"""Link conditions by name."""

PROVENANCE: Final = MappingProxyType(
    {
        "nominal": "1.282 s one way, the mean distance of 384,400 km [calc]; no other limits",
        "zero": "no delay, no limits: for comparison",
        "agency-6s": "round trip of 6 s, as studied by NASA [read]",
        "agency-8s": "round trip of 8 s, as studied by NASA [read]",
        "csa-10s": "round trip of 10 s with at most 300 kbit/s down, as the CSA has studied [read]",
        "farside-relay": "1.7 s one way through a halo relay [calc]; 125 bit/s up, 140 kbit/s down, as Queqiao [read]",
        "polar-window": "a south-pole site that sees the Earth 51 % of a month [read], one day before it sets; "
        "2 kbit/s up, 256 kbit/s down, as VIPER [assumed]",
        "lossy": "1.282 s one way; 30 % lost, 5 % doubled, 10 % out of order, 5 % damaged [assumed]: a stress case",
        "mars": "20 minutes one way: a stress case",
    }
)
"""Provenance of each, in one line."""


def preset(name: str) -> LinkConditions:
    """The conditions of that name; raises InvalidInput, listing the names, for an unknown one."""
    try:
        return PRESETS[name]
    except KeyError:
        raise InvalidInput(f"expected a link preset among {', '.join(PRESETS)}, got {name!r}") from None
