"""Continuous adjoint (eqs. 26-42): adjoint equations integrated backward by HHT-I3.

With f = M a + Phi_q^T lam - Q, a held, and mu_tau the derivative in reversed time
tau = t_2 - t, the adjoint equations (36), (37) read

    M mu_tautau + K mu + C mu_tau + Phi_q^T zeta = r,      Phi_q mu = H_lam^T,
    K = (f_q - f_v' + M'')^T,   C = (f_v - 2 M')^T,        r = H_q^T - (H_v^T)',

where ' is the time derivative along the motion; the paper's mass is constant, and M' and M''
come from integrating mu^T M q'' by parts twice. One step of HHT-I3 is linear:

    [ M/(1+alpha) + beta h^2 K + gamma h C   Phi_q^T ] [x   ]
    [ Phi_q                                  0       ] [zeta]
      = [ r - alpha/(1+alpha) M A - K mu~ - C mu~_tau ;  (H_lam^T - Phi_q mu~)/(beta h^2) ]

with A the mu_tautau of the step before.

End conditions at t_2: (39), (40) for mu and epsilon; for mu' and gamma (38) with the time
derivative of (37), Phi_q mu' + (Phi_q)' mu = (H_lam^T)'. Equation (41) of the paper lacks
-(Phi_q)' mu, which may be dropped only where H_lam(t_2) = 0.

Time derivatives of M, f_v, H_v and H_lam along the run are taken by second-order differences on
its grid, so the gradient differs from the discrete one by O(h^2).
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy

from ancfdae.equations import Linearisation, MechanicalSystem
from ancfdae.equations.saddle_points import saddle_point, solve, solve_transposed
from ancfdae.equations.solution import Solution
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.integrators.hht.equations import Steps, acceleration, correct, predict, require_alpha
from ancfdae.integrators.problem import accelerations
from ancfdae.integrators.start import Covectors, consistent_start, pull_back_start
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.numerics.threads import in_one_thread
from ancfdae.numerics.timing import progress_bar
from ancfdae.sensitivity.method import (
    Gradient,
    GradientMethod,
    Run,
    finished,
    keeping,
    require_differentiable,
)
from ancfdae.sensitivity.objectives import Objective, ObjectivePartials
from ancfdae.sensitivity.objectives.reductions import OverTime
from ancfdae.sensitivity.observables.expression import leaves
from ancfdae.sensitivity.observables.observable import states_of

# Least number of steps, for the one-sided differences at the end.
_LEAST_STEPS = 4


@final
@dataclass(frozen=True)
class ContinuousAdjoint(GradientMethod):
    """Gradients by the adjoint equations of the paper, integrated backward with HHT-I3.

    For objectives that are functions of time integrals, on the output times of a run of any
    integrator. Provided for comparison: `Adjoint` costs the same and is exact for the discrete run.
    The error is of second order in even steps, of first order in uneven ones.

    Parameters
    ----------
    hht_alpha : float
        Numerical damping of the backward integration, as in `HHT`; dimensionless.
    """

    hht_alpha: float = -0.3

    def __post_init__(self) -> None:
        require_alpha("ContinuousAdjoint.hht_alpha", self.hht_alpha)

    @in_one_thread
    def gradients(self, run: Run, objectives: Sequence[Objective]) -> list[Gradient]:
        """Return value and gradient of each objective by one run and a backward run for each."""
        system = run.system
        for objective in objectives:
            if not all(isinstance(leaf, OverTime) for leaf in leaves(objective)):
                raise InvalidInputError(
                    "ContinuousAdjoint",
                    "needs an objective made of time integrals (eq. 20)",
                    repr(objective),
                    "Use Adjoint for values at given times.",
                )
        solution = finished(run.solution())
        if len(solution.t) <= _LEAST_STEPS:
            raise InvalidInputError(
                "ContinuousAdjoint",
                "needs four steps",
                len(solution.t) - 1,
                "Use shorter steps, or method=Adjoint().",
            )
        require_differentiable(system, solution.t, solution.q, solution.v)
        results = []
        for objective in objectives:
            value = objective.value(system, states_of(solution))
            started = time.perf_counter()
            with keeping(solution):
                smooth = _with_smooth_multipliers(system, solution, run.progress)
                partials = objective.partials(system, states_of(smooth))
                backward = _BackwardRun(system, self.hht_alpha, smooth, partials)
                total = backward.gradient(run.progress)
            # Two factorisations per step: for the multipliers and backward; one more at the end.
            factorised, seconds = 2 * len(solution.t) - 1, time.perf_counter() - started
            done = solution.with_pass(factorised, seconds)
            results.append(Gradient(value, total, system.design_names, self, done))
        return results


def _with_smooth_multipliers(
    system: MechanicalSystem, solution: Solution, progress: bool
) -> Solution:
    """Return the solution with multipliers recomputed from positions and velocities.

    Multipliers of HHT-I3 carry transients of O(h^2) from the start and from changes of the step.
    (37) would divide these by h^2 on the way to zeta, and the gradient would err by O(h).
    """
    solve = accelerations(system, saddle_point(system, 0.0)).solve
    states = list(zip(solution.t[1:], solution.q[1:], solution.v[1:], strict=True))
    bar = progress_bar(progress, states, desc="multipliers", unit="step")
    later = [solve(float(t), q, v)[1] for t, q, v in bar]
    # At the start the reported v has no shift, unlike at later times: extrapolate to the start.
    near, t = slice(0, _LEAST_STEPS), solution.t
    first = scipy.interpolate.BarycentricInterpolator(t[1:][near], later[near])(t[0])
    return replace(solution, lam=np.stack([first, *later]))


@final
@dataclass(frozen=True)
class _Adjoint:
    """Adjoint variables at one time; x is HHT-I3's algorithmic mu_tautau, A the true one."""

    mu: Array
    mu_tau: Array
    x: Array
    zeta: Array
    A: Array


@final
class _BackwardRun:
    """Integrates the adjoint variables of one objective backward along one run."""

    def __init__(
        self,
        system: MechanicalSystem,
        alpha: float,
        solution: Solution,
        partials: ObjectivePartials,
    ) -> None:
        self._system, self._solution, self._partials = system, solution, partials
        self._steps = Steps(np.diff(solution.t), alpha)
        self._matrices: SaddlePoint = saddle_point(system, 0.0)
        t, q, v, lam = solution.t, solution.q, solution.v, solution.lam
        self._local: Linearisation = system.linearise(t, q, v, solution.a, lam)
        # The trapezoidal rule is in the rows of the partials; take it out again: H_q, H_v, H_lam.
        self._w = states_of(solution).grid.weights()
        H_q = self._density(partials.q, system.n_q)
        H_v = self._density(partials.v, system.n_q)
        self._H_v, self._H_lam = H_v, self._density(partials.lam, system.n_lam)
        self._r = H_q - np.gradient(H_v, t, axis=0, edge_order=2)
        self._end_rates = _end_rates(t)
        self._coefficients(t)

    def _coefficients(self, t: Array) -> None:
        """Set P = f_v - M', K = f_q - P' and C = P - M' of every time; None for zero."""
        self._P = self._C = self._local.f_v
        if not self._system.traits.constant_mass:
            M_t = np.gradient(self._local.M, t, axis=0, edge_order=2)
            self._P = -M_t if self._P is None else self._P - M_t
            self._C = self._P - M_t
        self._K = self._local.f_q
        if self._P is not None:
            self._K = self._K - np.gradient(self._P, t, axis=0, edge_order=2)

    def _mass(self, n: int) -> Array:
        M: Array = self._local.M[0 if self._system.traits.constant_mass else n]
        return M

    def gradient(self, progress: bool) -> Array:
        """Return the gradient of the objective by eq. (42), shape (n_b,)."""
        system, s = self._system, self._solution
        state, epsilon, gamma = self._end()
        mu, zeta = np.zeros_like(s.q), np.zeros_like(s.lam)
        mu[-1], zeta[-1] = state.mu, state.zeta
        steps = range(len(s.t) - 2, -1, -1)
        for n in progress_bar(progress, steps, desc="adjoint", unit="step"):
            state = self._step(state, n)
            mu[n], zeta[n] = state.mu, state.zeta
        weighted = mu * self._w[:, None], zeta * self._w[:, None]
        total = self._partials.b - system.pull_back(s.t, (s.q, s.v, s.a, s.lam), weighted)
        total = total + self._start_terms(state)
        q, v, t = s.q[-1], s.v[-1], float(s.t[-1])
        ends = gamma @ system.constraint_total(t, (q,))
        ends = ends + epsilon @ system.constraint_total(t, (q, v))
        return np.asarray(total - ends)

    def _density(self, rows: Array | None, n: int) -> Array:
        if rows is None:
            return np.zeros((len(self._w), n))
        density = rows / np.where(self._w == 0, 1.0, self._w)[:, None]
        if self._w[0] == 0:
            # Radau's quadrature has no weight at the start: extrapolate from the next two times.
            t = self._solution.t
            density[0] = density[1] + (t[0] - t[1]) / (t[2] - t[1]) * (density[2] - density[1])
        return density

    def _end(self) -> tuple[_Adjoint, Array, Array]:
        """Return the adjoint variables at t_2, epsilon and gamma (eqs. 38-41)."""
        system, s, (first, _) = self._system, self._solution, self._end_rates
        q, v, t = s.q[-1], s.v[-1], float(s.t[-1])
        factors = self._matrices.factor(self._mass(-1), self._local.Phi_q[-1])
        mu, epsilon = solve(factors, np.zeros(system.n_q), self._H_lam[-1])
        turned = system.constraint_q(t, q, v)
        force = system.constraint_pattern.dot_transposed(turned, epsilon) - self._H_v[-1]
        if self._P is not None:
            force = force + system.pattern.dot_transposed(self._P[-1], mu)
        products = np.array(
            [system.constraint_pattern.dot(row, mu) for row in self._local.Phi_q[-4:]]
        )
        rate = first @ self._H_lam[-3:]
        # (Phi_q)' mu with mu held, from Phi_q at the last instants.
        turning = first @ products[-3:]
        mu_t, minus_gamma = solve(factors, force, rate - turning)
        return self._accelerated(mu, -mu_t, products, factors), epsilon, -minus_gamma

    def _accelerated(
        self, mu: Array, mu_tau: Array, products: Array, factors: Factorization
    ) -> _Adjoint:
        """Return the adjoint state at the end time, with mu'' and zeta from (36) and (37)''."""
        first, second = self._end_rates
        pattern, Phi_q = self._system.constraint_pattern, self._local.Phi_q
        moving = np.array([pattern.dot(row, -mu_tau) for row in Phi_q[-3:]])
        side = second @ (self._H_lam[-4:] - products) - 2 * (first @ moving)
        x, zeta = solve(factors, -self._forces(-1, mu, mu_tau), side)
        return _Adjoint(mu, mu_tau, x, zeta, x)

    def _forces(self, n: int, mu: Array, mu_tau: Array) -> Array:
        """Return the adjoint forces K mu + C mu_tau - r at time point n, shape (n_q,)."""
        dot = self._system.pattern.dot_transposed
        force: Array = dot(self._K[n], mu) - self._r[n]
        return force if self._C is None else force + dot(self._C[n], mu_tau)

    def _step(self, before: _Adjoint, n: int) -> _Adjoint:
        """Return the adjoint variables at t_n by one step of HHT-I3 from t_{n+1}."""
        system, c = self._system, self._steps.of(n + 1)
        scale = 1 + c.alpha
        M = self._mass(n)
        # As `rescaled` of HHT: the preceding step in reversed time may be of another size.
        last = n + 2 >= len(self._solution.t)
        ratio = 1.0 if last else 1 / self._steps.ratio(n + 1)
        x = before.A + ratio * (before.x - before.A)
        mu_p, tau_p = predict(c, before.mu, before.mu_tau, x)
        K = M / scale + (c.beta * c.h**2) * self._K[n]
        if self._C is not None:
            K = K + (c.gamma * c.h) * self._C[n]
        memory = system.pattern.dot(M, (c.alpha / scale) * before.A)
        side = self._H_lam[n] - system.constraint_pattern.dot(self._local.Phi_q[n], mu_p)
        force, side = -memory - self._forces(n, mu_p, tau_p), side / (c.beta * c.h**2)
        factors = self._matrices.factor(K, self._local.Phi_q[n])
        x, zeta = solve_transposed(factors, force, side)
        mu, mu_tau = correct(c, mu_p, tau_p, x)
        return _Adjoint(mu, mu_tau, x, zeta, acceleration(c, x, before.A))

    def _start_terms(self, first: _Adjoint) -> Array:
        """Return mu^T M v_b - (H_v + (M mu)' - f_v^T mu) q_b at t_1, (n_b,), with mu' = -mu_tau."""
        system = self._system
        initial = consistent_start(system, self._matrices, 0.0)[0]
        dot = system.pattern.dot_transposed
        on_q = self._H_v[0] - dot(self._mass(0), first.mu_tau)
        if self._P is not None:
            on_q = on_q - dot(self._P[0], first.mu)
        on_v, none = dot(self._mass(0), first.mu), np.zeros(system.n_q)
        on = Covectors(-on_q, on_v, none, np.zeros(system.n_lam), np.zeros(system.n_b))
        return pull_back_start(system, self._matrices, initial, on)


def _end_rates(t: Array) -> tuple[Array, Array]:
    """Return weights of the last three (four) values in the first (second) end derivative."""
    x = t[-4:] - t[-1]
    first = np.linalg.solve(np.vander(x[-3:] / x[-3], increasing=True).T, [0.0, 1.0, 0.0])
    second = np.linalg.solve(np.vander(x / x[0], increasing=True).T, [0.0, 0.0, 2.0, 0.0])
    return first / x[-3], second / x[0] ** 2
