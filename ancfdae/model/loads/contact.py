"""Contact with obstacles as a load: a point or sphere of a body, or the line of a beam."""

import abc
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.errors.checks import (
    require_count,
    require_finite,
    require_not_negative,
    require_positive,
    require_together,
)
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint, Quantity
from ancfdae.model.loads.contact_law import (
    damping_of,
    friction_force,
    moving_with,
    normal_force,
    on_body,
    require_restitution,
    split_velocity,
)
from ancfdae.model.loads.load import LAW_FIELD, Copies, Load
from ancfdae.model.loads.obstacles import Carrier, Obstacle, require_obstacle
from ancfdae.model.parts import Elements, LineVector, Vectors
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.time_grid import box_rule
from ancfdae.numerics.vector_formulas import concatenate, dot, positive


def longest(M: Array) -> Array:
    """Return the largest norms of movements M, (m, ..., n, d), over m, shape (..., n, 1)."""
    return np.asarray(np.sqrt((M * M).sum(axis=-1, keepdims=True).max(axis=0)))


#: Design fields of the contact force, in the order of the argument `p` of `ContactLoad.pressed`.
FORCE_FIELDS = (
    ("stiffness", require_positive),
    ("radius", require_not_negative),
    ("restitution", require_restitution),
    ("impact_speed", require_positive),
    ("friction", require_not_negative),
    ("slip_speed", require_positive),
)


@dataclass(frozen=True)
class ContactLoad(Load, abc.ABC):
    """Base class of contact loads: Hunt and Crossley's normal force, regularised friction."""

    stiffness: float = field(kw_only=True)
    radius: float | None = field(default=None, kw_only=True)
    exponent: float = field(default=1.5, kw_only=True)
    restitution: float | None = field(default=None, kw_only=True)
    impact_speed: float | None = field(default=None, kw_only=True)
    friction: float | None = field(default=None, kw_only=True)
    slip_speed: float | None = field(default=None, kw_only=True)

    kind = "contact"
    elastic = True
    touches = True
    damping_fields: ClassVar[tuple[str, ...]] = ("restitution", "friction")

    def __post_init__(self) -> None:
        super().__post_init__()
        where = f"load {self.name!r}"
        require_finite(f"{where}, exponent", self.exponent)
        if self.exponent < 1:
            rule, repair = "must be 1 or more", "Use 1 for a linear force, 1.5 for Hertz's."
            raise InvalidInputError(f"{where}, exponent", rule, self.exponent, repair)
        for names in (("restitution", "impact_speed"), ("friction", "slip_speed")):
            require_together(where, {name: getattr(self, name) for name in names})

    def turning(self, point: MaterialPoint, elements: Elements) -> tuple[Quantity, ...]:
        """Return the slopes that rotate with a body, needed where friction acts at a radius.

        They are the section slopes of a beam, or all directions of a rigid body; none for a cable,
        which has no section.
        """
        quantities = tuple(Quantity)[1 : elements.d + 1]
        if self.friction is None or self.radius is None:
            return ()
        if point.fraction is None:
            return quantities
        return tuple(x for x in quantities[1:] if x in elements.at(point).quantities)

    @abc.abstractmethod
    def depth(self, U: Array, signals: Array, p: Array, U_o: Array) -> Array:
        """Return the penetration depth, (..., 1, 1), m, negative where surfaces are apart.

        The arguments are as in `force_at`. There is no force where the depth is negative.
        """

    @abc.abstractmethod
    def closing(self, U: Array, M: Array, signals: Array, p: Array, U_o: Array) -> Array:
        """Return an upper bound of the change of `depth` along a path from U, (..., 1, 1); m.

        M, (m, ..., n_vectors, d), are movements: along the path the rates of the vectors lie
        between them.
        """

    def pressed(self, p: Sequence[Any], depth: Any, n: Any, w: Any) -> Any:
        """Return the force on the first body from depth, normal n and relative velocity w; N.

        p holds the values of `FORCE_FIELDS`.
        """
        stiffness, _, restitution, impact_speed, friction, slip_speed = p
        w_n, w_t = split_velocity(w, n)
        chi = None if restitution is None else damping_of(restitution, impact_speed)
        N = normal_force(depth, w_n, stiffness, self.exponent, chi)
        if friction is None:
            return N * n
        return N * n + friction_force(N, w_t, friction, slip_speed)


class ObstacleContact(ContactLoad, abc.ABC):
    """Base class of contact of points with an obstacle on the ground or on a rigid body."""

    obstacle: Obstacle
    other: MaterialPoint | None

    design_fields = (("obstacle", require_obstacle), *FORCE_FIELDS, LAW_FIELD)

    @property
    def refers(self) -> bool:  # type: ignore[override]  # only what is carried has a reference
        """Whether the force depends on the reference configuration: with a carrying body."""
        return self.other is not None

    def numbers_of(self, name: str) -> dict[str, float]:
        """Return the numbers of a design field; of the obstacle as ``obstacle_place_x`` ..."""
        numbers = super().numbers_of(name)
        if name != "obstacle":
            return numbers
        return {f"obstacle_{inner}": number for inner, number in numbers.items()}

    def check_space(self, elements: Elements) -> None:
        """Raise InvalidInputError unless the load and its obstacle fit the dimension of space."""
        super().check_space(elements)
        self.obstacle.check_space(f"load {self.name!r}, obstacle", elements.d)

    def _check_ends(self, where: str, given: dict[str, Any]) -> None:
        super()._check_ends(where, given)
        if self.other is not None and self.other.fraction is not None:
            rule = "must be a point of a rigid body, which carries the obstacle"
            repair = "Give a point of a RigidBody, or leave it out for an obstacle on the ground."
            raise InvalidInputError(f"{where}, other", rule, str(self.other), repair)

    def carrier_vectors(self, d: int) -> Vectors:
        """Return origin and directions of the body that carries the obstacle; none on ground."""
        if self.other is None:
            return ()
        return tuple((self.other, quantity) for quantity in tuple(Quantity)[: d + 1])

    def _own(self, U_o: Array) -> int:
        """Return the number of vectors of the first body; vectors of the obstacle's body follow."""
        return len(U_o) - (0 if self.other is None else U_o.shape[1] + 1)

    def _apart(self, U: Any, p: Array, U_o: Array) -> tuple[Any, Any]:
        """Return the penetration depth, negative where surfaces are apart, and the normal."""
        own, values = self._own(U_o), self.split(p)
        at, rows = U[..., own:, :], U_o[own:]
        carrier = Carrier(at[..., :1, :], at[..., 1:, :], rows[:1], rows[1:])
        distance, n = self.obstacle.surface(U[..., :1, :], carrier, values[0])
        return (0.0 if values[2] is None else values[2]) - distance, n

    def depth(self, U: Array, signals: Array, p: Array, U_o: Array) -> Array:
        """Return the penetration depth of the point or sphere, shape (..., 1, 1); m."""
        return np.asarray(self._apart(U, p, U_o)[0])

    def closing(self, U: Array, M: Array, signals: Array, p: Array, U_o: Array) -> Array:
        """Return an upper bound of the path of the point in axes of the carrier, (..., 1, 1); m."""
        if self.other is None:
            return longest(M[..., :1, :])
        own = self._own(U_o)
        o = slice(own, own + 1)
        way, arm = longest(M[..., :1, :] - M[..., o, :]), U[..., :1, :] - U[..., o, :]
        turn = np.sqrt((longest(M[..., own + 1 :, :]) ** 2).sum(axis=-2, keepdims=True))
        return np.asarray(way + (np.sqrt(dot(arm, arm)) + way) * turn)

    def gates(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> tuple[Any, ...]:
        """Return max(depth, 0), a factor with which the contact force vanishes."""
        return (positive(self._apart(U, p, U_o)[0]),)

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return N n + T on the first body, at its surface, and the opposite on the carrier; N."""
        (depth, n), own = self._apart(U, p, U_o), self._own(U_o)
        depth = positive(depth)
        _, *values, _ = self.split(p)
        arm = (0.0 if values[1] is None else -values[1]) * n
        parts, w = moving_with(U[..., :own, :], V[..., :own, :], arm)
        if self.other is None:
            return on_body(self.pressed(values, depth, n, w), parts)
        reach = U[..., :1, :] + arm - U[..., own : own + 1, :]
        others, along = moving_with(U[..., own:, :], V[..., own:, :], reach)
        F = self.pressed(values, depth, n, w - along)
        return concatenate([on_body(F, parts), on_body(-F, others)])


@final
@dataclass(frozen=True)
class Contact(ObstacleContact):
    """Contact of a point, or of a sphere around it, with a plane, a sphere or a cylinder.

    With the depth d, the normal n and the velocity w of the surface of the sphere relative to the
    obstacle: N = k d^m (1 - chi w_n), never negative, along n, and friction
    -mu N w_t / (|w_t|^4 + w_s^4)^(1/4). chi follows from the restitution e of a free impact at the
    speed v (docs/theory/19-contact.md). With a radius, friction also exerts a moment on the body.
    There is no sticking: below w_s a tangential force makes the body creep. Steps must resolve the
    contact. Design targets: ``stiffness``, ``radius``, ``restitution``, ``impact_speed``,
    ``friction``, ``slip_speed``, and ``obstacle_place_x`` ..., ``obstacle_normal_x`` ... of the
    obstacle.

    Parameters
    ----------
    point : MaterialPoint
        Centre of the sphere.
    obstacle : Plane, Sphere or Cylinder
    stiffness : float
        k, positive; N/m^m.
    radius : float, optional
        Radius of the sphere; m. By default a point touches.
    exponent : float, optional
        m, from 1 on; 1.5 by default, as Hertz found. The force of 1 has a kink where contact
        begins.
    restitution : float, optional
        e, between 0.05 and 1; undamped by default.
    impact_speed : float, optional
        v, positive, at which an impact has this restitution; m/s.
    friction : float, optional
        mu; without friction by default.
    slip_speed : float, optional
        w_s, positive; m/s.
    other : MaterialPoint, optional
        Point of the rigid body that carries the obstacle; the ground by default. The obstacle is
        declared at its position in the reference configuration.
    """

    point: MaterialPoint
    obstacle: Obstacle
    other: MaterialPoint | None = field(default=None, kw_only=True)

    def vectors(self, elements: Elements) -> Vectors:
        """Return position and slopes of the point, and the vectors of the carrier."""
        own = (Quantity.POSITION, *self.turning(self.point, elements))
        return (*((self.point, x) for x in own), *self.carrier_vectors(elements.d))


@final
@dataclass(frozen=True)
class BeamContact(ObstacleContact):
    """Contact of a beam or cable, a centre line with a radius, with a plane, sphere or cylinder.

    The force per unit of reference length follows the law of `Contact` for this radius; it acts
    at Gauss points along every element, so that it does not depend on the mesh. On beams friction
    also exerts a moment on sections; on cables it acts on the centre line. Design targets as in
    `Contact`.

    Parameters
    ----------
    beam : str
        Name of the beam.
    obstacle : Plane, Sphere or Cylinder
    stiffness : float
        k, positive; N/m^(m+1).
    radius : float, optional
        Distance from the centre line to the surface; m. By default the centre line touches.
    points_per_element : int, optional
        Gauss points in each element, 4 by default.
    exponent, restitution, impact_speed, friction, slip_speed, other
        As in `Contact`.
    """

    beam: str
    obstacle: Obstacle
    points_per_element: int = 4
    other: MaterialPoint | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        where = f"load {self.name!r}, points_per_element"
        require_count(where, self.points_per_element, "Give the number of points.", 64)

    def vectors(self, elements: Elements) -> Vectors:
        """Return, per Gauss point, its position and slopes, and the vectors of the carrier."""
        own = (Quantity.POSITION, *self.turning(MaterialPoint(self.beam, 0.0), elements))
        carrier = self.carrier_vectors(elements.d)
        names: list[Any] = []
        for element in range(elements.counts[self.beam]):
            for xi in box_rule((self.points_per_element,))[0][:, 0].tolist():
                names += [LineVector(self.beam, element, xi, x) for x in own]
                names += carrier
        return tuple(names)

    def copies(self, elements: Elements) -> Copies:
        """Return one copy of the load per Gauss point, with the length that it represents."""
        count, (_, weights) = elements.counts[self.beam], box_rule((self.points_per_element,))
        of = tuple((self.beam, k) for k in range(count) for _ in weights)
        return Copies(np.tile(weights, count)[:, None], {0: of})

    def force_at(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> Any:
        """Return the force per length times the length that the Gauss point represents; N."""
        return signals[..., -1:, None] * self.force(U, V, p, U_o)
