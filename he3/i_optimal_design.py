"""Where to sample so that the whole field becomes known, not where it is least known.

The criterion is the posterior variance averaged over the field (I-optimality: Fedorov 1972; as "integrated mean squared
error" in Sacks, Welch, Mitchell & Wynn, Stat. Sci. 4, 1989): for the field f at nodes g of weights w, with samples at
P,

    V(P) = sum_g w_g [ k(g, g) - k(g, P) (K(P, P) + s^2 I)^-1 k(P, g) ]

which does not depend on what is measured. Samples on the border or close to others lower it little, so that it does not
drive to the edges as the largest variance does. Its gradient with respect to the places is analytic, and costs about as
much as itself: with B = (K + s^2 I)^-1 k(P, g) and M = B W B',

    dV/dp_i = 2 sum_j M_ij dk(p_i, p_j)/dp_i - 2 sum_g w_g B_ig dk(p_i, g)/dp_i.

Samples already taken are conditioned on once; after that only the free ones cost anything. Nodes stand for square
cells: their squared distance to a place is increased by the mean squared distance of a cell's points from its centre,
or places would be drawn onto the nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

from he3.errors import InvalidInput, NumericalFailure
from he3.frames import Float32Array, FloatArray, SiteGrid, as_points

CovarianceOfSquaredDistance = Callable[[FloatArray], FloatArray]

TABLE_STEP_M = 0.25
"""Covariances are looked up at multiples of this distance [m]: far below any length scale that samples can tell."""
MIN_NOISE = 1e-4
"""Noise variance, as a share of the field's, below which a design does not change but the algebra suffers."""


@dataclass(frozen=True, slots=True)
class FieldNodes:
    """The field as the criterion sees it: square cells, coarser than the map's."""

    places_m: FloatArray
    """(G, 2) centres of the cells [m]."""
    weights: FloatArray
    """(G,) share of each cell in the average: they sum to 1."""
    spacing_m: float
    """Edge of the cells [m]."""


def field_nodes(grid: SiteGrid, interest: NDArray[np.floating] | None, most: int = 2500) -> FieldNodes:
    """At most about ``most`` square cells that together cover the grid, weighted by the interest in them.

    interest: (rows, columns) weights >= 0, or None for 1 everywhere. Raises InvalidInput if nothing is of interest.
    """
    block = max(1, int(np.ceil(np.sqrt(grid.rows * grid.columns / most))))
    rows = np.arange(0, grid.rows, block)
    columns = np.arange(0, grid.columns, block)
    weight = np.ones(grid.shape) if interest is None else np.asarray(interest, dtype=np.float64)
    summed = np.add.reduceat(np.add.reduceat(weight, rows, axis=0), columns, axis=1)
    total = summed.sum()
    if not (np.isfinite(total) and total > 0 and summed.min() >= 0):
        raise InvalidInput("expected interest that is finite, nowhere negative, and somewhere above zero")
    x = 0.5 * (columns + np.minimum(columns + block, grid.columns)) * grid.resolution_m
    y = 0.5 * (rows + np.minimum(rows + block, grid.rows)) * grid.resolution_m
    xx, yy = np.meshgrid(x, y)
    kept = summed.ravel() > 0
    places = np.column_stack((xx.ravel(), yy.ravel()))[kept]
    return FieldNodes(places, summed.ravel()[kept] / total, block * grid.resolution_m)


class AverageVariance:
    """V(P) for given nodes and samples already taken, in units of the field's prior variance."""

    def __init__(
        self,
        covariance: CovarianceOfSquaredDistance,
        noise_variance: float,
        nodes: FieldNodes,
        sampled_m: FloatArray,
    ) -> None:
        taken = as_points(sampled_m) if len(sampled_m) else np.zeros((0, 2))
        self._nodes = nodes
        span = np.ptp(np.vstack((nodes.places_m, taken)), axis=0)
        reach = 2.0 * float(np.hypot(*span)) + 4.0 * nodes.spacing_m
        r = np.arange(0.0, reach, TABLE_STEP_M)
        variance = float(covariance(np.zeros(1))[0])
        if not variance > 0:
            raise InvalidInput(f"expected a field of positive variance, got {variance!r}")
        values = covariance(r * r) / variance
        middles = covariance((r + 0.5 * TABLE_STEP_M) ** 2) / variance
        # dk/d(r^2) between neighbouring entries, to go with r at their middle; flat beyond the table.
        slopes = np.diff(values) / np.diff(r * r)
        self._values = values.astype(np.float32)
        self._middles = middles.astype(np.float32)
        self._slopes = np.append(slopes, 0.0).astype(np.float32)
        self._noise = max(noise_variance / variance, MIN_NOISE)
        self._softening = nodes.spacing_m**2 / 6.0
        self._x = nodes.places_m[:, 0].astype(np.float32)
        self._y = nodes.places_m[:, 1].astype(np.float32)
        self._weights = nodes.weights.astype(np.float32)
        self._taken = taken
        k_tg, _ = self._to_nodes(taken)
        self._factor = self._factored(self._between(taken, taken)[0])
        self._white = solve_triangular(self._factor, k_tg, lower=True, check_finite=False).astype(np.float32)
        self._k_tg = k_tg
        left = 1.0 - np.einsum("ig,ig->g", self._white, self._white)
        self.without = float(self._weights @ left)
        """V before any further sample."""
        self.variance: FloatArray = np.clip(left, 0.0, None).astype(np.float64)
        """(G,) variance of each node before any further sample."""

    def __call__(self, places_m: FloatArray) -> float:
        """V with further samples at places (n, 2) [m]."""
        return self._conditioned(places_m)[0]

    def with_gradient(self, places_m: FloatArray) -> tuple[float, FloatArray]:
        """V, and its derivative (n, 2) [1/m] with respect to the places (n, 2) [m]."""
        p = as_points(places_m)
        value, b, k_ft, slope_g = self._conditioned(p)
        weighted = b * self._weights
        # Against the nodes: dk/dp = 2 k' (p - g).
        pull = weighted * slope_g
        total = pull.sum(axis=1, dtype=np.float64)
        gradient = np.column_stack((p[:, 0] * total - pull @ self._x, p[:, 1] * total - pull @ self._y)) * -4.0
        # Among the free places, and against those taken.
        m_ff = (weighted @ b.T).astype(np.float64)
        gradient += self._push(p, p, m_ff)
        if len(self._taken):
            m_ft = (weighted @ self._k_tg.T).astype(np.float64) - m_ff @ k_ft
            m_ft = cho_solve((self._factor, True), m_ft.T, check_finite=False).T
            gradient += self._push(p, self._taken, m_ft)
        return value, gradient

    def _push(self, a: FloatArray, b: FloatArray, m: FloatArray) -> FloatArray:
        """2 sum_j M_ij dk(a_i, b_j)/da_i, (n, 2)."""
        slope = self._between(a, b)[1] * m
        total = slope.sum(axis=1)
        pushed: FloatArray = 4.0 * (a * total[:, None] - slope @ b)
        return pushed

    def _conditioned(self, p: FloatArray) -> tuple[float, Float32Array, FloatArray, Float32Array]:
        """V, B of the free places (n, G), their covariance with those taken (n, t), and k' against the nodes (n, G)."""
        k_fg, slope_g = self._to_nodes(p)
        k_ft = self._between(p, self._taken)[0]
        white_f = solve_triangular(self._factor, k_ft.T, lower=True, check_finite=False)
        c_fg = k_fg - white_f.T.astype(np.float32) @ self._white
        c_ff = self._between(p, p)[0] - white_f.T @ white_f
        factor = self._factored(c_ff)
        inverse = cho_solve((factor, True), np.eye(len(p)), check_finite=False).astype(np.float32)
        b = inverse @ c_fg
        value = self.without - float(np.einsum("ig,ig,g->", b, c_fg, self._weights, optimize=True))
        return value, b, k_ft, slope_g

    def _factored(self, covariance: FloatArray) -> FloatArray:
        if not len(covariance):
            return np.zeros((0, 0))
        try:
            factor: FloatArray = cholesky(
                covariance + self._noise * np.eye(len(covariance)), lower=True, check_finite=False
            )
        except np.linalg.LinAlgError:
            raise NumericalFailure(
                f"the covariance of {len(covariance)} places is not positive definite with noise {self._noise:g}"
            ) from None
        return factor

    def _between(self, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Covariance (n, m) and its derivative to the squared distance, between places."""
        r2 = (a[:, 0, None] - b[None, :, 0]) ** 2 + (a[:, 1, None] - b[None, :, 1]) ** 2
        at = np.sqrt(r2) * (1.0 / TABLE_STEP_M)
        below = np.minimum(at.astype(np.intp), len(self._values) - 2)
        part = at - below
        values = self._values[below] * (1.0 - part) + self._values[below + 1] * part
        return values, self._slopes[below].astype(np.float64)

    def _to_nodes(self, p: FloatArray) -> tuple[Float32Array, Float32Array]:
        """Covariance (n, G) and its derivative to the squared distance, between places and nodes."""
        xy = p.astype(np.float32)
        dx = xy[:, 0, None] - self._x
        dy = xy[:, 1, None] - self._y
        dx *= dx
        dy *= dy
        dx += dy
        dx += np.float32(self._softening)
        np.sqrt(dx, out=dx)
        dx *= np.float32(1.0 / TABLE_STEP_M)
        at = dx.astype(np.int32)
        np.minimum(at, len(self._values) - 2, out=at)
        return self._middles.take(at), self._slopes.take(at)
