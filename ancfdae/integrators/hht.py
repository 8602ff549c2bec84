"""HHT-I3 with a fixed step (eqs. 2-6, Fig. 1)."""

from __future__ import annotations

import math
import time
import warnings
from dataclasses import dataclass
from typing import final

import numpy as np
from tqdm import tqdm

from ancfdae.errors import (
    InvalidInput,
    Outcome,
    SingularMatrix,
    StabilityWarning,
    Verdict,
    require_count,
    require_finite,
    require_positive,
)
from ancfdae.integrators import hht_linear
from ancfdae.integrators.contract import AdjointIntegrator
from ancfdae.integrators.hht_equations import (
    Coefficients,
    Node,
    acceleration,
    correct,
    factor_jacobian,
    predict,
    residual,
    start_node,
    start_node_sensitivity,
)
from ancfdae.integrators.initial import (
    consistent_start,
    saddle_point,
    start_sensitivity,
)
from ancfdae.integrators.recorder import Recorder
from ancfdae.integrators.seeds import Seeds
from ancfdae.numerics.arrays import Array, is_finite, real_norm
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.solution import Sensitivities, Solution
from ancfdae.system import MechanicalSystem

# A matrix is replaced when an iteration shrinks the correction by less than this factor.
_SLOW = 0.2
# Corrections that stop shrinking are round-off if they are this small against the motion.
_ROUND_OFF = 1e-6
# Forces may grow by this factor from one step to the next before the Newton test gets stricter.
_JUMP = 100.0
# Steps may miss the end time by this many parts of their number (accumulated round-off).
_WHOLE = 1e-9


@final
@dataclass(frozen=True)
class HHT(AdjointIntegrator):
    """HHT-I3 at a fixed step (Negrut, Rampalli, Ottarsson & Sajdak 2007).

    Parameters
    ----------
    step : float
        Step size h; s.
    hht_alpha : float
        Numerical damping, in [-1/3, 0]. Second order throughout; -1/3 damps frequencies above
        1/h most. At 0 the multipliers oscillate and do not converge, which is warned about.
    newton_tolerance : float
        Estimated error of a and lam after the last iteration, relative to the forces of the
        motion; free of units.
    max_iterations : int
        Newton iterations per step before the run ends with an outcome.

    Raises
    ------
    InvalidInput
        If a setting is out of range.
    """

    step: float
    hht_alpha: float = -0.3
    newton_tolerance: float = 1e-14
    max_iterations: int = 60

    def __post_init__(self) -> None:
        """Validate."""
        require_positive("HHT.step", self.step)
        require_finite("HHT.hht_alpha", self.hht_alpha)
        if not -1 / 3 <= self.hht_alpha <= 0:
            raise InvalidInput(
                "HHT.hht_alpha",
                "must lie in [-1/3, 0]",
                self.hht_alpha,
                "-0.3 damps fast motion strongly, -0.05 hardly.",
            )
        require_positive("HHT.newton_tolerance", self.newton_tolerance)
        require_count("HHT.max_iterations", self.max_iterations, "60 is plenty.")
        # A NumPy number of single precision would spread its precision.
        for name in ("step", "hht_alpha", "newton_tolerance"):
            object.__setattr__(self, name, float(getattr(self, name)))
        if self.hht_alpha == 0:
            warnings.warn(
                "HHT.hht_alpha = 0 leaves errors of the multipliers undamped: they oscillate and "
                "grow with the number of steps. Use a negative value, such as -0.05.",
                StabilityWarning,
                stacklevel=3,
            )

    def integrate(
        self,
        system: MechanicalSystem,
        t_end: float,
        *,
        sensitivities: bool = False,
        progress: bool = False,
    ) -> Solution:
        """Integrate from t = 0 to `t_end`, a whole number of steps."""
        count = self._count_steps(t_end)
        c = self._coefficients()
        matrices = saddle_point(system, 0.0)
        initial = consistent_start(system, matrices, 0.0)
        recorder = Recorder(system, count + 1)
        solver = _StepSolver(system, matrices, c, self, recorder)
        node = start_node(system, matrices, c, initial)
        recorder.record(initial.t, initial.q, initial.v, initial.a, initial.lam)
        verdict = Verdict.FINISHED
        try:
            for n in tqdm(range(1, count + 1), disable=not progress, unit="step"):
                # A run that blows up overflows; its outcome tells so, not NumPy's warnings.
                with np.errstate(over="ignore", invalid="ignore"):
                    after = solver.advance(node, n * self.step)
                if after is None:
                    verdict = solver.verdict
                    break
                node = after
                recorder.record(node.t, node.q, node.v, node.A, node.lam)
        except SingularMatrix:
            verdict = Verdict.SINGULAR
        except KeyboardInterrupt:
            verdict = Verdict.INTERRUPTED
        size = 0.0 if verdict is Verdict.FINISHED else solver.correction
        steps = recorder.steps
        solution = recorder.solution(Outcome(verdict, steps * self.step, steps, size))
        return self.differentiate(system, solution) if sensitivities else solution

    def differentiate(self, system: MechanicalSystem, solution: Solution) -> Solution:
        """Add the design derivatives of a run of this integrator (eqs. 22-25).

        If a matrix is singular or the pass is interrupted, the solution is cut to what has
        derivatives and its outcome says so.
        """
        started, c = time.perf_counter(), self._coefficients()
        matrices = saddle_point(system, 0.0)
        initial = consistent_start(system, matrices, 0.0)
        derivative = start_sensitivity(system, matrices, initial)
        node_b = start_node_sensitivity(system, matrices, c, initial, derivative)
        arrays, verdict = hht_linear.differentiate(system, matrices, c, solution, node_b)
        arrays[1][0] = derivative.v_b  # A solution reports the consistent start.
        own = Sensitivities(system.design_names, system.b, *arrays)
        seconds = time.perf_counter() - started
        return solution.with_sensitivities(own, verdict, len(arrays[0]) - 1, seconds)

    def pull_back(self, system: MechanicalSystem, solution: Solution, seeds: Seeds) -> Array:
        """Return the gradient of an objective by the discrete adjoint."""
        c, matrices = self._coefficients(), saddle_point(system, 0.0)
        initial = consistent_start(system, matrices, 0.0)
        derivative = start_sensitivity(system, matrices, initial)
        node_b = start_node_sensitivity(system, matrices, c, initial, derivative)
        gradient, back = hht_linear.pull_back(system, matrices, c, solution, seeds)
        for covector, start_b in (
            (back.q_b, node_b.q_b),
            (back.v_b, node_b.v_b),
            (back.a_b, node_b.a_b),
            (back.A_b, node_b.A_b),
        ):
            gradient = gradient + covector @ start_b
        # What an objective reads at t = 0 is the consistent start, not the shifted one.
        for seed, start_b in (
            (seeds.q, derivative.q_b),
            (seeds.v, derivative.v_b),
            (seeds.lam, derivative.lam_b),
        ):
            if seed is not None:
                gradient = gradient + seed[0] @ start_b
        return gradient

    def _coefficients(self) -> Coefficients:
        return Coefficients.of(self.step, self.hht_alpha)

    def _count_steps(self, t_end: float) -> int:
        require_positive("t_end", t_end)
        steps = t_end / self.step
        count = round(steps) if math.isfinite(steps) else 0
        if count < 1 or not math.isclose(steps, count, rel_tol=_WHOLE):
            raise InvalidInput(
                "t_end",
                f"must be a whole number of steps of {self.step:.6g}",
                f"{t_end:.6g}, that is {steps:.6g} steps",
                f"Use t_end = {max(count, 1) * self.step:.6g}, or another step.",
            )
        return count


@final
class _StepSolver:
    """Newton's method for one step after another, with the matrix kept while it serves."""

    def __init__(
        self,
        system: MechanicalSystem,
        matrices: SaddlePoint,
        c: Coefficients,
        settings: HHT,
        recorder: Recorder,
    ) -> None:
        self._system, self._matrices, self._c = system, matrices, c
        self._settings, self._recorder = settings, recorder
        self._jacobian: Factorization | None = None
        self._inverse_weights = 1 / system.weights
        self._last_motion = math.inf
        self.verdict = Verdict.NO_CONVERGENCE
        self.correction = math.inf

    def advance(self, before: Node, t: float) -> Node | None:
        """Solve eqs. (4) and (5) at t; None, with `verdict` set, if that fails."""
        system, c, tolerance = self._system, self._c, self._settings.newton_tolerance
        q_p, v_p = predict(c, before.q, before.v, before.a)
        a, lam = before.a, before.lam
        is_complex = a.dtype.kind == "c" or system.b.dtype.kind == "c"
        jacobian = None if is_complex else self._jacobian
        last, settled, motion = math.inf, 0, _JUMP * self._motion_before(before)
        for _ in range(self._settings.max_iterations):
            q, v = correct(c, q_p, v_p, a)
            A = acceleration(c, a, before.A)
            reaction, Q = system.constraint_force(q, lam, t), system.force(q, v, t)
            R = residual(system, c, t, q, A, reaction - Q)
            self._recorder.residuals += 1
            self._recorder.iterations += 1
            if not is_finite(R):
                self.verdict = Verdict.NOT_FINITE
                return None
            fresh = jacobian is None
            if jacobian is None:
                jacobian = self._factor(Node(t, q.real, v.real, a.real, lam.real, A.real))
            x = jacobian.solve(R)
            a, lam = a - x[: system.n_q], lam - x[system.n_q :]
            now = self._motion(a, reaction, Q)
            # An iterate that runs away has huge forces; measured against those any correction
            # looks small. So the smallest motion met counts, and no more than a jump from the
            # last accepted step.
            motion = min(motion, now)
            size = self._size(t, q, x) / motion
            rate = min(size / last, 1.0) if 0 < last < math.inf else float(size > 0)
            self.correction = size
            # Error left after the correction: quadratic convergence squares the rate once more.
            left = size * (min(1.0, rate * rate) if fresh else rate / max(1.0 - rate, 1e-3))
            stuck = fresh and rate > 0.5 and size <= _ROUND_OFF
            if stuck and settled == 0:
                self._recorder.round_off_steps += 1
            if left <= tolerance or size <= tolerance or stuck:
                # The imaginary part of a complex step lags the real part by one iteration.
                settled += 1
                if not is_complex or settled == 3:
                    self._jacobian = None if is_complex else jacobian
                    self._last_motion = now
                    q, v = correct(c, q_p, v_p, a)
                    return Node(t, q, v, a, lam, acceleration(c, a, before.A))
            # The matrix kept from the step before serves one iteration; a fresh one at the
            # improved state then converges in two (measured: 3 iterations and 1 factorisation
            # per step, against 6 and 0.3 with the old matrix throughout, and 1.5 times slower).
            if is_complex or rate > _SLOW:
                jacobian = None
            last = size
        self.verdict = Verdict.NO_CONVERGENCE
        return None

    def _factor(self, state: Node) -> Factorization:
        self._recorder.factorisations += 1
        return factor_jacobian(self._system, self._matrices, self._c, state)

    def _size(self, t: float, q: Array, x: Array) -> float:
        """Size of a correction: of the accelerations and of the reactions, in units of force."""
        system = self._system
        reaction = system.constraint_force(q, x[system.n_q :], t)
        return real_norm(x[: system.n_q], system.weights) + real_norm(
            reaction, self._inverse_weights
        )

    def _motion_before(self, before: Node) -> float:
        """Motion at the last accepted step, or at the start."""
        if self._last_motion == math.inf:
            system, t = self._system, before.t
            reaction = system.constraint_force(before.q, before.lam, t)
            Q = system.force(before.q, before.v, t)
            self._last_motion = self._motion(before.a, reaction, Q)
        return self._last_motion

    def _motion(self, a: Array, reaction: Array, Q: Array) -> float:
        """Size of inertia, reactions and forces in the same norm.

        Where all of them vanish, as in a body at rest, corrections are compared with round-off.
        """
        inverse = self._inverse_weights
        size = real_norm(a, self._system.weights)
        size += real_norm(reaction, inverse) + real_norm(Q, inverse)
        floor = self._system.force_round_off / (0.1 * _ROUND_OFF)
        return max(size, floor, float(np.finfo(float).tiny))
