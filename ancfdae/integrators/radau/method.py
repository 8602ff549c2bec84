"""The integrator Radau IIA of order 5 under any step control, and its runs in parts.

See docs/theory/14-radau.md. A run with steps that are known in advance can be integrated part by
part, forward and backward.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.integrator import PartwiseIntegrator, RunInParts, Seeds, with_contacts
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.radau import linear_passes
from ancfdae.integrators.radau.stages import PLACES, State
from ancfdae.integrators.radau.step import RadauStepper
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control import StepControl
from ancfdae.integrators.step_control.contracts import Reached, march
from ancfdae.integrators.step_control.steps import StepPlan
from ancfdae.integrators.stepped import EXACT, SteppedIntegrator
from ancfdae.numerics.arrays import Array


@final
class RadauReplay(RunInParts):
    """A run of Radau IIA with steps of sizes h, (n,), s, between given ends, (n + 1,), in parts."""

    degree = 3

    def __init__(
        self, problem: InitialValueProblem, h: Array, ends: Array, newton: tuple[float, int]
    ) -> None:
        self._problem, self._h, self._ends, self._newton = problem, h, ends, newton
        stages = ends[:-1, None] + h[:, None] * PLACES[:2, 0]
        self.t = np.append(ends[0], np.column_stack([stages, ends[1:]]).ravel())
        self.taken, self._contacts = 0, problem.system.contacts()

    def start(self) -> State:
        """Return the consistent start of the run."""
        return self._stepper(SolutionRecorder(self._problem.system, 1)).start(float(self._h[0]))

    def part(self, node: State, first: int, last: int) -> tuple[Solution, State]:
        """Integrate the steps from time point `first` to `last` from the state `node`."""
        begin, end = first // self.degree, last // self.degree
        recorder = SolutionRecorder(self._problem.system, last - first + 1, self.degree)
        t, q, v, a, lam = (x[-1] for x in node.rows)
        recorder.record(float(t), q, v, a, lam, ())
        plan = StepPlan(self._h[:end], self._ends[1 : end + 1])
        begun = Reached(begin, float(t), node.h, node)
        stepper = self._stepper(recorder)
        run, reached = march(stepper, plan, recorder, float(self._ends[end]), False, [begun])
        self.taken += reached.n - begin
        run = replace(run, outcome=replace(run.outcome, step=reached.n))
        if self._contacts:
            run = with_contacts(run, self._contacts, last == len(self.t) - 1)
        return run, reached.now

    def pull_back(
        self, run: Solution, node: State, first: int, seeds: Seeds, on: Array
    ) -> tuple[Array, Array]:
        """Run one part of the backward pass; see `linear_passes.pull_back`."""
        begin = first // self.degree
        h = self._h[begin : begin + len(run.t) // self.degree]
        return linear_passes.pull_back(self._problem, run, h, seeds, on)

    def close(self, on: Array, seeds: Seeds, gradient: Array) -> Array:
        """Return the gradient with the part that acts through the start of the run."""
        return linear_passes.through_start(self._problem, on, seeds, gradient)

    def no_covectors(self) -> Array:
        """Return zero adjoint vectors of q and v, shape (2, n_q)."""
        return np.zeros((2, self._problem.system.n_q))

    def _stepper(self, recorder: SolutionRecorder) -> RadauStepper:
        return RadauStepper(self._problem, self._newton, (), recorder)


# The estimate of a step falls with h^4, the error of the run with h^5: its power 5/4.
_SHARE, _POWER = 0.05, 4 / 5


@final
@dataclass(frozen=True, init=False)
class Radau(SteppedIntegrator, PartwiseIntegrator):
    """Radau IIA with three stages at a fixed step, or with error control; for stiff damped scenes.

    The order in q, v, a, lam and their design derivatives is 5 at the ends of steps, 4 at the
    stages within. A solution also contains the stages: four time points from the start of a step to
    its end. For motions much faster than the step the order falls (docs/theory/14-radau.md). A step
    costs several times a step of `HHT`. Exactly one of `steps`, `step` and `rtol` is given.

    Parameters
    ----------
    steps : StepControl or float
        `FixedSteps`, `AdaptiveSteps` or `PrescribedSteps`; a number is the step of `FixedSteps`, s.
    newton_tolerance : float, optional
        Largest last correction relative to the motion, as in `HHT`; dimensionless.
    max_iterations : int
        Newton iterations of a step before it is rejected.
    step : float, optional
        Short for ``steps=FixedSteps(step)``; s.
    rtol : float, optional
        Relative error per step, dimensionless; short for ``steps=AdaptiveSteps(rtol)``.

    Raises
    ------
    InvalidInputError
        If a setting is out of range.
    """

    order: ClassVar[int | None] = 5
    degree: ClassVar[int] = 3

    steps: StepControl
    newton_tolerance: float
    max_iterations: int = 15

    def __init__(
        self,
        steps: StepControl | float | None = None,
        newton_tolerance: float | None = None,
        max_iterations: int = 15,
        *,
        step: float | None = None,
        rtol: float | None = None,
    ) -> None:
        newton = EXACT if newton_tolerance is None else newton_tolerance
        self._set(steps, step, rtol, newton, max_iterations)

    def _stepper(
        self, problem: InitialValueProblem, t_end: float, sizes_b: Array, recorder: SolutionRecorder
    ) -> RadauStepper:
        newton = self.newton_tolerance, self.max_iterations
        tolerances = []
        for sizes in (problem.scales.q, problem.scales.v):
            tolerance = self.steps.tolerance(t_end, sizes, sizes_b)
            if tolerance is not None:
                rtol, atol = (_SHARE * x**_POWER for x in (tolerance.rtol, tolerance.atol))
                tolerances.append(replace(tolerance, rtol=rtol, atol=atol))
        return RadauStepper(problem, newton, tuple(tolerances), recorder)

    def _state_after(self, run: Solution, steps: int) -> State:
        last = slice(3 * steps - 3, 3 * steps + 1)
        rows = tuple(x[last] for x in (run.t, run.q, run.v, run.a, run.lam))
        return State(float(self.sizes(run)[steps - 1]), rows)

    def _derivatives(
        self, problem: InitialValueProblem, run: Solution, progress: bool
    ) -> tuple[list[Array], Verdict]:
        return linear_passes.differentiate(problem, run, self.sizes(run), progress)

    def pull_back(
        self, system: MechanicalSystem, solution: Solution, seeds: Seeds, progress: bool = False
    ) -> Array:
        """Return the gradient of an objective, (n_b,), by the discrete adjoint."""
        problem = InitialValueProblem.of(system, float(solution.t[-1]) or 1.0, solution.q)
        on, h = np.zeros((2, system.n_q)), self.sizes(solution)
        gradient, on = linear_passes.pull_back(problem, solution, h, seeds, on, progress)
        return linear_passes.through_start(problem, on, seeds, gradient)

    def replay(self, system: MechanicalSystem, t_end: float) -> RadauReplay:
        """Return the run to `t_end` (s) in parts; its steps must be known in advance."""
        ends = self._known_instants(t_end)
        newton = self.newton_tolerance, self.max_iterations
        problem = InitialValueProblem.of(system.in_all_states(), t_end)
        return RadauReplay(problem, self.steps.sizes(ends), ends, newton)
