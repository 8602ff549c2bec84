"""Observables of controllers: their states, and the torques and forces that they act with."""

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import require_kind, require_text
from ancfdae.errors.kinds import UnknownNameError
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.observable import Columns, Leaf, LeafGradient, Observable
from ancfdae.sensitivity.observables.states import Named, States, known_naming, known_scene


def state(controller: str, name: str) -> Observable:
    """Return a state of a controller, such as ``state("motor", "current")``; its own unit."""
    return ControllerState(controller, name)


def effort(controller: str, axis: int = 0) -> Observable:
    """Return the torque, N m, or the force, N, of a controller on one of its axes.

    Axes are counted from 0 on; a `PID` or a `DCMotor` has one.
    """
    return ControllerEffort(controller, axis)


@final
@dataclass(frozen=True)
class ControllerState(Leaf):
    """A state of a controller."""

    controller: str
    name: str

    def __post_init__(self) -> None:
        require_text("state, controller", self.controller)
        require_text("state, name", self.name)

    def check_leaf(self, system: Named) -> None:
        """Raise UnknownNameError for a controller or a state that does not exist."""
        its = known_naming(system).layout.controller(self.controller)
        if self.name not in its.states:
            raise UnknownNameError(f"state of {self.controller!r}", self.name, its.states)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the state at the times, shape (n_t,)."""
        return states.v[:, self._column(system)]

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return one in the column of the velocity that is the state."""
        return LeafGradient(v=Columns(np.array([self._column(system)]), np.ones((1, 1))))

    def _column(self, system: Named) -> int:
        layout = known_naming(system).layout
        its = layout.controller(self.controller)
        return layout.d * (its.first_vector + its.states.index(self.name))


@final
@dataclass(frozen=True)
class ControllerEffort(Leaf):
    """A torque or a force of a controller."""

    controller: str
    axis: int

    def __post_init__(self) -> None:
        require_text("effort, controller", self.controller)
        require_kind("effort, axis", self.axis, (int, np.integer), "Counted from 0 on.")

    def check_leaf(self, system: Named) -> None:
        """Raise UnknownNameError or InvalidInputError for one that does not exist."""
        known_scene(system).works.of_controller(self.controller, self.axis)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the effort at the times, shape (n_t,)."""
        function = known_scene(system).works.of_controller(self.controller, self.axis)
        return function.value(states.t, states.q, states.v)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Differentiate with respect to q, v and b."""
        function = known_scene(system).works.of_controller(self.controller, self.axis)
        q, v, b = function.partials(states.t, states.q, states.v)
        return LeafGradient(q=Columns(slice(None), q), v=Columns(slice(None), v), b=b)
