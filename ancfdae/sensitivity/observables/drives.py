"""Observables of what moves a scene: torque of a drive, force of a guide, power of all loads."""

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import require_text
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.observable import Columns, Leaf, LeafGradient, Observable
from ancfdae.sensitivity.observables.states import Named, States, known_scene


def driver_torque(joint: str) -> Observable:
    """Return the torque of a `RotationDriver` on what it turns, in the sense of its angle; N m.

    It is work conjugate to the angle: its product with the rate of the angle is `joint_power`.
    """
    return DriveWork(joint, unit_rate=True)


def driver_force(joint: str) -> Observable:
    """Return the force of a `TranslationDriver` on what it moves, along its direction; N."""
    return DriveWork(joint, unit_rate=True)


def joint_power(joint: str) -> Observable:
    """Return the power of a driven joint, what it adds to the energy of the scene; W.

    ``Integral(joint_power("motor"))`` is its work; J.
    """
    return DriveWork(joint, unit_rate=False)


def load_power(load: str) -> Observable:
    """Return the power of a load, what it adds to the energy of the scene; W.

    That of a spring is what it gives back, and that of a damper is negative.
    """
    return LoadPower(load)


def spring_energy(load: str | None = None) -> Observable:
    """Return the elastic energy of a spring, or of all springs of the scene; J.

    Springs are `SpringDamper`, `TorsionalSpringDamper` and `Bushing`. With a law the energy has its
    factor, and changes with it.
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
        """Refuse a load that does not exist or stores no energy."""
        known_scene(system).works.of_springs(self.load)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the energy of the states, shape (k,)."""
        springs = known_scene(system).works.of_springs(self.load)
        none = np.zeros(len(states.t))
        return sum((x.value(states.t, states.q, states.v) for x in springs), start=none)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Differentiate with respect to q and b."""
        springs = known_scene(system).works.of_springs(self.load)
        q, b = np.zeros(states.q.shape), np.zeros((len(states.t), system.n_b))
        for each in springs:
            by_q, _, by_b = each.partials(states.t, states.q, states.v)
            q, b = q + by_q, b + by_b
        return LeafGradient(q=Columns(slice(None), q), b=b)


@final
@dataclass(frozen=True)
class LoadPower(Leaf):
    """Power of a load."""

    load: str

    def __post_init__(self) -> None:
        require_text("load_power, load", self.load)

    def check_leaf(self, system: Named) -> None:
        """Refuse a load that does not exist."""
        known_scene(system).works.of_load(self.load)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return F . V."""
        return known_scene(system).works.of_load(self.load).value(states.t, states.q, states.v)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Differentiate with respect to q, v and b."""
        work = known_scene(system).works.of_load(self.load)
        q, v, b = work.partials(states.t, states.q, states.v)
        return LeafGradient(q=Columns(slice(None), q), v=Columns(slice(None), v), b=b)


@final
@dataclass(frozen=True)
class DriveWork(Leaf):
    """Power of a driven joint, at the rate of its law or at a rate of one."""

    joint: str
    unit_rate: bool

    def __post_init__(self) -> None:
        require_text("joint of an observable", self.joint)

    def check_leaf(self, system: Named) -> None:
        """Refuse a joint that does not exist or is not driven."""
        known_scene(system).works.of_joint(self.joint, self.unit_rate)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return lam . Phi_t."""
        work = known_scene(system).works.of_joint(self.joint, self.unit_rate)
        return work.value(states.t, states.q, states.lam)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Differentiate with respect to q, the joint's multipliers and b."""
        work = known_scene(system).works.of_joint(self.joint, self.unit_rate)
        q, lam, b = work.partials(states.t, states.q, states.lam)
        columns = np.arange(work.rows.start, work.rows.stop)
        return LeafGradient(q=Columns(slice(None), q), lam=Columns(columns, lam), b=b)
