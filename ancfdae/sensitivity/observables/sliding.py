"""Observables of sliding joints: the distance that the guide has slid along its beam, its rate."""

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import require_text
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.observable import (
    Columns,
    Leaf,
    LeafGradient,
    Named,
    Observable,
    States,
    known_naming,
)


def slide_distance(joint: str) -> Observable:
    """Return how far the guide of a `SlidingJoint` has slid along its beam since t = 0; m.

    The distance is measured along the beam in the reference configuration.
    """
    return _Slide(joint, rate=False)


def slide_speed(joint: str) -> Observable:
    """Return the rate at which the guide of a `SlidingJoint` slides along its beam; m/s."""
    return _Slide(joint, rate=True)


@final
@dataclass(frozen=True)
class _Slide(Leaf):
    """The distance that a sliding joint has moved along its beam, or its rate."""

    joint: str
    rate: bool

    def __post_init__(self) -> None:
        require_text("slide_speed, joint" if self.rate else "slide_distance, joint", self.joint)

    def check_leaf(self, system: Named) -> None:
        """Raise UnknownNameError unless the scene has a sliding joint of this name."""
        self._column(system)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the distance, m, or speed, m/s, of the guide at the states, shape (k,)."""
        return (states.v if self.rate else states.q)[:, self._column(system)]

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return the partial one in the column of the slide coordinate, or of its rate."""
        one = Columns(np.array([self._column(system)]), np.ones((1, 1)))
        return LeafGradient(v=one) if self.rate else LeafGradient(q=one)

    def _column(self, system: Named) -> int:
        layout = known_naming(system).layout
        return layout.d * layout.slider(self.joint).first_vector
