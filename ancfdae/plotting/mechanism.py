"""Data of a mechanism at several times, from which pictures, animations and exports are made."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.assembly.beam_sections import BeamElements, BeamSections
from ancfdae.assembly.geometry import Reference
from ancfdae.assembly.layout import Layout
from ancfdae.assembly.naming import SceneNaming
from ancfdae.assembly.numbering import number
from ancfdae.assembly.parameters import ParameterMap, parameter_map
from ancfdae.equations import Solution, Statistics
from ancfdae.errors.checks import require_kind, require_vector
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.outcomes import RunOutcome, Verdict
from ancfdae.errors.text import listed
from ancfdae.model.bodies import RigidBody
from ancfdae.model.elements import ElementParameter
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.plotting.shapes import BeamMesh, Field, Mesh, RigidMesh
from ancfdae.plotting.symbols import Arrows, Line, Mark, Symbols

# Relative difference of element lengths that are equal to round-off.
_SAME = 1e-9


@final
@dataclass(frozen=True, eq=False)
class Mechanism:
    """A scene at k times of a motion.

    `places` are the points of each mesh, (k, n, d), m; `values` the field there, (k, n): NaN where
    it does not exist; empty without a field. `asked` are the given limits of the colour scale.
    """

    d: int
    motion: Solution
    meshes: tuple[Mesh, ...]
    places: tuple[Array, ...]
    values: tuple[Array, ...]
    marks: tuple[Mark, ...]
    lines: tuple[Line, ...]
    arrows: tuple[Arrows, ...]
    field: Field | None
    asked: tuple[float, float] | None = None

    @property
    def bounds(self) -> Array:
        """Least and largest coordinates of all drawn points at all times, shape (2, d); m."""
        places = [x.reshape(-1, self.d) for x in self.places]
        places += [mark.places for mark in self.marks]
        places += [line.ends.reshape(-1, self.d) for line in self.lines if line.kind != "way"]
        every = np.concatenate(places)
        return np.stack([every.min(axis=0), every.max(axis=0)])

    @property
    def faces(self) -> Array:
        """Point indices of the faces of all meshes, counted over all meshes, shape (n_faces, 4)."""
        firsts = np.cumsum([0, *(x.shape[1] for x in self.places)])
        faces = [mesh.faces + n for mesh, n in zip(self.meshes, firsts, strict=False)]
        return np.concatenate(faces)

    @property
    def limits(self) -> tuple[float, float]:
        """Limits of the colour scale, in the unit of the field.

        `asked` if given, else the smallest and the largest value, symmetric about zero for a signed
        field.
        """
        if self.asked is not None:
            return self.asked
        values = np.concatenate([np.zeros(0), *(x[np.isfinite(x)] for x in self.values)])
        if not len(values):
            return 0.0, 1.0
        low, high = float(values.min()), float(values.max())
        if self.field is not None and self.field.signed:
            high = max(abs(low), abs(high))
            low = -high
        # A constant field: a colour scale needs a span.
        return (low, high) if low < high else (low, low + (abs(low) or 1.0))


def mechanism(
    scene: Scene,
    motion: Solution | None,
    times: Sequence[float] | None,
    field: Field | None,
    limits: Sequence[float] | None = None,
) -> Mechanism:
    """Return a scene at `times` of a motion, s, or as declared without a motion.

    Raises InvalidInputError if the solution belongs to another scene, if the field cannot be
    computed from it, or if `limits` are not two increasing numbers given with a field.
    """
    require_kind("picture, scene", scene, (Scene,), "Give the Scene that was integrated.")
    if field is not None:
        require_kind("picture, colour", field, (Field,), "For example VonMisesStress().")
    asked = _span(limits, field)
    mapping, declared = parameter_map(scene, ()), _naming(scene)
    reference = Reference(scene, mapping, mapping.nominal, declared)
    if motion is None:
        if times is not None or field is not None:
            rule, repair = "times and colour need a motion", "Give the solution as well."
            raise InvalidInputError("picture", rule, "a scene alone", repair)
        motion = _at_rest(reference.Z.ravel(), declared)
    require_kind("picture, solution", motion, (Solution,), "Call simulate, or leave it out.")
    naming = _checked(motion, declared)
    motion = motion if times is None else motion.at(times)
    meshes = _meshes(scene, mapping, naming, motion.q.shape[1])
    symbols = Symbols(scene, naming, reference.q)
    return Mechanism(
        scene.dimension,
        motion,
        meshes,
        tuple(mesh.places(motion.q) for mesh in meshes),
        () if field is None else tuple(field.values(mesh, motion) for mesh in meshes),
        tuple(symbols.marks(motion)),
        tuple(symbols.lines(motion)),
        tuple(symbols.arrows(motion)),
        field,
        asked,
    )


def _span(limits: Sequence[float] | None, field: Field | None) -> tuple[float, float] | None:
    if limits is None:
        return None
    require_vector("picture, limits", limits, (2,))
    low, high = map(float, limits)
    if field is None or not low < high:
        rule = "must be two increasing numbers, those of a colour"
        got = f"{low} and {high}" + (" without a colour" if field is None else "")
        repair = "For example colour=VonMisesStress(), limits=(0, 1e8)."
        raise InvalidInputError("picture, limits", rule, got, repair)
    return low, high


def _naming(scene: Scene) -> SceneNaming:
    """Return the positions of bodies in the coordinates, without the cost of assembling."""
    numbering, masses = number(scene), tuple(mass.name for mass in scene.point_masses)
    layout = Layout(
        scene.dimension,
        numbering.bodies,
        numbering.beams,
        masses,
        (),
        numbering.controllers,
        numbering.sliders,
    )
    lengths = scene.element_parameters[:, ElementParameter.LENGTH]
    return SceneNaming(layout, lengths, np.zeros((len(lengths), 0)))


def _meshes(scene: Scene, mapping: ParameterMap, naming: SceneNaming, n_q: int) -> tuple[Mesh, ...]:
    numbering, parameters = number(scene), mapping.values(mapping.nominal)
    sections = BeamSections(scene, naming.layout, numbering, mapping, mapping.nominal)
    meshes: list[Mesh] = []
    for body in scene.members:
        if isinstance(body, RigidBody):
            meshes.append(RigidMesh(body, naming, n_q))
            continue
        place = naming.layout.beam(body.name), numbering, mapping, parameters, slice(None)
        elements = None if body.rigid else BeamElements(body, *place)
        meshes.append(BeamMesh(body, naming, n_q, elements, sections))
    return tuple(meshes)


def frames_of(motion: Solution, count: int) -> Array:
    """Return `count` equally spaced times of a whole motion, shape (count,); s."""
    require_kind("film, solution", motion, (Solution,), "Call simulate.")
    if len(motion.t) < 2:
        rule, repair = "needs a motion of several instants", "Use snapshots for a state of rest."
        raise InvalidInputError("film", rule, f"{len(motion.t)}", repair)
    return np.linspace(motion.t[0], motion.t[-1], count)


def _at_rest(q: Array, naming: SceneNaming) -> Solution:
    none, outcome = np.zeros((1, 0)), RunOutcome(Verdict.FINISHED, 0.0, 0, 0.0)
    still, statistics = np.zeros((1, len(q))), Statistics(0, 0, 0, 0, 0, 0.0)
    return Solution(np.zeros(1), q[None], still, still, none, statistics, outcome, naming)


def _checked(motion: Solution, declared: SceneNaming) -> SceneNaming:
    """Return the naming of a solution; raise InvalidInputError if it belongs to another scene.

    The element lengths must also be those of the scene.
    """
    given = motion.naming
    if not isinstance(given, SceneNaming):
        rule, repair = "must be that of an ANCF scene", "Other systems have no bodies to draw."
        raise InvalidInputError("picture, solution", rule, "a system of another kind", repair)
    vectors = [
        {body.name: (body.first_vector, body.count, body.kinks) for body in x.layout.bodies}
        for x in (given, declared)
    ]
    if vectors[0] != vectors[1] or len(given.lengths) != len(declared.lengths):
        raise InvalidInputError(
            "picture, solution",
            f"must be that of the scene, with the bodies {listed(vectors[1])}",
            f"one of {listed(vectors[0])}, or of other elements",
            "Give the scene that was integrated.",
        )
    if not np.allclose(given.lengths, declared.lengths, rtol=_SAME, atol=0.0):
        raise InvalidInputError(
            "picture, solution",
            "must be that of the scene at its design values",
            "elements of other lengths",
            "Give scene.with_values({...}) at the values of the solution.",
        )
    return given
