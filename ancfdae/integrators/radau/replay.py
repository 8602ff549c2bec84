"""A run at known steps, taken part by part, forward and backward."""

from __future__ import annotations

from dataclasses import replace
from typing import final

import numpy as np

from ancfdae.equations.solution import Solution
from ancfdae.integrators.integrator import RunInParts, Seeds
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.radau import linear_passes
from ancfdae.integrators.radau.step import RadauStepper, State
from ancfdae.integrators.radau.tableau import PLACES
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control.contracts import Reached, march
from ancfdae.integrators.step_control.planned import StepPlan
from ancfdae.numerics.arrays import Array


@final
class RadauReplay(RunInParts):
    """A run of steps of sizes h, (n,), between given ends, (n + 1,)."""

    degree = 3

    def __init__(
        self, problem: InitialValueProblem, h: Array, ends: Array, newton: tuple[float, int]
    ) -> None:
        self._problem, self._h, self._ends, self._newton = problem, h, ends, newton
        stages = ends[:-1, None] + h[:, None] * PLACES[:2, 0]
        self.t = np.append(ends[0], np.column_stack([stages, ends[1:]]).ravel())
        self.taken = 0

    def start(self) -> State:
        """Return the consistent start of the run that is repeated."""
        return self._stepper(SolutionRecorder(self._problem.system, 1)).start(float(self._h[0]))

    def part(self, node: State, first: int, last: int) -> tuple[Solution, State]:
        """March over a plan of the known steps."""
        begin, end = first // self.degree, last // self.degree
        recorder = SolutionRecorder(self._problem.system, last - first + 1, self.degree)
        t, q, v, a, lam = (x[-1] for x in node.rows)
        recorder.record(float(t), q, v, a, lam, ())
        plan = StepPlan(self._h[:end], self._ends[1 : end + 1])
        begun = Reached(begin, float(t), node.h, node)
        stepper = self._stepper(recorder)
        run, reached = march(stepper, plan, recorder, float(self._ends[end]), False, begun)
        self.taken += reached.n - begin
        return replace(run, outcome=replace(run.outcome, step=reached.n)), reached.now

    def pull_back(
        self, run: Solution, node: State, first: int, seeds: Seeds, on: Array
    ) -> tuple[Array, Array]:
        """Pull back over the steps of a part."""
        begin = first // self.degree
        h = self._h[begin : begin + len(run.t) // self.degree]
        return linear_passes.pull_back(self._problem, run, h, seeds, on)

    def close(self, on: Array, seeds: Seeds, gradient: Array) -> Array:
        """Add to the gradient the part that goes through the start of the run."""
        return linear_passes.through_start(self._problem, on, seeds, gradient)

    def no_covectors(self) -> Array:
        """Return zero adjoint vectors on q and v, shape (2, n_q)."""
        return np.zeros((2, self._problem.system.n_q))

    def _stepper(self, recorder: SolutionRecorder) -> RadauStepper:
        return RadauStepper(self._problem, self._newton, (), recorder)
