"""What the integrators of high order share: instants, start, recording.

They choose their steps themselves and report Gauss-Lobatto instants in equal intervals, with
accelerations and multipliers recomputed from positions and velocities by one linear solve: more
accurate than what a solver carries along.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import final

import numpy as np
from tqdm import tqdm

from ancfdae.errors import InvalidInput, Outcome, SingularMatrix, Verdict, require_positive
from ancfdae.integrators.accelerations import Accelerations
from ancfdae.integrators.contract import Integrator
from ancfdae.integrators.initial import (
    InitialSensitivity,
    InitialState,
    consistent_start,
    saddle_point,
    start_sensitivity,
)
from ancfdae.integrators.point import Point
from ancfdae.integrators.recorder import Recorder
from ancfdae.integrators.scales import Scales
from ancfdae.numerics.arrays import is_finite
from ancfdae.numerics.time_grid import TimeGrid
from ancfdae.solution import Solution
from ancfdae.system import MechanicalSystem


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
        """
        require_positive("t_end", t_end)
        if np.iscomplexobj(system.b):
            # A solver in real numbers would drop imaginary parts and return derivatives of zero.
            raise InvalidInput(
                "design variables",
                "must be real for an integrator that controls its error",
                "complex values",
                "Use HHT for a complex step, or Direct().",
            )
        matrices = saddle_point(system, 0.0)
        initial = consistent_start(system, matrices, 0.0)
        derivative = start_sensitivity(system, matrices, initial) if sensitivities else None
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
    def to(self, t: float) -> Point | Verdict:
        """Go on to the time t; return the state there, or why it was not reached.

        Raises
        ------
        NotFinite
            If the equations yield NaN or infinity.
        SingularMatrix
        """

    @abc.abstractmethod
    def residual(self) -> float:
        """Size of the scaled residual at the last accepted step."""


class HighOrder(Integrator):
    """An integrator that controls its error.

    Attributes
    ----------
    intervals : int
        Equal intervals of the run; each has nine Gauss-Lobatto instants, ends included.
    """

    intervals: int

    @abc.abstractmethod
    def start(self, problem: Problem, t_end: float) -> March:
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
        problem = Problem.of(system, t_end, sensitivities)
        grid = TimeGrid.lobatto(t_end, self.intervals)
        recorder = Recorder(system, len(grid.t), grid.degree, sensitivities)
        recorder.accepted = 0
        start, b = problem.initial, problem.derivative
        verdict, march = Verdict.FINISHED, self.start(problem, t_end)
        first = Point(start.q, start.v) if b is None else Point(start.q, start.v, b.q_b, b.v_b)
        try:
            _record(problem, recorder, 0.0, first)
            for t in tqdm(grid.t[1:], disable=not progress, unit="instant"):
                with np.errstate(all="ignore"):  # A blow-up is told by the outcome.
                    point = march.to(float(t))
                    if isinstance(point, Verdict):
                        verdict = point
                        break
                    _record(problem, recorder, float(t), point)
        except NotFinite:
            verdict = Verdict.NOT_FINITE
        except SingularMatrix:
            verdict = Verdict.SINGULAR
        except KeyboardInterrupt:
            verdict = Verdict.INTERRUPTED
        recorder.accepted, recorder.iterations = march.steps, march.iterations
        recorder.residuals = march.residuals
        recorder.factorisations = march.factorisations + problem.accelerations.factorisations
        size = 0.0 if verdict is Verdict.FINISHED else march.residual()
        return recorder.solution(Outcome(verdict, recorder.time, march.steps, size))


def _record(problem: Problem, recorder: Recorder, t: float, point: Point) -> None:
    """Complete a state by accelerations and multipliers, and store it."""
    q, v = point.q, point.v
    a, lam = problem.accelerations.solve(t, q, v)
    if not is_finite(a):
        raise NotFinite
    if point.q_b is None or point.v_b is None:
        recorder.record(t, q, v, a, lam)
        return
    q_b, v_b = point.q_b, point.v_b
    a_b, lam_b = problem.accelerations.solve_b(t, (q, v, a, lam), q_b, v_b)
    recorder.record(t, q, v, a, lam, (q_b, v_b, a_b, lam_b))
