"""What the belief is made of besides the samples, and how it is found: maximum likelihood within stated bounds.

Observations are standardised by their own mean and standard deviation when hyperparameters are fitted, and the kernel
lives in those units. Bounds, and why:

- length scales from 5 m, below which samples that planners keep 5 to 15 m apart say nothing about it, to the site's own
  width (500 m where it is less), beyond which it is a trend that no sample on the site can tell from another;
- the smooth part's from 40 m and the rough part's up to 60 m, so that each keeps to its role, both in proportion to the
  width where the site is wider than 500 m;
- an exponential covariance's from the typical distance between neighbouring samples, up to 40 m: under a shorter one
  they are all but independent, the likelihood is flat, and what it happens to prefer draws the map to its mean for
  nothing (2 % of RMSE on a lattice of 37 m); if the scale really is shorter, the samples cannot say so. On a wider
  site the 40 m grow with it, as samples lie farther apart there;
- variances from 0.02 to 10 times that of the samples: a handful of samples close together may under-estimate the
  field's variance by a lot, but hardly over-estimate it;
- parts of a sum may fade to 0.001, so that one part alone stays possible;
- the noise is the instrument's, and fixed, unless bounds for it are given.

"auto" chooses a kernel by its evidence, with caution. Samples far apart cannot see how smooth a field is in between,
and likelihood then leans to smooth kernels, whose intervals are the narrowest: on even lattices of 144 and 196 samples
of the embedded regions, the squared exponential was within 2.1 of the best evidence 19 times in 20, and its 68 %
intervals covered 38 to 67 %. So "auto" takes the first of ``CAUTIOUS_FIRST`` that the evidence does not speak very
strongly against.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
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
from he3.likelihood import likelihood_of_distances
from he3.trend import OrbitalTrend

DEFAULT_NOISE_STD_PPB = 0.1  # ppb, the paper's sensor
EXTENT_M = 500.0  # m, width of the site that the following length scales are for, see above
LENGTH_SCALE_BOUNDS_M = (5.0, EXTENT_M)  # m
SMOOTH_LENGTH_SCALE_BOUNDS_M = (40.0, EXTENT_M)  # m
ROUGH_LENGTH_SCALE_BOUNDS_M = (5.0, 60.0)  # m
WIDEST_SPACING_M = 40.0  # samples farther apart than this say nothing against a length scale of it, see above
VARIANCE_BOUNDS = (0.02, 10.0)  # of the samples' variance, see above
PART_VARIANCE_BOUNDS = (0.001, 10.0)  # of the samples' variance, see above
# Smallest noise variance in standardised units that any computation uses: a noise of a thousandth of the field's
# standard deviation. It bounds the condition number of n samples by n 1e6 (times the kernel's variance), which a
# float64 Cholesky and a float32 grid both survive; a map is not better for pretending to more.
NOISE_VARIANCE_FLOOR = 1e-6
CAUTIOUS_FIRST = ("smooth+rough", "matern12", "matern32", "matern52", "se")
"""Kernels from the one that promises least: not differentiable, the sum first as it holds most others; then the rest by
how often their fields can be differentiated."""
VERY_STRONG_EVIDENCE = 5.0  # logarithm of a ratio of evidences from which it is called that (Kass & Raftery 1995)
MIN_SAMPLES = 5  # below it the likelihood says next to nothing, and the previous or default kernel stays
SMALLEST_SCALE_IN_NOISE = (
    5.0  # samples that vary less than 5 noise standard deviations are not yet a measure of the field
)
_CANDIDATE_STARTS = 8  # starts whose likelihood is looked at; the best few are followed
_FOLLOWED_STARTS = 2
_ITERATIONS = 60

Bounds = list[tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Hyperparameters:
    """Kernel in standardised units, noise, and the standardisation z = (y - trend - mean_ppb) / scale_ppb.

    log_likelihood is that of the observations [ppb] they were fitted to, NaN if they were not fitted.
    """

    kernel: Kernel
    noise_std_ppb: float = DEFAULT_NOISE_STD_PPB
    mean_ppb: float = 0.0
    scale_ppb: float = 1.0
    log_likelihood: float = math.nan
    trend: OrbitalTrend | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale_ppb) and self.scale_ppb > 0 and math.isfinite(self.mean_ppb)):
            raise InvalidInput(f"expected a finite mean and a positive scale, got {self.mean_ppb} and {self.scale_ppb}")
        if not (math.isfinite(self.noise_std_ppb) and self.noise_std_ppb >= 0):
            raise InvalidInput(f"expected a noise standard deviation of 0 or more, got {self.noise_std_ppb!r} ppb")

    @property
    def noise_variance(self) -> float:
        """Noise variance in standardised units, never below the floor that keeps the algebra safe."""
        return max((self.noise_std_ppb / self.scale_ppb) ** 2, NOISE_VARIANCE_FLOOR)

    @property
    def noise_variance_ppb2(self) -> float:
        """The same in ppb^2: what ``information_gain`` takes beside a covariance in ppb^2."""
        return self.noise_variance * self.scale_ppb**2

    def standardise(self, xy_m: FloatArray, values_ppb: FloatArray) -> FloatArray:
        """Observations (n,) [ppb] at places (n, 2) [m] as the kernel sees them: no trend, no mean, unit scale."""
        return (values_ppb - self.prior_mean_ppb(xy_m)) / self.scale_ppb

    def prior_mean_ppb(self, xy_m: FloatArray) -> FloatArray:
        """Mean of the field (n,) [ppb] at places (n, 2) [m] before any sample."""
        if self.trend is None:
            return np.full(len(xy_m), self.mean_ppb)
        return self.trend.at(xy_m) + self.mean_ppb

    def trend_basis(self, xy_m: FloatArray) -> FloatArray | None:
        """Columns (n, 2) whose outer product is the trend's covariance in standardised units; None without a trend."""
        return None if self.trend is None else self.trend.basis(xy_m) / self.scale_ppb

    def covariance(self, a_m: FloatArray, b_m: FloatArray) -> FloatArray:
        """Prior covariance (N, M) between places a (N, 2) and b (M, 2) [m] in standardised units, trend included."""
        covariance = self.kernel.covariance(a_m, b_m)
        if self.trend is not None:
            covariance += (self.trend.basis(a_m) / self.scale_ppb) @ (self.trend.basis(b_m) / self.scale_ppb).T
        return covariance

    def prior_variance(self, xy_m: FloatArray) -> FloatArray:
        """Prior variance (n,) at places (n, 2) [m] in standardised units, trend included."""
        variance = np.full(len(xy_m), self.kernel.prior_variance, dtype=np.float64)
        basis = self.trend_basis(xy_m)
        if basis is not None:
            variance += (basis * basis).sum(axis=1)
        return variance


def parameter_bounds(kernel: Kernel, spacing_m: float = 0.0, extent_m: float = EXTENT_M) -> Bounds:
    """Lower and upper bound of each of the kernel's parameters, in their order.

    For samples of that typical spacing [m] on a site of that width [m], the larger one if its sides differ.
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
    """How many times wider the site is than what the length scales of this module are for, 1 if it is not."""
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
    """The bounds, widened where earlier hyperparameters have a shorter length scale: no fit is worse than the last."""
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
    noise_bounds_ppb: tuple[float, float] | None = None,
    previous: Hyperparameters | None = None,
    trend: OrbitalTrend | None = None,
    extent_m: float = EXTENT_M,
) -> Hyperparameters:
    """The hyperparameters under which the samples are likeliest, within the bounds of this module.

    xy_m: places (n, 2) [m]; values_ppb: observations (n,) [ppb]; kernel_name: one of ``KERNEL_NAMES``, where "auto"
    fits every kernel and keeps the most cautious that the evidence allows (see above); extent_m: the site's width [m],
    up to which a length scale may go. The search is by L-BFGS-B from several starts, of which ``previous`` is one: the
    result is never less likely than the previous hyperparameters of that kernel on these samples. With fewer than
    FEWEST_SAMPLES the kernel stays what it was, or at its default.
    Raises InvalidInput for shapes that do not fit, values that are not finite, or an unknown kernel.
    """
    xy = as_points(xy_m)
    values = np.asarray(values_ppb, dtype=np.float64)
    if values.shape != (len(xy),) or not np.isfinite(values).all():
        raise InvalidInput(f"expected {len(xy)} finite values, one a place, got shape {values.shape}")
    if kernel_name == AUTO:
        return _fit_best_kernel(xy, values, rng, noise_std_ppb, noise_bounds_ppb, previous, trend, extent_m)
    return _fit(xy, values, kernel_from(kernel_name), rng, noise_std_ppb, noise_bounds_ppb, previous, trend, extent_m)


def information_criterion(fitted: Hyperparameters) -> float:
    """Akaike's information criterion as a log evidence: log likelihood - p, p parameters (Akaike 1974); more is better.

    Its price of a parameter does not grow with the samples, so that a kernel which holds another is not ruled out by
    their number alone.
    """
    return fitted.log_likelihood - len(fitted.kernel.parameters())


def _fit_best_kernel(
    xy: FloatArray,
    values: FloatArray,
    rng: np.random.Generator,
    noise_std_ppb: float,
    noise_bounds_ppb: tuple[float, float] | None,
    previous: Hyperparameters | None,
    trend: OrbitalTrend | None,
    extent_m: float,
) -> Hyperparameters:
    fits: list[Hyperparameters] = []
    for name in KERNELS:
        warm = previous if previous is not None and previous.kernel.name == name else None
        fits.append(_fit(xy, values, kernel_from(name), rng, noise_std_ppb, noise_bounds_ppb, warm, trend, extent_m))
    if len(xy) < MIN_SAMPLES:
        return next((fit for fit in fits if previous is not None and fit.kernel.name == previous.kernel.name), fits[0])
    evidence = {fit.kernel.name: information_criterion(fit) for fit in fits}
    least = max(evidence.values()) - VERY_STRONG_EVIDENCE
    chosen = next(name for name in CAUTIOUS_FIRST if evidence[name] >= least)
    return next(fit for fit in fits if fit.kernel.name == chosen)


def _fit(
    xy: FloatArray,
    values: FloatArray,
    default: Kernel,
    rng: np.random.Generator,
    noise_std_ppb: float,
    noise_bounds_ppb: tuple[float, float] | None,
    previous: Hyperparameters | None,
    trend: OrbitalTrend | None,
    extent_m: float,
) -> Hyperparameters:
    residual = values if trend is None else values - trend.at(xy)
    mean = float(residual.mean()) if len(residual) else 0.0
    smallest = max(SMALLEST_SCALE_IN_NOISE * noise_std_ppb, 1e-3)
    scale = max(float(residual.std()) if len(residual) else 1.0, smallest)
    z = (residual - mean) / scale
    bounds = _including(parameter_bounds(default, typical_spacing_m(xy), extent_m), previous, default, extent_m)
    warm = None
    if previous is not None and previous.kernel.name == default.name:
        warm = _in_scale(previous, scale, bounds)
    noise_bounds = None
    if noise_bounds_ppb is not None:
        low, high = noise_bounds_ppb
        if not 0 < low <= high:
            raise InvalidInput(f"expected noise bounds 0 < low <= high [ppb], got {noise_bounds_ppb}")
        noise_bounds = (
            max(low / scale, NOISE_VARIANCE_FLOOR**0.5) ** 2,
            max(high / scale, NOISE_VARIANCE_FLOOR**0.5) ** 2,
        )
    noise = max((noise_std_ppb / scale) ** 2, NOISE_VARIANCE_FLOOR)
    if noise_bounds is not None:
        before = noise if previous is None else (previous.noise_std_ppb / scale) ** 2
        noise = min(max(before, noise_bounds[0]), noise_bounds[1])
    basis = None if trend is None else trend.basis(xy) / scale
    problem = _Problem(
        default=default,
        r2=squared_distances(xy, xy),
        z=z,
        trend_covariance=None if basis is None else basis @ basis.T,
        noise=noise,
        bounds=np.log(np.array(bounds + ([noise_bounds] if noise_bounds else []))),
    )
    if len(xy) < MIN_SAMPLES:
        best = problem.start(warm or default)
    else:
        best = problem.solve(_starts(problem, warm, default, rng, _widening(extent_m)))
    kernel = with_log_parameters(default, best[: len(bounds)])
    if noise_bounds is not None:
        noise_std_ppb = float(np.exp(0.5 * best[-1])) * scale
    likelihood = -problem.cost(best)[0] - len(z) * math.log(scale) if len(z) else math.nan
    return Hyperparameters(kernel, noise_std_ppb, mean, scale, likelihood, trend)


def _in_scale(previous: Hyperparameters, scale: float, bounds: Sequence[tuple[float, float]]) -> Kernel:
    """The previous kernel in units of the new scale, within bounds."""
    ratio = (previous.scale_ppb / scale) ** 2
    parameters = {
        key: min(max(value * ratio if key.endswith("variance") else value, low), high)
        for (key, value), (low, high) in zip(previous.kernel.parameters().items(), bounds, strict=True)
    }
    return kernel_from(previous.kernel.name, parameters)


@dataclass(frozen=True, slots=True)
class _Problem:
    """Minimise minus the log likelihood over the logarithms of the parameters, the noise's last if it is free."""

    default: Kernel
    r2: FloatArray
    z: FloatArray
    trend_covariance: FloatArray | None
    noise: float
    bounds: FloatArray

    @property
    def noise_is_free(self) -> bool:
        return len(self.bounds) > len(self.default.parameters())

    def start(self, kernel: Kernel) -> FloatArray:
        parameters = np.log(list(kernel.parameters().values()))
        if self.noise_is_free:
            parameters = np.append(parameters, np.log(self.noise))
        return np.clip(parameters, self.bounds[:, 0], self.bounds[:, 1])

    def cost(self, log_parameters: FloatArray) -> tuple[float, FloatArray]:
        count = len(self.default.parameters())
        noise = float(np.exp(log_parameters[-1])) if self.noise_is_free else self.noise
        kernel = with_log_parameters(self.default, log_parameters[:count])
        value, gradient = likelihood_of_distances(kernel, noise, self.r2, self.z, self.trend_covariance)
        return -value, -gradient[: len(self.bounds)]

    def solve(self, starts: Sequence[FloatArray]) -> FloatArray:
        best, lowest = starts[0], math.inf
        for start in starts:
            found = minimize(
                self.cost,
                start,
                jac=True,
                method="L-BFGS-B",
                bounds=self.bounds,
                options={"maxiter": _ITERATIONS, "ftol": 1e-9, "gtol": 1e-4},
            )
            if found.fun < lowest:
                best, lowest = np.asarray(found.x), float(found.fun)
        if not math.isfinite(lowest):
            raise NumericalFailure(f"no start of {len(starts)} gave a finite likelihood for {self.default.name!r}")
        return best


def _starts(
    problem: _Problem, warm: Kernel | None, default: Kernel, rng: np.random.Generator, widening: float
) -> list[FloatArray]:
    """Where to start: the previous optimum if there is one, and the likeliest of the default and some random places.

    On a wide site the default is far shorter than samples lie apart, where the likelihood is flat; so there the default
    in proportion to the site is another start.
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
    """The kernel with length scales so many times as long."""
    parameters = {
        key: value * widening if key.endswith("length_scale_m") else value for key, value in kernel.parameters().items()
    }
    return kernel_from(kernel.name, parameters)
