"""Realisations of the field: fields drawn from the joint posterior of the whole site (conditional simulation).

A map's mean is smoother than any field can be, so what depends on the field's roughness, such as the yield of a route
or of a mine, follows from many such fields and not from the mean. Each realisation passes through the samples as
closely as their noise allows, and varies between them as the belief says: its process is drawn first, by the weights of
the mixture, and then the field from that process (Rasmussen & Williams 2006, sect. A.2; a warp is applied last).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from he3.coarse_grid import coarser
from he3.mixture import ProcessMixture
from he3.resource import of_constant

if TYPE_CHECKING:
    from he3.frames import FloatArray, SiteGrid
    from he3.gp import GaussianProcess

MOST_CELLS = 2500
"""Cells of a realisation; their covariance is factored once for each process of the mixture, within a second."""
JITTER = 1e-8  # 1, share of the greatest variance that is added to each: more than rounding errors, and 0.01 % of std


def realisations(
    process: GaussianProcess, grid: SiteGrid, count: int, rng: np.random.Generator
) -> tuple[FloatArray, SiteGrid]:
    """Fields (count, rows, columns) [ppb] at the centres of the cells of a grid over the site, and that grid.

    The grid is the site's own, or a coarser one of at most ``MOST_CELLS`` cells. The values are those of places, not
    means over cells. Measurement noise is excluded. Values below zero, of which a normal belief has some, are zero.
    """
    coarse = coarser(grid, MOST_CELLS)
    places = coarse.points()
    mixture = ProcessMixture.of(process)
    fields = []
    for one, drawn in zip(mixture.processes, rng.multinomial(count, mixture.weights), strict=True):
        if drawn == 0:
            continue
        covariance = one.latent_covariance(places)
        if len(one):
            crossing = one.hyperparameters.covariance(one.places_m, places)
            unknown = one.hyperparameters.scale_ppb * of_constant(one, one.solve(crossing))
            covariance += np.outer(unknown, unknown)
        half = _factor(covariance)
        latent = one.predict_latent(places)[0] + rng.standard_normal((int(drawn), len(places))) @ half.T
        warp = one.hyperparameters.warp
        fields.append(latent if warp is None else warp.field(latent))
    values = np.maximum(rng.permutation(np.vstack(fields)), 0.0)
    return values.reshape(count, *coarse.shape), coarse


def _factor(covariance: FloatArray) -> FloatArray:
    """The lower Cholesky factor (k, k) of a covariance that may be singular but for rounding errors."""
    covariance.flat[:: len(covariance) + 1] += JITTER * covariance.diagonal().max()
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
