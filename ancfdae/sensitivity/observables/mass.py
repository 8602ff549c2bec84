"""Observables of mass: mass, centre of mass, moments of inertia, momentum, of a body or the scene.

All are integrals of rho a b dV with a and b one of 1, a component of the position and one of the
velocity. With vectors X on which positions depend linearly, the mass matrix m (x) I_d gives them
all: int rho r_i r_j dV = sum_ab m_ab X_ai X_bj. Where a factor is one, X is 1 for positions and 0
for slopes in place of r.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.assembly.system import AncfSystem
from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import require_text, require_vector
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.observable import (
    Columns,
    Leaf,
    LeafGradient,
    Named,
    Observable,
    States,
    known_scene,
    require_index,
)
from ancfdae.sensitivity.observables.points import position


def mass(beam: str | None = None) -> Observable:
    """Return the mass of a beam, a body or a point mass, or of the whole scene; kg."""
    return MassIntegral(beam)


def centre_of_mass(axis: int, beam: str | None = None) -> Observable:
    """Return a component of the centre of mass of a beam or body, or of the whole scene; m."""
    require_index("centre_of_mass, axis", axis)
    return MassIntegral(beam, right=axis) / mass(beam)


def inertia(
    axis: int = 2,
    other: int | None = None,
    beam: str | None = None,
    about: MaterialPoint | Sequence[float] | None = None,
) -> Observable:
    """Return a moment or product of inertia of a beam or body, or of the whole scene; kg m^2.

    Parameters
    ----------
    axis : int
        2, the axis across the plane, in planar scenes.
    other : int, optional
        The second axis of a product of inertia, -int rho r_i r_j dV; without it the moment about
        `axis`. A planar body that is given by its moment counts as round.
    beam : str, optional
        Name of a beam, a body or a point mass.
    about : MaterialPoint or sequence of float, optional
        Reference point: a point of a body, which may move, or a fixed position, m; by default the
        centre of mass.
    """
    require_index("inertia, axis", axis)
    if other is not None:
        require_index("inertia, other", other)
    if other is not None and other != axis:
        return -_second(beam, axis, other, about)
    first, second = (i for i in range(3) if i != axis)
    return _second(beam, first, first, about) + _second(beam, second, second, about)


def linear_momentum(axis: int, beam: str | None = None) -> Observable:
    """Return a component of the momentum of a beam or body, or of the whole scene; kg m/s."""
    require_index("linear_momentum, axis", axis)
    return MassIntegral(beam, right=axis, rate=True)


def angular_momentum(axis: int = 2, beam: str | None = None) -> Observable:
    """Return a component of the angular momentum of a body or the scene about the origin; kg m^2/s.

    `beam` names a beam, a body or a point mass; None is the whole scene. In the plane `axis` is 2,
    z.
    """
    require_index("angular_momentum, axis", axis)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    turning = MassIntegral(beam, left=first, right=second, rate=True)
    return turning - MassIntegral(beam, left=second, right=first, rate=True)


def _second(
    beam: str | None, i: int, j: int, about: MaterialPoint | Sequence[float] | None
) -> Observable:
    """Return int rho (r_i - p_i) (r_j - p_j) dV; p is `about`, or the centre of mass for None."""
    whole, m = MassIntegral(beam, left=i, right=j), mass(beam)
    F_i, F_j = MassIntegral(beam, right=i), MassIntegral(beam, right=j)
    if about is None:
        return whole - F_i * F_j / m
    p_i, p_j = _place(about, i), _place(about, j)
    return whole - F_i * p_j - F_j * p_i + m * p_i * p_j


def _place(about: MaterialPoint | Sequence[float], axis: int) -> Observable | float:
    if isinstance(about, MaterialPoint):
        return position(about, axis)
    require_vector("inertia, about", about)
    # In the plane there is no third component; the observable rejects the axis later.
    return float(about[axis]) if axis < len(about) else 0.0


@final
@dataclass(frozen=True)
class MassIntegral(Leaf):
    """Integral of rho a b dV, each factor a component of the position r, or one for None.

    With `rate` the right factor b is a component of the velocity.
    """

    beam: str | None = None
    left: int | None = None
    right: int | None = None
    rate: bool = False

    def __post_init__(self) -> None:
        if self.beam is not None:
            require_text("mass, beam", self.beam)

    def check_leaf(self, system: Named) -> None:
        """Raise unless the scene has the beam and axes of this mass integral."""
        layout = known_scene(system).naming.layout
        if self.beam is not None:
            layout.owner(self.beam)
        for axis in (self.left, self.right):
            if axis is not None and axis >= layout.d:
                raise InvalidInputError(
                    "observable of mass",
                    "axes in the plane must be 0 or 1; moments are about axis 2",
                    axis,
                    "For example inertia(), about axis 2.",
                )

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the mass integral a^T M b at the states, shape (k,)."""
        scene = known_scene(system)
        a, b = self._factors(scene, states)
        value = np.sum(a * scene.energies.momenta(b, self.beam), axis=1)
        return np.broadcast_to(value, (len(states.t),))

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return M b and M a as partials in q or v, and a^T M_b b by polarisation."""
        scene = known_scene(system)
        a, b = self._factors(scene, states)
        parts, d = dict[str, Array](), scene.naming.layout.d
        for factor, other, name in (
            (self.left, b, "q"),
            (self.right, a, "v" if self.rate else "q"),
        ):
            if factor is not None:
                momenta = scene.energies.momenta(other, self.beam)
                along = _spread(momenta.reshape(len(momenta), -1, d)[..., 0], factor, d)
                parts[name] = parts[name] + along if name in parts else along
        rows = {name: Columns(slice(None), part) for name, part in parts.items()}
        both, first, second = (scene.energies.kinetic_b(x, self.beam) for x in (a + b, a, b))
        gradient = np.broadcast_to(both - first - second, (len(states.t), system.n_b))
        return LeafGradient(q=rows.get("q"), v=rows.get("v"), b=gradient)

    def _factors(self, scene: AncfSystem, states: States) -> tuple[Array, Array]:
        """Return both factors as coordinate vectors along the first axis, shape (k or 1, n_q)."""
        right = states.v if self.rate else states.q
        return self._factor(scene, states.q, self.left), self._factor(scene, right, self.right)

    def _factor(self, scene: AncfSystem, x: Array, axis: int | None) -> Array:
        d = scene.naming.layout.d
        one = axis is None
        component = scene.energies.places[None] if one else x.reshape(len(x), -1, d)[..., axis]
        return _spread(component, 0, d)


def _spread(component: Array, axis: int, d: int) -> Array:
    """Return vectors, (k, n_vectors d), whose component `axis` is `component`, (k, n_vectors)."""
    vectors = np.zeros((*component.shape, d), dtype=component.dtype)
    vectors[..., axis] = component
    return vectors.reshape(len(component), -1)
