"""Common base of the integrators of high order (DOP853, IDA, IDAS): start, output times, recording.

They choose their steps themselves. The solution is reported at Gauss-Lobatto points in equal
intervals, with accelerations and multipliers recomputed from positions and velocities by one linear
solve: more accurate than the values that a solver carries along. Integrals use the steps, not the
output times.
"""

import abc
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, fields, replace
from typing import ClassVar, Self, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import MissedContact
from ancfdae.errors.checks import require_array, require_count
from ancfdae.errors.kinds import InvalidInputError, SingularMatrix
from ancfdae.errors.outcomes import RunOutcome, Verdict
from ancfdae.integrators.integrator import Integrand, QuadratureIntegrator, refused, require_rtol
from ancfdae.integrators.prescribed_motion import Watch, is_driven, lock
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.quadrature import Quadrature
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control.steps import Pace
from ancfdae.kernels import finite
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.threads import in_one_thread
from ancfdae.numerics.time_grid import TimeGrid, next_end
from ancfdae.numerics.timing import progress_bar

# A run warns if it expects more steps: DOP853 takes 20 s for these in a small system (5,000 a
# second).
_MANY = 100_000
# Recorded states that are checked for contacts in one batch.
_TOGETHER = 256
# Default number of intervals of a run, and of a run of which only the end is read.
INTERVALS, _FEW = 64, 4
# Most stops that `repr` lists.
_SHOWN = 6
# Most intervals; each adds eight output times.
_MOST_INTERVALS = 10**8


# Reason and remedy in the warning of many steps.
_REMEDY = (
    "an integrator of high order follows every wave and every fast decay of the mesh. HHT(step) "
    "and HHT(rtol=...) step over those that do not matter (docs/howto/integrator.md)."
)


def pace(t_end: float, max_steps: int) -> Pace:
    """Return the counter that warns if a solver of high order will take many steps."""
    return Pace(t_end, _MANY, _REMEDY, max_steps, sure=True)


@final
class NotFinite(Exception):
    """Raised in a callback of a solver where values are not finite; never reaches the user."""


class March(abc.ABC):
    """One run of a solver of high order, step by step, in a context; it counts as `Statistics` do.

    Contacts are checked at `parts` of each step, the last one its end. `residual` is the norm of
    the last finite scaled residual (dimensionless), zero where a step leaves none. It is stored,
    because the equations must not be evaluated again after an interrupt or a failure.
    """

    parts: ClassVar[tuple[float, ...]] = (1.0,)

    def __init__(
        self,
        problem: InitialValueProblem,
        t_end: float,
        max_steps: int,
        context: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self.steps = self.iterations = self.factorisations = self.residuals = 0
        self.residual, self._t, self._t_end, self._max_steps = 0.0, 0.0, t_end, max_steps
        self.pace, self._context = pace(t_end, max_steps), context
        self.stops: tuple[float, ...] = problem.system.breakpoints(t_end)
        # Contacts are checked at the states after steps, since output times may be far apart.
        self.contacts = problem.system.contacts()
        self._path = [(0.0, problem.initial.q, problem.initial.v)] if self.contacts else []

    @property
    def _stop(self) -> float:
        """Time that the next step must not pass, s: the next breakpoint, or the end."""
        return next_end(self.stops, self._t, self._t_end)

    @final
    def to(self, times: Array) -> Array | Verdict:
        """Step until the first of the ascending `times` is passed, or return why it is not reached.

        Return the states (`stacked`) at that time and at all further `times` that were passed, (k,
        2, rows, n). May raise NotFinite, if the equations yield NaN or infinity, or SingularMatrix.
        """
        with self._context():
            while self._t < times[0]:
                if self.steps == self._max_steps:
                    return Verdict.STEP_LIMIT
                # Where there are contacts steps come singly.
                before, ends = self._t, self._steps(times)
                if isinstance(ends, Verdict):
                    return ends
                for self._t in ends:
                    if verdict := self.pace.ends_run(self._t):
                        return verdict
                if self.contacts and self._t > before:
                    within = before + (self._t - before) * np.array(self.parts)
                    states = self._states(np.append(within[:-1], self._t))
                    self._path += zip(within.tolist(), *states[:, :, 0].swapaxes(0, 1), strict=True)
                    self._look_at_contacts(_TOGETHER)
            behind = max(1, np.searchsorted(times, self._t, side="right"))
            return self._reported(times[:behind])

    @final
    def _look_at_contacts(self, least: int) -> None:
        """Pass the states after the last steps to the contact record, if there are `least`."""
        if self.contacts and len(self._path) >= least:
            self.contacts.follow(*(np.array(x) for x in zip(*self._path, strict=True)))
            self._path = []

    @final
    def missed(self) -> MissedContact | None:
        """Return the first contact that the steps of this finished run passed over, or None."""
        self._look_at_contacts(1)
        return self.contacts.missed() if self.contacts else None

    @abc.abstractmethod
    def _steps(self, times: Array) -> list[float] | Verdict:
        """Take steps, the last one of which may pass the first of the ascending `times`.

        Return the end times of the steps, s, or why no step was taken.
        """

    @abc.abstractmethod
    def _states(self, times: Array) -> Array:
        """Return states at `times` within the last step by interpolation, (k, 2, rows, n_q)."""

    def _reported(self, times: Array) -> Array:
        """Return states at the first k >= 1 of `times`, in the last step, (k, 2, rows, n_q)."""
        return self._states(times)

    @abc.abstractmethod
    def finish(self) -> None:
        """Add the steps that are still stored to the integrals of the run."""


@dataclass(frozen=True)
class HighOrder(QuadratureIntegrator):
    """An integrator of high order that chooses its steps by an error tolerance.

    Parameters
    ----------
    rtol : float
        Relative tolerance per step; dimensionless.
    intervals : int, optional
        Number of equal intervals into which the run is divided for output; the solution is reported
        at nine Gauss-Lobatto points of each, ends included. Steps do not depend on it. By default
        64, and 4 in gradients of objectives that are read at the end alone or integrated with the
        motion.
    max_steps : int
        Largest number of steps of a run, after which it ends with an outcome. The default, a
        million, only ends runs that nobody waits for; runs without progress end by themselves.
    stops : sequence of float
        Times that no step passes, in addition to the breakpoints of laws; s. For events so short
        that a step could pass over them, such as a pulse.
    """

    # The solvers compute in real numbers and would drop imaginary parts of the forces.
    real_only: ClassVar[bool] = True
    checks_contacts: ClassVar[bool] = True

    rtol: float = 1e-8
    intervals: int | None = None
    max_steps: int = 1_000_000
    stops: tuple[float, ...] = field(default=(), kw_only=True)

    @final
    def __repr__(self) -> str:
        """Return name and settings; of many stops the first, the last and the count."""
        settings = [
            f"{x.name}={getattr(self, x.name)!r}" for x in fields(self) if x.name != "stops"
        ]
        shown = repr(self.stops)
        if len(self.stops) > _SHOWN:
            first, *_, last = self.stops
            shown = f"<{len(self.stops)} from {first:.6g} to {last:.6g}>"
        return f"{type(self).__name__}({', '.join([*settings, f'stops={shown}'])})"

    @final
    def require_settings(self, least_rtol: float) -> None:
        """Raise InvalidInputError unless rtol, intervals, stops and max_steps are valid."""
        name = type(self).__name__
        require_rtol(f"{name}.rtol", self.rtol, least_rtol)
        if self.intervals is not None:
            repair = f"{INTERVALS} is a good number."
            require_count(f"{name}.intervals", self.intervals, repair, _MOST_INTERVALS)
        require_array(f"{name}.stops", self.stops)
        require_count(f"{name}.max_steps", self.max_steps, f"{type(self).max_steps} is plenty.")

    @final
    def refined(self, solution: Solution) -> Self:
        """Return the same integrator with a tenth of the tolerance `rtol`."""
        return replace(self, rtol=self.rtol / 10)

    @final
    def at_end(self, system: MechanicalSystem, t_end: float) -> Self:
        """Return the integrator with few output times, for a run of which only the end is read.

        Given `intervals` are kept. A prescribed motion keeps the default number of intervals,
        because it is checked from one output time to the next.
        """
        if self.intervals or system.n_lam == system.n_q:
            return self
        times = np.linspace(0.0, t_end, INTERVALS + 1)
        if is_driven(system, times, system.start()[0].real):
            return self
        return replace(self, intervals=_FEW)

    @abc.abstractmethod
    def start(self, problem: InitialValueProblem, t_end: float, quadrature: Quadrature) -> March:
        """Return a run of this integrator, set up at the consistent start of the problem."""

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
        """Integrate the motion from t = 0 to `t_end` (s), and integrals of the `integrands`."""
        if any(np.iscomplexobj(x) for x in (system.b, *system.start())):
            rule, got = "needs real coordinates and design values", "complex ones"
            raise InvalidInputError(type(self).__name__, rule, got, "Only HHT takes complex steps.")
        with np.errstate(all="ignore"):  # Values that are not finite raise an error below.
            problem = InitialValueProblem.of(system, t_end)
            problem = problem.differentiated(True) if sensitivities else problem
        problem.require_finite()
        grid = TimeGrid.lobatto(t_end, self.intervals or INTERVALS)
        recorder = SolutionRecorder(system, len(grid.t), grid.degree, sensitivities)
        recorder.accepted = 0
        recorder.record(*problem.initial, problem.derivative or ())
        verdict, march, remedy, lost = Verdict.FINISHED, None, "", None
        watch = Watch(system, recorder)
        quadrature = Quadrature(integrands, problem.accelerations, self.rtol)
        try:
            with np.errstate(all="ignore"):  # The outcome reports a blow-up.
                march = self.start(problem, t_end, quadrature)
                march.stops = (*march.stops, *self.stops)
                for k in progress_bar(progress, range(1, len(grid.t)), unit="instant"):
                    if k < recorder.instants:
                        continue  # This output time was reported with the one before.
                    states = march.to(grid.t[k:])
                    if isinstance(states, Verdict):
                        verdict = states
                        break
                    _record(problem, recorder, grid.t[k : k + len(states)], states)
                    if lost := watch.missed():
                        break
                else:
                    march.finish()
        except NotFinite:
            verdict = Verdict.NOT_FINITE
        except SingularMatrix:
            verdict = Verdict.SINGULAR
        except KeyboardInterrupt:
            verdict = Verdict.INTERRUPTED
        if lost := lost or watch.missed(all_of_them=True):
            verdict, remedy = lost.verdict, lost.remedy
        recorder.factorisations = problem.accelerations.factorisations
        size = 0.0
        if march is not None:
            recorder.accepted, recorder.iterations = march.steps, march.iterations
            recorder.residuals = march.residuals
            recorder.factorisations += march.factorisations
            size = 0.0 if verdict is Verdict.FINISHED else march.residual
            remedy = march.pace.advice if verdict is Verdict.STEPS_TOO_SHORT else remedy
        if verdict in (Verdict.NO_CONVERGENCE, Verdict.ERROR_TEST):
            last = recorder.last(1)
            remedy = lock(system, float(last.t[0]), last.q[0], t_end)
        outcome = RunOutcome(verdict, recorder.time, recorder.accepted, size, advice=remedy)
        missed = march.missed() if march is not None and outcome.success else None
        return refused(recorder.solution(outcome), missed)


def _record(
    problem: InitialValueProblem, recorder: SolutionRecorder, t: Array, states: Array
) -> None:
    """Complete states, (k, 2, rows, n_q), by accelerations and multipliers, and record them.

    If one of them has no accelerations, those before it are recorded and an exception is raised.
    """
    n = problem.system.n_q
    try:
        x = problem.accelerations.rows_of(t, states)
        if not finite(x):
            raise NotFinite
    except (NotFinite, SingularMatrix):
        if len(t) == 1:
            raise
        for k in range(len(t)):
            _record(problem, recorder, t[[k]], states[[k]])
        return
    parts = states[:, 0], states[:, 1], x[..., :n], x[..., n:]
    q, v, a, lam = (part[:, 0] for part in parts)
    derivatives = tuple(part[:, 1:].swapaxes(1, 2) for part in parts if states.shape[2] > 1)
    recorder.record(t, q, v, a, lam, derivatives)
