"""Quiet parts and rough parts: a kernel whose field varies more in some parts of the site than in others.

A stationary kernel says that the field varies alike everywhere. On plains beside mountains its map is too uncertain of
the plains and too certain of the mountains. With a smooth positive amplitude s over the site

    k(a, b) = s(a) s(b) k0(a, b),      log s(x) = H tanh(g(x) / H)
    g(x) = sum_jk c_jk cos(pi j east / W) cos(pi k north / W),      j^2 + k^2 <= ``HIGHEST``^2

where k0 is any kernel, W the longer side of the site, and H = ``MOST_LOG``. It is the covariance of s(x) times a field
of the kernel k0, so it is positive definite. At scales below its length, a field of exponential covariance varies by
the ratio of its variance to its length alone, so there a greater amplitude is a shorter length, too.

The waves are those of a rectangle with reflecting sides. No part varies more than exp(H) times as much as the kernel
says, or less than exp(-H) times as much.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from he3.errors import InvalidInput
from he3.frames import as_points
from he3.kernels import Kernel, kernel_from

if TYPE_CHECKING:
    from collections.abc import Mapping

    from he3.frames import Float32Array, FloatArray

HIGHEST = 3  # 1, half waves on the longer side of the site: a part is a third of it or wider
MOST_LOG = 1.0  # 1, of the amplitude's logarithm: a factor of 2.7 either way
AMPLITUDE = "amplitude_"
"""What the names of the amplitude's parameters begin with, beside those of the kernel."""
AMPLITUDE_EXTENT = "amplitude_extent_m"


@cache
def modes() -> tuple[tuple[int, int], ...]:
    """Half waves east and north (j, k) of each of the m functions, the constant first."""
    numbers = range(HIGHEST + 1)
    found = [(j, k) for j in numbers for k in numbers if j * j + k * k <= HIGHEST**2]
    return tuple(sorted(found, key=lambda one: (one[0] ** 2 + one[1] ** 2, one)))


def waves(xy_m: FloatArray, extent_m: float) -> FloatArray:
    """The functions (n, m) at places (n, 2) [m] of a site of that width [m]."""
    angles = np.arange(HIGHEST + 1) * (math.pi / extent_m)
    east, north = np.cos(xy_m[:, :1] * angles), np.cos(xy_m[:, 1:] * angles)
    j, k = np.array(modes()).T
    found: FloatArray = east[:, j] * north[:, k]
    return found


@dataclass(frozen=True, slots=True)
class LocalAmplitude:
    """The amplitude s. extent_m: W [m]. coefficients: (m,) c of g, in the order of ``modes``.

    Raises InvalidInput for a width that is not positive, another number of coefficients, or one that is not finite.
    """

    extent_m: float
    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.extent_m) and self.extent_m > 0):
            raise InvalidInput(f"expected a positive width of the site, got {self.extent_m!r} m")
        if len(self.coefficients) != len(modes()) or not all(map(math.isfinite, self.coefficients)):
            raise InvalidInput(f"expected {len(modes())} finite coefficients of an amplitude, got {self.coefficients}")

    def log_at(self, xy_m: FloatArray) -> FloatArray:
        """log s (n,) at places (n, 2) [m]."""
        return limited(waves(xy_m, self.extent_m) @ np.array(self.coefficients))

    def at(self, xy_m: FloatArray) -> FloatArray:
        """s (n,) at places (n, 2) [m]."""
        return np.exp(self.log_at(xy_m))

    def gradient_of_log(self, xy_m: FloatArray) -> FloatArray:
        """Derivatives (n, 2) of log s by east and north [1/m] at places (n, 2) [m]."""
        numbers = np.arange(HIGHEST + 1) * (math.pi / self.extent_m)
        j, k = np.array(modes()).T
        angles = xy_m[:, :, None] * numbers
        cosine, sine = np.cos(angles), -np.sin(angles) * numbers
        by_place = np.stack((sine[:, 0, j] * cosine[:, 1, k], cosine[:, 0, j] * sine[:, 1, k]), axis=1)
        slope = slope_of_limit(self.log_at(xy_m))
        found: FloatArray = slope[:, None] * (by_place @ np.array(self.coefficients))
        return found

    def parameters(self) -> dict[str, float]:
        """By name, as messages have them."""
        named = {f"{AMPLITUDE}{j}_{k}": c for (j, k), c in zip(modes(), self.coefficients, strict=True)}
        return {AMPLITUDE_EXTENT: self.extent_m, **named}


def limited(g: FloatArray) -> FloatArray:
    """log s where g is that."""
    return MOST_LOG * np.tanh(g / MOST_LOG)


def slope_of_limit(log_amplitude: FloatArray) -> FloatArray:
    """Derivative of log s by g, where log s is that."""
    return 1.0 - (log_amplitude / MOST_LOG) ** 2


@dataclass(frozen=True, slots=True)
class LocallyScaled:
    """The kernel of a field that varies s times as much as one of the kernel ``even``, with s from place to place.

    Its covariance is no function of a distance, so what needs one refuses it; ``even_kernel`` gives the other.
    """

    even: Kernel
    amplitude: LocalAmplitude

    @property
    def name(self) -> str:
        """That of the even kernel; the parameters tell them apart."""
        return self.even.name

    @property
    def half_correlation_scales(self) -> float:
        return self.even.half_correlation_scales

    @property
    def prior_variance(self) -> float:
        """Where the amplitude is 1; ``prior_variance_at`` gives that at a place."""
        return self.even.prior_variance

    def parameters(self) -> dict[str, float]:
        return {**self.even.parameters(), **self.amplitude.parameters()}

    def covariance(self, a_m: FloatArray, b_m: FloatArray) -> FloatArray:
        a, b = as_points(a_m), as_points(b_m)
        covariance = self.even.covariance(a, b)
        covariance *= self.amplitude.at(a)[:, None]
        covariance *= self.amplitude.at(b)
        return covariance

    def squared_length(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        return self.even.squared_length(east_m, north_m)

    def of_squared_distance(self, r2: FloatArray) -> FloatArray:
        raise self._refusal()

    def with_log_gradients(self, r2: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        raise self._refusal()

    def fill(self, r2: Float32Array, out: Float32Array) -> None:
        raise self._refusal()

    def _refusal(self) -> TypeError:
        return TypeError(f"the covariance of a locally scaled kernel {self.name!r} is no function of a distance")


def even_kernel(kernel: Kernel) -> Kernel:
    """The kernel without its local amplitude; itself if it has none."""
    return kernel.even if isinstance(kernel, LocallyScaled) else kernel


def prior_variance_at(kernel: Kernel, xy_m: FloatArray) -> FloatArray:
    """Variance (n,) of the field at places (n, 2) [m] before the first sample."""
    variance: FloatArray = np.full(len(xy_m), kernel.prior_variance, dtype=np.float64)
    if isinstance(kernel, LocallyScaled):
        variance *= kernel.amplitude.at(xy_m) ** 2
    return variance


def least_prior_variance(kernel: Kernel) -> float:
    """A lower bound on that at any place."""
    even = kernel.prior_variance
    return even * math.exp(-2.0 * MOST_LOG) if isinstance(kernel, LocallyScaled) else even


def covariances_within(kernel: Kernel, sets_m: FloatArray) -> FloatArray:
    """Covariances (B, k, k) within each of B sets of k places (B, k, 2) [m]."""
    even, apart = even_kernel(kernel), sets_m[:, :, None, :] - sets_m[:, None, :, :]
    covariances = even.of_squared_distance(even.squared_length(apart[..., 0], apart[..., 1]))
    if isinstance(kernel, LocallyScaled):
        amplitude = kernel.amplitude.at(sets_m.reshape(-1, 2)).reshape(sets_m.shape[:2])
        covariances *= amplitude[:, :, None] * amplitude[:, None, :]
    return covariances


def site_kernel_from(name: str, parameters: Mapping[str, float]) -> Kernel:
    """As ``kernel_from``, with a local amplitude if the parameters have one.

    Raises InvalidInput for an unknown name or a set of parameters that no such kernel has.
    """
    of_amplitude = {key: float(value) for key, value in parameters.items() if key.startswith(AMPLITUDE)}
    if not of_amplitude:
        return kernel_from(name, parameters)
    even = kernel_from(name, {key: value for key, value in parameters.items() if key not in of_amplitude})
    named = [f"{AMPLITUDE}{j}_{k}" for j, k in modes()]
    if set(of_amplitude) != {AMPLITUDE_EXTENT, *named}:
        raise InvalidInput(
            f"kernel {name!r}: expected {AMPLITUDE_EXTENT} and {len(named)} coefficients of an amplitude, "
            f"got {', '.join(of_amplitude)}"
        )
    amplitude = LocalAmplitude(of_amplitude[AMPLITUDE_EXTENT], tuple(of_amplitude[key] for key in named))
    return LocallyScaled(even, amplitude)
