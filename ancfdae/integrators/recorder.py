"""Collects states and counters during a run, and makes a `Solution` of them."""

import time
from typing import NamedTuple, TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import Sensitivities, Statistics
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.errors.outcomes import RunOutcome
from ancfdae.numerics.arrays import Array

# Arrays of q, v, a and lam, one row per time point.
StateRows: TypeAlias = tuple[Array, Array, Array, Array]


class Rows(NamedTuple):
    """Time points t, (k,), with coordinates q and velocities v, (k, n_q)."""

    t: Array
    q: Array
    v: Array

    def cubic(self, times: Array | float) -> Array:
        """Return coordinates on the cubic through q and v at both of two rows, (..., n_q)."""
        (t, end), q, v = self
        h = end - t
        s = (np.asarray(times)[..., None] - t) / h
        ends = q[0] + s * s * (3 - 2 * s) * (q[1] - q[0])
        return np.asarray(ends + h * s * (1 - s) * ((1 - s) * v[0] - s * v[1]))


@final
class SolutionRecorder:
    """Arrays of states that a run fills row by row, and the counters of its cost (`Statistics`).

    There is space for `rows` time points, the start included; the arrays grow if there are more.
    `degree` is the number of time points per step; `accepted` counts the accepted steps where time
    points are not tied to steps. A continued run starts with the rows and counters of the solution
    `before`.

    Raises
    ------
    InvalidInputError
        If the trajectory does not fit into memory.
    """

    def __init__(
        self,
        system: MechanicalSystem,
        rows: int,
        degree: int = 1,
        sensitivities: bool = False,
        before: Solution | None = None,
    ) -> None:
        self._system, self._degree = system, degree
        self.dtype = dtype = np.result_type(system.b, system.start()[0], float)
        sizes = (system.n_q, system.n_q, system.n_q, system.n_lam)
        try:
            self._arrays = [np.zeros(rows), *(np.zeros((rows, n), dtype=dtype) for n in sizes)]
            if sensitivities:
                self._arrays += [np.zeros((rows, n, system.n_b)) for n in sizes]
        except MemoryError as error:
            raise InvalidInputError(
                "trajectory",
                "must fit into memory",
                f"{rows} instants of {sum(sizes)} numbers",
                "Use a larger step, fewer instants or a shorter run.",
            ) from error
        self.instants = 0
        # State of step control at the last time.
        self._control: tuple[float, ...] = ()
        self.accepted: int | None = None
        self.iterations = self.factorisations = self.residuals = 0
        self.round_off_steps = self.rejected = self.continued = 0
        self._started = time.perf_counter()
        if before is not None:
            self._go_on(before)

    def _go_on(self, before: Solution) -> None:
        done, told = len(before.t), before.statistics
        kept = (before.t, before.q, before.v, before.a, before.lam)
        more = max(0, done - len(self._arrays[0]))
        arrays = [np.concatenate([x, np.zeros((more, *x.shape[1:]))]) for x in self._arrays]
        for array, rows in zip(arrays, kept, strict=True):
            array[:done] = rows
        self._arrays, self.instants, self._control = arrays, done, before.control
        self.iterations, self.factorisations = told.iterations, told.factorisations
        self.residuals, self.round_off_steps = told.residuals, told.round_off_steps
        self.rejected, self.continued = told.rejected, told.continued
        self._started -= told.wall_seconds

    @property
    def steps(self) -> int:
        """Number of accepted steps of the run so far."""
        return max(self.instants - 1, 0) // self._degree if self.accepted is None else self.accepted

    @property
    def time(self) -> float:
        """Time of the last recorded state; s."""
        return float(self._arrays[0][max(self.instants - 1, 0)])

    def record(
        self,
        t: float | Array,
        q: Array,
        v: Array,
        a: Array,
        lam: Array,
        derivatives: tuple[Array, ...] = (),
    ) -> None:
        """Store a state and its design derivatives (q_b, v_b, a_b, lam_b).

        With an array t, (k,), all arrays hold k rows. Rows count only when all are stored, so that
        an interrupt leaves no incomplete row.
        """
        rows = slice(self.instants, self.instants + np.size(t))
        while rows.stop > len(self._arrays[0]):
            self._arrays = [np.concatenate([x, np.zeros_like(x)]) for x in self._arrays]
        for array, value in zip(self._arrays, (t, q, v, a, lam, *derivatives), strict=True):
            array[rows] = value
        self.instants, self._control = rows.stop, ()

    def room(self, count: int) -> StateRows:
        """Return the next `count` rows of q, v, a and lam as views to fill; `take` counts them."""
        while self.instants + count > len(self._arrays[0]):
            self._arrays = [np.concatenate([x, np.zeros_like(x)]) for x in self._arrays]
        q, v, a, lam = (x[self.instants : self.instants + count] for x in self._arrays[1:5])
        return q, v, a, lam

    def take(self, t: Array, control: tuple[float, ...] = ()) -> None:
        """Add rows that are already written, at times t, s, and store the state of step control."""
        self._arrays[0][self.instants : self.instants + len(t)] = t
        self.instants, self._control = self.instants + len(t), control

    def beside(self, derivatives: tuple[Array, ...]) -> None:
        """Write design derivatives of states to the rows that `take` counts next."""
        for array, rows in zip(self._arrays[5:], derivatives, strict=True):
            array[self.instants : self.instants + len(rows)] = rows

    def last(self, count: int) -> Rows:
        """Return the last `count` time points with coordinates and velocities."""
        t, q, v, *_ = (x[self.instants - count : self.instants] for x in self._arrays)
        return Rows(t, q, v)

    def cut(self, count: int) -> None:
        """Delete time points after the first `count`, and a step that is thus incomplete."""
        self.instants, self._control = 1 + (count - 1) // self._degree * self._degree, ()

    def back(self) -> None:
        """Delete the last recorded step and count it as rejected."""
        self.cut(self.instants - 1)
        self.rejected += 1

    def restart(self) -> None:
        """Delete all recorded states after the first."""
        self.instants, self._control = 1, ()

    def solution(self, outcome: RunOutcome) -> Solution:
        """Return the recorded states as a `Solution` with this outcome."""
        system = self._system
        t, q, v, a, lam, *derivatives = (array[: self.instants] for array in self._arrays)
        return Solution(
            t=t,
            q=q,
            v=v,
            a=a,
            lam=lam,
            statistics=Statistics(
                steps=self.steps,
                iterations=self.iterations,
                factorisations=self.factorisations,
                residuals=self.residuals,
                round_off_steps=self.round_off_steps,
                rejected=self.rejected,
                continued=self.continued,
                wall_seconds=time.perf_counter() - self._started,
            ),
            outcome=outcome,
            naming=system.naming,
            sensitivities=Sensitivities(system.design_names, system.b, *derivatives)
            if derivatives
            else None,
            degree=self._degree,
            control=self._control,
        )
