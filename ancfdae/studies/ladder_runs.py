"""Runs of one rung of a ladder: steps halved until they err little."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import final

import numpy as np

from ancfdae.assembly import assemble
from ancfdae.equations import MechanicalSystem
from ancfdae.errors import InvalidInput
from ancfdae.integrators import HHT
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import timed
from ancfdae.sensitivity import UnfinishedRun
from ancfdae.sensitivity.objectives import Objective
from ancfdae.studies.calls import evaluate, gradient, simulate
from ancfdae.studies.error_bars import bars
from ancfdae.studies.ladder_result import KINDS, Rung, RungRun, error

# Share of the tolerance that the step of the finest run may take, or the last doubled mesh.
_SHARE = 1 / 8
# A model that errs by more needs its value no better than to this share of that.
_KNOWN = 1 / 8
# Steps of the first run; shorter runs than so many seconds are timed thrice.
_FIRST, _SHORT = 32, 0.05
# Runs whose differences show the order.
_SEEN = 3


@final
@dataclass(frozen=True)
class Question:
    """What is asked of every rung; `scale` has 1 and the values of the design variables."""

    objective: Objective
    t_end: float
    design: tuple[DesignVariable, ...]
    scale: Array
    tolerance: float
    max_steps: int

    def numbers(self, system: MechanicalSystem, integrator: HHT) -> Array:
        """Return what `RungRun` holds; derivatives are zero in variables that a rung lacks."""
        numbers = np.zeros(len(self.scale))
        if not system.n_b:
            solution = simulate(system, self.t_end, integrator)
            numbers[0] = evaluate(self.objective, solution, system)
            return numbers
        answer = gradient(system, self.objective, self.t_end, integrator)
        names = [variable.name for variable in self.design]
        numbers[0] = answer.value
        numbers[[1 + names.index(name) for name in answer.names]] = answer.gradient
        return numbers * self.scale

    def is_small(self, difference: Array, at: Array, richest: Rung | None) -> bool:
        """Whether an error is small beside the tolerance, or what the model neglects there."""
        exact = at if richest is None else richest.numbers
        return all(
            error(difference, exact, of)
            <= max(_SHARE * self.tolerance, _KNOWN * error(at - exact, exact, of))
            for of in KINDS
        )

    def settled_mesh(self, rungs: Sequence[Rung], richest: Rung) -> bool:
        """Whether the last of some meshes of a model needs no finer one."""
        if len(rungs) < 2 or not (rungs[-1].runs and rungs[-2].runs):
            return False
        fine, coarse = rungs[-1].numbers, rungs[-2].numbers
        return self.is_small(fine - coarse, fine, richest)


def refined_runs(
    model: Scene, design: Sequence[DesignVariable], question: Question, richest: Rung | None
) -> tuple[tuple[RungRun, ...], Array]:
    """Return runs from the longest step to one that errs little, and the bar of that.

    A run that costs more than the best one of the richest model is the last.

    Raises
    ------
    InvalidInput, UnfinishedRun
        If the model does not have what is asked for, or runs do not get to the end.
    """
    system, runs = assemble(model, design), list[RungRun]()
    steps, left = _FIRST, None
    while steps <= question.max_steps:
        try:
            if not runs:  # What a system makes at first use is not to be timed.
                question.numbers(system, HHT(question.t_end / steps))
            step = question.t_end / steps
            run = partial(question.numbers, system, HHT(step))
            runs.append(RungRun(step, *timed(run, 3, long=_SHORT)))
        except UnfinishedRun as failed:
            left = failed
        dear = runs and richest is not None and runs[-1].seconds > richest.runs[-1].seconds
        if len(runs) >= _SEEN and (
            dear or question.is_small(_bar(runs), runs[-1].numbers, richest)
        ):
            break
        steps *= 2
    if len(runs) < _SEEN:
        raise left or InvalidInput(
            "max_steps", "must be 128 at least", question.max_steps, "Raise it."
        )
    return tuple(runs), _bar(runs)


def _bar(runs: Sequence[RungRun]) -> Array:
    return bars(np.diff([run.numbers for run in runs[-_SEEN:]], axis=0), HHT.order)[0]
