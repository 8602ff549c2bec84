"""Products with the stiffness at an equilibrium, computed element by element, and refinement.

In K of a thin beam, sums of axial stiffness leave the bending stiffness, (h/L)^2 times as large:
products with the matrix, and solutions with its factors, are right to (L/h)^2 units of round-off.
The force of an element along a motion is a stress times a strain rate, in which rigid rotation has
cancelled. Residuals computed with it refine what the factors give (docs/theory/11-statics.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.saddle_points import held_q
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.linear_solvers import Factorization

# The two parts of a saddle-point system's unknowns or equations.
Parts: TypeAlias = tuple[Array, Array]

# Most steps of refinement; each gains as many digits as the factors have.
_REFINEMENTS = 20
# Factor on corrections below the last digit of the coordinates, so that coordinates can hold them.
_MAGNIFIED = 2.0**17


@final
@dataclass(frozen=True)
class ExactProducts:
    """Forces and products with K at a state q, lam in balance at time t.

    K are entries of the tangent stiffness; `beyond`, (n_q,), is the correction of q by Newton's
    method that is too small to be added.
    """

    system: MechanicalSystem
    t: float
    q: Array
    lam: Array
    K: Array
    beyond: Array

    def corrected(self, value: Callable[[Array], Array]) -> Array:
        """Return a function of q at the equilibrium, corrected for the round-off of q.

        Coordinates round to eps |q|, which leaves an axial force eps EA: (L/h)^2 times the forces
        that bend a beam. The last correction of Newton's method is smaller than q can hold: it is
        magnified, and its effect taken by a central difference. Forces of beams are cubic in q.
        """
        step = _MAGNIFIED * self.beyond
        slope = (value(self.q + step) - value(self.q - step)) / (2 * _MAGNIFIED)
        return value(self.q) + slope

    def times(self, x: Array) -> Array:
        """Return K x for a motion x, (n_q,), by complex steps of the forces."""
        system, rest, moving = self.system, np.zeros_like(self.q), 1j * STEP * x
        rate = self.corrected(lambda q: system.force(self.t, q + moving, rest).imag)
        held = held_q(system, self.t, self.q, rest, self.lam)
        return np.asarray(system.pattern.dot(held, x) - rate / STEP)

    def transposed_times(self, x: Array) -> Array:
        """Return K^T x for a vector x, (n_q,): K x, plus (K^T - K) x by the matrix."""
        K = self.system.pattern.csr(self.K)
        return np.asarray(self.times(x) + (K.T - K) @ x)


def refined(
    system: MechanicalSystem,
    factors: Factorization,
    x: Parts,
    left: Callable[[Array, Array], Parts],
    solver: Callable[[Factorization, Array, Array], Parts],
) -> Parts:
    """Return the solution x, each column refined as long as its corrections halve.

    `left` returns what a solution leaves of the right-hand sides.
    """
    last = np.array(np.inf)
    for _ in range(_REFINEMENTS):
        change = solver(factors, *left(*x))
        size = np.sqrt(system.weights @ change[0] ** 2)
        shrinking = size < 0.5 * last
        on_q, on_lam = (np.where(shrinking, part, 0.0) for part in change)
        x = x[0] + on_q, x[1] + on_lam
        if not np.any(shrinking):
            break
        last = np.where(shrinking, size, 0.0)
    return x
