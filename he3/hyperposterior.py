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
(``he3.warp_choice``); and beside the few that are chosen stand others of quiet and rough parts, where the samples speak
for them (``he3.amplitude_inference``). With a map from orbit as the trend there are neither: its contrast is in ppb.

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

from he3.amplitude_inference import local_member, with_local_members
from he3.condensation import condensed
from he3.errors import InvalidInput
from he3.frames import FloatArray, as_points
from he3.hyperparameters import (
    CAUTIOUS_FIRST,
    VERY_STRONG_EVIDENCE,
    Hyperparameters,
    LikelihoodProblem,
    parameter_bounds,
    typical_spacing_m,
)
from he3.hyperprior import REACH, UNREMARKABLE, Hyperprior
from he3.kernel_families import log_family_weights
from he3.kernel_inference import LEAST_LOG_SHARE, KernelInference, WeightedKernels, extended, of_family, warped_models
from he3.kernels import AUTO, Kernel, kernel_from, squared_distances
from he3.layer_selection import LEAST_OF_WIDE, LOG_ODDS, LOG_ODDS_OF_DETAIL, chosen_shares, in_shares
from he3.parameter_posterior import ParameterPosterior, log_integral, normal_design
from he3.trend import UnknownConstant, UnknownLevel, unknown_level
from he3.warp_choice import log_warp_weight, warps_to_try

if TYPE_CHECKING:
    from collections.abc import Callable

    from he3.trend import CovariateTrend, Trend
    from he3.warping import Warp

COMPONENTS = 6  # 1, kernels that stand for the posterior
PROBES_PER_AXIS = 6  # 1, places per axis at which their moments are those of all points
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
    samples: tuple[FloatArray, FloatArray, float] | None
    """Places (n, 2) [m], values (n,) [ppb] and the site's width [m], where there may be a local amplitude."""

    def draw(self, random: np.random.Generator) -> Hyperparameters:
        """One draw."""
        number = int(random.choice(len(self.shares), p=self.shares))
        noise_ppb = self.fitted.scale_ppb * math.sqrt(self.noises[number])
        drawn = replace(
            self.fitted,
            kernel=self.kernels[number],
            noise_std_ppb=noise_ppb,
            log_likelihood=math.nan,
            warp=self.warps[number],
        )
        local = None if self.samples is None else local_member(drawn, *self.samples)
        if local is None or random.random() >= local.weight:
            return drawn
        return replace(drawn, kernel=local.kernel)


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
    guide = families[0][0]
    values = _values_of_any_kind(guide) if len(families) > 1 else None
    samples = None if values is None else (xy, values, prior.extent_m)
    return HyperparameterDraws(guide.fitted, points.kernels, points.noises, shares, points.warps, samples)


def _families(
    xy_m: FloatArray,
    values_ppb: FloatArray,
    kernel_name: str,
    prior: Hyperprior,
    noise_std_ppb: float,
    trend: CovariateTrend | None,
    previous: Hyperparameters | None,
) -> tuple[FloatArray, list[list[KernelInference]]]:
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
    return xy, [[each, *extended(each, xy)] for each in ordered]


def _points(families: list[list[KernelInference]], xy: FloatArray, extent_m: float) -> WeightedKernels:
    """The points that stand for all families, models and warps that count."""
    places = _probes(extent_m)
    if len(families) == 1:
        return of_family(families[0], xy, places, predicts=False)
    plain = _of_families(families, xy, places)
    groups = [(0.0, plain)]
    best = int(np.argmax([one.log_weight for one in plain]))
    for warp in _warps(families[0][0]):
        first = _of_families([warped_models(families[best], warp, xy)], xy, places)
        if not first or log_warp_weight([first[0].predictive], [plain[best].predictive]) < LEAST_LOG_SHARE:
            continue  # with the other families, it would hardly count either
        others = [models for number, models in enumerate(families) if number != best]
        found = _of_families([warped_models(models, warp, xy) for models in others], xy, places)
        found = _weighed([*first, *found])
        more = log_warp_weight([one.predictive for one in found], [one.predictive for one in plain])
        groups.append((more, found))
    least = max(more + one.log_weight for more, group in groups for one in group) + LEAST_LOG_SHARE
    return WeightedKernels.together(
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
    points: WeightedKernels
    predictive: float
    log_weight: float = 0.0


def _of_families(families: list[list[KernelInference]], xy: FloatArray, places: FloatArray) -> list[_Family]:
    """Those families that have points, with one warp or none."""
    each = []
    for models in families:
        found = of_family(models, xy, places, predicts=True)
        if len(found):
            found = replace(found, log_weights=found.log_weights - np.logaddexp.reduce(found.log_weights))
            each.append(_Family(models[0].posterior.likelihood.default.name, found, found.log_predictive()))
    return _weighed(each)


def _weighed(families: list[_Family]) -> list[_Family]:
    """The same with their weights among each other."""
    log_weights = log_family_weights([one.name for one in families], [one.predictive for one in families])
    return [replace(one, log_weight=float(weight)) for one, weight in zip(families, log_weights, strict=True)]


def _probes(extent_m: float) -> FloatArray:
    """Places (m, 2) [m] all over the site, at which the moments of the kernels are looked at."""
    axis = (np.arange(PROBES_PER_AXIS) + 0.5) / PROBES_PER_AXIS * extent_m
    return np.column_stack([values.ravel() for values in np.meshgrid(axis, axis)])


def _warps(plain: KernelInference) -> list[Warp]:
    """The warps that are looked at."""
    values = _values_of_any_kind(plain)
    return [] if values is None else warps_to_try(values, plain.fitted.noise_std_ppb)


def _values_of_any_kind(plain: KernelInference) -> FloatArray | None:
    """The samples (n,) [ppb] of a field that may be skewed, or uneven.

    None where it has a trend from orbit: that is one in ppb, and so is what remains.
    """
    fitted = plain.fitted
    if not isinstance(fitted.trend, UnknownConstant | UnknownLevel):
        return None
    return fitted.mean_ppb + fitted.scale_ppb * plain.posterior.likelihood.z


def _mixed(families: list[list[KernelInference]], xy: FloatArray, extent_m: float) -> Hyperparameters:
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
    if not np.all(noises == guide.posterior.likelihood.noise):
        stds = fitted.scale_ppb * np.sqrt(noises)
        noise_std_ppb = float(np.sqrt(shares @ stds**2))
        fitted = replace(fitted, noise_std_ppb=noise_std_ppb, noises_ppb=tuple(float(std) for std in stds))
    values = _values_of_any_kind(guide) if len(families) > 1 else None
    if values is None:
        return fitted
    return with_local_members(fitted, xy, values, extent_m, _probes(extent_m), COMPONENTS)


def _with_layers(
    xy: FloatArray, trend: CovariateTrend | None, inferred: Callable[[tuple[float, ...]], KernelInference]
) -> KernelInference:
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
) -> KernelInference:
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
    posterior = ParameterPosterior(problem, medians, factors)
    mode = posterior.mode(_starts(posterior, kernel_name, previous, scale))
    spread = posterior.normal_at(mode)
    of_scale = len(values) * math.log(scale)  # the samples are in ppb
    log_evidence = log_integral(posterior, mode, spread) - of_scale
    guide = _guide(posterior, mode, xy, prior.extent_m)
    likelihood = 0.5 * float(guide @ guide) - posterior.cost(guide)[0] - of_scale if len(values) else math.nan
    fitted = Hyperparameters(
        posterior.kernel(guide), noise_std_ppb, mean, scale, likelihood, unknown, trend_shares=shares
    )
    return KernelInference(posterior, mode, spread, log_evidence, fitted)


def _guide(posterior: ParameterPosterior, mode: FloatArray, xy: FloatArray, extent_m: float) -> FloatArray:
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
    posterior: ParameterPosterior, kernel_name: str, previous: Hyperparameters | None, scale: float
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
        others = normal_design(_CANDIDATES, len(posterior))
        starts.append(min(others, key=lambda u: posterior.cost(u)[0]))
    return starts
