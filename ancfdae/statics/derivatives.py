"""Design derivatives of an equilibrium, direct and transposed.

K q_b + Phi_q^T lam_b = Q_b - (Phi_q^T lam)_b,      K = (Phi_q^T lam)_q - Q_q
Phi_q q_b             = -Phi_b

K of a thin beam holds sums of its axial stiffness that leave that of bending, (h/L)^2 of them: a
solution with its factors is right to (L/h)^2 units of round-off, and Q_b in a length is that of a
stretch which q_b takes back. Both are corrected by refinement: the residual of a solution is
differentiated as a whole, element by element, before anything is summed
(docs/theory/11-statics.md).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.held import force_total, held_q, held_total
from ancfdae.equations.saddle_points import solve, solve_transposed
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.linear_solvers import Factorization
from ancfdae.statics.balance import Balance

# The two parts of a saddle-point system's unknowns or equations.
Parts: TypeAlias = tuple[Array, Array]

# Refinement gains the digits that the factors have; with none left it gives up.
_REFINEMENTS = 20
# Corrections below the last digit of the coordinates are magnified to eleven digits below them.
_MAGNIFIED = 2.0**17


@final
class Tangent:
    """The factorised tangent of an equilibrium; raises SingularMatrix where there is none."""

    def __init__(self, system: MechanicalSystem, t: float, q: Array, lam: Array) -> None:
        balance = Balance(system, t, q, lam)
        self._system, self._t = system, t
        zero = np.zeros_like(q)
        self._q, self._lam, self._rest = q, lam, zero
        self._K, self._Phi_q = balance.tangent(1.0, q, lam), system.constraint_q(t, q)
        self._factors: Factorization = balance.factor(self._K, self._Phi_q)
        R, Phi = balance.unbalanced(q, lam), system.constraint(t, q)
        # Not where a caller linearises about what is no equilibrium.
        beyond = solve(self._factors, R, -Phi)[0]
        at_rest = balance.is_round_off(R, self._K, q, lam, beyond)
        self._beyond = beyond if at_rest else zero

    def sensitivities(self) -> Parts:
        """Return q_b and lam_b, shapes (n_q, n_b) and (n_lam, n_b)."""
        system = self._system
        start = np.zeros((system.n_q, system.n_b)), np.zeros((system.n_lam, system.n_b))
        return self._refined(start, self._left, solve)

    def pull_back(self, on_q: Array, on_lam: Array) -> Array:
        """Return q_b^T on_q + lam_b^T on_lam by transposed solves, shape (n_b,).

        With [mu, zeta] the transposed solution, on_q^T s_b - [mu, zeta]^T r_b, where r_b is the
        total derivative of the equations along any s_b: along the start's, of which little is
        left in q_b, round-off of mu does not meet the stretch.
        """
        system = self._system

        def left(mu: Array, zeta: Array) -> Parts:
            pushed = on_q - self._transposed_times(mu)
            pushed = pushed - system.constraint_pattern.dot_transposed(self._Phi_q, zeta)
            return pushed, on_lam - system.constraint_pattern.dot(self._Phi_q, mu)

        mu, zeta = self._refined((0 * on_q, 0 * on_lam), left, solve_transposed)
        s_b = system.start_b()[0]
        if not np.any(s_b):
            rest = self._rest[None]
            states = self._q[None], rest, rest, self._lam[None]
            return -system.pull_back(np.array([self._t]), states, (mu[None], zeta[None]))
        force, side = self._left(s_b, np.zeros((system.n_lam, system.n_b)))
        return np.asarray(on_q @ s_b + mu @ force + zeta @ side)

    def _left(self, q_b: Array, lam_b: Array) -> Parts:
        """Return minus the total derivatives of Phi_q^T lam - Q and of Phi."""
        system, q, lam, t = self._system, self._q, self._lam, self._t
        still = np.zeros_like(q_b)
        force = self._exactly(lambda q: force_total(system, t, q, self._rest, q_b, still))
        force = force - held_total(system, t, q, self._rest, lam, q_b)
        force = force - system.constraint_pattern.dot_transposed(self._Phi_q, lam_b)
        side = system.constraint_total(t, (q,), (q_b,))
        return force, -side

    def _transposed_times(self, mu: Array) -> Array:
        """Return K^T mu; the elements' part, which is symmetric, element by element."""
        system, pattern = self._system, self._system.pattern
        moving = 1j * STEP * mu
        rate = self._exactly(lambda q: system.force(self._t, q + moving, self._rest).imag)
        product: Array = -rate / STEP
        held = held_q(system, self._t, self._q, self._rest, self._lam)
        product = product + pattern.dot(held, mu)
        K = pattern.csr(self._K)
        product += (K.T - K) @ mu
        return product

    def _exactly(self, value: Callable[[Array], Array]) -> Array:
        """Return a function of q at the equilibrium corrected for the round-off of q.

        Coordinates round to eps |q|, which leaves the axial force eps EA: (L/h)^2 times what bends
        a beam. The correction that q is too coarse for is taken magnified, by a central difference;
        forces of beams are cubic in q.
        """
        step = _MAGNIFIED * self._beyond
        slope = (value(self._q + step) - value(self._q - step)) / (2 * _MAGNIFIED)
        return value(self._q) + slope

    def _refined(
        self,
        x: Parts,
        left: Callable[[Array, Array], Parts],
        solver: Callable[[Factorization, Array, Array], Parts],
    ) -> Parts:
        """Add corrections as long as each column's are less than half of the last ones."""
        last = np.array(np.inf)
        for _ in range(_REFINEMENTS):
            change = solver(self._factors, *left(*x))
            size = self._size(change[0])
            shrinking = size < 0.5 * last
            on_q, on_lam = (np.where(shrinking, part, 0.0) for part in change)
            x = x[0] + on_q, x[1] + on_lam
            if not np.any(shrinking):
                break
            last = np.where(shrinking, size, 0.0)
        return x

    def _size(self, x: Array) -> Array:
        return np.asarray(np.sqrt(self._system.weights @ (x * x)))
