"""The score of the map against the reference field, which only a simulated Moon has.

Nothing else on the ground sees the reference: neither belief nor planners do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from he3.errors import InvalidInput
from schemas.maps import MapScore

if TYPE_CHECKING:
    from he3.frames import BoolArray, Float32Array
    from services.mission.mission_time import MissionTime


class Scorer:
    """Compares maps with the reference field (rows, columns) [ppb] over all cells, or those where it is known."""

    def __init__(self, reference_ppb: NDArray[np.floating], known: BoolArray | None = None) -> None:
        reference = np.ascontiguousarray(reference_ppb, dtype=np.float32)
        self._shape = reference.shape
        self._known: slice | BoolArray = slice(None) if known is None else known
        self._reference = reference[self._known]
        self._miss = np.empty_like(self._reference)

    def score(
        self, mean_ppb: Float32Array, std_ppb: Float32Array, revision: int, samples: int, now: MissionTime
    ) -> MapScore:
        """RMSE [ppb], coverage at one and two standard deviations, and mean standard deviation [ppb] of that map."""
        if mean_ppb.shape != self._shape or std_ppb.shape != self._shape:
            raise InvalidInput(f"score: expected maps of shape {self._shape}, got {mean_ppb.shape} and {std_ppb.shape}")
        mean_ppb, std_ppb = mean_ppb[self._known], std_ppb[self._known]
        miss = self._miss
        np.subtract(mean_ppb, self._reference, out=miss)
        np.abs(miss, out=miss)
        cells = miss.size
        within_1 = np.count_nonzero(miss <= std_ppb) / cells
        miss *= np.float32(0.5)
        within_2 = np.count_nonzero(miss <= std_ppb) / cells
        np.square(miss, out=miss)
        # Pairwise sums of float32 are good to 1e-6 here; the factor undoes the halving, squared.
        mean_square = 4.0 * float(miss.mean(dtype=np.float64))
        return MapScore(
            rmse_ppb=mean_square**0.5,
            coverage_68=within_1,
            coverage_95=within_2,
            mean_std_ppb=float(std_ppb.mean(dtype=np.float64)),
            revision=revision,
            samples=samples,
            mission_time_ns=now,
        )
