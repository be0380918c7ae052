"""Whether samples speak for quiet parts and rough parts of the site, member by member of a mixture.

A member of the mixture (``he3.mixture``) is a Gaussian process with a kernel, a noise and perhaps a warp. Beside it may
stand another one that is the same but for a local amplitude (``he3.local_amplitude``). The coefficients of log s have
normal priors about 0; that of the constant lets the whole field vary more or less than the kernel says. With C the
covariance of the samples under the kernel and S that of their values, noise and trend included, the log likelihood has

    the derivative  a_i (C a)_i - (S^-1 C)_ii  by log s_i,  a = S^-1 z
    and the expected information  (S^-1)_ij (C S^-1 C)_ij + (S^-1 C)_ij (S^-1 C)_ji

so its mode is found by Fisher scoring, and the evidence is Laplace's approximation about it. It is set against that of
the constant alone, which no part is quiet or rough for. The amplitude in use is that of the mode, and the square root
of what the posterior makes of its square: a part of which little is known may vary more than the mode says.

The member's weight is shared. That of the local one has prior odds of ``ODDS``, times the evidence to the power of
``POWER``, since neighbouring samples are no independent witnesses of how much a part varies. It is at most ``MOST``: a
few samples of a quiet part do not show that it has no peak.

Shapes, odds, power and limits were chosen on sets of samples of quarters of two SRTM pieces, of a part of Walker Lake,
of six pieces of the lunar LDEM_4, and of heights and slopes of Apollo 17. [measured: docs/uncertainty.md]
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from he3.condensation import condensed
from he3.gp import GaussianProcess
from he3.local_amplitude import LocalAmplitude, LocallyScaled, limited, modes, slope_of_limit, waves
from he3.mixture import alternatives_of
from he3.warp_choice import LEAST_STD_IN_NOISE

if TYPE_CHECKING:
    from he3.frames import FloatArray
    from he3.hyperparameters import Hyperparameters

STD = 0.5  # 1, prior standard deviation of log s, and of its constant
LENGTH = 0.3  # 1, of the site's width: correlation length of log s before any sample
ODDS = 0.1  # 1, prior odds of quiet and rough parts against none
POWER = 0.5  # 1, of the evidence
MOST = 2.0 / 3.0  # 1, weight of the local member in the two
LEAST = 0.02  # 1, the same from which there is one, and weight of all local members from which there are any
LEAST_SAMPLES = 12  # below it, samples tell next to nothing of parts
LEAST_SHARE = 0.03  # 1, weight of a member in the mixture from which it is asked
_HOPELESS = 2.5  # 1, logarithm of evidence: how far short of ``LEAST`` the first step may be where others follow
_MOST_STEPS = 12
_CLOSE = 1e-3  # 1, gain of a step that is expected to be the last
_LATTICE = 12  # places per axis at which the amplitude is made to be what its posterior says


@dataclass(frozen=True, slots=True, eq=False)
class LocalMember:
    """The kernel with a local amplitude, and its weight beside the same without one, 0 to 1."""

    kernel: LocallyScaled
    weight: float


def local_member(one: Hyperparameters, xy_m: FloatArray, values_ppb: FloatArray, extent_m: float) -> LocalMember | None:
    """The local member beside a process, given observations (n,) [ppb] at places (n, 2) [m]; None where it has none.

    extent_m: the longer side of the site. Samples that hardly vary beyond the noise show no parts.
    """
    if len(values_ppb) < LEAST_SAMPLES or not float(values_ppb.std()) > LEAST_STD_IN_NOISE * one.noise_std_ppb:
        return None
    columns = waves(xy_m, extent_m) * _prior_stds()
    problem = _Amplitudes.of(one, xy_m, values_ppb)
    wanted = (math.log(LEAST / (1.0 - LEAST)) - math.log(ODDS)) / POWER
    even, local = problem.start(columns[:, :1]), problem.start(columns)
    if even is None or local is None or local.expected_evidence - even.expected_evidence < wanted - _HOPELESS:
        return None
    even, local = problem.mode(columns[:, :1], even), problem.mode(columns, local)
    log_odds = math.log(ODDS) + POWER * (local.evidence - even.evidence)
    weight = min(MOST, 1.0 / (1.0 + math.exp(-log_odds)))
    if weight < LEAST:
        return None
    amplitude = LocalAmplitude(extent_m, _widened(local, extent_m))
    return LocalMember(LocallyScaled(one.kernel, amplitude), weight)


def with_local_members(
    mixture: Hyperparameters, xy_m: FloatArray, values_ppb: FloatArray, extent_m: float, places_m: FloatArray, most: int
) -> Hyperparameters:
    """The mixture with local members where the samples speak for them; itself, to the byte, where they do not.

    places_m: (m, 2) [m], places all over the site, at which at most ``most`` members keep the moments of all.
    """
    members: list[tuple[float, Hyperparameters]] = []
    of_local = 0.0
    for weight, one in alternatives_of(mixture):
        found = local_member(one, xy_m, values_ppb, extent_m) if weight >= LEAST_SHARE else None
        if found is None:
            members.append((weight, one))
            continue
        members.append((weight * (1.0 - found.weight), one))
        members.append((weight * found.weight, replace(one, kernel=found.kernel)))
        of_local += weight * found.weight
    if of_local < LEAST:
        return mixture
    weights, each = zip(*members, strict=True)
    moments = [GaussianProcess(one).condition(xy_m, values_ppb).predict(places_m) for one in each]
    means, stds = (np.array(values) for values in zip(*moments, strict=True))
    kinds = [(one.warp, isinstance(one.kernel, LocallyScaled)) for one in each]
    chosen, shares = condensed(np.array(weights), means, stds**2, most, kinds)
    kept = [each[number] for number in chosen]
    if not any(isinstance(one.kernel, LocallyScaled) for one in kept):
        return mixture
    return replace(
        mixture,
        alternatives=tuple((float(share), one.kernel) for share, one in zip(shares, kept, strict=True)),
        noises_ppb=tuple(one.noise_std_ppb for one in kept) if mixture.noises_ppb else (),
        warps=tuple(one.warp for one in kept) if any(one.warp is not None for one in kept) else (),
    )


def _prior_stds() -> FloatArray:
    """Prior standard deviations (m,) of the coefficients."""
    j, k = np.array(modes()).T
    smooth = np.exp(-0.25 * (math.pi * LENGTH) ** 2 * (j * j + k * k))
    of_square = np.where(j > 0, 0.5, 1.0) * np.where(k > 0, 0.5, 1.0)  # mean square of a wave over the site
    # So that log s without its constant has the standard deviation, on average over a square.
    stds = np.where(j + k > 0, smooth / np.sqrt(of_square), 0.0).astype(np.float64)
    stds *= STD / math.sqrt(float((stds * stds) @ of_square))
    stds[0] = STD
    return stds


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """Coefficients u (m,) in prior standard deviations, and what is known there.

    gain: of the log posterior over that of no amplitude. gradient (m,) and information (m, m): of minus its logarithm.
    """

    u: FloatArray
    gain: float
    gradient: FloatArray
    information: FloatArray

    @property
    def step(self) -> FloatArray:
        """To the mode of the quadratic function that is expected there."""
        return np.asarray(-np.linalg.solve(self.information, self.gradient), dtype=np.float64)

    @property
    def evidence(self) -> float:
        """Logarithm of the evidence, over the likelihood of no amplitude."""
        return self.gain - 0.5 * float(np.linalg.slogdet(self.information)[1])

    @property
    def expected_evidence(self) -> float:
        """The same, as one step makes it out."""
        return self.evidence - 0.5 * float(self.gradient @ self.step)


@dataclass(frozen=True, slots=True, eq=False)
class _Amplitudes:
    """The likelihood of amplitudes at n samples. covariance, others: (n, n) of the kernel; of trend and noise."""

    z: FloatArray
    covariance: FloatArray
    others: FloatArray
    plain: float
    """Log likelihood without any, but for a constant."""

    @classmethod
    def of(cls, one: Hyperparameters, xy_m: FloatArray, values_ppb: FloatArray) -> _Amplitudes:
        basis, count = one.trend_basis(xy_m), len(xy_m)
        others = np.zeros((count, count)) if basis is None else basis @ basis.T
        others.flat[:: count + 1] += one.noise_variances(values_ppb)
        found = cls(one.standardise(xy_m, values_ppb), one.kernel.covariance(xy_m, xy_m), others, 0.0)
        factor, whitened = found._factored(np.ones(count))
        return replace(found, plain=_log_likelihood(factor, whitened))

    def start(self, columns: FloatArray) -> _State | None:
        """No amplitude, for functions (n, m); None where the covariance has no factor."""
        try:
            return self._at(np.zeros(columns.shape[1]), columns)
        except np.linalg.LinAlgError:
            return None

    def mode(self, columns: FloatArray, state: _State) -> _State:
        """The most probable coefficients."""
        for _ in range(_MOST_STEPS):
            step, share = state.step, 1.0
            expected = -0.5 * float(state.gradient @ step)
            if expected < _CLOSE:
                break
            while share > _CLOSE:
                try:
                    tried = self._at(state.u + share * step, columns)
                except np.linalg.LinAlgError:
                    share *= 0.5
                    continue
                if tried.gain > state.gain:
                    break
                share *= 0.5
            else:
                break
            state = tried
        return state

    def _factored(self, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
        total = self.covariance * amplitude[:, None] * amplitude + self.others
        factor: FloatArray = np.asarray(np.linalg.cholesky(total), dtype=np.float64)
        whitened: FloatArray = solve_triangular(factor, self.z, lower=True, check_finite=False)
        return factor, whitened

    def _at(self, u: FloatArray, columns: FloatArray) -> _State:
        """The state at u. Raises LinAlgError where the covariance has no factor."""
        log_amplitude = limited(columns @ u)
        amplitude = np.exp(log_amplitude)
        factor, whitened = self._factored(amplitude)
        gain = _log_likelihood(factor, whitened) - self.plain - 0.5 * float(u @ u)
        scaled = self.covariance * amplitude[:, None] * amplitude
        inverse = cho_solve((factor, True), np.eye(len(amplitude)), check_finite=False)
        alpha = inverse @ self.z
        shares = inverse @ scaled  # S^-1 C
        by_log = alpha * (scaled @ alpha) - shares.diagonal()
        information = inverse * (scaled @ shares) + shares * shares.T
        by_u = slope_of_limit(log_amplitude)[:, None] * columns
        return _State(u, gain, u - by_u.T @ by_log, by_u.T @ information @ by_u + np.eye(len(u)))


def _log_likelihood(factor: FloatArray, whitened: FloatArray) -> float:
    return -0.5 * float(whitened @ whitened) - float(np.log(factor.diagonal()).sum())


def _widened(mode: _State, extent_m: float) -> tuple[float, ...]:
    """Coefficients (m,) of the amplitude whose square is what the posterior makes of it.

    With g normal, of variance v, the mean of exp(2 g) is that of g + v. So v, which is smooth, is added to g, as far as
    the functions go.
    """
    axis = (np.arange(_LATTICE) + 0.5) / _LATTICE * extent_m
    places = np.column_stack([values.ravel() for values in np.meshgrid(axis, axis)])
    functions = waves(places, extent_m)
    columns = functions * _prior_stds()
    variance = (columns * np.linalg.solve(mode.information, columns.T).T).sum(axis=1)
    more = np.linalg.lstsq(functions, variance, rcond=None)[0]
    return tuple(float(c) for c in mode.u * _prior_stds() + more)
