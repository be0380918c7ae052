"""Draws of the hyperparameters: how uncertain a fit of the covariance function to few samples is.

Where they have alternatives (``he3.mixture``), those are drawn with their weights. Else the posterior of the logarithms
theta of the kernel's parameters is taken as normal about the fitted ones (Laplace's approximation): its precision is
minus the Hessian of the log marginal likelihood, plus that of a vague prior.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from he3.kernels import squared_distances, with_log_parameters
from he3.likelihood import log_marginal_likelihood
from he3.mixture import alternatives_of

if TYPE_CHECKING:
    from he3.frames import FloatArray
    from he3.gp import GaussianProcess

VAGUE_STD = 0.7  # 1, of the prior of each logarithm: a factor of two either way
FARTHEST = 2.0  # 1, largest change of a logarithm, in standard deviations of that prior
_STEP = 0.05  # 1, of the second differences


def redrawn(belief: GaussianProcess, random: np.random.Generator) -> GaussianProcess:
    """The same observations under drawn hyperparameters; without observations or alternatives, the belief."""
    fitted, places = belief.hyperparameters, belief.places_m
    if fitted.alternatives:
        weights, each = zip(*alternatives_of(fitted), strict=True)
        return belief.under(each[int(random.choice(len(each), p=weights))])
    if not len(belief):
        return belief
    z = belief.factor @ belief.whitened
    r2 = squared_distances(places, places)
    basis = fitted.trend_basis(places)
    trend = None if basis is None else basis @ basis.T
    centre = np.log(list(fitted.kernel.parameters().values()))

    def gradient(theta: FloatArray) -> FloatArray:
        kernel = with_log_parameters(fitted.kernel, theta)
        return log_marginal_likelihood(kernel, fitted.noise_variance, r2, z, trend)[1][: len(centre)]

    steps = _STEP * np.eye(len(centre))
    hessian = np.array([(gradient(centre + step) - gradient(centre - step)) / (2.0 * _STEP) for step in steps])
    values, axes = np.linalg.eigh(-0.5 * (hessian + hessian.T))
    std = 1.0 / np.sqrt(np.maximum(values, 0.0) + VAGUE_STD**-2)
    change = axes @ (std * random.standard_normal(len(centre)))
    theta = centre + np.clip(change, -FARTHEST * VAGUE_STD, FARTHEST * VAGUE_STD)
    drawn = replace(fitted, kernel=with_log_parameters(fitted.kernel, theta), log_likelihood=float("nan"))
    return belief.under(drawn)
