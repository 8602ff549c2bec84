"""Where a continuum beam's energy is integrated: fibres of the section times points along the axis.

Lengths are divided by the element length l, and the chord r_2 - r_1 with them (`strain_fields`), so
that the length enters through the fibres only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import final

import numpy as np

from ancfdae.elements.element import Batch, ElementParameter, Quantity
from ancfdae.elements.hermite import shape_weights
from ancfdae.elements.strain_fields import (
    axial_functions,
    components,
    section_functions,
    twist_shears,
)
from ancfdae.errors import InvalidInput
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.quadrature import box_rule
from ancfdae.sections.section import central_moments

# Poisson's effect on the axis couples stretch, quadratic in xi, with thickness strains, linear in
# xi: two points ask it where both can follow.
AXIS_POINTS = 2


@final
@dataclass(frozen=True)
class Fibres:
    """Fibres of n elements, or their derivative in a parameter.

    Attributes
    ----------
    offsets : array, shape (n, n_s, 2)
        y and z over l.
    volume : array, shape (n, n_s)
        Area that a fibre stands for, times l.
    factors : array, shape (n, 3)
        Square roots of the shear factors along y and z and of what the torsion constant is to the
        polar moment about the centroid: strains are multiplied by them.
    radii : array, shape (n, 3)
        Radii of gyration about the centroid along y and z, and sqrt(J/A), over l: what squares of
        curvatures and twist are multiplied by, limited in short elements (docs/theory.md, 2).
    centroid : array, shape (n, 1, 2)
        y and z of the centroid over l.
    """

    offsets: Array
    volume: Array
    factors: Array
    radii: Array
    centroid: Array

    def any(self) -> bool:
        """Whether anything differs from zero; radii and centroid follow from the rest."""
        parts = (self.offsets, self.volume, self.factors)
        return any(bool(np.any(part)) for part in parts)

    def axis(self) -> Fibres:
        """All of the section in one fibre at the centroid."""
        volume = self.volume.sum(axis=1, keepdims=True)
        return Fibres(self.centroid, volume, self.factors, self.radii, self.centroid)


def fibres(own: Batch) -> Fibres:
    """Return the fibres of elements."""
    l, kind, sizes = own.lengths, own.kind, own.sizes
    y, z, dA = kind.section.points(sizes, not kind.straight)
    centroid, moments = central_moments(y, z, dA)
    polar = moments.sum(axis=1)
    factors = np.ones((len(l), 3), dtype=own.parameters.dtype)
    if kind.energy is not None and kind.energy.corrected:
        k_y, k_z, J = kind.section.properties(sizes, own.moduli[1])
        factors = np.sqrt(np.stack([k_y, k_z, J / polar], axis=1))
    twist = factors[:, 2] ** 2 * polar
    squares = np.column_stack([moments, twist]) / np.sum(dA, axis=1)[:, None]
    offsets = np.stack([y, z], axis=-1) / l[:, None, None]
    radii, centroid = np.sqrt(squares) / l[:, None], centroid / l[:, None, None]
    radii = radii / np.sqrt(1 + radii**4)
    return Fibres(offsets, dA * l[:, None], factors, radii, centroid)


def fibres_partial(own: Batch, which: ElementParameter) -> Fibres:
    """Return the derivative of `fibres` in a parameter."""
    at, moved, step = fibres(own), fibres(own.moved(which)), own.step(which)
    names = [each.name for each in fields(Fibres)]
    return Fibres(*(change(getattr(moved, name), getattr(at, name), step) for name in names))


def gauss_rule(count: int) -> tuple[Array, Array]:
    """Gauss points along an element and their weights."""
    corner, rule = box_rule((count,))
    return corner[:, 0], rule


def along(function: Callable[..., Array], at: Sequence[Array], b: Sequence[Array]) -> Array:
    """Return the derivative of a function along changes of its arguments, by an imaginary step."""
    moved = (x.real + 1j * STEP * x_b.real for x, x_b in zip(at, b, strict=True))
    return np.asarray(function(*moved).imag / STEP)


def change(moved: Array, at: Array, step: Array) -> Array:
    """Return the derivative out of a value at `Batch.moved` parameters and at the parameters.

    What is imaginary already, in a complex-step run, does not count.
    """
    return np.asarray((np.imag(moved) - np.imag(at)) / step.reshape(-1, *[1] * (at.ndim - 1)))


@final
class Region:
    """Strains and volume at the points where an energy is integrated.

    Parameters
    ----------
    own : Batch
    fibres : Fibres
    along : (array, array), shape (n_xi,) each
        Places xi along the axis and their weights, such as those of `gauss_rule`.
    owners : array of str, shape (n,)
        What each element belongs to, for the error.

    Attributes
    ----------
    P : array, shape (n, n_p, n_v, n_g)
        Strains in the Gram matrix of the scaled node vectors.
    T : array, shape (n, n_p, n_v, n_v), or (n_v, n_v) for a straight reference
        Strains in the components of the metric.
    dV : array, shape (n, n_p)

    Raises
    ------
    InvalidInput
        If the reference configuration folds (det dr_o/dx <= 0 somewhere).
    """

    def __init__(
        self, own: Batch, fibres: Fibres, along: tuple[Array, Array], owners: Array
    ) -> None:
        self._xi, self._rule = along
        self._d, self._fibres = own.d, fibres
        assumed, straight = own.energy.assumed_strains, own.kind.straight
        self._beta = axial_functions(own.d, tuple(self._xi.tolist()), assumed, straight)
        self._B = self._metric(section_functions(fibres.offsets, fibres.factors, fibres.radii))
        self._straight, self._J_inv = straight, np.eye(own.d)
        self.dV = self._measure(fibres.volume)
        if not straight:
            self._Y = own.Y_unit
            J = self._gradient(fibres.offsets)
            det_J = np.linalg.det(J)
            _refuse_folds(det_J, owners)
            self._axes = _section_axes(J)
            self._J_inv = np.linalg.inv(self._axes @ J)
            self.dV = self.dV * det_J
        self.T = self._transform(self._J_inv, self._J_inv, 1.0)
        self.P = self.T @ self._B

    def partial(self, fibres_b: Fibres) -> tuple[Array, Array]:
        """Return the derivatives of P and dV."""
        own = self._fibres
        parts = [(x.offsets, x.factors, x.radii) for x in (own, fibres_b)]
        phi_b = along(section_functions, *parts)
        P_b = self.T @ self._metric(phi_b)
        dV_b = self._measure(fibres_b.volume)
        if self._straight:
            return P_b, dV_b
        # The section slopes of the reference, and so its axes, depend on no parameter.
        J_b = self._axes @ along(self._gradient, (own.offsets,), (fibres_b.offsets,))
        K_b = -self._J_inv @ J_b @ self._J_inv
        T_b = self._transform(K_b, self._J_inv, 0.0) + self._transform(self._J_inv, K_b, 0.0)
        trace = np.einsum("npij,npji->np", self._J_inv, J_b)
        det_J = self.dV / self._measure(own.volume)
        return P_b + T_b @ self._B, dV_b * det_J + self.dV * trace

    def of_twist(self, shear: Array) -> Array:
        """P of shear strains along y and z, (n, n_s, 2), over the rate of twist; in space."""
        B = twist_shears(self._beta, shear, self._fibres.radii[:, :2])
        return np.asarray(self.T @ B.reshape(len(B), -1, *B.shape[3:]))

    def shape(self, offsets: Array) -> Array:
        """Scaled shape functions, shape (n, n_p, n_a)."""
        return self._weights(Quantity.POSITION, offsets)

    def _weights(self, quantity: Quantity, offsets: Array) -> Array:
        """Weights of the node vectors at all points, shape (n, n_p, n_a)."""
        y, z = np.moveaxis(offsets[:, :, None], -1, 0)
        weights = shape_weights(self._d, quantity, self._xi, y, z)
        return weights.reshape(len(weights), -1, weights.shape[-1])

    def _metric(self, phi: Array) -> Array:
        """B at all points, shape (n, n_p, n_v, n_g)."""
        n_phi, _, n_v, n_g = self._beta.shape
        B = phi.reshape(-1, n_phi) @ self._beta.reshape(n_phi, -1)
        return B.reshape(len(phi), -1, n_v, n_g)

    def _measure(self, volume: Array) -> Array:
        measure: Array = volume[:, :, None] * self._rule
        return measure.reshape(len(volume), -1)

    def _gradient(self, offsets: Array) -> Array:
        """dr_o/dx (eq. 16), shape (n, n_p, d, d)."""
        n_s = self._d + 1
        slopes = [self._weights(quantity, offsets) for quantity in tuple(Quantity)[1:n_s]]
        # Of both positions the weights are opposite: that of the chord is the second one.
        N = np.stack(slopes, axis=-1)[..., np.r_[n_s, 1:n_s, n_s + 1 : 2 * n_s], :]
        J: Array = self._Y.transpose(0, 2, 1)[:, None] @ N
        return J

    def _transform(self, K_1: Array, K_2: Array, turn: float) -> Array:
        """T of the module `continuum`, bilinear in (K_1, K_2), both J_o^-1; (..., n_v, n_v)."""
        pairs = np.array(components(self._d))
        i, j = pairs.T[:, :, None]
        alpha, beta = pairs.T[:, None]
        product = K_1[..., alpha, i] * K_2[..., beta, j] + K_1[..., beta, i] * K_2[..., alpha, j]
        # 1/2 from 2 E = ..., doubled for engineering shear, halved where both terms are one entry.
        T = product * np.where(i == j, 0.5, 1.0) * np.where(alpha == beta, 0.5, 1.0)
        n_v, all_rows = len(pairs), self._beta.shape[2]
        # Turns are the same in all axes.
        padded = np.zeros((*T.shape[:-2], all_rows, all_rows), dtype=T.dtype)
        padded[..., :n_v, :n_v] = T
        turns = np.arange(n_v, all_rows)
        padded[..., turns, turns] = turn
        return padded


def _section_axes(J: Array) -> Array:
    """Rows: the normal of the section, r_y over its length, and what is across both in space.

    Shear factors, and C without Poisson's effect, belong to these axes.
    """
    r_y = J[..., 1] / np.sqrt(np.sum(J[..., 1] ** 2, axis=-1, keepdims=True))
    if J.shape[-1] == 2:
        normal = np.stack([r_y[..., 1], -r_y[..., 0]], axis=-1)
        return np.stack([normal, r_y], axis=-2)
    normal = np.cross(r_y, J[..., 2])
    normal = normal / np.sqrt(np.sum(normal**2, axis=-1, keepdims=True))
    return np.stack([normal, r_y, np.cross(normal, r_y)], axis=-2)


def _refuse_folds(det_J: Array, owners: Array) -> None:
    worst = np.min(det_J.real, axis=1)
    if not np.all(worst > 0):
        k = int(np.argmin(worst))
        raise InvalidInput(
            str(owners[k]),
            "dr_o/dx of the reference configuration must have a positive determinant everywhere",
            f"{float(worst[k]):.3g} at the worst point",
            "Use right-handed node frames, more elements along the curve or a thinner section.",
        )
