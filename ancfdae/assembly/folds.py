"""Checks of elements: folded, too few, or strained beyond the validity of their laws.

Energies are polynomials of the coordinates, finite even if the body passes through itself, so that
equilibrium equations have solutions that no body can have. For an element, with F = (dr/dX) at a
point of its axis or of the outline of its section, such a solution has

    det F <= 0                        a section that is turned inside out,
    |r_x|^2 <= (1 - 2 eps_i)/3        an axis in compression beyond the largest force of the law,
    r_x . (r_2 - r_1) <= 0            a cable, without section, bent by more than half a circle.

N = E A lambda (lambda^2 - lambda_f^2)/2 of a stretch lambda, lambda_f the stretch of the axis free
of stress, is smallest at lambda^2 = lambda_f^2/3: a bar that is compressed farther yields to any
force.

The axis of an element is a cubic, which cannot bend without stretching: an axis that turns by phi
has a strain of phi^4/1920 at its middle, whatever its length, and one whose curvature varies along
the element has strains of the order of phi^2. The stretch r_x can cancel parts of them up to degree
two in xi; loads give a linear part. So the part eps_n of degrees three and four is an error of the
mesh. It contributes to E A eps^2/2, and it resists bending by moments m at the ends (membrane
locking): the derivatives of int E A eps_n^2/2 ds by the rotations theta of the end tangents. Ends
that are free of them would turn by K^-1 m more, K = E I/l [4, 2; 2, 4]. A cubic does not have the
curvature of an arc, either: the energy of bending errs by up to phi^4/180 (measured;
docs/theory/11-statics.md). The error of the stiffness is

    eta  = int E A eps_n^2 + E I kappa^2 phi^4/180 ds / U + loss/4,
    U    = int E I kappa^2 + E A (eps^2 - eps_n^2) ds,
    loss = (|theta m| + m K^-1 m) / (U + 2 |theta m| + m K^-1 m),

summed over the elements of a beam (and over states of a motion), kappa and theta relative to the
reference. In a beam without tension the first term is 1.2 (l/h)^2 (phi^3/1920)^2 + phi^4/180.
Both parts grow as phi^4, and phi with the load: at given loads the energy errs by about 5 eta, and
its derivative in the stiffness or in a load by up to 25 eta. The loss is the part of a deflection
that is missing, or 0.2 to 1 times it: strains of degree one and two resist bending, too.

Elements that are curved in the reference lock at small loads, too. Where they turn by phi_o there,
e = x^2/(1 + x^2), x = (l/r) phi_o^3/380 with the radius of gyration r of the section, is the part
of their deflection that is missing (fitted to quarter circles; docs/measurements.md). eta is e/5
at least, whatever the state.

The laws of beams and cables are linear in Green and Lagrange's strain E = (lambda^2 - 1)/2: where
Hooke's law in the stretch, e = lambda - 1, gives the force E A e, they give 1 + 3 e/2 times it. The
bending of beams errs by about the square of the strain of their outermost fibres, measured on half
a circle (docs/howto/elements.md); the bending of cables, M = E I dtheta/ds, does not.
"""

from __future__ import annotations

from typing import final

import numpy as np

from ancfdae.assembly.block import element_kinds, unit_vectors
from ancfdae.assembly.numbering import Numbering
from ancfdae.errors.text import listed
from ancfdae.kernels import keeps_sides
from ancfdae.model.bodies import BeamBody
from ancfdae.model.elements import ElementParameter, ElementType, Quantity
from ancfdae.model.elements.element import tangent_weights
from ancfdae.model.sections.section import central_moments
from ancfdae.numerics.arrays import Array

# Locations xi at which an element is checked, nodes included: the quantities checked are
# polynomials of degree four at most.
_PLACES = np.linspace(0.0, 1.0, 9)
_TANGENTS = tangent_weights(_PLACES)
# Largest number of elements of a beam that a message names.
_NAMED = 3
# Error of the stiffness above which elements are too few: values err by 2 %, derivatives by 10 %.
_SHARE = 0.004
# Parts of eta for 1 of the loss in bent states, and of the loss e of curved references.
_LOSS, _CURVED = 0.25, 0.2
# An element that turns by phi_o in the reference has x = (l/r) phi_o^3/_ARCH.
_ARCH = 380.0
# Error of the energy of bending of an element that turns by phi, over phi^4: the larger one, of
# beams (5.6e-3; of cables 2.8e-3).
_ARC = 1 / 180
# Further limits, fitted, not derived. If tension shapes the elements, with a mean N l^2/EI above
# _LIMP, as in limp cables, forces are right whatever eta, until one of the elements turns by more
# than _TURN, in rad: then they err by 20 % and more. Beams whose elements change their turn by less
# than _STRAIGHT, in rad, are not checked: round-off could make eta large.
_LIMP, _TURN, _STRAIGHT = 25.0, 0.5, 1e-8
# Largest strain of a fibre for which the laws are valid: in bending it changes a shape by 1 % and
# its gradient by 2.4 %; in stretching it changes a force by 15 %.
_STRAIN = 0.1
# Weights of Boole's rule on two intervals, orthonormal functions quadratic in xi, and the projector
# on the part of a strain, of degree four, that is not quadratic in xi.
_WEIGHTS = np.array([7, 32, 12, 32, 14, 32, 12, 32, 7]) / 180.0
_CENTRED = 2.0 * _PLACES - 1.0
_FREE = np.stack([np.ones(9), np.sqrt(3.0) * _CENTRED, np.sqrt(5.0) * (1.5 * _CENTRED**2 - 0.5)])
# The force between the ends of an element is the mean of E A eps r_x with weights 6 xi (1 - xi).
_CHORD = 6.0 * _PLACES * (1.0 - _PLACES) * _WEIGHTS
_BEYOND = np.eye(9) - _FREE.T @ (_FREE * _WEIGHTS)
# Bernstein's polynomials of degree two and one at the locations, (9, 3) and (9, 2); and the weights
# of products of coefficients of a tangent and of 1, 2 or 4 normals at them.
_QUADRATIC = np.stack([(1 - _PLACES) ** 2, 2 * _PLACES * (1 - _PLACES), _PLACES**2], axis=1)
_LINEAR = np.stack([1 - _PLACES, _PLACES], axis=1)
_NORMALS = np.ones((9, 1)), _LINEAR, np.einsum("pj,pk->pjk", _LINEAR, _LINEAR).reshape(9, 4)
_BERNSTEIN = {
    (n.shape[1], m.shape[1]): np.einsum("pi,pj->pij", n, m)
    for n in (np.ones((9, 1)), _QUADRATIC)
    for m in _NORMALS
}


@final
class Folds:
    """Checks of the flexible elements of a scene at given coordinates.

    `parameters`, shape (n, 10), are the parameters of these elements.
    """

    def __init__(self, beams: list[BeamBody], numbering: Numbering, parameters: Array) -> None:
        self._d, self._names = numbering.d, [beam.name for beam in beams]
        parameters = parameters.real
        layouts = {body.name: body for body in numbering.bodies}
        counts = [beam.element_count for beam in beams]
        self._first = np.cumsum([0, *counts])
        kinds, kind = element_kinds(beams)
        ends = [layouts[name].ends for name in self._names]
        units = [unit_vectors(beam) for beam in beams]
        of_kind = kind[self._first[:-1]]
        self._groups = []
        for k, (_, its_type) in enumerate(kinds):
            own = np.flatnonzero(of_kind == k)
            rows = np.flatnonzero(kind == k)
            its_ends, its_units = (np.concatenate([x[i] for i in own]) for x in (ends, units))
            numbers = np.array(counts)[own]
            alike = _Alike(its_type, its_ends, its_units, parameters[rows], numbers)
            self._groups.append((own, rows, alike))

    def words(self, q: Array) -> str:
        """Return a text naming the elements folded at coordinates q; empty if there are none."""
        Z = q.real.reshape(-1, self._d)
        folded = np.zeros(self._first[-1], dtype=bool)
        for _, rows, group in self._groups:
            folded[rows] = group.folded(Z)
        if not folded.any():
            return ""
        texts = []
        for name, own in zip(self._names, np.split(folded, self._first[1:-1]), strict=True):
            places = np.flatnonzero(own)
            if len(places):
                numbers = [*map(str, 1 + places[:_NAMED])]
                some = listed(numbers + ["others"] * (len(places) > _NAMED))
                texts.append(f"{name!r}, element{'s' if len(places) > 1 else ''} {some}")
        return "; ".join(texts)

    def coarse(self, states: Array, moving: bool) -> dict[str, float]:
        """Return eta, by name, of beams that have too few elements in states, rows of q.

        Cables are left out of states of a motion: inertia shapes a rope that falls, and not its
        bending.
        """
        values = np.zeros(len(self._names))
        groups = [each for each in self._groups if each[2].has_sections or not moving]
        for own, _, group in groups:
            rows = states.real.reshape(len(states), -1, self._d)
            error, work, yielded, rest = np.sum([group.parts(Z) for Z in rows], axis=0)
            bent = rest > 0
            rest = np.where(bent, rest, 1.0)
            loss = (work + yielded) / (rest + 2.0 * work + yielded)
            eta = bent * (error / rest + _LOSS * loss)
            values[own] = np.maximum(eta, _CURVED * group.curved())
        return self._above(_SHARE, values)

    def strained(self, q: Array) -> dict[str, float]:
        """Return the largest fibre strain, by name, of beams strained beyond the laws' validity."""
        values, Z = np.zeros(len(self._names)), q.real.reshape(-1, self._d)
        for own, _, group in self._groups:
            values[own] = group.strain(Z)
        return self._above(_STRAIN, values)

    def _above(self, limit: float, values: Array) -> dict[str, float]:
        """Return, by name, values of the beams, (n_beams,), that exceed `limit`."""
        return {self._names[k]: float(values[k]) for k in np.flatnonzero(values > limit)}


@final
class _Alike:
    """Checks of the elements of one type in some beams; vectors have shape (n, 2 n_s, d).

    `counts` are the numbers of elements of each beam, whose elements follow each other.
    """

    def __init__(
        self, kind: ElementType, ends: Array, units: Array, parameters: Array, counts: Array
    ) -> None:
        self._ends, self._counts, self._d = ends, counts, units.shape[2]
        self._first = np.cumsum(counts) - counts
        n_s = ends.shape[1] // 2
        self._lengths = parameters[:, ElementParameter.LENGTH, None]
        self._free = 1.0 - 2.0 * parameters[:, ElementParameter.INITIAL_STRAIN, None]
        self.has_sections = n_s == self._d + 1
        y, z = kind.section.outline(kind.sizes(parameters))
        # Distance of the outermost fibres from the axis; zero for cables.
        reach = [np.max(np.abs(x), axis=1) * self.has_sections for x in (y, z)]
        self._reach = np.stack(reach[: max(1, n_s - 2)], axis=1)
        self._offsets = (y, z)[: self._d - 1]
        # Node vectors of the reference, whose chord is given per unit length.
        start = np.zeros_like(units[:, :1])
        chord = self._lengths[..., None] * units[:, :1]
        X = np.concatenate([start, units[:, 1:n_s], chord, units[:, n_s:]], axis=1)
        if self.has_sections:
            slopes = X.reshape(-1, 2, self._d + 1, self._d)[:, :, 1:]
            self._upright = np.sign(np.linalg.det(slopes))
        self._stretch_o = self._stretch(self._tangents(X))
        # Elements with equal parameters have the same section: most beams have one.
        rows, same = np.unique(parameters, axis=0, return_inverse=True)
        y, z, dA = kind.section.points(kind.sizes(rows), False)
        _, moments = central_moments(y, z, dA)
        # E A, and E I about the axes across which slopes are nodal vectors, or the first.
        modulus = rows[:, ElementParameter.YOUNGS_MODULUS, None]
        self._EA = (modulus * np.sum(dA, axis=1, keepdims=True))[same.ravel()]
        self._EI = (modulus * moments[:, : max(1, n_s - 2)])[same.ravel()]
        self._turns_o = self._turns(X)

    def _largest(self, x: Array) -> Array:
        """Return the largest entry for each beam, (n_beams,), of element values, (n, k)."""
        return np.asarray(np.maximum.reduceat(x.max(axis=1), self._first))

    def folded(self, Z: Array) -> Array:
        """Return whether each element is folded, shape (n,)."""
        X = Z[self._ends]
        r_x = self._tangents(X)
        crushed = 3.0 * self._stretch(r_x) <= self._free * self._stretch_o
        if self.has_sections:
            # In the reference the determinants have one sign along an element.
            turned = self._volumes(X, r_x) <= 0
        else:
            chord = X[:, len(X[0]) // 2] - X[:, 0]
            turned = (r_x @ chord[:, :, None])[..., 0] <= 0
        return np.asarray((crushed | turned).any(axis=1))

    def parts(self, Z: Array) -> Array:
        """Return terms of eta (module docstring) of each beam, (4, n_beams); N m.

        Sums of int E A eps_n^2 + E I kappa^2 phi^4/180 ds, of theta m, of m K^-1 m, and U; zeros
        for beams that tension shapes, and for those that are not bent.
        """
        X = Z[self._ends]
        r_x = self._tangents(X)
        strain = 0.5 * (self._stretch(r_x) / self._stretch_o - self._free)
        beyond = strain @ _BEYOND.T
        axial, error = (
            self._EA * self._lengths * (x**2 @ _WEIGHTS)[:, None] for x in (strain, beyond)
        )
        # The bending of the reference is free of stress and rotates with the element.
        turns = self._turns(X) - self._turns_o
        square = _square(turns)
        bending = self._EI / self._lengths * square
        moments = self._moments(X, r_x, beyond)
        a, b = moments
        chord = _unit(_WEIGHTS @ r_x)
        force = np.einsum("np,npd,nd->n", strain * _CHORD, r_x, chord)[:, None]
        # The change of an element is its turn.
        arcs = error[:, 0] + _ARC * (bending * square**2).sum(axis=1)
        work = np.abs((turns * moments).sum(axis=(0, 2)))
        yielded = (self._lengths / (3.0 * self._EI) * (a * a - a * b + b * b)).sum(axis=1)
        rest = (axial - error)[:, 0] + bending.sum(axis=1)
        pulled = np.maximum(force, 0.0) * self._EA * self._lengths**2 / self._EI
        terms = [arcs, work, yielded, rest, pulled.sum(axis=1)]
        *found, pulled = np.add.reduceat(terms, self._first, axis=1)
        ignored = pulled > _LIMP * self._counts * self._EI.shape[1]
        if ignored.any():
            ends = [_unit(X[:, k + Quantity.SLOPE_X]) for k in (0, X.shape[1] // 2)]
            # |t_2 - t_1| = 2 sin(phi/2).
            turn = self._largest(np.sqrt(np.sum((ends[1] - ends[0]) ** 2, axis=1))[:, None])
            ignored &= turn <= 2.0 * np.sin(0.5 * _TURN)
        ignored |= self._largest(square) <= _STRAIGHT**2
        return np.where(ignored, 0.0, np.stack(found))

    def curved(self) -> Array:
        """Return the part e of the deflection that curved beams lack when unloaded, (n_beams,)."""
        bent = _square(self._turns_o)
        thin = (bent * self._EA / self._EI).sum(axis=1) * self._lengths[:, 0] ** 2
        x = thin * bent.sum(axis=1) ** 2 / _ARCH**2
        return np.asarray(np.add.reduceat(x / (1.0 + x), self._first) / self._counts)

    def strain(self, Z: Array) -> Array:
        """Return the largest strain of a fibre in each beam, shape (n_beams,)."""
        X = Z[self._ends]
        stretch = self._stretch(self._tangents(X)) / self._stretch_o
        axial = 0.5 * self._largest(np.abs(stretch - self._free))
        if not self.has_sections:
            return axial
        change = np.sqrt(_square(self._turns(X) - self._turns_o))
        return np.maximum(axial, self._largest(change / self._lengths * self._reach))

    def _across(self, X: Array, vectors: Array) -> Array:
        """Return components of vectors of both ends, (2, n, d), across the axis, (2, n, k).

        The axes of beams are their section slopes; cables, without sections, keep the vectors.
        """
        if not self.has_sections:
            return vectors
        n_s = X.shape[1] // 2
        sections = X.reshape(len(X), 2, n_s, -1)[:, :, Quantity.SLOPE_Y :].swapaxes(0, 1)
        return np.asarray(np.einsum("enkd,end->enk", _unit(sections), vectors))

    def _turns(self, X: Array) -> Array:
        """Return rotations of both end tangents from the chord about each axis, (2, n, k); rad."""
        n_s = X.shape[1] // 2
        chord = _unit(X[:, n_s] - X[:, 0])
        ends = [_unit(X[:, k + Quantity.SLOPE_X]) - chord for k in (0, n_s)]
        return self._across(X, np.stack(ends))

    def _moments(self, X: Array, r_x: Array, beyond: Array) -> Array:
        """Return moments at both ends of the strains `beyond`, (n, n_p), shape (2, n, k); N m."""
        pressed = beyond / self._stretch_o * _WEIGHTS * self._EA * self._lengths
        force = np.einsum("pe,np,npd->end", _TANGENTS[:, 1:], pressed, r_x)
        tangent = X[:, [Quantity.SLOPE_X, X.shape[1] // 2 + Quantity.SLOPE_X]].swapaxes(0, 1)
        along = _unit(tangent)
        across = force - np.sum(force * along, axis=2, keepdims=True) * along
        return self._across(X, across * np.sqrt(np.sum(tangent**2, axis=2, keepdims=True)))

    def _tangents(self, X: Array) -> Array:
        """Return the tangents r_x of elements at locations on the axis, shape (n, n_p, d)."""
        n_s = X.shape[1] // 2
        parts = np.empty((len(X), 3, X.shape[2]))
        np.subtract(X[:, n_s], X[:, 0], out=parts[:, 0])
        parts[:, 0] /= self._lengths
        parts[:, 1:] = X[:, [Quantity.SLOPE_X, n_s + Quantity.SLOPE_X]]
        return np.asarray(_TANGENTS @ parts)

    @staticmethod
    def _stretch(r_x: Array) -> Array:
        """Return |r_x|^2 of elements at locations on the axis, shape (n, n_p)."""
        return np.asarray(np.einsum("npd,npd->np", r_x, r_x))

    def _volumes(self, X: Array, r_x: Array) -> Array:
        """Return the smallest det [r_x, r_y(, r_z)] over axis and outline, shape (n, n_p).

        With the normal N = r_y x r_z of the section, in the plane r_y rotated back by a right
        angle, it is (r_x + y r_xy + z r_xz) . N, linear in y and z.
        """
        n_s = X.shape[1] // 2
        first, second = X[:, Quantity.SLOPE_Y : n_s], X[:, n_s + Quantity.SLOPE_Y :]
        along = _PLACES[:, None]
        across = [
            (1 - along) * a[:, None] + along * b[:, None]
            for a, b in zip(first.swapaxes(0, 1), second.swapaxes(0, 1), strict=True)
        ]
        if self._d == 2:
            normal = np.stack([across[0][..., 1], -across[0][..., 0]], axis=-1)
        else:
            normal = np.cross(*across)
        normal *= self._upright[:, :1, None]
        volume = np.einsum("npd,npd->np", r_x, normal)
        change = (second - first) / self._lengths[..., None]
        # Shape (n, n_p, 1 or 2), and of the outline (n, n_f, n_p).
        rates = normal @ change.swapaxes(1, 2)
        rest = sum(y[:, :, None] * rates[:, None, :, k] for k, y in enumerate(self._offsets))
        return np.asarray(volume + np.minimum(np.min(rest, axis=1), 0.0))


def first_mirrored(
    numbering: Numbering, ends: Array, parameters: Array | None, q: Array
) -> tuple[int, str] | None:
    """Return the index of the first mirrored, folded or crushed state, and a message; or None.

    `ends` are node vectors of elements, rows of `Numbering.vectors` with their `parameters`, or of
    rigid bodies, rows of `Numbering.frames` without; q has the shape (k, n_q). An axis is crushed
    at a node or in the middle of an element (module docstring). Along the axis r_x is quadratic in
    xi and section slopes are linear: det [r_x, r_y(, r_z)] has no root if all products of their
    Bernstein coefficients have one sign, nor has r_x . (r_2 - r_1) of a cable. Only if signs differ
    are locations along the element evaluated. Defects of the first state are not counted.
    """
    d, n_s = numbering.d, numbering.widest.n_s
    if parameters is not None and n_s not in (2, d + 1):
        return None
    lengths = limit = None
    if parameters is not None:
        lengths = np.ascontiguousarray(parameters[:, ElementParameter.LENGTH])
        limit = (1.0 - 2.0 * parameters[:, ElementParameter.INITIAL_STRAIN]) / 3.0
    if keeps_sides(q, ends, d, lengths, limit):
        return None
    # Components first, states last.
    X = np.ascontiguousarray(q.reshape(len(q), -1, d)[:, ends].transpose(3, 2, 1, 0))
    # Elements with fewer vectors than the widest repeat their first vector.
    cables, looked_at = np.zeros(len(ends), dtype=bool), ends[:, 1] != ends[:, 0]
    crushed = np.zeros(X.shape[2:], dtype=bool)
    if lengths is None or limit is None:
        tangents, sections = X[:, 1:2], X[:, None, 2:]
    else:
        chord = (X[:, n_s] - X[:, 0]) / lengths[:, None]
        along, after = X[:, 1], X[:, n_s + 1]
        tangents = np.stack([along, 3.0 * chord - along - after, after], axis=1)
        sections = X.reshape(d, 2, n_s, *X.shape[2:])[:, :, 2:]
        cables |= (n_s == 2) | (ends[:, min(2, n_s)] == ends[:, 0])
        places = along, 1.5 * chord - 0.25 * (along + after), after
        crushed = np.any([np.sum(r_x * r_x, axis=0) <= limit[:, None] for r_x in places], axis=0)
        crushed &= ~crushed[:, :1] & looked_at[:, None]
    if np.all(cables):
        normals = chord[:, None]
    elif d == 2:
        normals = np.stack([sections[1, :, 0], -sections[0, :, 0]])
    else:
        (a, b, c), (u, v, w) = sections[:, :, None, 0], sections[:, None, :, 1]
        normals = np.stack([b * w - c * v, c * u - a * w, a * v - b * u])
        normals = normals.reshape(3, -1, *normals.shape[3:])
    if np.any(cables) and not np.all(cables):
        normals[:, :, cables] = chord[:, None, cables]
    sides = sum(t[:, None] * n for t, n in zip(tangents, normals, strict=True))
    sides *= np.where(cables[:, None], 1.0, np.sign(sides[0, 0, :, :1]))
    suspects = np.flatnonzero(~(np.min(sides, axis=(0, 1, 3)) > 0) & looked_at)
    if not len(suspects) and not np.any(crushed):
        return None
    # Values that are not numbers do not count as mirrored: other checks find them.
    weights = _BERNSTEIN[tangents.shape[1], normals.shape[1]]
    folded = np.any(np.tensordot(weights, sides[:, :, suspects], 2) <= 0, axis=0)
    turned = np.zeros_like(crushed)
    turned[suspects] = folded & ~folded[:, :1]
    if not np.any(turned | crushed):
        return None
    first = int(np.argmax(np.any(turned | crushed, axis=0)))
    is_crushed = not np.any(turned[:, first])
    which = int(np.argmax((crushed if is_crushed else turned)[:, first]))
    return first, _turning(numbering, ends[which, 0], bool(cables[which]), is_crushed)


def _turning(numbering: Numbering, vector: int, is_cable: bool, is_crushed: bool) -> str:
    """Return a message on the body or element that begins with a vector: folded or crushed."""
    name = [body.name for body in numbering.bodies if body.first_vector <= vector][-1]
    if is_crushed:
        return (
            f"crushes an element of {name!r} beyond the largest force of its law (a stretch of "
            "0.58): the load is more than the element bears, or the step too long for its waves. "
            "Take a stiffer section or a smaller load, or shorter steps"
        )
    if is_cable:
        return (
            f"turns an element of {name!r} back on itself (its tangent turns against its chord): "
            "the mesh is too coarse for the motion, or the step too long. Take more elements, "
            "shorter steps, or a cable that is less slack"
        )
    return (
        f"turns sections of {name!r} inside out (det [r_x r_y r_z] changes its sign), where the "
        "strain energy is finite: the step is too long for the waves of the section, or the waves "
        "are larger than its law bears. Take shorter steps; where they fold too, give materials a "
        "damping_time, start with sections that have the contraction of their axis, or take more "
        "elements"
    )


def _square(turns: Array) -> Array:
    """Return the integral of kappa^2 ds times the length about each axis, shape (n, k).

    The curvature is linear between rotations a and b of both ends: 4 (a^2 + a b + b^2).
    """
    a, b = turns
    return np.asarray(4.0 * (a * a + a * b + b * b))


def _unit(x: Array) -> Array:
    length = np.sqrt(np.sum(x * x, axis=-1, keepdims=True))
    return np.asarray(x / np.where(length > 0, length, 1.0))
