"""Constraints as polynomials in the vectors of joints, Phi(U), with their derivatives in time.

    Phi = sum over linear entries a (e . U) + sum over bilinear entries s U_i . U_j - offset,

where a linear entry picks one component of one vector. The *raw* Jacobian is the list of nonzero
entries of Phi_U: a for linear entries; s U_j and s U_i, component by component, for bilinear ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import final

import numpy as np

from ancfdae.assembly.joint_coefficients import Entries, Values
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_map import LinearMap


@final
class JointPolynomials:
    """What the constraints of all joints are at vectors U and coefficients, (..., n_vectors, d).

    `turning` tells whether coefficients of products depend on time; `raw_row` and `raw_at`,
    (n_raw,), are rows of Phi and components of U of the raw Jacobian.
    """

    def __init__(self, entries: Entries, n_lam: int, d: int, turning: bool) -> None:
        self.entries, self._shape, self._turning = entries, (n_lam, d), turning
        self._i, self._j = entries.s_i, entries.s_j
        axes, s_row = np.arange(d), np.repeat(entries.s_row, d)
        to_i, to_j = ((at[:, None] * d + axes).ravel() for at in (self._i, self._j))
        self.raw_row = np.concatenate([entries.a_row, s_row, s_row])
        self.raw_at = np.concatenate([entries.a_at, to_i, to_j])
        self._row_map, self._s_row_map, self._raw_row_map = (
            LinearMap.of(at, np.arange(len(at)), np.ones(len(at)), (n_lam, len(at)))
            for at in (entries.a_row, entries.s_row, self.raw_row)
        )

    def only(self, rows: Array) -> JointPolynomials:
        """Return those of some rows, a mask of shape (n_lam,); of the others it knows zeros."""
        return JointPolynomials(self.entries.only(rows), *self._shape, self._turning)

    def phi(self, c: Values, U: Array) -> Array:
        """Phi."""
        products = np.sum(U[..., self._i, :] * U[..., self._j, :], axis=-1)
        return self._linear(c, U) + self._s_row_map.rows(c.s * products) - c.offset

    def raw(self, c: Values, U: Array) -> Array:
        """Nonzero entries of Phi_U."""
        s = c.s[..., None]
        a = np.broadcast_to(c.a, (*U.shape[:-2], c.a.shape[-1]))
        to_i, to_j = _flat(s * U[..., self._j, :]), _flat(s * U[..., self._i, :])
        return np.concatenate([a, to_i, to_j], axis=-1)

    def raw_rate(self, series: Sequence[Values], *X: Array) -> Array:
        """Time derivative of `raw` of order n by Leibniz' rule; X_k is U^(k), k to n."""
        n = len(X) - 1
        rate = self.raw(Values(series[n].a, series[0].s, series[n].offset), X[n])
        for k in range(1, n + 1) if self._turning else ():
            still = Values(np.zeros_like(series[k].a), series[k].s, series[k].offset)
            rate = rate + math.comb(n, k) * self.raw(still, X[n - k])
        return rate

    def jacobian_times(self, series: Sequence[Values], U: Array, X: Array) -> Array:
        """Phi_U X."""
        return self._raw_row_map.rows(self.raw(series[0], U) * _flat(X)[..., self.raw_at])

    def rate(self, series: Sequence[Values], *X: Array) -> Array:
        """Time derivative of Phi of order n by Leibniz' rule; X_k is U^(k), k to n."""
        n, last = len(X) - 1, 0 if np.any(X[-1]) else 1
        # Where the last rate vanishes, its terms are left out: k and j begin behind it.
        rate = -series[n].offset
        for k in range(last, n + 1):
            rate = rate + math.comb(n, k) * self._linear(series[k], X[n - k])
        for k in range(n + 1 if self._turning else 1):
            # Of s^(k) and the derivative of order m of the products.
            m = n - k
            for j in range(last if k == 0 else 0, m // 2 + 1):
                share = math.comb(n, k) * math.comb(m, j) / (2 if 2 * j == m else 1)
                rate = rate + share * self._product(series[k], X[j], X[m - j])
        return rate

    def _linear(self, c: Values, U: Array) -> Array:
        return self._row_map.rows(c.a * _flat(U)[..., self.entries.a_at])

    def _product(self, c: Values, U: Array, V: Array) -> Array:
        """Sum of s (U_i . V_j + V_i . U_j)."""
        i, j = self._i, self._j
        products = np.sum(U[..., i, :] * V[..., j, :] + V[..., i, :] * U[..., j, :], axis=-1)
        return self._s_row_map.rows(c.s * products)


def _flat(U: Array) -> Array:
    """Join the last two axes; also where a leading axis is empty."""
    return U.reshape(*U.shape[:-2], U.shape[-2] * U.shape[-1])
