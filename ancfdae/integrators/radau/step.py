"""Runs of Radau IIA: known steps, steps under error control, and derivatives along with them.

**Error of a step.** The embedded formula of order 3, filtered by the real matrix (Hairer & Wanner,
IV.8). With a_0 of the state before, e its weights and k = gamma, in the scaled displacements x

    r_q = h sum e_i x_i,    r_v = a_0 + sum (e^T A^-1)_i x_i
    [k^2 M + h k f_v + h^2 f_q   Phi_q^T] [dq]   [h^2 (M (r_v + k r_q/h) + f_v r_q)]
    [Phi_q                       0      ] [. ] = [0                                ],
    dv = k dq/h - r_q,

applied twice, the second time to r_q = k dq/h, r_v = k dv/h: stiff vibrations in a_0 must not pass.
The motion that joints prescribe, across the free directions, is known at the stages, and is not
filtered: with the completed velocities v_i

    Phi_q dq = (h/k) Phi_q h sum e_i x_i,    Phi_q dv = (h/k) Phi_q (a_0 + sum e_i (v_i - v_0)/h)

are added, with K dq + Phi_q^T [.] = 0 for the matrix K above: bodies follow quasi-statically. Here
the error is not divided by the share of the step in the run (`contracts`); it is the whole error.
x has the round-off of positions over h^2, which the tolerance allows beside.

The kernel (`stages.h`) has these formulas. It calls back for the errors of derivatives.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.errors.kinds import SingularMatrix
from ancfdae.integrators.prescribed_motion import turn_error
from ancfdae.integrators.problem import InitialValueProblem, vector_sizes
from ancfdae.integrators.radau.linear_passes import LinearStages, StageKernel
from ancfdae.integrators.radau.stages import (
    PLACES,
    Control,
    StageSolver,
    State,
    laws_of,
    laws_of_known,
)
from ancfdae.integrators.recorder import Rows, SolutionRecorder
from ancfdae.integrators.step_control.contracts import (
    Batch,
    ErrorController,
    Failure,
    OneStepMethod,
    Reached,
    Record,
    Tolerance,
    Tries,
)
from ancfdae.numerics.arrays import Array

# Fractions of a run that are tried as first step, each an eighth of the one before.
_FIRST = [0.05 * 8.0**-k for k in range(8)]
_EPS = float(np.finfo(float).eps)
_NONE = np.zeros(0)


@final
class RadauStepper(OneStepMethod[State]):
    """Takes the steps of a Radau run, with derivatives if those of the start are given.

    There are tolerances of positions and of velocities; none without error control.
    """

    order: ClassVar[int] = 4
    bears_jumps: ClassVar[bool] = True
    # A step of a small mechanism takes 0.05 to 1 ms.
    many: ClassVar[int] = 5_000
    remedy: ClassVar[str] = (
        "Radau under error control follows every wave that its tolerance sees. HHT(step=...) steps "
        "over those that do not matter (docs/howto/integrator.md)."
    )

    def __init__(
        self,
        problem: InitialValueProblem,
        newton: tuple[float, int],
        tolerances: tuple[Tolerance, ...],
        recorder: SolutionRecorder,
    ) -> None:
        self._problem, self._recorder, self._tolerances = problem, recorder, tolerances
        self._solver = StageSolver(problem, *newton, recorder)
        self.system = problem.system

    @cached_property
    def _passes(self) -> StageKernel:
        """The kernel's derivative passes, for runs with derivatives."""
        return StageKernel(self._problem)

    def consistent(self) -> Record:
        """Return the consistent start as a row of the solution, with derivatives if present."""
        return *self._problem.initial, self._problem.derivative or ()

    def start(self, h: float) -> State:
        """Return the consistent start, which does not depend on the step size."""
        rows = (np.asarray(x)[None] for x in self._problem.initial)
        return State(h, tuple(rows), tuple(x[None] for x in self._problem.derivative or ()))

    def resized(self, state: State, ratio: float) -> State:
        """Return the state unchanged, because it suits any step size."""
        return state

    def recorded(self, state: State) -> Record:
        """Return the stages of a step as rows of the solution; the last one is its end."""
        t, q, v, a, lam = (x[1:] for x in state.rows)
        return t, q, v, a, lam, tuple(x[1:] for x in state.derivatives)

    def advance(self, h: float, before: State, t: float) -> State | Failure:
        """Return the state after the step to t, with completed stages, or a Failure."""
        found = self._known(before, np.array([h]), np.array([t]))
        return found.failure or found.states(1)

    def march(self, before: State, sizes: Array, ends: Array) -> tuple[int, State]:
        """Take steps of given sizes in one call of the kernel."""
        if self._solver.prepared.alone or len(sizes) == 1:
            return 0, before
        found = self._known(before, sizes, ends)
        self._recorder.take(found.t)
        count = len(found.ends)
        return count, found.states(count) if count else before

    def _known(self, before: State, sizes: Array, ends: Array) -> Batch:
        """Return steps of given sizes."""
        prepared, t = self._solver.prepared, float(before.rows[0][-1])
        laws = laws_of_known(prepared, t, sizes, ends) if prepared.timed else None
        control = Control(_NONE, _NONE, sizes, ends)
        begin = Reached(0, t, before.h, before)
        return self._solver.march(begin, control, len(sizes), None, laws)[0]

    def controlled(
        self, begin: Reached, controller: ErrorController, most: int, tries: Tries | None
    ) -> Batch:
        """Take steps in one call of the kernel, one by one with derivatives."""
        control = Control(controller.numbers, controller.stops, _NONE, _NONE)
        return self._controlled(begin, control, most, tries)[0]

    def _controlled(
        self, begin: Reached, control: Control, most: int, tries: Tries | None = None
    ) -> tuple[Batch, float]:
        """Return steps with errors against the tolerances, and e of the last one."""
        solver, before, derivatives = self._solver, begin.now, tuple[Array, ...]()
        laws = laws_of(solver.prepared, self._turn_error) if solver.prepared.timed else None
        rows = self._recorder.room(3)

        def times(h: float, end: float) -> Array:
            return np.append(begin.t + h * PLACES[:2, 0], end)

        def seen(h: float, end: float) -> float:
            assert tries is not None
            tries(Rows(times(h, end), *rows[:2]))
            return 0.0

        if not before.derivatives:
            most = 1 if solver.prepared.alone else most
            along_with = seen if tries else None
            return solver.march(begin, control, most, self._bounds, laws, along_with)

        def along(h: float, end: float) -> float:
            nonlocal derivatives
            t = times(h, end)
            both = zip(before.rows, (t, *rows), strict=True)
            after = State(h, tuple(np.concatenate([x[-1:], y]) for x, y in both))
            derivatives, errors = self._differentiated(before, after)
            return self._error_of_derivatives(h, derivatives, errors)

        found, error = solver.march(begin, control, 1, self._bounds, laws, along)
        if len(found.ends):
            self._recorder.beside(tuple(x[1:] for x in derivatives))

        def state(k: int) -> State:
            motion: State = found.states(k)
            return motion._replace(derivatives=derivatives)

        return found._replace(states=state), error

    def _turn_error(self, end: float, h: float) -> float:
        return turn_error(self.system, end, h, self.order)

    @cached_property
    def _bounds(self) -> tuple[Any, ...]:
        """Tolerances of positions and velocities as `StageSolver.march` takes them."""
        scales, d = self._problem.scales, self.system.vector_size
        pairs = [x for each in self._tolerances for x in (each.rtol, each.atol * each.sizes)]
        return *pairs, scales.place, scales.q, d

    def _differentiated(self, before: State, after: State) -> tuple[tuple[Array, ...], Array]:
        """Return derivatives of the stages of a step, and their errors dq and dv as rows."""
        h, passes = after.h, self._passes
        t, *states = (x[None] for x in after.rows)
        *first, lam = (x[-1].T for x in before.derivatives)
        rows, lam_b = (np.zeros((4, *x.shape)) for x in (np.array(first), lam))
        rows[0], lam_b[0] = first, lam
        steps = LinearStages.of(passes, np.array([h]), t, states)
        taken, x_b = steps.forward(rows, lam_b)
        if not taken:
            raise SingularMatrix("the matrix of the stages is singular")
        middle = float(after.rows[0][2]), tuple(x[2] for x in after.rows[1:])
        errors = passes.embedded_errors(h, *middle, (rows[:, 1].copy(), first[2], x_b))
        self._recorder.factorisations += 2
        return (*rows.transpose(1, 0, 3, 2), lam_b.transpose(0, 2, 1)), errors

    def _error_of_derivatives(
        self, h: float, derivatives: tuple[Array, ...], errors: Array
    ) -> float:
        """Return the largest e of derivatives of positions and velocities; NaN if one is."""
        found = []
        for k, tolerance in enumerate(self._tolerances):
            # The tolerance divides by the share of the step in the run; here it is the whole error.
            size_b = vector_sizes(derivatives[k][-1].T, self.system.vector_size).T
            # Infinite sizes of derivatives are not known yet.
            known = np.where(np.isfinite(tolerance.sizes_b), tolerance.sizes_b, 0.0)
            least = np.multiply.outer(self._problem.scales.q, known)
            blur_b = _EPS * (np.abs(derivatives[0][-1]) + least) / h**k
            found.append(tolerance.of_derivatives(tolerance.t_end, errors[k].T, size_b, blur_b))
        return float(np.max(found))

    def start_error(self) -> float:
        """Return e of the first step that can be solved, divided by its size^order."""
        for part in _FIRST if self._tolerances else ():
            h = part * self._tolerances[0].t_end
            step, begin = np.array([h]), Reached(0, 0.0, h, self.start(h))
            found, error = self._controlled(begin, Control(_NONE, _NONE, step, step), 1)
            if len(found.ends):
                return error / h**self.order
        return 0.0
