"""A step of HHT-I3: Newton's method, continuation where it fails, and the error of the step.

**Newton's method** (docs/theory/05-hht-i3.md) runs in a kernel, `kernels/march.h`.

**Continuation** finds the solution of a step by way of shorter steps where Newton's method fails.
From the same state the equations of a step s h, with 0 < s <= 1, have one solution near the motion
if s is small. The branch of solutions that begins there is followed in s. Guesses lie on the cubic
through the last four solutions; they are accepted only where Newton's method contracts from its
first correction on. The first rate of contraction is proportional to the distance of the guess,
which goes with the stride to the power of the number of solutions. The branch ends at s = 1, with
the solution of the full step, or turns back before: no larger step has a solution that belongs to
this motion. Only guesses differ, not the equations; the solution has the derivatives of any other
step.

**Error of a step** (Negrut, Rampalli, Ottarsson & Sajdak 2007, section 3). Inserting the smooth
solution in eq. (2), with a_n standing for q'' at t_n + alpha h, leaves in the position update

    delta = C h^3 q''' = C h^2 (a_{n+1} - a_n),     C = -(1 + 3 alpha^2)/12,

so the increment of the acceleration estimates it at no cost, and at fixed steps the increment of
a_b its derivative in the design. The tolerance bounds delta / h, which falls with h^2; the original
bounds delta, and its runs then err by the tolerance to the power 2/3.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import ClassVar, NamedTuple, TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.saddle_points import Prepared
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.hht import linear_passes
from ancfdae.integrators.hht.equations import (
    PLACES,
    QUIET,
    WEIGHTS,
    Coefficients,
    ConstraintRow,
    Node,
    NodeSensitivity,
    constraint_error,
    predict_increment,
    rescaled,
    rescaled_sensitivity,
)
from ancfdae.integrators.hht.start import RecurrenceStart
from ancfdae.integrators.prescribed_motion import turn_error
from ancfdae.integrators.problem import InitialValueProblem, vector_sizes
from ancfdae.integrators.recorder import Rows, SolutionRecorder, StateRows
from ancfdae.integrators.step_control.contracts import (
    VERDICTS,
    Batch,
    ErrorController,
    Failure,
    OneStepMethod,
    Reached,
    Record,
    Tolerance,
    Tries,
)
from ancfdae.kernels import FILTER, March, norm
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import SaddlePoint

# A matrix is replaced if an iteration shrinks the correction by less than the factor _SLOW, or the
# first correction exceeds _SLOW times the motion; and, for corrections below _NEAR times the
# motion, if more than two further iterations are predicted. (With that rule for larger corrections,
# too, 25 of 202 hard runs end early instead of 14: full steps far from a solution lead to others.)
_SLOW, _NEAR = 0.2, 1e-5
# The guess extrapolates the line through A and a by at most _AHEAD times the time between them, and
# only if that changes a by less than _SMOOTH times the forces; otherwise they oscillate.
_AHEAD, _SMOOTH = 20.0, 0.1
# Corrections that stop shrinking count as round-off below _ROUND_OFF times the motion.
_ROUND_OFF = 1e-6
# Forces may grow by this factor from one step to the next before the Newton test gets stricter.
_JUMP = 100.0
# Corrections from a guess close to the solution shrink by this factor at least.
_CLOSE = 0.5
# Seconds after which the kernel returns, so that interrupts and the progress bar are served.
_NEWTON_PATIENCE = 0.1

# Coefficients, the node before the step, and the time at its end.
Step: TypeAlias = tuple[Coefficients, Node, float]


class SolvedStep(NamedTuple):
    """A solved step: its node, whether round-off disturbs it, and the slowest convergence rate."""

    node: Node
    round_off: int
    rate: float


class _Attempt(NamedTuple):
    """Attempt to solve a step: a guess of a and lam, and limits as for `Model.march`."""

    guess: tuple[Array, Array] | None
    limits: tuple[float, float, int]


class _End(NamedTuple):
    """End of steps: number taken, reason, last node, last correction and slowest rate."""

    taken: int
    why: March
    node: Node
    round_off: int
    size: float
    rate: float


@final
class StepSolver:
    """Newton's method for steps of HHT-I3, whose iterations the recorder counts."""

    def __init__(
        self,
        system: MechanicalSystem,
        matrices: SaddlePoint,
        alpha: float,
        newton: tuple[float, int],
        recorder: SolutionRecorder,
    ) -> None:
        self._tolerance, self.max_iterations = newton
        # The round-off of elastic forces, times 1e7.
        blur = system.traits.force_round_off / (0.1 * _ROUND_OFF)
        rates = _SLOW, _NEAR, _AHEAD, _SMOOTH, _ROUND_OFF, _JUMP, QUIET
        rules = np.array([alpha, *newton, blur, *rates, *PLACES, *WEIGHTS])
        self._kernel = Prepared(system, matrices, rules, recorder.dtype)
        self.alone, self.timed = self._kernel.alone, self._kernel.timed
        self._sizes = system.n_q, system.n_q, system.n_q, system.n_lam
        self._recorder, self._small = recorder, False

    @property
    def iterations(self) -> int:
        """Number of iterations of all steps so far."""
        return self._recorder.iterations

    def march(self, before: Node, h: Array, ends: Array, rows: StateRows) -> tuple[int, Node]:
        """Take steps until one is not solved; write q, v, A and lam to rows; return how many."""
        usual = _Attempt(None, (self._tolerance, math.inf, self.max_iterations))
        end = self._taken(before, h, ends, rows, usual)
        self._recorder.round_off_steps += end.round_off
        return end.taken, end.node

    def advance(self, step: Step, patience: int = 1) -> Node | Failure:
        """Solve eqs. (4) and (5) within `patience` times the usual number of iterations."""
        limits = self._tolerance, math.inf, patience * self.max_iterations
        solved = self._solved(step, _Attempt(None, limits))
        return solved if isinstance(solved, Failure) else self.accept(solved)

    def follow(self, step: Step, guess: tuple[Array, Array], rough: float) -> SolvedStep | Failure:
        """Solve eqs. (4) and (5) from a guess close to the solution.

        If corrections do not shrink quickly from the first one on, the step counts as failed,
        because the solution may be another one. `rough` is a tolerance larger than that of the run.
        """
        limits = max(rough, self._tolerance), _CLOSE, self.max_iterations
        return self._solved(step, _Attempt(guess, limits))

    def accept(self, solved: SolvedStep) -> Node:
        """Count the solution as an accepted step and return its node."""
        self._recorder.round_off_steps += solved.round_off
        return solved.node

    def controlled(
        self,
        begin: Reached,
        controller: ErrorController,
        tolerance: tuple[float, Array, Array, int],
        laws: Callable[[float, float, float], tuple[Array, Array, float]] | None,
        most: int,
        along: Callable[[Node, float], float] | None = None,
    ) -> Batch:
        """Take up to `most` steps under error control in one call of the kernel.

        Parameters
        ----------
        begin : Reached
            Progress of the run, with a `Node`.
        controller : ErrorController
            The kernel changes its numbers.
        tolerance : tuple
            rtol, atol Q_i of the coordinates, place of the system, and length of its vectors.
        laws : Callable, optional
            Returns the factors of joints and loads of a step and the error of its turn, from the
            start, end and size of the step, s.
        most : int
            Largest number of steps; one with `along`.
        along : Callable, optional
            Returns an error e that belongs to the step too, from the node after it and its size, s.
        """
        recorder, node, numbers = self._recorder, begin.now, self._sizes[0]
        q, v, A, lam = rows = recorder.room(most)
        a, ends, motions = np.empty((most, numbers), recorder.dtype), np.empty(most), np.empty(most)
        filters, limits = np.empty((most, FILTER)), (self._tolerance, self.max_iterations)

        def after(k: int, end: float) -> Node:
            of_q, of_v, of_a, of_lam, of_A = (x[k - 1].copy() for x in (q, v, a, lam, A))
            return Node(end, of_q, of_v, of_a, of_lam, of_A, float(motions[k - 1]))

        taken, why, rejected, counts, size = self._kernel.model.march_controlled(
            (node.q, node.v, node.a, node.lam, node.A),
            (begin.n, begin.t, begin.last),
            node.motion,
            (controller.numbers, controller.stops),
            tolerance,
            (laws, self._kernel.start),
            None if along is None else lambda h, end: along(after(1, end), h),
            rows,
            (ends, filters),
            (a, motions),
            (*limits, _NEWTON_PATIENCE),
        )
        recorder.rejected += rejected
        recorder.iterations += counts[0]
        recorder.residuals += counts[0]
        recorder.factorisations += counts[1]
        recorder.round_off_steps += counts[2]
        if not taken and why in (March.NEEDS_GAUSS, March.INDEFINITE):
            self._add(why)
            return self.controlled(begin, controller, tolerance, laws, most, along)
        t = ends[:taken]
        return Batch(t, t, filters, lambda k: after(k, float(ends[k - 1])), March(why), size)

    def _solved(self, step: Step, attempt: _Attempt) -> SolvedStep | Failure:
        """Return the solution of one step, or why it was not solved."""
        c, before, t = step
        q, v, A, lam = (np.empty((1, n), dtype=self._recorder.dtype) for n in self._sizes)
        end = self._taken(before, np.array([c.h]), np.array([t]), (q, v, A, lam), attempt)
        if end.taken:
            return SolvedStep(end.node, end.round_off, end.rate)
        return Failure(VERDICTS.get(end.why, Verdict.NO_CONVERGENCE), end.size)

    def _taken(
        self, before: Node, h: Array, ends: Array, rows: StateRows, attempt: _Attempt
    ) -> _End:
        """Take steps until one is not solved, and add their cost to the counters."""
        t, q, v, a, lam, A, motion = before
        starts = np.concatenate([[t], ends[:-1]])
        of_loads = self._kernel.plan.load_factors
        loads = np.stack([of_loads(ends), of_loads(starts)], axis=1)
        tables = self._joint_factors(starts, ends, h), loads
        taken, why, motion, a, counts, size, rate = self._kernel.model.march(
            (q, v, a, lam, A), motion, h, *tables, _NEWTON_PATIENCE, rows, *attempt
        )
        self._recorder.iterations += counts[0]
        self._recorder.residuals += counts[0]
        self._recorder.factorisations += counts[1]
        if not taken and why in (March.NEEDS_GAUSS, March.INDEFINITE):
            self._add(why)
            return self._taken(before, h, ends, rows, attempt)
        if taken:
            # Copies: a stored node must not keep the rows of a whole part in memory.
            q, v, A, lam = (row[taken - 1].copy() for row in rows)
            before = Node(float(ends[taken - 1]), q, v, a, lam, A, motion)
        return _End(taken, March(why), before, counts[2], size, rate)

    def _add(self, why: int) -> None:
        """Prepare what the kernel reported missing: Gauss points, or a banded factorisation."""
        if why == March.NEEDS_GAUSS:
            self._small = True
        else:
            self._kernel.add_band()

    def laws(self, t: float, end: float, h: float) -> tuple[Array, Array]:
        """Return factors of joints and loads at end, start and Gauss points of a step from t."""
        starts, ends = np.array([t]), np.array([end])
        loads = self._kernel.plan.load_factors(np.array([end, t]))
        return self._joint_factors(starts, ends, np.array([h]))[0], loads

    def _joint_factors(self, starts: Array, ends: Array, h: Array) -> Array:
        """Return factors of driven joints at ends and starts of steps, (k, ..., n).

        If steps may be small, Gauss points are included.
        """
        of = self._kernel.plan.joint_factors
        if of is None:
            return np.ones((1, 2, 1))
        instants = [ends, starts]
        if self._small:
            instants += [starts + place * h for place in PLACES]
        t = np.stack(instants, axis=1)
        values, rates = of(t.ravel(), 1)[0], of(t[:, 2:].ravel(), 2)[1]
        tables = [x.reshape(len(h), -1, x.shape[1]) for x in (values, rates)]
        return np.concatenate(tables, axis=1)


# Tolerance of solutions that serve as guesses only.
_ROUGH = 1e-8
# Shortest fraction of a step that is tried.
_SHORTEST = 2.0**-20
# The branch counts as ended if the fraction of the step grows by less than this, relatively.
_FINEST = 1e-4
# Most iterations over those of Newton's method: more than any successful branch took (measured: 10
# to 200 iterations, with 15 allowed in Newton's method).
_MOST = 15
# Number of solutions through which a guess is extrapolated.
_POINTS = 4
# Convergence rate at which strides aim, and least and largest ratio of successive strides.
_AIM, _LEAST, _LONGEST = 0.2, 0.5, 3.0
# If the branch was followed over more than _MOST_OF_IT of a step and then lost in round-off, the
# full step is tried with _CONTINUATION_PATIENCE times the usual iterations.
_MOST_OF_IT, _CONTINUATION_PATIENCE = 0.5, 4


def solved(
    solver: StepSolver, system: MechanicalSystem, step: Step, why: Failure
) -> Node | Failure:
    """Return the node after a step that Newton's method alone does not solve, or a Failure."""
    node, part = continued(solver, step, why)
    if isinstance(node, Failure) and part > _MOST_OF_IT:
        node = _patient(solver, system, step)
    if not isinstance(node, Failure) or node.verdict is Verdict.NOT_FINITE:
        # No step helps where the forces themselves are not finite.
        return node
    return node._replace(remedy=_remedy(step[0].h, part))


def continued(solver: StepSolver, step: Step, why: Failure) -> tuple[Node | Failure, float]:
    """Follow the branch of solutions; return the node or a Failure, and the fraction solved."""
    branch: deque[tuple[float, SolvedStep]] = deque(maxlen=_POINTS)
    reached, stride = 0.0, 1.0
    most = solver.iterations + _MOST * solver.max_iterations
    while solver.iterations < most:
        part = min(1.0, reached + stride)
        stride = part - reached
        solved = _solved(solver, step, part, branch)
        if isinstance(solved, Failure):
            why = why if solved.verdict is Verdict.SINGULAR else solved
            stride /= 2 if reached else 4
            if stride < max(_FINEST * reached, _SHORTEST):
                break
            continue
        if part == 1.0:
            return solver.accept(solved), 1.0
        branch.append((part, solved))
        reached = part
        wish = (_AIM / max(solved.rate, 1e-9)) ** (1 / len(branch))
        stride *= min(_LONGEST, max(_LEAST, wish))
    return why, reached


def _patient(solver: StepSolver, system: MechanicalSystem, step: Step) -> Node | Failure:
    """Return the node by more iterations on the full step, unless it is far from the motion."""
    c, last, _ = step
    node = solver.advance(step, patience=_CONTINUATION_PATIENCE)
    if isinstance(node, Failure):
        return node
    ahead, _ = predict_increment(c, last.v, last.a)
    near = norm(node.q - last.q - ahead, system.weights) <= norm(ahead, system.weights)
    return node if near else Failure(Verdict.NO_CONVERGENCE, math.inf)


def _remedy(h: float, part: float) -> str:
    """Return in words how much of a step of size h was solved; empty if all or none."""
    if not 0 < part < 1:
        return ""
    return (
        f"The solution that belongs to the motion was found there for steps up to {part * h:.3g}."
    )


def _solved(
    solver: StepSolver, step: Step, part: float, branch: Sequence[tuple[float, SolvedStep]]
) -> SolvedStep | Failure:
    """Return the solution of a fraction `part` of the step from a guess on the branch."""
    c, before, t = step
    now = t if part == 1.0 else before.t + part * (t - before.t)
    state, rough = rescaled(before, part), 0.0 if part == 1.0 else _ROUGH
    guess = _guess(part, branch) if branch else (state.a, state.lam)
    return solver.follow((Coefficients(part * c.h, c.alpha), state, now), guess, rough)


def _guess(part: float, branch: Sequence[tuple[float, SolvedStep]]) -> tuple[Array, Array]:
    """Return a and lam at `part` on the polynomial through the solutions of the branch."""
    s = np.array([reached for reached, _ in branch])
    weights = [np.prod((part - np.delete(s, i)) / (x - np.delete(s, i))) for i, x in enumerate(s)]
    a, lam = (np.stack(x) for x in zip(*((f.node.a, f.node.lam) for _, f in branch), strict=True))
    return weights @ a, weights @ lam


# Node of the recurrence, and its derivatives if they are integrated.
State = tuple[Node, NodeSensitivity | None]


@final
class HHTStepper(OneStepMethod[State]):
    """Takes the steps of an HHT-I3 run, with derivatives if those of the start are given.

    `tolerance` bounds the error of a step; None without error control. The counters of the recorder
    continue.
    """

    order: ClassVar[int] = 2
    # A step of a small mechanism takes 0.2 to 2 ms.
    many: ClassVar[int] = 20_000
    remedy: ClassVar[str] = (
        "error control follows every undamped wave, and every contact, that its tolerance sees. "
        "Give materials a damping_time and contacts less stiffness, or take a fixed step, "
        "HHT(step=...), which steps over waves that do not matter (docs/howto/integrator.md)."
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
        """The kernel's derivative passes, for runs with derivatives."""
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
        """Return a state for a step of `ratio` times the size of the step before."""
        node, node_b = state
        return rescaled(node, ratio), node_b and rescaled_sensitivity(node_b, ratio)

    def advance(self, h: float, before: State, t: float) -> State | Failure:
        """Return the state at t = t_n + h, or a Failure if Newton's method does not converge."""
        (last, _), c = before, self._coefficients
        if c.h != h:
            c = self._coefficients = Coefficients(h, self._alpha)
        system, step = self._problem.system, (c, last, t)
        node = self._solver.advance(step)
        if isinstance(node, Failure) and node.verdict is not Verdict.SINGULAR:
            node = solved(self._solver, system, step, node)
            self._recorder.continued += isinstance(node, Node)
        return node if isinstance(node, Failure) else (node, None)

    def march(self, before: State, sizes: Array, ends: Array) -> tuple[int, State]:
        """Take steps of given sizes in one call of the kernel."""
        if self._solver.alone or len(sizes) == 1:
            return 0, before
        rows = self._recorder.room(len(sizes))
        taken, node = self._solver.march(before[0], sizes, ends, rows)
        self._recorder.take(ends[:taken])
        return taken, (node, None)

    def controlled(
        self, begin: Reached, controller: ErrorController, most: int, tries: Tries | None
    ) -> Batch:
        """Take steps in one call of the kernel, one by one with derivatives."""
        assert self._tolerance is not None
        (node, node_b), scales, tolerance = begin.now, self._problem.scales, self._tolerance
        bounds = tolerance.rtol, tolerance.atol * tolerance.sizes, scales.place
        motion, solver = begin._replace(now=node), self._solver
        given = motion, controller, (*bounds, self.system.vector_size)
        laws, after_b = self._laws if solver.timed else None, node_b

        def seen(after: Node, h: float) -> float:
            assert tries is not None
            tries(Rows(np.array([after.t]), after.q[None], after.v[None]))
            return 0.0

        if node_b is None:
            along_with = seen if tries else None
            found = solver.controlled(*given, laws, 1 if solver.alone else most, along_with)
            return found._replace(states=lambda k: (found.states(k), None))

        def along(after: Node, h: float) -> float:
            nonlocal after_b
            last, last_b = self.resized(begin.now, h / begin.last)
            assert last_b is not None
            after_b = self._differentiated(h, last, last_b, after)
            return self._error_of_derivatives(h, after_b.q_b, after_b.a_b - last_b.a_b)

        found = solver.controlled(*given, laws, 1, along)
        if len(found.ends):
            *_, derivatives = self.recorded((found.states(1), after_b))
            self._recorder.beside(tuple(x[None] for x in derivatives))
        return found._replace(states=lambda k: (found.states(k), after_b))

    def _differentiated(
        self, h: float, last: Node, last_b: NodeSensitivity, after: Node
    ) -> NodeSensitivity:
        """Return the derivatives of the node after a step; raises SingularMatrix."""
        self._recorder.factorisations += 1
        c = Coefficients(h, self._alpha)
        row = ConstraintRow.of(self.system, c, last, after)
        after_b = linear_passes.advance(self._problem, self._passes, c, last_b, after, row)
        if after_b is None:
            raise SingularMatrix("a matrix of the derivatives is singular")
        return after_b

    def _laws(self, t: float, end: float, h: float) -> tuple[Array, Array, float]:
        """Return factors of joints and loads of a step from t, and the error e of its turn."""
        return *self._solver.laws(t, end, h), turn_error(self.system, end, h, self.order)

    def recorded(self, state: State) -> Record:
        """Return a state as a row of the solution."""
        x, b = state
        return x.t, x.q, x.v, x.A, x.lam, () if b is None else (b.q_b, b.v_b, b.A_b, b.lam_b)

    def start_error(self) -> float:
        """Return e of a first step of size 1 s, from the third derivative at the start.

        Zero if the matrices there are not finite, which the first step reports.
        """
        if self._tolerance is None:
            return 0.0
        derivative, still = self._problem.derivative, Coefficients(0.0, self._alpha)
        try:
            start = RecurrenceStart.of(self._problem, still)
        except SingularMatrix:
            return 0.0
        scale, jerk = constraint_error(Coefficients(1.0, self._alpha)), start.jerks[0].jerk
        size = self._problem.size(self._problem.initial.q)
        error = self._tolerance.of_motion(1.0, scale * jerk.real, size)
        if derivative is None:
            return error
        jerk_b = start.jerk_total(start.jerks[0], derivative, derivative.a_b)
        return float(np.maximum(error, self._error_of_derivatives(1.0, derivative.q_b, jerk_b)))

    def _error_of_derivatives(self, h: float, q_b: Array, rise_b: Array) -> float:
        """Return the largest e of derivatives q_b in a step of size h in which a_b rises."""
        assert self._tolerance is not None
        size_b = vector_sizes(q_b.T, self.system.vector_size).T
        scale = constraint_error(Coefficients(h, self._alpha))
        return self._tolerance.of_derivatives(h, scale * rise_b, size_b)
