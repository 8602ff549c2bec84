"""The call that finds the cheapest model of a scene that is accurate enough."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ancfdae.errors import (
    AncfdaeError,
    InvalidInput,
    require_count,
    require_flag,
    require_kind,
    require_positive,
)
from ancfdae.model.design import DesignVariable, as_design
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.progress import progress_bar
from ancfdae.sensitivity.objectives import Objective
from ancfdae.studies.calls import differentiable, require_objectives
from ancfdae.studies.error_bars import MESH_ORDER, bars
from ancfdae.studies.ladder_result import KINDS, ModelLadder, Rung, error
from ancfdae.studies.ladder_runs import Question, refined_runs
from ancfdae.studies.meshes import coarsest, with_mesh
from ancfdae.studies.model_kinds import Kind, known_design, model_kinds

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
) -> ModelLadder:
    """Measure which model, mesh and step a value and its gradient need.

    Models are made from the scene: rigid beams, all or all but one; elements with fewer
    coordinates; no damping; each with some numbers of elements, from a quarter of those declared
    on. Every one is run with halved steps until the step errs little beside the tolerance, and
    compared with the scene as declared on its finest mesh.

    Parameters
    ----------
    scene : Scene
        As rich as makes sense, with elements as one would choose them.
    objective, t_end, design
        As in `gradient`. Errors are relative to the value, which must not vanish.
    tolerance : float
        Relative error of value and gradient that is asked for; the result tells of looser ones too.
    alternatives : mapping of str to Scene, optional
        Models of your own, in which what the objective names has the same name: a planar scene
        for a spatial one, say.
    doublings : int
        How often the elements may be doubled to see their error.
    max_steps : int
        Steps of the longest run; what errs more by its step says so in that part.
    progress : bool
        Whether to show a progress bar.

    Raises
    ------
    InvalidInput
        If the input makes no sense, or the scene as declared gives no gradient.
    """
    require_kind("scene", scene, (Scene,), "Pass a Scene.")
    require_positive("tolerance", tolerance)
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
        richest: list[Rung] = []
        for level in range(coarsest(scene), doublings + 1):
            richest.append(_rung(declared, level, question, None))
            bar.update()
            if level >= 0 and not richest[-1].runs:
                raise InvalidInput("scene", "must run", richest[-1].outcome, "Repair it.")
            if level > 0 and _is_fine(richest, tolerance):
                break
        rungs = list[Rung]()
        for kind in simpler:
            known = len(rungs)
            for like in richest:
                rungs.append(_rung(kind, like.level, question, richest[-1]))
                bar.update()
                if question.settled_mesh(rungs[known:], richest[-1]):
                    break
    told = tuple(x for x in (*rungs, *richest) if x.runs or x.level == 0)
    names = tuple(variable.name for variable in variables)
    return ModelLadder(told, names, tolerance, *_mesh_bar(richest))


def _rung(kind: Kind, level: int, question: Question, richest: Rung | None) -> Rung:
    """Measure a model on a mesh; one that cannot be is a rung without runs."""
    rung = Rung(kind.name, level, "")
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


def _mesh_bar(richest: Sequence[Rung]) -> tuple[Array, Array]:
    """Return the bar of the finest mesh, and the orders seen in the last three."""
    numbers = [rung.numbers for rung in richest if rung.runs][-3:]
    return bars(np.diff(numbers, axis=0), MESH_ORDER)


def _is_fine(richest: Sequence[Rung], tolerance: float) -> bool:
    bar, exact = _mesh_bar(richest)[0], richest[-1].numbers
    return all(error(bar, exact, of) <= _MESH * tolerance for of in KINDS)
