"""Steps of Radau IIA: coefficients, equations of the stages, and the solver in the kernel.

Coefficients: Hairer & Wanner, Solving ODEs II, IV.5 and IV.8. With h^2 x the
displacements of the stages from the motion at constant velocity,

    Q = q_0 + h c v_0 + h^2 x,     V = v_0 + h A^-1 x,     Q'' = A^-2 x,

the equations of a step are those of motion and the constraints at every stage,

    M(Q_i) Q_i'' + Phi_q^T lam_i - Q(t_i, Q_i, V_i) = 0,     Phi(t_i, Q_i) / h^2 = 0.

**Matrix.** With the matrices of every stage at its own state block (i, j) of K is (A^-2)_ij M_i + h
(A^-1)_ij f_v,i, plus h^2 f_q,i for i = j.

**Completion.** The stages satisfy the constraints of positions. The violation of constraints by
their velocities, O(h^3), is removed, and accelerations and multipliers follow (`linear_passes`); so
a step continues from q and v.

**Steps that Newton's method does not solve** are solved by way of shorter steps from the same
start, unless their error is controlled: a smaller step is the better remedy then.

Steps run in `kernels/stages.h`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np

from ancfdae.equations.saddle_points import Prepared
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control.contracts import Batch, Reached
from ancfdae.kernels import FILTER, RULES, CoupledMatrix, March
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import coupled_arrays

_ROOT = np.sqrt(6.0)

#: Butcher matrix A.
BUTCHER = np.array(
    [
        [(88 - 7 * _ROOT) / 360, (296 - 169 * _ROOT) / 1800, (-2 + 3 * _ROOT) / 225],
        [(296 + 169 * _ROOT) / 1800, (88 + 7 * _ROOT) / 360, (-2 - 3 * _ROOT) / 225],
        [(16 - _ROOT) / 36, (16 + _ROOT) / 36, 1 / 9],
    ]
)
#: Nodes c of the stages as fractions of the step, as a column.
PLACES = np.array([[(4 - _ROOT) / 10], [(4 + _ROOT) / 10], [1.0]])
#: A^-1 and A^-2.
INVERSE = np.linalg.inv(BUTCHER)
SQUARED = INVERSE @ INVERSE
#: Weights e, a row, of the embedded formula: err = (gamma/h - J)^-1 (f_0 + sum e_i (Y_i - y_0)/h).
EMBEDDED = np.array([[-13 - 7 * _ROOT, -13 + 7 * _ROOT, -1]]) / 3
#: The real eigenvalue of A^-1.
GAMMA = float(min(np.linalg.eigvals(INVERSE), key=lambda x: abs(x.imag)).real)
#: All coefficients in the layout of `StageTableau` of the kernel.
TABLEAU = np.append(
    np.concatenate([x.ravel() for x in (PLACES, INVERSE, SQUARED, BUTCHER, EMBEDDED)]), GAMMA
)


class Stages(NamedTuple):
    """Positions, velocities, accelerations and multipliers of the stages of a step, a row each."""

    q: Array
    v: Array
    a: Array
    lam: Array


class State(NamedTuple):
    """State after a step: its size h, s, and start, stages and end as rows (t, q, v, a, lam).

    The start of a run is one row. Derivatives q_b, v_b, a_b, lam_b have the same rows.
    """

    h: float
    rows: tuple[Array, ...]
    derivatives: tuple[Array, ...] = ()


def stage_matrices(problem: InitialValueProblem) -> CoupledMatrix:
    """Return the coupled matrix of the stages for kernels.

    Constraints are scaled by their rows at the start.
    """
    system, Phi_q = problem.system, problem.system.constraint_q(0.0, problem.initial.q)
    patterns = system.pattern, system.constraint_pattern
    layout = problem.matrices.layout(band=False)
    return coupled_arrays(3, *patterns, system.weights, Phi_q, layout and layout.order)


# The iteration matrix is recomputed if more than _MORE further iterations are predicted.
_MORE = 4
# Forces above _JUMP times those at the start of the step come from wrong strains of the guess: a
# matrix made there is used once.
_JUMP = 10.0
# Corrections are measured against forces of the iterate, at most _MOST times those at the start of
# the step: a diverging iterate has huge forces.
_MOST = 100.0
# Corrections count as no longer shrinking if they shrink by less than this factor.
_SLOW = 0.5
# Corrections that stop shrinking count as round-off below _ROUND_OFF times the motion, or
# _POSITIONS times the round-off of positions.
_ROUND_OFF, _POSITIONS = 1e-6, 1e4
_TINY = float(np.finfo(float).tiny)


Laws: TypeAlias = Callable[[float, float, float], tuple[Array, Array, float]]


def factors(prepared: Prepared, starts: Array, ends: Array, h: Array) -> tuple[Array, Array]:
    """Return factors of joints and loads at the stages and at the start of k steps.

    Factors of joints, with two time derivatives, have the shape (k, 12, n_parts), or (1, 1, 1) if
    nothing is driven; factors of loads have the shape (k, 4, n_loads).
    """
    within = starts[:, None] + h[:, None] * PLACES[:2, 0]
    t = np.column_stack([within, ends, starts]).ravel()
    joints, of_loads = prepared.plan.joint_factors, prepared.plan.load_factors(t)
    of_joints = np.ones((1, 1, 1))
    if joints is not None:
        of_joints = joints(t, 3).reshape(3, len(h), 4, -1).swapaxes(0, 1).reshape(len(h), 12, -1)
    return of_joints, of_loads.reshape(len(h), 4, of_loads.shape[1])


def laws_of(prepared: Prepared, turn: Callable[[float, float], float]) -> Laws:
    """Return the laws of a system, with `turn(end, h)` as error of the rotation in a step."""

    def laws(t: float, end: float, h: float) -> tuple[Array, Array, float]:
        joints, loads = factors(prepared, np.array([t]), np.array([end]), np.array([h]))
        return joints[0], loads[0], turn(end, h)

    return laws


def laws_of_known(prepared: Prepared, begin: float, sizes: Array, ends: Array) -> Laws:
    """Return the laws of steps from `begin` (s) on, whose factors are evaluated together."""
    starts, others = np.append(begin, ends[:-1]), laws_of(prepared, lambda end, h: 0.0)
    joints, loads = factors(prepared, starts, ends, sizes)
    steps = zip(starts.tolist(), ends.tolist(), strict=True)
    at = {step: k for k, step in enumerate(steps)}

    def laws(t: float, end: float, h: float) -> tuple[Array, Array, float]:
        k = at.get((t, end))
        if k is None:  # A shorter step.
            return others(t, end, h)
        return joints[min(k, len(joints) - 1)], loads[k], 0.0

    return laws


# Seconds after which the kernel returns, so that interrupts and the progress bar are served.
_PATIENCE = 0.1


class Control(NamedTuple):
    """Control of steps: numbers of a filter and stops, or sizes and ends of known steps."""

    numbers: Array
    stops: Array
    sizes: Array
    ends: Array


@final
class StageSolver:
    """Takes steps in the kernel, whose cost the recorder counts."""

    def __init__(
        self,
        problem: InitialValueProblem,
        tolerance: float,
        max_iterations: int,
        recorder: SolutionRecorder,
    ) -> None:
        system, matrices = problem.system, problem.matrices
        least = max(10 * system.traits.force_round_off, _TINY)
        rules = tolerance, max_iterations, least, _MORE, _JUMP, _MOST, _SLOW, _ROUND_OFF
        self._rules, self._recorder = np.array([0.0, *rules, _POSITIONS]), recorder
        self.prepared = Prepared(system, matrices, np.zeros(RULES), recorder.dtype)
        self._coupled = stage_matrices(problem)

    def march(
        self,
        begin: Reached,
        control: Control,
        most: int,
        tolerance: tuple[Any, ...] | None,
        laws: Laws | None,
        along: Callable[[float, float], float] | None = None,
    ) -> tuple[Batch, float]:
        """Take up to `most` steps, and write their stages to the next rows of the recorder.

        Parameters
        ----------
        begin : Reached
            Progress of the run, with a `State`.
        control : Control
            The kernel changes the numbers of the filter.
        most : int
            Largest number of steps; their number if they are known.
        tolerance : tuple, optional
            rtol and atol Q_i of positions, the same of velocities, place and scale of positions,
            and length of the system's vectors.
        laws : Laws, optional
            Returns the factors of joints and loads of a step and the error of its rotation, from
            the start, end and size of the step, s.
        along : Callable, optional
            Returns an error e that belongs to the step too, from its size and end, s.

        Returns
        -------
        tuple of Batch and float
            The steps, and e of the last one that was tried.
        """
        recorder, prepared, before = self._recorder, self.prepared, begin.now
        rows, ends = recorder.room(3 * most), np.empty(most)
        t, filters = np.empty(3 * most), np.empty((most, FILTER))
        taken, end, rejected, continued, counts, size, error = prepared.model.march_stages(
            self._coupled,
            before.rows[1:],
            (begin.n, begin.t, before.h),
            control,
            tolerance,
            (laws, prepared.start),
            along,
            (t, *rows),
            (ends, filters),
            (TABLEAU, self._rules),
            _PATIENCE,
        )
        recorder.rejected += rejected
        recorder.continued += continued
        recorder.iterations += counts[0]
        recorder.residuals += 3 * counts[0]
        recorder.factorisations += counts[1]
        recorder.round_off_steps += counts[2]
        if not taken and end == March.INDEFINITE:
            prepared.add_band()
            return self.march(begin, control, most, tolerance, laws, along)

        def state(k: int) -> State:
            """Return the state after the first k steps; copies, to keep no other rows."""
            last = slice(3 * (k - 1), 3 * k)
            starts = (
                (x[-1:] for x in before.rows)
                if k == 1
                else (x[[last.start - 1]] for x in (t, *rows))
            )
            h = ends[k - 1] - (ends[k - 2] if k > 1 else begin.t)
            h = float(control.sizes[k - 1] if len(control.sizes) else h)
            both = zip(starts, (t, *rows), strict=True)
            return State(h, tuple(np.concatenate([x, y[last]]) for x, y in both))

        found = Batch(t[: 3 * taken], ends[:taken], filters, state, March(end), size)
        return found, error
