"""A mixture of Gaussian processes: one for each of the kernels that the samples leave possible, with its weight.

With weights w_i, and means m_i and variances v_i of the processes at a place,

    mean = sum w_i m_i,      variance = sum w_i v_i + sum w_i (m_i - mean)^2

(law of total variance): the mean of the variances, and the variance of the means, which is what is not known of the
kernel. All processes have the same samples and trend. A process with a warp (``he3.warping``) is not normal in ppb; its
mean and variance there are, in closed form, those that the law asks for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from he3.local_amplitude import even_kernel

if TYPE_CHECKING:
    from he3.frames import FloatArray
    from he3.gp import GaussianProcess
    from he3.hyperparameters import Hyperparameters


def alternatives_of(hyperparameters: Hyperparameters) -> list[tuple[float, Hyperparameters]]:
    """The weight and the hyperparameters of each process of the mixture; one of weight 1 if there are no others."""
    if not hyperparameters.alternatives:
        return [(1.0, hyperparameters)]
    count = len(hyperparameters.alternatives)
    noises = hyperparameters.noises_ppb or (hyperparameters.noise_std_ppb,) * count
    warps = hyperparameters.warps or (None,) * count
    return [
        (weight, replace(alone(hyperparameters), kernel=kernel, noise_std_ppb=noise, warp=warp))
        for (weight, kernel), noise, warp in zip(hyperparameters.alternatives, noises, warps, strict=True)
    ]


def alone(hyperparameters: Hyperparameters) -> Hyperparameters:
    """Those without the alternatives."""
    return replace(hyperparameters, alternatives=(), noises_ppb=(), warps=())


def heaviest_of(hyperparameters: Hyperparameters) -> Hyperparameters:
    """The process of the greatest weight alone, for planners: of those without a warp, if there are any.

    Else without its warp, so that planners weigh the latent field; and always without a local amplitude, which they do
    not know. The hyperparameters themselves if there are no others.
    """
    each = alternatives_of(hyperparameters)
    plain = [one for one in each if one[1].warp is None]
    heaviest = max(plain or each, key=lambda one: one[0])[1]
    return replace(heaviest, kernel=even_kernel(heaviest.kernel), warp=None)


def mixture_moments(
    weights: FloatArray, means: NDArray[np.floating], stds: NDArray[np.floating]
) -> tuple[FloatArray, FloatArray]:
    """Mean (...,) and standard deviation (...,) of the mixture. weights: (K,); means and stds of its parts (K, ...)."""
    mean = np.tensordot(weights, means, axes=1)
    apart = means - mean
    variance = np.tensordot(weights, stds.astype(np.float64) ** 2 + apart * apart, axes=1)
    return mean, np.sqrt(variance)


@dataclass(frozen=True, slots=True, eq=False)
class ProcessMixture:
    """The processes of a mixture, all with the same samples. weights: (K,), their sum is 1."""

    weights: FloatArray
    processes: tuple[GaussianProcess, ...]

    @classmethod
    def of(cls, process: GaussianProcess) -> ProcessMixture:
        """The mixture of the process's alternatives, each with its samples; the process alone if there are none."""
        if not process.hyperparameters.alternatives:
            return cls(np.ones(1), (process,))
        weights, each = zip(*alternatives_of(process.hyperparameters), strict=True)
        return cls(np.array(weights), tuple(process.under(one) for one in each))

    def predict(self, points_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Posterior mean (k,) and standard deviation (k,) [ppb] of the field at places (k, 2) [m], noise excluded."""
        means, stds = zip(*(process.predict(points_m) for process in self.processes), strict=True)
        return mixture_moments(self.weights, np.array(means), np.array(stds))

    def posterior_covariance(self, points_m: ArrayLike) -> FloatArray:
        """Posterior covariance (k, k) [ppb^2] of the field among places (k, 2) [m], by the law of total covariance."""
        means = np.array([process.predict(points_m)[0] for process in self.processes])
        apart = means - self.weights @ means
        covariance: FloatArray = (self.weights[:, None] * apart).T @ apart
        for weight, process in zip(self.weights, self.processes, strict=True):
            covariance += weight * process.posterior_covariance(points_m)
        return covariance
