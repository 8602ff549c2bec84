"""Common parts of the integrators of high order: output times, start, recording.

They choose their steps themselves and report Gauss-Lobatto instants in equal intervals, with
accelerations and multipliers recomputed from positions and velocities by one linear solve: more
accurate than what a solver carries along. Integrals follow the steps, not the instants.
"""

import abc
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.errors import (
    InvalidInput,
    Outcome,
    SingularMatrix,
    Verdict,
    require_array,
    require_count,
)
from ancfdae.integrators.integrand import Integrand
from ancfdae.integrators.integrator import QuadratureIntegrator, require_rtol
from ancfdae.integrators.pace import Pace
from ancfdae.integrators.prescribed_motion import lock
from ancfdae.integrators.problem import Problem
from ancfdae.integrators.quadrature import Quadrature
from ancfdae.integrators.recorder import Recorder
from ancfdae.integrators.watch import Watch
from ancfdae.kernels import finite
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.progress import progress_bar
from ancfdae.numerics.threads import in_one_thread
from ancfdae.numerics.time_grid import TimeGrid, next_end

# Steps of which a run warns: Explicit takes 20 s for them in a small system (5,000 a second).
_MANY = 100_000
# Each interval has eight instants more.
_MOST_INTERVALS = 10**8


# Why there are many, and what to use instead.
_REMEDY = (
    "an integrator of high order follows every wave and every fast decay of the mesh. HHT(step) "
    "and HHT(rtol=...) step over those that do not matter (docs/howto/integrator.md)."
)


def pace(t_end: float) -> Pace:
    """Return the counter that warns if a solver of high order will take many steps."""
    return Pace(t_end, _MANY, _REMEDY, sure=True)


@final
class NotFinite(Exception):
    """Raised inside a callback to leave a solver; never reaches the user."""


class March(abc.ABC):
    """One run of a solver, step by step, in a context; it counts as `Statistics` do.

    `residual` is the size of the last finite scaled residual, zero where a step leaves none; it is
    kept, for after an interrupt or a failure the equations must not be called once more.
    """

    def __init__(
        self,
        problem: Problem,
        t_end: float,
        max_steps: int,
        context: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self.steps = self.iterations = self.factorisations = self.residuals = 0
        self.residual, self._t, self._t_end, self._max_steps = 0.0, 0.0, t_end, max_steps
        self._pace, self._context = pace(t_end), context
        self.stops: tuple[float, ...] = problem.system.traits.breakpoints

    @property
    def _stop(self) -> float:
        """Time that the next step must not pass, s: the next breakpoint, or the end."""
        return next_end(self.stops, self._t, self._t_end)

    @final
    def to(self, t: float) -> Array | Verdict:
        """Step until t lies behind; return the state there (`stacked`), or why it is not reached.

        NotFinite if the equations yield NaN or infinity, or SingularMatrix, may be raised.
        """
        with self._context():
            while self._t < t:
                if self.steps == self._max_steps:
                    return Verdict.STEP_LIMIT
                trouble = self._step()
                if trouble is not None:
                    return trouble
                if self._pace.stalls(self._t):
                    return Verdict.ERROR_TEST
            return self._state(t)

    @abc.abstractmethod
    def _step(self) -> Verdict | None:
        """Take a step, or return why there is none."""

    @abc.abstractmethod
    def _state(self, t: float) -> Array:
        """Interpolate in the last step; `stacked`."""

    @abc.abstractmethod
    def finish(self) -> None:
        """Add the last steps to the integrals."""


@dataclass(frozen=True)
class HighOrder(QuadratureIntegrator):
    """An integrator that controls its error.

    Parameters
    ----------
    rtol : float
        Relative tolerance per step; dimensionless.
    intervals : int
        Equal intervals of the run; each has nine Gauss-Lobatto instants, ends included. They
        say where the trajectory is reported, nothing else.
    max_steps : int
        Steps of the whole run before it ends with an outcome. The default, a million, is no
        budget: it ends runs that nobody waits for. Runs that lead nowhere end by themselves.
    stops : sequence of float
        Instants that no step passes, beside the breakpoints of laws: where something happens that
        lasts so short that steps could pass over it, such as a pulse; s.
    """

    # The solvers are real wherever the start is, and would drop imaginary parts of the forces.
    real_only: ClassVar[bool] = True

    rtol: float = 1e-8
    intervals: int = 64
    max_steps: int = 1_000_000
    stops: tuple[float, ...] = field(default=(), kw_only=True)

    @final
    def require_settings(self, least_rtol: float) -> None:
        """Validate the settings that all have."""
        name = type(self).__name__
        require_rtol(f"{name}.rtol", self.rtol, least_rtol)
        require_count(f"{name}.intervals", self.intervals, "64 is a good number.", _MOST_INTERVALS)
        require_array(f"{name}.stops", self.stops)
        require_count(f"{name}.max_steps", self.max_steps, f"{type(self).max_steps} is plenty.")

    @final
    def refined(self, solution: Solution) -> Self:
        """Return the integrator with a tenth of the tolerance."""
        return replace(self, rtol=self.rtol / 10)

    @abc.abstractmethod
    def start(self, problem: Problem, t_end: float, quadrature: Quadrature) -> March:
        """Set up a solver at the start."""

    @final
    @in_one_thread
    def integrate(
        self,
        system: MechanicalSystem,
        t_end: float,
        *,
        sensitivities: bool = False,
        progress: bool = False,
        integrands: Sequence[Integrand] = (),
    ) -> Solution:
        """Integrate from t = 0 to `t_end`, integrals beside the motion."""
        if any(np.iscomplexobj(x) for x in (system.b, *system.start())):
            rule, got = "needs real coordinates and design values", "complex ones"
            raise InvalidInput(type(self).__name__, rule, got, "Only HHT takes complex steps.")
        with np.errstate(all="ignore"):  # What is not finite is refused, not warned about.
            problem = Problem.of(system, t_end)
            problem = problem.differentiated() if sensitivities else problem
        problem.require_finite()
        grid = TimeGrid.lobatto(t_end, self.intervals)
        recorder = Recorder(system, len(grid.t), grid.degree, sensitivities)
        recorder.accepted = 0
        recorder.record(*problem.initial, problem.derivative or ())
        verdict, march, remedy = Verdict.FINISHED, None, ""
        watch = Watch(system, recorder)
        quadrature = Quadrature(integrands, problem.accelerations, self.rtol)
        try:
            with np.errstate(all="ignore"):  # A blow-up is told by the outcome.
                march = self.start(problem, t_end, quadrature)
                march.stops = (*march.stops, *self.stops)
                for t in progress_bar(progress, grid.t[1:], unit="instant"):
                    point = march.to(float(t))
                    if isinstance(point, Verdict):
                        verdict = point
                        break
                    _record(problem, recorder, float(t), point)
                    if remedy := watch.missed():
                        break
                else:
                    march.finish()
        except NotFinite:
            verdict = Verdict.NOT_FINITE
        except SingularMatrix:
            verdict = Verdict.SINGULAR
        except KeyboardInterrupt:
            verdict = Verdict.INTERRUPTED
        if remedy := remedy or watch.missed(all_of_them=True):
            verdict = Verdict.OFF_ROOT
        recorder.factorisations = problem.accelerations.factorisations
        size = 0.0
        if march is not None:
            recorder.accepted, recorder.iterations = march.steps, march.iterations
            recorder.residuals = march.residuals
            recorder.factorisations += march.factorisations
            size = 0.0 if verdict is Verdict.FINISHED else march.residual
        if verdict in (Verdict.NO_CONVERGENCE, Verdict.ERROR_TEST):
            last = recorder.last(1)
            remedy = lock(system, float(last.t[0]), last.q[0], t_end)
        outcome = Outcome(verdict, recorder.time, recorder.accepted, size, advice=remedy)
        return recorder.solution(outcome)


def _record(problem: Problem, recorder: Recorder, t: float, state: Array) -> None:
    """Complete a state by accelerations and multipliers, and store it."""
    (q, v), n = state, problem.system.n_q
    x = problem.accelerations.rows(t, q, v)
    if not finite(x):
        raise NotFinite
    a, lam = x[:, :n], x[:, n:]
    derivatives = () if len(q) == 1 else (q[1:].T, v[1:].T, a[1:].T, lam[1:].T)
    recorder.record(t, q[0], v[0], a[0], lam[0], derivatives)
