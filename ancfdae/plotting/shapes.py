"""Meshes of bodies, moved by the coordinates, and fields of numbers that colour them.

Positions are those of material points, exact in the shape functions. Functions of the design are
complex-safe, so that derivatives are complex steps.
"""

import abc
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.assembly.beam_sections import BeamElements, BeamSections, StressPoints
from ancfdae.assembly.elastic_forces import strain_energy
from ancfdae.assembly.naming import SceneNaming, Vectors
from ancfdae.equations import Solution
from ancfdae.errors.checks import require_text
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import (
    BeamBody,
    BodyShape,
    MaterialPoint,
    Quantity,
    RigidBody,
    RigidBox,
    RigidCylinder,
)
from ancfdae.model.elements import ElementParameter
from ancfdae.model.elements.continuum import prepare
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.rotations import generators

# Least number of stations along a beam, and rows of cells over the height of a planar one: a circle
# of eight elements looks round, and the change of sign of bending stresses is visible.
_STATIONS, _ROWS = 24, 4
# Number of points around circles, and of intervals from pole to pole of a sphere.
_AROUND, _POLES = 24, 12
# Added to 1 + cos of an angle, so that it is not zero.
_LEAST = 1e-12


class Mesh(abc.ABC):
    """Points and faces of the surface of one body.

    `faces` are the point indices of each face, (n_faces, 4): a triangle repeats its last one;
    `loop`, (n_loop,), are those of the closed outline in the plane.
    """

    name: str
    faces: Array
    loop: Array

    @abc.abstractmethod
    def places(self, q: Array, move: int | None = None) -> Array:
        """Return the positions of the points, shape (k, n, d), m; complex where q is complex.

        With `move` they are taken with this design variable perturbed by an imaginary step.
        """

    @final
    def velocities(self, q: Array, v: Array) -> Array:
        """Return the velocities of the points of the mesh, shape (k, n, d); m/s."""
        return self.places(q + 1j * STEP * v).imag / STEP

    @final
    def sensitivities(self, q: Array, q_b: Array, number: int) -> Array:
        """Return the total derivatives of the positions in a design variable, shape (k, n, d).

        `q_b`, (k, n_q), are the derivatives of the coordinates, `number` is the index of the
        variable.
        """
        return self.places(q + 1j * STEP * q_b, number).imag / STEP


@final
class BeamMesh(Mesh):
    """The surface of a beam; in the plane the area between its lowest and highest fibres.

    `elements` is None if the beam is rigid; `sections` belongs to the scene. Points lie at the
    reference coordinates xi, (n_xi,), of every element and at fibres y, z, (n, n_f); they are
    numbered element by element, station by station.
    """

    def __init__(
        self,
        body: BeamBody,
        naming: SceneNaming,
        n_q: int,
        elements: BeamElements | None,
        sections: BeamSections,
    ) -> None:
        self.name, self.body, self.elements, self.sections = body.name, body, elements, sections
        n, d = body.element_count, body.dimension
        self.xi = np.linspace(0.0, 1.0, max(2, -(-_STATIONS // n)) + 1)
        kind = body.element_type()
        sizes = kind.sizes(body.element_parameters())
        y, z = kind.section.contour(sizes)
        if d == 2:
            outer, _ = kind.section.outline(sizes)
            low, high = outer.min(axis=1), outer.max(axis=1)
            y = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, _ROWS + 1)
            z = np.zeros_like(y)
        self.y, self.z = y, z
        quantities = [q for q in body.element.quantities if q <= d]
        points = self._stations(naming)
        self._vectors = {
            quantity: Vectors.of_points(
                [naming.vector(point, quantity) for point in points],
                d,
                n_q,
                naming.lengths_b.shape[1],
            )
            for quantity in quantities
        }
        self.faces, self.loop = self._connected()

    def places(self, q: Array, move: int | None = None) -> Array:
        """Return positions r + y r_y + z r_z; cables use axes across their centre line."""
        at, shape = self._along(q, move), (len(q), *self.shape[:2], 1, self.body.dimension)
        x = at[Quantity.POSITION].reshape(shape)
        for slope, offset in ((Quantity.SLOPE_Y, self.y), (Quantity.SLOPE_Z, self.z)):
            if slope in at:
                x = x + offset[:, None, :, None] * at[slope].reshape(shape)
        return x.reshape(len(q), -1, shape[-1])

    def axis(self, q: Array) -> tuple[Array, Array]:
        """Return centre line, m, and unit height axis of the section, (k, n, n_xi, d) each."""
        at, shape = self._along(q, None), (len(q), *self.shape[:2], self.body.dimension)
        up = at[Quantity.SLOPE_Y].reshape(shape)
        up = up / np.linalg.norm(up, axis=-1, keepdims=True)
        return at[Quantity.POSITION].reshape(shape), up

    def _along(self, q: Array, move: int | None) -> dict[Quantity, Array]:
        """Return position and slope vectors at all stations, shape (k, n n_xi, d) each."""
        at = {
            quantity: (vectors if move is None else vectors.moved(move)).of(q)
            for quantity, vectors in self._vectors.items()
        }
        if Quantity.SLOPE_Y not in at:
            tangent = at[Quantity.SLOPE_X]
            tangent = tangent / np.sqrt(np.sum(tangent * tangent, axis=-1, keepdims=True))
            at |= self._carried(tangent)
        return at

    def _carried(self, tangent: Array) -> dict[Quantity, Array]:
        """Return the axes across a cable: the declared ones, rotated with the tangent.

        The rotation is the smallest one from the declared direction to the tangent.
        """
        if self.body.dimension == 2:
            return {Quantity.SLOPE_Y: tangent @ generators(2)[0].T}
        start, *across = self.body.directions()
        both, slopes = start + tangent, (Quantity.SLOPE_Y, Quantity.SLOPE_Z)
        # For half a turn the smallest rotation is not unique: any will do.
        share = (tangent @ np.stack(across, axis=1)) / (1 + _LEAST + tangent @ start)[..., None]
        return {
            slope: e - share[..., k, None] * both
            for k, (slope, e) in enumerate(zip(slopes, across, strict=True))
        }

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of elements, of stations per element, and of fibres per station."""
        return len(self.y), len(self.xi), self.y.shape[1]

    def _stations(self, naming: SceneNaming) -> list[MaterialPoint]:
        nodes = np.asarray(naming.layout.beam(self.name).fractions)
        along = nodes[:-1, None] + np.diff(nodes)[:, None] * self.xi
        along[:, -1] = nodes[1:]
        return [MaterialPoint(self.name, fraction) for fraction in along.ravel().tolist()]

    def _connected(self) -> tuple[Array, Array]:
        """Return faces between the stations, with caps on the ends in space, and the outline."""
        numbers = np.arange(np.prod(self.shape)).reshape(self.shape)
        if self.body.dimension == 2:
            rows = numbers.reshape(-1, self.shape[2])
            loop = np.concatenate([rows[:, 0], rows[::-1, -1]])
            here, there = numbers[..., :-1], numbers[..., 1:]
        else:
            loop = np.zeros(0, dtype=np.int64)
            here, there = numbers, np.roll(numbers, -1, axis=2)
        corners = [here[:, :-1], here[:, 1:], there[:, 1:], there[:, :-1]]
        faces = np.stack(corners, axis=-1).reshape(-1, 4)
        if self.body.dimension == 3:
            faces = np.concatenate([_cap(numbers[0, 0])[:, ::-1], faces, _cap(numbers[-1, -1])])
        return faces, loop


@final
class RigidMesh(Mesh):
    """The surface of a rigid body; without faces if only its mass and inertia are known."""

    def __init__(self, body: RigidBody, naming: SceneNaming, n_q: int) -> None:
        self.name, self.body = body.name, body
        x, self.faces, self.loop = _solid(body.shape, body.dimension)
        x = x[:, : body.dimension] + np.asarray(body.centre)
        points = [body.at(*place) for place in x.tolist()]
        vectors = [naming.vector(point, Quantity.POSITION) for point in points]
        self._places = Vectors.of_points(vectors, body.dimension, n_q, naming.lengths_b.shape[1])

    def places(self, q: Array, move: int | None = None) -> Array:
        """Return the positions r + x d_1 + y d_2 + z d_3 of the points, (k, n, d); m."""
        return self._places.of(q)


def _cap(loop: Array) -> Array:
    """Return faces that fill a contour by strips between opposite points of its sides."""
    half = len(loop) // 2
    up, down = loop[:half], loop[: half - 1 : -1]
    return np.stack([up[:-1], up[1:], down[1:], down[:-1]], axis=-1)


def _solid(shape: BodyShape | None, d: int) -> tuple[Array, Array, Array]:
    """Return points in the axes of the body, faces and outline of a shape."""
    none = np.zeros((0, 4), dtype=np.int64)
    if shape is None:
        return np.zeros((0, 3)), none, none[:, 0]
    if d == 2:
        if isinstance(shape, RigidBox):
            x = _rectangle(shape)
        else:
            x = _circle(shape.radius if isinstance(shape, RigidCylinder) else _radius(shape))
        loop = np.arange(len(x))
        return x, _cap(loop), loop
    return (*_surface(shape), none[:, 0])


def _surface(shape: BodyShape) -> tuple[Array, Array]:
    """Return points of a closed surface in rings, (n, 3), m, and its faces."""
    up = np.array([0.0, 0.0, 1.0])
    if isinstance(shape, RigidBox):
        rings = [_rectangle(shape) + sign * shape.width / 2 * up for sign in (-1, 1)]
    elif isinstance(shape, RigidCylinder):
        rings = [_circle(shape.radius) + sign * shape.length / 2 * up for sign in (-1, 1)]
    else:
        radius, angles = _radius(shape), np.pi * np.arange(_POLES + 1) / _POLES
        rings = [_circle(radius * np.sin(a)) - radius * np.cos(a) * up for a in angles]
    numbers = np.arange(len(rings) * len(rings[0])).reshape(len(rings), -1)
    beside = np.roll(numbers, -1, axis=1)
    sides = np.stack([numbers[:-1], numbers[1:], beside[1:], beside[:-1]], axis=-1)
    faces = [_cap(numbers[0]), sides.reshape(-1, 4), _cap(numbers[-1])[:, ::-1]]
    return np.concatenate(rings), np.concatenate(faces)


def _rectangle(shape: RigidBox) -> Array:
    a, b = shape.length / 2, shape.height / 2
    return np.array([[-a, -b, 0.0], [-a, b, 0.0], [a, b, 0.0], [a, -b, 0.0]])


def _circle(radius: float) -> Array:
    """Return a polygon of a circle, (n, 3), whose points have equal heights in pairs."""
    angle = (np.arange(_AROUND) + 0.5) * 2 * np.pi / _AROUND
    return radius * np.stack([-np.cos(angle), np.sin(angle), 0 * angle], axis=-1)


def _radius(shape: BodyShape) -> float:
    """Return the radius, m, of a ball with the radius of gyration of a user's own shape."""
    _, means = shape.moments(np.array(list(shape.parameters().values()), dtype=float))
    return float(np.sqrt(5 * np.mean(means)))


# -- fields ------------------------------------------------------------------------------------


# Indices of the axial force and the torque in the vector of section forces of `SectionLaw`.
_AXIAL, _TORQUE = 0, 3


class Field(abc.ABC):
    """A scalar at every point of a mesh, by which pictures are coloured.

    Attributes
    ----------
    label : str
        Quantity and unit.
    signed : bool
        Whether its sign matters, so that the colour scale is symmetric about zero.
    """

    signed = False

    @property
    @abc.abstractmethod
    def label(self) -> str:
        """Name of the field with its unit, for the colour bar."""

    @abc.abstractmethod
    def values(self, mesh: Mesh, motion: Solution) -> Array:
        """Return the values at the times of a solution, (k, n); NaN where they do not exist.

        Raises
        ------
        InvalidInputError
            If the solution or the element lacks the data of the field.
        """


class _OfBeams(Field):
    """A field that only flexible beams have."""

    @final
    def values(self, mesh: Mesh, motion: Solution) -> Array:
        """Return the field at the points of a mesh, (k, n points); NaN for rigid bodies."""
        if not isinstance(mesh, BeamMesh) or mesh.elements is None:
            return np.full(mesh.places(motion.q).shape[:2], np.nan)
        values = np.broadcast_to(self.on_beam(mesh, motion), (len(motion.t), *mesh.shape))
        return values.reshape(len(motion.t), -1)

    @abc.abstractmethod
    def on_beam(self, mesh: BeamMesh, motion: Solution) -> Array:
        """Return the field, shape (k, n elements, n stations, n fibres) or broadcast to it."""


@final
@dataclass(frozen=True)
class StrainEnergyDensity(_OfBeams):
    """Strain energy per volume, averaged over each element, as a colour; J/m^3."""

    label = "strain energy density [J/m³]"

    def on_beam(self, mesh: BeamMesh, motion: Solution) -> Array:
        """Return the energy of each element over its volume, shape (k, n, 1, 1); J/m^3."""
        elements = mesh.elements
        assert elements is not None
        law = prepare(elements.element, elements.batch)
        Y = elements.relative(motion.q[:, elements.coordinates])
        energy = strain_energy(law.A, law.g_o, Y, law.bending)
        # The mass of an element is the sum of the entries of m for the positions of its two nodes.
        positions = slice(None, None, elements.element.n_s)
        mass = law.m[:, positions, positions].sum(axis=(1, 2))
        density: Array = energy * elements.batch.parameters[:, ElementParameter.DENSITY] / mass
        return density[..., None, None]


@final
@dataclass(frozen=True)
class VonMisesStress(_OfBeams):
    """Von Mises' stress as a colour, as the observable `von_mises`; Pa."""

    label = "von Mises stress [Pa]"

    def on_beam(self, mesh: BeamMesh, motion: Solution) -> Array:
        """Return the stresses at all points, shape (k, n, n_xi, n_f); Pa."""
        elements = mesh.elements
        assert elements is not None
        points = StressPoints(elements, mesh.xi, lambda _: (mesh.y, mesh.z))
        n, n_xi, n_f = mesh.shape
        stress = points.value(motion.q, motion.v).reshape(len(motion.t), n, n_f, n_xi)
        return stress.swapaxes(2, 3)


class _SectionForce(_OfBeams):
    """A force or moment of the section as a colour."""

    signed = True

    @property
    @abc.abstractmethod
    def component(self) -> int:
        """Index of this force or moment among N, V_y, V_z, T, M_y, M_z."""

    @final
    def on_beam(self, mesh: BeamMesh, motion: Solution) -> Array:
        """Return the section force at all stations, the same at all fibres of a section."""
        return section_forces(mesh, motion)[..., [self.component]]


@final
@dataclass(frozen=True)
class AxialForce(_SectionForce):
    """Axial force as a colour, positive in tension, as the observable `axial_force`; N."""

    component = _AXIAL
    label = "axial force [N]"


@final
@dataclass(frozen=True)
class BendingMoment(_SectionForce):
    """Bending moment as a colour, as the observable `bending_moment`; N m.

    Parameters
    ----------
    about : int
        2 for the width of the section, the z axis of a planar scene, and 1 for its height.
    """

    about: int = 2

    def __post_init__(self) -> None:
        if self.about not in (1, 2):
            raise InvalidInputError(
                "BendingMoment, about", "must be 1 or 2", repr(self.about), "2 is the width."
            )

    @property
    def component(self) -> int:
        """Index of M_y or M_z among N, V_y, V_z, T, M_y, M_z."""
        return _TORQUE + self.about

    label = "bending moment [N m]"


@final
@dataclass(frozen=True)
class Speed(Field):
    """Magnitude of the velocity as a colour; m/s."""

    label = "speed [m/s]"

    def values(self, mesh: Mesh, motion: Solution) -> Array:
        """Return the magnitude of the velocity of every point, shape (k, n); m/s."""
        return np.asarray(np.linalg.norm(mesh.velocities(motion.q, motion.v), axis=-1))


@final
@dataclass(frozen=True)
class Sensitivity(Field):
    """Magnitude |dr/db| of the derivative of a point's position in a design variable, as a colour.

    Parameters
    ----------
    variable : str
        Name of a design variable of the solution, which must come from `differentiate`.
    """

    variable: str

    def __post_init__(self) -> None:
        require_text("Sensitivity, variable", self.variable)

    @property
    def label(self) -> str:
        """Name of the field with its unit, for the colour bar."""
        return f"|dr/db|, b = {self.variable} [m per unit of b]"

    def values(self, mesh: Mesh, motion: Solution) -> Array:
        """Return |dr/db| of every point, shape (k, n); m per unit of the variable."""
        number = motion.design_index(self.variable)
        assert motion.sensitivities is not None  # as was just seen
        q_b = motion.sensitivities.q_b[..., number]
        return np.asarray(np.linalg.norm(mesh.sensitivities(motion.q, q_b, number), axis=-1))


def section_forces(mesh: BeamMesh, motion: Solution) -> Array:
    """Return N, V_y, V_z, T, M_y, M_z of a flexible beam, shape (k, n, n_xi, 6); N and N m."""
    places = ((k, xi) for k in range(mesh.shape[0]) for xi in mesh.xi.tolist())
    laws = (mesh.sections.forces_in(mesh.name, *place) for place in places)
    forces = np.stack([law.values(motion.q, motion.v) for law in laws], axis=1)
    return forces.reshape(len(forces), *mesh.shape[:2], 6)
