"""The drill: a borehole is drilled bite by bite, its cuttings are analysed, and then the instrument is asked."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from schemas.plans import PlannedSample
    from services.runtime.node import SavedState

_ROUNDING_M: Final = 1e-9  # m; a last bite shallower than this is rounding, not drilling


def bites_m(depth_m: float, bite_m: float) -> tuple[float, ...]:
    """Depth [m] of each bite of a hole: full bites, then the remainder."""
    count = max(1, math.ceil((depth_m - _ROUNDING_M) / bite_m))
    return (*(bite_m,) * (count - 1), depth_m - bite_m * (count - 1))


@dataclass(slots=True)
class Borehole:
    """The progress of the work at one planned sample."""

    sample: PlannedSample
    bites_left_m: list[float] = field(default_factory=list)
    analysed: bool = False

    @classmethod
    def begun(cls, sample: PlannedSample, bite_m: float) -> Borehole:
        """A borehole of the sample's depth with nothing drilled yet."""
        return cls(sample, list(bites_m(sample.depth_m, bite_m)))

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {"sample": self.sample, "bites_left_m": list(self.bites_left_m), "analysed": self.analysed}
