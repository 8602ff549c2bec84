"""Base class of joints and loads: name, points of bodies, design targets, symbols; point masses."""

import abc
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from enum import Enum
from functools import cache, cached_property
from typing import Any, ClassVar, Self, TypeAlias, TypeVar, final

import numpy as np

from ancfdae.errors.checks import (
    require_axial,
    require_kind,
    require_positive,
    require_text,
    require_vector,
)
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import BeamBody, MaterialPoint, RigidBody, require_point
from ancfdae.model.design import Designable
from ancfdae.model.elements import BeamElement, Quantity, default_element
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.rotations import rotation


@final
@dataclass(frozen=True)
class Sign:
    """Symbol of a joint in pictures, drawn at its first point."""

    word: str  # name in the legend
    marker: str  # a marker of matplotlib, or a symbol of its mathematics between dollar signs
    filled: bool = False
    size: float = 7.0  # points of print


@final
class Stroke(Enum):
    """Kind of line drawn for a joint or load, between its points or from point to `ground`."""

    LINK = "link"
    SPRING = "spring"


@final
@dataclass(frozen=True)
class Elements:
    """Elements of the beams of a scene, on which the vectors of joints and loads depend.

    `d` is the dimension of space and `of_beam` gives the element of each beam.
    """

    d: int
    of_beam: Mapping[str, BeamElement]
    #: Number of elements of each beam, and the reference position of a point as declared, (d,); m.
    counts: Mapping[str, int] = field(default_factory=dict)
    place_of: Callable[[MaterialPoint], Array] = lambda point: np.zeros(0)

    def at(self, point: MaterialPoint) -> BeamElement:
        """Return the element at a point; for a rigid body the default beam of the dimension."""
        return self.of_beam.get(point.beam) or default_element(self.d)


@final
@dataclass(frozen=True)
class CentreLine:
    """Vector of a load: the integral of the position along the centre line of a beam."""

    beam: str


@final
@dataclass(frozen=True)
class LineVector:
    """Vector of a load: a node vector quantity at xi of an element (from 0) of a beam."""

    beam: str
    element: int
    xi: float
    quantity: Quantity


@final
@dataclass(frozen=True)
class Normal:
    """Vector of a joint: the tangent at a point, rotated by a right angle from x to y.

    It replaces the section slope in planar elements without a section.
    """

    point: MaterialPoint


# What a name must not contain. Default names hold numbers with a dot: pin(rod@0.5).
_NO_NAME = re.compile(r"\.(?!\d)|\[")


@final
@dataclass(frozen=True)
class FrameDirection:
    """Vector of rigid bodies: position (number 0) or axis direction (from 1) of a rigid body."""

    body: str
    number: int


@final
@dataclass(frozen=True)
class StateVector:
    """Vector of a controller state, or of a coordinate that a joint adds; counted from 0.

    A coordinate of a joint is component 0 of the vector. A state of a controller is component 0 of
    the rate of the vector; the vector is its integral over time.
    """

    owner: str
    number: int


#: Vectors that joints and loads depend on: a point with a quantity, or one of the classes above.
Vectors: TypeAlias = tuple[
    tuple[MaterialPoint, Quantity]
    | Normal
    | CentreLine
    | LineVector
    | FrameDirection
    | StateVector,
    ...,
]


@dataclass(frozen=True)
class Part(Designable, abc.ABC):
    """A named joint or load.

    A part is a frozen dataclass. Fields of these names mean the same in every part. `point` is the
    point that the part acts on, `beam` the name of a beam that it acts on as a whole. `other`, a
    point, or `ground`, a position, is the second end.

    Parameters
    ----------
    name : str, optional
        Unique in a scene; by default ``kind(beam@fraction)``.
    """

    #: "joint", "load" or "body", and the word for this class in default names, such as "pin".
    role: ClassVar[str]
    kind: ClassVar[str]
    #: Whether one of `other` and `ground` must be given, and whether it exists in space only.
    needs_other_end: ClassVar[bool] = False
    spatial: ClassVar[bool] = False
    #: The line that pictures draw from its first point to its second, or to its `ground`.
    stroke: ClassVar[Stroke | None] = None
    #: Names of states of a load (`Controller`), or of coordinates that a joint adds, each with a
    #: vector that is integrated with the mechanism; these vectors come last.
    states: ClassVar[tuple[str, ...]] = ()
    #: Whether it has a guide or pulleys, which a motion may leave; `off_route` then finds where.
    routed: ClassVar[bool] = False
    #: Remedy in the error message if `ground` is a point.
    no_second_point: ClassVar[str] = "Give a point as `other`, if there is one."

    name: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        """Set the default name if the part has none, and check its fields."""
        self._check_declared()
        name, where = self.name, f"{self.role} {self.kind!r}, name"
        require_kind(where, name, (str,), "Give a name.")
        if _NO_NAME.search(name):
            rule = "must hold no '[' and no dot, except in a number: design targets have them"
            raise InvalidInputError(where, rule, repr(name), "Write '_' or '-' instead.")
        given = self._given()
        where = f"{self.role} {name!r}" if name else self.kind
        at = given.get("beam", given.get("joint", given.get("start")))
        if "point" in given:
            require_point(where, given["point"])
            at = str(given["point"])
        elif "beam" in given:
            require_text(f"{where}, beam", at)
        if not name:
            object.__setattr__(self, "name", f"{self.kind}({at})")
        where = f"{self.role} {self.name!r}"
        self._check_ends(where, given)
        self.check_fields(where)

    def initial_states(self, p: Array) -> Sequence[Any]:
        """Return the states of a load, or the rates of the states of a joint, at t = 0."""
        return ()

    def off_route(
        self, t: Array, U: Array, V: Array, p: Array, U_o: Array
    ) -> tuple[int, str] | None:
        """Return the first of k states up to which the part left its route, and a message.

        U are the vectors at times t, (k, n_vectors, d), V their rates, and U_o the vectors in the
        reference configuration. None if the part stays on its route. The message begins with a verb
        and ends with a remedy.
        """
        return None

    def point_numbers(self) -> dict[str, float]:
        """Return the coordinates of the points on their bodies, which can be design targets.

        Their names are ``point_fraction``, ``point_y``, ``point_z``, and likewise for `other`.
        """
        return {
            f"{name}_{coordinate}": number
            for name, point in self.point_fields().items()
            for coordinate, number in point.numbers().items()
        }

    def with_parameters(self, changes: Mapping[str, float]) -> Self:
        """Return the same part with some of its `parameters` and `point_numbers` changed."""
        placing = {name: number for name, number in changes.items() if name in self.point_numbers()}
        points = self.point_fields()
        for name, number in placing.items():
            owner, _, coordinate = name.rpartition("_")
            points[owner] = replace(points[owner], **{coordinate: number})  # type: ignore[arg-type]
        part = self.with_points(points)
        rest = {name: number for name, number in changes.items() if name not in placing}
        return super(Part, part).with_parameters(rest)

    def with_points(self, points: Mapping[str, MaterialPoint]) -> Self:
        """Return the same part with other points in its `point_fields`, given by name."""
        return replace(self, **points)  # type: ignore[arg-type]

    def point_fields(self) -> dict[str, MaterialPoint]:
        """Return the fields that hold a material point, by name."""
        given = ((name, getattr(self, name)) for name in _field_names(type(self)))
        return {name: x for name, x in given if isinstance(x, MaterialPoint)}

    @cached_property
    def points(self) -> tuple[MaterialPoint, ...]:
        """Points that the part acts on, `point` first."""
        return tuple(self.point_fields().values())

    def ground_place(self) -> Sequence[float] | None:
        """Return the declared position on the ground, shape (d,), m; None if undeclared."""
        return self._given().get("ground")

    @property
    def whole_beams(self) -> tuple[str, ...]:
        """Names of the beams that the part acts on along their whole length."""
        beam = self._given().get("beam")
        return () if beam is None else (beam,)

    @property
    def whole_bodies(self) -> tuple[str, ...]:
        """Names of the rigid bodies that the part acts on without naming points of them."""
        return ()

    @abc.abstractmethod
    def vectors(self, elements: Elements) -> Vectors:
        """Return the vectors that the equations or forces of the part depend on."""

    def check_space(self, elements: Elements) -> None:
        """Raise InvalidInputError if the part does not fit the dimension of the scene.

        It does not if it is spatial and the scene planar, an element lacks a vector that it needs,
        a vector field has another number of components, or an optional axis is given in the plane.
        """
        where, d = f"{self.role} {self.name!r}", elements.d
        if self.spatial and d != 3:
            raise InvalidInputError(
                where,
                "this kind of part needs a scene in space",
                "a scene in the plane",
                "Give points three components, or use Pin in the plane.",
            )
        for vector in self._known_vectors(elements):
            if isinstance(vector, tuple) and vector[0].fraction is not None:
                point, quantity = vector
                elements.at(point).require(where, quantity, point.y, point.z)
        axis = self._given().get("axis")
        if d == 2 and axis is not None and not self._needs("axis"):
            raise InvalidInputError(
                f"{where}, axis",
                "must be left out in the plane",
                axis,
                "The axis of a planar part is z.",
            )
        for name, rule_of_value in self.design_fields:
            value = getattr(self, name)
            if rule_of_value is require_axial and value is not None:
                require_axial(f"{where}, {name}", value, d)
            elif np.ndim(value) == 1 and name not in self.indexed_fields:
                require_vector(f"{where}, {name}", value, (d,))

    def _check_declared(self) -> None:
        """Raise InvalidInputError if the class lacks a field named in `design_fields`."""
        for name, _ in self.design_fields:
            if name not in _field_names(type(self)):
                where = f"{self.role} of class {type(self).__name__}"
                rule, repair = "must have its `design_fields`", "Write it among those of the class."
                raise InvalidInputError(where, rule, f"no field {name!r}", repair)

    def _known_vectors(self, elements: Elements) -> Vectors:
        """Return the vectors declared by `vectors`.

        Raises InvalidInputError unless they are a non-empty tuple of vectors of points.
        """
        vectors: Any = self.vectors(elements)
        of_point = MaterialPoint, Quantity
        if not (isinstance(vectors, tuple) and vectors) or not all(
            isinstance(x, Normal | CentreLine | LineVector | FrameDirection | StateVector)
            or (isinstance(x, tuple) and len(x) == 2 and all(map(isinstance, x, of_point)))
            for x in vectors
        ):
            raise InvalidInputError(
                f"vectors of {self.role} {self.name!r}",
                "must be a tuple of one or more vectors of points",
                repr(vectors),
                "For example ((self.point, Quantity.POSITION),).",
            )
        points = [x[0] for x in vectors if isinstance(x, tuple)]
        points += [x.point for x in vectors if isinstance(x, Normal)]
        for point in points:
            if point not in self.points:
                where = f"vectors of {self.role} {self.name!r}"
                rule = "must be vectors of points that are fields of its class"
                repair = "Write `point: MaterialPoint` in the class, and use self.point."
                raise InvalidInputError(where, rule, repr(point), repair)
        return vectors

    def _given(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in _field_names(type(self))}

    def _needs(self, name: str) -> bool:
        declared = (each for each in fields(self) if each.name == name)
        return any(each.default is MISSING for each in declared)

    def _check_ends(self, where: str, given: dict[str, Any]) -> None:
        other, ground = given.get("other"), given.get("ground")
        if other is not None or self._needs("other"):
            require_point(f"{where}, other", other)
        if isinstance(ground, MaterialPoint):
            where, rule = f"{where}, ground", "must be a place"
            raise InvalidInputError(where, rule, f"the point {ground}", self.no_second_point)
        ends = (other is not None) + (ground is not None)
        if ends == 2 or (ends == 0 and self.needs_other_end):
            raise InvalidInputError(
                where,
                "needs either `other`, a second point, or `ground`, a place",
                "both" if ends else "neither",
                "For example ground=(0.0, 1.0), or other=rod.at_end.",
            )


@cache
def _field_names(kind: type) -> tuple[str, ...]:
    """Return the names of the fields of a dataclass."""
    return tuple(each.name for each in fields(kind))


#: Function that returns the beam or rigid body of a name.
_Member: TypeAlias = Callable[[str], BeamBody | RigidBody]
_Any = TypeVar("_Any", bound=Part)

#: Design targets of the position on the ground.
TARGETS = ("ground_x", "ground_y", "ground_z")


def reference_place(point: MaterialPoint, member: _Member) -> Array:
    """Return the position of a point in the declared reference configuration, shape (d,); m."""
    arms, at = list[Array](), point
    while True:
        body = member(at.beam)
        turn = rotation(np.asarray(body.turn, float), body.dimension)
        arms.append(turn @ body.at_origin(at))
        if body.attached is None:
            break
        at = body.attached
    # Summed from the first body on, in the order in which the bodies are attached.
    return sum(reversed(arms), start=np.asarray(body.place))


def on_ground(part: _Any, member: _Member) -> _Any:
    """Return the part with `ground` declared: by default the reference position of its point.

    A part with a second point, or that needs neither, is returned as it is.
    """
    given = part._given()
    if "ground" not in given or given["ground"] is not None or given.get("other"):
        return part
    place = tuple(reference_place(given["point"], member).tolist())
    return replace(part, ground=place)  # type: ignore[call-arg]


@final
@dataclass(frozen=True)
class PointMass(Part):
    """A point mass on a beam or a rigid body; it has no coordinates of its own.

    With r = L q its position, it adds m L^T L to the mass matrix; gravity acts on it. Design
    target: ``mass``.

    Parameters
    ----------
    point : MaterialPoint
    mass : float
        Mass m, positive; kg.
    """

    point: MaterialPoint
    mass: float

    role = "body"
    kind = "mass"
    design_fields = (("mass", require_positive),)

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vector that the mass acts on: the position of the point."""
        return ((self.point, Quantity.POSITION),)
