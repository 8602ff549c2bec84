"""The class `AncfSystem`, a scene as equations of motion, and `assemble`, which makes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, final

import numpy as np
import scipy

from ancfdae.assembly.beam_sections import BeamSections
from ancfdae.assembly.contact_checks import Groups, RunContacts
from ancfdae.assembly.energies import Energies, Works
from ancfdae.assembly.folds import Folds, first_mirrored
from ancfdae.assembly.geometry import PartInputs
from ancfdae.assembly.left_out_pairs import LeftOutPairs
from ancfdae.assembly.load_forces import LoadInput
from ancfdae.assembly.naming import SceneNaming
from ancfdae.assembly.numbers import Numbers
from ancfdae.assembly.parameters import parameter_map, value_limits
from ancfdae.equations import (
    DesignPartials,
    Linearisation,
    PlannedSystem,
    StateDirection,
    SystemProperties,
)
from ancfdae.equations.plans import DesignPlan, FactorTable, Plan
from ancfdae.equations.solution_parts import ContactRecord
from ancfdae.equations.system import States
from ancfdae.errors.checks import require_kind
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.text import listed
from ancfdae.kernels import norm
from ancfdae.model.design import DesignVariable, as_design
from ancfdae.model.loads.pair_contact import leaves_out
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array, only
from ancfdae.numerics.pulses import SAMPLES, find_pulses
from ancfdae.numerics.threads import in_one_thread

if TYPE_CHECKING:
    from ancfdae.statics.equilibrium import RestingStart


# Largest number of element states that are checked at once: more do not fit into the cache.
_STATES = 2000


# Singular value below which rows of Phi_q of unit length depend on each other, and w^T Phi_b over
# the length of Phi_b that is not round-off.
_DEPENDENT, _OPENED = 1e-8, 1e-7
# Equations that are left out are open if a gap exceeds _OPEN times the size of the mechanism, and
# _WIDER times the gaps of the other equations, which integrators may leave open.
_OPEN, _WIDER = 1e-6, 100.0


@in_one_thread
def assemble(scene: Scene, design: Sequence[str | DesignVariable] = ()) -> AncfSystem:
    """Return the mechanical system of a scene.

    Design variables are in the order of the last axis of every sensitivity. Raises
    InvalidInputError or UnknownNameError if one does not fit the scene.
    """
    require_kind("scene", scene, (Scene,), "Call Scene(...).")
    variables = as_design(design)
    scene = scene.with_grounds(text for variable in variables for text in variable.targets)
    mapping = parameter_map(scene, variables)
    return AncfSystem(Numbers.first(scene, variables, mapping, mapping.nominal))


@final
class AncfSystem(PlannedSystem):
    """Equations of motion of a scene at values b of its design variables; made by `assemble`.

    b may be complex; all numeric data are in its dtype. `naming` has the indices of bodies and
    joints in q and lam, and the lengths of elements; `inputs` are the numeric data of joints and
    loads, and vectors of points in the reference.
    """

    naming: SceneNaming

    def __init__(self, numbers: Numbers, at_rest: Numbers | None = None) -> None:
        """Set up the system; `at_rest` are data of its equilibrium at other design values."""
        structure, geometry = numbers.structure, numbers.geometry
        self._at_rest = at_rest
        self._numbers, self._structure, self.b = numbers, structure, numbers.b
        self._scene, self._mapping = structure.scene, structure.mapping
        self._numbering, self._reference = structure.numbering, geometry.reference
        self._constraints, self._loads = numbers.constraints, numbers.loads
        self._elastic, self._inertia = numbers.elastic, numbers.inertia
        self._turning, self._start = numbers.turning, numbers.start
        self.n_b, self.design_names = len(structure.design), structure.mapping.names
        self.n_q, self.n_lam = structure.numbering.n_q, geometry.joints.n_lam
        self.vector_size = structure.numbering.d
        self.pattern, self.constraint_pattern = structure.pattern, geometry.joints.pattern
        self.naming = geometry.naming
        self.constraint_names, self.reach = structure.constraint_names, structure.reach
        controllers = structure.numbering.controllers
        self.controllers = tuple(each.name for each in controllers)
        first = [each.first_vector + k for each in controllers for k in range(len(each.states))]
        self.state_places = structure.numbering.d * np.array(first, dtype=int)
        self.inputs, self.weights = geometry.inputs, numbers.inertia.weights
        self.traits, self.divides = self._described(), len(self._loads.dividing) > 0

    @cached_property
    def energies(self) -> Energies:
        """Kinetic, strain and gravity energies of beams and bodies, for observables."""
        parts = self._elastic, self._inertia, self._numbering, self.naming.layout
        return Energies(*parts, None if self._turning is None else self._turning.potential)

    @cached_property
    def _folds(self) -> Folds:
        soft, beams = self._numbering.elements, self._scene.beams
        own = self._mapping.values(self.b)[soft]
        return Folds([beam for beam in beams if not beam.rigid], self._numbering, own)

    @cached_property
    def sections(self) -> BeamSections:
        """Section forces and stresses of beams, for observables."""
        where = self.naming.layout, self._numbering
        return BeamSections(self._scene, *where, self._mapping, self.b)

    @cached_property
    def works(self) -> Works:
        """Power of driven joints and of loads, for observables."""
        return Works(self._scene, self.inputs, self.naming.layout, self.n_b)

    def __repr__(self) -> str:
        """Return sizes, scene and values of the design variables."""
        pairs = zip(self.design_names, self.b, strict=True)
        values = listed(f"{name} = {b:.6g}" for name, b in pairs)
        sizes = f"{self.n_q} coordinates, {self.n_lam} multipliers"
        return f"AncfSystem: {sizes}\n{self._scene}\ndesign variables: {values}"

    def _described(self) -> SystemProperties:
        joints, moving = self._constraints, self._loads.moving
        damped, turning = self._elastic.damped, self._turning is not None
        return SystemProperties(
            constant_mass=True,
            linear_constraints=joints.linear,
            # The same at all times and designs.
            constant_constraints=joints.tangent is not None and not joints.active,
            velocity_forces=damped or turning or self._loads.uses_velocity,
            # Damping of bodies turns with them: -(D(q) v)_q is not symmetric; nor are loads that
            # move, nor gyroscopic forces.
            symmetric=not (damped or moving or turning),
            routed=self._numbering.routed,
            project_start=self._scene.project_start,
            force_round_off=self._elastic.round_off(self._reference.Z.ravel(), self.weights),
            breakpoints=self.inputs.breakpoints,
            leaves_out=any(map(leaves_out, self._scene.loads)),
            rows_left_out=len(self._scene.left_out) > 0,
            slender=self._structure.slender,
        )

    def breakpoints(self, t_end: float) -> tuple[float, ...]:
        """Return the ends of the pieces of laws, and times around pulses of unmarked laws; s."""
        t = np.linspace(0.0, t_end, SAMPLES + 1)
        return (*self.traits.breakpoints, *find_pulses(t, self.over_time(t, True)).stops)

    @property
    def scleronomic(self) -> bool:  # type: ignore[override]  # computed where it is asked for
        """Whether no joint is driven."""
        return not self._constraints.factors.driven

    @cached_property
    def has_loops(self) -> bool:  # type: ignore[override]  # computed where it is asked for
        """Whether joints close loops of bodies and ground."""
        joined: dict[str, str] = {}

        def root(name: str) -> str:
            while name in joined:
                name = joined[name]
            return name

        for joint in self._scene.joints:
            names = [*(point.beam for point in joint.points), *joint.whole_beams]
            first, second = (root(x) for x in (*names, "")[:2])
            if first == second:
                return True
            joined[first] = second
        return False

    def over_time(self, t: Array, unmarked: bool = False) -> Array:
        """Return the laws of time at t, shape (k, n_laws): all laws, or the `unmarked` ones."""
        parts = (*self._scene.joints, *self._scene.loads)
        values = ((part, self._mapping.numbers(part.name, self.b)[0]) for part in parts)
        rows = [row for part, p in values for row in part.over_time(p.real, t, unmarked)]
        return np.stack(rows, axis=1) if rows else np.zeros((len(t), 0))

    def sharp_loads(self) -> list[LoadInput]:
        """Return the loads whose force may change abruptly with positions or velocities."""
        found = self._loads.sharp()
        return [self.inputs.in_all_states(x.load) if leaves_out(x.load) else x for x in found]

    @property
    def plan(self) -> Plan | None:
        """Arrays of the scene for time stepping in kernels; None in a rotating frame."""
        if self._turning is not None:
            return None
        steady, rows = self._loads.timed
        inertia, weights, factors = self._inertia, self.weights, self._constraints.factors
        return Plan(
            *self._elastic.tangent_places,
            inertia.M.csr,
            self.pattern.rows_of(inertia.values),
            inertia.gravity + steady,
            rows,
            weights,
            1 / weights,
            self._constraints.plan,
            self.constraint_pattern.rows_of(np.zeros(self.constraint_pattern.size)),
            factors.over if factors.driven else None,
            self._loads.factors,
            self._loads.plans,
            self._loads.turning,
        )

    @cached_property
    def design_plan(self) -> DesignPlan:
        """Design derivatives of the arrays of `plan`."""
        steady, loads, moved = self._loads.changes
        return DesignPlan(
            self.n_b,
            self._elastic.law_b,
            self._inertia.M_b.csr,
            self._inertia.gravity_b.T + steady,
            loads.csr,
            self._constraints.partials,
            moved,
        )

    @property
    def timed(self) -> bool:
        """Whether factors of joints or loads in `plan` change with time."""
        return self._constraints.factors.driven or self._loads.changing

    def factor_table(self, t: Array, derivatives: bool) -> FactorTable:
        """Return the factors of joints and loads at times t, (k,), with design partials or None."""
        joints, loads = self._constraints.factors, self._loads
        values = joints.spread(t, 3), loads.factors(t)
        if not derivatives:
            return *values, None, None
        return *values, joints.partials(t, 3, self.n_b), loads.factors_b(t)

    # -- the protocol --------------------------------------------------------------------------

    def require_derivatives_at(self, t: float, q: Array, v: Array) -> None:
        """Raise InvalidInputError if a design variable opens a joint with equations left out.

        The equations of all joints have derivatives q_b, Phi_q q_b + Phi_b = 0, only where
        w^T Phi_b = 0 for every w with w^T Phi_q = 0. Where more rows than those that are left out
        depend on each other, at a dead point, nothing is raised.
        """
        if not self._scene.left_out or not self.n_b:
            return
        whole, q = self._with_all_rows, q.real
        Phi_q = whole.constraint_pattern.dense(whole.constraint_q(t, q)) / np.sqrt(self.weights)
        lengths = np.linalg.norm(Phi_q, axis=1)
        w = scipy.linalg.null_space((Phi_q / lengths[:, None]).T, rcond=_DEPENDENT)
        if w.shape[1] > len(self._scene.left_out):
            return
        Phi_b = whole.constraint_total(t, (q,)) / lengths[:, None]
        opened = np.abs(w.T @ Phi_b) > _OPENED * np.linalg.norm(Phi_b, axis=0)
        names = [name for name, no in zip(self.design_names, opened.any(axis=0), strict=True) if no]
        if names:
            rule = "must not open joints of which `Scene.left_out` leaves equations out"
            repair = (
                "The motion has no derivative: one link alone cannot change. Change all that must "
                "fit together, by one DesignVariable with several targets."
            )
            raise InvalidInputError("design", rule, listed(names), repair)

    def opened(self, t: Array, q: Array) -> tuple[int, str] | None:
        """Return the first state that opens a joint of which equations are left out; a message.

        Equations are measured by the distance to where they hold, |Phi_i|/|Phi_iq|, and distances
        by the size of the mechanism and by the gaps of the equations that are kept.
        """
        whole, q = self._with_all_rows, q.real
        size = norm(self.centred(q[0]), self.weights)
        for k, (time, each) in enumerate(zip(t.tolist(), q, strict=True)):
            gaps, kept = (system.gaps(time, each) for system in (whole, self))
            widest = int(np.argmax(gaps))
            if gaps[widest] > max(_OPEN * size, _WIDER * np.max(kept, initial=0.0)):
                return k, (
                    f"joint {whole.constraint_names[widest]!r} open by {gaps[widest] / size:.2g} "
                    "of the size of the mechanism, of which equations are left out"
                )
        return None

    def gaps(self, t: float, q: Array) -> Array:
        """Return the distance to where each equation of the joints holds, shape (n_lam,)."""
        pattern = self.constraint_pattern
        squares = self.constraint_q(t, q).real ** 2 / self.weights[pattern.columns]
        lengths = np.sqrt(np.bincount(pattern.rows, squares, self.n_lam))
        return np.abs(self.constraint(t, q).real) / np.where(lengths > 0, lengths, 1.0)

    @cached_property
    def _with_all_rows(self) -> AncfSystem:
        scene, structure = replace(self._scene, left_out=()), self._structure
        values = self.b.real
        return AncfSystem(Numbers.first(scene, structure.design, self._mapping, values))

    @in_one_thread
    def with_values(self, b: Array) -> AncfSystem:
        """Return the same scene at other design values b, (n_b,), real or complex.

        Raises InvalidInputError for values that a part cannot take.
        """
        b = np.asarray(b)
        if b.shape != (self.n_b,):
            names = ", ".join(self.design_names[:5]) + (", ..." if self.n_b > 5 else "")
            rule = f"must have shape ({self.n_b},), one value per design variable ({names})"
            raise InvalidInputError("design values", rule, f"shape {b.shape}")
        scene, design = self._scene, self._structure.design
        if np.any(b.real != self.b.real):
            scene.refuse_values(dict(zip(design, b.real.tolist(), strict=True)))
        return self._of(self._numbers.at(b) or self._first(b, self.inputs))

    def along(self, q: Array, wider: float = 1.0) -> AncfSystem:
        """Return the same system with the pairs of contact loads near states q, (k, n_q).

        The system itself is returned if it has these pairs. `wider` multiplies their reach.
        """
        inputs = self.inputs.along(q, wider)
        return self if inputs is self.inputs else self._of(self._first(self.b, inputs))

    def _first(self, b: Array, inputs: PartInputs) -> Numbers:
        """Return numbers on a new structure, with the pairs of contact loads of `inputs`."""
        design = self._structure.design
        return Numbers.first(self._scene, design, self._mapping, b, elements=inputs.elements)

    def _of(self, numbers: Numbers) -> AncfSystem:
        return AncfSystem(numbers, None if self._scene.rest is None else self._rest_numbers)

    def value_limits(self) -> tuple[Array, Array]:
        """Return lower and upper limits of admissible values of each variable, (n_b,) each."""
        return value_limits(self._scene, self._structure.design, self.b.real)

    @cached_property
    def _rest(self) -> RestingStart | None:
        """The static equilibrium that the motion starts from; None without `EquilibriumStart`."""
        if self._scene.rest is None:
            return None
        from ancfdae.statics.equilibrium import RestingStart

        return RestingStart(AncfSystem(self._rest_numbers).in_all_states())

    @cached_property
    def _rest_numbers(self) -> Numbers:
        """Numeric data of the scene in its initial equilibrium, reusing a structure if possible."""
        known = None if self._at_rest is None else self._at_rest.at(self.b)
        if known is not None:
            return known
        scene, rest, mapping = self._scene.at_rest(), self._scene.rest, self._mapping
        assert scene is not None
        assert rest is not None
        if rest.gravity is not None:
            mapping = mapping.with_scene(rest.gravity, len(self._scene.gravity or ()))
        return Numbers.first(scene, self._structure.design, mapping, self.b)

    def start(self) -> tuple[Array, Array]:
        """Return q and v at t = 0, shape (n_q,) each: as declared, or the equilibrium."""
        if self._rest is None:
            return self._start.state
        return self._from_rest(self._rest.state, self._reference.state_rates)

    def start_b(self) -> tuple[Array, Array]:
        """Return the design derivatives of q and v at t = 0, shape (n_q, n_b) each."""
        if self._rest is None:
            return self._start.state_b()
        return self._from_rest(self._rest.state_b, self._reference.state_rates_b)

    def start_pull_back(self, on_q: Array, on_v: Array) -> Array:
        """Return q_b^T on_q + v_b^T on_v at t = 0, shape (n_b,)."""
        if self._rest is None:
            return self._start.pull_back(on_q, on_v)
        here, there = self._shared_with_rest
        at_rest, declared = np.zeros((2, len(self._rest.state[0]))), np.array(on_v)
        at_rest[:, there], declared[here] = (on_q[here], on_v[here]), 0.0
        states_b = self._reference.state_rates_b
        return self._rest.pull_back(*at_rest) + declared[self.n_q - len(states_b) :] @ states_b

    def _from_rest(self, state: tuple[Array, Array], declared: Array) -> tuple[Array, Array]:
        """Return q and v at the start, or derivatives, from the equilibrium's.

        States of controllers that do not act in the equilibrium start as declared.
        """
        here, there = self._shared_with_rest
        dtype = np.result_type(state[0], declared)
        q, v = np.zeros((2, self.n_q, *declared.shape[1:]), dtype=dtype)
        v[self.n_q - len(declared) :] = declared
        q[here], v[here] = (x[there] for x in state)
        return q, v

    @cached_property
    def _shared_with_rest(self) -> tuple[Array, Array]:
        """Indices of the same coordinates here and in the equilibrium of the start, (k,) each."""
        own, rest = self._numbering, self._rest_numbers.structure.numbering
        bodies = np.arange(self.n_q - own.d * own.controlled)
        here, there = [bodies], [bodies]
        acting = {each.name: each for each in rest.controllers}
        for each in own.controllers:
            if each.name in acting:
                places = np.arange(own.d * len(each.states))
                here.append(own.d * each.first_vector + places)
                there.append(own.d * acting[each.name].first_vector + places)
        return np.concatenate(here), np.concatenate(there)

    def mass(self, q: Array) -> Array:
        """Return the values of the mass matrix M on `pattern`, shape (nnz,) (eq. 10)."""
        return self._inertia.values

    def mass_times(self, q: Array, x: Array) -> Array:
        """Return M x for a vector, shape (n_q,), or columns, shape (n_q, k)."""
        return self._inertia.times(x)

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return Q, shape (n_q,): gravity, elastic and damping forces, loads (eqs. 11-13); N."""
        Q = self._inertia.gravity - self._elastic.internal(q, v)
        if self._turning is not None:
            Q = Q - self._turning.force(q, v)
        if self._scene.loads:
            Q = Q + self._loads.force(q[None], v[None], np.array([t]))[0]
        return Q

    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Return the derivative Q_q dq + Q_v dv + Q_t dt of the force, shape (n_q,)."""
        dt, *rates = direction
        dQ = self._elastic.force_along((q, v), (rates[0], rates[1]))
        if self._turning is not None:
            dQ = dQ - self._turning.force_along(rates[0], rates[1])
        if self._scene.loads:
            states, moving = (q[None], v[None]), (rates[0][None], rates[1][None])
            dQ = dQ + self._loads.force_along(states, moving, np.array([t]), dt)[0]
        return dQ

    def force_and_total(self, t: float, q_rows: Array, v_rows: Array) -> Array:
        """Return Q and its total design derivatives as rows, shape (1 + n_b, n_q)."""
        rows = self._inertia.gravity_rows - self._elastic.totals(q_rows, v_rows)
        if self._turning is not None:
            rows = rows - self._turning.rows(q_rows, v_rows)
        if self._scene.loads:
            time = np.array([t])
            total = self._loads.force_total(q_rows[0], v_rows[0], time, q_rows[1:].T, v_rows[1:].T)
            rows = rows + np.concatenate([self._loads.force(q_rows[:1], v_rows[:1], time), total.T])
        return rows

    def following_load(self, t: float, q: Array) -> tuple[Array, Array]:
        """Return follower and centrifugal forces, (n_q,), and values of their derivatives in q."""
        P, P_q = self._loads.following(q, np.array([t]))
        if self._turning is None:
            return P, P_q
        return P - self._turning.force(q, np.zeros_like(q)), P_q - self._turning.tangents[0]

    def stress_force(self, q: Array) -> Array:
        """Return the elastic forces at zero velocity, shape (n_q,); N."""
        return -self._elastic.internal(q, np.zeros_like(q))

    def centred(self, q: Array) -> Array:
        """Return q with positions relative to their weighted mean; slopes are unchanged."""
        d, positions = self._numbering.d, self._numbering.positions
        Z, w = q.reshape(-1, d).copy(), self.weights.reshape(-1, d)[positions, 0]
        Z[positions] -= w @ Z[positions] / w.sum()
        return Z.ravel()

    def folded(self, q: Array) -> str:
        """Return a text naming elements turned inside out, bent back or crushed; else empty."""
        return self._folds.words(q)

    def coarse(self, states: Array, moving: bool = False) -> dict[str, float]:
        """Return, by name, beams with too few elements and their error of the stiffness."""
        return self._folds.coarse(states, moving)

    def strained(self, q: Array) -> dict[str, float]:
        """Return, by name, beams strained beyond the validity of their laws, with the strain."""
        return self._folds.strained(q)

    def contacts(self) -> ContactRecord | None:
        """Return a record for the contacts of one run; None without contact loads.

        Raises InvalidInputError if a beam that touches itself has too few elements at the start.
        """
        loads = self._loads.touching
        if not loads:
            return None
        groups = Groups.of(self._numbering, self.weights)
        return RunContacts(loads, self.naming, self.inputs.elements, groups, self.start()[0])

    def left_out(self) -> list[LeftOutPairs]:
        """Return searches for pairs that touch but are left out, for one run."""
        return [
            LeftOutPairs(load, self.naming, self.inputs.elements)
            for load in self._scene.loads
            if leaves_out(load)
        ]

    def constraint(self, t: float, *motion: Array) -> Array:
        """Return Phi, (n_lam,), or its time derivative of the order of the rates in `motion`."""
        return self._constraints.constraint(t, *motion)

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Return the values of Phi_q, or of its time derivative, on `constraint_pattern`."""
        return self._constraints.constraint_q(t, *motion)

    def constraints_q(self, t: Array, *motion: Array) -> Array:
        """Return the values of Phi_q, or of its time derivative, at times t, shape (k, nnz)."""
        return self._constraints.constraints_q(t, *motion)

    def constraint_total(
        self, t: float, motion: tuple[Array, ...], motion_b: tuple[Array, ...] | None = None
    ) -> Array:
        """Return the total design derivative of Phi or of its time derivative, (n_lam, n_b)."""
        return self._constraints.total(t, motion, motion_b)

    @cached_property
    def _sides(self) -> Array:
        """Signs of the derivatives of Phi in prescribed angles at the start, shape (n_lam,)."""
        return np.sign(self._constraints.by_turn(self.start()[0].real[None], np.zeros(1))[0])

    def off_root(self, t: Array, q: Array) -> tuple[int, str] | None:
        """Return the first state with a driven joint half a turn off its angle, and its name.

        There the derivative of its equation in the angle has not the sign that it has at the start.
        """
        if not self._constraints.factors.turns or np.iscomplexobj(q) or np.iscomplexobj(self.b):
            return None
        off = self._constraints.by_turn(q, t) * self._sides < 0
        instants = np.flatnonzero(np.any(off, axis=1))
        if not len(instants):
            return None
        first = int(instants[0])
        return first, self.constraint_names[int(np.argmax(off[first]))]

    def mirrored(self, q: Array) -> tuple[int, str] | None:
        """Return the first state with a mirrored, folded or crushed element, and a message.

        Sections, tangents and stretches are compared with the first state.
        """
        numbering, found = self._numbering, None
        tables: list[tuple[Array, Array | None]] = [(numbering.frames, None)]
        count = _STATES // len(q) or 1
        if len(numbering.vectors):
            own = self._mapping.values(self.b.real)[numbering.elements]
            tables.append((numbering.vectors, own))
        for table, parameters in tables:
            for k in range(0, len(table), count):
                some = slice(k, k + count)
                law = None if parameters is None else parameters[some]
                each = first_mirrored(numbering, table[some], law, q.real)
                # The first state of all so far; later states need not be checked.
                if each is not None:
                    found, q = each, q[: each[0]]
        return found

    def off_route(self, t: Array, q: Array, v: Array) -> tuple[int, str] | None:
        """Return the first state with a guide off its beam or a rope off a pulley, with a message.

        Return None if all states are on their routes.
        """
        geometry, found = self._numbers.geometry, list[tuple[int, str]]()
        U, V = (geometry.joints.vectors.of(x.real) for x in (q, v))
        for slot in geometry.joints.slots:
            joint, its = slot.item, slot.vectors
            numbers = joint.p.real, joint.reference.real
            off = joint.joint.off_route(t, U[:, its], V[:, its], *numbers)
            found += [] if off is None else [off]
        for load in geometry.loads:
            if load.load.routed:
                U, V = (load.vectors.of(x.real) for x in (q, v))
                off = load.load.off_route(t, U, V, load.p.real, load.reference.real)
                found += [] if off is None else [off]
        return min(found, default=None)

    def divisors(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Return the divisors in formulas of loads in k states, (k, n) by the name of the load."""
        return {f"load {x.load.name!r}": x.divisors(t, q, v) for x in self._loads.dividing}

    def turn_rate(self, t: Array) -> Array:
        """Return the largest rate of the prescribed angles at times t; rad/s."""
        return self._constraints.factors.turn_rate(t)

    # -- the residual f = M a + Phi_q^T lam - Q ----------------------------------------------------

    def linearise(self, t: Array, q: Array, v: Array | None, a: Array, lam: Array) -> Linearisation:
        """Return M, f_q (eq. 19), f_v and Phi_q at times t as a `Linearisation`."""
        f_v, f_q = None, np.zeros((len(q), self.pattern.size))
        if v is not None:
            f_q, f_v = self._tangents(q, v, t)
        if not self.traits.linear_constraints:
            f_q = f_q + self._constraints.constraint_force_q(q, lam, t)
        M = self._inertia.values[None]
        return Linearisation(M, f_q, f_v, self._constraints.constraints_q(t, q))

    def design_partials(
        self, t: Array, q: Array, v: Array | None, a: Array, lam: Array
    ) -> DesignPartials:
        """Return the design partials of f (eqs. 24, 25) and Phi at times t."""
        f_b = self._inertia.times_b(a)
        if v is not None:
            Q_b = self._elastic.force_b(q, v) + self._inertia.gravity_b
            if self._scene.loads:
                Q_b = Q_b + self._loads.force_b(q, v, t)
            f_b = f_b - Q_b
            if self._turning is not None:
                f_b = f_b + self._turning.partials(q, v)
        if self._constraints.active:
            f_b = f_b + self._constraints.totals(t, (q,), multipliers=(lam, None))
        return DesignPartials(f_b, self._constraints.totals(t, (q,)))

    def pull_back(
        self,
        t: Array,
        states: tuple[Array, Array | None, Array, Array],
        covectors: tuple[Array, Array],
    ) -> Array:
        """Return the sum over times of f_b^T mu + Phi_b^T zeta, shape (n_b,).

        It is contracted pair by pair, without arrays of the size n_q n_b.
        """
        (q, v, a, lam), (mu, zeta) = states, covectors
        total = self._inertia.pull_back(a, mu, gravity=v is not None)
        if v is not None:
            total = total - self._elastic.pull_back(q, v, mu) - self._loads.pull_back(q, v, t, mu)
            if self._turning is not None:
                total = total + self._turning.pull_back(q, v, mu)
        return np.asarray(total + self._constraints.pull_back(q, lam, t, mu, zeta))

    def along_total(
        self,
        t: float,
        states: States,
        direction: StateDirection,
        states_b: States,
        direction_b: tuple[Array, Array],
    ) -> Array:
        """Return the total design derivative of the rate of f along a direction, (n_q, n_b)."""
        (q, v, _, lam), (q_b, v_b, _, lam_b) = states, states_b
        dt, *rates = direction
        moved_by = q_b, v_b, *direction_b
        total = -self._elastic.force_along_total((q, v), tuple(rates), moved_by)
        if self._turning is not None:
            total += self._turning.along_total(rates[0], rates[1], *direction_b)
        if self._scene.loads:
            time = np.array([t])
            total -= self._loads.force_along_total((q, v), tuple(rates), time, dt, moved_by)
        if self.traits.constant_constraints:
            return total
        joints = (q, rates[0], lam), (q_b, direction_b[0], lam_b)
        return total + self._constraints.force_along_total(t, *joints, dt)

    def along_pull_back(
        self, t: float, states: States, direction: StateDirection, mu: Array
    ) -> tuple[Array, Array, Array]:
        """Return the products of mu with the derivatives of f along a direction in q, v and b."""
        q, v, _, lam = states
        dt, *rates = direction
        moving, time, joints = (rates[0], rates[1]), np.array([t]), (q, rates[0], lam)
        Q_q, Q_v = self._elastic.tangent_rates(q, v, moving)
        on_b = -self._elastic.pull_back_rate(q, v, moving, mu)
        if self._turning is not None:
            on_b = on_b + self._turning.along_pull_back(rates[0], rates[1], mu)
        if self._scene.loads:
            Q_v = np.zeros_like(Q_q) if Q_v is None else Q_v
            self._loads.add_tangents_along((q, v), moving, time, dt, Q_q, Q_v)
            on_b = on_b - self._loads.force_along_pull_back((q, v), moving, time, dt, mu)
        f_q = -only(Q_q)
        if not self.traits.linear_constraints:
            f_q = f_q + self._constraints.force_q_along(t, joints, dt)
        on_b = on_b + self._constraints.force_along_pull_back(t, joints, dt, mu)
        dot = self.pattern.dot_transposed
        on_v = np.zeros_like(mu) if Q_v is None else -dot(only(Q_v), mu)
        return dot(f_q, mu), on_v, on_b

    def _tangents(self, q: Array, v: Array, t: Array) -> tuple[Array, Array | None]:
        """Return the values of -Q_q and -Q_v on the pattern; None if Q ignores velocities."""
        K, D = self._elastic.internal_q(q, v), None
        if self._elastic.damped:
            D = self._elastic.internal_v(q)
        elif self.traits.velocity_forces:
            D = np.zeros_like(K)
        if self._turning is not None and D is not None:
            turning_q, turning_v = self._turning.tangents
            K, D = K + turning_q, D + turning_v
        if self._scene.loads:
            self._loads.subtract_tangents(q, v, t, K, D)
        return K, D
