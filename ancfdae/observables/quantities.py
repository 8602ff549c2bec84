"""Observables of joints and energies, time, and the design variables themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from ancfdae.ancf import AncfSystem
from ancfdae.errors import InvalidInput, UnknownName
from ancfdae.numerics.arrays import Array
from ancfdae.observables.observable import Leaf, LeafGradient, Observable, Rows
from ancfdae.observables.states import Named, States, known_naming, known_system, require_index
from ancfdae.protocol import MechanicalSystem


def reaction(joint: str, axis: int) -> Observable:
    """Return a component of the force of a joint on its first point; N.

    It is minus a multiplier of the joint's first equations, as in `Solution.reaction`; for joints
    that hold a point in all directions. For others see `multiplier`.

    Parameters
    ----------
    joint : str
        Name of the joint.
    axis : int
        0, 1 or 2 for x, y or z.
    """
    return Reaction(joint, axis)


def multiplier(joint: str, row: int) -> Observable:
    """Return a multiplier of a joint.

    Parameters
    ----------
    joint : str
        Name of the joint.
    row : int
        Number of its equation, from 0 on.
    """
    return Multiplier(joint, row)


def strain_energy(beam: str | None = None) -> Observable:
    """Return the strain energy of a beam, or of the whole scene; J."""
    return StrainEnergy(beam)


def kinetic_energy(beam: str | None = None) -> Observable:
    """Return the kinetic energy of a beam, or of the whole scene; J."""
    return KineticEnergy(beam)


def time() -> Observable:
    """Return the time; s."""
    return Time()


def design_value(name: str) -> Observable:
    """Return the value of a design variable, the same at every instant.

    Parameters
    ----------
    name : str
        As in `MechanicalSystem.design_names`, such as ``"rod.height"``.
    """
    return Design(name)


@final
@dataclass(frozen=True)
class Reaction(Leaf):
    """Component of the force of a joint on its first point.

    Raises
    ------
    InvalidInput
        If the axis is not 0, 1 or 2.
    """

    multipliers: ClassVar[bool] = True

    joint: str
    axis: int

    def __post_init__(self) -> None:
        """Validate."""
        require_index("reaction, axis", self.axis)

    def check_leaf(self, system: Named) -> None:
        """Refuse a joint or an axis that does not exist."""
        layout = known_naming(system).layout
        if not layout.joint(self.joint).holds_position:
            raise InvalidInput(
                f"reaction of {self.joint!r}",
                "is defined for joints that hold a point in all directions",
                "a joint of another kind",
                "Use multiplier(joint, row).",
            )
        require_index("reaction, axis", self.axis, layout.d)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Minus the multiplier."""
        return -states.lam[:, self._row(system)]

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Minus one in the column of the multiplier."""
        return LeafGradient(lam=Rows(np.array([self._row(system)]), np.array([[-1.0]])))

    def _row(self, system: Named) -> int:
        return known_naming(system).layout.joint(self.joint).first_row + self.axis


@final
@dataclass(frozen=True)
class Multiplier(Leaf):
    """Multiplier of an equation of a joint."""

    multipliers: ClassVar[bool] = True

    joint: str
    row: int

    def check_leaf(self, system: Named) -> None:
        """Refuse a joint or an equation that does not exist."""
        place = known_naming(system).layout.joint(self.joint)
        require_index(f"multiplier of {self.joint!r}, row", self.row, place.rows)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the multiplier."""
        return states.lam[:, self._row(system)]

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """One in the column of the multiplier."""
        return LeafGradient(lam=Rows(np.array([self._row(system)]), np.array([[1.0]])))

    def _row(self, system: Named) -> int:
        return known_naming(system).layout.joint(self.joint).first_row + self.row


@final
@dataclass(frozen=True)
class StrainEnergy(Leaf):
    """Strain energy of a beam or of the scene."""

    beam: str | None

    def check_leaf(self, system: Named) -> None:
        """Refuse a beam that does not exist, or a solution without its system."""
        _check_energy(system, self.beam)

    def leaf_value(self, system: Named, states: States) -> Array:
        """U of every instant."""
        return _ancf(system).strain_energies(states.q, beam=self.beam)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """U_q and U_b."""
        scene = _ancf(system)
        rows = Rows(slice(None), scene.strain_energies_q(states.q, beam=self.beam))
        return LeafGradient(q=rows, b=scene.strain_energies_b(states.q, beam=self.beam))


@final
@dataclass(frozen=True)
class KineticEnergy(Leaf):
    """Kinetic energy of a beam or of the scene."""

    beam: str | None

    def check_leaf(self, system: Named) -> None:
        """Refuse a beam that does not exist, or a solution without its system."""
        _check_energy(system, self.beam)

    def leaf_value(self, system: Named, states: States) -> Array:
        """T of every instant (eq. 9)."""
        return _ancf(system).kinetic_energies(states.v, beam=self.beam)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """T_v and T_b."""
        scene = _ancf(system)
        rows = Rows(slice(None), scene.kinetic_energies_v(states.v, beam=self.beam))
        return LeafGradient(v=rows, b=scene.kinetic_energies_b(states.v, beam=self.beam))


@final
@dataclass(frozen=True)
class Time(Leaf):
    """Time."""

    def check_leaf(self, system: Named) -> None:
        """Every system has a time."""

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the instants."""
        return states.t

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Time depends on nothing."""
        return LeafGradient()


@final
@dataclass(frozen=True)
class Design(Leaf):
    """Value of a design variable."""

    name: str

    def check_leaf(self, system: Named) -> None:
        """Refuse a design variable that the system does not have."""
        known = known_system(self.name, system).design_names
        if self.name not in known:
            raise UnknownName("design variable", self.name, known)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return b_i at every instant."""
        mechanical = known_system(self.name, system)
        return np.full(len(states.t), mechanical.b[mechanical.design_names.index(self.name)])

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """One for the variable itself."""
        b = np.zeros((len(states.t), system.n_b))
        b[:, system.design_names.index(self.name)] = 1.0
        return LeafGradient(b=b)


def _ancf(system: Named) -> AncfSystem:
    if not isinstance(system, AncfSystem):
        raise InvalidInput(
            "energy",
            "needs the assembled scene",
            type(system).__name__,
            "Pass assemble(scene, design).",
        )
    return system


def _check_energy(system: Named, beam: str | None) -> None:
    layout = known_naming(_ancf(system)).layout
    if beam is not None:
        layout.beam(beam)
