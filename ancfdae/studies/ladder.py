"""The cheapest model of a scene that is accurate enough: steps halved until they err little."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import final

import numpy as np

from ancfdae.assembly.system import assemble
from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import require_count, require_flag, require_kind, require_positive
from ancfdae.errors.kinds import AncfdaeError, InvalidInputError
from ancfdae.integrators.hht.method import HHT
from ancfdae.model.design import DesignVariable, as_design
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.progress import progress_bar
from ancfdae.numerics.timing import timed
from ancfdae.sensitivity.method import UnfinishedRunError
from ancfdae.sensitivity.objectives import Objective
from ancfdae.studies.calls import differentiable, evaluate, gradient, require_objectives, simulate
from ancfdae.studies.error_bars import MESH_ORDER, bars
from ancfdae.studies.ladder_result import KINDS, ModelComparison, ModelVariant, VariantRun, error
from ancfdae.studies.meshes import Kind, coarsest, known_design, model_kinds, with_mesh

# Share of the tolerance that the step of the finest run may take, or the last doubled mesh.
_SHARE = 1 / 8
# A model that errs by more needs its value no better than to this share of that.
_KNOWN = 1 / 8
# Steps of the first run; runs shorter than _SHORT seconds are timed three times.
_FIRST, _SHORT = 32, 0.05
# Runs whose differences show the order.
_SEEN = 3


@final
@dataclass(frozen=True)
class Question:
    """The task of every model; `scale` has 1 and the values of the design variables."""

    objective: Objective
    t_end: float
    design: tuple[DesignVariable, ...]
    scale: Array
    tolerance: float
    max_steps: int

    def numbers(self, system: MechanicalSystem, integrator: HHT) -> Array:
        """Return value and scaled derivatives; zero for variables that the model lacks."""
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

    def is_small(self, difference: Array, at: Array, richest: ModelVariant | None) -> bool:
        """Whether an error is small against the tolerance, or against the error of the model."""
        exact = at if richest is None else richest.numbers
        return all(
            error(difference, exact, of)
            <= max(_SHARE * self.tolerance, _KNOWN * error(at - exact, exact, of))
            for of in KINDS
        )

    def settled_mesh(self, rungs: Sequence[ModelVariant], richest: ModelVariant) -> bool:
        """Whether the last of some meshes of a model needs no finer one."""
        if len(rungs) < 2 or not (rungs[-1].runs and rungs[-2].runs):
            return False
        fine, coarse = rungs[-1].numbers, rungs[-2].numbers
        return self.is_small(fine - coarse, fine, richest)


def refined_runs(
    model: Scene, design: Sequence[DesignVariable], question: Question, richest: ModelVariant | None
) -> tuple[tuple[VariantRun, ...], Array]:
    """Return runs from the longest step to one that errs little, and the bar of that.

    A run of more work than the best one of the richest model is the last.

    Raises
    ------
    InvalidInputError, UnfinishedRunError
        If the model does not have what is asked for, or runs do not get to the end.
    """
    system, runs = assemble(model, design), list[VariantRun]()
    steps, size, left = _FIRST, system.n_q + system.n_lam, None
    while steps <= question.max_steps:
        try:
            if not runs:  # What a system makes at first use is not to be timed.
                question.numbers(system, HHT(question.t_end / steps))
            step = question.t_end / steps
            run = partial(question.numbers, system, HHT(step))
            runs.append(VariantRun(step, steps * size, *timed(run, 3, long=_SHORT)))
        except UnfinishedRunError as failed:
            left = failed
        dear = runs and richest is not None and runs[-1].work > richest.runs[-1].work
        if len(runs) >= _SEEN and (
            dear or question.is_small(_bar(runs), runs[-1].numbers, richest)
        ):
            break
        steps *= 2
    if len(runs) < _SEEN:
        raise left or InvalidInputError(
            "max_steps", "must be at least 128, for runs of 32, 64 and 128", question.max_steps
        )
    return tuple(runs), _bar(runs)


def _bar(runs: Sequence[VariantRun]) -> Array:
    return bars(np.diff([run.numbers for run in runs[-_SEEN:]], axis=0), HHT.order)[0]


# Share of the tolerance that the mesh of the richest model may take, by which all is measured.
_MESH = 1 / 4


def choose_model(
    scene: Scene,
    objective: Objective,
    t_end: float,
    tolerance: float,
    *,
    design: Sequence[str | DesignVariable],
    alternatives: Mapping[str, Scene] | None = None,
    doublings: int = 1,
    max_steps: int = 8192,
    progress: bool = False,
) -> ModelComparison:
    """Measure which model, mesh and step a value and its gradient need.

    Models are made from the scene: rigid beams, all or all but one; elements with fewer
    coordinates; no damping; each with some numbers of elements. Every one is run with halved steps
    until the step errs little, and compared with the scene as declared on its finest mesh.

    Parameters
    ----------
    scene : Scene
        As rich as makes sense, with elements as one would choose them.
    objective, t_end, design, progress
        As in `gradient`. Errors are relative to the value, which must not vanish.
    tolerance : float
        Relative error that neither the value nor the gradient may exceed; the result tells of
        looser ones too.
    alternatives : mapping of str to Scene, optional
        Models of your own, in which what the objective names has the same name.
    doublings : int
        How often the elements may be doubled to see their error.
    max_steps : int
        Steps of the longest run; what errs more by its step says so in that part.
    """
    require_kind("scene", scene, (Scene,), "Pass a Scene.")
    require_positive("tolerance", tolerance)
    if tolerance > 1:
        rule, repair = (
            "must be at most 1, since it is relative to the result",
            "For example 0.02, for 2 %.",
        )
        raise InvalidInputError("tolerance", rule, tolerance, repair)
    require_count("doublings", doublings, "An error is seen in two meshes.")
    require_count("max_steps", max_steps, "Runs begin with 32 steps.")
    require_flag("progress", progress)
    variables = as_design(design)
    system = differentiable(scene, variables)
    require_objectives(system, [objective], t_end)
    scale = np.append(1.0, np.where(system.b == 0, 1.0, system.b))
    question = Question(objective, t_end, variables, scale, tolerance, max_steps)
    *simpler, declared = model_kinds(scene, alternatives or {})
    with progress_bar(progress, unit="rung") as bar:
        richest = _richest(declared, range(coarsest(scene), doublings + 1), question, bar.update)
        rungs = _simpler(simpler, richest, question, bar.update)
    told = tuple(x for x in (*rungs, *richest) if x.runs or x.level == 0)
    names = tuple(variable.name for variable in variables)
    return ModelComparison(told, names, tolerance, *_mesh_bar(richest))


def _richest(
    declared: Kind, levels: Sequence[int], question: Question, done: Callable[[], object]
) -> list[ModelVariant]:
    """Measure the scene as declared on ever finer meshes, until the mesh errs little."""
    richest = list[ModelVariant]()
    for level in levels:
        richest.append(_rung(declared, level, question, None))
        done()
        if level >= 0 and not richest[-1].runs:
            rule = "must run to t_end on the declared mesh and on finer ones"
            repair = "Find a step that works with simulate(scene, t_end, HHT(step=...))."
            raise InvalidInputError("scene", rule, richest[-1].outcome, repair)
        if level > 0 and _is_fine(richest, question.tolerance):
            break
    return richest


def _simpler(
    kinds: Sequence[Kind],
    richest: Sequence[ModelVariant],
    question: Question,
    done: Callable[[], object],
) -> list[ModelVariant]:
    """Measure simpler models, each on the meshes of the richest until it settles."""
    rungs = list[ModelVariant]()
    for kind in kinds:
        known = len(rungs)
        for like in richest:
            rungs.append(_rung(kind, like.level, question, richest[-1]))
            done()
            if question.settled_mesh(rungs[known:], richest[-1]):
                break
    return rungs


def _rung(kind: Kind, level: int, question: Question, richest: ModelVariant | None) -> ModelVariant:
    """Measure a model on a mesh; one that cannot be is a rung without runs."""
    rung = ModelVariant(kind.name, level, "")
    try:
        declared = kind.build()
        known = known_design(declared, question.design, kind.lacks)
        model, design = with_mesh(declared, known, level)
        rung = replace(rung, scene=model, design=design)
        if level and not rung.elements:
            return replace(rung, outcome="has no mesh")
        runs, bar = refined_runs(model, design, question, richest)
        return replace(rung, runs=runs, bar=bar, outcome="done")
    except AncfdaeError as error:
        return replace(rung, outcome=str(error))


def _mesh_bar(richest: Sequence[ModelVariant]) -> tuple[Array, Array]:
    """Return the bar of the finest mesh, and the orders seen in the last three."""
    numbers = [rung.numbers for rung in richest if rung.runs][-3:]
    return bars(np.diff(numbers, axis=0), MESH_ORDER)


def _is_fine(richest: Sequence[ModelVariant], tolerance: float) -> bool:
    bar, exact = _mesh_bar(richest)[0], richest[-1].numbers
    return all(error(bar, exact, of) <= _MESH * tolerance for of in KINDS)
