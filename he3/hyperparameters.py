"""The parameters of the belief other than the samples, and their fit: maximum likelihood within stated bounds.

A fit standardises the observations by their own mean and standard deviation, and the kernel is in those units. Bounds,
and the reasons for them:

- length scales from 5 m, below which samples that planners keep 5 to 15 m apart carry no information on them, to the
  site's own width (500 m where it is less), beyond which the field is a trend that samples on the site cannot tell from
  a longer one;
- the smooth part's from 40 m and the rough part's up to 60 m, so that each keeps its role, both in proportion to the
  width where the site is wider than 500 m;
- an exponential covariance's from the typical distance between neighbouring samples, up to 40 m: below it the samples
  are almost independent, the likelihood is flat, and its accidental maximum draws the map to its mean without reason
  (2 % of RMSE on a lattice of 37 m); if the scale really is shorter, the samples cannot show it. On a wider site the
  40 m grow with it, because samples lie farther apart there;
- variances from 0.02 to 10 times that of the samples: a few samples close together may under-estimate the field's
  variance by much, but hardly over-estimate it;
- parts of a sum may fade to 0.001, so that one part alone stays possible;
- the noise is the instrument's, and fixed.

"auto" chooses a kernel by its evidence, cautiously. Samples far apart cannot show how smooth a field is in between, and
the likelihood then prefers smooth kernels, whose intervals are the narrowest: on even lattices of 144 and 196 samples
of the embedded regions, the squared exponential was within 2.1 of the best evidence 19 times in 20, and its 68 %
intervals covered 38 to 67 %. So "auto" takes the first of ``CAUTIOUS_FIRST`` that no other kernel beats by very strong
evidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from he3.errors import InvalidInput, NumericalFailure
from he3.frames import FloatArray, as_points
from he3.kernels import (
    AUTO,
    KERNELS,
    Kernel,
    Matern12,
    SmoothPlusRough,
    kernel_from,
    squared_distances,
    with_log_parameters,
)
from he3.layer_selection import in_shares
from he3.likelihood import log_marginal_likelihood
from he3.local_amplitude import prior_variance_at
from he3.warping import LEAST_SLOPE, Warp

if TYPE_CHECKING:
    from he3.trend import CovariateTrend, Trend

DEFAULT_NOISE_STD_PPB = 0.1  # ppb, the sensor's, PAPER
EXTENT_M = 500.0  # m, width of the site that the following length scales are for, PAPER
LENGTH_SCALE_BOUNDS_M = (5.0, EXTENT_M)  # m, see above
SMOOTH_LENGTH_SCALE_BOUNDS_M = (40.0, EXTENT_M)  # m, see above
ROUGH_LENGTH_SCALE_BOUNDS_M = (5.0, 60.0)  # m, see above
WIDEST_SPACING_M = 40.0  # m, largest lower bound of an exponential covariance's length scale, see above
VARIANCE_BOUNDS = (0.02, 10.0)  # 1, of the samples' variance, see above
PART_VARIANCE_BOUNDS = (0.001, 10.0)  # 1, of the samples' variance, see above
# 1, smallest noise variance that any computation uses, as a share of the field's prior variance: a noise of a
# ten-thousandth of the field's standard deviation. It bounds the condition number of the covariance of n samples by
# n 1e8, for any places and any unit of the field, which a float64 Cholesky factorisation survives.
NOISE_VARIANCE_FLOOR = 1e-8
CAUTIOUS_FIRST = ("smooth+rough", "matern12", "matern32", "matern52", "se")
"""Kernels, the least smooth first. The kernels of fields without derivatives come first, and of these the sum, which
contains most others; the rest follow by the number of derivatives of their fields."""
VERY_STRONG_EVIDENCE = 5.0  # 1, natural logarithm of a ratio of evidences (Kass & Raftery 1995)
MIN_SAMPLES = 5  # 1, below it the likelihood tells next to nothing: the previous or default kernel is kept
MIN_SCALE_IN_NOISE = 5.0  # 1, samples that vary by fewer noise standard deviations do not show the field's variation
# 1, of the samples' largest magnitude: variation below it is not resolved by a float32 map, whose rounding is 6e-8.
MIN_SCALE_OF_LEVEL = 1e-6
# 1, the same for fewer than ``MIN_SAMPLES``, whose own variation is no estimate of the field's, ASSUMED.
MIN_SCALE_OF_LEVEL_OF_FEW = 0.03
MIN_SCALE_PPB = 1e-3  # ppb, scale if all samples are 0 and so is the noise
_CANDIDATE_STARTS = 8  # starting points whose likelihood is evaluated; the best few are followed
_FOLLOWED_STARTS = 2
_MAX_ITERATIONS = 60

Bounds = list[tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Hyperparameters:
    """Kernel in standardised units, noise, and the standardisation z = (y - trend - mean_ppb) / scale_ppb.

    log_likelihood: of the observations [ppb] that they were fitted to, NaN if they were not fitted. alternatives:
    weights, whose sum is 1, and kernels that together stand for what the samples leave possible (``he3.mixture``);
    empty where ``kernel`` is taken for certain. noises_ppb: the noise's standard deviation under each alternative;
    empty where it is that of these under all.
    """

    kernel: Kernel
    noise_std_ppb: float = DEFAULT_NOISE_STD_PPB
    mean_ppb: float = 0.0
    scale_ppb: float = 1.0
    log_likelihood: float = math.nan
    trend: Trend | None = None
    alternatives: tuple[tuple[float, Kernel], ...] = ()
    noises_ppb: tuple[float, ...] = ()
    trend_shares: tuple[float, ...] = ()
    """Multiples of the prior standard deviations of a trend's first weights (``he3.layer_selection``); empty: 1."""
    warp: Warp | None = None
    """Of the field (``he3.warping``): kernel, mean, scale and noise are then of the latent field; None: no warp."""
    warps: tuple[Warp | None, ...] = ()
    """That of each alternative; empty where none has one. With a trend from orbit there is none."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale_ppb) and self.scale_ppb > 0 and math.isfinite(self.mean_ppb)):
            raise InvalidInput(f"expected a finite mean and a positive scale, got {self.mean_ppb} and {self.scale_ppb}")
        if not (math.isfinite(self.noise_std_ppb) and self.noise_std_ppb >= 0):
            raise InvalidInput(f"expected a noise standard deviation of 0 or more, got {self.noise_std_ppb!r} ppb")
        if self.noises_ppb and len(self.noises_ppb) != len(self.alternatives):
            raise InvalidInput(f"expected a noise for each of {len(self.alternatives)}, got {len(self.noises_ppb)}")
        if self.warps and len(self.warps) != len(self.alternatives):
            raise InvalidInput(f"expected a warp for each of {len(self.alternatives)}, got {len(self.warps)}")

    @property
    def noise_variance(self) -> float:
        """Noise variance in standardised units, at least ``NOISE_VARIANCE_FLOOR`` of the kernel's variance."""
        return max((self.noise_std_ppb / self.scale_ppb) ** 2, NOISE_VARIANCE_FLOOR * self.kernel.prior_variance)

    def noise_variances(self, values_ppb: FloatArray) -> FloatArray | float:
        """Noise variance of observations (n,) [ppb] in standardised units: one for all, or (n,) with a warp.

        The stated noise is one in ppb, so in the latent field it is the warp's slope there times as much.
        """
        return self.noise_variance if self.warp is None else self._with_slope(self.warp.noise_slope(values_ppb))

    @property
    def least_noise_variance(self) -> float:
        """The least noise variance that any observation has, in standardised units."""
        return self.noise_variance if self.warp is None else float(self._with_slope(np.array(LEAST_SLOPE)))

    def _with_slope(self, slope: FloatArray) -> FloatArray:
        """Noise variances in standardised units; a change of the field is ``slope`` times as much in the latent."""
        assert self.warp is not None
        more = (self.warp.noise_std_ppb / self.scale_ppb) ** 2 * (slope * slope - 1.0)
        return np.maximum(self.noise_variance + more, NOISE_VARIANCE_FLOOR * self.kernel.prior_variance)

    @property
    def noise_variance_ppb2(self) -> float:
        """Noise variance [ppb^2], as ``information_gain`` takes it beside a covariance in ppb^2."""
        return self.noise_variance * self.scale_ppb**2

    @property
    def field_std_ppb(self) -> float:
        """Standard deviation of the field under the kernel [ppb], a trend's uncertainty excepted."""
        return self.scale_ppb * math.sqrt(self.kernel.prior_variance)

    def with_kernel_of(self, other: Hyperparameters) -> Hyperparameters:
        """These with the kernel of others, in the units of these."""
        ratio = (other.scale_ppb / self.scale_ppb) ** 2
        parameters = {
            key: value * ratio if key.endswith("variance") else value
            for key, value in other.kernel.parameters().items()
        }
        return replace(self, kernel=kernel_from(other.kernel.name, parameters), log_likelihood=other.log_likelihood)

    def standardise(self, xy_m: FloatArray, values_ppb: FloatArray) -> FloatArray:
        """Observations (n,) [ppb] at places (n, 2) [m] in standardised units: less trend and mean, over the scale.

        With a warp, those of the latent field.
        """
        latent_ppb = values_ppb if self.warp is None else self.warp.latent(values_ppb)
        return (latent_ppb - self.prior_mean_ppb(xy_m)) / self.scale_ppb

    def prior_mean_ppb(self, xy_m: FloatArray) -> FloatArray:
        """Mean of the field (n,) [ppb] at places (n, 2) [m] before any sample; with a warp, of the latent field."""
        if self.trend is None:
            return np.full(len(xy_m), self.mean_ppb)
        return self.trend.at(xy_m) + self.mean_ppb

    def trend_basis(self, xy_m: FloatArray) -> FloatArray | None:
        """Columns (n, p) whose outer product is the trend's covariance in standardised units; None without a trend."""
        return None if self.trend is None else in_shares(self.trend.basis(xy_m, self.scale_ppb), self.trend_shares)

    def covariance(self, a_m: FloatArray, b_m: FloatArray) -> FloatArray:
        """Prior covariance (N, M) between places a (N, 2) and b (M, 2) [m] in standardised units, trend included."""
        covariance = self.kernel.covariance(a_m, b_m)
        basis = self.trend_basis(a_m)
        if basis is not None:
            other = self.trend_basis(b_m)
            assert other is not None
            covariance += basis @ other.T
        return covariance

    def prior_variance(self, xy_m: FloatArray) -> FloatArray:
        """Prior variance (n,) at places (n, 2) [m] in standardised units, trend included."""
        variance = prior_variance_at(self.kernel, xy_m)
        basis = self.trend_basis(xy_m)
        if basis is not None:
            variance += (basis * basis).sum(axis=1)
        return variance


def parameter_bounds(kernel: Kernel, spacing_m: float = 0.0, extent_m: float = EXTENT_M) -> Bounds:
    """Lower and upper bound of each of the kernel's parameters, in their order.

    spacing_m: typical spacing of the samples [m]. extent_m: the site's longer side [m]. Raises InvalidInput for an
    extent that is not positive.
    """
    widening = _widening(extent_m)
    shortest_m = min(spacing_m, WIDEST_SPACING_M * widening)
    if isinstance(kernel, SmoothPlusRough):
        smooth_low, smooth_high = SMOOTH_LENGTH_SCALE_BOUNDS_M
        rough_low, rough_high = ROUGH_LENGTH_SCALE_BOUNDS_M
        smooth = (smooth_low * widening, smooth_high * widening)
        rough = (max(rough_low, shortest_m), rough_high * widening)
        return [PART_VARIANCE_BOUNDS, smooth, PART_VARIANCE_BOUNDS, rough]
    low, high = LENGTH_SCALE_BOUNDS_M
    if isinstance(kernel, Matern12):
        low = max(low, shortest_m)
    return [VARIANCE_BOUNDS, (low, high * widening)]


def _widening(extent_m: float) -> float:
    """Ratio of the site's width to ``EXTENT_M``, for which the length scales here are given; at least 1."""
    if not (math.isfinite(extent_m) and extent_m > 0):
        raise InvalidInput(f"expected a positive width of the site, got {extent_m!r} m")
    return max(1.0, extent_m / EXTENT_M)


def typical_spacing_m(xy_m: FloatArray) -> float:
    """Median distance [m] from a place (n, 2) to the nearest other one, repeated places counted once; 0 for one."""
    distinct = np.unique(xy_m, axis=0)
    if len(distinct) < 2:
        return 0.0
    return float(np.median(cKDTree(distinct).query(distinct, k=2)[0][:, 1]))


def _including(bounds: Bounds, previous: Hyperparameters | None, kernel: Kernel, extent_m: float) -> Bounds:
    """The bounds, extended to a shorter length scale of the previous fit, so that no refit is less likely than it."""
    if previous is None or previous.kernel.name != kernel.name:
        return bounds
    widest = parameter_bounds(kernel, extent_m=extent_m)
    return [
        (max(least, min(low, value)), high) if name.endswith("length_scale_m") else (low, high)
        for (name, value), (low, high), (least, _) in zip(
            previous.kernel.parameters().items(), bounds, widest, strict=True
        )
    ]


def fit_hyperparameters(
    xy_m: FloatArray,
    values_ppb: FloatArray,
    kernel_name: str,
    *,
    rng: np.random.Generator,
    noise_std_ppb: float = DEFAULT_NOISE_STD_PPB,
    previous: Hyperparameters | None = None,
    trend: CovariateTrend | None = None,
    trend_shares: tuple[float, ...] = (),
    extent_m: float = EXTENT_M,
    nearby: bool = False,
) -> Hyperparameters:
    """The maximum-likelihood hyperparameters of the samples, within the bounds of this module.

    xy_m: places (n, 2) [m]. values_ppb: observations (n,) [ppb]. kernel_name: one of ``KERNELS``, or "auto", which fits
    every kernel and keeps the most cautious that the evidence allows. extent_m: the site's longer side [m], up to
    which a length scale may go. The search is by L-BFGS-B from several starts, of which ``previous`` is one: the
    result is never less likely than the previous hyperparameters of that kernel on these samples. With fewer than
    ``MIN_SAMPLES`` the kernel stays at its previous or default value. trend_shares: as of ``Hyperparameters``. nearby:
    whether ``previous``, if it is of that kernel, is the only start, which takes a third of the time. Raises
    InvalidInput for shapes that do not fit, values that are not finite, or an unknown kernel.
    """
    xy = as_points(xy_m)
    values = np.asarray(values_ppb, dtype=np.float64)
    if values.shape != (len(xy),) or not np.isfinite(values).all():
        raise InvalidInput(f"expected {len(xy)} finite values, one per place, got shape {values.shape}")
    data = _Data(xy, values, noise_std_ppb, trend, trend_shares, extent_m, nearby)
    if kernel_name == AUTO:
        return _fit_best_kernel(data, rng, previous)
    return _fit(data, kernel_from(kernel_name), rng, previous)


def information_criterion(fitted: Hyperparameters) -> float:
    """Akaike's information criterion as a log evidence: log likelihood - p, p parameters (Akaike 1974); more is better.

    Its penalty per parameter does not grow with the number of samples, which therefore never rules out a kernel that
    contains another.
    """
    return fitted.log_likelihood - len(fitted.kernel.parameters())


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    """The samples of a fit, places (n, 2) [m] and values (n,) [ppb], with the instrument's noise, trend and extent."""

    xy: FloatArray
    values: FloatArray
    noise_std_ppb: float
    trend: CovariateTrend | None
    trend_shares: tuple[float, ...]
    extent_m: float
    nearby: bool

    def __len__(self) -> int:
        return len(self.xy)

    def residual(self) -> FloatArray:
        """Values less the trend (n,) [ppb]."""
        return self.values if self.trend is None else self.values - self.trend.at(self.xy)

    def scale_ppb(self, residual: FloatArray) -> float:
        """Standard deviation of the residual [ppb], at least the smallest that a fit accepts."""
        level = float(np.abs(self.values).max()) if len(self) else 0.0
        of_level = MIN_SCALE_OF_LEVEL if len(self) >= MIN_SAMPLES else MIN_SCALE_OF_LEVEL_OF_FEW
        least = max(MIN_SCALE_IN_NOISE * self.noise_std_ppb, of_level * level)
        return max(float(residual.std()) if len(self) else 1.0, least if least > 0.0 else MIN_SCALE_PPB)


def _fit_best_kernel(data: _Data, rng: np.random.Generator, previous: Hyperparameters | None) -> Hyperparameters:
    fits: list[Hyperparameters] = []
    for name in KERNELS:
        warm = previous if previous is not None and previous.kernel.name == name else None
        fits.append(_fit(data, kernel_from(name), rng, warm))
    if len(data) < MIN_SAMPLES:
        return next((fit for fit in fits if previous is not None and fit.kernel.name == previous.kernel.name), fits[0])
    evidence = {fit.kernel.name: information_criterion(fit) for fit in fits}
    least = max(evidence.values()) - VERY_STRONG_EVIDENCE
    chosen = next(name for name in CAUTIOUS_FIRST if evidence[name] >= least)
    return next(fit for fit in fits if fit.kernel.name == chosen)


def _fit(data: _Data, default: Kernel, rng: np.random.Generator, previous: Hyperparameters | None) -> Hyperparameters:
    residual = data.residual()
    mean = float(residual.mean()) if len(data) else 0.0
    scale = data.scale_ppb(residual)
    z = (residual - mean) / scale
    bounds = parameter_bounds(default, typical_spacing_m(data.xy), data.extent_m)
    bounds = _including(bounds, previous, default, data.extent_m)
    warm = None
    if previous is not None and previous.kernel.name == default.name:
        warm = _in_scale(previous, scale, bounds)
    basis = None if data.trend is None else in_shares(data.trend.basis(data.xy, scale), data.trend_shares)
    problem = LikelihoodProblem(
        default=default,
        r2=squared_distances(data.xy, data.xy),
        z=z,
        trend_covariance=None if basis is None else basis @ basis.T,
        noise=(data.noise_std_ppb / scale) ** 2,
        bounds=np.log(np.array(bounds)),
    )
    if len(data) < MIN_SAMPLES:
        best = problem.start(warm or default)
    elif data.nearby and warm is not None:
        best = problem.solve([problem.start(warm)])
    else:
        best = problem.solve(_starts(problem, warm, default, rng, _widening(data.extent_m)))
    kernel = with_log_parameters(default, best)
    likelihood = -problem.cost(best)[0] - len(z) * math.log(scale) if len(z) else math.nan
    return Hyperparameters(
        kernel, data.noise_std_ppb, mean, scale, likelihood, data.trend, trend_shares=data.trend_shares
    )


def _in_scale(previous: Hyperparameters, scale: float, bounds: Sequence[tuple[float, float]]) -> Kernel:
    """The previous kernel in units of the new scale, within the bounds."""
    ratio = (previous.scale_ppb / scale) ** 2
    parameters = {
        key: min(max(value * ratio if key.endswith("variance") else value, low), high)
        for (key, value), (low, high) in zip(previous.kernel.parameters().items(), bounds, strict=True)
    }
    return kernel_from(previous.kernel.name, parameters)


@dataclass(frozen=True, slots=True)
class LikelihoodProblem:
    """Minus the log likelihood, to be minimised over the logarithms of the kernel's parameters.

    noise: the instrument's noise variance in standardised units. Where it is below the floor, the floor is used, which
    grows with the kernel's variances.
    """

    default: Kernel
    r2: FloatArray
    z: FloatArray
    trend_covariance: FloatArray | None
    noise: float
    bounds: FloatArray

    def kernel_at(self, theta: FloatArray) -> Kernel:
        """The kernel of these parameters (p,)."""
        return with_log_parameters(self.default, theta)

    def noise_at(self, theta: FloatArray) -> float:
        """The noise variance in standardised units, as these parameters (p,) have it."""
        del theta
        return self.noise

    def start(self, kernel: Kernel) -> FloatArray:
        """The kernel's log parameters (p,), within bounds."""
        parameters = np.log(list(kernel.parameters().values()))
        return np.clip(parameters, self.bounds[:, 0], self.bounds[:, 1])

    def cost(self, log_parameters: FloatArray) -> tuple[float, FloatArray]:
        """Minus the log likelihood, and its gradient (p,)."""
        kernel = with_log_parameters(self.default, log_parameters)
        floor = NOISE_VARIANCE_FLOOR * kernel.prior_variance
        noise = max(self.noise, floor)
        value, gradient = log_marginal_likelihood(kernel, noise, self.r2, self.z, self.trend_covariance)
        by_parameters, by_noise = gradient[:-1], float(gradient[-1])
        if noise > self.noise:  # noise is proportional to the sum of the variances
            shares = [v if name.endswith("variance") else 0.0 for name, v in kernel.parameters().items()]
            by_parameters = by_parameters + by_noise * np.array(shares) / kernel.prior_variance
        return -value, -by_parameters

    def solve(self, starts: Sequence[FloatArray]) -> FloatArray:
        """The best of the optima (p,) that the starts lead to. Raises NumericalFailure if none is finite."""
        return best_optimum(self.cost, starts, self.bounds, f"a likelihood for {self.default.name!r}")


def best_optimum(
    cost: Callable[[FloatArray], tuple[float, FloatArray]], starts: Sequence[FloatArray], bounds: FloatArray, of: str
) -> FloatArray:
    """The best of the minima (p,) of a cost with gradient that the starts lead to, within bounds (p, 2).

    Raises NumericalFailure, with the name of what the cost is of, if none is finite.
    """
    from scipy.optimize import minimize  # a tenth of a second, in processes that never fit

    best, lowest = starts[0], math.inf
    for start in starts:
        found = minimize(
            cost,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options={"maxiter": _MAX_ITERATIONS, "ftol": 1e-9, "gtol": 1e-4},
        )
        if found.fun < lowest:
            best, lowest = np.asarray(found.x), float(found.fun)
    if not math.isfinite(lowest):
        raise NumericalFailure(f"no start of {len(starts)} gave a finite value of {of}")
    return best


def _starts(
    problem: LikelihoodProblem, warm: Kernel | None, default: Kernel, rng: np.random.Generator, widening: float
) -> list[FloatArray]:
    """Starting points: the previous optimum if there is one, and the likeliest of the default and random ones.

    On a wide site the default is far shorter than the samples' spacing, where the likelihood is flat; there the default
    in proportion to the site is another candidate.
    """
    low, high = problem.bounds.T
    candidates = [problem.start(default)]
    candidates += [low + (high - low) * rng.random(len(low)) for _ in range(_CANDIDATE_STARTS - 1)]
    if widening > 1.0:
        candidates.append(problem.start(_widened(default, widening)))
    candidates.sort(key=lambda start: problem.cost(start)[0])
    if warm is None:
        return candidates[:_FOLLOWED_STARTS]
    return [problem.start(warm), *candidates[: _FOLLOWED_STARTS - 1]]


def _widened(kernel: Kernel, widening: float) -> Kernel:
    """The kernel with its length scales multiplied by the widening."""
    parameters = {
        key: value * widening if key.endswith("length_scale_m") else value for key, value in kernel.parameters().items()
    }
    return kernel_from(kernel.name, parameters)
