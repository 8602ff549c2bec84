"""The ANCF assembler: the only place where a scene becomes M, Q, Phi and their partials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import final

import numpy as np

from ancfdae.ancf.assembly import Assembly, Declared
from ancfdae.ancf.beam_elements import BeamElements
from ancfdae.ancf.block import element_block
from ancfdae.ancf.constraints import JointConstraints, JointInput
from ancfdae.ancf.elastic_forces import ElasticForces
from ancfdae.ancf.held_angles import HeldAngles
from ancfdae.ancf.inertia import Inertia
from ancfdae.ancf.joint_work import JointWork, at_unit_rate
from ancfdae.ancf.load_forces import LoadForces, LoadInput
from ancfdae.ancf.load_work import LoadWork
from ancfdae.ancf.mass_blocks import element_masses, other_masses
from ancfdae.ancf.numbering import number
from ancfdae.ancf.parameters import ParameterMap, parameter_map
from ancfdae.ancf.reference import Reference
from ancfdae.ancf.rigidity import Rigidity
from ancfdae.ancf.section_force import SectionForces
from ancfdae.ancf.stress_points import StressPoints
from ancfdae.ancf.vectors import Vectors
from ancfdae.bodies import Point
from ancfdae.design import DesignVariable, as_design
from ancfdae.elements import ElementParameter
from ancfdae.errors import InconsistentStart, InvalidInput, UnknownName, require_kind
from ancfdae.joints import DrivenJoint
from ancfdae.loads import Load
from ancfdae.naming import Layout, Naming, PointVector
from ancfdae.numerics.arrays import STEP, Array, only
from ancfdae.numerics.patterns import Pattern
from ancfdae.parts import CentreLine, Direction, Part
from ancfdae.protocol.system import DesignPartials, Linearisation, MechanicalSystem
from ancfdae.scene import Scene
from ancfdae.statics import RestingStart
from ancfdae.text import listed

# Places along every element where the largest stress is looked for: bending moments are linear in
# them, or nearly.
_STRESS_PLACES = np.array([0.0, 0.5, 1.0])


def assemble(scene: Scene, design: Sequence[str | DesignVariable] = ()) -> AncfSystem:
    """Turn a scene into a mechanical system with the given design variables.

    Parameters
    ----------
    scene : Scene
    design : sequence of str or DesignVariable
        Design variables, in the order of the last axis of every sensitivity.

    Raises
    ------
    InvalidInput, UnknownName
        If a design variable does not fit the scene.
    """
    require_kind("scene", scene, (Scene,), "Call Scene(...).")
    variables = as_design(design)
    mapping = parameter_map(scene, variables)
    return AncfSystem(scene, variables, mapping, mapping.nominal)


@final
class AncfSystem(MechanicalSystem):
    """A scene at given values of its design variables; made by `assemble`.

    Parameters
    ----------
    scene : Scene
    design : tuple of DesignVariable
    mapping : ParameterMap
    b : array, shape (n_b,)
        Values of the design variables, real or complex. Everything that depends on them is
        computed in their dtype.

    Attributes
    ----------
    naming : Naming
        Where beams and joints stand in q and lam, and the element lengths.
    """

    naming: Naming

    def __init__(
        self,
        scene: Scene,
        design: tuple[DesignVariable, ...],
        mapping: ParameterMap,
        b: Array,
    ) -> None:
        self._scene, self._design, self._mapping, self.b = scene, design, mapping, np.asarray(b)
        self.n_b = len(design)
        self.design_names = tuple(variable.name for variable in design)
        self.project_start = scene.project_start
        parameters = mapping.values(self.b)
        self._numbering = number(scene)
        self.element, self.n_q = self._numbering.element, self._numbering.n_q
        lengths = parameters[:, ElementParameter.LENGTH]
        masses = tuple(mass.name for mass in scene.point_masses)
        numbering = self._numbering
        layout = Layout(self.element.name, numbering.bodies, numbering.beams, masses, ())
        self.naming = Naming(layout, lengths, mapping.lengths_b(self.n_b))
        self._reference = Reference(scene, mapping, self.b, self.naming)
        self._constraints = self._joint_constraints()
        self._loads = self._load_forces()
        self.pattern = self._joint_pattern()
        self._constraints.place_curvature(self.pattern)
        self._loads.place(self.pattern)
        soft = mapping.only(self._numbering.elements)
        beams = [beam for beam in scene.beams if not beam.rigid]
        block = element_block(self.element, beams, soft, soft.values(self.b))
        self._elastic = ElasticForces(block, self._numbering, soft, self.n_b, self.pattern)
        others = other_masses(scene, self.naming, mapping, self.b)
        blocks = (element_masses(self._numbering, soft, block), *others)
        self._inertia = Inertia(blocks, self._numbering, self.n_b, self.pattern, self._gravity())
        self._describe()
        # What observables have asked for, prepared once.
        self._section_forces: dict[Point, SectionForces] = {}
        self._stresses: dict[Point | str, StressPoints] = {}
        self._load_works: dict[str, LoadWork] = {}
        self._joint_works: dict[tuple[str, bool], JointWork] = {}

    def __repr__(self) -> str:
        """Return sizes, scene and values of the design variables."""
        own = listed(f"{name} = {b:.6g}" for name, b in zip(self.design_names, self.b, strict=True))
        sizes = f"{self.n_q} coordinates, {self.n_lam} multipliers"
        return f"AncfSystem: {sizes}\n{self._scene}\ndesign variables: {own}"

    # -- preparation ---------------------------------------------------------------------------

    def _joint_constraints(self) -> JointConstraints:
        d, inputs, points = self.element.d, [], []
        bodies = zip(self._numbering.bodies, self._numbering.rigid, strict=True)
        rigidities = [Rigidity(body.name) for body, rigid in bodies if rigid]
        held = HeldAngles(self.naming.layout, {item.beam for item in rigidities})
        for joint in (*self._scene.joints, *rigidities):
            own, p, p_b = self._part_input(joint)
            reference = self._in_reference(Vectors(own, d, self.n_q, self.n_b))
            inputs.append(JointInput(joint, p, p_b, *reference).shaped(held))
            points += own
        vectors = Vectors(points, d, self.n_q, self.n_b)
        return JointConstraints(inputs, vectors, self.n_b, d)

    def _load_forces(self) -> LoadForces:
        inputs = [self._load_input(load) for load in self._scene.loads]
        return LoadForces(inputs, self.n_q, self.n_b, self.element.d)

    def _load_input(self, load: Load) -> LoadInput:
        own, p, p_b = self._part_input(load)
        vectors = Vectors(own, self.element.d, self.n_q, self.n_b)
        reference, reference_b = self._in_reference(vectors)
        used = reference_b if load.refers else {}
        return LoadInput(load, vectors, p, p_b, reference, used)

    def _in_reference(self, vectors: Vectors) -> tuple[Array, dict[int, Array]]:
        """Return vectors in the reference configuration, and their partials that are not zero."""
        q_o, active = self._reference.q, self._reference.active
        reference, along = vectors.of(q_o[None])[0], vectors.of_b(q_o[None])[0]
        if active:
            q_ob = np.array([self._reference.moved(i).q.imag / STEP for i in active])
            along[..., active] += np.moveaxis(vectors.of(q_ob), 0, -1).real
        moving = np.flatnonzero(np.any(along, axis=(0, 1)))
        return reference, {int(i): along[..., i] for i in moving}

    def _part_input(self, part: Part) -> tuple[list[PointVector], Array, Array]:
        """Return vectors of a joint or load, and values and partials of its design fields."""
        p, p_b = self._mapping.numbers(part.name, self.b)
        count = len(part.parameters())
        places, first = {}, count
        for point in part.points:
            last = first + len(point.numbers())
            places[point] = (p[first:last], p_b[first:last])
            first = last
        own = []
        for vector in part.vectors(self.element):
            if isinstance(vector, CentreLine):
                own.append(self.naming.centre_line(vector.beam))
            elif isinstance(vector, Direction):
                own.append(self.naming.direction(vector.body, vector.number))
            else:
                point, quantity = vector
                own.append(self.naming.vector(point, quantity, places[point]))
        return own, p[:count], p_b[:count]

    def _gravity(self) -> tuple[Array, Array]:
        g, g_b = self._mapping.numbers("scene", self.b)
        d = self.element.d
        return (g, g_b) if len(g) else (np.zeros(d), np.zeros((d, self.n_b)))

    def _joint_pattern(self) -> Pattern:
        """Pattern of everything: elements, rigid bodies, curvature of joints, tangents of loads."""
        numbering = self._numbering
        size = self.element.n_a * self.element.d
        own = numbering.coordinates(numbering.vectors).reshape(-1, size)
        rows, columns = np.broadcast_arrays(own[:, :, None], own[:, None, :])
        frames = numbering.coordinates(numbering.frames)
        body_rows, body_columns = np.broadcast_arrays(frames[:, :, None], frames[:, None])
        joint_rows, joint_columns, _, _ = self._constraints.couplings()
        load_rows, load_columns = self._loads.couplings()
        return Pattern(
            (self.n_q, self.n_q),
            np.concatenate([rows.ravel(), body_rows.ravel(), joint_rows, load_rows]),
            np.concatenate([columns.ravel(), body_columns.ravel(), joint_columns, load_columns]),
        )

    def _describe(self) -> None:
        self.n_lam = self._constraints.n_lam
        self.constraint_pattern = self._constraints.pattern
        self.constant_mass = True
        self.linear_constraints = self._constraints.linear
        self.velocity_forces = self._elastic.damped or self._loads.uses_velocity
        self.weights = self._inertia.weights
        self.force_round_off = self._elastic.round_off(self._reference.Z.ravel(), self.weights)
        joints = self._constraints.joints
        self.naming = replace(self.naming, layout=replace(self.naming.layout, joints=joints))
        self.constraint_names = tuple(joint.name for joint in joints for _ in range(joint.rows))

    # -- the protocol --------------------------------------------------------------------------

    def with_values(self, b: Array) -> AncfSystem:
        """Return the same scene at other design values, real or complex.

        Raises
        ------
        InvalidInput
            If there are not n_b values, or one is not admissible.
        """
        b = np.asarray(b)
        if b.shape != (self.n_b,):
            raise InvalidInput(
                "design values", f"must have shape ({self.n_b},)", b.shape, "One per variable."
            )
        if np.any(b.real != self.b.real):
            self._scene.check_values(self._design, b.real.tolist())
        return AncfSystem(self._scene, self._design, self._mapping, b)

    @cached_property
    def _rest(self) -> RestingStart | None:
        """The equilibrium that the motion starts from: of the same scene under other loads."""
        scene = self._scene.at_rest()
        if scene is None:
            return None
        mapping, rest = self._mapping, self._scene.rest
        if rest is not None and rest.gravity is not None:
            mapping = mapping.holding("scene", rest.gravity)
        return RestingStart(AncfSystem(scene, self._design, mapping, self.b))

    def start(self) -> tuple[Array, Array]:
        """Return the declared start, or the equilibrium."""
        if self._rest is not None:
            return self._rest.q, np.zeros_like(self._rest.q)
        if not self.project_start:
            self._assembly.require_closed()
        return self._assembly.q, self._assembly.v

    def start_b(self) -> tuple[Array, Array]:
        """Return the partials of the start."""
        q_b, v_b = np.zeros((2, self.n_q, self.n_b))
        if self._rest is not None:
            return self._rest.q_b, v_b
        for i, (along_q, along_v) in self._start_along.items():
            q_b[:, i], v_b[:, i] = along_q, along_v
        return q_b, v_b

    def start_pull_back(self, on_q: Array, on_v: Array) -> Array:
        """Contract over the variables that move the start."""
        if self._rest is not None:
            return self._rest.pull_back(on_q)
        total = np.zeros(self.n_b)
        for i, (along_q, along_v) in self._start_along.items():
            total[i] = on_q @ along_q + on_v @ along_v
        return total

    @cached_property
    def _assembly(self) -> Assembly:
        """The start: bodies follow the joints where asked to, and where the design has moved."""
        motions, scene = self._numbering.rigid_motions(), self._scene
        free = np.ones(motions.none.shape, dtype=bool)
        names = [member.name for member in scene.members]
        for name in scene.lead:
            free[names.index(name), self.element.d :] = False
        bodies = self._numbering.bodies
        places = self._reference.Z.real[np.concatenate([body.positions for body in bodies])]
        extent = np.linalg.norm(np.ptp(places, axis=0)) + max(body.size for body in bodies)
        # A power of two, so that a small change of the design leaves it as it is.
        size = 2.0 ** np.round(np.log2(extent))
        follows = scene.assemble or scene.project_start
        moves = follows or np.any(self.b.real != self._mapping.nominal)
        declared = self._declared(None)
        strains = scene.project_start
        return Assembly(motions, self.pattern, free, declared, size, bool(moves), strains)

    def _declared(self, i: int | None) -> Declared:
        """Return what is declared, moved in design variable i by an imaginary step."""
        joints, reference = self._constraints, self._reference
        if i is not None:
            joints, reference = joints.moved(i), reference.moved(i)
        return Declared(joints, reference.Z, reference.velocities)

    @cached_property
    def _start_along(self) -> dict[int, tuple[Array, Array]]:
        """Derivatives of q and v of the start, of the variables that move it."""
        active = sorted({*self._reference.active, *self._constraints.active})
        return {i: self._follow(i) for i in active}

    def _follow(self, i: int) -> tuple[Array, Array]:
        """Differentiate the assembly in design variable i; refuse what no rigid motion follows."""
        declared = self._declared(i)
        along = self._assembly.along(declared)
        joint = self._assembly.follows(declared, along[0], float(self.b[i].real))
        if joint is None:
            return along
        if self.project_start:
            return self._assembly.strained_along(declared)
        raise InconsistentStart(
            f"design variable {self.design_names[i]!r}",
            "rigid motions of the bodies must follow it",
            f"joint {joint!r}, which they leave open",
            "Set project_start=True to strain the bodies, or choose another variable.",
        )

    def mass(self, q: Array) -> Array:
        """M (eq. 10)."""
        return self._inertia.values

    def mass_times(self, q: Array, x: Array) -> Array:
        """M x."""
        return self._inertia.times(x)

    def mass_b_times(self, q: Array, a: Array) -> Array:
        """(M a)_b."""
        return only(self._inertia.times_b(a[None]))

    def force(self, q: Array, v: Array, t: float) -> Array:
        """Q: gravity, elastic and damping forces, loads (eqs. 11-13)."""
        Q = self._inertia.gravity + self._elastic.force(q, v)
        if self._scene.loads:
            Q = Q + self._loads.force(q[None], v[None], np.array([t]))[0]
        return Q

    def force_q(self, q: Array, v: Array, t: float) -> Array:
        """Q_q (eq. 19)."""
        return only(self._tangents(q[None], v[None], np.array([t]))[0])

    def force_v(self, q: Array, v: Array, t: float) -> Array:
        """Q_v."""
        Q_v = self._tangents(q[None], v[None], np.array([t]))[1]
        return np.zeros(self.pattern.size) if Q_v is None else Q_v[0]

    def force_b(self, q: Array, v: Array, t: float) -> Array:
        """Q_b (eqs. 24, 25)."""
        return only(self._forces_b(q[None], v[None], np.array([t])))

    def force_total(self, q: Array, v: Array, t: float, q_b: Array, v_b: Array) -> Array:
        """Total design derivative of Q."""
        total = self._elastic.force_total(q, v, q_b, v_b) + self._inertia.gravity_b
        if self._scene.loads:
            total = total + self._loads.force_total(q, v, np.array([t]), q_b, v_b)
        return total

    def following_load(self, q: Array, t: float) -> Array:
        """Follower forces and moments."""
        return self._loads.following(q, np.array([t]))

    def following_load_q(self, q: Array, t: float) -> Array:
        """Their tangents."""
        values = np.zeros((1, self.pattern.size), dtype=np.result_type(q, self.b, float))
        self._loads.add_following_tangents(q, np.array([t]), values)
        return only(values)

    def force_rate(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Q_q v + Q_v a + Q_t."""
        rate = self._elastic.force_rate(q, v, a)
        if self._scene.loads:
            rate = rate + self._loads.force_rate(q[None], v[None], a[None], np.array([t]))[0]
        return rate

    def force_rate_total(
        self, q: Array, v: Array, a: Array, t: float, q_b: Array, v_b: Array, a_b: Array
    ) -> Array:
        """Total design derivative of `force_rate`."""
        states, states_b = (q, v, a), (q_b, v_b, a_b)
        return self._force_rate_total(self._loads, states, t, states_b)

    def _force_rate_total(
        self, loads: LoadForces, states: Sequence[Array], t: float, states_b: Sequence[Array]
    ) -> Array:
        total = self._elastic.force_rate_total(states, states_b)
        return total + loads.force_rate_total(states, np.array([t]), states_b)

    def force_q_times(self, q: Array, x: Array, t: float) -> Array:
        """Q_q x at rest: the rate along a tiny velocity while laws of time stand still."""
        still, tiny = np.zeros_like(x), STEP * x
        rate = self._elastic.force_rate(q, tiny, still)
        held = self._loads.held.force_rate(q[None], tiny[None], still[None], np.array([t]))[0]
        return np.asarray((rate + held) / STEP)

    def force_q_times_total(self, q: Array, x: Array, t: float, q_b: Array) -> Array:
        """Total design derivative of Q_q x at rest."""
        still, none = np.zeros_like(x), np.zeros_like(q_b)
        states, states_b = (q, STEP * x, still), (q_b, none, none)
        return self._force_rate_total(self._loads.held, states, t, states_b) / STEP

    def force_q_times_q(self, q: Array, x: Array, t: float) -> Array:
        """(Q_q x)_q at rest: the rate of Q_q."""
        still, tiny = np.zeros_like(x), STEP * x
        Q_q, _ = self._elastic.tangent_rates(q, tiny, (tiny, still))
        if self._scene.loads:
            self._loads.held.add_tangent_rates((q, tiny, still), np.array([t]), Q_q, None)
        return only(Q_q) / STEP

    def pull_back_force_q_times(self, q: Array, x: Array, t: float, mu: Array) -> Array:
        """Contract forces pair by pair."""
        still, tiny = np.zeros_like(x), STEP * x
        total = self._elastic.pull_back_rate(q, tiny, (tiny, still), mu)
        if self._scene.loads:
            total = total + self._loads.held.pull_back_rate((q, tiny, still), np.array([t]), mu)
        return total / STEP

    def constraint(self, q: Array, t: float) -> Array:
        """Phi."""
        return self._constraints.constraint(q, t)

    def constraint_q(self, q: Array, t: float) -> Array:
        """Phi_q."""
        return self._constraints.constraint_q(q, t)

    def constraint_b(self, q: Array, t: float) -> Array:
        """Phi_b."""
        return only(self._constraints.constraints_b(q[None], np.array([t])))

    def constraint_force(self, q: Array, lam: Array, t: float) -> Array:
        """Phi_q^T lam."""
        return self._constraints.constraint_force(q, lam, t)

    def constraint_force_q(self, q: Array, lam: Array, t: float) -> Array:
        """(Phi_q^T lam)_q."""
        return only(self._constraints.constraint_force_q(lam[None], np.array([t])))

    def constraint_force_b(self, q: Array, lam: Array, t: float) -> Array:
        """(Phi_q^T lam)_b."""
        return only(self._constraints.constraint_forces_b(q[None], lam[None], np.array([t])))

    def constraint_q_times_total(self, q: Array, x: Array, t: float, q_b: Array) -> Array:
        """Total design derivative of Phi_q x."""
        return self._constraints.constraint_q_times_total(q, x, t, q_b)

    def constraint_q_rate(self, q: Array, v: Array, t: float) -> Array:
        """dPhi_q/dt."""
        return self._constraints.constraint_q_rate(t, q, v)

    def constraint_q_second_rate(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """d^2 Phi_q/dt^2."""
        return self._constraints.constraint_q_rate(t, q, v, a)

    def velocity_side(self, q: Array, t: float) -> Array:
        """-Phi_t."""
        return self._constraints.side(t, q)

    def velocity_side_total(self, q: Array, t: float, q_b: Array) -> Array:
        """Total design derivative of `velocity_side`."""
        return self._constraints.side_total(t, (q,), (q_b,))

    def acceleration_side(self, q: Array, v: Array, t: float) -> Array:
        """Right side of Phi_q a."""
        return self._constraints.side(t, q, v)

    def acceleration_side_total(
        self, q: Array, v: Array, t: float, q_b: Array, v_b: Array
    ) -> Array:
        """Total design derivative of `acceleration_side`."""
        return self._constraints.side_total(t, (q, v), (q_b, v_b))

    def jerk_side(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Right side of Phi_q q'''."""
        return self._constraints.side(t, q, v, a)

    def jerk_side_total(
        self, q: Array, v: Array, a: Array, t: float, q_b: Array, v_b: Array, a_b: Array
    ) -> Array:
        """Total design derivative of `jerk_side`."""
        return self._constraints.side_total(t, (q, v, a), (q_b, v_b, a_b))

    def constraint_force_rate(self, q: Array, v: Array, lam: Array, t: float) -> Array:
        """(dPhi_q^T/dt) lam."""
        return self._constraints.constraint_force_rate(q, v, lam, t)

    def constraint_force_rate_total(
        self, q: Array, v: Array, lam: Array, t: float, q_b: Array, v_b: Array, lam_b: Array
    ) -> Array:
        """Total design derivative of `constraint_force_rate`."""
        return self._constraints.constraint_force_rate_total(q, v, lam, t, q_b, v_b, lam_b)

    # -- many instants at once -----------------------------------------------------------------

    def linearise(self, t: Array, q: Array, v: Array, a: Array, lam: Array) -> Linearisation:
        """M, f_q, f_v and Phi_q."""
        Q_q, Q_v = self._tangents(q, v, t)
        f_q = -Q_q
        if not self.linear_constraints:
            f_q = f_q + self._constraints.constraint_force_q(lam, t)
        f_v = None if Q_v is None else -Q_v
        M = self._inertia.values[None]
        return Linearisation(M, f_q, f_v, self._constraints.constraints_q(q, t))

    def design_partials(self, t: Array, q: Array, v: Array, a: Array, lam: Array) -> DesignPartials:
        """Design partials of f and Phi."""
        f_b = self._inertia.times_b(a) - self._forces_b(q, v, t)
        f_b += self._constraints.constraint_forces_b(q, lam, t)
        return DesignPartials(f_b, self._constraints.constraints_b(q, t))

    def pull_back(
        self,
        t: Array,
        states: tuple[Array, Array, Array, Array],
        covectors: tuple[Array, Array],
    ) -> Array:
        """Contraction over pairs and active variables, without arrays of the size n_q n_b."""
        (q, v, a, lam), (mu, zeta) = states, covectors
        total = self._inertia.pull_back(a, mu) - self._elastic.pull_back(q, v, mu)
        total = total - self._loads.pull_back(q, v, t, mu)
        return np.asarray(total + self._constraints.pull_back(q, lam, t, mu, zeta))

    # -- rates for the transpose of the start --------------------------------------------------

    def constraint_q_third_rate(self, q: Array, v: Array, a: Array, jerk: Array, t: float) -> Array:
        """d^3 Phi_q/dt^3."""
        return self._constraints.constraint_q_rate(t, q, v, a, jerk)

    def constraint_rate_b(self, t: float, q: Array, *rates: Array) -> Array:
        """Return partials of constraint rates, of the variables that constraints depend on."""
        return self._constraints.rate_b(t, q, rates)

    def force_rate_partials(
        self, t: float, states: tuple[Array, ...], later: Array
    ) -> tuple[Array, Array, Array]:
        """f'_q = ((Phi_q^T)' lam)_q - (Q_q)', f'_v = f_q - (Q_v)'; M is constant."""
        q, v, a, lam = states
        Q_q, Q_v = self._elastic.tangent_rates(q, v, (v, later))
        if Q_v is None:
            Q_v = np.zeros_like(Q_q)
        if self._scene.loads:
            self._loads.add_tangent_rates((q, v, later), np.array([t]), Q_q, Q_v)
        f_q = self.linearise(np.array([t]), q[None], v[None], a[None], lam[None]).f_q
        turned = self._constraints.constraint_force_rate_q(lam, t)
        return turned - Q_q[0], only(f_q - Q_v), np.zeros(self.pattern.size)

    def pull_back_inertia(self, t: float, q: Array, a: Array, lam: Array, mu: Array) -> Array:
        """Contract masses pair by pair, joints for the variables they depend on."""
        none = np.zeros((1, len(lam)))
        reaction = self._constraints.pull_back(q[None], lam[None], np.array([t]), mu[None], none)
        return self._inertia.pull_back(a[None], mu[None], gravity=False) + reaction

    def pull_back_rate(self, t: float, states: tuple[Array, ...], later: Array, mu: Array) -> Array:
        """Contract forces pair by pair, the rest for the variables it depends on."""
        q, v, _, lam = states
        total = self._constraints.constraint_force_rate_pull_back(q, v, lam, t, mu)
        total = total - self._elastic.pull_back_rate(q, v, (v, later), mu)
        if self._scene.loads:
            total = total - self._loads.pull_back_rate((q, v, later), np.array([t]), mu)
        return total

    # -- driven joints and loads ---------------------------------------------------------------

    def joint_work(self, name: str, unit_rate: bool) -> JointWork:
        """Return what gives the power of a driven joint, or at a unit rate its torque or force.

        Raises
        ------
        InvalidInput
            If the joint is not driven: it does no work.
        """
        key = name, unit_rate
        if key not in self._joint_works:
            place = self.naming.layout.joint(name)
            found = [joint for joint in self._scene.joints if joint.name == name]
            if not found or not isinstance(found[0], DrivenJoint):
                rule, repair = "must be driven: others do no work", "Name a Drive or a Guide."
                raise InvalidInput(f"work of joint {name!r}", rule, "one that is not", repair)
            moving = at_unit_rate(found[0]) if unit_rate else found[0]
            own, p, p_b = self._part_input(moving)
            vectors = Vectors(own, self.element.d, self.n_q, self.n_b)
            item = JointInput(moving, p, p_b, *self._in_reference(vectors))
            common = (place.first_row, self.n_b, self.element.d)
            self._joint_works[key] = JointWork(item, vectors, *common)
        return self._joint_works[key]

    def load_work(self, name: str) -> LoadWork:
        """Return what gives the power of a load, or raise UnknownName."""
        if name not in self._load_works:
            loads = {load.name: load for load in self._scene.loads}
            if name not in loads:
                raise UnknownName("load", name, loads)
            self._load_works[name] = LoadWork(self._load_input(loads[name]), self.n_b)
        return self._load_works[name]

    # -- mass ----------------------------------------------------------------------------------

    @property
    def places(self) -> Array:
        """One for vectors that are positions, zero for slopes; shape (n_q / d,)."""
        return self._inertia.places

    # -- sections of beams ---------------------------------------------------------------------

    def section_forces(self, point: Point) -> SectionForces:
        """Return what gives the forces in the section at a point of a beam."""
        if point not in self._section_forces:
            self._section_forces[point] = SectionForces(*self._beam_element(point))
        return self._section_forces[point]

    def half_extents(self, point: Point) -> tuple[float, float]:
        """Return half of the height and of the width of the section at a point of a beam."""
        own, _ = self._beam_element(point)
        section, sizes = own.kind.section, own.kind.sizes(own.parameters)[0].real.tolist()
        names = section.size_names()
        return section.with_sizes(dict(zip(names, sizes, strict=True))).half_extents

    def stress_at(self, point: Point) -> StressPoints:
        """Return what gives the stress at a point of a beam."""
        if point not in self._stresses:
            own, xi = self._beam_element(point)
            y, z = np.full((1, 1), point.y), np.full((1, 1), point.z)
            places = partial(_held, (y, z))
            self._stresses[point] = StressPoints(own, np.array([xi]), places)
        return self._stresses[point]

    def stress_over(self, beam: str) -> StressPoints:
        """Return what gives stresses at the outer points of all sections of a beam."""
        if beam not in self._stresses:
            own = self._beam_elements(beam, slice(None))
            self._stresses[beam] = StressPoints(own, _STRESS_PLACES, own.outline)
        return self._stresses[beam]

    def _beam_element(self, point: Point) -> tuple[BeamElements, float]:
        """Return the element that a point lies in, and where."""
        element, xi = self.naming.layout.beam(point.beam).locate(point.fraction)
        return self._beam_elements(point.beam, slice(element, element + 1)), xi

    def _beam_elements(self, beam: str, elements: slice) -> BeamElements:
        place, values = self.naming.layout.beam(beam), self._mapping.values(self.b)
        body, mapping = self._scene.beam(beam), self._mapping
        if body.rigid:
            raise InvalidInput(
                f"beam {beam!r}",
                "must deform to have section forces and stresses",
                "a rigid one, which has no strain",
                "Leave out rigid=True, or ask for the reactions of its joints.",
            )
        return BeamElements(body, place, self._numbering, mapping, values, elements)

    # -- energies, instants as rows ------------------------------------------------------------

    def strain_energy(self, q: Array) -> Array:
        """Return the strain energy of every element that deforms at one instant, shape (n,)."""
        return only(self._elastic.energies(q[None]))

    def strain_energies(self, q: Array, beam: str | None = None) -> Array:
        """Return the strain energy of the scene or of one beam or body, shape (k,)."""
        energies: Array = self._elastic.energies(q) @ self._chosen(beam)
        return energies

    def strain_energies_q(self, q: Array, beam: str | None = None) -> Array:
        """Return the gradient of `strain_energies`, shape (k, n_q)."""
        return self._elastic.energy_q(q, self._chosen(beam))

    def strain_energies_b(self, q: Array, beam: str | None = None) -> Array:
        """Return the design partial of `strain_energies`, shape (k, n_b)."""
        return self._elastic.energy_b(q, self._chosen(beam))

    def kinetic_energies(self, v: Array, beam: str | None = None) -> Array:
        """Return the kinetic energy (eq. 9) of the scene, a beam, a body or a point mass, (k,)."""
        energies: Array = 0.5 * np.sum(v * self.kinetic_energies_v(v, beam), axis=1)
        return energies

    def kinetic_energies_v(self, v: Array, beam: str | None = None) -> Array:
        """Return the momenta M v, shape (k, n_q)."""
        if beam is None:
            return self._inertia.times(v.T).T
        return self._inertia.owner_times(v, self.naming.layout.owner(beam))

    def kinetic_energies_b(self, v: Array, beam: str | None = None) -> Array:
        """Return the design partial of `kinetic_energies`, shape (k, n_b)."""
        owner = None if beam is None else self.naming.layout.owner(beam)
        return 0.5 * self._inertia.quadratic_b(v, owner)

    def gravity_potential(self, q: Array) -> Array:
        """Return the potential of gravity at one instant, zero at q = 0."""
        return -np.asarray(self._inertia.gravity @ q)

    def _chosen(self, beam: str | None) -> Array:
        """One for the elements of a beam, or for all, that deform, shape (n,)."""
        owners = self._numbering.owners
        if beam is None:
            return np.ones(len(owners))
        return np.asarray(owners == self.naming.layout.owner(beam), dtype=float)

    def _tangents(self, q: Array, v: Array, t: Array) -> tuple[Array, Array | None]:
        Q_q, Q_v = self._elastic.force_q(q, v), None
        if self._elastic.damped:
            Q_v = self._elastic.force_v(q)
        elif self.velocity_forces:
            Q_v = np.zeros_like(Q_q)
        if self._scene.loads:
            self._loads.add_tangents(q, v, t, Q_q, Q_v)
        return Q_q, Q_v

    def _forces_b(self, q: Array, v: Array, t: Array) -> Array:
        Q_b = self._elastic.force_b(q, v) + self._inertia.gravity_b
        return Q_b + self._loads.force_b(q, v, t) if self._scene.loads else Q_b


def _held(places: tuple[Array, Array], parameters: Array) -> tuple[Array, Array]:
    """Places in a section that no parameter moves."""
    return places
