"""The score of the map against the reference field, which only a simulated Moon has.

Nothing else on the ground sees the reference: neither belief nor planners do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from he3.errors import InvalidInput
from he3.intervals import NORMAL_ENDS
from schemas.maps import MapScore, ReachScore

if TYPE_CHECKING:
    from he3.frames import BoolArray, Float32Array
    from services.mission.mission_time import MissionTime


class Scorer:
    """Compares maps with the reference field (rows, columns) [ppb] over all cells, or those where it is known."""

    def __init__(
        self,
        reference_ppb: NDArray[np.floating],
        known: BoolArray | None = None,
        within_reach: BoolArray | None = None,
    ) -> None:
        """known, within_reach: (rows, columns), where the reference is known, and where the rover can go."""
        reference = np.ascontiguousarray(reference_ppb, dtype=np.float32)
        self._shape = reference.shape
        self._known: slice | BoolArray = slice(None) if known is None else known
        self._reference = reference[self._known]
        self._miss = np.empty_like(self._reference)
        # On ground that no sample can come from, the map is an extrapolation: its error says little of the samples.
        reached = None if within_reach is None else within_reach[self._known]
        self._reached = reached if reached is not None and 0 < np.count_nonzero(reached) < reached.size else None

    def score(
        self,
        mean_ppb: Float32Array,
        std_ppb: Float32Array,
        revision: int,
        samples: int,
        now: MissionTime,
        ends: Float32Array | None = None,
    ) -> MapScore:
        """RMSE [ppb], coverage of the central intervals, and mean standard deviation [ppb] of that map.

        ends: (4, rows, columns) of the intervals of 68.3 and 95.4 %, as ``he3.intervals`` gives them; None for a map
        that is normal in every cell. Raises InvalidInput for maps of another shape than the reference.
        """
        if mean_ppb.shape != self._shape or std_ppb.shape != self._shape:
            raise InvalidInput(f"score: expected maps of shape {self._shape}, got {mean_ppb.shape} and {std_ppb.shape}")
        mean_ppb, std_ppb = mean_ppb[self._known], std_ppb[self._known]
        miss = self._miss
        np.subtract(self._reference, mean_ppb, out=miss)
        reach = NORMAL_ENDS if ends is None else [end[self._known] for end in ends]
        held_2, held_1 = (
            (miss >= low * std_ppb) & (miss <= high * std_ppb)
            for low, high in ((reach[0], reach[3]), (reach[1], reach[2]))
        )
        np.square(miss, out=miss)
        # Pairwise sums of float32 are good to 1e-6 here.
        mean_square = float(miss.mean(dtype=np.float64))
        reached, within_reach = self._reached, None
        if reached is not None:
            within_reach = ReachScore(
                share=float(reached.mean()),
                rmse_ppb=float(miss[reached].mean(dtype=np.float64)) ** 0.5,
                coverage_68=float(held_1[reached].mean()),
                coverage_95=float(held_2[reached].mean()),
            )
        return MapScore(
            rmse_ppb=mean_square**0.5,
            coverage_68=np.count_nonzero(held_1) / miss.size,
            coverage_95=np.count_nonzero(held_2) / miss.size,
            mean_std_ppb=float(std_ppb.mean(dtype=np.float64)),
            revision=revision,
            samples=samples,
            mission_time_ns=now,
            within_reach=within_reach,
        )
