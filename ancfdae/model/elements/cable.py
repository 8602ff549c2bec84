"""Gradient-deficient cables of the plane (8 coordinates) and of space (12).

Node vectors X = [r_1, r_x1, r_2, r_x2] (Berzeri & Shabana 2000; Gerstmayr & Shabana 2006): a centre
line that stretches and bends, without shear, torsion and deformation of the section. Beam law, no
Poisson effect:

    U = int 1/2 E A eps^2 + 1/2 (E I/lambda) kappa^2 dx,   eps = (r_x . r_x - 1)/2 + eps_i,

with the curvature kappa of the material and the initial strain eps_i, free of which a reference
length dx is lambda dx, lambda^2 = 1 - 2 eps_i. The stretch makes A, an integral over xi times E A
and powers of l; bending has the flexural stiffness E I/lambda, which is E I for the length and the
curvature of the cable free of stress.

**Bending** is taken at Gauss points. With t = r_x, h = l r_xx and the part of h across t, n = h - t
(t . h)/(t . t), the tangent turns by

    kappa = |r_x x r_xx| / |r_x|^2 = |n| / (l |t|)

per length of the reference configuration, however the cable is stretched, and the energy is
1/2 int E I kappa^2 dx (docs/theory/02-strain-energy.md). Two Gauss points are exact for small
deflections, whose kappa is linear along an element. Forces and tangents of simulations are those of
`kernels/bending.h`; here the same formulas stand in vectors, for energies and section
forces.

`bending`, (n or 1, 2), holds the flexural stiffness E I and the length l; both are zero in beams.
Y, (..., n, n_y, d), are relative node vectors, of which the chord, r_x1 and r_x2 count.

**Section forces and stresses.** The axial force is that of the balance of nodes, as in
`section_results`: the force Q_c of an element on its chord is the mean of the section force, n =
Q_c + (xi - 1/2) n' along the element with the slope n' of the means of elements beside it, and N =
n . r_x/|r_x|. The strain of the axis oscillates along an element of a bent thin cable, by far more
than its mean, and is right in the middle only. The shear force is that of -E I r_xxx, the moment E
I k with k = r_x x r_xx/|r_x|^2. Stresses take the strain eps, the initial one included, with tau
eps', linear as `_smoothing` has it. Stresses are those of the strain eps of the axis and of the
curvature: E (eps - y k_z) at a height y over the centroid of a planar cable. Sections of a cable in
space have no axes, they may lie turned by any angle about the tangent: its shear force and bending
moment are their sizes, and the stress is the largest that a point at a distance rho from the
centroid can have, E (|eps| + rho |k|).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import final

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.elements.element import (
    Batch,
    BeamElement,
    ElementIntegrals,
    ElementParameter,
    Quantity,
    SectionLaw,
    SectionPlace,
    StressLaw,
    curvature_weights,
    end_weight,
    end_weight_xi,
    slope_weights,
    tangent_weights,
)
from ancfdae.model.elements.section_results import SMALL_STRAIN, scaled, slope_of_means
from ancfdae.model.elements.strains import change, upper_triangle
from ancfdae.model.sections.section import Section, central_moments
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.rotations import in_space
from ancfdae.numerics.time_grid import box_rule

_CORNER, _RULE = box_rule((2,))
#: Gauss points of the energy of bending, in xi, shape (2,).
POINTS: Array = _CORNER[:, 0]
_T, _H = tangent_weights(POINTS), np.stack(curvature_weights(POINTS), axis=-1)


def energy(bending: Array, Y: Array) -> Array:
    """Return the bending energy of each element, shape (..., n), J."""
    per_l, Z = _scaled(bending, Y)
    return np.asarray(bending[:, 0] * per_l * _energy(Z))


def energy_along(bending: Array, change: Array, Y: Array) -> Array:
    """Return the derivative of `energy`, shape (..., n), along a change of `bending` at fixed Y."""
    per_l, Z = _scaled(bending, Y)
    mean, by_chord = _energy(Z), np.sum(_gradient(Z)[..., 0, :] * Z[..., 0, :], axis=-1)
    by_length = -bending[:, 0] * per_l**2 * (mean + by_chord)
    return np.asarray(change[:, 0] * per_l * mean + change[:, 1] * by_length)


def curvature_forces(bending: Array, Y: Array) -> Array:
    """Return the bending forces on the relative node vectors, dU/dY, shape (..., n, n_y, d)."""
    per_l, Z = _scaled(bending, Y)
    on_Z = (bending[:, 0] * per_l)[:, None, None] * _gradient(Z)
    on_Z[..., 0, :] *= per_l[:, None]
    F = np.zeros(Y.shape, dtype=on_Z.dtype)
    F[..., _rows(Y), :] = on_Z
    return F


def _rows(Y: Array) -> list[int]:
    """Return the indices of chord, r_x1 and r_x2 among a cable's relative node vectors Y."""
    return [0, 1, (Y.shape[-2] + 1) // 2]


def _scaled(bending: Array, Y: Array) -> tuple[Array, Array]:
    """Return 1/l, (n or 1,), 0 for beams, which do not bend as cables, and chord/l, r_x1, r_x2.

    The vectors have the shape (..., n, 3, d).
    """
    l = bending[:, 1]
    per_l = np.where(l == 0, 0.0, 1 / np.where(l == 0, 1.0, l))
    Z = Y[..., _rows(Y), :].astype(np.result_type(Y, l))
    Z[..., 0, :] *= per_l[:, None]
    return per_l, Z


def _vectors(Z: Array) -> tuple[Array, Array, Array, Array]:
    """Return t and n at the Gauss points, shape (..., 2, d), then t . t and (t . h)/(t . t)."""
    t, h = _T @ Z, _H @ Z
    square = np.sum(t * t, axis=-1, keepdims=True)
    along = np.sum(t * h, axis=-1, keepdims=True) / square
    return t, h - along * t, square, along


def _energy(Z: Array) -> Array:
    """Return the mean of (l kappa)^2/2 over each element, (..., n), from scaled node vectors Z."""
    _, across, square, _ = _vectors(Z)
    return np.asarray(0.5 * np.sum(across * across / square, axis=-1) @ _RULE)


def _gradient(Z: Array) -> Array:
    """Return the derivative of `_energy` in Z, shape (..., n, 3, d)."""
    t, across, square, along = _vectors(Z)
    kappa_squared = np.sum(across * across, axis=-1, keepdims=True) / square
    on_t = -(along * across + kappa_squared * t) / square
    rule = _RULE[:, None]
    return np.asarray(_T.T @ (rule * on_t) + _H.T @ (rule * across / square))


# -- section forces and stresses ---------------------------------------------------------------


_THIRD = np.array([-12.0, 6.0, 6.0])


@final
@dataclass(frozen=True)
class _Line:
    """Tangents and axial strains of the centre lines of n cables at locations xi, shape (n_xi,)."""

    xi: Array
    l: Array
    tau: Array
    initial: Array

    @classmethod
    def of(cls, batch: Batch, xi: Array) -> _Line:
        """Return the centre lines of the elements of `batch` at locations xi, shape (n_xi,)."""
        tau, initial = ElementParameter.DAMPING_TIME, ElementParameter.INITIAL_STRAIN
        return cls(xi, batch.lengths, batch.of(tau), batch.of(initial))

    def strains(self, Y: Array, V: Array) -> Array:
        """Return the axial strains eps_i + eps + tau eps', smoothed, shape (..., n, n_xi)."""
        places, weights = _smoothing(self.xi)
        return np.asarray(self._strains_at(places, Y, V) @ weights.T)

    def _strains_at(self, places: Array, Y: Array, V: Array) -> Array:
        """Return the axial strains eps_i + eps + tau eps' at locations xi, not smoothed."""
        along, along_v = (tangent_weights(places) @ x for x in (Y, V))
        strains = 0.5 * (np.sum(along * along, axis=-1) - 1.0) + self.initial[:, None]
        return np.asarray(strains + self.tau[:, None] * np.sum(along * along_v, axis=-1))

    def force_on_chord(self, Y: Array, V: Array) -> Array:
        """Return the force of axial stretch on the chord over E A, shape (..., n, d)."""
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
        """Return a function's gradients in Y and V from those in axial strain and curvature."""
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
    """Axial and shear force and bending moment in a cable section.

    `stiffness` holds E A and E I of the elements, shape (n,) each.
    """

    def __init__(self, run: Batch, place: SectionPlace, stiffness: tuple[Array, ...]) -> None:
        self._element = [place.element]
        batch, (E_A, E_I) = run[np.array(self._element)], stiffness
        self._run, self._run_E_A = _Line.of(run, np.zeros(1)), E_A
        self._bending = np.stack([E_I, run.lengths], axis=1)
        self._place, self._slope = place, slope_of_means(run.lengths, place)
        self._E_I = E_I[self._element]
        self._l, self._line = batch.lengths, _Line.of(batch, np.array([place.xi]))

    def forces(self, Y: Array, V: Array) -> Array:
        """Return N, V_y and M_z, shape (..., 6); in space V_y and M_z are magnitudes. N and N m."""
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
            # A magnitude has no derivative where the vector vanishes.
            small = SMALL_STRAIN * self._E_I / self._l
            forces[..., 1] = np.sqrt(np.sum(shear * shear, axis=-1) + (small / self._l) ** 2)
            forces[..., 5] = np.sqrt(np.sum(moment * moment, axis=-1) + small**2)
        return forces[..., 0, :]

    def _force(self, Y: Array, V: Array) -> Array:
        """Return the section force vector by equilibrium of the nodes, shape (..., d); N."""
        means = curvature_forces(self._bending, Y)[..., 0, :]
        stretched = self._run.force_on_chord(scaled(Y, self._run.l), scaled(V, self._run.l))
        means = means + self._run_E_A[:, None] * stretched
        slope = np.einsum("n,...nd->...d", self._slope, means)
        place = self._place
        return np.asarray(means[..., place.element, :] + (place.xi - 0.5) * slope)


@final
class CableStressLaw(StressLaw):
    """Stresses of cables at the points y and z, (n, n_f) each, of sections at xi."""

    def __init__(self, batch: Batch, xi: Array, places: tuple[Array, Array]) -> None:
        y, z, dA = batch.kind.section.points(batch.sizes, False)
        centroid, _ = central_moments(y, z, dA)
        offsets = np.stack(places, axis=-1) - centroid
        self._planar = batch.d == 2
        squares = np.sum(offsets * offsets, axis=-1)
        arms = offsets[..., 0] if self._planar else np.sqrt(squares)
        # Axes: element, fibre, location xi.
        self._arms, self._E = arms[:, :, None], batch.moduli[0][:, None, None]
        self._l, self._line, self.count = batch.lengths, _Line.of(batch, xi), arms.size * len(xi)

    def von_mises(self, Y: Array, V: Array) -> Array:
        """Return the absolute stresses E |eps| + E rho |k|, shape (k, n, n_f n_xi); Pa."""
        stress = self._E * self._parts(*self._scaled(Y, V))[0]
        return np.asarray(stress.reshape(*stress.shape[:2], -1))

    def pulled_back(self, Y: Array, V: Array, weights: Array) -> tuple[Array, Array]:
        """Return gradients in Y and V of the weighted sum of half the squared stresses."""
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
        """Return stress/E, (k, n, n_f, n_xi), and its derivatives in axial strain and in k."""
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
    """Return Gauss points, (5,), and their weights in the linear axial force at xi, (n_xi, 5).

    The linear force along an element does the same work as the force of the law on the chord and on
    both tangents, whose weights are 6 xi (1 - xi), (1 - xi)(1 - 3 xi) and xi (3 xi - 2).
    """
    corner, rule = box_rule((5,))
    places = corner[:, 0]
    weights = rule * (end_weight_xi(places) + 6 * (xi[:, None] - 0.5) * (2 * places - 1))
    return places, weights


# -- elements ----------------------------------------------------------------------------------


# Exponents of l in the shape functions s_a, in the tangent weights, and in the flexural stiffness.
_S_POWER, _N_POWER = np.array([0, 1, 0, 1]), np.array([-1, 0, 0])
_NO_POWER = np.zeros(1, dtype=int)
# Relative difference of the two second moments up to which a section counts as round: round-off.
_ROUND = 1e-9


@final
@dataclass(frozen=True)
class Cable(BeamElement):
    """The cable element in d dimensions: positions and tangents at the nodes, no section."""

    name: str
    d: int

    quantities = (Quantity.POSITION, Quantity.SLOPE_X)
    default_energy = None

    def check_section(self, where: str, section: Section) -> None:
        """Raise InvalidInputError for a spatial cable whose section has unequal second moments."""
        (yy, yz), (_, zz) = section.second_moments()
        if self.d == 3 and max(abs(yy - zz), 2 * abs(yz)) > _ROUND * (yy + zz):
            raise InvalidInputError(
                f"{where}, section",
                "must bend as easily about every axis: a cable in space has no axes across it",
                repr(section),
                "Use a Circle, or the element BEAM_3D.",
            )

    def vector_weights(
        self, quantity: Quantity, xi: float, y: float, z: float
    ) -> tuple[Array, Array]:
        """Return weights and powers of l, (4,) each, of the Hermite cubic or of its tangent."""
        if quantity is Quantity.POSITION:
            return _shape(np.array(xi)), _S_POWER
        chord, first, second = tangent_weights(np.array(xi))
        return np.array([-chord, first, chord, second]), np.array([-1, 0, -1, 0])

    def integrals(self, batch: Batch, owners: Array) -> ElementIntegrals:
        """Return the invariants of cables: integrals times E A and rho A, and E I."""
        if not batch.kind.straight:
            raise InvalidInputError(
                str(owners[0]),
                "a cable must be straight in its reference configuration",
                "a curved one",
                "Use Beam, or another element.",
            )
        return _CableIntegrals(batch)

    def section_law(self, batch: Batch, place: SectionPlace) -> SectionLaw:
        """Return the evaluator of axial and shear force and bending moment in a cable section."""
        return CableSectionLaw(batch, place, _moduli(batch)[::2])

    def stress_law(self, batch: Batch, xi: Array, places: tuple[Array, Array]) -> StressLaw:
        """Return the evaluator of the stresses from axial strain and curvature of cables."""
        return CableStressLaw(batch, xi, places)


@final
class _CableIntegrals(ElementIntegrals):
    """Integrals A and m of cables: of unit moduli, times E A and rho A; and flexural stiffness."""

    def __init__(self, batch: Batch) -> None:
        self._batch, self._moduli, self._units = batch, _moduli(batch), _integrals()
        self.powers = _powers()
        self.values = self._times(self._moduli)

    def partial(self, which: ElementParameter) -> tuple[Array, ...]:
        """Return the derivatives of `values` in an element parameter, which changes only moduli."""
        moved, step = _moduli(self._batch.moved(which)), self._batch.step(which)
        return self._times(change(x, at, step) for x, at in zip(moved, self._moduli, strict=True))

    def _times(self, moduli: Iterable[Array]) -> tuple[Array, ...]:
        """Return the integrals for unit moduli times the modulus of each element."""
        pairs = zip(moduli, self._units, strict=True)
        return tuple(np.multiply.outer(modulus, unit) for modulus, unit in pairs)


def _moduli(batch: Batch) -> tuple[Array, Array, Array]:
    """Return E A, rho A and E I/lambda, shape (n,) each; in space I is the mean of I_y and I_z."""
    E, rho = batch.moduli[0], batch.of(ElementParameter.DENSITY)
    y, z, dA = batch.kind.section.points(batch.sizes, False)
    _, moments = central_moments(y, z, dA)
    area = dA.sum(axis=1)
    free = np.sqrt(1 - 2 * batch.of(ElementParameter.INITIAL_STRAIN))
    return E * area, rho * area, E / free * np.mean(moments[:, : batch.d - 1], axis=1)


def _shape(xi: Array) -> Array:
    """Return the shape functions s_a of elements of unit length at xi, shape (n_p, 4)."""
    s5, (p2, p6) = end_weight(xi), slope_weights(xi)
    return np.stack([1 - s5, p2, s5, p6], axis=-1)


@cache
def _powers() -> tuple[Array, Array, Array]:
    """Return the exponents of the length in each entry of A, m and the flexural stiffness."""
    of_g = _N_POWER[list(upper_triangle(3))].sum(axis=0)
    return of_g[:, None] + of_g + 1, _S_POWER[:, None] + _S_POWER + 1, _NO_POWER


@cache
def _integrals() -> tuple[Array, Array, Array]:
    """Return A and m at unit moduli and length; five Gauss points are exact (degrees 8 and 6)."""
    points, rule = box_rule((5,))
    xi = points[:, 0]
    s, N = _shape(xi), tangent_weights(xi)
    rows, columns = upper_triangle(3)
    twice = np.where(rows == columns, 1.0, 2.0)
    P = 0.5 * twice * N[:, rows] * N[:, columns]
    return (rule * P.T) @ P, (rule * s.T) @ s, np.ones(1)


CABLE_2D, CABLE_3D = Cable("CABLE_2D", 2), Cable("CABLE_3D", 3)
