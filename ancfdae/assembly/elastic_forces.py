"""Elastic and internal damping forces of all flexible elements, with design derivatives.

With the invariant A and the packed Gram matrix g of the relative node vectors Y
(docs/theory/02-strain-energy.md):

    U = 1/2 dg^T A dg,   dg = g(Y) - g_o,
    force   = W(p) Y,    p = A (dg + tau g'),   g' = dg/dt     (eqs. 13, 17)
    tangent = W(p) (x) I_d + G(Y)^T A (G(Y) + tau G(V))        (eq. 19)
    damping tangent = tau G(Y)^T A G(Y),        G(Y) = dg/dY

Forces and tangents are computed in `ancfdae.kernels`. tau is the retardation time of Kelvin-Voigt
damping, stress = C (E + tau E').

Y and V have shape (..., n, n_y, d): leading axes are times. A has shape (n, n_g, n_g), or (1, n_g,
n_g) when all elements share it. Cables have bending energy in addition, whose stress and second
partials in g are added to p and A (`cable`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.block import ElementBlock
from ancfdae.assembly.numbering import Numbering
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.kernels import Block, strain, stressed
from ancfdae.model.elements import cable
from ancfdae.numerics.arrays import STEP, Array, only
from ancfdae.numerics.patterns import SparsityPattern


@final
@dataclass(frozen=True, eq=False)
class ElementPlaces:
    """Indices of the flexible elements among coordinates and matrix entries.

    `vectors`, (n, n_a), are the node vectors of the elements and `coordinates`, (n, n_a d), their
    coordinates. `index`, (n, (n_a d)^2), are the indices of the entries of an element tangent among
    the `size` values of the system's pattern.
    """

    vectors: Array
    d: int
    n_q: int
    coordinates: Array
    index: Array
    size: int

    @staticmethod
    def of(numbering: Numbering, pattern: SparsityPattern) -> ElementPlaces:
        """Return the elements' indices for a pattern that contains their tangents' entries."""
        vectors, d = numbering.vectors, numbering.d
        n, width = len(vectors), vectors.shape[1] * d
        at = numbering.coordinates(vectors).reshape(n, width)
        index = pattern.index(at[:, :, None], at[:, None]).reshape(n, width**2).astype(np.int32)
        return ElementPlaces(vectors, d, numbering.n_q, at, index, pattern.size)


@final
class ElasticForces:
    """Generalised elastic and internal damping forces Q_s and their partials.

    States are rows of an array (k, n_q), one per time. `tangent_places` are the elements, and the
    indices of their tangents on the system's pattern.
    """

    def __init__(
        self, block: ElementBlock, places: ElementPlaces, mapping: ParameterMap, n_b: int
    ) -> None:
        self._block, self._n_b, self._places = block, n_b, places
        invariants = block.A, block.g_o, block.bending, block.tau
        self._elements = Block(*invariants, places.vectors, places.d, places.n_q)
        self.tangent_places = self._elements, places.index
        pairs = np.concatenate([block.stiffness_pairs, block.damping_pairs])
        self._stiff = len(block.stiffness_pairs)
        self._pair_element = mapping.elements[pairs]
        self._pair_variable = mapping.variables[pairs]
        self._pair_weight = mapping.weights[pairs]

    @cached_property
    def law_b(self) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Derivatives of element invariants in design variables, in the order of `force_totals`."""
        order = np.lexsort((self._pair_variable, self._pair_element))
        places = np.arange(len(self._places.vectors) + 1)
        first = np.searchsorted(self._pair_element[order], places)
        tau_b, its = self._pair_weight[self._stiff :], self._block.partials
        return its.A_b, its.rest_b, tau_b, first, order, self._pair_variable[order]

    @property
    def damped(self) -> bool:
        """Whether an element has internal damping, so that forces depend on velocities."""
        return self._block.tau is not None

    def round_off(self, q: Array, weights: Array) -> float:
        """Return the norm of the round-off in Q_s near the configuration q, (n_q,).

        Relative node vectors have round-off eps |q|, and forces the tangent times that, all terms
        by their magnitude. The norm is sqrt(sum Q^2 / weights).
        """
        places, (n, size) = self._places.coordinates, self._places.coordinates.shape
        if not n:
            return 0.0
        apart = np.arange(n * size**2, dtype=np.int32).reshape(n, size**2)
        block, its = self._block, self._places
        bending = None if block.bending is None else block.bending.real
        real = Block(block.A.real, block.g_o.real, bending, None, its.vectors, its.d, its.n_q)
        K = np.abs(real.tangents(q.real, None, False, apart, apart.size)).reshape(n, size, size)
        F = np.matmul(K, np.abs(q)[places][..., None])
        Q = np.finfo(float).eps * np.bincount(places.ravel(), F.ravel(), minlength=len(q))
        return float(np.sqrt(np.sum(Q * Q / weights)))

    def relative(self, q: Array) -> Array:
        """Return the relative node vectors of all elements, shape (k, n, n_y, d)."""
        return self._elements.relative(q)

    def internal(self, q: Array, v: Array) -> Array:
        """Return -Q_s, shape (n_q,) for one time, or (k, n_q) for rows."""
        return self._elements.forces(q, v if self.damped else None)

    def internal_q(self, q: Array, v: Array) -> Array:
        """Return the values of -(Q_s)_q on the pattern, shape (k, nnz)."""
        v_or_none = v if self.damped else None
        return self._elements.tangents(q, v_or_none, False, self._places.index, self._places.size)

    def internal_v(self, q: Array) -> Array:
        """Return the values of -(Q_s)_v on the pattern, shape (k, nnz); only if `damped`."""
        return self._elements.tangents(q, None, True, self._places.index, self._places.size)

    def totals(self, q: Array, v: Array) -> Array:
        """Return -Q_s and its total design derivatives, shape (1 + n_b, n_q).

        The first rows of q and v are the state, the others its design derivatives.
        """
        return self._elements.force_totals(q, v if self.damped else None, self.law_b)

    def _along(self, states: tuple[Array, Array], rates: tuple[Array, Array]) -> Array:
        """Return the derivatives of -Q_s along rows of rates of q and v, shape (k, n_q)."""
        (q, v), (u, z) = states, rates
        if not self.damped:
            return self._elements.forces_along(q, None, u, None)
        return self._elements.forces_along(q, v, u, z)

    def force_b(self, q: Array, v: Array) -> Array:
        """Return the design partials of -Q_s, shape (k, n_q, n_b)."""
        return -self._partials(q, v, None).mT

    def tangent_rates(
        self, q: Array, v: Array, rates: tuple[Array, Array]
    ) -> tuple[Array, Array | None]:
        """Return the time derivatives of (Q_s)_q and (Q_s)_v at one time along rates of q and v."""
        moved = [(x + 1j * STEP * rate)[None] for x, rate in zip((q, v), rates, strict=True)]
        rate_q = -self.internal_q(moved[0], moved[1]).imag / STEP
        return rate_q, -self.internal_v(moved[0]).imag / STEP if self.damped else None

    def pull_back_rate(self, q: Array, v: Array, rates: tuple[Array, Array], mu: Array) -> Array:
        """Return the time derivative of `pull_back` at one time along rates of q and v."""
        return -self._partial_rates(q, v, rates, mu[None])

    def pull_back(self, q: Array, v: Array, mu: Array) -> Array:
        """Return the sum over times of (Q_s)_b^T mu, shape (n_b,); mu has shape (k, n_q)."""
        return -self._partials(q, v, mu)

    def force_along(self, states: tuple[Array, Array], rates: tuple[Array, Array]) -> Array:
        """Return the derivative of Q_s at one time along rates of q and v, shape (n_q,)."""
        u, z = rates
        return -only(self._along(states, (u[None], z[None])))

    def force_along_total(
        self, states: tuple[Array, ...], rates: tuple[Array, ...], moved_by: tuple[Array, ...]
    ) -> Array:
        """Return the total design derivative of `force_along`, shape (n_q, n_b).

        `moved_by` are the design derivatives of the states and of the rates.
        """
        q, v = states
        total = only(self._partial_rates(q, v, (rates[0], rates[1]), None)).T
        pairs = zip((*states, *rates), moved_by, strict=True)
        q, v, u, z = (x + 1j * STEP * x_b.T for x, x_b in pairs)
        along: Array = self._along((q, v), (u, z)).imag.T / STEP
        return -(total + along)

    def _partials(self, q: Array, v: Array, mu: Array | None) -> Array:
        """Return the design partials of -Q_s, (k, n_b, n_q), or their products with mu, summed."""
        v_or_none = v if self.damped else None
        return self._elements.force_partials(q, v_or_none, mu, self.law_b, self._n_b)

    def _partial_rates(
        self, q: Array, v: Array, rates: tuple[Array, Array], mu: Array | None
    ) -> Array:
        """Return design partials of -Q_s differentiated at one time along rates of q and v."""
        moved = [(x + 1j * STEP * rate)[None] for x, rate in zip((q, v), rates, strict=True)]
        return np.asarray(self._partials(moved[0], moved[1], mu).imag / STEP)

    # -- energies ------------------------------------------------------------------------------

    def energies(self, q: Array) -> Array:
        """Return the strain energy of every element, shape (k, n); J."""
        block = self._block
        return strain_energy(block.A, block.g_o, self.relative(q), block.bending)

    def energy_q(self, q: Array, chosen: Array) -> Array:
        """Return the gradient of the strain energy of the chosen elements, shape (k, n_q)."""
        block, Y = self._block, self.relative(q)
        p = apply_invariant(block.A, strain(block.g_o, Y, None, None))
        F = stressed(p * chosen[:, None], Y)
        if block.bending is not None:
            F = F + chosen[:, None, None] * cable.curvature_forces(block.bending, Y)
        return self._elements.lifted(F)

    def energy_b(self, q: Array, chosen: Array) -> Array:
        """Return the design partial of the strain energy of the chosen elements, shape (k, n_b)."""
        block, pairs = self._block, self._pair_element[: self._stiff]
        Y, its = self.relative(q), block.partials
        dg = strain(block.g_o, Y, None, None)[:, pairs]
        # d(1/2 dg^T A dg) = 1/2 dg^T A_b dg - dg^T c_b.
        per_pair = np.sum(dg * (0.5 * apply_invariant(its.A_b, dg) - its.c_b), axis=2)
        if block.bending is not None:
            bending = np.broadcast_to(block.bending, (len(self._places.vectors), 2))[pairs]
            change = its.rest_b[:, -2:]
            per_pair = per_pair + cable.energy_along(bending, change, Y[:, pairs])
        result = np.zeros((len(q), self._n_b), dtype=per_pair.dtype)
        np.add.at(result.T, self._pair_variable[: self._stiff], (per_pair * chosen[pairs]).T)
        return result


def apply_invariant(A: Array, x: Array) -> Array:
    """Return A x for each element: A of shape (n or 1, n_g, n_g), x of shape (..., n, n_g)."""
    product: Array
    if x.dtype.kind == "c" and A.dtype.kind != "c":
        # One after the other, so that A is not copied.
        product = apply_invariant(A, x.real) + 1j * apply_invariant(A, x.imag)
    elif len(A) == 1:
        product = x @ A[0]
    elif x.ndim == 2:
        product = np.matmul(A, x[..., None])[..., 0]
    else:
        # A is symmetric; one product per element for all times instead of one for each.
        instants = x.reshape(math.prod(x.shape[:-2]), *x.shape[-2:]).swapaxes(0, 1)
        product = np.matmul(instants, A).swapaxes(0, 1).reshape(x.shape)
    return product


def strain_energy(A: Array, g_o: Array, Y: Array, bending: Array | None = None) -> Array:
    """Return the strain energy of each element, (..., n), J, from invariants A and g_o."""
    dg = strain(g_o, Y, None, None)
    U = np.asarray(np.sum(dg * (0.5 * apply_invariant(A, dg)), axis=-1))
    return U if bending is None else U + cable.energy(bending, Y)
