"""The exact Gaussian process over the site, as an immutable value: conditioning on more samples returns a new one.

    rng = np.random.default_rng(7)
    fitted = fit_hyperparameters(xy_m, values_ppb, "se", rng=rng)            # maximum likelihood; "auto" picks a kernel
    belief = GaussianProcess(fitted).condition(xy_m, values_ppb)
    mean_ppb, std_ppb = belief.predict([[12.5, 80.0], [13.0, 81.0]])
    later = belief.condition([[40.0, 55.0]], [7.9])                          # belief itself is unchanged
    planned = belief.condition_on_places([[100.0, 20.0], [120.0, 20.0]])     # to be sampled: less variance, same mean
    nats = information_gain(planned.posterior_covariance(places_m), fitted.noise_variance_ppb2)
    posterior = GridPosterior.build(grid, fitted, xy_m, values_ppb)          # every cell of the site
    posterior.add([60.0, 61.0], 8.3)                                         # one sample, no refit
    posterior.mean_ppb, posterior.std_ppb                                    # (rows, columns) float32

Algorithm: Rasmussen & Williams 2006, alg. 2.1, with the Cholesky factor extended by blocks as samples come. Internally
everything is in standardised units (``Hyperparameters.standardise``); the interface has places in metres and values in
ppb.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from he3.errors import InvalidInput, NumericalFailure
from he3.factor_room import FactorRoom
from he3.frames import FloatArray, as_points
from he3.hyperparameters import Hyperparameters, fit_hyperparameters
from he3.local_amplitude import covariances_within, least_prior_variance

__all__ = ["GaussianProcess", "Hyperparameters", "fit_hyperparameters"]


@dataclass(frozen=True, slots=True, eq=False)
class GaussianProcess:
    """The belief about the field given n samples.

    places_m: (n, 2) [m]. factor: lower Cholesky factor (n, n) of their covariance plus noise. whitened: (n,), factor^-1
    times the standardised observations. ``condition`` sets all but ``hyperparameters``. room: where the factor lies, if
    it grows there (``with_room``).
    """

    hyperparameters: Hyperparameters
    places_m: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    factor: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    whitened: FloatArray = field(default_factory=lambda: np.empty(0))
    room: FactorRoom | None = None

    def __len__(self) -> int:
        return len(self.places_m)

    def condition(self, xy_m: ArrayLike, values_ppb: ArrayLike) -> GaussianProcess:
        """The belief after observations (k,) [ppb] at places (k, 2) [m]; places may repeat.

        Raises InvalidInput for shapes that do not fit or values that are not finite.
        """
        xy = as_points(np.asarray(xy_m, dtype=np.float64))
        values = np.asarray(values_ppb, dtype=np.float64)
        if values.shape != (len(xy),) or not np.isfinite(values).all():
            raise InvalidInput(f"expected {len(xy)} finite values, one per place, got shape {values.shape}")
        own = self.hyperparameters
        return self._extend(xy, own.standardise(xy, values), own.noise_variances(values))

    def condition_on_places(self, xy_m: ArrayLike) -> GaussianProcess:
        """The belief after samples at places (k, 2) [m] with values yet unknown: less variance, the same mean.

        With a warp, their noise is that at the median of the field there, and it is the latent field's mean that stays.
        """
        xy, own = as_points(np.asarray(xy_m, dtype=np.float64)), self.hyperparameters
        if own.warp is None:
            return self._extend(xy, None, own.noise_variance)
        return self._extend(xy, None, own.noise_variances(own.warp.field(self.predict_latent(xy)[0])))

    def drawn(self, place_m: ArrayLike, draw: Callable[[float, float], float]) -> tuple[float, GaussianProcess]:
        """An observation [ppb] at the place (2,) [m] that is drawn, and the belief after it.

        draw: gives it from the latent field's mean and standard deviation there [ppb], which is the field without a
        warp.
        """
        place = as_points(np.asarray(place_m, dtype=np.float64).reshape(1, 2))
        own, n = self.hyperparameters, len(self)
        if own.warp is not None:
            mean, latent_std = self.predict_latent(place)
            value = draw(float(mean[0]), float(latent_std[0]))
            return value, self.condition(place, [value])
        planned = self._extend(place, None, own.noise_variance)
        expected, pivot = float(planned.factor[n, :n] @ self.whitened), float(planned.factor[n, n])
        std = np.sqrt(max(pivot**2 - own.noise_variance, self.least_variance()))
        value = draw(float(own.prior_mean_ppb(place)[0]) + own.scale_ppb * expected, own.scale_ppb * float(std))
        residual = float(own.standardise(place, np.array([value]))[0]) - expected
        return value, replace(planned, whitened=np.append(self.whitened, residual / pivot))

    def under(self, hyperparameters: Hyperparameters) -> GaussianProcess:
        """The belief after the same observations under other hyperparameters."""
        own, places = self.hyperparameters, self.places_m
        values = own.prior_mean_ppb(places) + own.scale_ppb * (self.factor @ self.whitened)
        if own.warp is not None:
            values = own.warp.field(values)
        return GaussianProcess(hyperparameters).condition(places, values)

    def _extend(self, xy: FloatArray, z: FloatArray | None, noise: FloatArray | float) -> GaussianProcess:
        n, k = len(self), len(xy)
        if k == 0:
            return self
        cross = self._whiten(xy)
        block = self.hyperparameters.covariance(xy, xy) - cross.T @ cross
        # Rounding may make the field's own variance negative; clipped at 0, no pivot is below the noise.
        block.flat[:: k + 1] = np.maximum(block.diagonal(), 0.0) + noise
        try:
            corner = np.linalg.cholesky(block)
        except np.linalg.LinAlgError:
            raise NumericalFailure(f"{k} samples could not be added to {n}: covariance not positive definite") from None
        room = self.room
        if room is None:
            factor = np.zeros((n + k, n + k))
            factor[:n, :n] = self.factor
            factor[n:, :n] = cross.T
            factor[n:, n:] = corner
        else:
            room = room.extended(cross.T, corner)
            factor = room.factor(n + k)
        # A value equal to its expectation leaves the mean unchanged: its whitened residual is 0.
        new = np.zeros(k) if z is None else solve_triangular(corner, z - cross.T @ self.whitened, lower=True)
        places, whitened = np.concatenate((self.places_m, xy)), np.concatenate((self.whitened, new))
        return GaussianProcess(self.hyperparameters, places, factor, whitened, room)

    def with_room(self) -> GaussianProcess:
        """The same belief; its factor, and that of each belief conditioned on it, grows in one array.

        For a belief to which many samples come one by one: none of them copies the factor. For one thread.
        """
        if self.room is not None:
            return self
        room = FactorRoom(self.factor)
        return replace(self, factor=room.factor(len(self)), room=room)

    def without_room(self) -> GaussianProcess:
        """The same belief with a contiguous factor of its own."""
        return self if self.room is None else replace(self, factor=np.ascontiguousarray(self.factor), room=None)

    def solve(self, right: FloatArray, transposed: bool = False) -> FloatArray:
        """factor^-1 right, or factor^-T right, for right (n,) or (n, k)."""
        if self.room is not None:
            return self.room.solve(right, transposed)
        solution: FloatArray = solve_triangular(
            self.factor, right, lower=True, trans=int(transposed), check_finite=False
        )
        return solution

    def _whiten(self, xy: FloatArray) -> FloatArray:
        """Whitened covariance (n, k) between samples and places: factor^-1 K(samples, xy)."""
        if len(self) == 0:
            return np.zeros((0, len(xy)))
        return self.solve(self.hyperparameters.covariance(self.places_m, xy))

    def predict(self, points_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Posterior mean (k,) and standard deviation (k,) [ppb] of the field at places (k, 2) [m], noise excluded."""
        mean, std = self.predict_latent(points_m)
        warp = self.hyperparameters.warp
        if warp is None:
            return mean, std
        mean, variance = warp.moments(mean, std * std)
        return mean, np.sqrt(variance)

    def predict_latent(self, points_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """As ``predict``, of the latent field, whose distribution is normal; without a warp it is the field."""
        xy = as_points(np.asarray(points_m, dtype=np.float64))
        cross = self._whiten(xy)
        scale = self.hyperparameters.scale_ppb
        mean = self.hyperparameters.prior_mean_ppb(xy) + scale * (cross.T @ self.whitened)
        variance = self.hyperparameters.prior_variance(xy) - np.einsum("ij,ij->j", cross, cross)
        return mean, scale * np.sqrt(np.maximum(variance, self.least_variance()))

    def least_variance(self) -> float:
        """A positive lower bound on the posterior variance of the latent field anywhere, in standardised units.

        After n samples at the very place the variance is k / (1 + n k / s^2), with k the kernel's variance and s^2 the
        noise's; samples elsewhere tell no more. The bound is half of that; only rounding errors fall below it.
        """
        prior = least_prior_variance(self.hyperparameters.kernel)
        return 0.5 * prior / (1.0 + len(self) * prior / self.hyperparameters.least_noise_variance)

    def posterior_covariance(self, points_m: ArrayLike, others_m: ArrayLike | None = None) -> FloatArray:
        """Posterior covariance (k, m) [ppb^2] of the field between places (k, 2) and others (m, 2) [m].

        Without others, (k, k) among the places themselves.
        """
        xy = as_points(np.asarray(points_m, dtype=np.float64))
        others = None if others_m is None else as_points(np.asarray(others_m, dtype=np.float64))
        covariance, warp = self.latent_covariance(xy, others), self.hyperparameters.warp
        if warp is None:
            return covariance
        mean, std = self.predict_latent(xy)
        other_mean, other_std = (mean, std) if others is None else self.predict_latent(others)
        return warp.covariance(mean[:, None], std[:, None] ** 2, other_mean, other_std**2, covariance)

    def latent_covariance(self, xy: FloatArray, others: FloatArray | None = None) -> FloatArray:
        """As ``posterior_covariance``, of the latent field."""
        cross = self._whiten(xy)
        if others is None:
            covariance = self.hyperparameters.covariance(xy, xy) - cross.T @ cross
        else:
            covariance = self.hyperparameters.covariance(xy, others) - cross.T @ self._whiten(others)
        covariance *= self.hyperparameters.scale_ppb**2
        return covariance

    def posterior_covariances(self, sets_m: ArrayLike) -> FloatArray:
        """Posterior covariances (B, k, k) [ppb^2] within each of B sets of k places (B, k, 2) [m], in one batch.

        With a warp, of the latent field.
        """
        sets = np.asarray(sets_m, dtype=np.float64)
        if sets.ndim != 3 or sets.shape[2] != 2:
            raise InvalidInput(f"expected sets of places (B, k, 2), got {sets.shape}")
        batch, k, _ = sets.shape
        flat = as_points(sets.reshape(-1, 2))
        covariance = covariances_within(self.hyperparameters.kernel, sets)
        basis = self.hyperparameters.trend_basis(flat)
        if basis is not None:
            stacked = basis.reshape(batch, k, -1)
            covariance += stacked @ stacked.transpose(0, 2, 1)
        if len(self):
            cross = self._whiten(flat).T.reshape(batch, k, -1)
            covariance -= cross @ cross.transpose(0, 2, 1)
        covariance *= self.hyperparameters.scale_ppb**2
        return covariance
