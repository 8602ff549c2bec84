"""Base class of the one-step integrators HHT and Radau, whose steps a `StepControl` chooses."""

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
from ancfdae.integrators.integrator import AdjointIntegrator, with_contacts
from ancfdae.integrators.problem import InitialValueProblem, Scales
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control import (
    AdaptiveSteps,
    FixedSteps,
    PrescribedSteps,
    StepControl,
)
from ancfdae.integrators.step_control.contracts import (
    BACK,
    NOWHERE,
    OneStepMethod,
    Reached,
    march,
    with_own_sizes,
)
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.threads import in_one_thread

# Default tolerance of Newton's method, as a fraction of the relative error tolerance of a step.
_SHARE = 1e-3
# Largest default tolerance of Newton's method. The remaining residual force disturbs stiff damped
# beams far more than its size suggests (measured at rtol 1e-3, E = 2e11 Pa: states wrong by 43
# times rtol with 1e-6, by one with 1e-9, for a tenth more time).
_LOOSEST = 1e-9
# Largest tolerance that a user may give: above it Newton's method would accept its first guess.
_LARGEST = 0.1
EXACT = 1e-14

# How often the reach of contact loads is doubled until a pair is found.
_DOUBLINGS = 64
# A list of neighbours that serves fewer steps than this is followed by one of a longer reach.
_SERVED = 4


class SteppedIntegrator(AdjointIntegrator):
    """An integrator under a `StepControl`: its forward runs, with and without derivatives.

    A solution has `degree` time points per step, between which the motion is interpolated by a
    polynomial of this degree.
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
        """Validate and store the settings that HHT and Radau share."""
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
        """Whether `resume` can add derivatives to a run: not if they control its steps."""
        return not (isinstance(self.steps, AdaptiveSteps) and self.steps.sensitivities)

    @abc.abstractmethod
    def _stepper(
        self, problem: InitialValueProblem, t_end: float, sizes_b: Array, recorder: SolutionRecorder
    ) -> OneStepMethod[Any]:
        """Return the one-step method of a run; `sizes_b` are sizes of the design derivatives."""

    @abc.abstractmethod
    def _state_after(self, run: Solution, steps: int) -> Any:
        """Return the internal state of the method after some steps of a run, at least one."""

    @abc.abstractmethod
    def _derivatives(
        self, problem: InitialValueProblem, run: Solution, progress: bool
    ) -> tuple[list[Array], Verdict]:
        """Return q_b, v_b, a_b and lam_b of a run of at least one step, and how the pass ended."""

    def _estimated(self, solution: Solution, scales: Scales) -> Solution:
        """Return the solution with estimates of its errors if the method has such estimates."""
        return solution

    def back_factorisations(self, solution: Solution) -> int:
        """Return the number of steps of the run: `pull_back` factorises one matrix for each."""
        return solution.statistics.steps

    @final
    def sizes(self, solution: Solution) -> Array:
        """Return the step sizes of a run of this integrator, shape (n,); s."""
        return self.steps.sizes(solution.t[:: self.degree])

    @final
    def _known_instants(self, t_end: float) -> Array:
        """Return the end times of all steps of a run to `t_end`, s.

        Raise InvalidInputError if the steps are not known in advance.
        """
        if isinstance(self.steps, FixedSteps | PrescribedSteps):
            return self.steps.instants(t_end)
        name, rule = type(self).__name__, "needs steps that are known before the run"
        repair = f"Repeat the steps of a run: {name}.frozen(simulate(...))."
        raise InvalidInputError(f"{name}.steps", rule, repr(self.steps), repair)

    def frozen(self, solution: Solution) -> Self:
        """Return the integrator that repeats the steps of `solution` at any design.

        Steps under error control jump with the design, so the run as a function of the design has
        no derivative. Every sensitivity method differentiates it at the steps as they were taken.
        """
        steps = self.steps.frozen(solution.t[:: self.degree])
        return self if steps is self.steps else self._changed(steps=steps)

    @final
    def with_steps(self, steps: StepControl) -> Self:
        """Return the same integrator under another control of its steps."""
        return self._changed(steps=steps)

    def refined(self, solution: Solution) -> Self:
        """Return the integrator that halves every step of `solution`."""
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
        """Integrate the motion from t = 0 to `t_end` (s), where prescribed steps must end."""
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
        steps.count(t_end)  # Refuses an end that the steps do not reach, before anything else.
        along = self._derivatives_along(system)
        # Such a run cannot be continued with other neighbours.
        system = system.in_all_states() if along else system
        problem = InitialValueProblem.of(system, t_end, None if after is None else after.q[-1:])
        problem = problem.differentiated() if along else problem
        scales = problem.scales
        if after is not None:
            problem.require_run(after, t_end, "after")
            # HHT and Radau have the same controllers, but not the same time points per step.
            alike = after.degree == self.degree
            if not alike or not steps.continues(after.t[:: self.degree], after.control, t_end):
                rule = "must be a run of the same integrator under the same steps"
                repair = "Pass its own integrator, and an end after whole steps of it."
                raise InvalidInputError("after", rule, repr(self.steps), repair)
            after = after if len(after.t) > 1 else None

        def run(sizes_b: Array) -> Solution:
            near, before, q, begun, wider = problem, after, np.zeros((0, system.n_q)), 0, 1.0
            short = 0
            while True:
                done, tried = self._marched(near, t_end, sizes_b, before, progress)
                if done.outcome.verdict is not Verdict.LEFT_OUT:
                    break
                # The run goes on with the pair that comes close, which may be far before its step,
                # or with the pairs along all steps that were tried from here.
                known, here = near.system, q if begun == len(done.t) else done.q[-1:]
                # A reach that is short beside the path of a step grows, faster with each list.
                short = short + 1 if len(done.t) - begun < _SERVED * self.degree else 0
                wider *= 2.0**short
                q, begun = here if tried is None else np.concatenate([here, tried]), len(done.t)
                others = (known.along(q, wider * 2.0**k) for k in range(_DOUBLINGS))
                renewed = next((other for other in others if other is not known), known)
                if renewed is known:
                    break
                near = InitialValueProblem.of(renewed, t_end, q)
                before = done if len(done.t) > 1 else None
            whole = system.along(done.q) if system.traits.leaves_out else system
            contacts = whole.contacts()
            return with_contacts(done, contacts) if contacts else done

        if not along:
            solution = run(np.zeros(0))
            if sensitivities:
                if system.traits.leaves_out:
                    problem = InitialValueProblem.of(system, t_end, solution.q)
                return self._differentiate(problem, solution, progress)
            return self._estimated(solution, scales)
        rough = self._rough().integrate(system, t_end, sensitivities=True, progress=progress)
        solution = with_own_sizes(rough, run, scales)
        # Statistics count the last run, and the time of all.
        seconds = time.perf_counter() - started
        statistics = replace(solution.statistics, wall_seconds=seconds)
        return self._estimated(replace(solution, statistics=statistics), scales)

    def _marched(
        self,
        problem: InitialValueProblem,
        t_end: float,
        sizes_b: Array,
        before: Solution | None,
        progress: bool,
    ) -> tuple[Solution, Array | None]:
        """Return the run `before`, if given, continued by steps to `t_end` or to a failure.

        After it stand coordinates of a step that was tried next over pairs that are left out.
        """
        rows, along = self.degree * self.steps.count(t_end) + 1, problem.derivative is not None
        recorder = SolutionRecorder(problem.system, rows, self.degree, along, before)
        stepper = self._stepper(problem, t_end, sizes_b, recorder)
        if before is None:
            begun = self.steps.controller(t_end, stepper)
            run, end = march(stepper, begun, recorder, t_end, progress)
            return run, end.tried
        controller = self.steps.controller(t_end, stepper, before.control)
        h, t = self.sizes(before).tolist(), before.t[:: self.degree].tolist()
        path = [
            Reached(k, t[k], h[k - 1], self._state_after(before, k)) if k else NOWHERE
            for k in range(max(len(h) - BACK, 0), len(h) + 1)
        ]
        run, end = march(stepper, controller, recorder, t_end, progress, path)
        return run, end.tried

    def _derivatives_along(self, system: MechanicalSystem) -> bool:
        """Return whether design derivatives are integrated with the motion and control steps."""
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
        """Return the integrator of the rough run that gives the sizes of the design derivatives."""
        assert isinstance(self.steps, AdaptiveSteps)
        # The residual force that Newton's method leaves must not be taken for the derivative in a
        # variable that scales masses and forces alike.
        return self._changed(steps=self.steps.rough(), newton_tolerance=EXACT)

    def _changed(self, **changes: Any) -> Self:
        """Return a copy with some settings changed; warnings about settings are not repeated."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StabilityWarning)
            settings: Any = self  # Every kind is a frozen dataclass.
            changed: Self = replace(settings, **changes)
            return changed

    def differentiate(self, system: MechanicalSystem, solution: Solution) -> Solution:
        """Return `solution`, a run of this integrator, with its design derivatives (eqs. 22-25).

        If a matrix is singular or the pass is interrupted, the solution is cut after the last state
        that has derivatives, and its outcome says so.
        """
        return self._differentiate(
            InitialValueProblem.of(system, float(solution.t[-1]) or 1.0, solution.q), solution
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
    """Return the step control from exactly one of `steps`, `step` (s) and `rtol`."""
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
