"""What the samples tell of the hyperparameters: one kernel to plan with, and a few weighted ones for all of them.

With log-normal priors (``he3.hyperprior``) the posterior of the logarithms theta of the kernel's parameters is

    p(theta | y)  ~  p(y | theta) N(theta; medians, factors^2)

where the constant mean, or a trend's coefficients, are marginalised in p(y | theta). Its mode is found by L-BFGS-B. The
evidence of a kernel is Laplace's approximation of the integral. A likelihood alone has no lower bound on the variance
but that of the samples: five nearly equal ones make a whole site look known. With a prior in ppb, they do not.

The mode alone is still certain of whatever it says. So the whole posterior is represented in two steps, neither of
which draws at random:

1. *A weighted design.* Points of a low-discrepancy sequence, some after the normal approximation at the mode, a little
   widened, and some after the prior, so that a second mode is not missed. Their weights are p / q, with q the density
   of the whole design (multiple importance sampling with the balance heuristic: Veach & Guibas 1995).
2. *A few of its points.* ``he3.condensation`` chooses those whose mixture has, at places all over the site, the
   moments that all of them have together.

Where the samples speak for unstated noise or for two lengths and a bearing (``he3.model_extensions``), the points of
those models are among them, with the weight of their evidence. Where the kernel is "auto", so are those of all families
of kernels, with the weight of how well they predict (``he3.kernel_families``), and of skewed fields
(``he3.warp_choice``), except where a map from orbit is the trend: its contrast is one in ppb.

On 20 maps of 10 to 30 samples of 16 fields, six points had the moments of a design of 256, twice the one used here:
standard deviations within 1 % on average and 2 % at most, means within 2 and 5 % of a standard deviation.

From 150 samples the design is coarse: of its points for so many, 3 to 21 count (effective sample size, four maps of
``t1`` and ``t2``). Its means differ by 0.10 of a standard deviation, and its standard deviations by 10 % (root mean
square over cells), from those of two Markov chains of 6,000 steps; on one map, two such pairs differ by as much. Twice
the points, or a second stage of them after the first, came no closer to them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import ndtri

from he3.condensation import condensed
from he3.errors import InvalidInput
from he3.frames import FloatArray, as_points
from he3.hyperparameters import (
    CAUTIOUS_FIRST,
    NOISE_VARIANCE_FLOOR,
    VERY_STRONG_EVIDENCE,
    Hyperparameters,
    LikelihoodProblem,
    best_optimum,
    parameter_bounds,
    typical_spacing_m,
)
from he3.hyperprior import REACH, UNREMARKABLE, Hyperprior
from he3.kernel_families import left_out, log_family_weights, log_predictive
from he3.kernels import AUTO, Kernel, Stretched, kernel_from, squared_distances
from he3.layer_selection import LEAST_OF_WIDE, LOG_ODDS, LOG_ODDS_OF_DETAIL, chosen_shares, in_shares
from he3.model_extensions import extensions
from he3.trend import UnknownConstant, UnknownLevel, unknown_level
from he3.warp_choice import MOST_LOG_VARIANCE, log_warp_weight, warps_to_try

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from he3.trend import CovariateTrend, Trend
    from he3.warping import Warp

LEAST_PRECISION = 0.5  # 1, of the normal approximation along any axis, in units of the prior's
COMPONENTS = 6  # 1, kernels that stand for the posterior
PROBES_PER_AXIS = 6  # 1, places per axis at which their moments are those of all points
POINTS = ((40, 128), (200, 64), (400, 40))  # points of the design for up to so many samples
POINTS_OF_MANY = 24
WIDENING = 1.3  # 1, of the normal approximation; its tails are then never thinner than the posterior's
_PRIOR_SHARE = 0.5  # 1, of the design, for up to 40 samples; less for more
LEAST_LOG_SHARE = -4.0  # 1, logarithm of a model's weight, over the best one's, below which it is left out
_LEAST_VARIANCE = 1e-9  # 1, of the prior's, where rounding leaves less
_STEP = 0.05  # 1, of the second differences, in standard deviations of the prior
_FOLLOWED_UP_TO = 150  # samples up to which the best points of the prior are starts, too
_CANDIDATES = 16


def infer_hyperparameters(
    xy_m: FloatArray,
    values_ppb: FloatArray,
    kernel_name: str,
    prior: Hyperprior,
    *,
    noise_std_ppb: float,
    trend: CovariateTrend | None = None,
    previous: Hyperparameters | None = None,
) -> Hyperparameters:
    """The hyperparameters given observations (n,) [ppb] at places (n, 2) [m]: one kernel, and the alternatives.

    The one is the most probable with length scales no shorter than those of a fit of maximum likelihood. Without
    samples, they are those of the prior. kernel_name: one of ``KERNELS``, or "auto": then the one is the most cautious
    that the evidence allows, and the alternatives are of all families. previous: a start of the search. It draws
    nothing at random. Raises InvalidInput for shapes that do not fit, values that are not finite, or an unknown kernel.
    """
    xy, families = _families(xy_m, values_ppb, kernel_name, prior, noise_std_ppb, trend, previous)
    return _mixed(families, xy, prior.extent_m)


@dataclass(frozen=True, slots=True, eq=False)
class HyperparameterDraws:
    """The posterior whose few representatives ``infer_hyperparameters`` returns, to draw from.

    The representatives have the moments of the map, but most of their weight is on one or two of them: what follows
    from the kernel in other ways varies less among them than in the posterior.
    """

    fitted: Hyperparameters
    kernels: list[Kernel]
    noises: FloatArray
    """Variances (N,) in standardised units."""
    shares: FloatArray
    """(N,), of which the sum is 1."""
    warps: list[Warp | None]
    """(N,)."""

    def draw(self, random: np.random.Generator) -> Hyperparameters:
        """One draw."""
        number = int(random.choice(len(self.shares), p=self.shares))
        noise_ppb = self.fitted.scale_ppb * math.sqrt(self.noises[number])
        return replace(
            self.fitted,
            kernel=self.kernels[number],
            noise_std_ppb=noise_ppb,
            log_likelihood=math.nan,
            warp=self.warps[number],
        )


def hyperparameter_draws(
    xy_m: FloatArray,
    values_ppb: FloatArray,
    kernel_name: str,
    prior: Hyperprior,
    *,
    noise_std_ppb: float,
    trend: CovariateTrend | None = None,
    previous: Hyperparameters | None = None,
) -> HyperparameterDraws:
    """The posterior to draw from; arguments and errors of ``infer_hyperparameters``."""
    xy, families = _families(xy_m, values_ppb, kernel_name, prior, noise_std_ppb, trend, previous)
    points = _points(families, xy, prior.extent_m)
    shares = np.exp(points.log_weights - np.logaddexp.reduce(points.log_weights))
    return HyperparameterDraws(families[0][0].fitted, points.kernels, points.noises, shares, points.warps)


def _families(
    xy_m: FloatArray,
    values_ppb: FloatArray,
    kernel_name: str,
    prior: Hyperprior,
    noise_std_ppb: float,
    trend: CovariateTrend | None,
    previous: Hyperparameters | None,
) -> tuple[FloatArray, list[list[_Inference]]]:
    """The places (n, 2) [m], and for each family of kernels the models of the samples there: its own and extensions.

    The first family is the one that guides planners.
    """
    xy = as_points(np.asarray(xy_m, dtype=np.float64).reshape(-1, 2))
    values = np.asarray(values_ppb, dtype=np.float64)
    if values.shape != (len(xy),) or not np.isfinite(values).all():
        raise InvalidInput(f"expected {len(xy)} finite values, one per place, got shape {values.shape}")
    names = CAUTIOUS_FIRST if kernel_name == AUTO else (kernel_from(kernel_name).name,)
    of = [partial(_inferred, xy, values, name, prior, noise_std_ppb, trend, previous) for name in names]
    first = _with_layers(xy, trend, of[0])
    # All alternatives have the same trend.
    found = [first, *(inferred(first.fitted.trend_shares) for inferred in of[1:])]
    least = max(each.log_evidence for each in found) - VERY_STRONG_EVIDENCE
    guide = next(each for each in found if each.log_evidence >= least)
    ordered = [guide, *(each for each in found if each is not guide)]
    return xy, [[each, *_extended(each, xy)] for each in ordered]


@dataclass(frozen=True, slots=True, eq=False)
class _Posterior:
    """The log posterior, up to a constant, of u: log parameters in standard deviations from the prior's medians."""

    likelihood: LikelihoodProblem
    medians: FloatArray
    factors: FloatArray

    def __len__(self) -> int:
        return len(self.medians)

    def kernel(self, u: FloatArray) -> Kernel:
        """The kernel whose parameters are at u (p,)."""
        return self.likelihood.kernel_at(self.medians + self.factors * u)

    def noise(self, u: FloatArray) -> float:
        """The noise variance at u (p,), in standardised units."""
        return self.likelihood.noise_at(self.medians + self.factors * u)

    def cost(self, u: FloatArray) -> tuple[float, FloatArray]:
        """Minus the log posterior, and its gradient (p,)."""
        if not len(self.likelihood.z):
            return 0.5 * float(u @ u), u
        value, gradient = self.likelihood.cost(self.medians + self.factors * u)
        return value + 0.5 * float(u @ u), gradient * self.factors + u

    def mode(self, starts: Sequence[FloatArray], least: FloatArray | None = None) -> FloatArray:
        """The best of the optima (p,) that the starts lead to. Raises NumericalFailure if none is finite.

        least: lower bounds of u (p,); None for those of the search alone.
        """
        bounds = np.column_stack((-REACH / self.factors if least is None else least, REACH / self.factors))
        return best_optimum(self.cost, starts, bounds, f"a posterior for {self.likelihood.default.name!r}")

    def normal_at(self, mode: FloatArray) -> FloatArray:
        """A matrix (p, p) whose outer product is the covariance of the normal approximation at the mode."""
        p = len(self)
        precision = np.empty((p, p))
        for k in range(p):
            step = np.zeros(p)
            step[k] = _STEP
            precision[k] = (self.cost(mode + step)[1] - self.cost(mode - step)[1]) / (2.0 * _STEP)
        along, axes = np.linalg.eigh(0.5 * (precision + precision.T))
        spread: FloatArray = axes / np.sqrt(np.maximum(along, LEAST_PRECISION))
        return spread

    def weighted_design(self, mode: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (N, p) after the normal approximation and the prior, and the logarithms of prior over density (N,)."""
        n, p = len(self.likelihood.z), len(self)
        count = next((count for most, count in POINTS if n <= most), POINTS_OF_MANY)
        of_prior = round(_PRIOR_SHARE * count * min(1.0, POINTS[0][0] / max(n, 1)))
        widened = WIDENING * spread
        points = np.vstack((mode + _normal_design(count - of_prior, p) @ widened.T, _normal_design(of_prior, p)))
        log_prior = -0.5 * (points * points).sum(axis=1)
        whitened = np.linalg.solve(widened, (points - mode).T)
        log_normal = -0.5 * (whitened * whitened).sum(axis=0) - float(np.linalg.slogdet(widened)[1])
        with np.errstate(divide="ignore"):
            shares = np.log(np.array([count - of_prior, of_prior]) / count)
        density = np.logaddexp(shares[0] + log_normal, shares[1] + log_prior)
        return points, log_prior - density


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
    def of(cls, inference: _Inference, xy: FloatArray, places: FloatArray, *, predicts: bool) -> _Probed:
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


@dataclass(frozen=True, slots=True, eq=False)
class _Weighted:
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

    def through(self, warp: Warp, mean_ppb: float, scale_ppb: float, z: FloatArray) -> _Weighted:
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
        return _Weighted(
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
    def together(cls, each: list[_Weighted]) -> _Weighted:
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
class _Inference:
    """The posterior of one model's parameters, its mode, and the evidence, the model's own prior odds included."""

    posterior: _Posterior
    mode: FloatArray
    spread: FloatArray
    log_evidence: float
    fitted: Hyperparameters
    warp: Warp | None = None
    """With it, all else is of the latent field."""

    def weighted(self, xy: FloatArray, places: FloatArray, *, predicts: bool) -> _Weighted:
        """The points that stand for the posterior. The sum of their weights is 1, if there are any."""
        probed = _Probed.of(self, xy, places, predicts=predicts)
        points, log_weights = self.posterior.weighted_design(self.mode, self.spread)
        kernels, noises = zip(*((self.posterior.kernel(u), self.posterior.noise(u)) for u in points), strict=True)
        moments = (probed.moments(kernel, noise) for kernel, noise in zip(kernels, noises, strict=True))
        log_likelihoods, means, variances, found = zip(*moments, strict=True)
        log_weights = log_weights + np.array(log_likelihoods)
        log_weights -= np.logaddexp.reduce(log_weights)
        left_out_each = np.array(found)
        weighted = _Weighted(
            list(kernels), np.array(noises), log_weights, np.array(means), np.array(variances), left_out_each,
            left_out_each, [None] * len(kernels),
        )  # fmt: skip
        if self.warp is None:
            return weighted
        return weighted.through(self.warp, self.fitted.mean_ppb, self.fitted.scale_ppb, self.posterior.likelihood.z)


def _points(families: list[list[_Inference]], xy: FloatArray, extent_m: float) -> _Weighted:
    """The points that stand for all families, models and warps that count."""
    axis = (np.arange(PROBES_PER_AXIS) + 0.5) / PROBES_PER_AXIS * extent_m
    places = np.column_stack([values.ravel() for values in np.meshgrid(axis, axis)])
    if len(families) == 1:
        return _of_family(families[0], xy, places, predicts=False)
    plain = _of_families(families, xy, places)
    groups = [(0.0, plain)]
    best = int(np.argmax([one.log_weight for one in plain]))
    for warp in _warps(families[0][0]):
        first = _of_families([_warped_models(families[best], warp, xy)], xy, places)
        if not first or log_warp_weight([first[0].predictive], [plain[best].predictive]) < LEAST_LOG_SHARE:
            continue  # with the other families, it would hardly count either
        others = [models for number, models in enumerate(families) if number != best]
        found = _of_families([_warped_models(models, warp, xy) for models in others], xy, places)
        found = _weighed([*first, *found])
        more = log_warp_weight([one.predictive for one in found], [one.predictive for one in plain])
        groups.append((more, found))
    least = max(more + one.log_weight for more, group in groups for one in group) + LEAST_LOG_SHARE
    return _Weighted.together(
        [
            replace(one.points, log_weights=one.points.log_weights + (one.log_weight + more))
            for more, group in groups
            for one in group
            if more + one.log_weight >= least
        ]
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Family:
    """The points that stand for a family, of weights whose sum is 1, with its weight among the others of its warp.

    predictive: the log density of the samples given each other.
    """

    name: str
    points: _Weighted
    predictive: float
    log_weight: float = 0.0


def _of_families(families: list[list[_Inference]], xy: FloatArray, places: FloatArray) -> list[_Family]:
    """Those families that have points, with one warp or none."""
    each = []
    for models in families:
        found = _of_family(models, xy, places, predicts=True)
        if len(found):
            found = replace(found, log_weights=found.log_weights - np.logaddexp.reduce(found.log_weights))
            each.append(_Family(models[0].posterior.likelihood.default.name, found, found.log_predictive()))
    return _weighed(each)


def _weighed(families: list[_Family]) -> list[_Family]:
    """The same with their weights among each other."""
    log_weights = log_family_weights([one.name for one in families], [one.predictive for one in families])
    return [replace(one, log_weight=float(weight)) for one, weight in zip(families, log_weights, strict=True)]


def _warps(plain: _Inference) -> list[Warp]:
    """The warps that are looked at: none where the field has a trend from orbit, which is one in ppb."""
    fitted, problem = plain.fitted, plain.posterior.likelihood
    if not isinstance(fitted.trend, UnknownConstant | UnknownLevel):
        return []
    return warps_to_try(fitted.mean_ppb + fitted.scale_ppb * problem.z, fitted.noise_std_ppb)


def _warped_models(models: list[_Inference], warp: Warp, xy: FloatArray) -> list[_Inference]:
    """The models of a family for the latent field of a warp: the plain one, and its extensions."""
    warped = _warped(models[0], warp)
    return [warped, *_extended(warped, xy)]


def _warped(plain: _Inference, warp: Warp) -> _Inference:
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
    posterior = _Posterior(problem, of.medians, of.factors)
    mode = posterior.mode([plain.mode])
    spread = posterior.normal_at(mode)
    return _Inference(posterior, mode, spread, _log_integral(posterior, mode, spread), fitted, warp)


def _of_family(models: list[_Inference], xy: FloatArray, places: FloatArray, *, predicts: bool) -> _Weighted:
    """The points that stand for all models of a family that count, by their evidence."""
    best = max(model.log_evidence for model in models)
    counted = [model for model in models if model.log_evidence >= best + LEAST_LOG_SHARE]
    each = [
        replace(found, log_weights=found.log_weights + model.log_evidence - best)
        for model, found in ((model, model.weighted(xy, places, predicts=predicts)) for model in counted)
    ]
    return _Weighted.together(each)


def _mixed(families: list[list[_Inference]], xy: FloatArray, extent_m: float) -> Hyperparameters:
    """The hyperparameters for planners, those of the first model, with the kernels that stand for all models."""
    points = _points(families, xy, extent_m)
    weights = np.exp(points.log_weights - points.log_weights.max())
    chosen, shares = condensed(weights, points.means, points.variances, COMPONENTS, points.warps)
    guide = families[0][0]
    fitted = guide.fitted
    alternatives = tuple((float(share), points.kernels[number]) for number, share in zip(chosen, shares, strict=True))
    noises = points.noises[chosen]
    warps = tuple(points.warps[number] for number in chosen)
    fitted = replace(fitted, alternatives=alternatives, warps=warps if any(warps) else ())
    if np.all(noises == guide.posterior.likelihood.noise):
        return fitted
    stds = fitted.scale_ppb * np.sqrt(noises)
    return replace(
        fitted,
        noise_std_ppb=float(np.sqrt(shares @ stds**2)),
        noises_ppb=tuple(float(std) for std in stds),
    )


def _extended(plain: _Inference, xy: FloatArray) -> list[_Inference]:
    """The extensions of a model that the samples speak for."""
    of = plain.posterior
    found = []
    for extension in extensions(of.likelihood, of.medians, of.factors, plain.mode, xy):
        posterior = _Posterior(extension.likelihood, extension.medians, extension.factors)
        mode = posterior.mode([extension.start])
        spread = posterior.normal_at(mode)
        # What does not depend on the model is that of the plain one, such as the samples' unit.
        more = _log_integral(posterior, mode, spread) - _log_integral(of, plain.mode, plain.spread)
        evidence = plain.log_evidence + more + extension.log_odds
        found.append(_Inference(posterior, mode, spread, evidence, plain.fitted, plain.warp))
    return found


def _log_integral(posterior: _Posterior, mode: FloatArray, spread: FloatArray) -> float:
    """Laplace's approximation of the logarithm of the posterior's integral."""
    return float(np.linalg.slogdet(spread)[1]) - posterior.cost(mode)[0]


def _with_layers(
    xy: FloatArray, trend: CovariateTrend | None, inferred: Callable[[tuple[float, ...]], _Inference]
) -> _Inference:
    """The posterior of a kernel's parameters, where each of the trend's layers has the room that the samples speak for.

    That is judged with the kernel that describes the samples without those layers; of their details, with the kernel
    that describes what their wide features leave. inferred: the posterior with the layers in given shares.
    """
    optional = None if trend is None else trend.optional
    if trend is None or optional is None or not optional.any():
        return inferred(())
    after = np.array(trend.after or range(len(optional)))
    detail = after != np.arange(len(optional))
    shares = tuple(float(not one) for one in optional)
    for details in (False, True):
        found = inferred(shares)
        problem, kernel = found.posterior.likelihood, found.posterior.kernel(found.mode)
        covariance = kernel.of_squared_distance(problem.r2) + problem.noise * np.eye(len(xy))
        judged = detail & (np.array(shares)[after] > LEAST_OF_WIDE) if details else optional & ~detail
        odds = LOG_ODDS_OF_DETAIL if details else LOG_ODDS
        basis = trend.basis(xy, found.fitted.scale_ppb)
        chosen = chosen_shares(covariance, problem.z, basis, np.array(shares), judged, odds)
        if chosen == shares:
            return found
        shares = chosen
    return inferred(shares)


def _inferred(
    xy: FloatArray,
    values: FloatArray,
    kernel_name: str,
    prior: Hyperprior,
    noise_std_ppb: float,
    trend: CovariateTrend | None,
    previous: Hyperparameters | None,
    shares: tuple[float, ...],
) -> _Inference:
    """The posterior of a kernel's parameters, with the trend's layers in these shares."""
    scale = prior.field_std_ppb
    residual = values if trend is None else values - trend.at(xy)
    sample_mean = float(residual.mean()) if len(residual) else 0.0
    if trend is None:
        mean = prior.mean_ppb
        away = abs(sample_mean - mean) - UNREMARKABLE * prior.mean_std_ppb if len(residual) else 0.0
        unknown: Trend = unknown_level(max(prior.mean_std_ppb, away), prior.extent_m)
        scale *= max(1.0, away / prior.mean_std_ppb)
    elif trend.level_varies:  # no layer is a map of the field: all that is known of its level is the prior
        mean, unknown = sample_mean - min(max(sample_mean, -trend.offset_std_ppb), trend.offset_std_ppb), trend
        scale *= max(1.0, abs(sample_mean) / trend.offset_std_ppb)
    else:
        mean, unknown = sample_mean, trend  # the trend's own offset lies about the samples' misfit
    basis = in_shares(unknown.basis(xy, scale), shares)
    medians, factors = prior.log_normal(kernel_name)
    problem = LikelihoodProblem(
        default=kernel_from(kernel_name),
        r2=squared_distances(xy, xy),
        z=(residual - mean) / scale,
        trend_covariance=basis @ basis.T,
        noise=(noise_std_ppb / scale) ** 2,
        bounds=np.column_stack((medians - REACH, medians + REACH)),
    )
    posterior = _Posterior(problem, medians, factors)
    mode = posterior.mode(_starts(posterior, kernel_name, previous, scale))
    spread = posterior.normal_at(mode)
    of_scale = len(values) * math.log(scale)  # the samples are in ppb
    log_evidence = _log_integral(posterior, mode, spread) - of_scale
    guide = _guide(posterior, mode, xy, prior.extent_m)
    likelihood = 0.5 * float(guide @ guide) - posterior.cost(guide)[0] - of_scale if len(values) else math.nan
    fitted = Hyperparameters(
        posterior.kernel(guide), noise_std_ppb, mean, scale, likelihood, unknown, trend_shares=shares
    )
    return _Inference(posterior, mode, spread, log_evidence, fitted)


def _guide(posterior: _Posterior, mode: FloatArray, xy: FloatArray, extent_m: float) -> FloatArray:
    """The most probable parameters (p,) with the least length scales of ``fit_hyperparameters``.

    Planners are guided by one kernel. If its length scale is shorter than the samples' spacing, a sample informs about
    its own place only, and all designs are as good as each other.
    """
    kernel = posterior.likelihood.default
    allowed = parameter_bounds(kernel, typical_spacing_m(xy), extent_m)
    least = -REACH / posterior.factors
    for number, (name, (shortest, _)) in enumerate(zip(kernel.parameters(), allowed, strict=True)):
        if name.endswith("length_scale_m"):
            least[number] = (math.log(shortest) - posterior.medians[number]) / posterior.factors[number]
    return mode if (mode >= least).all() else posterior.mode([np.maximum(mode, least)], least)


def _starts(
    posterior: _Posterior, kernel_name: str, previous: Hyperparameters | None, scale: float
) -> list[FloatArray]:
    """Starts (p,) of the search: the previous optimum or the prior's median, and others while it is cheap."""
    starts = [np.zeros(len(posterior))]
    if previous is not None and previous.kernel.name == kernel_name:
        in_scale = {
            key: value * (previous.scale_ppb / scale) ** 2 if key.endswith("variance") else value
            for key, value in previous.kernel.parameters().items()
        }
        starts = [(np.log(list(in_scale.values())) - posterior.medians) / posterior.factors]
    if len(posterior.likelihood.z) <= _FOLLOWED_UP_TO:
        others = _normal_design(_CANDIDATES, len(posterior))
        starts.append(min(others, key=lambda u: posterior.cost(u)[0]))
    return starts


def _normal_design(count: int, p: int) -> FloatArray:
    """Points (count, p) that follow a standard normal distribution evenly, the first in its middle.

    A lattice of Kronecker's, with the golden ratio's generalisation to p dimensions (Roberts 2018).
    """
    ratio = 2.0
    for _ in range(60):
        ratio = (1.0 + ratio) ** (1.0 / (p + 1))
    steps = ratio ** -np.arange(1.0, p + 1)
    uniform = (0.5 + np.arange(count)[:, None] * steps) % 1.0
    design: FloatArray = ndtri(np.clip(uniform, 1e-6, 1.0 - 1e-6))
    return design
