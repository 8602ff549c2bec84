"""Joints, loads and point masses as markers, lines and arrows that move with the mechanism."""

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from ancfdae.assembly.load_forces import LoadInput, own_numbers
from ancfdae.assembly.naming import SceneNaming, Vectors, point_vectors
from ancfdae.equations import Solution
from ancfdae.model.bodies import MaterialPoint, Quantity, RigidBody
from ancfdae.model.joints.joint import Joint
from ancfdae.model.loads.load import Load
from ancfdae.model.parts import CentreLine, LineVector, Sign
from ancfdae.model.parts import Vectors as Names
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array

GROUND: Final = Sign("ground", "^", size=12.0)
_MASS: Final = Sign("point mass", "o", filled=True, size=9.0)
# Number of arrows along a beam under a distributed force.
_ALONG: Final = 9


@final
@dataclass(frozen=True)
class Mark:
    """A marker at a point at k times: `kind` is the word of a part, or "ground"; places, (k, d)."""

    kind: str
    sign: Sign
    name: str
    places: Array


@final
@dataclass(frozen=True)
class Line:
    """A line between two points at k times, `ends` of shape (k, 2, d); m.

    `kind` is "link", "spring", "frame", or "way": the direction along which a joint slides. The
    ends of a way are its point and that plus a unit vector; the painter chooses its length.
    """

    kind: str
    name: str
    ends: Array


@final
@dataclass(frozen=True)
class Arrows:
    """Forces or moments at points, (k, n, d) each; a moment in the plane has the shape (k, n, 1).

    `kind` is "force" (N), "force per length" (N/m) or "moment" (N m).
    """

    kind: str
    name: str
    places: Array
    vectors: Array


@final
class Symbols:
    """Symbols of joints, loads, point masses and ground; q_o are the reference coordinates."""

    def __init__(self, scene: Scene, naming: SceneNaming, q_o: Array) -> None:
        self._scene, self._naming, self._q_o = scene, naming, q_o
        self._d = scene.dimension

    def marks(self, motion: Solution) -> list[Mark]:
        """Return a marker for each joint, each ground support, and each point mass."""
        marks = []
        for joint in self._scene.joints:
            places = self._places(joint.points[0], motion.q)
            if len(joint.points) == 1 and joint.shows_ground:
                ground = places
                if joint.stroke is not None:
                    at = np.asarray(joint.ground_place(), dtype=float)
                    ground = np.broadcast_to(at, places.shape)
                marks.append(Mark("ground", GROUND, joint.name, ground))
            marks.append(Mark(joint.kind, joint.sign, joint.name, places))
        return marks + [
            Mark(mass.kind, _MASS, mass.name, self._places(mass.point, motion.q))
            for mass in self._scene.point_masses
        ]

    def lines(self, motion: Solution) -> list[Line]:
        """Return lines for links, springs, axes and ways of joints, and frames of bodies."""
        parts: list[Joint | Load] = [*self._scene.joints, *self._scene.loads]
        lines = [
            Line(part.stroke.value, part.name, self._between(part, motion))
            for part in parts
            if part.stroke is not None
        ]
        for joint in self._scene.joints:
            if joint.way is not None:
                way = np.asarray(joint.way, dtype=float)
                lines.append(Line("way", joint.name, self._along(joint, way, motion)))
        for body in self._scene.bodies:
            if isinstance(body, RigidBody) and body.shape is None:
                lines += self._frame(body, motion)
        return lines

    def arrows(self, motion: Solution) -> list[Arrows]:
        """Return the forces and moments of all loads over the motion, with their laws."""
        return [arrows for load in self._scene.loads for arrows in self._of_load(load, motion)]

    def _of_load(self, load: Load, motion: Solution) -> list[Arrows]:
        names = load.vectors(self._scene.elements)
        F, arrows = self._forces(load, motion), []
        moments: dict[MaterialPoint, list[Array]] = {}
        for number, name in enumerate(names):
            force = F[:, [number]]
            if isinstance(name, CentreLine):
                places = self._stations(name.beam, motion.q)
                spread = np.broadcast_to(force, places.shape)
                arrows.append(Arrows("force per length", load.name, places, spread))
            elif isinstance(name, LineVector):
                if name.quantity is Quantity.POSITION:
                    places = self._vectors((name,)).of(motion.q)
                    arrows.append(Arrows("force", load.name, places, force))
            elif isinstance(name, tuple) and name[1] is Quantity.POSITION:
                if load.stroke is None:
                    places = self._places(name[0], motion.q)[:, None]
                    arrows.append(Arrows("force", load.name, places, force))
            elif isinstance(name, tuple):
                slope = self._of([name], motion.q)
                moments.setdefault(name[0], []).append(_cross(slope, force))
        for point, parts in moments.items():
            M = sum(parts[1:], parts[0])
            if np.any(M):
                arrows.append(
                    Arrows("moment", load.name, self._places(point, motion.q)[:, None], M)
                )
        return arrows

    def _forces(self, load: Load, motion: Solution) -> Array:
        """Return the generalised forces on the vectors of a load, shape (k, n, d)."""
        vectors = self._vectors(load.vectors(self._scene.elements))
        p = np.array(list(load.parameters().values()), dtype=float)
        p_b = np.zeros((len(p), self._naming.lengths_b.shape[1]))
        own, own_b = own_numbers(load.copies(self._scene.elements), self._naming, p, p_b)
        reference = vectors.of(self._q_o[None])[0][: vectors.count // len(own)]
        item = LoadInput(load, vectors, p, p_b, reference, {}, np.zeros(0), own, own_b)
        factors = item.factors(motion.t, 0)
        F = item.forces(vectors.of(motion.q), vectors.of(motion.v), factors[:, 1:])
        return F * factors[:, :1, None]

    def _vectors(self, names: Names) -> Vectors:
        vectors, n_b = point_vectors(self._naming, names), self._naming.lengths_b.shape[1]
        return Vectors.of_points(vectors, self._d, len(self._q_o), n_b)

    def _of(self, names: list[tuple[MaterialPoint, Quantity]], q: Array) -> Array:
        """Return position or slope vectors of points at coordinates q, shape (k, n, d)."""
        return self._vectors(tuple(names)).of(q)

    def _places(self, point: MaterialPoint, q: Array) -> Array:
        return self._of([(point, Quantity.POSITION)], q)[:, 0]

    def _stations(self, beam: str, q: Array) -> Array:
        fractions = np.linspace(0.0, 1.0, _ALONG).tolist()
        return self._of([(MaterialPoint(beam, x), Quantity.POSITION) for x in fractions], q)

    def _between(self, part: Joint | Load, motion: Solution) -> Array:
        ends = self._of([(point, Quantity.POSITION) for point in part.points], motion.q)
        if len(part.points) == 2:
            return ends
        fixed = np.broadcast_to(np.asarray(part.ground_place(), dtype=float), ends.shape)
        return np.concatenate([ends, fixed], axis=1)

    def _along(self, joint: Joint, direction: Array, motion: Solution) -> Array:
        """Return a point of a joint, and that plus a unit vector along its way; (k, 2, d), m.

        The direction rotates with the last body of the joint.
        """
        point, e = joint.points[-1], direction / np.linalg.norm(direction)
        places = self._places(joint.points[0], motion.q)
        if len(joint.points) == 1:
            return np.stack([places, places + e], axis=1)
        slopes = [(point, Quantity(k)) for k in range(1, self._d + 1)]
        reference = self._of(slopes, self._q_o[None])[0]
        carried = np.linalg.solve(reference.T, e) @ self._of(slopes, motion.q)
        carried = carried / np.linalg.norm(carried, axis=-1, keepdims=True)
        return np.stack([places, places + carried], axis=1)

    def _frame(self, body: RigidBody, motion: Solution) -> list[Line]:
        """Return the axes of a body without a shape as lines from its centre."""
        size = self._naming.layout.body(body.name).size
        centre = np.asarray(body.centre, dtype=float)
        ends = [centre, *(centre + size * e for e in np.eye(self._d))]
        points = [(body.at(*end.tolist()), Quantity.POSITION) for end in ends]
        x = self._of(points, motion.q)
        return [Line("frame", body.name, x[:, [0, k]]) for k in range(1, self._d + 1)]


def _cross(r: Array, F: Array) -> Array:
    """Return r x F, (..., 3), in the plane its single component, (..., 1)."""
    if r.shape[-1] == 3:
        return np.cross(r, F)
    return r[..., :1] * F[..., 1:] - r[..., 1:] * F[..., :1]
