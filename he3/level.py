"""The level of the field, which is unknown before landing, and on a wide site not the same everywhere.

The means of landing sites differ by 4 ppb (``he3.hyperprior``). Two places 30 km apart may lie on soils as different as
those of two landing sites; two places 300 m apart do not. So the level is a Gaussian process of its own, with that
standard deviation and with an exponential covariance over ``LEVEL_LENGTH_M``:

    cov(level(a), level(b)) = std^2 exp(-|a - b| / LEVEL_LENGTH_M)

Samples therefore say little of the level at places many kilometres away, however well they agree with each other: away
from them the map returns to what is known of lunar soils, with its uncertainty. A constant level would be known
everywhere, and ground that cannot be reached would be taken for like ground.

The process is written as a trend, a sum of columns with unknown coefficients: its principal components on a lattice
over the site, continued by Nystroem's formula (Rasmussen & Williams 2006, sect. 4.3.2 and 8.1). Components of little
variance are left out; they are narrow, and the kernel describes the field at their scale. The columns are scaled to the
level's variance at every place. On a site of less than ``NARROW_M`` the one component is the constant.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.spatial.distance import cdist

from he3.frames import FloatArray, as_points

LEVEL_LENGTH_M = 20_000.0  # m, between the width of a mare valley and that of a mare [assumed]
NARROW_M = LEVEL_LENGTH_M / 20.0  # m, width of a site on which the level differs by less than a third of its std
LEAST_SHARE = 0.0025  # 1, variance of a component that is left out, as a share of the level's
_PER_AXIS = 9  # 1, lattice points


def level_columns(points_m: FloatArray, extent_m: float) -> FloatArray:
    """Columns (N, p) at places (N, 2) [m] whose outer product is the level's correlation over a site of that width."""
    if extent_m < NARROW_M:
        return np.ones((len(points_m), 1))
    lattice, components = _components(extent_m)
    columns: FloatArray = _correlation(as_points(points_m), lattice) @ components
    # The components left out hold more of the variance between the lattice's places than at them. Without this scale
    # the level would be more certain there: 5 to 30 % of the variance would be missing, in the lattice's pattern.
    columns /= np.linalg.norm(columns, axis=1, keepdims=True)
    return columns


@lru_cache(maxsize=8)
def _components(extent_m: float) -> tuple[FloatArray, FloatArray]:
    """The lattice (m, 2) [m] over the site, and the components (m, p) that turn correlations with it into columns."""
    axis = (np.arange(_PER_AXIS) + 0.5) / _PER_AXIS * extent_m
    lattice = np.column_stack([values.ravel() for values in np.meshgrid(axis, axis)])
    variances, directions = np.linalg.eigh(_correlation(lattice, lattice))
    kept = variances > LEAST_SHARE * len(lattice)
    return lattice, directions[:, kept] / np.sqrt(variances[kept])


def _correlation(a_m: FloatArray, b_m: FloatArray) -> FloatArray:
    correlation: FloatArray = np.exp(-cdist(a_m, b_m) / LEVEL_LENGTH_M)
    return correlation
