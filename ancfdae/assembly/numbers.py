"""Numbers of a scene at design values b, on a structure that does not depend on them.

A state x of a controller is the rate of a vector with a mass w, w x' = w f. The motion does not
depend on w, but norms of forces and velocities do, in which iterations and tolerances are measured.
With W the weights of the coordinates q of the mechanism, at the start,

    g = |Q_x|,   e = |f_q|,   d = |f_v|   in the norm of 1/W,

1/T is the largest of the rates |f_x|, (g d)^(1/2) and (g e)^(1/3): the rate of the state by itself,
and the rates of the loop that it closes with the mechanism. Then w = (g T)^2: sqrt(w) x is the
velocity, in the norm of W, that the forces of x cause in the time T. A state that acts on no axis
has w = 1/(e T^2)^2 or 1/(d T)^2, from its input; a state coupled to other states only gets its mass
from theirs by f_x. The unit of w is an energy over x^2, so that units and positions do not matter.
If all these partials are zero at the start, as for an effort with the square of a state that starts
from zero, w = (l / (T X))^2 with the size l of the mechanism in the norm of W and the size X of the
state, the largest of |x|, T |f| and T^2 |f_t|. If all those rates are zero, 1/T is |f_t| / |f|.

The structure holds sizes, numbering and sparsity patterns. Numbers hold positions, forces, masses
and the start, in groups. At other design values a group that depends on none of the changed
variables is reused with everything that it has computed (Young's modulus leaves joints and the
assembled start unchanged); the other groups are computed again on the same structure.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.assembly import AssembledStart
from ancfdae.assembly.block import WEIGHTLESS, ElementBlock, ElementForms
from ancfdae.assembly.constraints import JointConstraints
from ancfdae.assembly.elastic_forces import ElasticForces, ElementPlaces
from ancfdae.assembly.geometry import Geometry
from ancfdae.assembly.inertia import (
    Inertia,
    KnownMasses,
    MassBlocks,
    MassPartials,
    MassPlaces,
    TurningForces,
    of_states,
    other_masses,
)
from ancfdae.assembly.joint_structure import JointStructure
from ancfdae.assembly.layout import Layout
from ancfdae.assembly.load_forces import LoadForces, LoadInput
from ancfdae.assembly.numbering import Numbering, number
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.model.design import DesignVariable
from ancfdae.model.elements import ElementParameter
from ancfdae.model.parts import Elements
from ancfdae.model.scene import Scene
from ancfdae.model.scene_design import SCENE
from ancfdae.model.sections.section import central_moments
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.patterns import SparsityPattern

# Elements longer than this multiple of the radius of gyration (14 heights of a rectangle) can miss
# 2 % of a deflection by membrane locking before they turn by a radian (docs/measurements.md).
_SLENDER = 50.0


@np.errstate(all="ignore")
def state_masses(item: LoadInput, weights: Array, size: float) -> Array:
    """Return the masses of the vectors of the states of a load, shape (n_states,).

    They are one if all partials and rates vanish, or if numbers overflow. `weights` belong to the
    coordinates of the mechanism, (n_q,), and `size` is its size in their norm.
    """
    n = len(item.masses)
    Q_x, f_q, f_v, f_x = _partials(item)
    of_coordinates = (np.sqrt(np.sum(x**2 / weights, axis=1)) for x in (Q_x, f_q, f_v))
    g, e, d = of_coordinates
    rates = np.max([np.abs(np.diag(f_x)), np.sqrt(g * d), np.cbrt(g * e)], axis=0)
    x, f, f_t = _first_rates(item)
    of_time = np.where((rates == 0) & (np.abs(f) > 0), np.abs(f_t / f), 0.0)
    rates = np.where(rates > 0, rates, np.max(rates) or of_time)
    T = 1 / np.where(rates > 0, rates, 1.0)
    root = g * T
    for from_input in (1 / _or_infinite(e * T**2), 1 / _or_infinite(d * T)):
        root = np.where(root > 0, root, from_input)
    # From states coupled to the mechanism on to states coupled to these.
    for _ in range(n):
        for j, k in np.argwhere((root[:, None] == 0) & (root > 0)).tolist():
            out, into = abs(f_x[k, j]) * T[k], abs(f_x[j, k]) * T[j]
            root[j] = root[j] or (root[k] * out if out else root[k] / into if into else 0.0)
    expected = np.max(np.abs([x, T * f, T**2 * f_t]), axis=0)
    root = np.where(root > 0, root, size / _or_infinite(T * expected))
    masses = root**2
    return np.where((masses > 0) & np.isfinite(masses), masses, 1.0)


def _or_infinite(x: Array) -> Array:
    return np.where(x > 0, x, np.inf)


def _first_rates(item: LoadInput) -> tuple[Array, Array, Array]:
    """Return the states, their rates f, and the partials f_t in time at t = 0, (n,) each."""
    U, V, first = _at_start(item)
    signals, rates = (item.factors(np.zeros(1), k)[0, 1:] for k in (0, 1))
    F = item.force(U + 0j, V + 0j, signals + 1j * STEP * rates)[first:, 0]
    return V[first:, 0], F.real, F.imag / STEP


def _at_start(item: LoadInput) -> tuple[Array, Array, int]:
    """Return U in the reference, V with rates of states only, and the first state's index."""
    U = item.reference.real
    first, V = len(U) - len(item.masses), np.zeros_like(U)
    V[first:, 0] = np.real(item.load.initial_states(item.p.real))
    return U, V, first


def _partials(item: LoadInput) -> tuple[Array, Array, Array, Array]:
    """Return Q_x, f_q and f_v, (n, n_q) each, and f_x, (n, n), at t = 0.

    The mechanism is in its reference configuration; masses in `item` are one.
    """
    n, (U, V, first) = len(item.masses), _at_start(item)
    signals, lift = item.factors(np.zeros(1), 0)[0, 1:], item.vectors.lift
    steps = 1j * STEP * np.eye(U.size).reshape(-1, *U.shape)
    F_U, F_V = (
        np.imag(item.force(*moved, signals)) / STEP
        for moved in ((U + steps, V + 0 * steps), (U + 0 * steps, V + steps))
    )
    rates = F_U[:, first:, 0].T.reshape(n, *U.shape), F_V[:, first:, 0].T.reshape(n, *U.shape)
    mechanism = np.arange(len(U))[:, None] < first
    of_states = F_V.reshape(*U.shape, *U.shape)[first:, 0]
    f_q, f_v = (lift(x * mechanism) for x in rates)
    return lift(of_states * mechanism), f_q, f_v, of_states[:, first:, 0].T


@final
@dataclass(frozen=True, eq=False)
class Structure:
    """The parts of a system that do not depend on design values: sizes, patterns, numbering.

    `soft` maps the design to the flexible elements, which have `forms` and the indices `places` in
    the pattern. `constraint_names` are the joints of the equations, `reach` is the largest
    coordinate, in m, of a position on the ground that a load refers to. `slender` is whether an
    element is more than _SLENDER times as long as the radius of gyration of its section at the
    declared design. `masses` caches masses of rigid bodies, rigid beams and point masses.
    """

    scene: Scene
    design: tuple[DesignVariable, ...]
    mapping: ParameterMap
    numbering: Numbering
    layout: Layout
    soft: ParameterMap
    forms: ElementForms
    pattern: SparsityPattern
    places: ElementPlaces
    constraint_names: tuple[str, ...]
    reach: float
    slender: bool
    masses: KnownMasses = field(default_factory=dict)

    @staticmethod
    def of(
        scene: Scene,
        design: tuple[DesignVariable, ...],
        mapping: ParameterMap,
        numbering: Numbering,
        layout: Layout,
        parts: tuple[JointStructure, Sequence[LoadInput]],
    ) -> Structure:
        """Return the structure of a scene with these joints and loads."""
        joints, loads = parts
        # Entries of elements and rigid bodies, curvature of joints, tangents of loads.
        moving = [item.couplings for item in loads if not item.load.constant]
        bodies = numbering.couplings(scene.frame is not None)
        entries = zip(bodies, joints.couplings, *moving, strict=True)
        pattern = SparsityPattern((numbering.n_q, numbering.n_q), *map(np.concatenate, entries))
        places = ElementPlaces.of(numbering, pattern)
        layout = replace(layout, joints=joints.joints)
        soft = mapping.only(numbering.elements)
        beams = [beam for beam in scene.beams if not beam.rigid]
        forms = ElementForms.of(numbering.widest, beams, soft)
        names = tuple(joint.name for joint in layout.joints for _ in range(joint.rows))
        of_ground = (
            abs(value)
            for load in scene.loads
            for name, value in load.parameters().items()
            if name.startswith(("ground_", "obstacle_place_", "start_", "end_", "pulley_"))
        )
        reach = max(of_ground, default=0.0)
        slender = False
        for k, (_, kind) in enumerate(forms.kinds):
            own = soft.base[forms.kind == k]
            y, z, dA = kind.section.points(kind.sizes(own), False)
            radii = central_moments(y, z, dA)[1] / np.sum(dA, axis=1, keepdims=True)
            lengths = own[:, ElementParameter.LENGTH, None]
            slender |= bool(np.any(lengths**2 > _SLENDER**2 * radii[:, : numbering.d - 1]))
        grid = pattern, places, names
        return Structure(
            scene, design, mapping, numbering, layout, soft, forms, *grid, reach, slender
        )

    def reaches(self, owners: Iterable[str]) -> Array:
        """Return which design variables drive parameters of these owners, bool, (n_b,)."""
        reached = np.zeros(len(self.design), dtype=bool)
        for owner in owners:
            reached[[slot[1] for slot in self.mapping.slots.get(owner, ())]] = True
        return reached

    @cached_property
    def reaches_parts(self) -> Array:
        """Whether each design variable drives a joint or load, shape (n_b,)."""
        return self.reaches(part.name for part in (*self.scene.joints, *self.scene.loads))

    def reaches_geometry(self, geometry: Geometry) -> Array:
        """Return which design variables change the reference geometry, bool, (n_b,)."""
        reached = self.reaches_parts.copy()
        reached[geometry.reference.active] = True
        return reached

    @cached_property
    def reaches_elements(self) -> Array:
        """Whether each design variable drives flexible elements, shape (n_b,)."""
        return np.bincount(self.soft.variables, minlength=len(self.design)) > 0

    @cached_property
    def reaches_masses(self) -> Array:
        """Whether masses, gravity or frame may depend on each design variable, shape (n_b,)."""
        pairs = ~WEIGHTLESS[self.mapping.parameters]
        heavy = np.bincount(self.mapping.variables[pairs], minlength=len(self.design)) > 0
        owners = (*self.scene.members, *self.scene.point_masses)
        return heavy | self.reaches([SCENE, *(owner.name for owner in owners)])


@final
@dataclass(frozen=True, eq=False)
class Numbers:
    """All numeric data of a scene at design values b, real or complex."""

    structure: Structure
    b: Array
    geometry: Geometry
    constraints: JointConstraints
    loads: LoadForces
    start: AssembledStart
    block: ElementBlock
    elastic: ElasticForces
    inertia: Inertia
    turning: TurningForces | None

    @staticmethod
    def first(
        scene: Scene,
        design: tuple[DesignVariable, ...],
        mapping: ParameterMap,
        b: Array,
        numbering: Numbering | None = None,
        elements: Elements | None = None,
    ) -> Numbers:
        """Return the numbers of a scene, with the structure that other designs will share.

        The `numbering` holds masses of states; by default they are computed from the mechanism. The
        `elements` hold pairs of contact loads; by default they are the ones of the scene.
        """
        if numbering is None:
            numbering = number(scene)
            if numbering.controllers:
                of_one = Numbers.first(scene, design, mapping, b.real, numbering)
                loads, weights = of_one.geometry.loads, of_one.inertia.weights
                size = numbering.size(weights)
                found = [state_masses(item, weights, size) for item in loads if len(item.masses)]
                of_joints = numbering.masses[: len(numbering.masses) - numbering.controlled]
                numbering = replace(numbering, masses=np.concatenate([of_joints, *found]))
        masses = tuple(mass.name for mass in scene.point_masses)
        bodies = numbering.bodies, numbering.beams
        layout = Layout(numbering.d, *bodies, masses, (), numbering.controllers, numbering.sliders)
        geometry = Geometry.of(elements or scene.elements, scene, layout, numbering, mapping, b)
        parts = geometry.joints, geometry.loads
        structure = Structure.of(scene, design, mapping, numbering, layout, parts)
        # With the layout of the joints, which was not known before.
        geometry = replace(geometry, naming=replace(geometry.naming, layout=structure.layout))
        block = structure.forms.at(b)
        elastic = ElasticForces(block, structure.places, structure.soft, len(b))
        fixed = _placed(structure, geometry, b)
        return Numbers(
            structure, b, geometry, *fixed, block, elastic, *_masses(structure, geometry, block, b)
        )

    def at(self, b: Array) -> Numbers | None:
        """Return the numbers at other design values; None if the structure changes."""
        structure, geometry = self.structure, self.geometry
        # Numbers are real or complex as b is.
        other_kind, moved = np.iscomplexobj(b) != np.iscomplexobj(self.b), b != self.b

        def changes(reached: Array) -> bool:
            return bool(other_kind or (moved & reached).any())

        fixed = self.constraints, self.loads, self.start
        displaced = changes(structure.reaches_geometry(geometry))
        if displaced:
            changed = geometry.at(b)
            if changed is None:
                return None
            geometry, fixed = changed, _placed(structure, changed, b)
        block, elastic = self.block, self.elastic
        if changes(structure.reaches_elements):
            block = structure.forms.at(b)
            elastic = ElasticForces(block, structure.places, structure.soft, len(b))
        masses = self.inertia, self.turning
        if displaced or changes(structure.reaches_masses):
            masses = _masses(structure, geometry, block, b, self.inertia.places)
        return Numbers(structure, b, geometry, *fixed, block, elastic, *masses)


def _placed(
    structure: Structure, geometry: Geometry, b: Array
) -> tuple[JointConstraints, LoadForces, AssembledStart]:
    """Return constraints, loads and start, which depend on the reference geometry."""
    pattern, mapping, n_b = structure.pattern, structure.mapping, len(b)
    curved = pattern.index(*geometry.joints.couplings)
    constraints = JointConstraints(geometry.joints, curved, pattern.size, n_b)
    moved = b.real != mapping.nominal
    displaced = bool(moved.any() and moved[structure.reaches_geometry(geometry)].any())
    start = AssembledStart(
        structure.scene,
        structure.numbering,
        mapping,
        geometry.reference,
        constraints,
        pattern,
        b,
        displaced,
    )
    return constraints, LoadForces(geometry.loads, pattern, n_b), start


def _masses(
    structure: Structure,
    geometry: Geometry,
    block: ElementBlock,
    b: Array,
    places: MassPlaces | None = None,
) -> tuple[Inertia, TurningForces | None]:
    """Return inertia with gravity, and the forces of a rotating frame; None without a frame."""
    scene, numbering, n_b, d = structure.scene, structure.numbering, len(b), structure.numbering.d
    p, p_b = structure.mapping.numbers("scene", b)
    gravity, frame = (np.zeros(d), np.zeros((d, n_b))), (p, p_b)
    if scene.gravity is not None:
        gravity, frame = (p[:d], p_b[:d]), (p[d:], p_b[d:])
    others: tuple[MassBlocks, ...] = ()
    if numbering.rigid.any() or scene.point_masses:
        others = other_masses(scene, geometry.naming, structure.mapping, b, structure.masses)
    soft, pairs = structure.soft, block.mass_pairs
    of_pairs = soft.elements[pairs], soft.variables[pairs]
    derivative = lambda: MassPartials(*of_pairs, block.partials.m_b)  # noqa: E731
    blocks = (MassBlocks(numbering.vectors, block.m, numbering.owners, derivative), *others)
    if len(numbering.masses):
        blocks = (*blocks, of_states(numbering))
    inertia = Inertia(blocks, numbering, n_b, structure.pattern, gravity, places)
    turns = scene.frame
    return inertia, turns and TurningForces(turns, frame, inertia, structure.pattern)
