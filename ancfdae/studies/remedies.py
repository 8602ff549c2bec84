"""Trials after a run has stopped, so that its outcome names a setting that reaches the end.

A fixed step may be too long for undamped elastic waves: they grow until no solution of the next
step continues the motion. Shorter steps, and the same step with damping, are tried over the whole
motion. After a step that ended on another branch of the joints shorter steps are tried, too, and
then error control. Only settings that were tried are named, and no trial replaces the run.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from ancfdae.assembly.system import assemble
from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.errors.kinds import AncfdaeError, ManyStepsWarning
from ancfdae.errors.outcomes import Interrupted, Verdict
from ancfdae.integrators.step_control import AdaptiveSteps, FixedSteps, StepControl
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.model.material import Material
from ancfdae.model.scene import Scene
from ancfdae.numerics.timing import stopwatch
from ancfdae.sensitivity.method import Run

# Relative tolerances of error-controlled runs that are tried.
_RTOL = (1e-3, 1e-5)
# Processor time of an error-controlled step over a fixed step (0.7 ms, 30 us).
_DEARER = 25
# Number of halvings of the step that are tried.
_HALVINGS = 4
# Largest number of steps times coordinates and multipliers of all trials together: some seconds (4
# us and 0.7 us for each coordinate, docs/measurements.md). A message should not take longer than
# the run.
_MOST = 2e6
# Largest processor time of all trials, s. Runs that follow prescribed motions between their steps
# cost more than the numbers of steps and unknowns predict.
_SECONDS = 5.0


def with_remedies(model: Scene | MechanicalSystem, run: Run, solution: Solution) -> Solution:
    """Return a run; if it stopped at a fixed step, its outcome names the trials made then.

    Raises Interrupted with the run if Ctrl-C ends a trial.
    """
    integrator, outcome = run.integrator, solution.outcome
    if not (isinstance(integrator, SteppedIntegrator) and isinstance(integrator.steps, FixedSteps)):
        return solution
    if outcome.verdict not in (Verdict.NO_CONVERGENCE, Verdict.OFF_ROOT, Verdict.FOLDED):
        return solution
    budget = _Budget(run, solution, integrator)
    others = _controlled(budget) if outcome.verdict is Verdict.OFF_ROOT else _damped(budget, model)
    words = outcome.advice, *_shorter(budget), *others
    return replace(solution, outcome=replace(outcome, advice=" ".join(filter(None, words))))


class _Budget:
    """Trials to reach the end of a run that stopped, within limits of their cost."""

    def __init__(self, run: Run, solution: Solution, integrator: SteppedIntegrator) -> None:
        assert isinstance(integrator.steps, FixedSteps)
        self.step, self._integrator = integrator.steps.step, integrator
        self._run, self._stopped, self._left = run, solution, _MOST
        self._spent, self._longest = stopwatch(), 0.0

    def reaches_end(self, system: MechanicalSystem | None, step: float) -> bool | None:
        """Return whether a trial with `step` reaches the end; None if it would cost too much.

        `system` is by default the system of the run.
        """
        system = self._run.system if system is None else system
        self._left -= math.ceil(self._run.t_end / step) * (system.n_q + system.n_lam)
        # A step of half the length reaches twice as far in twice as many steps.
        late = self._spent() + 4 * self._longest > _SECONDS
        return None if self._left < 0 or late else self._ends(system, FixedSteps(step))

    def reaches_end_with(self, rtol: float) -> bool:
        """Return whether an error-controlled run reaches the end in the number of steps left."""
        system = self._run.system
        most = self._left / (system.n_q + system.n_lam) / _DEARER
        return most >= 1 and self._ends(system, AdaptiveSteps(rtol, max_steps=int(most)))

    def _ends(self, system: MechanicalSystem, steps: StepControl) -> bool:
        integrator, spent = self._integrator.with_steps(steps), stopwatch()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ManyStepsWarning)
            outcome = integrator.integrate(system, self._run.t_end).outcome
        self._longest = max(self._longest, spent())
        if outcome.verdict is Verdict.INTERRUPTED:
            raise Interrupted(self._stopped, str(self._stopped.outcome))
        return outcome.success

    def call(self, step: float, name: str = "step") -> str:
        """Return the integrator with another step or setting, written as a call."""
        return f"{type(self._integrator).__name__}({name}={step:.3g})"


def _shorter(budget: _Budget) -> Iterator[str]:
    """Yield which shorter step reached the end, or that none of the steps tried did."""
    stopped = list[str]()
    for k in range(1, _HALVINGS + 1):
        step = float(f"{budget.step / 2**k:.3g}")  # Rounded as printed.
        done = budget.reaches_end(None, step)
        if done:
            yield f"{budget.call(step)} was tried then and reached the end."
            return
        if done is None:
            break
        stopped.append(f"{step:.3g}")
    if stopped:
        yield f"Steps of {', '.join(stopped)} were tried then and stopped, too."


def _controlled(budget: _Budget) -> Iterator[str]:
    """Yield an error-controlled setting that reached the end: its steps are short in turns."""
    for rtol in _RTOL:
        if budget.reaches_end_with(rtol):
            yield f"{budget.call(rtol, 'rtol')} was tried and reached the end."
            return


def _damped(budget: _Budget, model: Scene | MechanicalSystem) -> Iterator[str]:
    """Yield a retardation time of one step if with it the same step reaches the end."""
    if not isinstance(model, Scene):
        return
    damping_time = float(f"{budget.step:.3g}")
    beams = [_with_damping(beam, damping_time) for beam in model.beams]
    if all(one is other for one, other in zip(beams, model.beams, strict=True)):
        return
    try:
        done = budget.reaches_end(assemble(replace(model, beams=beams)), budget.step)
    except AncfdaeError:
        return
    if done:
        yield (
            "Its waves are damped too little for this step: with damping_time="
            f"{damping_time:.3g} where materials have less, it reached the end."
        )


def _with_damping(beam: Any, time: float) -> Any:
    """Return a beam whose materials have at least this retardation time, s."""
    several = not isinstance(beam.material, Material)
    materials = tuple(beam.material) if several else (beam.material,)
    if beam.rigid or all(x.damping_time >= time for x in materials):
        return beam
    damped = tuple(replace(x, damping_time=max(x.damping_time, time)) for x in materials)
    return replace(beam, material=damped if several else damped[0])
