"""What the integrators of high order share: instants, start, recording.

They choose their steps themselves and report Gauss-Lobatto instants in equal intervals, with
accelerations and multipliers recomputed from positions and velocities by one linear solve: more
accurate than what a solver carries along. Integrals follow the steps, not the instants.
"""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from tqdm import tqdm

from ancfdae.errors import InvalidInput, Outcome, SingularMatrix, Verdict, require_positive
from ancfdae.integrators.characteristic_sizes import Scales
from ancfdae.integrators.index_1 import Accelerations, State
from ancfdae.integrators.integrand import Integrand
from ancfdae.integrators.integrator import QuadratureIntegrator
from ancfdae.integrators.quadrature import Quadrature
from ancfdae.integrators.recorder import Recorder
from ancfdae.integrators.start import (
    InitialSensitivity,
    InitialState,
    consistent_start,
    start_sensitivity,
)
from ancfdae.numerics.arrays import Array, is_finite
from ancfdae.numerics.time_grid import TimeGrid
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.saddle_points import saddle_point
from ancfdae.protocol.solution import Solution

# Steps that together advance by less than this share of the end time. Single steps may be lost in
# round-off: at tight tolerances Newton's method meets it, and SUNDIALS tries shorter steps until it
# gets on (a pendulum of IDA at 3e-13: five in a row, and the end time is reached).
_STEPS, _SHARE = 100, 1e-12


@final
class Progress:
    """Watches the times that a solver reaches.

    Parameters
    ----------
    t_end : float
    """

    def __init__(self, t_end: float) -> None:
        self._mark, self._least, self._taken = 0.0, _SHARE * t_end, 0

    def stalls(self, t: float) -> bool:
        """Take note of a step to t; return whether the last hundred led nowhere.

        This ends runs that diverge, meet a jump too large to integrate, or integrate noise.
        """
        self._taken += 1
        if self._taken < _STEPS:
            return False
        stalled = t - self._mark < self._least
        self._mark, self._taken = t, 0
        return stalled


@final
class NotFinite(Exception):
    """Raised inside a callback to leave a solver; never reaches the user."""


@final
@dataclass(frozen=True)
class Problem:
    """A system at its consistent start.

    Attributes
    ----------
    system : MechanicalSystem
    initial : InitialState
    derivative : InitialSensitivity or None
        None where no sensitivities are asked for.
    scales : Scales
    accelerations : Accelerations
    """

    system: MechanicalSystem
    initial: InitialState
    derivative: InitialSensitivity | None
    scales: Scales
    accelerations: Accelerations

    @staticmethod
    def of(system: MechanicalSystem, t_end: float, sensitivities: bool) -> Problem:
        """Find the consistent start.

        Raises
        ------
        InvalidInput
            Also if accelerations, multipliers or design derivatives at the start are not finite.
        """
        require_positive("t_end", t_end)
        matrices = saddle_point(system, 0.0)
        initial = consistent_start(system, matrices, 0.0)
        _require_finite("accelerations at the start", initial.a, initial.lam)
        derivative = None
        if sensitivities:
            with np.errstate(all="ignore"):  # What is not finite is refused, not warned about.
                derivative = start_sensitivity(system, matrices, initial)
            d = derivative
            _require_finite("design derivatives at the start", d.q_b, d.v_b, d.a_b, d.lam_b)
        scales = Scales.of(system, initial, t_end)
        return Problem(system, initial, derivative, scales, Accelerations(system, matrices))


class March(abc.ABC):
    """One run of a solver, from instant to instant.

    Attributes
    ----------
    steps, iterations, factorisations, residuals : int
        As in `Statistics`.
    """

    steps: int
    iterations: int
    factorisations: int
    residuals: int

    @abc.abstractmethod
    def to(self, t: float) -> State | Verdict:
        """Go on to the time t; return the state there, or why it was not reached.

        Raises
        ------
        NotFinite
            If the equations yield NaN or infinity.
        SingularMatrix
        """

    @abc.abstractmethod
    def finish(self) -> None:
        """Take the last steps into the integrals."""

    @abc.abstractmethod
    def residual(self) -> float:
        """Size of the last finite scaled residual; it is kept, not evaluated again.

        After an interrupt or a failure the equations must not be called once more.
        """


class HighOrder(QuadratureIntegrator):
    """An integrator that controls its error.

    Attributes
    ----------
    rtol : float
    intervals : int
        Equal intervals of the run; each has nine Gauss-Lobatto instants, ends included. They
        say where the trajectory is reported, nothing else.
    """

    rtol: float
    intervals: int

    @abc.abstractmethod
    def start(self, problem: Problem, t_end: float, quadrature: Quadrature) -> March:
        """Set up a solver at the start."""

    @final
    def integrate(
        self,
        system: MechanicalSystem,
        t_end: float,
        *,
        sensitivities: bool = False,
        progress: bool = False,
    ) -> Solution:
        """Integrate from t = 0 to `t_end`."""
        return self.integrate_with(
            system, t_end, (), sensitivities=sensitivities, progress=progress
        )

    @final
    def integrate_with(
        self,
        system: MechanicalSystem,
        t_end: float,
        integrands: Sequence[Integrand],
        *,
        sensitivities: bool = False,
        progress: bool = False,
    ) -> Solution:
        """Integrate from t = 0 to `t_end`, integrals beside the motion."""
        if self.real_only:
            _refuse_complex(type(self).__name__, system)
        problem = Problem.of(system, t_end, sensitivities)
        grid = TimeGrid.lobatto(t_end, self.intervals)
        recorder = Recorder(system, len(grid.t), grid.degree, sensitivities)
        recorder.accepted = 0
        _record_start(problem, recorder)
        verdict, march = Verdict.FINISHED, None
        quadrature = Quadrature(integrands, problem.accelerations, self.rtol)
        try:
            with np.errstate(all="ignore"):  # A blow-up is told by the outcome.
                march = self.start(problem, t_end, quadrature)
                for t in tqdm(grid.t[1:], disable=not progress, unit="instant"):
                    point = march.to(float(t))
                    if isinstance(point, Verdict):
                        verdict = point
                        break
                    _record(problem, recorder, float(t), point)
                else:
                    march.finish()
        except NotFinite:
            verdict = Verdict.NOT_FINITE
        except SingularMatrix:
            verdict = Verdict.SINGULAR
        except KeyboardInterrupt:
            verdict = Verdict.INTERRUPTED
        recorder.factorisations = problem.accelerations.factorisations
        size = 0.0
        if march is not None:
            recorder.accepted, recorder.iterations = march.steps, march.iterations
            recorder.residuals = march.residuals
            recorder.factorisations += march.factorisations
            size = 0.0 if verdict is Verdict.FINISHED else march.residual()
        return recorder.solution(Outcome(verdict, recorder.time, recorder.accepted, size))


def _refuse_complex(name: str, system: MechanicalSystem) -> None:
    if any(np.iscomplexobj(x) for x in (system.b, *system.start())):
        raise InvalidInput(name, "computes in real numbers", "a complex system", "Use HHT.")


def _require_finite(what: str, *arrays: Array) -> None:
    if not all(is_finite(x) for x in arrays):
        raise InvalidInput(what, "must be finite", "NaN or infinity", "Check forces and start.")


def _record_start(problem: Problem, recorder: Recorder) -> None:
    """Store the consistent start as the first row."""
    s, d = problem.initial, problem.derivative
    derivatives = () if d is None else (d.q_b, d.v_b, d.a_b, d.lam_b)
    recorder.record(0.0, s.q, s.v, s.a, s.lam, derivatives)


def _record(problem: Problem, recorder: Recorder, t: float, point: State) -> None:
    """Complete a state by accelerations and multipliers, and store it."""
    q, v = point.q, point.v
    a, lam = problem.accelerations.solve(t, q, v)
    if not (is_finite(a) and is_finite(lam)):
        raise NotFinite
    if point.q_b is None or point.v_b is None:
        recorder.record(t, q, v, a, lam)
        return
    q_b, v_b = point.q_b, point.v_b
    a_b, lam_b = problem.accelerations.solve_b(t, (q, v, a, lam), q_b, v_b)
    if not (is_finite(a_b) and is_finite(lam_b)):
        raise NotFinite
    recorder.record(t, q, v, a, lam, (q_b, v_b, a_b, lam_b))
