"""Open ground without its steepest cells, for planners that weigh what terrain costs.

The cost alone does not keep a way off a few steep cells: one of 15 deg costs little more than one of 12. So a small
share of the ground, the steepest, is left out where that cuts nothing else off.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from services.ground.planners.interface import PlanningRequest

KEPT: Final = (0.97, 0.98, 0.99, 0.995)
"""Shares of the reachable ground that are tried, the least first."""
CUT_OFF: Final = 0.01
"""Largest share of the reachable ground that may be cut off by the steepest one."""


def on_gentle_ground(request: PlanningRequest) -> PlanningRequest:
    """The request without the steepest ground; the request itself without a cost, or if too much would be cut off."""
    cost = request.cost
    rows, columns = request.grid.cells_of(np.array([request.start_m]))
    here = int(rows[0]), int(columns[0])
    if cost is None or not request.traversable[here]:
        return request
    labels, _ = ndimage.label(request.traversable)
    reachable = labels == labels[here]
    total = int(np.count_nonzero(reachable))
    for kept in KEPT:
        limit_deg = float(np.quantile(cost.slope_deg[reachable], kept))
        gentle = reachable & (cost.slope_deg <= limit_deg)
        gentle[here] = True
        labels, _ = ndimage.label(gentle)
        still = labels == labels[here]
        if np.count_nonzero(still) >= (kept - CUT_OFF) * total:
            return replace(request, traversable=still)
    return request
