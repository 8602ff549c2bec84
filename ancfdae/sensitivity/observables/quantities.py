"""Observables of joints, drivers, loads and controllers, energies, time and design variables."""

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from ancfdae.assembly.energies import LoadFunction
from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import require_kind, require_text
from ancfdae.errors.kinds import InvalidInputError, UnknownNameError
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.observable import (
    Columns,
    Leaf,
    LeafGradient,
    Named,
    Observable,
    States,
    known_naming,
    known_scene,
    known_system,
    require_index,
)


def reaction(joint: str, axis: int) -> Observable:
    """Return a component of the force of a joint on its first point; N.

    Axes 0, 1 and 2 are x, y and z. The force is minus a multiplier of the joint's first equations,
    as in `Solution.reaction`; for joints that hold a point in all directions. For others see
    `multiplier`.
    """
    require_index("reaction, axis", axis)
    return -Multiplier(joint, axis, on_point=True)


def multiplier(joint: str, row: int) -> Observable:
    """Return the Lagrange multiplier of equation `row` of a joint, counted from 0.

    The joint acts with -lam Phi_q: the multiplier of e . (r(point) - r(other)) = 0 is minus the
    force along e on the point; N.
    """
    return Multiplier(joint, row)


def strain_energy(beam: str | None = None) -> Observable:
    """Return the strain energy of a beam or body, or of the whole scene; J."""
    return Energy(beam, kinetic=False)


def kinetic_energy(beam: str | None = None) -> Observable:
    """Return the kinetic energy of a beam, a body or a point mass, or of the whole scene; J."""
    return Energy(beam, kinetic=True)


def gravitational_energy() -> Observable:
    """Return the potential energy of the weight of the scene, -m g . r_c; J.

    It is zero where the centre of mass r_c is at the origin.
    """
    return GravitationalEnergy()


def potential_energy() -> Observable:
    """Return the potential energy of the scene: strain of beams, weight, and springs; J.

    Its sum with `kinetic_energy` is constant if no other force does work and nothing damps.
    """
    return strain_energy() + gravitational_energy() + spring_energy()


def elapsed_time() -> Observable:
    """Return the time since the start of the run; s."""
    return Time()


def design_value(name: str) -> Observable:
    """Return the value of a design variable such as ``"rod.height"``, constant over time."""
    return Design(name)


def spring_energy(load: str | None = None) -> Observable:
    """Return the elastic energy of a spring, or of all springs of the scene; J.

    Springs are `SpringDamper`, `TorsionalSpringDamper` and `Bushing`. The energy of a spring with a
    law is multiplied by the law's factor, and changes with it.
    """
    return SpringEnergy(load)


@final
@dataclass(frozen=True)
class SpringEnergy(Leaf):
    """Elastic energy of one spring, or of all springs of a scene."""

    load: str | None

    def __post_init__(self) -> None:
        if self.load is not None:
            require_text("spring_energy, load", self.load)

    def check_leaf(self, system: Named) -> None:
        """Raise unless the scene has the load and it stores energy."""
        known_scene(system).works.of_springs(self.load)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the elastic energy at the states, shape (k,); J."""
        springs = known_scene(system).works.of_springs(self.load)
        none = np.zeros(len(states.t))
        return sum((x.value(states.t, states.q, states.v) for x in springs), start=none)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return the partials of the spring energy in q and b."""
        springs = known_scene(system).works.of_springs(self.load)
        q, b = np.zeros(states.q.shape), np.zeros((len(states.t), system.n_b))
        for each in springs:
            by_q, _, by_b = each.partials(states.t, states.q, states.v)
            q, b = q + by_q, b + by_b
        return LeafGradient(q=Columns(slice(None), q), b=b)


@final
@dataclass(frozen=True)
class Multiplier(Leaf):
    """Lagrange multiplier of an equation of a joint.

    If `on_point`, it must be minus a component of the joint's force on its first point.
    """

    joint: str
    row: int
    on_point: bool = False

    def __post_init__(self) -> None:
        require_text("joint of an observable", self.joint)
        if not self.on_point:
            require_kind("multiplier, row", self.row, (int, np.integer), "Counted from 0 on.")

    def check_leaf(self, system: Named) -> None:
        """Raise unless the scene has the joint, and the joint the equation or axis."""
        layout = known_naming(system).layout
        place = layout.joint(self.joint)
        if not self.on_point:
            require_index(f"multiplier of {self.joint!r}, row", self.row, place.rows)
        elif not place.holds_position:
            raise InvalidInputError(
                f"reaction of {self.joint!r}",
                "the joint must hold a point in all directions",
                "a joint of another kind",
                "Use multiplier(joint, row).",
            )
        else:
            require_index("reaction, axis", self.row, layout.d)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the Lagrange multiplier of the joint's equation, shape (k,)."""
        return states.lam[:, self._column(system)]

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return the partial one in the column of this multiplier."""
        return LeafGradient(lam=Columns(np.array([self._column(system)]), np.ones((1, 1))))

    def _column(self, system: Named) -> int:
        return known_naming(system).layout.joint(self.joint).first_row + self.row


@final
@dataclass(frozen=True)
class Energy(Leaf):
    """Strain or kinetic energy of a beam or of the scene."""

    beam: str | None
    kinetic: bool

    def __post_init__(self) -> None:
        if self.beam is not None:
            require_text("energy, beam", self.beam)

    def check_leaf(self, system: Named) -> None:
        """Raise unless `system` is an assembled scene that has the beam."""
        layout = known_naming(known_scene(system)).layout
        if self.beam is not None:
            layout.owner(self.beam)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the kinetic energy T (eq. 9) or the strain energy U, shape (k,); J."""
        energies = known_scene(system).energies
        if self.kinetic:
            return energies.kinetic(states.v, self.beam)
        return energies.strain(states.q, self.beam)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return T_v and T_b of the kinetic energy, or U_q and U_b of the strain energy."""
        energies, q, v = known_scene(system).energies, states.q, states.v
        if self.kinetic:
            rows = Columns(slice(None), energies.momenta(v, self.beam))
            return LeafGradient(v=rows, b=energies.kinetic_b(v, self.beam))
        rows = Columns(slice(None), energies.strain_q(q, self.beam))
        return LeafGradient(q=rows, b=energies.strain_b(q, self.beam))


@final
@dataclass(frozen=True)
class GravitationalEnergy(Leaf):
    """Potential energy of the weight of a scene."""

    def check_leaf(self, system: Named) -> None:
        """Raise InvalidInputError unless `system` is an assembled scene."""
        known_scene(system)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return -Q_g . q at the states, shape (k,), J; Q_g is the force of gravity on q."""
        return known_scene(system).energies.gravity(states.q)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return the partials -Q_g in q, the same at every time, and -Q_gb . q in b."""
        scene = known_scene(system)
        weight = Columns(slice(None), scene.energies.gravity(np.eye(system.n_q))[None])
        return LeafGradient(q=weight, b=scene.energies.gravity_b(states.q))


@final
@dataclass(frozen=True)
class Time(Leaf):
    """The time since the start of the run as an observable; s."""

    names_time: ClassVar[bool] = True

    def check_leaf(self, system: Named) -> None:
        """Accept every system, since every system has a time."""

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the times of the states, shape (n_t,); s."""
        return states.t

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return no partials: time depends neither on the state nor on the design."""
        return LeafGradient()


@final
@dataclass(frozen=True)
class Design(Leaf):
    """Value of a design variable as an observable, constant over time."""

    name: str

    def __post_init__(self) -> None:
        require_text("design_value, name", self.name)

    def check_leaf(self, system: Named) -> None:
        """Raise UnknownNameError unless the system has the design variable."""
        known = known_system(self.name, system).design_names
        if self.name not in known:
            raise UnknownNameError("design variable", self.name, known)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the value b_i of the design variable at every time point, shape (k,)."""
        mechanical = known_system(self.name, system)
        return np.full(len(states.t), mechanical.b[mechanical.design_names.index(self.name)])

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return the partial one in the column of this design variable."""
        b = np.zeros((len(states.t), system.n_b))
        b[:, system.design_names.index(self.name)] = 1.0
        return LeafGradient(b=b)


# -- drivers and loads -------------------------------------------------------------------------


def driver_torque(joint: str) -> Observable:
    """Return the torque of a `RotationDriver` on the body that it drives; N m.

    It is work conjugate to the angle: its product with the rate of the angle is `joint_power`.
    """
    return DriveWork(joint, unit_rate=True)


def driver_force(joint: str) -> Observable:
    """Return the force of a `TranslationDriver` on its point, along its direction; N."""
    return DriveWork(joint, unit_rate=True)


def joint_power(joint: str) -> Observable:
    """Return the power that a driven joint adds to the scene; W.

    ``Integral(joint_power("motor"))`` is its work; J.
    """
    return DriveWork(joint, unit_rate=False)


def load_power(load: str) -> Observable:
    """Return the power that a load adds to the scene; W.

    A spring that relaxes has positive power, a damper negative power.
    """
    return LoadQuantity(load)


@final
@dataclass(frozen=True)
class LoadQuantity(Leaf):
    """Power of a load or, with an axis, the torque or force of a controller on that axis."""

    load: str
    axis: int | None = None

    def __post_init__(self) -> None:
        where = "load_power, load" if self.axis is None else "effort, controller"
        require_text(where, self.load)

    def check_leaf(self, system: Named) -> None:
        """Raise UnknownNameError or InvalidInputError for a load or axis that does not exist."""
        self._function(system)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the power F . V, or the torque or force, at the states, shape (k,)."""
        return self._function(system).value(states.t, states.q, states.v)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return the partials of the power, torque or force in q, v and b."""
        q, v, b = self._function(system).partials(states.t, states.q, states.v)
        return LeafGradient(q=Columns(slice(None), q), v=Columns(slice(None), v), b=b)

    def _function(self, system: Named) -> LoadFunction:
        works = known_scene(system).works
        return (
            works.of_load(self.load) if self.axis is None else works.of_effort(self.load, self.axis)
        )


@final
@dataclass(frozen=True)
class DriveWork(Leaf):
    """Power of a driven joint: at the rate of its law, or at unit rate (then torque or force)."""

    joint: str
    unit_rate: bool

    def __post_init__(self) -> None:
        require_text("joint of an observable", self.joint)

    def check_leaf(self, system: Named) -> None:
        """Raise unless the scene has the joint and it is driven."""
        known_scene(system).works.of_joint(self.joint, self.unit_rate)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return lam . Phi_t, or its value per unit rate of the law, at the states, shape (k,)."""
        work = known_scene(system).works.of_joint(self.joint, self.unit_rate)
        return work.value(states.t, states.q, states.lam)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return the partials of the power, torque or force in q, lam and b."""
        work = known_scene(system).works.of_joint(self.joint, self.unit_rate)
        q, lam, b = work.partials(states.t, states.q, states.lam)
        columns = np.arange(work.rows.start, work.rows.stop)
        return LeafGradient(q=Columns(slice(None), q), lam=Columns(columns, lam), b=b)


# -- controllers -------------------------------------------------------------------------------


def state(controller: str, name: str) -> Observable:
    """Return a state of a controller, such as ``state("motor", "current")``; its own unit."""
    return ControllerState(controller, name)


def effort(controller: str, axis: int = 0) -> Observable:
    """Return the torque, N m, or the force, N, of a controller on one of its axes.

    Axes are counted from 0; a `PID` or a `DCMotor` has one.
    """
    require_kind("effort, axis", axis, (int, np.integer), "Counted from 0 on.")
    return LoadQuantity(controller, axis)


def rope_tension(rope: str, span: int = 0) -> Observable:
    """Return the tension of a `Rope` in one of its spans, counted from 0 at its start; N."""
    require_kind("rope_tension, span", span, (int, np.integer), "Counted from 0 on.")
    return LoadQuantity(rope, span)


@final
@dataclass(frozen=True)
class ControllerState(Leaf):
    """A state of a controller, such as the current of a motor, as an observable."""

    controller: str
    name: str

    def __post_init__(self) -> None:
        require_text("state, controller", self.controller)
        require_text("state, name", self.name)

    def check_leaf(self, system: Named) -> None:
        """Raise UnknownNameError unless the scene has the controller and its state."""
        its = known_naming(system).layout.controller(self.controller)
        if self.name not in its.states:
            raise UnknownNameError(f"state of {self.controller!r}", self.name, its.states)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the state of the controller at the times, shape (k,); its own unit."""
        return states.v[:, self._column(system)]

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return one in the column of the velocity that represents the state."""
        return LeafGradient(v=Columns(np.array([self._column(system)]), np.ones((1, 1))))

    def _column(self, system: Named) -> int:
        layout = known_naming(system).layout
        its = layout.controller(self.controller)
        return layout.d * (its.first_vector + its.states.index(self.name))
