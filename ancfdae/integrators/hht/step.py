"""A step of HHT-I3: Newton's method, shorter steps where it stalls, and the error.

Newton's method for steps of HHT-I3, taken by a kernel: its rules, and how steps end.

Derivation: docs/theory/05-hht-i3.md. `kernels/march.h` iterates.

Continuation in the step: where Newton's method stalls, the solution by way of shorter steps.

From the same state the equations of a step s h, with 0 < s <= 1, have one solution near the motion
if s is small. The branch of solutions that begins there is followed in s: guesses lie on the cubic
through the last four solutions, and count only where Newton's method contracts from its first
correction on, so that the branch is not left. The first rate of contraction is that of the distance
of the guess, which goes with the stride to the power of the number of solutions. The branch ends at
s = 1, with the solution of the full step, or turns back before: no larger step has a solution that
belongs to this motion.

Only guesses differ, not the equations; what they give has the derivatives of any other step.

A step of HHT-I3: of the motion and, if asked for, of its design derivatives.

**Error of a step** (Negrut, Rampalli, Ottarsson & Sajdak 2007, section 3). Inserting the smooth
solution in eq. (2), with a_n standing for q'' at t_n + alpha h, the position update misses

    delta = C h^3 q''' = C h^2 (a_{n+1} - a_n),     C = -(1 + 3 alpha^2)/12,

so the increment of the acceleration estimates it at no cost, and at frozen steps that of a_b its
derivative in the design. The tolerance bounds delta / h, which falls with h^2; the original bounds
delta, and its runs then err by the tolerance to the power 2/3.
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
from ancfdae.integrators.recorder import SolutionRecorder, StateRows
from ancfdae.integrators.step_control.contracts import (
    Batch,
    Controller,
    Failure,
    OneStepMethod,
    Reached,
    Record,
    Tolerance,
)
from ancfdae.kernels import FILTER, CalledPlan, ListPlan, March, norm
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import SaddlePoint

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
# Seconds after which a packet ends, so that interrupts and progress come through.
_NEWTON_PATIENCE = 0.1

_VERDICTS = {
    March.NOT_FINITE: Verdict.NOT_FINITE,
    March.SINGULAR: Verdict.SINGULAR,
    March.NO_CONVERGENCE: Verdict.NO_CONVERGENCE,
    March.INACCURATE: Verdict.ERROR_TEST,
}

# Coefficients, the state before the step, and the instant at its end.
Step: TypeAlias = tuple[Coefficients, Node, float]


class SolvedStep(NamedTuple):
    """A solution, whether round-off disturbs it, and the slowest rate of the corrections."""

    node: Node
    round_off: int
    rate: float


class _Attempt(NamedTuple):
    """Attempt to solve a step: a guess of a and lam, and limits as for `Model.march`."""

    guess: tuple[Array, Array] | None
    limits: tuple[float, float, int]


class _End(NamedTuple):
    """End of steps: number taken, reason, last state, size and slowest rate of corrections."""

    taken: int
    why: March
    node: Node
    round_off: int
    size: float
    rate: float


class ControlledSteps(NamedTuple):
    """Steps under control: ends, filters and nodes after each, why they end, last correction."""

    ends: Array
    filters: Array
    node: Callable[[int], Node]
    why: March
    size: float


@final
class StepSolver:
    """Newton's method for one step after another, which the recorder counts."""

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
        # Whether steps are taken one by one: a function of Python may raise in each of them.
        self.alone = isinstance(self._kernel.plan, CalledPlan)
        self._sizes = system.n_q, system.n_q, system.n_q, system.n_lam
        self._recorder, self._small = recorder, False

    @property
    def iterations(self) -> int:
        """Iterations so far, of all steps."""
        return self._recorder.iterations

    def march(self, before: Node, h: Array, ends: Array, rows: StateRows) -> tuple[int, Node]:
        """Take steps until one is not solved; write the states to rows of q, v, A and lam."""
        end = self._taken(before, h, ends, rows, self._usual(1))
        self._recorder.round_off_steps += end.round_off
        return end.taken, end.node

    def advance(self, step: Step, patience: int = 1) -> Node | Failure:
        """Solve eqs. (4) and (5), in `patience` times as many iterations as are usual."""
        solved = self._solved(step, self._usual(patience))
        return solved if isinstance(solved, Failure) else self.accept(solved)

    def follow(self, step: Step, guess: tuple[Array, Array], rough: float) -> SolvedStep | Failure:
        """Solve them from a guess that is close to the solution.

        Where corrections do not shrink quickly from the first one on, the solution that they lead
        to may be another one. A tolerance that is larger than that of the run may be given.
        """
        limits = max(rough, self._tolerance), _CLOSE, self.max_iterations
        return self._solved(step, _Attempt(guess, limits))

    def accept(self, solved: SolvedStep) -> Node:
        """Count the solution that was found as an accepted step."""
        self._recorder.round_off_steps += solved.round_off
        return solved.node

    def controlled(
        self,
        begin: tuple[Node, int, float],
        control: tuple[Array, Array],
        tolerance: tuple[float, Array, Array, int],
        laws: Callable[[float, float, float], tuple[Array, Array, float]] | None,
        most: int,
    ) -> ControlledSteps:
        """Take steps under error control until there are `most`, or Python is to decide.

        Begin with a node, its number and the size of the step that led there.
        """
        recorder, plan, (node, n, last) = self._recorder, self._kernel.plan, begin
        rows, numbers = recorder.room(most), self._sizes[0]
        a, ends, motions = np.empty((most, numbers), recorder.dtype), np.empty(most), np.empty(most)
        filters, limits = np.empty((most, FILTER)), (self._tolerance, self.max_iterations)
        start = plan.start if isinstance(plan, ListPlan) else 0.0
        taken, why, rejected, counts, size = self._kernel.model.march_controlled(
            (node.q, node.v, node.a, node.lam, node.A),
            (node.motion, n, node.t, last),
            *control,
            tolerance,
            (laws, start),
            rows,
            (a, ends, motions, filters),
            (*limits, _NEWTON_PATIENCE),
        )
        recorder.rejected += rejected
        recorder.iterations += counts[0]
        recorder.residuals += counts[0]
        recorder.factorisations += counts[1]
        recorder.round_off_steps += counts[2]
        if not taken and why in (March.NEEDS_GAUSS, March.INDEFINITE):
            self._add(why)
            return self.controlled(begin, control, tolerance, laws, most)
        q, v, A, lam = rows

        def node_at(k: int) -> Node:
            of_q, of_v, of_a, of_lam, of_A = (x[k - 1].copy() for x in (q, v, a, lam, A))
            motion = float(motions[k - 1])
            return Node(float(ends[k - 1]), of_q, of_v, of_a, of_lam, of_A, motion)

        return ControlledSteps(ends[:taken], filters, node_at, March(why), size)

    def _usual(self, patience: int) -> _Attempt:
        return _Attempt(None, (self._tolerance, math.inf, patience * self.max_iterations))

    def _solved(self, step: Step, attempt: _Attempt) -> SolvedStep | Failure:
        """Solve one step."""
        c, before, t = step
        q, v, A, lam = (np.empty((1, n), dtype=self._recorder.dtype) for n in self._sizes)
        end = self._taken(before, np.array([c.h]), np.array([t]), (q, v, A, lam), attempt)
        if end.taken:
            return SolvedStep(end.node, end.round_off, end.rate)
        return Failure(_VERDICTS.get(end.why, Verdict.NO_CONVERGENCE), end.size)

    def _taken(
        self, before: Node, h: Array, ends: Array, rows: StateRows, attempt: _Attempt
    ) -> _End:
        """Take steps until one is not solved, and count what they cost."""
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
            # Copies: a node that is kept must not keep the rows of a whole part.
            q, v, A, lam = (row[taken - 1].copy() for row in rows)
            before = Node(float(ends[taken - 1]), q, v, a, lam, A, motion)
        return _End(taken, March(why), before, counts[2], size, rate)

    def _add(self, why: int) -> None:
        """Prepare what the next step needs."""
        if why == March.NEEDS_GAUSS:
            self._small = True
        else:
            self._kernel.add_band()

    @property
    def timed(self) -> bool:
        """Whether laws of time act on joints or loads of a scene."""
        plan = self._kernel.plan
        driven = plan.joint_factors is not None or plan.load_factors(np.zeros(1)).size > 0
        return driven and not self.own

    @property
    def own(self) -> bool:
        """Whether the system is one of the user's own, whose factors are the times."""
        return isinstance(self._kernel.plan, CalledPlan | ListPlan)

    def laws(self, t: float, end: float, h: float) -> tuple[Array, Array]:
        """Return the factors of joints and of loads in a step, as the kernel takes them."""
        starts, ends = np.array([t]), np.array([end])
        loads = self._kernel.plan.load_factors(np.array([end, t]))
        return self._joint_factors(starts, ends, np.array([h]))[0], loads

    def _joint_factors(self, starts: Array, ends: Array, h: Array) -> Array:
        """Factors at ends and beginnings of steps, and where they are small at Gauss points."""
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


# What follows only serves as a guess needs few digits.
_ROUGH = 1e-8
# The shortest part of a step that is tried.
_SHORTEST = 2.0**-20
# Where the part grows by less than this of itself the branch is taken for ended.
_FINEST = 1e-4
# Iterations, in multiples of those that Newton's method may take: more than any branch took that
# reached a solution (measured: 10 to 200, with 15).
_MOST = 15
# Solutions that a guess is made of.
_POINTS = 4
# Rate of contraction that strides aim at, and how much one may differ from the last.
_AIM, _LEAST, _LONGEST = 0.2, 0.5, 3.0
# Where the branch of solutions could be followed over more than this part of a step, and then was
# lost in round-off, as many iterations as this times the usual ones are spent on the full step.
_MOST_OF_IT, _CONTINUATION_PATIENCE = 0.5, 4


def solved(
    solver: StepSolver, system: MechanicalSystem, step: Step, why: Failure
) -> Node | Failure:
    """Solve the equations of a step that Newton's method alone does not solve, for a reason."""
    node, part = continued(solver, step, why)
    if isinstance(node, Failure) and part > _MOST_OF_IT:
        node = _patient(solver, system, step)
    if not isinstance(node, Failure) or node.verdict is Verdict.NOT_FINITE:
        # No step helps where the forces themselves are not finite.
        return node
    return node._replace(remedy=_remedy(step[0].h, part))


def continued(solver: StepSolver, step: Step, why: Failure) -> tuple[Node | Failure, float]:
    """Follow the branch, beside the part of the step that was solved."""
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
    """Iterate on where round-off hides the branch, unless that leads away from the motion."""
    c, last, _ = step
    node = solver.advance(step, patience=_CONTINUATION_PATIENCE)
    if isinstance(node, Failure):
        return node
    ahead, _ = predict_increment(c, last.v, last.a)
    near = norm(node.q - last.q - ahead, system.weights) <= norm(ahead, system.weights)
    return node if near else Failure(Verdict.NO_CONVERGENCE, math.inf)


def _remedy(h: float, part: float) -> str:
    """Return in words how much of a step of size h was solved; nothing if all or none."""
    if not 0 < part < 1:
        return ""
    return (
        f"The solution that belongs to the motion was found there for steps up to {part * h:.3g}."
    )


def _solved(
    solver: StepSolver, step: Step, part: float, branch: Sequence[tuple[float, SolvedStep]]
) -> SolvedStep | Failure:
    """Solve the equations of a part of the step from a guess, which must be close."""
    c, before, t = step
    now = t if part == 1.0 else before.t + part * (t - before.t)
    state, rough = rescaled(before, part), 0.0 if part == 1.0 else _ROUGH
    guess = _guess(part, branch) if branch else (state.a, state.lam)
    return solver.follow((Coefficients(part * c.h, c.alpha), state, now), guess, rough)


def _guess(part: float, branch: Sequence[tuple[float, SolvedStep]]) -> tuple[Array, Array]:
    """Return a and lam on the polynomial through solutions."""
    s = np.array([reached for reached, _ in branch])
    weights = [np.prod((part - np.delete(s, i)) / (x - np.delete(s, i))) for i, x in enumerate(s)]
    a, lam = (np.stack(x) for x in zip(*((f.node.a, f.node.lam) for _, f in branch), strict=True))
    return weights @ a, weights @ lam


# State of the recurrence at an instant, and of its derivatives if they are integrated.
State = tuple[Node, NodeSensitivity | None]


@final
class HHTStepper(OneStepMethod[State]):
    """Takes the steps of a run; differentiates them if derivatives of the start are given.

    The tolerance, of the error of a step, is None where nothing controls it; the counters of the
    recorder go on.
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

    def controlled(
        self, begin: Reached, controller: Controller, recorder: SolutionRecorder, most: int
    ) -> Batch | None:
        """Take steps in one call of the kernel; without derivatives along."""
        node, node_b = begin.now
        if self._tolerance is None or node_b is not None:
            return None
        scales, tolerance, solver = self._problem.scales, self._tolerance, self._solver
        least, d = tolerance.atol * tolerance.sizes, self.system.vector_size
        found = solver.controlled(
            (node, begin.n, begin.last),
            (controller.numbers, controller.stops),
            (tolerance.rtol, least, scales.place, d),
            self._laws if self._timed else None,
            1 if solver.alone else most,
        )
        why, again = None, None
        if found.why in _VERDICTS:
            size = 0.0 if found.why == March.INACCURATE else found.size
            why = Failure(_VERDICTS[found.why], size)
        elif found.why == March.BEGIN_ANEW:
            again = 0
        elif found.why == March.STEP_BEFORE:
            again = begin.n - 1
        return Batch(found.ends, found.filters, lambda k: (found.node(k), None), again, why)

    @cached_property
    def _timed(self) -> bool:
        """Whether laws of time act, or a system of one's own prescribes a turn."""
        turns = type(self.system).turn_rate is not MechanicalSystem.turn_rate
        return self._solver.timed or (turns and self._solver.own)

    def _laws(self, t: float, end: float, h: float) -> tuple[Array, Array, float]:
        """Return the factors in a step, and the error of its turn."""
        return *self._solver.laws(t, end, h), turn_error(self.system, end, h, self.order)

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
