"""Elastic and internal damping forces of all elements that deform, with design derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import final

import numpy as np
import scipy

from ancfdae.ancf.block import ElementBlock
from ancfdae.ancf.numbering import Numbering
from ancfdae.ancf.parameters import ParameterMap
from ancfdae.elements import elastic
from ancfdae.elements.packing import packed_gram_direction
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.linear_map import LinearMap
from ancfdae.numerics.patterns import Pattern

# Elements whose complex arrays are held at once.
_TOGETHER = 300


@final
class ElasticForces:
    """Generalised elastic forces Q_s and their partials.

    States are given as rows of an array (k, n_q), one per instant.

    Parameters
    ----------
    block : ElementBlock
    numbering : Numbering
    mapping : ParameterMap
    n_b : int
        Number of design variables.
    pattern : Pattern
        Pattern of the system's matrices; must hold the entries of every element.
    """

    def __init__(
        self,
        block: ElementBlock,
        numbering: Numbering,
        mapping: ParameterMap,
        n_b: int,
        pattern: Pattern,
    ) -> None:
        self._block, self._numbering, self._n_b = block, numbering, n_b
        self._shape = (len(numbering.vectors), numbering.element.n_y, numbering.element.d)
        self._R = LinearMap(numbering.relative())
        self._tangent_map = _tangent_map(numbering, pattern)
        pairs = np.concatenate([block.stiffness_pairs, block.damping_pairs])
        self._stiff = len(block.stiffness_pairs)
        self._pair_element = mapping.elements[pairs]
        self._pair_variable = mapping.variables[pairs]
        self._pair_weight = mapping.weights[pairs]

    @property
    def damped(self) -> bool:
        """Whether forces depend on velocities."""
        return self._block.tau is not None

    def round_off(self, q: Array, weights: Array) -> float:
        """Size of the round-off in Q_s near a configuration, one instant.

        Relative node vectors carry eps |q| each, and forces the tangent times that; all terms
        by their magnitude, in the norm sqrt(sum Q^2 / weights).
        """
        block = self._block
        R = abs(self._numbering.relative())
        Y = self._R(q.real).reshape(self._shape)
        p_o = None if block.p_o is None else block.p_o.real
        K = np.abs(elastic.tangent(block.A.real, block.g_o.real, Y, p_o=p_o))
        F = np.matmul(K, (R @ np.abs(q.real)).reshape(*K.shape[:2], 1))
        Q = np.finfo(float).eps * (R.T @ F.ravel())
        return float(np.sqrt(np.sum(Q * Q / weights)))

    def relative(self, q: Array) -> Array:
        """Relative node vectors of all elements, shape (k, n, n_y, d)."""
        # In one piece for each element: matrix products of small strided blocks are slow.
        return np.ascontiguousarray(self._R.rows(q)).reshape(len(q), *self._shape)

    def force(self, q: Array, v: Array) -> Array:
        """Q_s for one instant, shape (n_q,)."""
        block = self._block
        Y = self._R(q).reshape(self._shape)
        V = None if block.tau is None else self._R(v).reshape(self._shape)
        F = elastic.force(block.A, block.g_o, Y, V, block.tau, block.p_o)
        return -self._R.transposed(F.ravel())

    def force_q(self, q: Array, v: Array) -> Array:
        """Values of (Q_s)_q on the pattern, shape (k, nnz)."""
        block, Y = self._block, self.relative(q)
        V = None if block.tau is None else self.relative(v)
        K = elastic.tangent(block.A, block.g_o, Y, V, block.tau, block.p_o)
        # Instants as whole rows in memory, as they are read afterwards.
        return np.negative(self._tangent_map.rows(K.reshape(len(q), -1)), order="C")

    def force_total(self, q: Array, v: Array, q_b: Array, v_b: Array) -> Array:
        """Total design derivative of Q_s for one instant, shape (n_q, n_b)."""
        block, tau, Y = self._block, self._block.tau, self._R(q).reshape(self._shape)
        V = None if tau is None else self._R(v).reshape(self._shape)
        shape = (len(Y), self._shape[1] * self._shape[2], self._n_b)
        U = self._R.columns(q_b).reshape(shape)
        VU = None if V is None else (V, self._R.columns(v_b).reshape(shape))
        x = elastic.strain(block.g_o, Y, V, tau)
        p_b = self._stresses_b(x, Y, V)
        p = elastic.stress(block.A, x, block.p_o)
        F_b = elastic.force_total(block.A, p, p_b, (Y, U), VU, tau)
        return -self._R.transposed(F_b.reshape(Y.size, self._n_b))

    def _stresses_b(self, x: Array, Y: Array, V: Array | None) -> Array:
        """Design partial of A (dg + tau g') at fixed Y and V, shape (n, n_g, n_b)."""
        block, element, variable = self._block, self._pair_element, self._pair_variable
        p_b = np.zeros((len(Y), self._n_b, x.shape[1]), dtype=np.result_type(x, block.A_b))
        stiff, damped = slice(self._stiff), slice(self._stiff, None)
        change = elastic.apply_invariant(block.A_b, x[element[stiff]]) - block.c_b
        np.add.at(p_b, (element[stiff], variable[stiff]), change)
        if V is not None and len(block.damping_pairs):
            at = element[damped]
            rate = packed_gram_direction(Y[at], V[at]) * self._pair_weight[damped, None]
            A = block.A if len(block.A) == 1 else block.A[at]
            np.add.at(p_b, (at, variable[damped]), elastic.apply_invariant(A, rate))
        return np.swapaxes(p_b, 1, 2)

    def force_v(self, q: Array) -> Array:
        """Values of (Q_s)_v on the pattern, shape (k, nnz); only if `damped`."""
        assert self._block.tau is not None
        K = elastic.damping_tangent(self._block.A, self.relative(q), self._block.tau)
        return -self._tangent_map.rows(K.reshape(len(q), -1))

    def force_b(self, q: Array, v: Array) -> Array:
        """(Q_s)_b, shape (k, n_q, n_b)."""
        F = self._pair_forces(q, v).reshape(len(q), -1)
        return -self._pair_map.rows(F).reshape(len(q), self._numbering.n_q, self._n_b)

    def tangent_rates(
        self, q: Array, v: Array, rates: tuple[Array, Array]
    ) -> tuple[Array, Array | None]:
        """Time derivatives of `force_q` and `force_v` of one instant along rates of q and v."""
        moved = [(x + 1j * STEP * rate)[None] for x, rate in zip((q, v), rates, strict=True)]
        rate_q = self.force_q(moved[0], moved[1]).imag / STEP
        return rate_q, self.force_v(moved[0]).imag / STEP if self.damped else None

    def pull_back_rate(self, q: Array, v: Array, rates: tuple[Array, Array], mu: Array) -> Array:
        """Time derivative of `pull_back` of one instant along rates of q and v, mu held."""
        moved = [(x + 1j * STEP * rate)[None] for x, rate in zip((q, v), rates, strict=True)]
        rate = self._pair_forces(moved[0], moved[1]).imag / STEP
        work = rate * self.relative(mu[None])[:, self._pair_element]
        per_pair = -np.sum(work, axis=(0, 2, 3))
        return np.bincount(self._pair_variable, per_pair, minlength=self._n_b)

    def pull_back(self, q: Array, v: Array, mu: Array) -> Array:
        """Sum over instants of (Q_s)_b^T mu, shape (n_b,); mu has shape (k, n_q)."""
        work = self._pair_forces(q, v) * self.relative(mu)[:, self._pair_element]
        per_pair = -np.sum(work, axis=(0, 2, 3))
        return np.bincount(self._pair_variable, per_pair, minlength=self._n_b)

    def force_rate(self, q: Array, v: Array, a: Array) -> Array:
        """d(Q_s)/dt along the motion, shape (n_q,), for one instant."""
        block = self._block
        Y, V, Z = (self._R(x).reshape(self._shape) for x in (q, v, a))
        F = elastic.force_rate(block.A, block.g_o, Y, V, Z, block.tau, block.p_o)
        return -self._R.transposed(F.ravel())

    def force_rate_total(self, states: Sequence[Array], states_b: Sequence[Array]) -> Array:
        """Total design derivative of `force_rate` for one instant, shape (n_q, n_b)."""
        block, n_b = self._block, self._n_b
        Y = [self._R(x).reshape(self._shape) for x in states]
        total = self._pair_map(self._pair_rates(Y).ravel()).reshape(self._numbering.n_q, n_b)
        Y_b = [self._R.columns(x).T.reshape(n_b, *self._shape) for x in states_b]
        count = max(1, _TOGETHER // max(1, self._shape[0]))
        for first in range(0, n_b, count):
            some = slice(first, first + count)
            y, v, z = (y + 1j * STEP * y_b[some] for y, y_b in zip(Y, Y_b, strict=True))
            F_b = elastic.force_rate(block.A, block.g_o, y, v, z, block.tau, block.p_o).imag / STEP
            total[:, some] += self._R.rows_transposed(F_b.reshape(len(F_b), -1)).T
        return -total

    def _pair_rates(self, Y: Sequence[Array]) -> Array:
        """Partial of the rate of the element force for every pair, shape (n_pairs, n_y, d)."""
        block, at, stiff = self._block, self._pair_element, slice(self._stiff)
        A, g_o = (np.broadcast_to(x, (len(Y[0]), *x.shape[1:])) for x in (block.A, block.g_o))
        A, g_o = A[at].astype(complex), g_o[at].astype(complex)
        A[stiff] += 1j * STEP * block.A_b
        g_o[stiff] += 1j * STEP * block.g_ob
        p_o = None
        if block.p_o is not None:
            p_o = np.broadcast_to(block.p_o, (len(Y[0]), *block.p_o.shape[1:]))[at].astype(complex)
            p_ob = elastic.apply_invariant(A[stiff].real, block.g_ob) - block.c_b
            p_o[stiff] += 1j * STEP * p_ob
        tau = None if block.tau is None else block.tau[at].astype(complex)
        if tau is not None:
            tau[self._stiff :] += 1j * STEP * self._pair_weight[self._stiff :]
        y, v, z = (x[at] for x in Y)
        return np.asarray(elastic.force_rate(A, g_o, y, v, z, tau, p_o).imag / STEP)

    # -- energies ------------------------------------------------------------------------------

    def energies(self, q: Array) -> Array:
        """Strain energy of every element, shape (k, n)."""
        block = self._block
        return elastic.energy(block.A, block.g_o, self.relative(q), block.p_o)

    def energy_q(self, q: Array, chosen: Array) -> Array:
        """Gradient of the energy of the chosen elements, shape (k, n_q)."""
        block = self._block
        F = elastic.force(block.A, block.g_o, self.relative(q), p_o=block.p_o)
        F = F * chosen[:, None, None]
        return self._R.rows_transposed(F.reshape(len(q), -1))

    def energy_b(self, q: Array, chosen: Array) -> Array:
        """Design partial of the energy of the chosen elements, shape (k, n_b)."""
        block, pairs = self._block, self._pair_element[: self._stiff]
        dg = elastic.strain(block.g_o, self.relative(q))[:, pairs]
        # d(1/2 dg^T A dg + p_o^T dg) = 1/2 dg^T A_b dg - dg^T c_b; the reference, which has no
        # energy whatever its length, has p_o^T g_ob = 0.
        per_pair = np.sum(dg * (0.5 * elastic.apply_invariant(block.A_b, dg) - block.c_b), axis=2)
        result = np.zeros((len(q), self._n_b), dtype=per_pair.dtype)
        np.add.at(result.T, self._pair_variable[: self._stiff], (per_pair * chosen[pairs]).T)
        return result

    def _pair_forces(self, q: Array, v: Array) -> Array:
        """Partial of the element force for every pair, shape (k, n_pairs, n_y, d)."""
        block, Y = self._block, self.relative(q)
        V = None if block.tau is None else self.relative(v)
        stiff = self._pair_element[: self._stiff]
        x = elastic.strain(block.g_o, Y, V, block.tau)
        F = elastic.force_partial(block.A_b, block.c_b, x[:, stiff], Y[:, stiff])
        if V is None or len(block.damping_pairs) == 0:
            return F
        damped, weight = self._pair_element[self._stiff :], self._pair_weight[self._stiff :]
        rate = packed_gram_direction(Y[:, damped], V[:, damped]) * weight[:, None]
        A = block.A if len(block.A) == 1 else block.A[damped]
        D = elastic.stressed(elastic.apply_invariant(A, rate), Y[:, damped])
        return np.concatenate([F, D], axis=1)

    @cached_property
    def _pair_map(self) -> LinearMap:
        """Map from the forces of all pairs to columns of a row-major (n_q, n_b) array."""
        size = self._shape[1] * self._shape[2]
        rows = (self._pair_element[:, None] * size + np.arange(size)).ravel()
        R = self._numbering.relative()
        shape = (R.shape[1] * self._n_b, len(rows))
        if len(rows) == 0:
            return LinearMap(scipy.sparse.csr_array(shape))
        picked = R[rows].tocoo()
        variable = np.repeat(self._pair_variable, size)[picked.row]
        return LinearMap.of(picked.col * self._n_b + variable, picked.row, picked.data, shape)


def _tangent_map(numbering: Numbering, pattern: Pattern) -> LinearMap:
    """Constant map from the element tangents in Y to values on the pattern."""
    n, size = len(numbering.vectors), numbering.element.n_y * numbering.element.d
    if n == 0:
        return LinearMap(scipy.sparse.csr_array((pattern.size, 0)))
    # Entries of R element by element; rows of an element and signs are those of the first one.
    rows, columns, signs = numbering.relative_entries()
    by_row = np.argsort(rows, kind="stable").reshape(n, -1)
    row, sign, columns = rows[by_row[0]], signs[by_row[0]], columns[by_row]
    index = pattern.index(columns[:, :, None], columns[:, None, :])
    raw = np.arange(n)[:, None, None] * size**2 + (row[:, None] * size + row)
    values = np.broadcast_to(np.outer(sign, sign), raw.shape)
    shape = (pattern.size, n * size * size)
    return LinearMap.of(index.ravel(), raw.ravel(), values.ravel(), shape)
