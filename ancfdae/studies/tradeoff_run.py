"""One measured run: what a worker process computes and sends back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.assembly.system import AncfSystem
from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.errors.kinds import AncfdaeError
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.integrator import Integrator
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import stopwatch, timed
from ancfdae.sensitivity.method import Gradient, GradientMethod, UnfinishedRunError
from ancfdae.sensitivity.objectives import Objective
from ancfdae.studies.calls import gradient
from ancfdae.studies.jobs import TimeLimit

# Times at which trajectories are compared, and instants at which drift and energy are computed.
_SAMPLES = 201
_LOOKS = 1000
# Longer runs are timed once; s.
_LONG = 1.0


@final
@dataclass(frozen=True)
class Task:
    """A measurement to make; everything in it pickles if system and objective do.

    `model` is the name of another model than the one that all are compared with.
    """

    system: MechanicalSystem
    objective: Objective
    t_end: float
    integrator: Integrator
    method: GradientMethod | None
    repeats: int
    time_limit: float | None
    model: str = ""


@final
@dataclass(frozen=True)
class Results:
    """Value, gradient and errors of a finished run.

    q and lam, (k, n), are those at the common times; `drift`, (j, n_lam), has the constraints at
    the instants t of the run, `energy`, (j,), is the total one there, empty for a system that is
    not a scene, and `kinetic` the largest kinetic one.
    """

    value: float
    gradient: Array
    q: Array
    lam: Array
    drift: Array
    t: Array
    energy: Array
    kinetic: float


@final
@dataclass(frozen=True)
class Measurement:
    """Least processor time of the repeats, the outcome as a sentence, and results if there are.

    `verdict` tells how a run ended that did not reach its end time.
    """

    seconds: float
    outcome: str
    results: Results | None = None
    verdict: Verdict | None = None


def common_times(t_end: float) -> Array:
    """Return the times at which trajectories are compared."""
    return np.linspace(0.0, t_end, _SAMPLES)


def measure(task: Task) -> Measurement:
    """Run one setting; a failure is a measurement without results."""
    clock, limit = stopwatch(), TimeLimit(task.time_limit)
    try:
        with limit:
            return _repeated(task)
    except KeyboardInterrupt:
        if not limit.expired:
            raise
    outcome = f"the limit of time (time_limit = {limit.seconds:g} s) was reached"
    return Measurement(clock(), outcome)


def _repeated(task: Task) -> Measurement:
    def run() -> Gradient:
        settings = task.objective, task.t_end, task.integrator
        return gradient(task.system, *settings, method=task.method)

    clock = stopwatch()
    try:
        seconds, answer = timed(run, task.repeats, long=_LONG)
    except UnfinishedRunError as error:
        outcome = error.solution.outcome
        return Measurement(clock(), str(outcome), verdict=outcome.verdict)
    except (AncfdaeError, ArithmeticError, ValueError, RuntimeError, MemoryError) as error:
        return Measurement(clock(), f"{type(error).__name__}: {error}")
    return Measurement(seconds, str(answer.solution.outcome), _results(task.system, answer))


def _results(system: MechanicalSystem, answer: Gradient) -> Results:
    solution = answer.solution
    # The end of a run with a fixed step may miss the end time by round-off.
    common = solution.at(common_times(float(solution.t[-1])))
    rows = np.unique(np.linspace(0, len(solution.t) - 1, _LOOKS).round().astype(int))
    t, q = solution.t[rows], solution.q[rows]
    drift = np.array([system.constraint(s, x) for s, x in zip(t.tolist(), q, strict=True)])
    values = (answer.value, answer.gradient, common.q, common.lam, drift, t)
    return Results(*values, *_energy(system, solution, rows))


def _energy(system: MechanicalSystem, solution: Solution, rows: Array) -> tuple[Array, float]:
    """Return the energy of a scene, kinetic, strain and gravity's, and the largest kinetic one."""
    if not isinstance(system, AncfSystem):
        return np.zeros(0), 0.0
    q, v = solution.q[rows], solution.v[rows]
    return system.energies.total(q, v), float(np.max(system.energies.kinetic(v)))
