"""Direct differentiation (eqs. 21-25) and the discrete adjoint, its transpose.

**With a memory limit** the adjoint integrates parts of the run again. The run is divided into
parts. The forward pass stores checkpoints, the states at the start of some parts; the backward pass
repeats each part from the last checkpoint before it. Which checkpoints to store, and which parts to
repeat, is the schedule of Griewank & Walther (revolve, ACM TOMS 26, 2000) by the library
`checkpoint_schedules`, with the least repetitions for the number of checkpoints.
"""

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution import Solution
from ancfdae.errors.checks import require_package, require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.integrators.integrator import AdjointIntegrator, PartwiseIntegrator, RunInParts, Seeds
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.threads import in_one_thread
from ancfdae.numerics.time_grid import TimeGrid
from ancfdae.sensitivity.method import (
    Gradient,
    GradientMethod,
    Method,
    Run,
    finished,
    keeping,
    require_differentiable,
)
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.objectives.objective import require_finite_number
from ancfdae.sensitivity.objectives.reductions import Reduction
from ancfdae.sensitivity.observables.expression import evaluated, leaf_weights, leaves
from ancfdae.sensitivity.observables.observable import States, remembered, states_of


@final
@dataclass(frozen=True)
class DirectDifferentiation(Method):
    """Gradients by direct differentiation of the discrete equations, step by step.

    The result is the exact derivative of the discrete solution; all design variables are right-hand
    sides of one factorisation per step.
    """

    def differentiate(self, run: Run) -> Solution:
        """Return the motion of the run with its design derivatives."""
        return run.solution(sensitivities=True)

    @in_one_thread
    def gradients(self, run: Run, objectives: Sequence[Objective]) -> list[Gradient]:
        """Return value and gradient of every objective by one run and one forward pass (eq. 21)."""
        solution, totals = run.integrals(objectives, differentiated=True, sensitivities=True)
        states, s = states_of(solution), solution.sensitivities
        assert s is not None
        results = []
        for objective in objectives:
            p = objective.partials(run.system, states, totals)
            total = p.b
            for rows, x_b in ((p.q, s.q_b), (p.v, s.v_b), (p.lam, s.lam_b)):
                if rows is not None:
                    total = total + np.tensordot(rows, x_b, axes=2)
            results.append(Gradient(p.value, total, run.system.design_names, self, solution))
        return results


@final
@dataclass(frozen=True)
class Adjoint(GradientMethod):
    """Gradients by the discrete adjoint: one forward run, then one backward pass per objective.

    The backward pass is the transpose of the recurrence of direct differentiation, so the two agree
    to round-off at any step size. Its cost grows little with the number of design variables: report
    `performance` measures it with six variables and with a thousand.

    Parameters
    ----------
    memory : str or float, optional
        Memory limit for stored states, for example ``"200 MB"``, or a number of bytes. If the run
        needs more, as few parts of it as possible are integrated again during the backward pass
        (docs/theory/08-adjoint.md). For `HHT` and `Radau` at steps that are known in advance. With
        events also under error control; the parts are then the phases between events.
    """

    memory: str | float | None = None

    def __post_init__(self) -> None:
        if self.memory is not None:
            size_of(self.memory)

    def __repr__(self) -> str:
        return f"Adjoint(memory={self.memory!r})" if self.memory is not None else "Adjoint()"

    @property
    def takes_runs(self) -> bool:
        """Whether an existing run can be reused: False with `memory`, which repeats parts of it."""
        return self.memory is None

    @in_one_thread
    def gradients(self, run: Run, objectives: Sequence[Objective]) -> list[Gradient]:
        """Return value and gradient of every objective by one run and a backward pass for each."""
        system, integrator = run.system, run.integrator
        if not isinstance(integrator, AdjointIntegrator):
            rule, repair = (
                "needs an integrator with an adjoint",
                "Use HHT, Radau or IDAS, or DirectDifferentiation().",
            )
            raise InvalidInputError("Adjoint", rule, repr(integrator), repair)
        if self.memory is not None:
            return checkpointed_gradients(run, objectives, self, size_of(self.memory))
        solution, totals = run.integrals(objectives, differentiated=True)
        results = []
        factorised = integrator.back_factorisations(solution)
        for objective in objectives:
            started = time.perf_counter()
            partials = objective.partials(system, states_of(solution), totals)
            seeds = Seeds(partials.q, partials.v, partials.lam, partials.densities)
            with keeping(solution):
                total = partials.b + integrator.pull_back(system, solution, seeds, run.progress)
            seconds = time.perf_counter() - started
            done = solution.with_pass(factorised, seconds)
            results.append(Gradient(partials.value, total, system.design_names, self, done))
        return results


# -- parts of a run ----------------------------------------------------------------------------


_UNITS = {"B": 1, "kB": 10**3, "MB": 10**6, "GB": 10**9}
#: Memory of a part over the memory of its states: states, their partials, and intermediate results.
COPIES = 3


def size_of(memory: str | float) -> float:
    """Return a size in bytes from a number or a text such as ``"200 MB"``."""
    rule, repair = "must be a size", 'For example "200 MB"; units are B, kB, MB and GB.'
    if not isinstance(memory, str):
        require_positive("memory", memory)
        return float(memory)
    match = re.fullmatch(r"\s*([0-9.eE+]+)\s*([kMG]?B)\s*", memory)
    try:
        number = float(match[1]) if match else 0.0
    except ValueError:
        number = 0.0
    if not match or not 0 < number < np.inf:
        raise InvalidInputError("memory", rule, repr(memory), repair)
    return number * _UNITS[match[2]]


@in_one_thread
def checkpointed_gradients(
    run: Run, objectives: Sequence[Objective], method: GradientMethod, memory: float
) -> list[Gradient]:
    """Return value and gradient of every objective; `memory`, bytes, limits the stored states.

    The solution of the results is the last part of the run; its statistics count repeated steps.
    """
    system, integrator = run.system, run.integrator
    if not (
        isinstance(integrator, PartwiseIntegrator) and isinstance(integrator, AdjointIntegrator)
    ):
        rule = "needs an integrator that can take parts of its runs again, such as HHT"
        repair = "Use HHT(step=...) or Radau(step=...), or leave it out."
        raise InvalidInputError("memory", rule, repr(integrator), repair)
    started, replay = time.perf_counter(), integrator.replay(system, run.t_end)
    length, kept = division(system, len(replay.t) - 1, memory, replay.degree)
    watched = [
        _Watched(system, objective, TimeGrid(replay.t, replay.degree)) for objective in objectives
    ]
    backward = _Backward(system, replay, length, watched)
    for action in schedule(-(-(len(replay.t) - 1) // length), kept):
        backward.follow(action)
    solution, seconds = backward.last, time.perf_counter() - started
    done = replace(solution.statistics, steps=replay.taken, wall_seconds=seconds)
    solution = replace(solution, statistics=done)
    return [Gradient(x.value, x.gradient, system.design_names, method, solution) for x in watched]


def division(
    system: MechanicalSystem, steps: int, memory: float, degree: int = 1
) -> tuple[int, int]:
    """Return the number of time points in a part and of checkpoints; each gets half of the memory.

    One part holds the whole run, without repetition, if the memory suffices. Steps of `degree` time
    points stay whole; a checkpoint holds all states of one step.
    """
    number = np.dtype(float).itemsize
    row = number * COPIES * (3 * system.n_q + system.n_lam + 1)
    node = number * degree * (4 * system.n_q + system.n_lam + 1)
    if row * (steps + 1) <= memory:
        return steps, 1
    length, kept = int(memory / 2 // row) - 1, int(memory / 2 // node)
    length -= length % degree
    if length < 1:
        rule = f"must be {2 * (degree + 1) * row / 1e6:.3g} MB or more for {system.n_q} coordinates"
        repair = "Omit it to store the whole run."
        raise InvalidInputError("memory", rule, f"{memory / 1e6:.3g} MB", repair)
    return length, min(kept, -(-steps // length))


def schedule(parts: int, kept: int) -> Any:
    """Return the Revolve schedule for `parts` parts of a run and `kept` stored checkpoints."""
    library = require_package("memory", "checkpoint_schedules", "checkpoints")
    return library.Revolve(parts, kept)


@final
class _Watched:
    """An objective whose observables are evaluated part by part along a run."""

    def __init__(self, system: MechanicalSystem, objective: Objective, grid: TimeGrid) -> None:
        self._system, self._objective, self._grid = system, objective, grid
        self._values = {
            x: np.zeros(len(grid.t)) for x in cast("list[Reduction]", leaves(objective))
        }
        self._slopes: dict[Reduction, Array] = {}
        # Values that observables with a memory, such as counts of turns, have where a part starts.
        self._past: dict[int, dict[object, float]] = {0: {}}
        self.value, self.gradient = 0.0, np.zeros(system.n_b)
        self.on: Array | None = None

    def look(self, states: States, first: int) -> None:
        """Store the values of the observables at the time points from index `first` on."""
        require_differentiable(self._system, states.t, states.q, states.v)
        states, last = replace(states, past=self._past[first]), first + len(states.t) - 1
        self._past[last] = {}
        for leaf, values in self._values.items():
            nodes = leaf.observable.node_values(self._system, states)
            values[first : last + 1] = list(nodes.values())[-1]
            self._past[last] |= remembered(nodes)

    def close(self) -> None:
        """Compute the objective from the values at all time points, and its derivative in each."""
        values, grid = self._values, self._grid
        nodes = evaluated(self._objective, lambda leaf: leaf.of_values(values[leaf], grid))
        value = list(nodes.values())[-1]
        require_finite_number("the value", value)
        self.value = float(value)
        for leaf, weight in leaf_weights(nodes, np.ones(())).items():
            require_finite_number("the derivative", weight)
            reduction = cast(Reduction, leaf)
            self._slopes[reduction] = weight * reduction.slopes_of_values(values[reduction], grid)

    def seeds(self, states: States, first: int) -> Seeds:
        """Return partials of the objective in the states of the part that starts at index `first`.

        Its partials in the design variables are added to `gradient`. The first time point of a part
        is left out, since it is the last one of the part before.
        """
        states = replace(states, past=self._past[first])
        total: dict[str, Array | None] = dict.fromkeys(("q", "v", "lam"))
        for leaf, all_slopes in self._slopes.items():
            slopes = all_slopes[first : first + len(states.t)].copy()
            slopes[: first > 0] = 0.0
            nodes = leaf.observable.node_values(self._system, states)
            p = leaf.pulled_back(self._system, states, nodes, slopes)
            self.gradient = self.gradient + p.b.sum(axis=0)
            for name, so_far in total.items():
                partial: Array | None = getattr(p, name)
                if partial is not None:
                    total[name] = partial if so_far is None else so_far + partial
        return Seeds(total["q"], total["v"], total["lam"])


@final
class _Backward:
    """Executes a checkpoint schedule; `last` is the solution of the last part of the run."""

    last: Solution

    def __init__(
        self, system: MechanicalSystem, replay: RunInParts, length: int, watched: list[_Watched]
    ) -> None:
        self._system, self._replay, self._watched = system, replay, watched
        self._ends = [*range(0, len(replay.t) - 1, length), len(replay.t) - 1]
        self._node, self._kept, self._seen = replay.start(), dict[int, Any](), 0
        # The part that the backward pass needs next, with the checkpoint at its start.
        self._held: tuple[Solution, Any] | None = None

    def follow(self, action: Any) -> None:
        """Execute an action of `checkpoint_schedules`: step, store, restore or pull back."""
        match type(action).__name__, action.args:
            case "Forward", (begin, end, keep, hold, _):
                if keep:
                    self._kept[begin] = self._node
                for k in range(begin, end):
                    self._forward(k, hold)
            case "EndForward", _:
                for x in self._watched:
                    x.close()
            case "Reverse", (end, begin, _):
                assert end == begin + 1
                self._reverse(begin)
            case "Copy", (k, _, _):
                self._node = self._kept[k]
            case "Move", (k, _, _):
                self._node = self._kept.pop(k)

    def _forward(self, k: int, hold: bool) -> None:
        from ancfdae.modes.analysis import advised

        first, begin = self._ends[k], self._node
        solution, self._node = self._replay.part(begin, first, self._ends[k + 1])
        finished(advised(self._system, solution))
        if hold:
            self._held = solution, begin
        if k == self._seen:
            self._seen, self.last = k + 1, solution
            for x in self._watched:
                x.look(states_of(solution), first)

    def _reverse(self, k: int) -> None:
        assert self._held is not None
        (solution, begin), self._held = self._held, None
        with keeping(solution):
            for x in self._watched:
                seeds = x.seeds(states_of(solution), self._ends[k])
                on = self._replay.no_covectors() if x.on is None else x.on
                gradient, x.on = self._replay.pull_back(solution, begin, self._ends[k], seeds, on)
                x.gradient = x.gradient + gradient
                if k == 0:
                    x.gradient = self._replay.close(x.on, seeds, x.gradient)
