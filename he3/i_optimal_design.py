"""I-optimal sample places: they minimise the average variance over the field, not the variance at one place.

The criterion is the posterior variance averaged over the field (I-optimality: Fedorov 1972; as "integrated mean squared
error" in Sacks, Welch, Mitchell & Wynn, Stat. Sci. 4, 1989): for the field f at nodes g of weights w, with samples at
P,

    V(P) = sum_g w_g [ k(g, g) - k(g, P) (K(P, P) + s^2 I)^-1 k(P, g) ]

which does not depend on the measured values. Samples on the border or close to others lower it little, so it does not
lead to the edges as the largest variance does. Its gradient with respect to the places is analytic, and costs about as
much as V itself: with B = (K + s^2 I)^-1 k(P, g) and M = B W B',

    dV/dp_i = 2 sum_j M_ij dk(p_i, p_j)/dp_i - 2 sum_g w_g B_ig dk(p_i, g)/dp_i.

Samples already taken are conditioned on once; after that only the free places cost anything. Nodes stand for square
cells: their squared distance to a place is increased by the mean squared distance of a cell's points from its centre,
because otherwise the optimum would draw places onto the nodes.

Covariances are looked up in a table, in float32. Their errors are magnified as the noise gets small, up to a covariance
that is not positive definite. So for small noise, and wherever a factorisation fails, covariances are evaluated in
float64; their derivatives are still looked up, which the direction of a descent survives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

from he3.errors import InvalidInput, NumericalFailure
from he3.frames import FloatArray, SiteGrid, as_points

CovarianceOfSquaredDistance = Callable[[FloatArray], FloatArray]
"""Squared distances [m^2] -> covariances, of the same shape."""

_Conditioned = tuple[NDArray[np.floating], NDArray[np.floating], FloatArray, NDArray[np.floating]]

TABLE_STEPS_PER_NODE = 40  # 1, entries of the table per spacing of the nodes: 0.25 m on a site of 500 m
MIN_NOISE = 1e-4  # 1, noise variance as a share of the field's, below which a smaller one does not change a design
DIRECT_BELOW_NOISE = 5e-4  # 1, the same, below which covariances are not looked up [measured]


@dataclass(frozen=True, slots=True)
class FieldNodes:
    """The field as the criterion represents it: square cells, coarser than the map's."""

    places_m: FloatArray
    """(G, 2) centres of the cells [m]."""
    weights: FloatArray
    """(G,) share of each cell in the average; they sum to 1."""
    spacing_m: float
    """Edge of the cells [m]."""


def field_nodes(grid: SiteGrid, interest: NDArray[np.floating] | None, most: int = 2500) -> FieldNodes:
    """At most about ``most`` square cells that together cover the grid, weighted by interest.

    interest: (rows, columns) weights >= 0, or None for 1 everywhere. Cells without interest are left out. Raises
    InvalidInput if no cell has any, or one has a negative or infinite one.
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
        *,
        rough: bool = False,
    ) -> None:
        """sampled_m: places (t, 2) [m] of the samples taken. Raises InvalidInput for a field without variance.

        rough: whether what these samples explain is computed in the precision of the table, which takes a third of the
        time and changes V by less than a millionth of the field's variance.
        """
        sampled = as_points(sampled_m) if len(sampled_m) else np.zeros((0, 2))
        variance = float(covariance(np.zeros(1))[0])
        if not variance > 0:
            raise InvalidInput(f"expected a field of positive variance, got {variance!r}")
        self._covariance = covariance
        self._prior_variance = variance
        self._noise = max(noise_variance / variance, MIN_NOISE)
        self._nodes = nodes
        self._sampled = sampled
        self._rough = rough
        self._last: tuple[FloatArray, _Conditioned] | None = None
        self._direct = self._noise < DIRECT_BELOW_NOISE
        self._prepare_or_go_direct()

    def __call__(self, places_m: FloatArray) -> float:
        """V with further samples at places (n, 2) [m]."""
        b, c_fg, _, _ = self._conditioned_or_go_direct(as_points(places_m))
        contraction = ["einsum_path", (0, 1), (0, 1)]
        value = self.without - float(np.einsum("ig,ig,g->", b, c_fg, self._weights, optimize=contraction))
        return max(value, self._least_variance(len(b)))

    def gradient(self, places_m: FloatArray) -> FloatArray:
        """The derivative (n, 2) [1/m] of V with respect to the places (n, 2) [m]."""
        p = as_points(places_m)
        b, _, k_ft, slope_g = self._conditioned_or_go_direct(p)
        weighted = b * self._weights
        # Against the nodes: dk/dp = 2 k' (p - g), with k' the derivative to the squared distance.
        pull = weighted * slope_g
        total = pull.sum(axis=1, dtype=np.float64)
        gradient = np.column_stack((p[:, 0] * total - pull @ self._x, p[:, 1] * total - pull @ self._y)) * -4.0
        # Among the free places, and against those sampled.
        m_ff = (weighted @ b.T).astype(np.float64)
        gradient += self._pair_gradient(p, p, m_ff)
        if len(self._sampled):
            m_ft = (weighted @ self._k_tg.T).astype(np.float64) - m_ff @ k_ft
            m_ft = cho_solve((self._factor, True), m_ft.T, check_finite=False).T
            gradient += self._pair_gradient(p, self._sampled, m_ft)
        return gradient

    def _prepare_or_go_direct(self) -> None:
        try:
            self._prepare()
        except NumericalFailure:
            if self._direct:
                raise
            self._direct = True
            self._prepare()

    def _conditioned_or_go_direct(self, p: FloatArray) -> _Conditioned:
        if self._last is not None and np.array_equal(self._last[0], p):
            return self._last[1]  # V and its gradient at the same places
        try:
            found = self._conditioned(p)
        except NumericalFailure:
            if self._direct:
                raise
            self._direct = True
            self._prepare()
            found = self._conditioned(p)
        self._last = p.copy(), found
        return found

    def _prepare(self) -> None:
        """Tabulate the covariance and condition on the samples taken, in the precision that is in use."""
        nodes, sampled, covariance, variance = self._nodes, self._sampled, self._covariance, self._prior_variance
        self._dtype: np.dtype[Any] = np.dtype(np.float64 if self._direct else np.float32)
        span = np.ptp(np.vstack((nodes.places_m, sampled)), axis=0)
        reach = 2.0 * float(np.hypot(*span)) + 4.0 * nodes.spacing_m
        self._step_m = nodes.spacing_m / TABLE_STEPS_PER_NODE
        r = np.arange(0.0, reach, self._step_m)
        values = covariance(r * r) / variance
        middles = covariance((r + 0.5 * self._step_m) ** 2) / variance
        # dk/d(r^2) between neighbouring entries, which belongs to the r halfway between them; flat beyond the table.
        slopes = np.diff(values) / np.diff(r * r)
        self._values = values.astype(self._dtype)
        self._middles = middles.astype(self._dtype)
        self._slopes = np.append(slopes, 0.0).astype(self._dtype)
        self._softening = nodes.spacing_m**2 / 6.0
        self._x = nodes.places_m[:, 0].astype(self._dtype)
        self._y = nodes.places_m[:, 1].astype(self._dtype)
        self._weights = nodes.weights.astype(self._dtype)
        columns, rows = np.unique(self._x), np.unique(self._y)
        on_lattice = np.array_equal(self._x, np.tile(columns, len(rows))) and np.array_equal(
            self._y, np.repeat(rows, len(columns))
        )
        self._lattice = (columns, rows) if on_lattice else None
        k_tg, _ = self._to_nodes(sampled)
        self._factor = self._factored(self._between(sampled, sampled)[0])
        if self._rough and not self._direct:
            inverse = solve_triangular(self._factor, np.eye(len(sampled)), lower=True, check_finite=False)
            self._whitened = inverse.astype(self._dtype) @ k_tg
        else:
            self._whitened = solve_triangular(self._factor, k_tg, lower=True, check_finite=False).astype(self._dtype)
        self._k_tg = k_tg
        left = 1.0 - np.einsum("ig,ig->g", self._whitened, self._whitened)
        self.without = max(float(self._weights @ left), self._least_variance(0))
        """V before any further sample."""

    def _least_variance(self, free: int) -> float:
        """A lower bound on V: half the variance that as many samples at one place would leave there."""
        return 0.5 / (1.0 + (len(self._sampled) + free) / self._noise)

    def _conditioned(self, p: FloatArray) -> _Conditioned:
        """What the samples taken leave of the covariance with the nodes, and what else follows from the places (n, 2).

        B (n, G) and that covariance (n, G), the one with the samples (n, t), and k' against the nodes (n, G).
        """
        k_fg, at = self._to_nodes(p)
        k_ft = self._between(p, self._sampled)[0]
        whitened_f = solve_triangular(self._factor, k_ft.T, lower=True, check_finite=False)
        c_fg = k_fg - whitened_f.T.astype(self._dtype) @ self._whitened
        c_ff = self._between(p, p)[0] - whitened_f.T @ whitened_f
        factor = self._factored(c_ff)
        inverse = cho_solve((factor, True), np.eye(len(p)), check_finite=False).astype(self._dtype)
        return inverse @ c_fg, c_fg, k_ft, self._slopes.take(at, mode="clip")

    def _pair_gradient(self, a: FloatArray, b: FloatArray, m: FloatArray) -> FloatArray:
        """2 sum_j M_ij dk(a_i, b_j)/da_i, (n, 2)."""
        slope = self._between(a, b)[1] * m
        total = slope.sum(axis=1)
        gradient: FloatArray = 4.0 * (a * total[:, None] - slope @ b)
        return gradient

    def _factored(self, covariance: FloatArray) -> FloatArray:
        """Lower Cholesky factor of a covariance (n, n) plus noise. Raises NumericalFailure if there is none."""
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
        """Covariance (n, m) between places and its derivative to the squared distance, in float64."""
        r2 = (a[:, 0, None] - b[None, :, 0]) ** 2 + (a[:, 1, None] - b[None, :, 1]) ** 2
        at = np.sqrt(r2) * (1.0 / self._step_m)
        below = np.minimum(at.astype(np.intp), len(self._values) - 2)
        slopes = self._slopes[below].astype(np.float64)
        if self._direct:
            return self._covariance(r2) / self._prior_variance, slopes
        part = at - below
        values = self._values[below] * (1.0 - part) + self._values[below + 1] * part
        return values, slopes

    def _to_nodes(self, p: FloatArray) -> tuple[NDArray[np.floating], NDArray[np.intp]]:
        """Covariance (n, G) between places and nodes, and where its derivative stands in the table."""
        xy = p.astype(self._dtype)
        r = self._squared_distances(xy)
        r += self._dtype.type(self._softening)
        values = self._covariance(r.astype(np.float64)) / self._prior_variance if self._direct else None
        np.sqrt(r, out=r)
        r *= self._dtype.type(1.0 / self._step_m)
        np.minimum(r, self._dtype.type(len(self._values) - 2), out=r)
        at = r.astype(np.intp)  # what `take` needs; it would convert any other integers
        if values is None:
            values = self._middles.take(at, mode="clip")
        return values, at

    def _squared_distances(self, xy: NDArray[np.floating]) -> NDArray[np.floating]:
        """Squared distances (n, G) [m^2] between places (n, 2) and nodes."""
        # On a lattice, each of its columns and rows counts once for all of its nodes.
        columns, rows = (self._x, self._y) if self._lattice is None else self._lattice
        dx, dy = xy[:, 0, None] - columns, xy[:, 1, None] - rows
        dx *= dx
        dy *= dy
        squared: NDArray[np.floating] = dx + dy if self._lattice is None else dx[:, None, :] + dy[:, :, None]
        return squared.reshape(len(xy), len(self._x))
