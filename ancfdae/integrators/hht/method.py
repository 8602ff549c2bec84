"""The integrator HHT-I3 (eqs. 2-6, Fig. 1) under any step control, and its runs in parts.

A run with steps that are known in advance can be integrated part by part, forward and backward. A
part starts from a node, the full state of the recurrence, so that it is always the same.
"""

import warnings
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.errors.kinds import StabilityWarning
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.hht import linear_passes
from ancfdae.integrators.hht.equations import (
    Coefficients,
    Defects,
    Node,
    Nodes,
    NodeSensitivity,
    Steps,
    constraint_error,
    node_after,
    require_alpha,
    rescaled,
    step_matrices,
)
from ancfdae.integrators.hht.start import RecurrenceStart
from ancfdae.integrators.hht.step import HHTStepper
from ancfdae.integrators.integrator import (
    DefectIntegrator,
    PartwiseIntegrator,
    RunInParts,
    Seeds,
    with_contacts,
)
from ancfdae.integrators.problem import InitialValueProblem, Scales
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.start import Covectors, pull_back_start
from ancfdae.integrators.step_control import StepControl
from ancfdae.integrators.step_control.contracts import Reached, estimated_errors, march
from ancfdae.integrators.step_control.steps import StepPlan
from ancfdae.integrators.stepped import SteppedIntegrator
from ancfdae.numerics.arrays import Array


@final
class Replay(RunInParts):
    """A run of HHT-I3 with steps that are known in advance, integrated part by part."""

    def __init__(
        self, problem: InitialValueProblem, steps: Steps, t: Array, newton: tuple[float, int]
    ) -> None:
        self._problem, self._steps, self.t, self._newton = problem, steps, t, newton
        self._first = RecurrenceStart.of(problem, steps.of(1))
        self.taken, self._contacts = 0, problem.system.contacts()

    def start(self) -> Node:
        """Return the node at the start of the run."""
        return self._first.node

    def part(self, node: Node, first: int, last: int) -> tuple[Solution, Node]:
        """Integrate from time point `first` to `last`, starting from the checkpoint `node`."""
        recorder, h = SolutionRecorder(self._problem.system, last - first + 1), self._steps.h
        stepper = HHTStepper(self._problem, self._steps.alpha, self._newton, None, recorder)
        recorder.record(*(stepper.recorded((node, None)) if first else stepper.consistent()))
        begun = Reached(first, float(self.t[first]), float(h[max(first - 1, 0)]), (node, None))
        plan = StepPlan(h[:last], self.t[1 : last + 1])
        run, reached = march(stepper, plan, recorder, float(self.t[last]), False, [begun])
        self.taken += reached.n - first
        run = replace(run, outcome=replace(run.outcome, step=reached.n))
        if self._contacts:
            run = with_contacts(run, self._contacts, last == len(self.t) - 1)
        return run, reached.now[0]

    def pull_back(
        self, run: Solution, node: Node, first: int, seeds: Seeds, on: Array
    ) -> tuple[Array, Array]:
        """Pull adjoint vectors back through one part of the run; see `pull_back_part`."""
        h, alpha, last = self._steps.h, self._steps.alpha, first + len(run.t) - 1
        # After its last step the part predicts a step of the size of the next one.
        matrix = step_matrices(Steps(h[first : last + 1], alpha))[: last - first]
        steps = Steps(h[first:last], alpha)
        begin = rescaled(node, self._steps.ratio(first)) if first else node
        nodes = Nodes(self._problem, run, steps, begin)
        gradient, on, _ = linear_passes.pull_back_part(nodes, seeds, on, matrix)
        return gradient, on

    def close(self, on: Array, seeds: Seeds, gradient: Array) -> Array:
        """Return the gradient, (n_b,), with the part that acts through the start of the run."""
        back = linear_passes.start_covectors(self._steps.of(1), on)
        return through_start(self._problem, self._first, back, seeds, gradient)

    def no_covectors(self) -> Array:
        """Return zero adjoint vectors, six for each coordinate, shape (6, n_q)."""
        return np.zeros((6, self._problem.system.n_q))


def through_start(
    problem: InitialValueProblem,
    first: RecurrenceStart,
    back: NodeSensitivity,
    seeds: Seeds,
    gradient: Array,
) -> Array:
    """Return the gradient, (n_b,), with the part that acts through the start of the recurrence."""
    on = first.pull_back(back)
    # An objective at t = 0 reads the consistent start, not the shifted start of the recurrence.
    q, v, lam = (
        x if seed is None else x + seed[0]
        for x, seed in ((on.q, seeds.q), (on.v, seeds.v), (on.lam, seeds.lam))
    )
    on = Covectors(q, v, on.a, lam, on.b + gradient)
    return pull_back_start(problem.system, problem.matrices, problem.initial, on)


@final
@dataclass(frozen=True, init=False)
class HHT(SteppedIntegrator, DefectIntegrator, PartwiseIntegrator):
    """HHT-I3 (Negrut, Rampalli, Ottarsson & Sajdak 2007) at a fixed step, or with error control.

    Exactly one of `steps`, `step` and `rtol` is given.

    Parameters
    ----------
    steps : StepControl or float
        `FixedSteps`, `AdaptiveSteps` or `PrescribedSteps`; a number is the step of `FixedSteps`, s.
    hht_alpha : float
        Numerical damping, in [-1/3, 0]. Second order throughout; -1/3 damps frequencies above 1/h
        most. At 0 the multipliers oscillate and do not converge, and a warning is given.
    newton_tolerance : float, optional
        Estimated error of a and lam after the last iteration, relative to the forces of the motion;
        dimensionless. By default 1e-14, with error control rtol/1000 but at most 1e-9.
    max_iterations : int
        Newton iterations of a step before it is solved by way of shorter ones (at fixed and
        prescribed steps, in ten times as many), or rejected.
    step : float, optional
        Short for ``steps=FixedSteps(step)``; s.
    rtol : float, optional
        Relative error per step, dimensionless; short for ``steps=AdaptiveSteps(rtol)``.
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
        self._set(steps, step, rtol, newton_tolerance, max_iterations)
        require_alpha("HHT.hht_alpha", hht_alpha)
        object.__setattr__(self, "hht_alpha", float(hht_alpha))
        if hht_alpha == 0:
            warnings.warn(
                "HHT.hht_alpha = 0 leaves errors of the multipliers undamped: they oscillate and "
                "grow with the number of steps. Use a negative value, such as -0.05.",
                StabilityWarning,
                stacklevel=2,
            )

    def _stepper(
        self, problem: InitialValueProblem, t_end: float, sizes_b: Array, recorder: SolutionRecorder
    ) -> HHTStepper:
        newton = self.newton_tolerance, self.max_iterations
        tolerance = self.steps.tolerance(t_end, problem.scales.q, sizes_b)
        return HHTStepper(problem, self.hht_alpha, newton, tolerance, recorder)

    def _state_after(self, run: Solution, steps: int) -> tuple[Node, None]:
        return node_after(run, steps, self.hht_alpha), None

    def _derivatives(
        self, problem: InitialValueProblem, run: Solution, progress: bool
    ) -> tuple[list[Array], Verdict]:
        steps, derivative = Steps(self.sizes(run), self.hht_alpha), problem.derivative
        assert derivative is not None
        first = RecurrenceStart.of(problem, steps.of(1))
        nodes = Nodes(problem, run, steps, first.node)
        derivatives = linear_passes.differentiate(nodes, first.sensitivity(derivative), progress)
        derivatives[0][1][0] = derivative.v_b  # A solution reports the consistent start.
        return derivatives

    def _estimated(self, solution: Solution, scales: Scales) -> Solution:
        """Return the solution with estimates of its errors, from its accelerations A.

        They replace the accelerations of the recurrence.
        """
        scale = constraint_error(Coefficients(1.0, self.hht_alpha)) * np.diff(solution.t) ** 2
        with np.errstate(over="ignore", invalid="ignore"):
            rise = np.diff(solution.a.real, axis=0)
        errors = estimated_errors(scales, scale, rise, solution.sensitivities)
        return replace(solution, estimated_errors=errors)

    def pull_back(
        self, system: MechanicalSystem, solution: Solution, seeds: Seeds, progress: bool = False
    ) -> Array:
        """Return the gradient of an objective, (n_b,), by the discrete adjoint."""
        first, nodes = self._opened(system, solution)
        gradient, back, _ = linear_passes.pull_back(nodes, seeds, progress=progress)
        return through_start(nodes.problem, first, back, seeds, gradient)

    def replay(self, system: MechanicalSystem, t_end: float) -> Replay:
        """Return the run to `t_end` (s) in parts; its steps must be known in advance."""
        t = self._known_instants(t_end)
        newton = self.newton_tolerance, self.max_iterations
        steps = Steps(self.steps.sizes(t), self.hht_alpha)
        problem = InitialValueProblem.of(system.in_all_states(), t_end)
        return Replay(problem, steps, t, newton)

    def discretisation_error(
        self, system: MechanicalSystem, solution: Solution, seeds: Seeds
    ) -> float:
        """Return the estimated change of an objective if the steps had no `Defects`; its unit."""
        first, nodes = self._opened(system, solution)
        defects = Defects.of(solution.t, solution.a, nodes.steps)
        _, back, change = linear_passes.pull_back(nodes, seeds, defects)
        return change - float(back.v_b @ first.dv)

    def _opened(
        self, system: MechanicalSystem, solution: Solution
    ) -> tuple[RecurrenceStart, Nodes]:
        """Return the start of the recurrence and the nodes of a run, for a pass over it."""
        # The length of a run with one time point does not matter.
        steps = Steps(self.sizes(solution), self.hht_alpha)
        problem = InitialValueProblem.of(system, float(solution.t[-1]) or 1.0, solution.q)
        first = RecurrenceStart.of(problem, steps.of(1))
        return first, Nodes(problem, solution, steps, first.node)
