"""Sets of sample places after which the standard deviation at all targets is at most a goal: a cover.

The posterior variance does not depend on the measured values, so a design can be judged before it is sampled: with
samples at places P besides those taken, for each kernel k and target T,

    var_k(T | P) <= goal^2

where the variance is that of the joint posterior. (A cover that asks of every target that one sample alone suffices,
as coverage planners do, needs about twice as many.) The steps are

- *greedy*: the candidate that removes most of what exceeds the goal, sum_T max(var - goal^2, 0), is added until nothing
  does. The truncated sum makes a covering problem of it (Krause et al., J. Mach. Learn. Res. 9, 2008, section 5);
- *pruning*: a place without which the goal still holds is removed. All removals are judged from one factorisation:
  var without i = var + b_i^2 / (A^-1)_ii with A the covariance of the places plus noise and b = A^-1 c(P, T);
- *descent*: the gradient of the mean squared excess by the places, for planners that move them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from he3.errors import InvalidInput, NumericalFailure
from he3.frames import FloatArray
from he3.local_amplitude import LocallyScaled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from he3.certificate import Targets
    from he3.gp import Hyperparameters
    from he3.kernels import Kernel

MARGIN = 0.02
"""Share of the goal's variance below it from which on an excess counts in a descent."""
_SOFTENING = 1e-4  # 1, of a length scale, squared, so that slopes are finite at the place itself
ROUNDING = 1e-7  # 1, of the field's variance, noise that makes up for rounding; it lets a design look worse, not better
_NOTHING = 1e-9  # 1, excess as a share of the goal's variance that counts as none


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """The targets under one kernel, given the samples taken, in standardised units."""

    hyperparameters: Hyperparameters
    targets: Targets
    sampled_m: FloatArray
    factor: FloatArray
    """(t, t) Cholesky factor of the covariance of the samples taken, plus noise."""
    whitened: FloatArray
    """(t, T): factor^-1 times the covariance of samples and targets."""
    variance: FloatArray
    """(T,) variance of the targets given the samples taken."""
    most: FloatArray | float
    """The goal's variance: one, or with a warp that of the latent field at each target (T,)."""

    @classmethod
    def of(cls, hyperparameters: Hyperparameters, targets: Targets, sampled_m: FloatArray, std_ppb: float) -> _Part:
        flat = targets.points_m.reshape(-1, 2)
        variance = targets.prior_variance(hyperparameters.kernel)
        basis = hyperparameters.trend_basis(flat)
        if basis is not None:
            over = targets.means(basis.T)
            variance = variance + (over * over).sum(axis=0)
        factor, whitened = np.zeros((0, 0)), np.zeros((0, len(targets)))
        if len(sampled_m):
            factor = _factored(hyperparameters.covariance(sampled_m, sampled_m), hyperparameters.noise_variance)
            cross = targets.means(hyperparameters.covariance(sampled_m, flat))
            whitened = solve_triangular(factor, cross, lower=True, check_finite=False)
            variance = variance - (whitened * whitened).sum(axis=0)
        most: FloatArray | float = (std_ppb / hyperparameters.scale_ppb) ** 2
        if hyperparameters.warp is not None and targets.levels_ppb is not None:
            # To first order, the field's standard deviation is that of the latent one over the slope of the inverse.
            most = most * hyperparameters.warp.slope(targets.levels_ppb) ** 2
        return cls(hyperparameters, targets, sampled_m, factor, whitened, variance, most)

    def whitened_at(self, places_m: FloatArray) -> FloatArray:
        """(t, n): factor^-1 times the covariance of samples taken and places."""
        if not len(self.sampled_m):
            return np.zeros((0, len(places_m)))
        cross = self.hyperparameters.covariance(self.sampled_m, places_m)
        whitened: FloatArray = solve_triangular(self.factor, cross, lower=True, check_finite=False)
        return whitened

    def given_taken(self, places_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Covariances given the samples taken, of places and targets (n, T) and among places (n, n); the whitened."""
        own, whitened = self.hyperparameters, self.whitened_at(places_m)
        cross = self.targets.means(own.covariance(places_m, self.targets.points_m.reshape(-1, 2)))
        return cross - whitened.T @ self.whitened, own.covariance(places_m, places_m) - whitened.T @ whitened, whitened

    def excess(self, places_m: FloatArray) -> FloatArray:
        """(T,) variance beyond the goal's, as a share of it, with further samples at places (n, 2) [m]."""
        variance = self.variance
        if len(places_m):
            cross, among, _ = self.given_taken(places_m)
            factor = _factored(among, self.hyperparameters.noise_variance)
            lowered = solve_triangular(factor, cross, lower=True, check_finite=False)
            variance = variance - (lowered * lowered).sum(axis=0)
        return variance / self.most - 1.0

    def excess_without(self, places_m: FloatArray) -> FloatArray:
        """(n,) greatest excess over the targets without each of the places (n, 2) [m] by turns."""
        cross, among, _ = self.given_taken(places_m)
        factor = _factored(among, self.hyperparameters.noise_variance)
        inverse = cho_solve((factor, True), np.eye(len(places_m)), check_finite=False)
        b = inverse @ cross
        variance = self.variance - (b * cross).sum(axis=0)
        variances = variance + b * b / inverse.diagonal()[:, None]
        without: FloatArray = np.asarray((variances / self.most).max(axis=1) - 1.0)
        return without

    def with_gradient(self, places_m: FloatArray) -> tuple[float, float, FloatArray]:
        """Greatest excess, mean squared excess beyond ``-MARGIN``, and the latter's gradient (n, 2) [1/m]."""
        own, targets, x = self.hyperparameters, self.targets, self.sampled_m
        cross, among, whitened_p = self.given_taken(places_m)
        factor = _factored(among, own.noise_variance)
        b = cho_solve((factor, True), cross, check_finite=False)
        excess: FloatArray = (self.variance - (b * cross).sum(axis=0)) / self.most - 1.0
        counted = np.maximum(excess + MARGIN, 0.0)
        weights = 2.0 * counted / (self.most * len(targets))
        weighted = b * weights
        count = targets.points_m.shape[1]
        points = targets.points_m.reshape(-1, 2)
        spread = np.repeat(weighted / count, count, axis=1) if count > 1 else weighted
        gradient = -_pulled(own.kernel, places_m, points, spread)
        m = weighted @ b.T
        gradient += _pulled(own.kernel, places_m, places_m, m)
        if len(x):
            to_targets = solve_triangular(self.factor, self.whitened, lower=True, trans="T", check_finite=False)
            to_places = solve_triangular(self.factor, whitened_p, lower=True, trans="T", check_finite=False)
            gradient += _pulled(own.kernel, places_m, x, weighted @ to_targets.T - m @ to_places.T)
        return float(excess.max()), float((counted * counted).mean()), gradient


def _pulled(kernel: Kernel, a_m: FloatArray, b_m: FloatArray, m: FloatArray) -> FloatArray:
    """2 sum_j m_ij dk(a_i, b_j)/da_i, (n, 2), for weights m (n, k)."""
    if isinstance(kernel, LocallyScaled):
        # k = s(a) s(b) k0(a, b), so dk/da = s(a) s(b) dk0/da + k d(log s)/da.
        at_a, at_b = kernel.amplitude.at(a_m), kernel.amplitude.at(b_m)
        by_log = 2.0 * (m * kernel.covariance(a_m, b_m)).sum(axis=1)
        pulled = _pulled(kernel.even, a_m, b_m, m * at_a[:, None] * at_b)
        pulled += by_log[:, None] * kernel.amplitude.gradient_of_log(a_m)
        return pulled
    east, north = a_m[:, 0, None] - b_m[None, :, 0], a_m[:, 1, None] - b_m[None, :, 1]
    lengths = [value for name, value in kernel.parameters().items() if name.endswith("length_scale_m")]
    r2 = kernel.squared_length(east, north) + _SOFTENING * min(lengths) ** 2
    _, by_logarithms = kernel.with_log_gradients(r2)
    by_length = np.zeros_like(r2)
    for name, gradient in zip(kernel.parameters(), by_logarithms, strict=False):  # a stretch has no gradient
        if name.endswith("length_scale_m"):
            by_length += gradient
    # Covariances depend on r^2 / l^2 alone, so dk/d(r^2) = -(dk/d log l) / (2 r^2).
    slope = -m * by_length / r2
    # The metric: r^2 = of_east east^2 + of_both east north + of_north north^2.
    of_east, of_north, all_three = kernel.squared_length(np.array([1.0, 0.0, 1.0]), np.array([0.0, 1.0, 1.0]))
    of_both = all_three - of_east - of_north
    by_east, by_north = (slope * east).sum(axis=1), (slope * north).sum(axis=1)
    return np.column_stack(
        (2.0 * of_east * by_east + of_both * by_north, of_both * by_east + 2.0 * of_north * by_north)
    )


def _factored(covariance: FloatArray, noise: float) -> FloatArray:
    """Lower Cholesky factor of a covariance (n, n) plus noise; a little more noise where rounding requires it."""
    for more in (0.0, ROUNDING, 100.0 * ROUNDING):
        total = covariance.copy()
        total.flat[:: len(total) + 1] += noise + more * max(float(covariance.diagonal().max(initial=0.0)), noise)
        try:
            return np.asarray(np.linalg.cholesky(total), dtype=np.float64)
        except np.linalg.LinAlgError:
            continue
    raise NumericalFailure(f"the covariance of {len(covariance)} places is not positive definite")


class CoverProblem:
    """Targets, the kernels under each of which the goal is to hold, and the samples taken."""

    def __init__(
        self, kernels: Sequence[Hyperparameters], sampled_m: FloatArray, targets: Targets, std_ppb: float
    ) -> None:
        """sampled_m: places (t, 2) [m] of samples taken. Raises InvalidInput without a kernel or a target."""
        if not kernels or not len(targets) or not std_ppb > 0:
            raise InvalidInput(f"expected a kernel, a target and a positive goal, got {std_ppb:g} ppb")
        sampled = np.asarray(sampled_m, dtype=np.float64).reshape(-1, 2)
        self.targets = targets
        self._parts = [_Part.of(one, targets, sampled, std_ppb) for one in kernels]

    def excess(self, places_m: FloatArray) -> FloatArray:
        """(T,) greatest variance under any kernel beyond the goal's, as a share of it, with samples at these places."""
        excess: FloatArray = np.max([part.excess(places_m) for part in self._parts], axis=0)
        return excess

    @property
    def size(self) -> int:
        """Number of variances that are to be lowered."""
        return len(self.targets) * len(self._parts)

    def holds(self, places_m: FloatArray) -> bool:
        """Whether the goal holds with samples at places (n, 2) [m]."""
        return bool(self.excess(places_m).max() <= _NOTHING)

    def with_gradient(self, places_m: FloatArray) -> tuple[float, float, FloatArray]:
        """Greatest excess, the kernels' mean squared excesses, and their gradient (n, 2) [1/m], at n > 0 places."""
        each = [part.with_gradient(places_m) for part in self._parts]
        gradient: FloatArray = np.sum([one[2] for one in each], axis=0)
        return max(one[0] for one in each), sum(one[1] for one in each), gradient

    def added(self, places_m: FloatArray, candidates_m: FloatArray, most: int) -> FloatArray:
        """The places (n, 2) [m] with candidates (C, 2) [m] added until the goal holds, or there are `most` of all.

        The first candidate of equal ones is taken. Nothing is added that lowers no excess.
        """
        states = [_Greedy(part, places_m, candidates_m, most) for part in self._parts]
        chosen: list[int] = []
        while len(places_m) + len(chosen) < most:
            gains = np.sum([state.gains() for state in states], axis=0)
            best = int(np.argmax(gains))
            if not gains[best] > _NOTHING:
                break
            chosen.append(best)
            for state in states:
                state.take(best)
        return np.vstack((places_m, candidates_m[chosen]))

    def pruned(self, places_m: FloatArray) -> FloatArray:
        """The places (n, 2) [m] less those without which the goal holds all the same, the least needed first."""
        places = places_m
        while len(places) > 1:
            without = self.excess_without(places)
            least = int(np.argmin(without))
            if without[least] > _NOTHING:
                break
            places = np.delete(places, least, axis=0)
        return places

    def excess_without(self, places_m: FloatArray) -> FloatArray:
        """(n,) greatest excess without each of the places (n, 2) [m] by turns."""
        without: FloatArray = np.max([part.excess_without(places_m) for part in self._parts], axis=0)
        return without


class _Greedy:
    """The targets under one kernel while candidates are added, as shares of the goal's variance, in float32."""

    def __init__(self, part: _Part, places_m: FloatArray, candidates_m: FloatArray, most: int) -> None:
        own = part.hyperparameters
        scale: FloatArray | float = 1.0 / part.most
        cross, _, whitened = part.given_taken(candidates_m)
        excess = part.excess(places_m)
        rows = [whitened]
        if len(places_m):
            to_targets, among, whitened_p = part.given_taken(places_m)
            factor = _factored(among, own.noise_variance)
            to_candidates = own.covariance(places_m, candidates_m) - whitened_p.T @ whitened
            lowered = solve_triangular(factor, to_candidates, lower=True, check_finite=False)
            cross -= lowered.T @ solve_triangular(factor, to_targets, lower=True, check_finite=False)
            rows.append(lowered)
        if isinstance(scale, np.ndarray):
            cross, scale = cross * np.sqrt(scale), 1.0
        self._candidates_m, self._hyperparameters, self._scale = candidates_m, own, scale
        known = np.vstack(rows)
        room = max(0, most - len(places_m))
        self._known = np.vstack((known, np.zeros((room, len(candidates_m)))))
        self._count = len(known)
        self._variance = own.prior_variance(candidates_m) - (known * known).sum(axis=0)
        self._noise = own.noise_variance
        open_targets = excess > _NOTHING
        self._excess = excess[open_targets].astype(np.float32)
        self._cross: NDArray[np.float32] = cross[:, open_targets].astype(np.float32)

    def gains(self) -> FloatArray:
        """(C,) what each candidate would remove of the sum of excesses."""
        if not len(self._excess):
            return np.zeros(len(self._candidates_m))
        shares = (self._scale / (np.maximum(self._variance, 0.0) + self._noise)).astype(np.float32)
        lowered = self._cross * self._cross
        lowered *= shares[:, None]
        np.minimum(lowered, self._excess, out=lowered)
        gains: FloatArray = lowered.sum(axis=1, dtype=np.float64)
        return gains

    def take(self, chosen: int) -> None:
        """Add the candidate with that index."""
        known = self._known[: self._count]
        place = self._candidates_m[chosen : chosen + 1]
        column = self._hyperparameters.covariance(self._candidates_m, place)[:, 0] - known.T @ known[:, chosen]
        root = np.sqrt(max(self._variance[chosen], 0.0) + self._noise)
        row = column / root
        self._known[self._count] = row
        self._count += 1
        self._variance -= row * row
        to_targets = self._cross[chosen] / np.float32(root)
        self._excess -= to_targets * to_targets * np.float32(self._scale)
        self._cross -= row.astype(np.float32)[:, None] * to_targets
        still = self._excess > _NOTHING
        if not still.all():
            self._excess, self._cross = self._excess[still], self._cross[:, still]
