"""Integrators that take one step after another under a control of the step."""

import abc
import time
import warnings
from dataclasses import replace
from typing import Any, ClassVar, Self, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import Sensitivities
from ancfdae.errors.checks import require_count, require_positive
from ancfdae.errors.kinds import InvalidInputError, StabilityWarning
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.integrator import AdjointIntegrator
from ancfdae.integrators.missed_contacts import with_contacts
from ancfdae.integrators.problem import InitialValueProblem, Scales
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control import (
    AdaptiveSteps,
    FixedSteps,
    PrescribedSteps,
    StepControl,
)
from ancfdae.integrators.step_control.contracts import OneStepMethod, Reached, march, with_own_sizes
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.threads import in_one_thread

# Newton's method stops well below the error of a step.
_SHARE = 1e-3
# What is left of the forces disturbs stiff damped beams far more than its size says (measured at
# rtol 1e-3, E = 2e11 Pa: states wrong by 43 times rtol with 1e-6, by one with 1e-9, for a tenth
# more time).
_LOOSEST = 1e-9
# Of what a user asks for: above it Newton's method would accept its first guess.
_LARGEST = 0.1
EXACT = 1e-14


class SteppedIntegrator(AdjointIntegrator):
    """An integrator under `StepControl`: its runs, forward and with derivatives.

    Solutions have `degree` instants for each step, and the polynomials between them its degree.
    """

    checks_contacts: ClassVar[bool] = True
    degree: ClassVar[int] = 1

    steps: StepControl
    newton_tolerance: float
    max_iterations: int

    @final
    def _set(
        self,
        steps: StepControl | float | None,
        step: float | None,
        rtol: float | None,
        newton_tolerance: float | None,
        max_iterations: int,
    ) -> None:
        """Validate and set what all have."""
        name = type(self).__name__
        control = _control(name, steps, step, rtol)
        if newton_tolerance is None:
            asked = _SHARE * control.rtol if isinstance(control, AdaptiveSteps) else EXACT
            newton_tolerance = max(EXACT, min(asked, _LOOSEST))
        require_positive(f"{name}.newton_tolerance", newton_tolerance)
        if newton_tolerance > _LARGEST:
            rule = f"must be at most {_LARGEST}, a part of the motion"
            repair = f"Leave it out, or take {EXACT}."
            raise InvalidInputError(f"{name}.newton_tolerance", rule, newton_tolerance, repair)
        require_count(f"{name}.max_iterations", max_iterations, "15 is plenty.")
        # A NumPy number of single precision would spread its precision.
        object.__setattr__(self, "steps", control)
        object.__setattr__(self, "newton_tolerance", float(newton_tolerance))
        object.__setattr__(self, "max_iterations", max_iterations)

    @property
    def differentiates_runs(self) -> bool:
        """Not where derivatives are controlled along with the motion."""
        return not (isinstance(self.steps, AdaptiveSteps) and self.steps.sensitivities)

    @abc.abstractmethod
    def _stepper(
        self, problem: InitialValueProblem, t_end: float, sizes_b: Array, recorder: SolutionRecorder
    ) -> OneStepMethod[Any]:
        """Return the one-step method of a run; `sizes` are the sizes of the derivatives."""

    @abc.abstractmethod
    def _state_after(self, run: Solution) -> Any:
        """Return the state of the method after a run of one step at least."""

    @abc.abstractmethod
    def _derivatives(
        self, problem: InitialValueProblem, run: Solution, progress: bool
    ) -> tuple[list[Array], Verdict]:
        """Return q_b, v_b, a_b and lam_b of a run of one step at least, and how the pass ended."""

    def _estimated(self, solution: Solution, scales: Scales) -> Solution:
        """Return the solution with estimates of its errors, if there are any."""
        return solution

    def back_factorisations(self, solution: Solution) -> int:
        """Return the steps: one matrix each."""
        return solution.statistics.steps

    @final
    def sizes(self, solution: Solution) -> Array:
        """Return the step sizes of a run of this integrator, shape (n,); s."""
        return self.steps.sizes(solution.t[:: self.degree])

    @final
    def _known_instants(self, t_end: float) -> Array:
        """Return the ends of all steps of a run; refuse steps that are not known before."""
        if isinstance(self.steps, FixedSteps | PrescribedSteps):
            return self.steps.instants(t_end)
        name, rule = type(self).__name__, "needs steps that are known before the run"
        repair = f"Repeat the steps of a run: {name}.frozen(simulate(...))."
        raise InvalidInputError(f"{name}.steps", rule, repr(self.steps), repair)

    def frozen(self, solution: Solution) -> Self:
        """Return the integrator that repeats the steps of a run, whatever the design.

        Steps under error control jump with the design, so no derivative of the run exists. Every
        method differentiates it at the steps as they were taken.
        """
        steps = self.steps.frozen(solution.t[:: self.degree])
        return self if steps is self.steps else self._changed(steps=steps)

    @final
    def with_steps(self, steps: StepControl) -> Self:
        """Return the same integrator under another control of its steps."""
        return self._changed(steps=steps)

    def refined(self, solution: Solution) -> Self:
        """Return the integrator that halves every step of a run."""
        steps, tolerance = self.steps.refined(solution.t[:: self.degree]), self.newton_tolerance
        if not isinstance(steps, FixedSteps):
            tolerance = max(EXACT, tolerance / 4)
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
        """Return the run `after` continued to `t_end`; see `Integrator.resume`."""
        if self._derivatives_along(system):
            rule = "a run that controls the error of its derivatives cannot be continued"
            repair = "Run again from t = 0."
            raise InvalidInputError("after", rule, repr(self.steps), repair)
        return self._integrate(system, t_end, after, sensitivities, progress)

    @in_one_thread
    def _integrate(
        self,
        system: MechanicalSystem,
        t_end: float,
        after: Solution | None,
        sensitivities: bool,
        progress: bool,
    ) -> Solution:
        steps, started = self.steps, time.perf_counter()
        rows, along = self.degree * steps.count(t_end) + 1, self._derivatives_along(system)
        problem = InitialValueProblem.of(system, t_end)
        problem = problem.differentiated() if along else problem
        scales = problem.scales
        if after is not None:
            problem.require_run(after, t_end, "after")
            if not steps.continues(after.t[:: self.degree], after.control, t_end):
                rule = "must be a run under the same steps"
                repair = "Pass its own integrator, and an end after whole steps of it."
                raise InvalidInputError("after", rule, repr(self.steps), repair)
            after = after if len(after.t) > 1 else None

        def run(sizes_b: Array) -> Solution:
            recorder = SolutionRecorder(system, rows, self.degree, along, after)
            stepper, contacts = self._stepper(problem, t_end, sizes_b, recorder), system.contacts()
            if after is None:
                begun = steps.controller(t_end, stepper)
                done = march(stepper, begun, recorder, t_end, progress)[0]
            else:
                controller = steps.controller(t_end, stepper, after.control)
                taken, state = self.sizes(after), self._state_after(after)
                reached = Reached(len(taken), float(after.t[-1]), float(taken[-1]), state)
                done = march(stepper, controller, recorder, t_end, progress, reached)[0]
            return with_contacts(done, contacts) if contacts else done

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
            raise InvalidInputError(
                "AdaptiveSteps.sensitivities",
                "needs real design values",
                "complex ones",
                "Repeat the steps of a run at real values: HHT(...).frozen(solution).",
            )
        return system.n_b > 0

    def _rough(self) -> Self:
        """Return the integrator of the run from which the sizes of the derivatives are read."""
        assert isinstance(self.steps, AdaptiveSteps)
        # What Newton's method leaves of the forces must not pass for the derivative in a variable
        # that scales masses and forces alike.
        return self._changed(steps=self.steps.rough(), newton_tolerance=EXACT)

    def _changed(self, **changes: Any) -> Self:
        """Return a copy with other settings, without repeating their warnings."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StabilityWarning)
            settings: Any = self  # Every kind is a frozen dataclass.
            changed: Self = replace(settings, **changes)
            return changed

    def differentiate(self, system: MechanicalSystem, solution: Solution) -> Solution:
        """Add the design derivatives of a run of this integrator (eqs. 22-25).

        If a matrix is singular or the pass is interrupted, the solution is cut after the last state
        that has derivatives, and its outcome says so.
        """
        return self._differentiate(
            InitialValueProblem.of(system, float(solution.t[-1]) or 1.0), solution
        )

    @in_one_thread
    def _differentiate(
        self, problem: InitialValueProblem, solution: Solution, progress: bool = False
    ) -> Solution:
        started, system = time.perf_counter(), problem.system
        problem = problem.differentiated()
        # A run that ended in its first step has the derivatives of its start.
        arrays, verdict = [x[None] for x in problem.derivative or ()], Verdict.FINISHED
        if len(solution.t) > 1:
            arrays, verdict = self._derivatives(problem, solution, progress)
        sensitivities = Sensitivities(system.design_names, system.b, *arrays)
        seconds = time.perf_counter() - started
        full = solution.with_sensitivities(sensitivities, verdict, seconds)
        return self._estimated(full, problem.scales)


def _control(
    name: str, steps: StepControl | float | None, step: float | None, rtol: float | None
) -> StepControl:
    """Return the control of the step, given in full or in short."""
    given: list[Any] = [x for x in (steps, step, rtol) if x is not None]
    if len(given) != 1:
        raise InvalidInputError(
            name,
            "needs exactly one of steps, step and rtol",
            f"{len(given)} of them",
            f"For example {name}(step=0.01), or {name}(rtol=1e-5) for error control.",
        )
    if isinstance(steps, StepControl):
        return steps
    try:
        return FixedSteps(given[0]) if rtol is None else AdaptiveSteps(rtol)
    except InvalidInputError as error:
        # The user wrote the short form.
        where = f"{name}.step" if rtol is None else f"{name}.rtol"
        raise InvalidInputError(where, error.rule, error.got, error.repair) from None
