"""Covariance functions of the belief, as frozen values, with their derivatives.

All are stationary and isotropic, so each is a function of the squared distance r^2 [m^2] alone. ``Stretched`` makes any
of them anisotropic, by a metric of its own. Variances are in the squared unit of the field (here: standardised, see
``he3.gp``); length scales are in metres.
With a = sqrt(2 nu) r / l (Rasmussen & Williams, Gaussian Processes for Machine Learning, 2006, eqs. 4.9, 4.14-4.17):

    se         s^2 exp(-r^2 / (2 l^2))
    matern12   s^2 exp(-a)
    matern32   s^2 (1 + a) exp(-a)
    matern52   s^2 (1 + a + a^2 / 3) exp(-a)
    smooth+rough   se with a long length scale plus matern12 with a short one: a trend with a perturbation

Derivatives are with respect to the logarithms of the parameters, in the order of ``parameters``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np

from he3.errors import InvalidInput
from he3.frames import Float32Array, FloatArray, as_points


@runtime_checkable
class Kernel(Protocol):
    """A covariance function of the squared distance between two places."""

    @property
    def half_correlation_scales(self) -> float:
        """Distance at which the correlation (that of the rough part, if there are two) is a half, in length scales."""

    @property
    def name(self) -> str:
        """Its key in ``KERNELS``."""

    @property
    def prior_variance(self) -> float:
        """Variance of the field at any place before the first sample."""

    def parameters(self) -> dict[str, float]:
        """The parameters by name, all positive, in the order of the derivatives."""

    def covariance(self, a_m: FloatArray, b_m: FloatArray) -> FloatArray:
        """Covariance (N, M) between places a (N, 2) and b (M, 2) [m]."""

    def squared_length(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        """Squared length of offsets [m] in the kernel's metric [m^2], of their common shape."""

    def of_squared_distance(self, r2: FloatArray) -> FloatArray:
        """Covariance at the squared distances [m^2] in the kernel's metric, same shape."""

    def with_log_gradients(self, r2: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        """Covariance at the squared distances [m^2], and its derivatives by the logarithm of each parameter."""

    def fill(self, r2: Float32Array, out: Float32Array) -> None:
        """Write the covariance at the squared distances [m^2] into ``out``, in float32; r2 is overwritten."""


def squared_distances(a_m: FloatArray, b_m: FloatArray) -> FloatArray:
    """Squared distances (N, M) [m^2] between places a (N, 2) and b (M, 2) [m]; exactly 0 for equal places."""
    dx = a_m[:, 0, None] - b_m[None, :, 0]
    dy = a_m[:, 1, None] - b_m[None, :, 1]
    dx *= dx
    dy *= dy
    dx += dy
    return dx


@cache
def _field_names(kind: type) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))


class _Stationary:
    """The part that all kernels share: parameters by name, covariance between places."""

    __slots__ = ()
    name: ClassVar[str]

    def __post_init__(self) -> None:
        for key, value in self.parameters().items():
            if not (math.isfinite(value) and value > 0):
                raise InvalidInput(f"kernel {self.name!r}: expected a positive {key}, got {value!r}")

    def parameters(self) -> dict[str, float]:
        return {name: float(getattr(self, name)) for name in _field_names(type(self))}  # type: ignore[arg-type]

    def covariance(self, a_m: FloatArray, b_m: FloatArray) -> FloatArray:
        return self.of_squared_distance(squared_distances(as_points(a_m), as_points(b_m)))

    def squared_length(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        return east_m * east_m + north_m * north_m

    def of_squared_distance(self, r2: FloatArray) -> FloatArray:
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class SquaredExponential(_Stationary):
    """Infinitely differentiable; the kernel that the paper names."""

    variance: float = 1.0
    length_scale_m: float = 60.0

    name: ClassVar[str] = "se"
    half_correlation_scales: ClassVar[float] = 1.1774

    @property
    def prior_variance(self) -> float:
        return self.variance

    def of_squared_distance(self, r2: FloatArray) -> FloatArray:
        k = r2 * (-0.5 / self.length_scale_m**2)
        np.exp(k, out=k)
        k *= self.variance
        return k

    def with_log_gradients(self, r2: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        k = self.of_squared_distance(r2)
        to_length = r2 * self.length_scale_m**-2
        to_length *= k
        return k, (k, to_length)

    def fill(self, r2: Float32Array, out: Float32Array) -> None:
        np.multiply(r2, np.float32(-0.5 / self.length_scale_m**2), out=out)
        np.exp(out, out=out)
        out *= np.float32(self.variance)


@dataclass(frozen=True, slots=True)
class Matern12(_Stationary):
    """Continuous, nowhere differentiable: the exponential covariance of the reference field's perturbation."""

    variance: float = 1.0
    length_scale_m: float = 60.0

    name: ClassVar[str] = "matern12"
    half_correlation_scales: ClassVar[float] = 0.6931

    @property
    def prior_variance(self) -> float:
        return self.variance

    def of_squared_distance(self, r2: FloatArray) -> FloatArray:
        k = np.sqrt(r2)
        k *= -1.0 / self.length_scale_m
        np.exp(k, out=k)
        k *= self.variance
        return k

    def with_log_gradients(self, r2: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        a = np.sqrt(r2)
        a *= 1.0 / self.length_scale_m
        k = np.exp(-a)
        k *= self.variance
        a *= k
        return k, (k, a)

    def fill(self, r2: Float32Array, out: Float32Array) -> None:
        np.sqrt(r2, out=out)
        out *= np.float32(-1.0 / self.length_scale_m)
        np.exp(out, out=out)
        out *= np.float32(self.variance)


@dataclass(frozen=True, slots=True)
class Matern32(_Stationary):
    """Once differentiable."""

    variance: float = 1.0
    length_scale_m: float = 60.0

    name: ClassVar[str] = "matern32"
    half_correlation_scales: ClassVar[float] = 0.9690

    @property
    def prior_variance(self) -> float:
        return self.variance

    def of_squared_distance(self, r2: FloatArray) -> FloatArray:
        a = np.sqrt(r2 * (3.0 / self.length_scale_m**2))
        k = np.exp(-a)
        a += 1.0
        k *= a
        k *= self.variance
        return k

    def with_log_gradients(self, r2: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        a2 = r2 * (3.0 / self.length_scale_m**2)
        a = np.sqrt(a2)
        decay = np.exp(-a)
        decay *= self.variance
        a += 1.0
        a *= decay
        a2 *= decay
        return a, (a, a2)

    def fill(self, r2: Float32Array, out: Float32Array) -> None:
        r2 *= np.float32(3.0 / self.length_scale_m**2)
        np.sqrt(r2, out=r2)
        np.negative(r2, out=out)
        np.exp(out, out=out)
        out *= np.float32(self.variance)
        r2 += np.float32(1.0)
        out *= r2


@dataclass(frozen=True, slots=True)
class Matern52(_Stationary):
    """Twice differentiable; the kernel that produced the paper's numbers."""

    variance: float = 1.0
    length_scale_m: float = 60.0

    name: ClassVar[str] = "matern52"
    half_correlation_scales: ClassVar[float] = 1.0420

    @property
    def prior_variance(self) -> float:
        return self.variance

    def of_squared_distance(self, r2: FloatArray) -> FloatArray:
        return self.with_log_gradients(r2)[0]

    def with_log_gradients(self, r2: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        a2_third = r2 * (5.0 / (3.0 * self.length_scale_m**2))
        a = np.sqrt(a2_third * 3.0)
        decay = np.exp(-a)
        decay *= self.variance
        a += 1.0
        to_length = a2_third * a
        to_length *= decay
        a += a2_third
        a *= decay
        return a, (a, to_length)

    def fill(self, r2: Float32Array, out: Float32Array) -> None:
        r2 *= np.float32(5.0 / self.length_scale_m**2)
        np.sqrt(r2, out=r2)
        np.negative(r2, out=out)
        np.exp(out, out=out)
        out *= np.float32(self.variance)
        # 1 + a + a^2 / 3 = ((a + 3/2)^2 + 3/4) / 3
        r2 += np.float32(1.5)
        r2 *= r2
        r2 += np.float32(0.75)
        r2 *= np.float32(1.0 / 3.0)
        out *= r2


@dataclass(frozen=True, slots=True)
class SmoothPlusRough(_Stationary):
    """A squared-exponential trend plus an exponential perturbation: the model that matches the reference field."""

    smooth_variance: float = 0.7
    smooth_length_scale_m: float = 120.0
    rough_variance: float = 0.3
    rough_length_scale_m: float = 25.0

    name: ClassVar[str] = "smooth+rough"
    half_correlation_scales: ClassVar[float] = 0.6931

    @property
    def smooth(self) -> SquaredExponential:
        return SquaredExponential(self.smooth_variance, self.smooth_length_scale_m)

    @property
    def rough(self) -> Matern12:
        return Matern12(self.rough_variance, self.rough_length_scale_m)

    @property
    def prior_variance(self) -> float:
        return self.smooth_variance + self.rough_variance

    def of_squared_distance(self, r2: FloatArray) -> FloatArray:
        k = self.smooth.of_squared_distance(r2)
        k += self.rough.of_squared_distance(r2)
        return k

    def with_log_gradients(self, r2: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        smooth, by_smooth = self.smooth.with_log_gradients(r2)
        rough, by_rough = self.rough.with_log_gradients(r2)
        return smooth + rough, (*by_smooth, *by_rough)

    def fill(self, r2: Float32Array, out: Float32Array) -> None:
        self.smooth.fill(r2, out)
        self.rough.fill(r2, r2)
        out += r2


STRETCH, BEARING = "stretch", "bearing_deg"


@dataclass(frozen=True, slots=True)
class Stretched:
    """An isotropic kernel with two lengths: longer along a bearing, and shorter across it.

    stretch: ratio of the longer to the shorter length, at least 1; the length scales of ``isotropic`` are their
    geometric mean. bearing_deg: of the longer axis, clockwise from north, 0 to 180. With d the offset, t the unit
    vector along it, n that across it and q the stretch, the squared length of d is (d t)^2 / q + (d n)^2 q.
    """

    isotropic: Kernel
    stretch: float
    bearing_deg: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.stretch) and self.stretch >= 1.0 and 0.0 <= self.bearing_deg <= 180.0):
            raise InvalidInput(
                f"kernel {self.name!r}: expected a stretch of at least 1 and a bearing of 0 to 180 deg, "
                f"got {self.stretch!r} and {self.bearing_deg!r}"
            )

    @property
    def name(self) -> str:
        """That of the isotropic kernel; the parameters tell them apart."""
        return self.isotropic.name

    @property
    def half_correlation_scales(self) -> float:
        """That of the isotropic kernel: in the metric the lengths are the same in all directions."""
        return self.isotropic.half_correlation_scales

    @property
    def prior_variance(self) -> float:
        return self.isotropic.prior_variance

    @property
    def metric(self) -> tuple[float, float, float]:
        """Coefficients of east^2, east north and north^2 in the squared length."""
        bearing = math.radians(self.bearing_deg)
        east, north, along, across = math.sin(bearing), math.cos(bearing), 1.0 / self.stretch, self.stretch
        return (
            along * east**2 + across * north**2,
            2.0 * (along - across) * east * north,
            along * north**2 + across * east**2,
        )

    def parameters(self) -> dict[str, float]:
        return {**self.isotropic.parameters(), STRETCH: self.stretch, BEARING: self.bearing_deg}

    def covariance(self, a_m: FloatArray, b_m: FloatArray) -> FloatArray:
        a, b = as_points(a_m), as_points(b_m)
        return self.of_squared_distance(
            self.squared_length(a[:, 0, None] - b[None, :, 0], a[:, 1, None] - b[None, :, 1])
        )

    def squared_length(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        of_east, of_both, of_north = self.metric
        length = (of_east * east_m + of_both * north_m) * east_m
        length += of_north * north_m * north_m
        return np.maximum(length, 0.0, out=length)

    def of_squared_distance(self, r2: FloatArray) -> FloatArray:
        return self.isotropic.of_squared_distance(r2)

    def with_log_gradients(self, r2: FloatArray) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        """As the protocol's, with derivatives by the parameters of the isotropic kernel alone."""
        return self.isotropic.with_log_gradients(r2)

    def fill(self, r2: Float32Array, out: Float32Array) -> None:
        self.isotropic.fill(r2, out)


KERNELS: dict[str, type[Kernel]] = {
    kind.name: kind for kind in (SquaredExponential, Matern12, Matern32, Matern52, SmoothPlusRough)
}
AUTO = "auto"  # not a kernel: the evidence chooses among KERNELS


def kernel_from(name: str, parameters: Mapping[str, float] | None = None) -> Kernel:
    """The kernel with that name and those parameters, or with its default ones; stretched if they say so.

    Raises InvalidInput for an unknown name or a set of parameters that the kernel does not have.
    """
    if name not in KERNELS:
        raise InvalidInput(f"expected a kernel among {', '.join(KERNELS)}, got {name!r}")
    kind = KERNELS[name]
    if parameters is None:
        return kind()
    expected = kind().parameters()
    if {STRETCH, BEARING} <= parameters.keys():
        isotropic = {key: value for key, value in parameters.items() if key not in (STRETCH, BEARING)}
        return Stretched(kernel_from(name, isotropic), float(parameters[STRETCH]), float(parameters[BEARING]))
    if set(parameters) != set(expected):
        raise InvalidInput(f"kernel {name!r}: expected parameters {', '.join(expected)}, got {', '.join(parameters)}")
    return kind(**{key: float(value) for key, value in parameters.items()})


def with_log_parameters(kernel: Kernel, log_parameters: FloatArray) -> Kernel:
    """A kernel of the same kind with the given logarithms of its parameters (p,), in the order of ``parameters``."""
    values = np.exp(log_parameters)
    return type(kernel)(**{key: float(value) for key, value in zip(kernel.parameters(), values, strict=True)})
