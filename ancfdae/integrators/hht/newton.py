"""Newton's method for a step of HHT-I3: matrix policy, stopping rule.

Derivation: docs/theory/05-hht-i3.md.
"""

import math
from typing import NamedTuple, TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem, reaction
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.hht.equations import (
    Coefficients,
    Node,
    acceleration,
    correct,
    factor_jacobian,
    predict_increment,
    residual,
)
from ancfdae.integrators.hht.small_steps import (
    PLACES,
    QUIET,
    WEIGHTS,
    constraint_increment,
    motion_size,
    share_of_defect,
)
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control.contracts import Failure
from ancfdae.kernels import add_scaled, finite, norm
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint

# A matrix is replaced when an iteration shrinks the correction by less than this factor, or the
# first correction is larger than this part of the motion; and from corrections of the second size
# on where it would take more than two iterations. (So at any size, 25 of 202 hard runs end early
# where 14 do otherwise: full steps far from a solution lead to others.)
_SLOW, _NEAR = 0.2, 1e-5
# The guess looks a step ahead along the line through a and A, over this multiple of the time
# between them at most, and where that changes a by less than this part of the forces: else they
# oscillate.
_AHEAD, _SMOOTH = 20.0, 0.1
# Corrections that stop shrinking are round-off if they are this small against the motion.
_ROUND_OFF = 1e-6
# Forces may grow by this factor from one step to the next before the Newton test gets stricter.
_JUMP = 100.0


# Corrections from a guess close to the solution shrink by this factor at least.
_CLOSE = 0.5


_TINY = float(np.finfo(float).tiny)

# Coefficients, the state before the step, and the instant at its end.
Step: TypeAlias = tuple[Coefficients, Node, float]
# (q, v, A), and the residual with the reaction and the force that it contains.
_Values: TypeAlias = tuple[tuple[Array, ...], tuple[Array, Array, Array]]


@final
class _Equations:
    """Eqs. (2) to (5) of one step, with what does not change in it formed once."""

    def __init__(self, system: MechanicalSystem, step: Step, motion: float) -> None:
        c, before, self._t = step
        self._system, self._c, self._before = system, c, before
        self._dq_p, self._v_p = predict_increment(c, before.v, before.a)
        self._q_p = before.q + self._dq_p
        chi = share_of_defect(system, c, before.q, motion)
        self._defect = chi * system.constraint(before.t, before.q) if chi < 1 else None

    def still(self) -> Array:
        """Return the a that leaves the coordinates where they were before the step."""
        return -self._dq_p / self._c.in_q

    def at(self, a: Array, lam: Array) -> _Values:
        """Return (q, v, A), and the residual with the reaction and the force that it contains."""
        system, t, state = self._system, self._t, self._state(a)
        q, v, A = state
        forces = reaction(system, t, q, lam), system.force(t, q, v)
        R = residual(system, self._c, q, A, forces, self._constraint(q, a))
        return state, (R, *forces)

    def node(self, a: Array, lam: Array, motion: float) -> Node:
        """Return the state after the step."""
        q, v, A = self._state(a)
        return Node(self._t, q, v, a, lam, A, motion)

    def _state(self, a: Array) -> tuple[Array, Array, Array]:
        q, v = correct(self._c, self._q_p, self._v_p, a)
        return q, v, acceleration(self._c, a, self._before.A)

    def _constraint(self, q: Array, a: Array) -> Array:
        if self._defect is None:
            return self._system.constraint(self._t, q)
        dq = self._dq_p + self._c.in_q * a
        return self._defect + constraint_increment(self._system, self._c, self._before, dq)


def _left(size: float, rate: float, fresh: bool) -> float:
    """Return the error left after a correction: quadratic convergence squares the rate again."""
    return size * (min(1.0, rate * rate) if fresh else rate / max(1.0 - rate, 1e-3))


def _slow(size: float, rate: float | None, tolerance: float, allowed: float) -> bool:
    """Whether the matrix is to be replaced; the rate is None after the first correction.

    The matrix evaluated at the predictor is kept while Newton's method converges quickly (measured
    at 1e-14: 2 iterations per step; 5 with the matrix of the previous step, 3 if that is reused
    once only).
    """
    if rate is None:  # Along the branch of short steps every correction must shrink quickly.
        return size > _SLOW or allowed < math.inf
    return rate > _SLOW or (size < _NEAR and size * rate**3 > tolerance)


class _Guess(NamedTuple):
    """Unknowns, and what the equations say at them."""

    a: Array
    lam: Array
    values: _Values


class SolvedStep(NamedTuple):
    """A solution, whether round-off disturbs it, and the slowest rate of the corrections."""

    node: Node
    round_off: bool
    rate: float


@final
class _Shrinking:
    """Convergence rates of Newton's corrections; `slowest` is the largest rate above round-off."""

    def __init__(self) -> None:
        self._last, self.slowest = math.inf, 0.0

    def rate(self, size: float) -> tuple[float, bool]:
        """Return the rate of one more correction, and whether it is the first."""
        last, self._last = self._last, size
        if last == math.inf:
            return float(size > 0), True
        rate = min(size / last, 1.0) if last > 0 else float(size > 0)
        if size > _ROUND_OFF:
            self.slowest = max(self.slowest, rate)
        return rate, False


@final
class StepSolver:
    """Newton's method for one step after another, which the recorder counts."""

    def __init__(
        self,
        system: MechanicalSystem,
        matrices: SaddlePoint,
        tolerance: float,
        max_iterations: int,
        recorder: SolutionRecorder,
    ) -> None:
        self._system, self._matrices, self._recorder = system, matrices, recorder
        self._tolerance, self.max_iterations = tolerance, max_iterations
        self._inverse_weights = 1 / system.weights
        # The round-off of elastic forces, times 1e7.
        self._blur = system.traits.force_round_off / (0.1 * _ROUND_OFF)
        self._least = max(self._blur, _TINY)

    def rules(self, alpha: float) -> Array:
        """Return the numbers that `march_rules` of the kernels names, in its order."""
        limits = self._tolerance, self.max_iterations, self._blur
        rates = _SLOW, _NEAR, _AHEAD, _SMOOTH, _ROUND_OFF, _JUMP, QUIET
        return np.array([alpha, *limits, *rates, *PLACES, *WEIGHTS])

    @property
    def iterations(self) -> int:
        """Iterations so far, of all steps."""
        return self._recorder.iterations

    def advance(self, step: Step, patience: int = 1) -> Node | Failure:
        """Solve eqs. (4) and (5), in `patience` times as many iterations as are usual."""
        c, before, _ = step
        motion, lam = self._motion_before(before), before.lam
        equations = _Equations(self._system, step, motion)
        a = self._ahead(c, before)
        ahead = _Guess(a, lam, equations.at(a, lam))
        solved: SolvedStep | Failure | None = self._from_rest(step, equations, ahead, motion)
        if solved is None:
            solved = self._solve(step, equations, ahead, self._tolerance, math.inf, patience)
        return solved if isinstance(solved, Failure) else self.accept(solved)

    def _from_rest(
        self, step: Step, equations: _Equations, ahead: _Guess, motion: float
    ) -> SolvedStep | None:
        """Return the solution close to the state before the step if the guess is far off.

        A wave far faster than the steps (omega h >> 1) has accelerations omega^2 u, and the line
        through them leads (omega h)^2/2 times its amplitude u away: sections are turned inside out
        there, and Newton's method finds the solution that they have so. None where corrections do
        not shrink quickly from the first one on: the solution that they lead to may be another one.
        """
        unbalanced = self._unbalanced(ahead)
        if unbalanced <= _JUMP * motion:
            return None
        a, lam = equations.still(), ahead.lam
        still = _Guess(a, lam, equations.at(a, lam))
        if self._unbalanced(still) > _SMOOTH * unbalanced:  # A load has grown: it acts on both.
            return None
        solved = self._solve(step, equations, still, self._tolerance, _CLOSE)
        return None if isinstance(solved, Failure) else solved

    def _unbalanced(self, guess: _Guess) -> float:
        """Return the size of the forces that a guess leaves."""
        _, (R, *_) = guess.values
        return norm(R[: self._system.n_q], self._inverse_weights)

    def _ahead(self, c: Coefficients, before: Node) -> Array:
        """Return a guess of a: a stands for q'' at t + alpha h, A at t."""
        if not c.alpha:
            return before.a
        times, rise = min(-1 / c.alpha, _AHEAD), before.A - before.a
        if times * norm(rise, self._system.weights) > _SMOOTH * self._motion_before(before):
            return before.a
        return add_scaled(before.a, times, rise)

    def follow(self, step: Step, guess: tuple[Array, Array], rough: float) -> SolvedStep | Failure:
        """Solve them from a guess that is close to the solution.

        Where corrections do not shrink quickly from the first one on, the solution that they lead
        to may be another one. A tolerance that is larger than that of the run may be given.
        """
        (_, before, _), (a, lam) = step, guess
        equations = _Equations(self._system, step, self._motion_before(before))
        first = _Guess(a, lam, equations.at(a, lam))
        return self._solve(step, equations, first, max(rough, self._tolerance), _CLOSE)

    def accept(self, solved: SolvedStep) -> Node:
        """Count what was found as a step."""
        self._recorder.round_off_steps += solved.round_off
        return solved.node

    def _solve(
        self,
        step: Step,
        equations: _Equations,
        guess: _Guess,
        tolerance: float,
        allowed: float,
        patience: int = 1,
    ) -> SolvedStep | Failure:
        """Iterate from a guess; corrections above round-off shrink at the allowed rate at least."""
        (c, before, t), n_q = step, self._system.n_q
        a, lam, values = guess
        settled, motion, shrinking = 0, self._most(before), _Shrinking()
        size, round_off = math.inf, False
        jacobian: Factorization | None = None
        more = self._for_imaginary_part(a, tolerance)
        for _ in range(patience * self.max_iterations + more):
            (q, v, A), (R, *forces) = values
            self._recorder.residuals += 1
            self._recorder.iterations += 1
            if not finite(R):
                return Failure(Verdict.NOT_FINITE, size)
            fresh = jacobian is None
            if jacobian is None:
                try:
                    jacobian = self._factor(c, Node(t, q, v, a, lam, A))
                except SingularMatrix:
                    return Failure(Verdict.SINGULAR, size)
            x = jacobian.solve(R)
            a, lam = a - x[:n_q], lam - x[n_q:]
            now = self._motion(a, *forces)
            # A diverging iterate has huge forces; measured against those any correction
            # looks small. So the smallest motion met counts, and no more than a jump from the
            # last accepted step.
            motion = min(motion, now)
            size = self._size(t, q, x) / motion
            rate, first = shrinking.rate(size)
            if not first and size > _ROUND_OFF and rate > allowed:
                break
            stuck = fresh and self._stuck(size, rate, R, now)
            if stuck or _left(size, rate, fresh) <= tolerance or size <= tolerance:
                settled += 1
                if settled == 1:
                    round_off = stuck or self._blurred(t, q, a, lam)
                if settled > more:
                    return SolvedStep(equations.node(a, lam, now), round_off, shrinking.slowest)
            if settled or _slow(size, None if first else rate, tolerance, allowed):
                jacobian = None
            values = equations.at(a, lam)
        return Failure(Verdict.NO_CONVERGENCE, size)

    def _for_imaginary_part(self, a: Array, tolerance: float) -> int:
        """Return how many iterations more the imaginary part needs; a guess serves as it is.

        It lags the real part by one iteration, and one is for its round-off. The real part goes its
        own way.
        """
        is_complex = a.dtype.kind == "c" or self._system.b.dtype.kind == "c"
        return 2 if is_complex and tolerance == self._tolerance else 0

    def _stuck(self, size: float, rate: float, R: Array, motion: float) -> bool:
        """Whether corrections of a fresh matrix are round-off.

        Of stiff bodies far from balance corrections are small too: forces must balance.
        """
        if rate <= 0.5 or size > _ROUND_OFF:
            return False
        return norm(R[: self._system.n_q], self._inverse_weights) <= _ROUND_OFF * motion

    def _factor(self, c: Coefficients, state: Node) -> Factorization:
        """Factorise eq. (6) at the real part of a state."""
        self._recorder.factorisations += 1
        if state.q.dtype.kind == "c":
            q, v, a, lam, A = (x.real for x in (state.q, state.v, state.a, state.lam, state.A))
            state = Node(state.t, q, v, a, lam, A)
        return factor_jacobian(self._system, self._matrices, c, state)

    def _size(self, t: float, q: Array, x: Array) -> float:
        """Size of a correction: of the accelerations and of the reactions, in units of force."""
        system = self._system
        force = reaction(system, t, q, x[system.n_q :])
        return norm(x[: system.n_q], system.weights, force, self._inverse_weights)

    def _blurred(self, t: float, q: Array, a: Array, lam: Array) -> bool:
        """Whether round-off of the elastic forces leaves less than seven digits of the motion."""
        if norm(a, self._system.weights) >= self._blur:
            return False
        force = reaction(self._system, t, q, lam)
        return norm(force, self._inverse_weights) < self._blur

    def _motion_before(self, before: Node) -> float:
        """Motion in the step before, or at the start."""
        if before.motion < math.inf:
            return before.motion
        system, t = self._system, before.t
        forces = reaction(system, t, before.q, before.lam), system.force(t, before.q, before.v)
        return self._motion(before.a, *forces)

    def _most(self, before: Node) -> float:
        """Motion that counts at most in a step; any after a rest that knows no round-off."""
        motion = self._motion_before(before)
        return _JUMP * motion if motion > _TINY else math.inf

    def _motion(self, a: Array, *forces: Array) -> float:
        """Size of the motion; in a body at rest corrections are compared with round-off."""
        size = motion_size(self._system, self._inverse_weights, a, *forces)
        return max(size, self._least)
