"""HHT-I3 (eqs. 2-6, Fig. 1) with a fixed step or with error control."""

from __future__ import annotations

import math
import sys
import time
import warnings
from dataclasses import dataclass, replace
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.errors import (
    InvalidInput,
    StabilityWarning,
    Verdict,
    require_count,
    require_finite,
    require_kind,
    require_positive,
)
from ancfdae.integrators.characteristic_sizes import Scales
from ancfdae.integrators.hht import linear_passes
from ancfdae.integrators.hht.defects import Defects
from ancfdae.integrators.hht.equations import (
    Steps,
)
from ancfdae.integrators.hht.march import march
from ancfdae.integrators.hht.small_steps import Nodes
from ancfdae.integrators.hht.start import RecurrenceStart
from ancfdae.integrators.hht.step import Stepper
from ancfdae.integrators.hht.step_control import Controlled, Given, Pace, Uniform, first_step
from ancfdae.integrators.hht.step_error import (
    StepError,
    derivative_sizes,
    estimated_errors,
    sizes_hold,
    smaller_sizes,
)
from ancfdae.integrators.integrator import AdjointIntegrator, Seeds, require_rtol
from ancfdae.integrators.recorder import Recorder
from ancfdae.integrators.start import (
    Covectors,
    InitialState,
    consistent_start,
    pull_back_start,
    saddle_point,
    start_sensitivity,
)
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import SaddlePoint
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.solution import Solution
from ancfdae.protocol.solution_parts import Sensitivities

# Steps may miss the end time by this many parts of their number (accumulated round-off).
_WHOLE = 1e-9
# Second order asks for a tolerance of the same size where coordinates pass through zero.
_LEAST_RTOL = 1e-12
# Newton's method stops well below the error of a step.
_SHARE = 1e-3
# What is left of the forces disturbs stiff damped beams far more than its size says (measured at
# rtol 1e-3, E = 2e11 Pa: states wrong by 43 times rtol with 1e-6, by one with 1e-9, for a tenth
# more time).
_LOOSEST = 1e-9
_EXACT = 1e-14
# Sizes of derivatives need no better tolerance.
_ROUGH = 1e-3
# Instants to allot memory for where their number is not known.
_ROWS = 1000


@final
@dataclass(frozen=True)
class HHT(AdjointIntegrator):
    """HHT-I3 (Negrut, Rampalli, Ottarsson & Sajdak 2007) at a fixed step, or with error control.

    Exactly one of `step`, `rtol` and `times` is given.

    Parameters
    ----------
    step : float, optional
        Step size h; s.
    hht_alpha : float
        Numerical damping, in [-1/3, 0]. Second order throughout; -1/3 damps frequencies above
        1/h most. At 0 the multipliers oscillate and do not converge, which is warned about.
    newton_tolerance : float, optional
        Estimated error of a and lam after the last iteration, relative to the forces of the
        motion; free of units. By default 1e-14, with error control rtol/1000 but at most 1e-9.
    max_iterations : int
        Newton iterations per step before the run ends with an outcome.
    rtol : float, optional
        What the errors of all steps may add up to, relative to every coordinate; the step follows
        from it. The run errs by up to 10 times as much (docs/theory.md, section 5).
    atol : float, optional
        The same relative to the size of the coordinates at the start (`Scales`), for coordinates
        that pass through zero; by default rtol. With `control_sensitivities` also relative to the
        size of each derivative: the smaller, the shorter the first steps, where they are zero.
    times : tuple of float, optional
        Instants of the run, from 0 on; see `frozen`.
    max_steps : int
        Steps, repeated ones included, before a run with error control ends with an outcome.
    control_sensitivities : bool
        Whether the tolerance also bounds the errors of the design derivatives q_b, each relative
        to its largest size in the run. They then go along with the motion, whatever is asked for,
        after a run that tells their sizes. Without it gradients of undamped waves can be wrong
        by any factor of the tolerance (docs/reports/work-precision).

    Raises
    ------
    InvalidInput
        If a setting is out of range.
    """

    order: ClassVar[int | None] = 2

    step: float | None = None
    hht_alpha: float = -0.3
    newton_tolerance: float | None = None
    max_iterations: int = 60
    rtol: float | None = None
    atol: float | None = None
    times: tuple[float, ...] | None = None
    max_steps: int = 1_000_000
    control_sensitivities: bool = False

    def __post_init__(self) -> None:
        """Validate."""
        given = [name for name in ("step", "rtol", "times") if getattr(self, name) is not None]
        if len(given) != 1:
            raise InvalidInput(
                "HHT",
                "needs exactly one of step, rtol and times",
                ", ".join(given) or "none",
                "For example HHT(step=0.01), or HHT(rtol=1e-5) for error control.",
            )
        self._check_pace()
        require_finite("HHT.hht_alpha", self.hht_alpha)
        if not -1 / 3 <= self.hht_alpha <= 0:
            raise InvalidInput(
                "HHT.hht_alpha",
                "must lie in [-1/3, 0]",
                self.hht_alpha,
                "-0.3 damps fast motion strongly, -0.05 hardly.",
            )
        if self.newton_tolerance is None:
            own = _EXACT if self.rtol is None else max(_EXACT, min(_SHARE * self.rtol, _LOOSEST))
            object.__setattr__(self, "newton_tolerance", own)
        require_positive("HHT.newton_tolerance", self._newton[0])
        require_count("HHT.max_iterations", self.max_iterations, "60 is plenty.")
        require_count("HHT.max_steps", self.max_steps, "1000000 is plenty.")
        # A NumPy number of single precision would spread its precision.
        for name in ("step", "hht_alpha", "newton_tolerance", "rtol", "atol"):
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else float(value))
        if self.hht_alpha == 0:
            warnings.warn(
                "HHT.hht_alpha = 0 leaves errors of the multipliers undamped: they oscillate and "
                "grow with the number of steps. Use a negative value, such as -0.05.",
                StabilityWarning,
                stacklevel=3,
            )

    def _check_pace(self) -> None:
        require_kind(
            "HHT.control_sensitivities", self.control_sensitivities, (bool,), "True or False."
        )
        if self.control_sensitivities and self.rtol is None:
            raise InvalidInput(
                "HHT.control_sensitivities", "belongs to error control", True, "Give rtol too."
            )
        if self.step is not None:
            require_positive("HHT.step", self.step)
            _require_square("HHT.step", float(self.step))
        if self.rtol is not None:
            require_rtol("HHT.rtol", self.rtol, _LEAST_RTOL)
        if self.atol is not None:
            require_positive("HHT.atol", self.atol)
            if self.rtol is None:
                raise InvalidInput(
                    "HHT.atol", "belongs to error control", self.atol, "Give rtol too."
                )
        if self.times is not None:
            times = np.asarray(self.times, dtype=float)
            good = times.ndim == 1 and len(times) > 1 and times[0] == 0.0
            if not (good and np.all(np.isfinite(times)) and np.all(np.diff(times) > 0)):
                raise InvalidInput(
                    "HHT.times",
                    "must be two or more increasing instants from 0 on",
                    "others",
                    "Take the instants of a solution.",
                )
            object.__setattr__(self, "times", tuple(float(t) for t in times))

    def frozen(self, solution: Solution) -> HHT:
        """Return the integrator that repeats the steps of a run, whatever the design.

        With error control the steps depend on the design and jump with it, so no derivative of
        the run exists. Every method differentiates it at the steps as they were taken.
        """
        if self.rtol is None:
            return self
        if len(solution.t) < 2:
            return self._changed(control_sensitivities=False)
        times = tuple(float(t) for t in solution.t)
        return self._changed(rtol=None, atol=None, times=times, control_sensitivities=False)

    def refined(self, solution: Solution) -> HHT:
        """Return the integrator that halves every step of a run."""
        if self.step is not None:
            return self._changed(step=self.step / 2)
        t = solution.t
        halves = np.sort(np.concatenate([t, 0.5 * (t[:-1] + t[1:])]))
        return self._changed(
            rtol=None,
            atol=None,
            control_sensitivities=False,
            times=tuple(float(x) for x in halves),
            newton_tolerance=max(_EXACT, self._newton[0] / 4),
        )

    def integrate(
        self,
        system: MechanicalSystem,
        t_end: float,
        *,
        sensitivities: bool = False,
        progress: bool = False,
    ) -> Solution:
        """Integrate from t = 0 to `t_end`, for a fixed step a whole number of steps."""
        count = self._count_steps(t_end)
        if self.control_sensitivities and np.iscomplexobj(system.b):
            raise InvalidInput(
                "HHT.control_sensitivities",
                "computes derivatives in real numbers",
                "a complex system",
                "Repeat the steps of a run at real values: HHT.frozen.",
            )
        matrices = saddle_point(system, 0.0)
        initial = consistent_start(system, matrices, 0.0)
        if self.control_sensitivities and system.n_b > 0:
            return self._integrate_with_derivatives(system, matrices, initial, t_end, progress)
        scales = Scales.of(system, initial, t_end)
        recorder = Recorder(system, count + 1)
        stepper = Stepper.of(system, matrices, initial, None, self._newton, recorder)
        pace = self._pace(scales, initial, t_end, count)
        solution = march(stepper, pace, self.hht_alpha, t_end, progress)
        if sensitivities:
            return self._differentiate(system, matrices, initial, scales, solution)
        return self._estimated(solution, scales)

    def _integrate_with_derivatives(
        self,
        system: MechanicalSystem,
        matrices: SaddlePoint,
        initial: InitialState,
        t_end: float,
        progress: bool,
    ) -> Solution:
        """Integrate with the derivatives along, under error control of both.

        Their sizes come from a run under error control of the motion alone. Where that had them
        too large the tolerance was too loose; then the sizes found count, and all is run again.
        The statistics count the last run, and the time of all.
        """
        started, sizes_b = time.perf_counter(), None
        derivative = start_sensitivity(system, matrices, initial)
        scales = Scales.of(system, initial, t_end)
        solution = self._rough().integrate(system, t_end, sensitivities=True, progress=progress)
        while solution.outcome.verdict is not Verdict.INTERRUPTED:
            assert solution.sensitivities is not None
            found = derivative_sizes(scales, solution.sensitivities.q_b)
            if sizes_b is None:
                # A rough run that broke off may have seen the beginning of a derivative only.
                sizes_b = found if solution.outcome.success else np.full(system.n_b, np.inf)
            elif not solution.outcome.success or sizes_hold(sizes_b, found):
                break
            else:
                sizes_b = smaller_sizes(sizes_b, found)
            recorder = Recorder(system, _ROWS, sensitivities=True)
            stepper = Stepper.of(system, matrices, initial, derivative, self._newton, recorder)
            error = self._step_error(scales, t_end, sizes_b)
            first = first_step(error, self.hht_alpha, initial, derivative)
            pace = Controlled(error, first, self.max_steps)
            solution = march(stepper, pace, self.hht_alpha, t_end, progress)
        seconds = time.perf_counter() - started
        solution = self._estimated(solution, scales)
        return replace(solution, statistics=replace(solution.statistics, wall_seconds=seconds))

    def _estimated(self, solution: Solution, scales: Scales) -> Solution:
        """Return the solution with estimates of its errors."""
        return replace(
            solution, estimated_errors=estimated_errors(scales, self.hht_alpha, solution)
        )

    def _rough(self) -> HHT:
        """Return the integrator of the run that tells the sizes of the derivatives."""
        assert self.rtol is not None
        rtol = max(self.rtol, _ROUGH)
        return self._changed(
            rtol=rtol,
            atol=None,
            newton_tolerance=max(self._newton[0], _LOOSEST),
            control_sensitivities=False,
        )

    def _changed(self, **changes: Any) -> HHT:
        """Return a copy with other settings; what these are warned about was said before."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StabilityWarning)
            return replace(self, **changes)

    def differentiate(self, system: MechanicalSystem, solution: Solution) -> Solution:
        """Add the design derivatives of a run of this integrator (eqs. 22-25).

        If a matrix is singular or the pass is interrupted, the solution is cut to what has
        derivatives and its outcome says so.
        """
        matrices = saddle_point(system, 0.0)
        initial = consistent_start(system, matrices, 0.0)
        # The length of a run of one instant scales nothing.
        scales = Scales.of(system, initial, float(solution.t[-1]) or 1.0)
        return self._differentiate(system, matrices, initial, scales, solution)

    def _differentiate(
        self,
        system: MechanicalSystem,
        matrices: SaddlePoint,
        initial: InitialState,
        scales: Scales,
        solution: Solution,
    ) -> Solution:
        started, steps = time.perf_counter(), self.steps_of(solution)
        derivative = start_sensitivity(system, matrices, initial)
        start = (derivative.q_b, derivative.v_b, derivative.a_b, derivative.lam_b)
        # A run that ended in its first step has the derivatives of its start.
        arrays, verdict = [x[None] for x in start], Verdict.FINISHED
        if len(steps.h):
            first = RecurrenceStart.of(system, matrices, steps.first, initial)
            nodes, node_b = Nodes(solution, steps, first.node), first.sensitivity(derivative)
            arrays, verdict = linear_passes.differentiate(system, matrices, nodes, node_b)
            arrays[1][0] = derivative.v_b  # A solution reports the consistent start.
        own = Sensitivities(system.design_names, system.b, *arrays)
        seconds = time.perf_counter() - started
        full = solution.with_sensitivities(own, verdict, len(arrays[0]) - 1, seconds)
        return self._estimated(full, scales)

    def pull_back(self, system: MechanicalSystem, solution: Solution, seeds: Seeds) -> Array:
        """Return the gradient of an objective by the discrete adjoint."""
        steps, matrices = self.steps_of(solution), saddle_point(system, 0.0)
        initial = consistent_start(system, matrices, 0.0)
        first = RecurrenceStart.of(system, matrices, steps.first, initial)
        nodes = Nodes(solution, steps, first.node)
        gradient, back, _ = linear_passes.pull_back(system, matrices, nodes, seeds)
        on = first.pull_back(back)
        # What an objective reads at t = 0 is the consistent start, not the shifted one.
        q, v, lam = (
            x if seed is None else x + seed[0]
            for x, seed in ((on.q, seeds.q), (on.v, seeds.v), (on.lam, seeds.lam))
        )
        on = Covectors(q, v, on.a, lam, on.b + gradient)
        return pull_back_start(system, matrices, initial, on)

    def discretisation_error(
        self, system: MechanicalSystem, solution: Solution, seeds: Seeds
    ) -> float:
        """Return what an objective would change without the defects of the steps.

        Parameters
        ----------
        system, solution, seeds
            As for `pull_back`; three instants at least.
        """
        steps, matrices = self.steps_of(solution), saddle_point(system, 0.0)
        initial = consistent_start(system, matrices, 0.0)
        node = RecurrenceStart.of(system, matrices, steps.first, initial).node
        defects = Defects.of(solution.t, solution.a, steps)
        nodes = Nodes(solution, steps, node)
        _, back, change = linear_passes.pull_back(system, matrices, nodes, seeds, defects)
        return change + float(back.v_b @ (initial.v - node.v))

    def steps_of(self, solution: Solution) -> Steps:
        """Return the steps of a run of this integrator."""
        if self.step is not None:
            return Steps(np.full(len(solution.t) - 1, self.step), self.hht_alpha)
        return Steps(np.diff(solution.t), self.hht_alpha)

    @property
    def _newton(self) -> tuple[float, int]:
        """Tolerance of Newton's method, which is a number from the start, and its iterations."""
        assert self.newton_tolerance is not None
        return self.newton_tolerance, self.max_iterations

    def _pace(self, scales: Scales, initial: InitialState, t_end: float, count: int) -> Pace:
        if self.step is not None:
            return Uniform(self.step, count)
        if self.times is not None:
            return Given(self.times)
        error = self._step_error(scales, t_end, np.zeros(0))
        return Controlled(error, first_step(error, self.hht_alpha, initial, None), self.max_steps)

    def _step_error(self, scales: Scales, t_end: float, sizes_b: Array) -> StepError:
        assert self.rtol is not None
        atol = self.rtol if self.atol is None else self.atol
        return StepError(self.rtol, atol, t_end, scales.q, sizes_b)

    def _count_steps(self, t_end: float) -> int:
        """Return the number of steps to allot memory for; check that the end is an instant."""
        require_positive("t_end", t_end)
        if self.times is not None:
            if not math.isclose(self.times[-1], t_end, rel_tol=_WHOLE):
                raise InvalidInput(
                    "t_end", f"must be the last instant, {self.times[-1]:.6g}", t_end, "Use it."
                )
            return len(self.times) - 1
        if self.step is None:
            _require_square("t_end", float(t_end))
            return _ROWS
        steps = t_end / self.step
        count = round(steps) if math.isfinite(steps) else 0
        if count < 1 or not math.isclose(steps, count, rel_tol=_WHOLE):
            raise InvalidInput(
                "t_end",
                f"must be a whole number of steps of {self.step:.6g}",
                f"{t_end:.6g}, that is {steps:.6g} steps",
                f"Use t_end = {max(count, 1) * self.step:.6g}, or another step.",
            )
        return count


def _require_square(where: str, value: float) -> None:
    """Refuse times whose square, or its inverse, is no number of full precision."""
    if not sys.float_info.min < value * value < math.inf:
        raise InvalidInput(where, "must have a square that is a number", value, "Change units.")
