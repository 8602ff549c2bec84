"""A step of HHT-I3: of the motion and, if asked for, of its design derivatives.

**Error of a step** (Negrut, Rampalli, Ottarsson & Sajdak 2007, section 3). Inserting the smooth
solution in eq. (2), with a_n standing for q'' at t_n + alpha h, the position update misses

    delta = C h^3 q''' = C h^2 (a_{n+1} - a_n),     C = -(1 + 3 alpha^2)/12,

so the increment of the acceleration estimates it at no cost, and at frozen steps that of a_b its
derivative in the design. The tolerance bounds delta / h, which falls with h^2; the original bounds
delta, and its runs then err by the tolerance to the power 2/3.
"""

from __future__ import annotations

from typing import ClassVar, final

import numpy as np

from ancfdae.errors import Verdict
from ancfdae.integrators.hht import linear_passes
from ancfdae.integrators.hht.continuation import continued, remedy
from ancfdae.integrators.hht.equations import (
    Coefficients,
    Node,
    NodeSensitivity,
    constraint_error,
    predict_increment,
    rescaled,
    rescaled_sensitivity,
)
from ancfdae.integrators.hht.newton import StepSolver
from ancfdae.integrators.hht.small_steps import ConstraintRow
from ancfdae.integrators.hht.start import RecurrenceStart
from ancfdae.integrators.problem import Problem
from ancfdae.integrators.recorder import Recorder
from ancfdae.integrators.step_control.contracts import Failure, OneStepMethod, Record
from ancfdae.integrators.step_control.tolerance import Tolerance
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array

# Where the branch of solutions could be followed over more than this part of a step, and then was
# lost in round-off, as many iterations as this times the usual ones are spent on the full step.
_MOST_OF_IT, _PATIENCE = 0.5, 4

# State of the recurrence at an instant, and of its derivatives if they are integrated.
State = tuple[Node, NodeSensitivity | None]


@final
class Stepper(OneStepMethod[State]):
    """Takes the steps of a run, with derivatives where those of the start are given.

    The tolerance, of the error of a step, is None where nothing controls it; the counters of the
    recorder go on.
    """

    order: ClassVar[int] = 2

    def __init__(
        self,
        problem: Problem,
        alpha: float,
        newton: tuple[float, int],
        tolerance: Tolerance | None,
        recorder: Recorder,
    ) -> None:
        self._problem, self._alpha = problem, alpha
        self._solver = StepSolver(problem.system, problem.matrices, *newton, recorder)
        self._tolerance, self._recorder, self._remedy = tolerance, recorder, ""
        self._coefficients = Coefficients(0.0, alpha)

    def consistent(self) -> Record:
        """Return what a solution keeps of the start, which is the consistent one."""
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

    def advance(self, h: float, before: State, t: float) -> State | None:
        """Solve the equations at t; None if Newton's method fails."""
        (last, node_b), c = before, self._coefficients
        if c.h != h:
            c = self._coefficients = Coefficients(h, self._alpha)
        self._remedy, node = "", self._solver.advance(c, last, t)
        # Where steps are controlled a smaller one is the better cure.
        if node is None and self._tolerance is None:
            node, part = continued(self._solver, c, last, t)
            if node is None and part > _MOST_OF_IT:
                node = self._patient(c, last, t)
            self._remedy = remedy(h, part)
            self._recorder.continued += node is not None
        if node is None:
            return None
        if node_b is not None:
            self._recorder.factorisations += 1
            system, matrices = self._problem.system, self._problem.matrices
            row = ConstraintRow.of(system, c, last, node)
            node_b = linear_passes.advance(system, matrices, c, node_b, node, row)
        return node, node_b

    def _patient(self, c: Coefficients, last: Node, t: float) -> Node | None:
        """Iterate on where round-off hides the branch; None if that leads away from the motion."""
        node = self._solver.advance(c, last, t, patience=_PATIENCE)
        if node is None:
            return None
        ahead, _ = predict_increment(c, last.v, last.a)
        weights = self._problem.system.weights
        near = norm(node.q - last.q - ahead, weights) <= norm(ahead, weights)
        return node if near else None

    def failure(self) -> Failure:
        """Return why Newton's method failed, the size of its last correction, and a remedy."""
        verdict = self._solver.verdict
        # No step helps where the forces themselves are not finite.
        told = "" if verdict is Verdict.NOT_FINITE else self._remedy
        return Failure(verdict, self._solver.correction, told)

    def recorded(self, state: State) -> Record:
        """Return what a solution keeps of a state."""
        x, b = state
        return x.t, x.q, x.v, x.A, x.lam, () if b is None else (b.q_b, b.v_b, b.A_b, b.lam_b)

    def error(self, h: float, before: State, after: State) -> float:
        """Return e of a step; zero where there is no tolerance."""
        if self._tolerance is None:
            return 0.0
        (old, old_b), (new, new_b) = before, after
        size = np.maximum(np.abs(old.q.real), np.abs(new.q.real))
        if old_b is None or new_b is None:
            return self._error(h, (new.a - old.a).real, size)
        return self._error(h, (new.a - old.a).real, size, new_b.a_b - old_b.a_b, np.abs(new_b.q_b))

    def start_error(self) -> float:
        """Return e of a first step of size 1, from the third derivative at the start."""
        own, still = self._problem.derivative, Coefficients(0.0, self._alpha)
        start = RecurrenceStart.of(self._problem, still)
        motion = start.jerks[0].jerk.real, np.abs(self._problem.initial.q.real)
        if own is None:
            return self._error(1.0, *motion)
        jerk_b = start.jerk_total(start.jerks[0], own, own.a_b)
        return self._error(1.0, *motion, jerk_b, np.abs(own.q_b))

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
