"""An equilibrium as the start of a motion, with its design derivatives."""

from __future__ import annotations

from functools import cached_property
from typing import final

from ancfdae.equations import MechanicalSystem
from ancfdae.errors import uninterrupted
from ancfdae.numerics.arrays import Array
from ancfdae.statics.derivatives import Tangent
from ancfdae.statics.equilibrium import Equilibrium, NoEquilibrium, find_equilibrium


@final
class RestingStart:
    """The equilibrium of a system at t = 0; found, and factorised, when first asked for.

    The system has the coordinates and design variables of the one that moves; the search starts
    at its own start.
    """

    def __init__(self, system: MechanicalSystem) -> None:
        self._system = system

    @cached_property
    def equilibrium(self) -> Equilibrium:
        """The equilibrium.

        NoEquilibrium if there is none under the full load; `FreeMechanism` if nothing holds a
        motion.
        """
        at_rest = uninterrupted(find_equilibrium(self._system))
        if not at_rest.outcome.success:
            raise NoEquilibrium(at_rest)
        return at_rest

    @cached_property
    def _tangent(self) -> Tangent:
        return Tangent(self._system, 0.0, self.equilibrium.q, self.equilibrium.lam)

    @property
    def q(self) -> Array:
        """Coordinates, shape (n_q,)."""
        return self.equilibrium.q

    @cached_property
    def q_b(self) -> Array:
        """Their design derivatives, shape (n_q, n_b)."""
        return self._tangent.sensitivities()[0]

    def pull_back(self, on_q: Array) -> Array:
        """Return q_b^T on_q by one transposed solve, shape (n_b,)."""
        return self._tangent.pull_back(on_q, 0 * self.equilibrium.lam)
