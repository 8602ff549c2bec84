"""Newton's method for steps of HHT-I3, taken by a kernel: its rules, and how steps end.

Derivation: docs/theory/05-hht-i3.md. `kernels/march.h` iterates.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.prepared import Prepared
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.hht.equations import Coefficients, Node
from ancfdae.integrators.hht.small_steps import PLACES, QUIET, WEIGHTS
from ancfdae.integrators.recorder import SolutionRecorder, StateRows
from ancfdae.integrators.step_control.contracts import Failure
from ancfdae.kernels import CalledPlan, March
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
_PATIENCE = 0.1

_VERDICTS = {March.NOT_FINITE: Verdict.NOT_FINITE, March.SINGULAR: Verdict.SINGULAR}

# Coefficients, the state before the step, and the instant at its end.
Step: TypeAlias = tuple[Coefficients, Node, float]


class SolvedStep(NamedTuple):
    """A solution, whether round-off disturbs it, and the slowest rate of the corrections."""

    node: Node
    round_off: int
    rate: float


class _Attempt(NamedTuple):
    """How a step is solved: a guess of a and lam, and limits as for `Model.march`."""

    guess: tuple[Array, Array] | None
    limits: tuple[float, float, int]


class _End(NamedTuple):
    """How steps end: number taken, reason, the last state, size and slowest rate of corrections."""

    taken: int
    why: March
    node: Node
    round_off: int
    size: float
    rate: float


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
        """Count what was found as a step."""
        self._recorder.round_off_steps += solved.round_off
        return solved.node

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
            (q, v, a, lam, A), motion, h, *tables, _PATIENCE, rows, *attempt
        )
        iterations, factorisations, round_off = counts
        self._recorder.iterations += iterations
        self._recorder.residuals += iterations
        self._recorder.factorisations += factorisations
        if not taken and why in (March.NEEDS_GAUSS, March.INDEFINITE):
            self._add(why)
            return self._taken(before, h, ends, rows, attempt)
        if taken:
            # Copies: a node that is kept must not keep the rows of a whole part.
            q, v, A, lam = (row[taken - 1].copy() for row in rows)
            before = Node(float(ends[taken - 1]), q, v, a, lam, A, motion)
        return _End(taken, March(why), before, round_off, size, rate)

    def _add(self, why: int) -> None:
        """Prepare what the next step needs."""
        if why == March.NEEDS_GAUSS:
            self._small = True
        else:
            self._kernel.add_band()

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
