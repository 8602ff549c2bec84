"""Where a start without stiffness settles: implicit steps of the motion without inertia.

A mechanism that its weight holds, such as a pendulum that starts level, has no stiffness at
s = 0 and no path that begins there. Under the full load M_0 q' = Q - Phi_q^T lam goes downhill, in
steps 1/mu that grow until mu vanishes; what is left is Newton's method at mu = 0.
"""

from __future__ import annotations

from typing import final

from ancfdae.equations.saddle_points import solve
from ancfdae.errors import SingularMatrix, Verdict
from ancfdae.numerics.arrays import Array
from ancfdae.statics.balance import Balance, Unsolved
from ancfdae.statics.softness import softest

# The first step moves by about this part of the size of the system.
_FIRST = 0.1
# A step is easy up to these iterations.
_EASY = 6
# A step has settled that moves no more than this part, and holds no more of the load by its mu;
# one that ends farther away has left.
_SETTLED, _HELD, _GONE = 1e-10, 1e-6, 100.0
# 4^30 is no reason to try once more.
_FAILURES = 30


@final
class Settling:
    """Goes downhill under the full load; q and lam are the state reached.

    `steps` have converged, the last of the size `residual`; `gone` is whether it grew without
    bound.
    """

    def __init__(self, balance: Balance, max_steps: int) -> None:
        self._balance, self._max_steps = balance, max_steps
        self.q, self.lam = balance.q_0, balance.lam_0
        self.steps, self.residual, self.gone = 0, 0.0, False

    def run(self) -> Verdict:
        """Settle; return the verdict."""
        try:
            return self._run()
        except KeyboardInterrupt:
            return Verdict.INTERRUPTED

    def _run(self) -> Verdict:
        balance, mu, failures = self._balance, self._first_mu(), 0
        for _ in range(self._max_steps):
            solved = balance.solve(1.0, self.q, self.lam, mu, self.q)
            if isinstance(solved, Unsolved):
                balance.work.rejected += 1
                self.residual, failures, mu = solved.residual, failures + 1, 4.0 * mu
                if failures > _FAILURES:
                    return solved.verdict
                continue
            moved, held = self._share(solved.q - self.q), self._held(mu, solved.q - self.q)
            if moved > _SETTLED and not (
                solved.definite or softest(balance, 1.0, solved.q, solved.lam, mu).stable
            ):
                # A step this long goes uphill.
                balance.work.rejected += 1
                mu *= 4.0
                continue
            balance.work.steps += 1
            self.steps += 1
            self.q, self.lam, self.residual, failures = solved.q, solved.lam, moved, 0
            if self._share(self.q - balance.q_0) > _GONE:
                self.gone = True
                return Verdict.NO_CONVERGENCE
            if moved <= _SETTLED and held <= _HELD:
                return Verdict.EQUILIBRIUM
            mu /= 8.0 if solved.iterations <= _EASY else 2.0
        return Verdict.STEP_LIMIT

    def _held(self, mu: float, dq: Array) -> float:
        """Part of the load that a step has left to do."""
        b = self._balance
        return b.strength(mu * b.system.pattern.dot(b.M_0, dq)) / b.load

    def _share(self, dq: Array) -> float:
        return self._balance.length(dq) / self._balance.extent

    def _first_mu(self) -> float:
        """Mu with which the accelerations at the start move it by a tenth of its size."""
        b = self._balance
        force = b.held_back(b.q_0)
        try:
            a = solve(b.factor(b.M_0, b.Phi_q(b.q_0)), force, 0 * b.Phi_0)[0]
        except SingularMatrix:
            a = force / b.system.weights
        # Where nothing is to move any mu does.
        return b.length(a) / (_FIRST * b.extent) or 1.0
