"""Where a continuum beam's energy is integrated: fibres of the section times points along the axis.

Lengths are divided by the element length l, and the chord r_2 - r_1 with them (`strain_fields`), so
that the length enters through the fibres only.
"""

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import final

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.elements.element import Batch, ElementParameter, Quantity
from ancfdae.model.elements.fibre_strains import Fibres, Frames
from ancfdae.model.elements.hermite import shape_weights
from ancfdae.model.elements.strain_fields import section_strains, turn_count, turn_stiffness
from ancfdae.model.sections.section import central_moments
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.quadrature import box_rule

# Poisson's effect on the axis couples stretch, quadratic in xi, with thickness strains, linear in
# xi: two points ask it where both can follow.
AXIS_POINTS = 2
# Share of the compliance in shear between the chord of an element and the tangents of its nodes.
_SHARE = 0.01


def fibres(batch: Batch) -> Fibres:
    """Return the quadrature points of the sections of elements, as fibres along them."""
    l, kind, sizes = batch.lengths, batch.kind, batch.sizes
    y, z, dA = kind.section.points(sizes, not kind.straight)
    centroid, moments = central_moments(y, z, dA)
    polar = moments.sum(axis=1)
    factors = np.ones((len(l), 3), dtype=batch.parameters.dtype)
    if kind.energy is not None and kind.energy.corrected:
        k_y, k_z, J = kind.section.properties(sizes, batch.moduli[1])
        factors = np.sqrt(np.stack([k_y, k_z, J / polar], axis=1))
    twist = factors[:, 2] ** 2 * polar
    squares = np.column_stack([moments, twist]) / np.sum(dA, axis=1)[:, None]
    shear_centre = kind.section.twist_centre(sizes, centroid)
    radii = np.sqrt(squares) / l[:, None]
    factors = _shared(batch, factors, radii)
    places = (x / l[:, None, None] for x in (np.stack([y, z], axis=-1), centroid, shear_centre))
    offsets, centroid, shear_centre = places
    ratio = radii[:, :2] ** 2
    fade = 1 / (1 + ratio**2)
    sizes_of_terms = radii, 1.5 * ratio * fade, fade
    return Fibres(offsets, dA * l[:, None], factors, *sizes_of_terms, centroid, shear_centre)


def _shared(batch: Batch, factors: Array, radii: Array) -> Array:
    """Return the factors of shears, which leave a share to waves, of twist and of waves."""
    waves = np.ones((len(factors), 2), dtype=factors.dtype)
    if batch.kind.energy is not None and batch.kind.energy.assumed_strains:
        nu = batch.moduli[1]
        C = batch.energy.stiffness(batch.d, np.ones_like(nu), nu)[0]
        ratio = (C[:, 0, 0] / C[:, -1, -1])[:, None] * (radii / factors)[:, :2] ** 2
        waves = 1 / np.sqrt(1 + 12 * _SHARE * ratio)
        factors = factors / np.sqrt([1 - _SHARE, 1 - _SHARE, 1.0])
    return np.concatenate([factors, waves], axis=1)


def fibres_partial(batch: Batch, which: ElementParameter) -> Fibres:
    """Return the derivative of `fibres` in a parameter."""
    at, moved, step = fibres(batch), fibres(batch.moved(which)), batch.step(which)
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
    """Strains of sections, and what they cost, at the places where an energy is integrated.

    These are places xi along the axis with their weights, (n_xi,) each. `beta`, (n_xi, n_s, n_g),
    are strains of the section in the Gram matrix of the scaled node vectors; `R`, (n, n_xi or 1,
    n_f, n_v, n_s), those at the fibres in these, one for all places of straight elements; `volume`
    is (n, n_xi or 1, n_f). InvalidInputError names the owner of an element, (n,), whose reference
    configuration folds (det dr_o/dx <= 0 somewhere).
    """

    def __init__(
        self, batch: Batch, fibres: Fibres, along: tuple[Array, Array], owners: Array
    ) -> None:
        self._xi, self.rule = along
        self._d, self._fibres = batch.d, fibres
        assumed = batch.energy.assumed_strains
        self._turns = turn_count(batch.d) if assumed else 0
        self.beta = section_strains(batch.d, tuple(self._xi.tolist()), assumed)
        straight = batch.kind.straight
        self._frames = Frames.straight(batch.d) if straight else Frames.of(batch.Y_unit, self._xi)
        self.R, self.volume = self._strains(fibres), self._measure(fibres)
        if not straight:
            _refuse_folds(self._frames.stretch(fibres.offsets), owners)

    def stiffness(self, C: Array) -> Array:
        """Return the integral of R^T C R over the sections, shape (n, n_xi or 1, n_s, n_s)."""
        return self._integral(self.R, C, self.volume, self.R)

    def stiffness_partial(self, C: Array, fibres_b: Fibres) -> Array:
        """Return the derivative of `stiffness` along that of the fibres."""
        R_b, volume_b = (self._along(of, fibres_b) for of in (self._strains, self._measure))
        cross = self._integral(R_b, C, self.volume, self.R)
        return cross + cross.swapaxes(-1, -2) + self._integral(self.R, C, volume_b, self.R)

    def total(self, K: Array) -> Array:
        """Return the sum of beta^T K beta along the axis, shape (n, n_g, n_g)."""
        right = self.rule[:, None, None] * (K @ self.beta)
        n_g = self.beta.shape[-1]
        return np.asarray(self.beta.reshape(-1, n_g).T @ right.reshape(len(K), -1, n_g))

    def true_strains(self, twist: Array | None) -> Array:
        """Return `R` with the shears of the material; `twist` as in `Frames.strains`."""
        return self._frames.strains(self._fibres, self._turns, 2, twist)

    def mass(self, rho: Array) -> Array:
        """Return the integral of rho s s^T (eq. 10), shape (n, n_a, n_a)."""
        s = self._shape(self._fibres.offsets)
        return _product(rho, self._points(self.volume), s, s)

    def mass_partial(self, rho: Array, fibres_b: Fibres) -> Array:
        """Return the derivative of `mass` along that of the fibres."""
        offsets, offsets_b = self._fibres.offsets, fibres_b.offsets
        s, s_b = self._shape(offsets), along(self._shape, (offsets,), (offsets_b,))
        volume_b = self._along(self._measure, fibres_b)
        cross = _product(rho, self._points(self.volume), s_b, s)
        return cross + cross.swapaxes(-1, -2) + _product(rho, self._points(volume_b), s, s)

    def _strains(self, fibres: Fibres) -> Array:
        return self._frames.strains(fibres, self._turns, 1)

    def _measure(self, fibres: Fibres) -> Array:
        j = self._frames.stretch(fibres.offsets) * self._frames.det[..., None]
        return np.asarray(fibres.volume[:, None] * j)

    def _along(self, function: Callable[[Fibres], Array], fibres_b: Fibres) -> Array:
        names = [each.name for each in fields(Fibres)]
        parts = [[getattr(x, name) for name in names] for x in (self._fibres, fibres_b)]
        return along(lambda *moved: function(Fibres(*moved)), *parts)

    def _integral(self, R_1: Array, C: Array, volume: Array, R_2: Array) -> Array:
        weighted = volume[..., None, None] * (C[:, None, None] @ R_2)
        left, right = (x.reshape(*x.shape[:2], -1, x.shape[-1]) for x in (R_1, weighted))
        return np.asarray(left.swapaxes(-1, -2) @ right)

    def _shape(self, offsets: Array) -> Array:
        """Scaled shape functions, shape (n, n_xi, n_f, n_a)."""
        y, z = np.moveaxis(offsets[:, None], -1, 0)
        weights = shape_weights(self._d, Quantity.POSITION, self._xi[:, None], y, z)
        return weights

    def _points(self, volume: Array) -> Array:
        """Volume of points, shape (n, n_xi, n_f)."""
        return np.asarray(self.rule[:, None] * volume)


def _product(rho: Array, dV: Array, s_1: Array, s_2: Array) -> Array:
    weighted = (rho[:, None, None] * dV)[..., None] * s_2
    left, right = (s.reshape(len(s), -1, s.shape[-1]) for s in (s_1, weighted))
    return np.asarray(left.swapaxes(-1, -2) @ right)


def section_stiffness(batch: Batch) -> tuple[Array, ...]:
    """C of strains and turns, in the volume and where there is such a part on the axis."""
    C = batch.stiffness
    if not batch.energy.assumed_strains:
        return C
    turns = turn_stiffness(batch.d, *batch.moduli, batch.kind.straight)
    return tuple(_with_diagonal(x, turns * k) for x, k in zip(C, (1.0, 0.0), strict=False))


def _with_diagonal(C: Array, more: Array) -> Array:
    """Add rows and columns with a diagonal, shape (n, n_more), to C."""
    n_v, size = C.shape[1], C.shape[1] + more.shape[1]
    whole = np.zeros((len(C), size, size), dtype=C.dtype)
    whole[:, :n_v, :n_v] = C
    rows = np.arange(n_v, size)
    whole[:, rows, rows] = more
    return whole


def _refuse_folds(stretch: Array, owners: Array) -> None:
    worst = np.min(stretch.real, axis=(1, 2))
    if not np.all(worst > 0):
        k = int(np.argmin(worst))
        raise InvalidInputError(
            str(owners[k]),
            "dr_o/dx of the reference configuration must have a positive determinant everywhere",
            f"{float(worst[k]):.3g} at the worst point",
            "Use right-handed node frames, more elements along the curve or a thinner section.",
        )
