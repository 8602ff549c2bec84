"""Rigid bodies: a reference point, directions of the body axes, and mass or a shape with density.

Position and rotation about the reference point are design targets.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self, final

import numpy as np

from ancfdae.errors.checks import (
    require_array,
    require_axial,
    require_finite,
    require_kind,
    require_name,
    require_positive,
    require_vector,
)
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies.point import MaterialPoint
from ancfdae.model.design import Designable
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.rotations import orthonormal


class Placed(abc.ABC):
    """Base class of beams and rigid bodies: position and rotation, both design targets."""

    name: str
    # Rotation of the whole body about its position: in space a vector along the axis; rad.
    turn: float | Sequence[float]
    place_word: ClassVar[str] = "start"  # first word of the design targets of the position

    @property
    @abc.abstractmethod
    def dimension(self) -> int:
        """Dimension of space, 2 or 3."""

    @property
    @abc.abstractmethod
    def place(self) -> Sequence[float] | MaterialPoint:
        """Position of the start or reference point, shape (d,), m, or the point of another beam."""

    @abc.abstractmethod
    def with_place(self, place: Sequence[float]) -> Self:
        """Return the same body with its start or reference point at `place`, shape (d,); m."""

    @abc.abstractmethod
    def at_origin(self, point: MaterialPoint) -> Array:
        """Return the position, (d,), m, of a point of the body at the origin and not rotated."""

    @property
    def attached(self) -> MaterialPoint | None:
        """The point of another beam that the body starts at; None if the body has a position."""
        place = self.place
        return place if isinstance(place, MaterialPoint) else None

    def placement(self) -> dict[str, float]:
        """Return rotation, rad, and, unless attached, position, m, of the body by target name."""
        turns = np.atleast_1d(np.asarray(self.turn, float)).tolist()
        names = ["turn"] if self.dimension == 2 else [f"turn_{axis}" for axis in "xyz"]
        numbers = dict(zip(names, turns, strict=True))
        if not isinstance(self.place, MaterialPoint):
            places = zip("xyz", self.place, strict=False)
            numbers |= {f"{self.place_word}_{axis}": float(x) for axis, x in places}
        return numbers

    def split_placement(self, numbers: Array) -> tuple[Array | None, Array]:
        """Return position, shape (d,), and rotation out of `numbers`, ordered as in `placement`.

        Further numbers may follow. The position is None for a body attached to a point of another
        beam.
        """
        n_r = 1 if self.dimension == 2 else 3
        place = None if self.attached else numbers[n_r : n_r + self.dimension]
        return place, numbers[:n_r]

    def with_placement(self, changes: Mapping[str, float]) -> Self:
        """Return the same body with some of the numbers of `placement` changed."""
        numbers = np.array(list((self.placement() | dict(changes)).values()))
        place, turn = self.split_placement(numbers)
        body = self if place is None else self.with_place(tuple(place.tolist()))
        new = float(turn[0]) if self.dimension == 2 else tuple(turn.tolist())
        return replace(body, turn=new)  # type: ignore[type-var]

    def _check_turn(self, where: str) -> None:
        if self.dimension == 3 and np.ndim(self.turn) == 0 and self.turn == 0:
            object.__setattr__(self, "turn", (0.0, 0.0, 0.0))
        require_axial(f"{where}, turn", self.turn, self.dimension)


# -- shapes and bodies -------------------------------------------------------------------------


class BodyShape(Designable, abc.ABC):
    """A solid that is symmetric about its three coordinate planes: its axes are principal axes.

    In a planar scene it is the same solid, seen along z.
    """

    @abc.abstractmethod
    def moments(self, p: Array) -> tuple[Array, Array]:
        """Return the volume, m^3, and the means of x^2, y^2 and z^2 over it, shape (3,); m^2.

        `p` holds the values of `parameters`, real or complex (complex steps differentiate the
        result).
        """

    def __post_init__(self) -> None:
        self.check_fields(type(self).__name__)


def require_shape(where: str, value: object) -> None:
    """Raise InvalidInputError unless `value` is a `BodyShape`."""
    require_kind(where, value, (BodyShape,), "For example RigidBox(0.2, 0.1, 0.05).")


@final
@dataclass(frozen=True)
class RigidBox(BodyShape):
    """A cuboid: `length` along x, `height` along y, `width` along z; m, all design targets."""

    length: float
    height: float
    width: float

    design_fields = tuple((name, require_positive) for name in ("length", "height", "width"))

    def moments(self, p: Array) -> tuple[Array, Array]:
        """Return volume, m^3, and means of x^2, y^2, z^2, (3,), m^2: a^2/12 for side length a."""
        return p[0] * p[1] * p[2], p * p / 12


@final
@dataclass(frozen=True)
class RigidCylinder(BodyShape):
    """A cylinder about z (in the plane a disc): `radius`, `length` along z; m, design targets."""

    radius: float
    length: float

    design_fields = tuple((name, require_positive) for name in ("radius", "length"))

    def moments(self, p: Array) -> tuple[Array, Array]:
        """Return volume, m^3, and means of x^2, y^2, z^2, (3,), m^2: r^2/4 across, l^2/12 along."""
        across = p[0] ** 2 / 4
        return np.pi * p[0] ** 2 * p[1], np.stack([across, across, p[1] ** 2 / 12])


@final
@dataclass(frozen=True)
class RigidSphere(BodyShape):
    """A ball: `radius`; m, a design target."""

    radius: float

    design_fields = (("radius", require_positive),)

    def moments(self, p: Array) -> tuple[Array, Array]:
        """Return volume, m^3, and means of x^2, y^2, z^2, (3,), m^2: each r^2/5."""
        return 4 / 3 * np.pi * p[0] ** 3, np.repeat(p**2 / 5, 3)


# Largest error of a frame F, max |F F^T - E|, that is taken for rounding of the input.
_SQUARE = 1e-6
_AXES = np.arange(3)


def _require_inertia(where: str, value: object) -> None:
    if np.ndim(value) == 0:  # type: ignore[arg-type]
        require_finite(where, value)
    else:
        require_vector(where, value, (3, 6))


@final
@dataclass(frozen=True)
class RigidBody(Placed, Designable):
    """A rigid body with axes of its own through a reference point.

    Its coordinates are the reference point r and its directions d_1, d_2(, d_3); a point x, y, z
    of it is at r + x d_1 + y d_2 + z d_3. Give either its mass and inertia or a shape with its
    density. Design targets: ``mass``, ``centre_x`` ..., ``inertia`` in the plane, ``inertia_x``
    ... or ``inertia_xx`` ... in space; ``density`` and the sizes of the shape.

    Parameters
    ----------
    name : str
    position : sequence of float
        Where the reference point is in the reference configuration, two components for a planar
        and three for a spatial scene; m.
    mass : float, optional
        kg.
    inertia : float or sequence of float, optional
        Moments of inertia about the centre of mass: in the plane one, in space three, (I_x, I_y,
        I_z), if the axes of the body run along its principal axes, or the six entries (I_xx, I_yy,
        I_zz, I_xy, I_xz, I_yz) of the tensor, with I_xy = -int x y dm; kg m^2. In space each
        principal moment must be less than the sum of the other two.
    centre : sequence of float, optional
        Centre of mass, or of the shape, in body axes; by default the reference point; m.
    shape : BodyShape, optional
        Shape of the body, for example `RigidBox`, along the axes of the body.
    density : float, optional
        Density of the shape; kg/m^3.
    frame : sequence of sequence of float, optional
        Directions of the axes in the reference configuration as rows; by default those of space.
    turn : float or sequence of float, optional
        Rotation of the body about its reference point, in space a vector along the axis; rad.
        Design targets: ``turn``, in space ``turn_x`` ..., and ``position_x`` ...

    Raises
    ------
    InvalidInputError
        If vectors have the wrong size, mass or shape are missing or both given, no body of positive
        thickness has the inertia, or the frame is not right-handed and orthonormal.
    """

    name: str
    position: Sequence[float]
    mass: float | None = None
    inertia: float | Sequence[float] | None = None
    centre: Sequence[float] | None = None
    shape: BodyShape | None = None
    density: float | None = None
    frame: Sequence[Sequence[float]] | None = None
    turn: float | Sequence[float] = 0.0

    place_word = "position"
    design_fields = (
        ("mass", require_positive),
        ("inertia", _require_inertia),
        ("centre", require_vector),
        ("shape", require_shape),
        ("density", require_positive),
    )

    def __post_init__(self) -> None:
        require_name("RigidBody.name", self.name)
        where = f"body {self.name!r}"
        require_vector(f"{where}, position", self.position)
        if self.centre is None:
            object.__setattr__(self, "centre", (0.0,) * self.dimension)
        self.check_fields(where)
        require_vector(f"{where}, centre", self.centre, (self.dimension,))
        self._check_mass(where)
        self._check_frame(where)
        self._check_turn(where)

    def refuse_values(self, changes: Mapping[str, float]) -> None:
        """Raise the exceptions of `with_parameters` for these changes.

        Masses and densities are checked without making the body.
        """
        if any(x not in ("mass", "density") or getattr(self, x) is None for x in changes):
            replace(self, **self.changed_fields(changes))
            return
        for name, value in changes.items():
            require_positive(f"body {self.name!r}, {name}", value)

    @property
    def dimension(self) -> int:
        """Dimension of space, 2 or 3."""
        return len(tuple(self.position))

    @property
    def place(self) -> Sequence[float]:
        """Position of the reference point, shape (d,); m."""
        return self.position

    def with_place(self, place: Sequence[float]) -> RigidBody:
        """Return the same body with its reference point moved to `place`, shape (d,); m."""
        return replace(self, position=tuple(place))

    @property
    def origin(self) -> MaterialPoint:
        """The reference point of the body, as a `MaterialPoint` for joints and loads."""
        return MaterialPoint(self.name)

    @property
    def centre_of_mass(self) -> MaterialPoint:
        """The centre of mass of the body, as a `MaterialPoint` for joints and loads."""
        return self.at(*map(float, self.centre))  # type: ignore[arg-type]  # never None here

    def at(self, x: float, y: float = 0.0, z: float = 0.0) -> MaterialPoint:
        """Return the point with coordinates x, y and z, one by one, in the axes of the body; m."""
        if np.ndim(x):
            rule = "coordinates x, y and z must be given one by one"
            repair = "For example body.at(0.1, 0.0, 0.2)."
            raise InvalidInputError(f"point of {self.name!r}", rule, x, repair)
        return MaterialPoint(self.name, x=x, y=y, z=z)

    def directions(self) -> Array:
        """Return the axes of the body in the reference configuration as rows, shape (d, d)."""
        if self.frame is None:
            return np.eye(self.dimension)
        return orthonormal(np.asarray(self.frame, dtype=float))

    def at_origin(self, point: MaterialPoint) -> Array:
        """Return the vector from reference point to `point`, (d,), in the unrotated body; m."""
        return np.array([point.x, point.y, point.z])[: self.dimension] @ self.directions()

    def moments(self, p: Array) -> Array:
        """Return the mass matrix int [1, x] [1, x]^T dm, x in body axes, shape (d + 1, d + 1).

        `p` holds the values of `parameters`, real or complex. With the tensor of inertia I about
        the centre of mass c, int x x^T dm = tr(I)/2 E - I + m c c^T.
        """
        mass, inertia, centre, sizes, density = self.split(p)
        d = self.dimension
        if self.shape is not None:
            volume, means = self.shape.moments(sizes)
            mass = density * volume
            spread = mass * np.diag(means[:d])
        else:
            spread = _spread(inertia, d)
        block = np.zeros((d + 1, d + 1), dtype=np.result_type(p, float))
        block[0, 0], block[0, 1:], block[1:, 0] = mass, mass * centre, mass * centre
        block[1:, 1:] = spread + mass * np.outer(centre, centre)
        return block

    def _check_mass(self, where: str) -> None:
        names = ("mass", "inertia", "shape", "density")
        given = [name for name in names if getattr(self, name) is not None]
        if given not in (["mass", "inertia"], ["shape", "density"]):
            raise InvalidInputError(
                where,
                "needs either mass and inertia, or a shape and its density",
                ", ".join(given) or "none of them",
                "For example RigidBody('arm', (0, 0), shape=RigidBox(0.4, 0.1, 0.1), density=7800)",
            )
        if self.inertia is None:
            return
        if (np.ndim(self.inertia) == 0) != (self.dimension == 2):
            raise InvalidInputError(
                f"{where}, inertia",
                "must be a number in the plane and have 3 or 6 components in space",
                self.inertia,
                f"The body has {self.dimension} dimensions.",
            )
        spread = _spread(np.asarray(self.inertia, dtype=float), self.dimension)
        principal = np.size(self.inertia) < 6
        spreads = np.sort(np.diag(spread)) if principal else np.linalg.eigvalsh(spread)
        # Below the square root of round-off the thickness across the body would be round-off.
        if spreads[0] <= 1e-8 * spreads[-1] or spreads[0] <= 0:
            rule = "must be positive"
            if self.dimension == 3:
                rule = "each principal moment must be less than the sum of the other two"
            repair = "Give the moments of a body of some thickness."
            raise InvalidInputError(f"{where}, inertia", rule, self.inertia, repair)

    def _check_frame(self, where: str) -> None:
        if self.frame is None:
            return
        d = self.dimension
        rows = require_array(f"{where}, frame", self.frame, (d, d))
        if np.max(np.abs(rows @ rows.T - np.eye(d))) > _SQUARE or np.linalg.det(rows) < 0:
            raise InvalidInputError(
                f"{where}, frame",
                "must have perpendicular rows of unit length that are right-handed",
                rows.tolist(),
                "For example ((c, s), (-s, c)) with c = cos(angle), s = sin(angle).",
            )


def _spread(inertia: Array, d: int) -> Array:
    """Return int x x^T dm about the centre of mass, shape (d, d), from the inertia; kg m^2."""
    if d == 2:
        # A planar motion depends on the sum over the two axes only.
        return inertia / 2 * np.eye(2)
    tensor = np.zeros((3, 3), dtype=inertia.dtype)
    tensor[_AXES, _AXES] = inertia[:3]
    if len(inertia) == 6:
        upper = np.triu_indices(3, 1)
        tensor[upper] = tensor.T[upper] = inertia[3:]
    return tensor.trace() / 2 * np.eye(3) - tensor
