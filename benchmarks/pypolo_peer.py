"""PyPolo beside our planners: the same field, samples and noise, its own boat and its own attentive kernel.

It runs in a separate environment (benchmarks/peers/requirements-pypolo.txt). Its boat knows no obstacles, so it is
asked for open ground only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.peer_environments import PYPOLO, packed, unpacked
from he3.frames import FloatArray
from he3.reference import Region

PILOT_SHARE = 0.1
"""Share of the samples that its pilot takes along a curve, before it plans."""


@dataclass(frozen=True, slots=True)
class PyPoloSurvey:
    """The samples of one survey, the path that was driven, and PyPolo's own map of it."""

    places_m: FloatArray
    values_ppb: FloatArray
    path_m: FloatArray
    mean_ppb: FloatArray
    std_ppb: FloatArray
    seconds: float


def survey_with_pypolo(
    region: Region, strategy: str, start_m: tuple[float, float], noise_std_ppb: float, noise_ppb: FloatArray, seed: int
) -> PyPoloSurvey:
    """A survey with as many samples as there is noise (n,) [ppb]. strategy: myopic or active."""
    grid, samples = region.grid, len(noise_ppb)
    answer = PYPOLO.ask({
        "strategy": strategy, "field_ppb": packed(region.he3_ppb), "rows": grid.rows, "columns": grid.columns,
        "resolution_m": grid.resolution_m, "start_m": list(start_m), "noise_std_ppb": noise_std_ppb,
        "noise_ppb": noise_ppb.tolist(), "samples": samples, "pilot": max(5, round(PILOT_SHARE * samples)),
        "seed": seed,
    })  # fmt: skip
    places, values, path = (np.array(answer[key]) for key in ("places_m", "values_ppb", "path_m"))
    mean, std = (unpacked(answer[key], grid.shape) for key in ("mean_ppb", "std_ppb"))
    # The boat's turns lead a little over the edge of the site.
    places = np.clip(places, 0.0, np.nextafter([grid.width_m, grid.height_m], 0.0))
    return PyPoloSurvey(places, values, path, mean, std, answer["seconds"])
