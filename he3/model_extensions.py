"""Which further parameters samples speak for: unstated noise, a stretch, or both, with their priors.

A field is taken for isotropic and the noise for the stated one unless the samples say otherwise. Each extension is a
model of its own beside the plain one, with prior odds below one and a prior of its parameters; its weight in the
mixture follows from its evidence. That of more parameters has to pay for them, so an extension that explains nothing
ends with less than its prior odds.

Only the kernels of rough fields learn noise. A kernel of smooth fields takes a rough field's own variation for noise,
and the map of what is left is too certain: with Matern 5/2 on 11 fields of the exam, 150 samples each, 63 % of the
cells lay within 68 % intervals, 68 % without.

Most fields need none, and shall not pay for the question. So an extension is fitted only if some of a few settings of
its parameters, with the kernel as it is, are likelier than the plain model by ``LEAST_GAIN``.

- *Noise beside the stated one.* The variance is s^2 + e^2, with s the stated standard deviation and e a log-normal one:
  what the instrument's sheet leaves out, and variation of the field over less than the instrument's own footprint. It
  is never below s^2.
- *Two lengths and a bearing.* The squared length of an offset d is d' M d, with M = exp(S), S = [[a, b], [b, -a]] in
  east and north, and a, b normal about 0. So det M = 1, the ratio of the lengths is exp(sqrt(a^2 + b^2)), no bearing is
  preferred, and an isotropic field lies in the middle of the prior instead of at its edge.

The derivatives of M follow from M = cosh(r) I + sinh(r) / r S, with r^2 = a^2 + b^2, as S^2 = r^2 I. That of a kernel
by the squared distance is -1/2 of that by the logarithm of all its length scales, over the squared distance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_triangular

from he3.hyperparameters import NOISE_VARIANCE_FLOOR, LikelihoodProblem
from he3.kernels import Kernel, Matern12, SmoothPlusRough, Stretched, with_log_parameters
from he3.likelihood import log_marginal_likelihood

if TYPE_CHECKING:
    from he3.frames import FloatArray

NOISE_ODDS = 0.1  # 1, prior odds of unstated noise: nine of ten sheets state an instrument's noise rightly [assumed]
NOISE_SHARE = 0.1  # 1, median of unstated noise in the field's standard deviations, or the stated one if larger
NOISE_FACTOR = 2.5  # 1, of that median [assumed]
STRETCH_ODDS = 0.1  # 1, prior odds of two lengths instead of one: with 0.3, maps of real fields were worse [measured]
STRETCH_STD = 0.7  # 1, of both parameters of the metric: half of all ratios of lengths are above 2.3, 5 % above 5.5
LEAST_GAIN = 3.0  # 1, logarithm of a ratio of densities from which an extension is fitted
LEAST_SAMPLES = 12  # below it, samples tell next to nothing of either
_TRIED_NOISES = (-0.75, 0.0, 0.75, 1.5, 2.25)  # standard deviations of the prior, from its median
_TRIED_STRETCHES = (0.9, 1.8)  # standard deviations of the prior
_TRIED_BEARINGS = 4
_ROUND = 1e-6  # 1, logarithm of a stretch below which a kernel counts as isotropic: far below what samples can show


@dataclass(frozen=True, slots=True, eq=False)
class Extension:
    """A likelihood with further parameters, the normal priors of all of them, a start, and the odds of its model.

    medians, factors, start: (p,), those of the kernel first. start is in standard deviations from the medians.
    """

    likelihood: Extended
    medians: FloatArray
    factors: FloatArray
    start: FloatArray
    log_odds: float


def extensions(
    plain: LikelihoodProblem, medians: FloatArray, factors: FloatArray, mode: FloatArray, xy: FloatArray
) -> list[Extension]:
    """The extensions that the samples at ``xy`` (n, 2) [m] speak for, none of most fields.

    medians, factors, mode: (p,), priors of the plain model's logarithms, and its most probable parameters in standard
    deviations from the medians.
    """
    if len(plain.z) < LEAST_SAMPLES:
        return []
    found: dict[tuple[bool, bool], FloatArray] = {}
    least = plain.cost(medians + factors * mode)[0] - LEAST_GAIN
    tried = {(False, True): _stretches()}
    if isinstance(plain.default, Matern12 | SmoothPlusRough):
        tried[True, False] = [np.array([u]) for u in _TRIED_NOISES]
    for what, settings in tried.items():
        extension = _extension(plain, medians, factors, xy, what, mode, settings[0])
        costs = [_cost(extension, np.concatenate((mode, setting))) for setting in settings]
        best = int(np.argmin(costs))
        if costs[best] < least:
            found[what] = settings[best]
    if len(found) == 2:
        found[True, True] = np.concatenate((found[True, False], found[False, True]))
    return [_extension(plain, medians, factors, xy, what, mode, further) for what, further in found.items()]


def _stretches() -> list[FloatArray]:
    angles = 2.0 * np.pi * np.arange(_TRIED_BEARINGS) / _TRIED_BEARINGS
    return [size * np.array([math.cos(angle), math.sin(angle)]) for size in _TRIED_STRETCHES for angle in angles]


def _cost(extension: Extension, u: FloatArray) -> float:
    """Minus the log likelihood and the log prior of the further parameters."""
    further = u[len(extension.likelihood.default.parameters()) :]
    return extension.likelihood.value(extension.medians + extension.factors * u) + 0.5 * float(further @ further)


def _extension(
    plain: LikelihoodProblem,
    medians: FloatArray,
    factors: FloatArray,
    xy: FloatArray,
    what: tuple[bool, bool],
    mode: FloatArray,
    further: FloatArray,
) -> Extension:
    noise, stretch = what
    of_noise = math.log(max(NOISE_SHARE, math.sqrt(plain.noise)))
    more: Sequence[tuple[float, float]] = [(of_noise, math.log(NOISE_FACTOR))] * noise + [(0.0, STRETCH_STD)] * (
        2 * stretch
    )
    more_medians, more_factors = np.array(more).T
    likelihood = Extended(
        plain.default, plain.r2, plain.z, plain.trend_covariance, plain.noise, plain.bounds, xy, noise, stretch
    )
    log_odds = noise * math.log(NOISE_ODDS) + stretch * math.log(STRETCH_ODDS)
    return Extension(
        likelihood,
        np.concatenate((medians, more_medians)),
        np.concatenate((factors, more_factors)),
        np.concatenate((mode, further)),
        log_odds,
    )


@dataclass(frozen=True, slots=True)
class Extended(LikelihoodProblem):
    """A problem with further parameters after those of the kernel: log e, and a and b, each where it is learned.

    xy: places (n, 2) [m]. noise: the stated variance. learns_noise, learns_stretch: which further parameters there are.
    """

    xy: FloatArray
    learns_noise: bool
    learns_stretch: bool

    @property
    def _of_kernel(self) -> int:
        return len(self.default.parameters())

    def kernel_at(self, theta: FloatArray) -> Kernel:
        kernel = with_log_parameters(self.default, theta[: self._of_kernel])
        return stretched(kernel, *theta[-2:]) if self.learns_stretch else kernel

    def noise_at(self, theta: FloatArray) -> float:
        return self.noise + (math.exp(2.0 * theta[self._of_kernel]) if self.learns_noise else 0.0)

    def value(self, theta: FloatArray) -> float:
        """Minus the log likelihood, in half the time of ``cost``; infinity if the covariance cannot be factorised."""
        kernel = self.kernel_at(theta)
        isotropic = not isinstance(kernel, Stretched)
        total = kernel.of_squared_distance(self.r2) if isotropic else kernel.covariance(self.xy, self.xy)
        if self.trend_covariance is not None:
            total += self.trend_covariance
        n = len(self.z)
        total.flat[:: n + 1] += max(self.noise_at(theta), NOISE_VARIANCE_FLOOR * kernel.prior_variance)
        try:
            factor = np.linalg.cholesky(total)
        except np.linalg.LinAlgError:
            return math.inf
        whitened = solve_triangular(factor, self.z, lower=True, check_finite=False)
        half_log_determinant = float(np.log(factor.diagonal()).sum())
        return 0.5 * float(whitened @ whitened) + half_log_determinant + 0.5 * n * math.log(2.0 * math.pi)

    def cost(self, theta: FloatArray) -> tuple[float, FloatArray]:
        """Minus the log likelihood, and its gradient (p,)."""
        count = self._of_kernel
        kernel = with_log_parameters(self.default, theta[:count])
        stated = self.noise_at(theta)
        noise = max(stated, NOISE_VARIANCE_FLOOR * kernel.prior_variance)
        evaluated = _Stretching.of(kernel, self.xy, *theta[-2:]) if self.learns_stretch else kernel
        value, gradient = log_marginal_likelihood(evaluated, noise, self.r2, self.z, self.trend_covariance)
        by_kernel, by_noise = gradient[:count], float(gradient[-1])
        if noise > stated:
            shares = [v if name.endswith("variance") else 0.0 for name, v in kernel.parameters().items()]
            by_kernel = by_kernel + by_noise * np.array(shares) / kernel.prior_variance
        parts = [by_kernel]
        if self.learns_noise:
            parts.append(np.array([by_noise * 2.0 * (stated - self.noise) / noise]) * (noise <= stated))
        parts.append(gradient[count:-1])
        return -value, -np.concatenate(parts)


def stretched(kernel: Kernel, a: float, b: float) -> Kernel:
    """The kernel with the metric exp([[a, b], [b, -a]]); the kernel itself where that is the identity."""
    r = math.hypot(a, b)
    if r < _ROUND:
        return kernel
    # The shorter axis lies at half of atan2(b, a) from east, the longer one across it.
    return Stretched(kernel, math.exp(r), -0.5 * math.degrees(math.atan2(b, a)) % 180.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Stretching:
    """A kernel in a metric, with the derivatives of its covariances by the metric's parameters.

    lengths, by_a, by_b: squared lengths (n, n) [m^2] of the offsets between all samples, and their derivatives.
    """

    kernel: Kernel
    lengths: FloatArray
    by_a: FloatArray
    by_b: FloatArray

    @classmethod
    def of(cls, kernel: Kernel, xy: FloatArray, a: float, b: float) -> _Stretching:
        r = math.hypot(a, b)
        cosh = math.cosh(r)
        g = math.sinh(r) / r if r > _ROUND else 1.0
        h = (cosh - g) / (r * r) if r > _ROUND else 1.0 / 3.0  # dg/dr over r
        east = xy[:, 0, None] - xy[None, :, 0]
        north = xy[:, 1, None] - xy[None, :, 1]
        both, twice = east * east + north * north, 2.0 * east * north
        differ = east * east - north * north
        along_s = a * differ + b * twice  # d' S d
        lengths = np.maximum(cosh * both + g * along_s, 0.0)
        return cls(
            kernel,
            lengths,
            g * a * both + h * a * along_s + g * differ,
            g * b * both + h * b * along_s + g * twice,
        )

    def with_log_gradients(self, _r2: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        covariance, derivatives = self.kernel.with_log_gradients(self.lengths)
        by_lengths: FloatArray = np.zeros_like(covariance)
        for name, derivative in zip(self.kernel.parameters(), derivatives, strict=True):
            if name.endswith("length_scale_m"):
                by_lengths -= 0.5 * derivative
        np.divide(by_lengths, self.lengths, out=by_lengths, where=self.lengths > 0.0)
        return covariance, (*derivatives, by_lengths * self.by_a, by_lengths * self.by_b)
