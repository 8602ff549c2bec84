"""A step of HHT-I3: of the motion and, if asked for, of its design derivatives.

**Error of a step** (Negrut, Rampalli, Ottarsson & Sajdak 2007, section 3). Inserting the smooth
solution in eq. (2), with a_n standing for q'' at t_n + alpha h, the position update misses

    delta = C h^3 q''' = C h^2 (a_{n+1} - a_n),     C = -(1 + 3 alpha^2)/12,

so the increment of the acceleration estimates it at no cost, and at frozen steps that of a_b its
derivative in the design. The tolerance bounds delta / h, which falls with h^2; the original bounds
delta, and its runs then err by the tolerance to the power 2/3.
"""

from functools import cached_property
from typing import ClassVar, final

import numpy as np

from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.hht import linear_passes
from ancfdae.integrators.hht.continuation import solved
from ancfdae.integrators.hht.equations import (
    Coefficients,
    Node,
    NodeSensitivity,
    constraint_error,
    rescaled,
    rescaled_sensitivity,
)
from ancfdae.integrators.hht.newton import StepSolver
from ancfdae.integrators.hht.small_steps import ConstraintRow
from ancfdae.integrators.hht.start import RecurrenceStart
from ancfdae.integrators.prescribed_motion import turn_error
from ancfdae.integrators.problem import InitialValueProblem, vector_sizes
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control.contracts import Failure, OneStepMethod, Record
from ancfdae.integrators.step_control.tolerance import Tolerance
from ancfdae.numerics.arrays import Array

# State of the recurrence at an instant, and of its derivatives if they are integrated.
State = tuple[Node, NodeSensitivity | None]


@final
class HHTStepper(OneStepMethod[State]):
    """Takes the steps of a run, with derivatives where those of the start are given.

    The tolerance, of the error of a step, is None where nothing controls it; the counters of the
    recorder go on.
    """

    order: ClassVar[int] = 2
    # A step of a small mechanism takes 0.2 to 2 ms.
    many: ClassVar[int] = 20_000
    remedy: ClassVar[str] = (
        "error control follows every undamped wave that its tolerance sees. Give the material a "
        "damping_time, or take a fixed step, HHT(step=...), which steps over those that do not "
        "matter (docs/howto/integrator.md)."
    )

    def __init__(
        self,
        problem: InitialValueProblem,
        alpha: float,
        newton: tuple[float, int],
        tolerance: Tolerance | None,
        recorder: SolutionRecorder,
    ) -> None:
        self._problem, self._alpha = problem, alpha
        self.system = problem.system
        self._solver = StepSolver(problem.system, problem.matrices, alpha, newton, recorder)
        self._tolerance, self._recorder = tolerance, recorder
        self._coefficients = Coefficients(0.0, alpha)

    @cached_property
    def _passes(self) -> linear_passes.CompiledPasses:
        """Linearised steps, for runs with derivatives."""
        return linear_passes.CompiledPasses(self.system, self._problem.matrices, self._alpha)

    def consistent(self) -> Record:
        """Return the consistent start as a row of the solution."""
        return *self._problem.initial, self._problem.derivative or ()

    def start(self, h: float) -> State:
        """Return the start of a run whose first step has the size h."""
        c = Coefficients(h, self._alpha)
        start, derivative = RecurrenceStart.of(self._problem, c), self._problem.derivative
        return start.node, derivative and start.sensitivity(derivative)

    def resized(self, state: State, ratio: float) -> State:
        """Return a state for a step whose size is `ratio` times that of the step before."""
        node, node_b = state
        return rescaled(node, ratio), node_b and rescaled_sensitivity(node_b, ratio)

    def advance(self, h: float, before: State, t: float) -> State | Failure:
        """Return the state at t = t_n + h, or a Failure if Newton's method does not converge."""
        (last, node_b), c = before, self._coefficients
        if c.h != h:
            c = self._coefficients = Coefficients(h, self._alpha)
        system, step = self._problem.system, (c, last, t)
        node = self._solver.advance(step)
        # Where steps are controlled a smaller one is the better cure.
        hard = isinstance(node, Failure) and node.verdict is not Verdict.SINGULAR
        if isinstance(node, Failure) and hard and self._tolerance is None:
            node = solved(self._solver, system, step, node)
            self._recorder.continued += isinstance(node, Node)
        if isinstance(node, Failure):
            return node
        if node_b is not None:
            self._recorder.factorisations += 1
            row = ConstraintRow.of(system, c, last, node)
            node_b = linear_passes.advance(self._problem, self._passes, c, node_b, node, row)
            if node_b is None:
                return Failure(Verdict.SINGULAR, 0.0)
        return node, node_b

    def march(self, before: State, sizes: Array, ends: Array) -> tuple[int, State]:
        """Take steps in one call of the kernel; without derivatives."""
        node, node_b = before
        if self._solver.alone or node_b is not None or len(sizes) == 1:
            return 0, before
        rows = self._recorder.room(len(sizes))
        taken, node = self._solver.march(node, sizes, ends, rows)
        self._recorder.take(ends[:taken])
        return taken, (node, None)

    def recorded(self, state: State) -> Record:
        """Return a state as a row of the solution."""
        x, b = state
        return x.t, x.q, x.v, x.A, x.lam, () if b is None else (b.q_b, b.v_b, b.A_b, b.lam_b)

    def error(self, h: float, before: State, after: State) -> float:
        """Return e of a step; zero where there is no tolerance."""
        if self._tolerance is None:
            return 0.0
        (old, old_b), (new, new_b) = before, after
        size = np.maximum(self._problem.size(old.q), self._problem.size(new.q))
        turn, rise = turn_error(self.system, new.t, h, self.order), (new.a - old.a).real
        if old_b is None or new_b is None:
            return float(np.maximum(turn, self._error(h, rise, size)))
        size_b = vector_sizes(new_b.q_b.T, self.system.vector_size).T
        error = self._error(h, rise, size, new_b.a_b - old_b.a_b, size_b)
        return float(np.maximum(turn, error))

    def start_error(self) -> float:
        """Return e of a first step of size 1, from the third derivative at the start."""
        derivative, still = self._problem.derivative, Coefficients(0.0, self._alpha)
        start = RecurrenceStart.of(self._problem, still)
        motion = start.jerks[0].jerk.real, self._problem.size(self._problem.initial.q)
        if derivative is None:
            return self._error(1.0, *motion)
        jerk_b = start.jerk_total(start.jerks[0], derivative, derivative.a_b)
        size_b = vector_sizes(derivative.q_b.T, self.system.vector_size).T
        return self._error(1.0, *motion, jerk_b, size_b)

    def _error(
        self,
        h: float,
        increment: Array,
        size: Array,
        increment_b: Array | None = None,
        size_b: Array | None = None,
    ) -> float:
        """Return the larger e; NaN, which no step passes, if one of them is NaN."""
        if self._tolerance is None:
            return 0.0
        scale = constraint_error(Coefficients(h, self._alpha))
        error = self._tolerance.of_motion(h, scale * increment, size)
        if increment_b is None or size_b is None:
            return error
        error_b = self._tolerance.of_derivatives(h, scale * increment_b, size_b)
        return float(np.maximum(error, error_b))
