"""One model of a field given the samples: a family of kernels, with the parameters and the warp that it may have.

A model's posterior of its parameters is represented by a weighted design. Each of its points is a kernel with a noise,
has the moments of the field at places all over the site, and says what each sample is found to be given the others.
``he3.hyperposterior`` weighs the models and condenses their points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_triangular

from he3.hyperparameters import NOISE_VARIANCE_FLOOR
from he3.kernel_families import left_out, log_predictive
from he3.kernels import Stretched, squared_distances
from he3.model_extensions import extensions
from he3.parameter_posterior import ParameterPosterior, log_integral
from he3.warp_choice import MOST_LOG_VARIANCE

if TYPE_CHECKING:
    from he3.frames import FloatArray
    from he3.hyperparameters import Hyperparameters, LikelihoodProblem
    from he3.kernels import Kernel
    from he3.warping import Warp

LEAST_LOG_SHARE = -4.0  # 1, logarithm of a model's weight, over the best one's, below which it is left out
_LEAST_VARIANCE = 1e-9  # 1, of the prior's, where rounding leaves less


@dataclass(frozen=True, slots=True, eq=False)
class KernelInference:
    """The posterior of one model's parameters, its mode, and the evidence, the model's own prior odds included."""

    posterior: ParameterPosterior
    mode: FloatArray
    spread: FloatArray
    log_evidence: float
    fitted: Hyperparameters
    warp: Warp | None = None
    """With it, all else is of the latent field."""

    def weighted(self, xy: FloatArray, places: FloatArray, *, predicts: bool) -> WeightedKernels:
        """The points that stand for the posterior. The sum of their weights is 1, if there are any."""
        probed = _Probed.of(self, xy, places, predicts=predicts)
        points, log_weights = self.posterior.weighted_design(self.mode, self.spread)
        kernels, noises = zip(*((self.posterior.kernel(u), self.posterior.noise(u)) for u in points), strict=True)
        moments = (probed.moments(kernel, noise) for kernel, noise in zip(kernels, noises, strict=True))
        log_likelihoods, means, variances, found = zip(*moments, strict=True)
        log_weights = log_weights + np.array(log_likelihoods)
        log_weights -= np.logaddexp.reduce(log_weights)
        left_out_each = np.array(found)
        weighted = WeightedKernels(
            list(kernels), np.array(noises), log_weights, np.array(means), np.array(variances), left_out_each,
            left_out_each, [None] * len(kernels),
        )  # fmt: skip
        if self.warp is None:
            return weighted
        return weighted.through(self.warp, self.fitted.mean_ppb, self.fitted.scale_ppb, self.posterior.likelihood.z)


@dataclass(frozen=True, slots=True, eq=False)
class WeightedKernels:
    """Kernels, noise variances (N,) in standardised units, logarithms of their weights (N,), and moments (N, m).

    left_out: (N, 2, n) of each sample given the others, or (N, 2, 0), of the latent field where there are warps (N,).
    judged: the same of the field.
    """

    kernels: list[Kernel]
    noises: FloatArray
    log_weights: FloatArray
    means: FloatArray
    variances: FloatArray
    left_out: FloatArray
    judged: FloatArray
    warps: list[Warp | None]

    def __len__(self) -> int:
        return len(self.kernels)

    def log_predictive(self) -> float:
        """That of the samples (``he3.kernel_families``), all given all others."""
        return log_predictive(self.log_weights, self.left_out, self.judged)

    def through(self, warp: Warp, mean_ppb: float, scale_ppb: float, z: FloatArray) -> WeightedKernels:
        """The same in the units of the field, where these are in those of a latent one: z (n,) of the samples there.

        Those that are too uncertain of the latent field to have moments are left out.
        """
        latent, variances = mean_ppb + scale_ppb * self.means, scale_ppb**2 * self.variances
        kept = warp.log_variance(variances).max(axis=1) <= MOST_LOG_VARIANCE
        means, variances = warp.moments(latent[kept], variances[kept])
        expected = mean_ppb + scale_ppb * (z - self.left_out[kept, 0])
        given_others, spread = warp.moments(expected, scale_ppb**2 * self.left_out[kept, 1])
        away = warp.field(mean_ppb + scale_ppb * z) - given_others
        log_weights = self.log_weights[kept]
        return WeightedKernels(
            [kernel for kernel, one in zip(self.kernels, kept, strict=True) if one],
            self.noises[kept],
            log_weights - np.logaddexp.reduce(log_weights),
            (means - mean_ppb) / scale_ppb,
            variances / scale_ppb**2,
            self.left_out[kept],
            np.stack((away / scale_ppb, spread / scale_ppb**2), axis=1),
            [warp] * len(log_weights),
        )

    @classmethod
    def together(cls, each: list[WeightedKernels]) -> WeightedKernels:
        """All of several."""
        return cls(
            [kernel for one in each for kernel in one.kernels],
            np.concatenate([one.noises for one in each]),
            np.concatenate([one.log_weights for one in each]),
            np.concatenate([one.means for one in each]),
            np.concatenate([one.variances for one in each]),
            np.concatenate([one.left_out for one in each]),
            np.concatenate([one.judged for one in each]),
            [warp for one in each for warp in one.warps],
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Probed:
    """The log likelihood of a kernel, and the moments of the field at places, from one factorisation.

    xy, places: of n samples and m places [m], and r2 (n, m) the squared distances between them [m^2]. trend (n, m) and
    trend_variance (m,): of the trend. predicts: whether it is judged how the samples predict each other.
    """

    likelihood: LikelihoodProblem
    xy: FloatArray
    places: FloatArray
    r2: FloatArray
    trend: FloatArray
    trend_variance: FloatArray
    predicts: bool

    @classmethod
    def of(cls, inference: KernelInference, xy: FloatArray, places: FloatArray, *, predicts: bool) -> _Probed:
        basis, of_samples = inference.fitted.trend_basis(places), inference.fitted.trend_basis(xy)
        assert basis is not None
        assert of_samples is not None
        across, variance = of_samples @ basis.T, (basis * basis).sum(axis=1)
        return cls(
            inference.posterior.likelihood, xy, places, squared_distances(xy, places), across, variance, predicts
        )

    def _covariances(self, kernel: Kernel) -> tuple[FloatArray, FloatArray]:
        """Among the samples (n, n), and between them and the places (n, m)."""
        if isinstance(kernel, Stretched):
            return kernel.covariance(self.xy, self.xy), kernel.covariance(self.xy, self.places)
        return kernel.of_squared_distance(self.likelihood.r2), kernel.of_squared_distance(self.r2)

    def moments(self, kernel: Kernel, noise: float) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Log likelihood, means (m,), variances (m,), ``left_out``, in standardised units; minus infinity if no value.

        noise: its variance in standardised units. ``left_out`` is (2, n), or (2, 0) if it is not asked for.
        """
        problem, n = self.likelihood, len(self.likelihood.z)
        prior = kernel.prior_variance + self.trend_variance
        none = np.ones((2, n if self.predicts else 0))
        if not n:
            return 0.0, np.zeros(len(prior)), prior, none
        noise = max(noise, NOISE_VARIANCE_FLOOR * kernel.prior_variance)
        total, across = self._covariances(kernel)
        if problem.trend_covariance is not None:
            total += problem.trend_covariance
        total.flat[:: n + 1] += noise
        try:
            factor = np.linalg.cholesky(total)
        except np.linalg.LinAlgError:
            return -math.inf, np.zeros(len(prior)), prior, none
        both = np.column_stack((problem.z, across + self.trend))
        whitened = solve_triangular(factor, both, lower=True, check_finite=False)
        value, cross = whitened[:, 0], whitened[:, 1:]
        log_likelihood = -0.5 * float(value @ value) - float(np.log(factor.diagonal()).sum())
        variance = np.maximum(prior - (cross * cross).sum(axis=0), _LEAST_VARIANCE * prior)
        return log_likelihood, value @ cross, variance, left_out(factor, value) if self.predicts else none


def extended(plain: KernelInference, xy: FloatArray) -> list[KernelInference]:
    """The extensions of a model that the samples speak for."""
    of = plain.posterior
    found = []
    for extension in extensions(of.likelihood, of.medians, of.factors, plain.mode, xy):
        posterior = ParameterPosterior(extension.likelihood, extension.medians, extension.factors)
        mode = posterior.mode([extension.start])
        spread = posterior.normal_at(mode)
        # What does not depend on the model is that of the plain one, such as the samples' unit.
        more = log_integral(posterior, mode, spread) - log_integral(of, plain.mode, plain.spread)
        evidence = plain.log_evidence + more + extension.log_odds
        found.append(KernelInference(posterior, mode, spread, evidence, plain.fitted, plain.warp))
    return found


def warped_models(models: list[KernelInference], warp: Warp, xy: FloatArray) -> list[KernelInference]:
    """The models of a family for the latent field of a warp: the plain one, and its extensions."""
    warped = _warped(models[0], warp)
    return [warped, *extended(warped, xy)]


def _warped(plain: KernelInference, warp: Warp) -> KernelInference:
    """The posterior of the same kernel's parameters for the latent field of a warp, with the same priors."""
    of, fitted = plain.posterior, plain.fitted
    values = fitted.mean_ppb + fitted.scale_ppb * of.likelihood.z
    # What the noise in ppb is in the latent field differs from the stated one sample by sample.
    more = of.likelihood.noise * (warp.noise_slope(values) ** 2 - 1.0)
    covariance = (
        np.diag(more) if of.likelihood.trend_covariance is None else of.likelihood.trend_covariance + np.diag(more)
    )
    problem = replace(
        of.likelihood, z=(warp.latent(values) - fitted.mean_ppb) / fitted.scale_ppb, trend_covariance=covariance
    )
    posterior = ParameterPosterior(problem, of.medians, of.factors)
    mode = posterior.mode([plain.mode])
    spread = posterior.normal_at(mode)
    return KernelInference(posterior, mode, spread, log_integral(posterior, mode, spread), fitted, warp)


def of_family(models: list[KernelInference], xy: FloatArray, places: FloatArray, *, predicts: bool) -> WeightedKernels:
    """The points that stand for all models of a family that count, by their evidence."""
    best = max(model.log_evidence for model in models)
    counted = [model for model in models if model.log_evidence >= best + LEAST_LOG_SHARE]
    each = [
        replace(found, log_weights=found.log_weights + model.log_evidence - best)
        for model, found in ((model, model.weighted(xy, places, predicts=predicts)) for model in counted)
    ]
    return WeightedKernels.together(each)
