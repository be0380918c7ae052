"""Unit Gaussian random fields with exponential covariance, independent or jointly correlated.

Circulant embedding (Dietrich and Newsam 1997; Wood and Chan 1994): the covariance of a field on a regular grid is
embedded in that of a torus at least twice as large, which the Fourier transform diagonalises. The samples have exactly
the covariance asked for if no eigenvalue of the torus is negative, which holds for a region of 500 m and a length of
25 m. Otherwise the torus is doubled until the negative eigenvalues, set to zero, hold less than a millionth of the
variance.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import fft

from he3.errors import InvalidInput, NumericalFailure

if TYPE_CHECKING:
    from he3.frames import FloatArray

_MAX_DOUBLINGS = 8  # 1, of the torus, before giving up
_MAX_TORUS_CELLS = 2**24  # cells: 256 MB of complex numbers
_MAX_CLIPPED_VARIANCE = 1e-6  # 1, share of the torus's total variance that clipped eigenvalues may hold


def exponential_covariance(distance_m: FloatArray, length_m: float) -> FloatArray:
    """Covariance exp(-r / length) of a unit field at the given distances [m], of the same shape."""
    covariance: FloatArray = np.exp(-np.asarray(distance_m, dtype=np.float64) / length_m)
    return covariance


def unit_fields(
    count: int, shape: tuple[int, int], spacing_m: tuple[float, float], length_m: float, random: np.random.Generator
) -> FloatArray:
    """Independent zero-mean, unit-variance Gaussian fields with exponential covariance, (count, rows, columns).

    spacing_m: distance between neighbouring rows and between neighbouring columns [m]. Raises InvalidInput for sizes
    that are not positive, and NumericalFailure if no torus of at most 2^24 cells embeds the covariance (a correlation
    length far longer than the grid).
    """
    rows, columns = shape
    if count < 1 or rows < 1 or columns < 1:
        raise InvalidInput(f"expected at least one field of at least one cell, got {count} of {rows} x {columns}")
    if not (length_m > 0 and spacing_m[0] > 0 and spacing_m[1] > 0):
        raise InvalidInput(f"expected a positive length and spacing [m], got {length_m} and {spacing_m}")
    amplitude = _torus_amplitude(shape, spacing_m, length_m)
    fields = np.empty((count, rows, columns))
    for first in range(0, count, 2):  # a complex transform yields two independent fields
        torus = np.empty(amplitude.shape, dtype=np.complex128)
        torus.real = random.standard_normal(amplitude.shape)
        torus.imag = random.standard_normal(amplitude.shape)
        torus *= amplitude
        torus = fft.fft2(torus, overwrite_x=True)  # in place: a site of a million cells has a torus of four million
        fields[first] = torus.real[:rows, :columns]
        if first + 1 < count:
            fields[first + 1] = torus.imag[:rows, :columns]
    return fields


def correlated(fields: FloatArray, correlation: FloatArray) -> FloatArray:
    """Unit fields (k, rows, columns) with the given correlation (k, k) between them, from independent ones.

    g = L z at every cell, with L the lower Cholesky factor of the correlation. Raises InvalidInput for shapes that do
    not fit, and NumericalFailure if the correlation is not positive definite.
    """
    k = fields.shape[0]
    if fields.ndim != 3 or correlation.shape != (k, k):
        raise InvalidInput(f"expected fields (k, rows, columns) and a (k, k) correlation, got {fields.shape} and "
                           f"{correlation.shape}")  # fmt: skip
    try:
        factor = np.linalg.cholesky(correlation)
    except np.linalg.LinAlgError:
        least = float(np.linalg.eigvalsh(correlation)[0])
        raise NumericalFailure(
            f"expected a positive definite correlation between layers, got one with least eigenvalue {least:.3g}"
        ) from None
    joint: FloatArray = np.tensordot(factor, fields, axes=1)
    return joint


def layer_correlation(layers: FloatArray) -> FloatArray:
    """Pearson correlation (k, k) between layers (k, rows, columns); a constant layer has correlation 0 with others."""
    flat = layers.reshape(layers.shape[0], -1)
    centred = flat - flat.mean(axis=1, keepdims=True)
    norms = np.linalg.norm(centred, axis=1)
    varies = norms > 1e-12 * np.maximum(np.linalg.norm(flat, axis=1), np.finfo(float).tiny)
    unit = np.where(varies, 1.0 / np.where(varies, norms, 1.0), 0.0)[:, None] * centred
    correlation: FloatArray = unit @ unit.T
    np.fill_diagonal(correlation, 1.0)
    return correlation


def _torus_amplitude(shape: tuple[int, int], spacing_m: tuple[float, float], length_m: float) -> FloatArray:
    """Square root of the torus's eigenvalues over its size: the amplitudes that shape white noise."""
    clipped = np.inf
    for growth in range(_MAX_DOUBLINGS + 1):
        sizes = [int(fft.next_fast_len(max(2 * n - 1, 1) * 2**growth)) for n in shape]
        if growth and sizes[0] * sizes[1] > _MAX_TORUS_CELLS:
            break
        lags = [np.minimum(np.arange(n), n - np.arange(n)) * d for n, d in zip(sizes, spacing_m, strict=True)]
        covariance = exponential_covariance(np.hypot(lags[0][:, None], lags[1][None, :]), length_m)
        eigenvalues = fft.fft2(covariance).real.copy()
        del covariance  # and the complex transform with it: see above
        clipped = float(-eigenvalues[eigenvalues < 0].sum() / eigenvalues.size)
        if clipped <= _MAX_CLIPPED_VARIANCE:
            amplitude: FloatArray = np.sqrt(np.maximum(eigenvalues, 0.0) / eigenvalues.size)
            return amplitude
    raise NumericalFailure(
        f"expected a torus whose covariance is positive for a correlation length of {length_m:g} m; at the largest "
        f"tried {clipped:.2g} of the variance is still negative: use a shorter length"
    )
