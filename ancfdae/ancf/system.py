"""The ANCF assembler: the only place where a scene becomes M, Q, Phi and their partials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.ancf.assembled_start import AssembledStart
from ancfdae.ancf.beam_sections import BeamSections
from ancfdae.ancf.block import element_block
from ancfdae.ancf.elastic_forces import ElasticForces
from ancfdae.ancf.energies import Energies
from ancfdae.ancf.inertia import Inertia
from ancfdae.ancf.load_forces import LoadForces
from ancfdae.ancf.mass_blocks import element_masses, other_masses
from ancfdae.ancf.numbering import number
from ancfdae.ancf.parameters import ParameterMap, parameter_map
from ancfdae.ancf.part_inputs import PartInputs
from ancfdae.ancf.reference import Reference
from ancfdae.ancf.works import Works
from ancfdae.design import DesignVariable, as_design
from ancfdae.elements import ElementParameter
from ancfdae.errors import InvalidInput, require_kind
from ancfdae.naming import Layout, Naming
from ancfdae.numerics.arrays import STEP, Array, only
from ancfdae.numerics.patterns import Pattern
from ancfdae.protocol.system import DesignPartials, Linearisation, MechanicalSystem
from ancfdae.scene import Scene
from ancfdae.statics import RestingStart
from ancfdae.text import listed


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
    energies : Energies
    sections : BeamSections
        Forces and stresses of beams.
    works : Works
        Power of driven joints and of loads.
    inputs : PartInputs
        What joints and loads are made of, and vectors of points in the reference.
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
        self.design_names = mapping.names
        self.project_start = scene.project_start
        parameters = mapping.values(self.b)
        self._numbering = number(scene)
        self.element, self.n_q = self._numbering.element, self._numbering.n_q
        lengths = parameters[:, ElementParameter.LENGTH]
        masses = tuple(mass.name for mass in scene.point_masses)
        numbering = self._numbering
        layout = Layout(self.element, numbering.bodies, numbering.beams, masses, ())
        self.naming = Naming(layout, lengths, mapping.lengths_b(self.n_b))
        self._reference = Reference(scene, mapping, self.b, self.naming)
        inputs = PartInputs(scene, numbering, self.naming, mapping, self._reference, self.b)
        self._constraints, self._loads = inputs.constraints(), inputs.forces()
        self.pattern = self._whole_pattern()
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
        layout = self.naming.layout
        self.energies = Energies(self._elastic, self._inertia, numbering, layout)
        self.sections = BeamSections(scene, layout, numbering, mapping, self.b)
        self.inputs, self.works = inputs, Works(scene, inputs, layout, self.n_b)
        start = mapping, self._reference, self._constraints, self.pattern, self.b
        self._start = AssembledStart(scene, numbering, *start)

    def __repr__(self) -> str:
        """Return sizes, scene and values of the design variables."""
        own = listed(f"{name} = {b:.6g}" for name, b in zip(self.design_names, self.b, strict=True))
        sizes = f"{self.n_q} coordinates, {self.n_lam} multipliers"
        return f"AncfSystem: {sizes}\n{self._scene}\ndesign variables: {own}"

    def _gravity(self) -> tuple[Array, Array]:
        g, g_b = self._mapping.numbers("scene", self.b)
        d = self.element.d
        return (g, g_b) if len(g) else (np.zeros(d), np.zeros((d, self.n_b)))

    def _whole_pattern(self) -> Pattern:
        """Pattern of everything: elements, rigid bodies, curvature of joints, tangents of loads."""
        joints, loads = self._constraints.couplings()[:2], self._loads.couplings()
        parts = zip(self._numbering.couplings(), joints, loads, strict=True)
        rows, columns = (np.concatenate(part) for part in parts)
        return Pattern((self.n_q, self.n_q), rows, columns)

    def _describe(self) -> None:
        self.n_lam = self._constraints.n_lam
        self.constraint_pattern = self._constraints.pattern
        self.constant_mass = True
        self.linear_constraints = self._constraints.linear
        self.constant_constraints = self._constraints.constant
        self.velocity_forces = self._elastic.damped or self._loads.uses_velocity
        # Damping of bodies turns with them: -(D(q) v)_q is not symmetric; nor are loads that move.
        self.symmetric = not (self._elastic.damped or self._loads.moving)
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
            # Refuses values that a part cannot take.
            self._scene.with_values(dict(zip(self._design, b.real.tolist(), strict=True)))
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
        return self._started

    @cached_property
    def _started(self) -> tuple[Array, Array]:
        if self._rest is not None:
            return self._rest.q, np.zeros_like(self._rest.q)
        return self._start.state()

    def start_b(self) -> tuple[Array, Array]:
        """Return the partials of the start."""
        if self._rest is not None:
            return self._rest.q_b, np.zeros_like(self._rest.q_b)
        return self._start.state_b()

    def start_pull_back(self, on_q: Array, on_v: Array) -> Array:
        """Contract over the variables that move the start."""
        if self._rest is not None:
            return self._rest.pull_back(on_q)
        return self._start.pull_back(on_q, on_v)

    def mass(self, q: Array) -> Array:
        """M (eq. 10)."""
        return self._inertia.values

    def mass_times(self, q: Array, x: Array) -> Array:
        """M x."""
        return self._inertia.times(x)

    def mass_b_times(self, q: Array, a: Array) -> Array:
        """(M a)_b."""
        return self._inertia.times_b(a)

    def force(self, q: Array, v: Array, t: float) -> Array:
        """Q: gravity, elastic and damping forces, loads (eqs. 11-13)."""
        Q = self._inertia.gravity - self._elastic.internal(q, v)
        if self._scene.loads:
            Q = Q + self._loads.force(q[None], v[None], np.array([t]))[0]
        return Q

    def force_q(self, q: Array, v: Array, t: float) -> Array:
        """Q_q (eq. 19)."""
        return -only(self._tangents(q[None], v[None], np.array([t]))[0])

    def force_v(self, q: Array, v: Array, t: float) -> Array:
        """Q_v."""
        D = self._tangents(q[None], v[None], np.array([t]))[1]
        return np.zeros(self.pattern.size) if D is None else -only(D)

    def force_b(self, q: Array, v: Array, t: float) -> Array:
        """Q_b (eqs. 24, 25)."""
        return only(self._forces_b(q[None], v[None], np.array([t])))

    def force_total(self, q: Array, v: Array, t: float, q_b: Array, v_b: Array) -> Array:
        """Total design derivative of Q."""
        rows = [np.concatenate([x[None], x_b.T]) for x, x_b in ((q, q_b), (v, v_b))]
        return self.force_and_total(rows[0], rows[1], t)[1:].T

    def force_and_total(self, q_rows: Array, v_rows: Array, t: float) -> Array:
        """Q and its total design derivatives as rows."""
        rows = self._inertia.gravity_rows - self._elastic.totals(q_rows, v_rows)
        if self._scene.loads:
            time = np.array([t])
            total = self._loads.force_total(q_rows[0], v_rows[0], time, q_rows[1:].T, v_rows[1:].T)
            rows = rows + np.concatenate([self._loads.force(q_rows[:1], v_rows[:1], time), total.T])
        return rows

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
        f_q, f_v = self._tangents(q, v, t)
        if not self.linear_constraints:
            f_q = f_q + self._constraints.constraint_force_q(lam, t)
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

    def _tangents(self, q: Array, v: Array, t: Array) -> tuple[Array, Array | None]:
        """Return -Q_q and -Q_v."""
        K, D = self._elastic.internal_q(q, v), None
        if self._elastic.damped:
            D = self._elastic.internal_v(q)
        elif self.velocity_forces:
            D = np.zeros_like(K)
        if self._scene.loads:
            self._loads.subtract_tangents(q, v, t, K, D)
        return K, D

    def _forces_b(self, q: Array, v: Array, t: Array) -> Array:
        Q_b = self._elastic.force_b(q, v) + self._inertia.gravity_b
        return Q_b + self._loads.force_b(q, v, t) if self._scene.loads else Q_b
