"""Section forces and stresses of cables.

The axial force is that of the balance of nodes, as in `section_forces`: the force Q_c of an element
on its chord is the mean of the section force, n = Q_c + (xi - 1/2) n' along the element with the
slope n' of the means of elements beside it, and N = n . r_x/|r_x|. The strain of the axis
oscillates along an element of a bent thin cable, by far more than its mean, and is right in the
middle only. The shear force is that of -E I r_xxx, the moment E I k with k = r_x x r_xx/|r_x|^2.
Stresses take the strain eps, the initial one included, with tau eps', linear as `_smoothing` has
it.
Stresses are those of the strain eps of the axis and of the curvature: E (eps - y k_z) at a height y
over the centroid of a planar cable. Sections of a cable in space have no axes, they may lie turned
by any angle about the tangent: its shear force and bending moment are their sizes, and the stress
is the largest that a point at a distance rho from the centroid can have, E (|eps| + rho |k|).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.model.elements import curvature
from ancfdae.model.elements.element import (
    Batch,
    ElementParameter,
    SectionLaw,
    SectionPlace,
    StressLaw,
)
from ancfdae.model.elements.hermite import curvature_weights, end_weight_xi, tangent_weights
from ancfdae.model.elements.section_forces import slope_of_means
from ancfdae.model.elements.stresses import SMALL_STRAIN, scaled
from ancfdae.model.sections.section import central_moments
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.quadrature import box_rule
from ancfdae.numerics.rotations import in_space

_THIRD = np.array([-12.0, 6.0, 6.0])


@final
@dataclass(frozen=True)
class _Line:
    """The centre line of n cables at places xi, shape (n_xi,), in scaled node vectors."""

    xi: Array
    l: Array
    tau: Array
    initial: Array

    @classmethod
    def of(cls, batch: Batch, xi: Array) -> _Line:
        """Return the axial law of elements at the points xi."""
        tau, initial = ElementParameter.DAMPING_TIME, ElementParameter.INITIAL_STRAIN
        return cls(xi, batch.lengths, batch.of(tau), batch.of(initial))

    def strains(self, Y: Array, V: Array) -> Array:
        """Return the initial strain + eps + tau eps', shape (..., n, n_xi)."""
        places, weights = _smoothing(self.xi)
        return np.asarray(self._strains_at(places, Y, V) @ weights.T)

    def _strains_at(self, places: Array, Y: Array, V: Array) -> Array:
        """Return the strains of the law at places in xi."""
        along, along_v = (tangent_weights(places) @ x for x in (Y, V))
        strains = 0.5 * (np.sum(along * along, axis=-1) - 1.0) + self.initial[:, None]
        return np.asarray(strains + self.tau[:, None] * np.sum(along * along_v, axis=-1))

    def force_on_chord(self, Y: Array, V: Array) -> Array:
        """Return the force of the stretch on r_2 - r_1 over E A, shape (..., n, d)."""
        corner, rule = box_rule((5,))
        places = corner[:, 0]
        weights = rule * end_weight_xi(places)
        along = tangent_weights(places) @ Y
        return np.asarray(weights @ (self._strains_at(places, Y, V)[..., None] * along))

    def tangents(self, Y: Array) -> tuple[Array, Array]:
        """Return r_x and r_xx, shape (..., n, n_xi, 3), padded with zero z in the plane."""
        H = np.stack(curvature_weights(self.xi), axis=-1)
        r_x, r_xx = tangent_weights(self.xi) @ Y, H @ Y / self.l[:, None, None]
        return in_space(r_x), in_space(r_xx)

    def pulled_back(
        self, Y: Array, V: Array, on_strain: Array, on_curvature: Array
    ) -> tuple[Array, Array]:
        """Return gradients in Y and V of a function, from its gradients in strain and curvature."""
        places, weights = _smoothing(self.xi)
        N = tangent_weights(places)
        on_points = (on_strain @ weights)[..., None]
        by_rate = on_points * self.tau[:, None, None]
        along, along_v = N @ Y, N @ V
        on_Y, on_V = N.T @ (on_points * along + by_rate * along_v), N.T @ (by_rate * along)
        (r_x, r_xx), d = self.tangents(Y), Y.shape[-1]
        H = np.stack(curvature_weights(self.xi), axis=-1)
        on_tangent = np.cross(r_xx, on_curvature)[..., :d]
        on_bend = np.cross(on_curvature, r_x)[..., :d] / self.l[:, None, None]
        return on_Y + tangent_weights(self.xi).T @ on_tangent + H.T @ on_bend, on_V


@final
class CableSectionLaw(SectionLaw):
    """Forces along tangent and normal; `stiffness` has E A and E I, shape (n,) each."""

    def __init__(self, run: Batch, place: SectionPlace, stiffness: tuple[Array, ...]) -> None:
        self._element = [place.element]
        batch, (E_A, E_I) = run[np.array(self._element)], stiffness
        self._run, self._run_E_A = _Line.of(run, np.zeros(1)), E_A
        self._bending = np.stack([E_I, run.lengths], axis=1)
        self._place, self._slope = place, slope_of_means(run.lengths, place)
        self._E_I = E_I[self._element]
        self._l, self._line = batch.lengths, _Line.of(batch, np.array([place.xi]))

    def forces(self, Y: Array, V: Array) -> Array:
        """N, V_y and M_z; in space the sizes of shear force and moment in the place of these."""
        l, E_I, d = self._l[:, None], self._E_I[:, None], Y.shape[-1]
        force = in_space(self._force(Y, V))
        Y, V = (scaled(x[..., self._element, :, :], self._l) for x in (Y, V))
        r_x, r_xx = (x[..., 0, :] for x in self._line.tangents(Y))
        r_xxx = in_space(_THIRD @ Y / l**2)
        square = np.sum(r_x * r_x, axis=-1, keepdims=True)
        tangent = r_x / np.sqrt(square)
        shear, moment = np.cross(tangent, -E_I * r_xxx), E_I * np.cross(r_x, r_xx) / square
        axial = np.sum(force[..., None, :] * tangent, axis=-1)
        forces = np.zeros((*axial.shape, 6), dtype=axial.dtype)
        forces[..., 0] = axial
        if d == 2:
            forces[..., 1], forces[..., 5] = shear[..., 2], moment[..., 2]
        else:
            # Where they vanish a size has no derivative.
            small = SMALL_STRAIN * self._E_I / self._l
            forces[..., 1] = np.sqrt(np.sum(shear * shear, axis=-1) + (small / self._l) ** 2)
            forces[..., 5] = np.sqrt(np.sum(moment * moment, axis=-1) + small**2)
        return forces[..., 0, :]

    def _force(self, Y: Array, V: Array) -> Array:
        """Return the section force from the forces on nodes of the elements, shape (..., d)."""
        means = curvature.forces(self._bending, Y)[..., 0, :]
        stretched = self._run.force_on_chord(scaled(Y, self._run.l), scaled(V, self._run.l))
        means = means + self._run_E_A[:, None] * stretched
        slope = np.einsum("n,...nd->...d", self._slope, means)
        place = self._place
        return np.asarray(means[..., place.element, :] + (place.xi - 0.5) * slope)


@final
class CableStressLaw(StressLaw):
    """Stresses at y and z, (n, n_f) each, of sections at xi."""

    def __init__(self, batch: Batch, xi: Array, places: tuple[Array, Array]) -> None:
        y, z, dA = batch.kind.section.points(batch.sizes, False)
        centroid, _ = central_moments(y, z, dA)
        offsets = np.stack(places, axis=-1) - centroid
        self._planar = batch.d == 2
        squares = np.sum(offsets * offsets, axis=-1)
        arms = offsets[..., 0] if self._planar else np.sqrt(squares)
        # Of fibres, then of places, one after the other.
        self._arms, self._E = arms[:, :, None], batch.moduli[0][:, None, None]
        self._l, self._line, self.count = batch.lengths, _Line.of(batch, xi), arms.size * len(xi)

    def von_mises(self, Y: Array, V: Array) -> Array:
        """Return the stresses, shape (k, n, n_f n_xi)."""
        stress = self._E * self._parts(*self._scaled(Y, V))[0]
        return np.asarray(stress.reshape(*stress.shape[:2], -1))

    def pulled_back(self, Y: Array, V: Array, weights: Array) -> tuple[Array, Array]:
        """Return the sum of weights times the gradient of half the squared stresses."""
        Y, V = self._scaled(Y, V)
        total, by_strain, by_curvature = self._parts(Y, V)
        weights = weights.reshape(total.shape) * self._E**2 * total
        on_strain = np.sum(weights * by_strain, axis=2)
        on_curvature = np.sum(weights[..., None] * by_curvature, axis=2)
        on_Y, on_V = self._line.pulled_back(Y, V, on_strain, on_curvature)
        return scaled(on_Y, self._l), scaled(on_V, self._l)

    def _scaled(self, Y: Array, V: Array) -> tuple[Array, Array]:
        return scaled(Y, self._l), scaled(V, self._l)

    def _parts(self, Y: Array, V: Array) -> tuple[Array, Array, Array]:
        """Stress over E, (k, n, n_f, n_xi), and its derivatives in the strain and in k."""
        strains = self._line.strains(Y, V)[:, :, None]
        k = np.cross(*self._line.tangents(Y))[:, :, None]
        if self._planar:
            net = strains - self._arms * k[..., 2]
            total = np.sqrt(net * net + SMALL_STRAIN**2)
            axis = -self._arms[..., None] * np.eye(3)[2]
            return total, net / total, (net / total)[..., None] * axis
        bent = self._arms[..., None] * k
        axial = np.sqrt(strains * strains + SMALL_STRAIN**2)
        bending = np.sqrt(np.sum(bent * bent, axis=-1) + SMALL_STRAIN**2)
        by_curvature = self._arms[..., None] * bent / bending[..., None]
        return axial + bending, strains / axial, by_curvature


def _smoothing(xi: Array) -> tuple[Array, Array]:
    """Return Gauss points, (5,), and their weights in the linear force at xi, (n_xi, 5).

    Of all linear forces along an element it is the one that does the same work as the force of the
    law on the chord and on both tangents, which have the weights 6 xi (1 - xi), (1 - xi)(1 - 3 xi)
    and xi (3 xi - 2).
    """
    corner, rule = box_rule((5,))
    places = corner[:, 0]
    weights = rule * (end_weight_xi(places) + 6 * (xi[:, None] - 0.5) * (2 * places - 1))
    return places, weights
