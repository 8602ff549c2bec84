"""HHT-I3 (eqs. 2-6, Fig. 1), with any control of its steps."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, replace
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import Sensitivities
from ancfdae.errors import (
    InvalidInput,
    StabilityWarning,
    Verdict,
    require_count,
    require_positive,
)
from ancfdae.integrators.hht import linear_passes
from ancfdae.integrators.hht.defects import Defects
from ancfdae.integrators.hht.equations import Coefficients, Steps, constraint_error, require_alpha
from ancfdae.integrators.hht.replay import Replay, through_start
from ancfdae.integrators.hht.small_steps import Nodes, node_after
from ancfdae.integrators.hht.start import RecurrenceStart
from ancfdae.integrators.hht.step import Stepper
from ancfdae.integrators.integrator import DefectIntegrator, PartwiseIntegrator, Seeds
from ancfdae.integrators.problem import Problem, Scales
from ancfdae.integrators.recorder import Recorder
from ancfdae.integrators.step_control import ControlledSteps, FixedSteps, GivenSteps, StepControl
from ancfdae.integrators.step_control.derivative_sizes import with_own_sizes
from ancfdae.integrators.step_control.march import Reached, march
from ancfdae.integrators.step_control.tolerance import estimated_errors
from ancfdae.numerics.arrays import Array

# Newton's method stops well below the error of a step.
_SHARE = 1e-3
# What is left of the forces disturbs stiff damped beams far more than its size says (measured at
# rtol 1e-3, E = 2e11 Pa: states wrong by 43 times rtol with 1e-6, by one with 1e-9, for a tenth
# more time).
_LOOSEST = 1e-9
_EXACT = 1e-14


@final
@dataclass(frozen=True, init=False)
class HHT(DefectIntegrator, PartwiseIntegrator):
    """HHT-I3 (Negrut, Rampalli, Ottarsson & Sajdak 2007) at a fixed step, or with error control.

    Exactly one of `steps`, `step` and `rtol` is given.

    Parameters
    ----------
    steps : StepControl or float
        `FixedSteps`, `ControlledSteps` or `GivenSteps`; a number is the step of `FixedSteps`.
    hht_alpha : float
        Numerical damping, in [-1/3, 0]. Second order throughout; -1/3 damps frequencies above
        1/h most. At 0 the multipliers oscillate and do not converge, and a warning is given.
    newton_tolerance : float, optional
        Estimated error of a and lam after the last iteration, relative to the forces of the
        motion; free of units. By default 1e-14, with error control rtol/1000 but at most 1e-9.
    max_iterations : int
        Newton iterations of a step before it is tried by way of shorter ones (at fixed and given
        steps, in ten times as many), or given up.
    step : float, optional
        Short for ``steps=FixedSteps(step)``; s.
    rtol : float, optional
        Short for ``steps=ControlledSteps(rtol)``.

    Raises
    ------
    InvalidInput
        If a setting is out of range.
    """

    order: ClassVar[int | None] = 2

    steps: StepControl
    newton_tolerance: float
    hht_alpha: float = -0.3
    max_iterations: int = 15

    def __init__(
        self,
        steps: StepControl | float | None = None,
        hht_alpha: float = -0.3,
        newton_tolerance: float | None = None,
        max_iterations: int = 15,
        *,
        step: float | None = None,
        rtol: float | None = None,
    ) -> None:
        control = _control(steps, step, rtol)
        require_alpha("HHT.hht_alpha", hht_alpha)
        if newton_tolerance is None:
            asked = _SHARE * control.rtol if isinstance(control, ControlledSteps) else _EXACT
            newton_tolerance = max(_EXACT, min(asked, _LOOSEST))
        require_positive("HHT.newton_tolerance", newton_tolerance)
        require_count("HHT.max_iterations", max_iterations, "15 is plenty.")
        # A NumPy number of single precision would spread its precision.
        object.__setattr__(self, "steps", control)
        object.__setattr__(self, "hht_alpha", float(hht_alpha))
        object.__setattr__(self, "newton_tolerance", float(newton_tolerance))
        object.__setattr__(self, "max_iterations", max_iterations)
        if hht_alpha == 0:
            warnings.warn(
                "HHT.hht_alpha = 0 leaves errors of the multipliers undamped: they oscillate and "
                "grow with the number of steps. Use a negative value, such as -0.05.",
                StabilityWarning,
                stacklevel=2,
            )

    @property
    def differentiates_runs(self) -> bool:
        """Not where derivatives are controlled along with the motion."""
        return not (isinstance(self.steps, ControlledSteps) and self.steps.sensitivities)

    def frozen(self, solution: Solution) -> HHT:
        """Return the integrator that repeats the steps of a run, whatever the design.

        Steps under error control jump with the design, so no derivative of the run exists. Every
        method differentiates it at the steps as they were taken.
        """
        steps = self.steps.frozen(solution.t)
        return self if steps is self.steps else self._changed(steps=steps)

    def refined(self, solution: Solution) -> HHT:
        """Return the integrator that halves every step of a run."""
        steps, tolerance = self.steps.refined(solution.t), self.newton_tolerance
        if not isinstance(steps, FixedSteps):
            tolerance = max(_EXACT, tolerance / 4)
        return self._changed(steps=steps, newton_tolerance=tolerance)

    def integrate(
        self,
        system: MechanicalSystem,
        t_end: float,
        *,
        sensitivities: bool = False,
        progress: bool = False,
    ) -> Solution:
        """Integrate from t = 0 to `t_end`, where given steps must end."""
        return self._integrate(system, t_end, None, sensitivities, progress)

    def resume(
        self,
        system: MechanicalSystem,
        t_end: float,
        after: Solution,
        *,
        sensitivities: bool = False,
        progress: bool = False,
    ) -> Solution:
        """Go on with a run; as `Integrator.resume`."""
        if self._derivatives_along(system):
            rule, repair = "cannot go on with derivatives along", "Run again from t = 0."
            raise InvalidInput("after", rule, repr(self.steps), repair)
        return self._integrate(system, t_end, after, sensitivities, progress)

    def _integrate(
        self,
        system: MechanicalSystem,
        t_end: float,
        after: Solution | None,
        sensitivities: bool,
        progress: bool,
    ) -> Solution:
        steps, started = self.steps, time.perf_counter()
        rows, along = steps.count(t_end) + 1, self._derivatives_along(system)
        problem = Problem.of(system, t_end)
        problem = problem.differentiated() if along else problem
        scales = problem.scales
        if after is not None:
            problem.require_run(after, t_end, "after")
            if not steps.continues(after.t, after.control, t_end):
                rule = "must be a run under the same steps"
                repair = "Pass its own integrator, and an end after whole steps of it."
                raise InvalidInput("after", rule, repr(self.steps), repair)
            after = after if len(after.t) > 1 else None

        def run(sizes_b: Array) -> Solution:
            recorder = Recorder(system, rows, sensitivities=along, before=after)
            newton = self.newton_tolerance, self.max_iterations
            tolerance = steps.tolerance(t_end, scales.q, sizes_b)
            stepper = Stepper(problem, self.hht_alpha, newton, tolerance, recorder)
            if after is None:
                begun = steps.controller(t_end, stepper)
                return march(stepper, begun, recorder, t_end, progress)[0]
            controller, n = steps.controller(t_end, stepper, after.control), len(after.t) - 1
            taken = self.steps_of(after)
            node = node_after(after, n, self.hht_alpha)
            reached = Reached(n, node.t, float(taken.h[-1]), (node, None))
            return march(stepper, controller, recorder, t_end, progress, reached)[0]

        if not along:
            solution = run(np.zeros(0))
            if sensitivities:
                return self._differentiate(problem, solution, progress)
            return self._estimated(solution, scales)
        rough = self._rough().integrate(system, t_end, sensitivities=True, progress=progress)
        solution = with_own_sizes(rough, run, scales)
        # Statistics count the last run, and the time of all.
        seconds = time.perf_counter() - started
        statistics = replace(solution.statistics, wall_seconds=seconds)
        return self._estimated(replace(solution, statistics=statistics), scales)

    def _derivatives_along(self, system: MechanicalSystem) -> bool:
        """Whether derivatives are integrated with the motion and controlled."""
        if self.differentiates_runs:
            return False
        if np.iscomplexobj(system.b):
            raise InvalidInput(
                "ControlledSteps.sensitivities",
                "computes derivatives in real numbers",
                "a complex system",
                "Repeat the steps of a run at real values: HHT.frozen.",
            )
        return system.n_b > 0

    def _estimated(self, solution: Solution, scales: Scales) -> Solution:
        """Return the solution with estimates of its errors.

        The accelerations at the instants serve as those of the recurrence.
        """
        scale = constraint_error(Coefficients(1.0, self.hht_alpha)) * np.diff(solution.t) ** 2
        with np.errstate(over="ignore", invalid="ignore"):
            rise = np.diff(solution.a.real, axis=0)
        found = estimated_errors(scales, scale, rise, solution.sensitivities)
        return replace(solution, estimated_errors=found)

    def _rough(self) -> HHT:
        """Return the integrator of the run from which the sizes of the derivatives are read."""
        assert isinstance(self.steps, ControlledSteps)
        # What Newton's method leaves of the forces must not pass for the derivative in a variable
        # that scales masses and forces alike.
        return self._changed(steps=self.steps.rough(), newton_tolerance=_EXACT)

    def _changed(self, **changes: Any) -> HHT:
        """Return a copy with other settings, without repeating their warnings."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StabilityWarning)
            return replace(self, **changes)

    def differentiate(self, system: MechanicalSystem, solution: Solution) -> Solution:
        """Add the design derivatives of a run of this integrator (eqs. 22-25).

        If a matrix is singular or the pass is interrupted, the solution is cut to what has
        derivatives and its outcome says so.
        """
        return self._differentiate(Problem.of(system, float(solution.t[-1]) or 1.0), solution)

    def _differentiate(
        self, problem: Problem, solution: Solution, progress: bool = False
    ) -> Solution:
        started, steps = time.perf_counter(), self.steps_of(solution)
        system, derivative = problem.system, problem.differentiated().derivative
        assert derivative is not None
        # A run that ended in its first step has the derivatives of its start.
        arrays, verdict = [x[None] for x in derivative], Verdict.FINISHED
        if len(steps.h):
            first = RecurrenceStart.of(problem, steps.first)
            nodes = Nodes(problem, solution, steps, first.node)
            begun = first.sensitivity(derivative)
            arrays, verdict = linear_passes.differentiate(nodes, begun, progress)
            arrays[1][0] = derivative.v_b  # A solution reports the consistent start.
        own = Sensitivities(system.design_names, system.b, *arrays)
        seconds = time.perf_counter() - started
        full = solution.with_sensitivities(own, verdict, len(arrays[0]) - 1, seconds)
        return self._estimated(full, problem.scales)

    def pull_back(
        self, system: MechanicalSystem, solution: Solution, seeds: Seeds, progress: bool = False
    ) -> Array:
        """Return the gradient of an objective by the discrete adjoint."""
        first, nodes = self._opened(system, solution)
        gradient, back, _ = linear_passes.pull_back(nodes, seeds, progress=progress)
        return through_start(nodes.problem, first, back, seeds, gradient)

    def back_factorisations(self, solution: Solution) -> int:
        """Return the steps: one matrix each."""
        return solution.statistics.steps

    def replay(self, system: MechanicalSystem, t_end: float) -> Replay:
        """Return the run to `t_end` part by part; its steps must be known before."""
        if not isinstance(self.steps, FixedSteps | GivenSteps):
            rule = "needs steps that are known before the run"
            repair = "Repeat the steps of a run: HHT.frozen(simulate(...))."
            raise InvalidInput("HHT.steps", rule, repr(self.steps), repair)
        t = self.steps.instants(t_end)
        newton = self.newton_tolerance, self.max_iterations
        steps = Steps(self.steps.sizes(t), self.hht_alpha)
        return Replay(Problem.of(system, t_end), steps, t, newton)

    def discretisation_error(
        self, system: MechanicalSystem, solution: Solution, seeds: Seeds
    ) -> float:
        """Return what an objective would change without the defects; `Defects` has them."""
        first, nodes = self._opened(system, solution)
        defects = Defects.of(solution.t, solution.a, nodes.steps)
        _, back, change = linear_passes.pull_back(nodes, seeds, defects)
        return change - float(back.v_b @ first.dv)

    def _opened(
        self, system: MechanicalSystem, solution: Solution
    ) -> tuple[RecurrenceStart, Nodes]:
        """Return what a pass over a run begins with."""
        # The length of a run of one instant scales nothing.
        steps, problem = self.steps_of(solution), Problem.of(system, float(solution.t[-1]) or 1.0)
        first = RecurrenceStart.of(problem, steps.first)
        return first, Nodes(problem, solution, steps, first.node)

    def steps_of(self, solution: Solution) -> Steps:
        """Return the steps of a run of this integrator."""
        return Steps(self.steps.sizes(solution.t), self.hht_alpha)


def _control(
    steps: StepControl | float | None, step: float | None, rtol: float | None
) -> StepControl:
    """Return the control of the step, given in full or in short."""
    given: list[Any] = [x for x in (steps, step, rtol) if x is not None]
    if len(given) != 1:
        raise InvalidInput(
            "HHT",
            "needs exactly one of steps, step and rtol",
            f"{len(given)} of them",
            "For example HHT(step=0.01), or HHT(rtol=1e-5) for error control.",
        )
    if isinstance(steps, StepControl):
        return steps
    try:
        return FixedSteps(given[0]) if rtol is None else ControlledSteps(rtol)
    except InvalidInput as error:
        # The user wrote the short form.
        where = "HHT.step" if rtol is None else "HHT.rtol"
        raise InvalidInput(where, error.rule, error.got, error.repair) from None
