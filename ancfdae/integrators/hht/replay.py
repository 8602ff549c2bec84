"""A run at known steps, taken part by part, forward and backward.

The node that a part begins with is all that Newton's method needs, so that a part is the same
whenever it is taken.
"""

from dataclasses import replace
from typing import final

import numpy as np

from ancfdae.equations.solution import Solution
from ancfdae.integrators.hht import linear_passes
from ancfdae.integrators.hht.equations import (
    Node,
    NodeSensitivity,
    Steps,
    rescaled,
    step_matrices,
)
from ancfdae.integrators.hht.small_steps import Nodes
from ancfdae.integrators.hht.start import RecurrenceStart
from ancfdae.integrators.hht.step import HHTStepper
from ancfdae.integrators.integrator import RunInParts, Seeds
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.start import Covectors, pull_back_start
from ancfdae.integrators.step_control.contracts import Reached, march
from ancfdae.integrators.step_control.planned import StepPlan
from ancfdae.numerics.arrays import Array


@final
class Replay(RunInParts):
    """A run of HHT-I3 at known steps."""

    def __init__(
        self, problem: InitialValueProblem, steps: Steps, t: Array, newton: tuple[float, int]
    ) -> None:
        self._problem, self._steps, self.t, self._newton = problem, steps, t, newton
        self._first = RecurrenceStart.of(problem, steps.of(1))
        self.taken = 0

    def start(self) -> Node:
        """Return the node of the start."""
        return self._first.node

    def part(self, node: Node, first: int, last: int) -> tuple[Solution, Node]:
        """March over a plan of the known steps."""
        recorder, h = SolutionRecorder(self._problem.system, last - first + 1), self._steps.h
        stepper = HHTStepper(self._problem, self._steps.alpha, self._newton, None, recorder)
        recorder.record(*(stepper.recorded((node, None)) if first else stepper.consistent()))
        begun = Reached(first, float(self.t[first]), float(h[max(first - 1, 0)]), (node, None))
        plan = StepPlan(h[:last], self.t[1 : last + 1])
        run, reached = march(stepper, plan, recorder, float(self.t[last]), False, begun)
        self.taken += reached.n - first
        outcome = replace(run.outcome, step=reached.n)
        return replace(run, outcome=outcome), reached.now[0]

    def pull_back(
        self, run: Solution, node: Node, first: int, seeds: Seeds, on: Array
    ) -> tuple[Array, Array]:
        """Run one part of the backward pass; arguments and results of `pull_back_part`."""
        h, alpha, last = self._steps.h, self._steps.alpha, first + len(run.t) - 1
        # The last step of the part hands on to a step of the size of the next.
        matrix = step_matrices(Steps(h[first : last + 1], alpha))[: last - first]
        steps = Steps(h[first:last], alpha)
        begin = rescaled(node, self._steps.ratio(first)) if first else node
        nodes = Nodes(self._problem, run, steps, begin)
        gradient, on, _ = linear_passes.pull_back_part(nodes, seeds, on, matrix)
        return gradient, on

    def close(self, on: Array, seeds: Seeds, gradient: Array) -> Array:
        """Pull back through the start of the recurrence."""
        back = linear_passes.start_covectors(self._steps.of(1), on)
        return through_start(self._problem, self._first, back, seeds, gradient)

    def no_covectors(self) -> Array:
        """Zero adjoint vectors, six for each coordinate, shape (6, n_q)."""
        return np.zeros((6, self._problem.system.n_q))


def through_start(
    problem: InitialValueProblem,
    first: RecurrenceStart,
    back: NodeSensitivity,
    seeds: Seeds,
    gradient: Array,
) -> Array:
    """Add to a gradient what goes through the start of the recurrence."""
    on = first.pull_back(back)
    # What an objective reads at t = 0 is the consistent start, not the shifted one.
    q, v, lam = (
        x if seed is None else x + seed[0]
        for x, seed in ((on.q, seeds.q), (on.v, seeds.v), (on.lam, seeds.lam))
    )
    on = Covectors(q, v, on.a, lam, on.b + gradient)
    return pull_back_start(problem.system, problem.matrices, problem.initial, on)
