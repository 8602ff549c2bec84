"""Comparison of models of a scene: the cheapest one that is accurate enough.

A rung is a model on a mesh; its steps are halved until their error is small. The error of a run of
a rung relative to the richest model has four parts, whose absolute values are summed: the *model*
(difference of the rung's model and the richest one, each on its finest mesh), the *mesh*
(difference of the rung and its model on the finest mesh), the *step* (difference of the run and the
finest one of the rung, plus the error bar of that) and the *reference* (error bars of mesh and step
of the richest model itself).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final, Literal, final

import numpy as np

from ancfdae.assembly.system import assemble
from ancfdae.equations import MechanicalSystem
from ancfdae.equations.solution_parts import pandas
from ancfdae.errors.checks import require_count, require_flag, require_kind, require_positive
from ancfdae.errors.kinds import AncfdaeError, InvalidInputError
from ancfdae.errors.text import PrintedTable, TableText, columns
from ancfdae.integrators.hht.method import HHT
from ancfdae.model.design import DesignVariable, as_design
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import progress_bar, timed
from ancfdae.sensitivity.method import UnfinishedRunError
from ancfdae.sensitivity.objectives import Objective
from ancfdae.studies.accuracy.bars import MESH_ORDER, convergence_bars, ratio
from ancfdae.studies.calls import differentiable, evaluate, gradient, require_objectives, simulate
from ancfdae.studies.meshes import Kind, coarsest, known_design, model_kinds, with_mesh

ErrorOf = Literal["objective", "gradient"]
KINDS: Final[tuple[ErrorOf, ...]] = ("objective", "gradient")


@final
@dataclass(frozen=True)
class VariantRun:
    """One run of value and gradient with one step.

    Attributes
    ----------
    step : float
        Size of the step; s.
    work : int
        Number of steps times the number of coordinates and multipliers. Choices compare it, because
        unlike processor time it is the same in every call.
    seconds : float
        Measured processor time; s.
    numbers : array, shape (1 + n_b,)
        The value and the derivatives times their variables; unit of the objective.
    """

    step: float
    work: int
    seconds: float
    numbers: Array

    @property
    def integrator(self) -> HHT:
        """The integrator of the run, HHT with its step."""
        return HHT(self.step)


@final
@dataclass(frozen=True)
class ModelVariant:
    """A model on a mesh.

    Attributes
    ----------
    name : str
        Simplification of the model, for example ``"rigid"``.
    level : int
        Binary logarithm of the number of elements over the declared number.
    outcome : str
        Why there are no runs, or "done".
    scene : Scene
    design : tuple of DesignVariable
        The design variables that the model has, with the targets that it has.
    runs : tuple of VariantRun
        Runs from the longest step to the shortest.
    bar : array, shape (1 + n_b,)
        Estimated error of the last run by its step, for each of its `numbers`; unit of the
        objective.
    """

    name: str
    level: int
    outcome: str
    scene: Scene | None = None
    design: tuple[DesignVariable, ...] = ()
    runs: tuple[VariantRun, ...] = ()
    bar: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def numbers(self) -> Array:
        """Value and scaled derivatives (times variables) of the finest run, shape (1 + n_b,)."""
        return self.runs[-1].numbers

    @property
    def elements(self) -> int:
        """Number of flexible elements of the model."""
        beams = () if self.scene is None else self.scene.beams
        return sum(beam.element_count for beam in beams if not beam.rigid)


@final
@dataclass(frozen=True)
class ModelChoice:
    """A model on a mesh with a step, and the parts of its relative error in value or gradient.

    `of` is the kind of error: the one asked for, or the larger one if both were.
    """

    rung: ModelVariant
    run: VariantRun
    of: ErrorOf
    parts: dict[str, float]

    @property
    def error(self) -> float:
        """Estimated relative error of the chosen model and step: the sum of `parts`."""
        return sum(self.parts.values())

    def __repr__(self) -> str:
        """Return the model, its step, its cost and its estimated error as text."""
        shares = ", ".join(f"{name} {size:.1g}" for name, size in self.parts.items())
        return (
            f"{self.rung.name}, {self.rung.elements} elements, step {self.run.step:.3g} s: "
            f"{self.run.seconds:.3g} s, error {self.error:.2g} in the {self.of} ({shares})"
        )


@final
class NoAccurateModelError(AncfdaeError):
    """No measured model is accurate enough; `best` is the most accurate one."""

    def __init__(self, tolerance: float, of: ErrorOf | None, best: ModelChoice) -> None:
        where = " and the ".join(_asked(of))
        super().__init__(
            f"no model reaches an error of {tolerance:.3g} in the {where}; the best is {best}. "
            "Where the mesh is the largest part, raise `doublings`; where the step is, damp the "
            "scene or ask for an integral instead of an instant."
        )
        self.best = best


@final
@dataclass(frozen=True, repr=False)
class ModelComparison(PrintedTable):
    """Models of a scene on several meshes, with their errors and costs, the richest one last.

    Attributes
    ----------
    rungs : tuple of ModelVariant
    names : tuple of str
        Names of the design variables.
    tolerance : float
        Largest admissible relative error (dimensionless).
    mesh_bar, mesh_orders : array, shape (1 + n_b,)
        Estimated error of the richest model by its mesh, unit of the objective, and the orders
        observed in its meshes, nan if there are only two.
    """

    rungs: tuple[ModelVariant, ...]
    names: tuple[str, ...]
    tolerance: float
    mesh_bar: Array
    mesh_orders: Array

    def to_dataframe(self) -> Any:
        """Return a pandas table with a row for each run: model, step, cost, error and its parts.

        The error is the larger one of value and gradient; the column ``of`` says which.
        """
        rows = [
            {
                "model": each.rung.name,
                "elements": each.rung.elements,
                "step": each.run.step,
                "seconds": each.run.seconds,
                "of": each.of,
                "error": each.error,
                **each.parts,
            }
            for each in self.choices()
        ]
        return pandas().DataFrame(rows)

    def _printed(self) -> TableText:
        return "", self._table(), self._foot()

    @property
    def richest(self) -> ModelVariant:
        """The richest model on its finest mesh, with which all others are compared."""
        return self.rungs[-1]

    @property
    def chosen(self) -> ModelChoice:
        """The cheapest run within the tolerance in both value and gradient; see `recommend`."""
        return self.recommend(self.tolerance)

    def recommend(self, tolerance: float, of: ErrorOf | None = None) -> ModelChoice:
        """Return the run with the least `work` whose error is within the tolerance.

        Parameters
        ----------
        tolerance : float
            Largest admissible relative error, the sum of the parts (dimensionless).
        of : {"objective", "gradient"}, optional
            Whether the value or the gradient must be within the tolerance; by default both. The
            choice then has the parts of the larger of the two errors.

        Raises
        ------
        NoAccurateModelError
            If no run is within the tolerance.
        """
        require_positive("tolerance", tolerance)
        choices = self.choices(of)
        enough = [each for each in choices if each.error <= tolerance]
        if not enough:
            raise NoAccurateModelError(tolerance, of, min(choices, key=lambda each: each.error))
        return min(enough, key=lambda each: (each.run.work, each.error))

    def choices(self, of: ErrorOf | None = None) -> list[ModelChoice]:
        """Return all runs of all models with their errors; argument `of` as in `recommend`."""
        if of is not None and str(of) not in KINDS:
            repair = "Choose one, or leave it out for both."
            raise InvalidInputError("of", f"must be one of {', '.join(KINDS)}", repr(of), repair)
        return [self.choice(rung, run, of) for rung in self.rungs for run in rung.runs]

    def without_influence(self, rung: ModelVariant) -> tuple[str, ...]:
        """Return variables that affect the richest model's value but not this simpler model's."""
        lost = (rung.numbers[1:] == 0) & (self.richest.numbers[1:] != 0) if rung.runs else []
        return tuple(name for name, x in zip(self.names, lost, strict=bool(rung.runs)) if x)

    def table(self) -> str:
        """Return all models as a plain-text table: errors at their best steps, and costs.

        The step shown is the longest one with which the model is within the tolerance in both value
        and gradient, or else the step with the smallest error.
        """
        return f"{columns(self._table(), shorten=False)}\n{self._foot()}"

    def _table(self) -> list[list[str]]:
        head = ["model", "elements", *(f"{of}: {part}" for of in KINDS for part in _PARTS[:2])]
        rows = [[*head, "step", "steps err", "seconds", "no influence / outcome"]]
        return rows + [self._cells(rung) for rung in self.rungs]

    def _foot(self) -> str:
        orders = ", ".join(f"{x:.2g}" for x in self.mesh_orders if np.isfinite(x)) or "not seen"
        exact = self.richest.numbers
        bars = ", ".join(f"{of} {error(self.mesh_bar, exact, of):.2g}" for of in KINDS)
        return f"mesh of the last: {bars}; orders {orders}"

    def choice(self, rung: ModelVariant, run: VariantRun, of: ErrorOf | None = None) -> ModelChoice:
        """Return one run of a model with the parts of its error; `of` as in `recommend`."""
        exact, numbers = self.richest.numbers, rung.numbers
        alike = [x for x in self.rungs if x.name == rung.name and x.runs]
        finest = max(alike, key=lambda x: x.level)
        sizes = (
            np.abs(finest.numbers - exact),
            np.abs(numbers - finest.numbers),
            np.abs(run.numbers - numbers) + rung.bar,
            self.mesh_bar + self.richest.bar,
        )
        asked = (
            ModelChoice(
                rung,
                run,
                kind,
                {x: error(y, exact, kind) for x, y in zip(_PARTS, sizes, strict=True)},
            )
            for kind in _asked(of)
        )
        return max(asked, key=lambda each: each.error)

    def _cells(self, rung: ModelVariant) -> list[str]:
        if not rung.runs:
            return [rung.name, str(rung.elements), *["-"] * 7, rung.outcome]
        choices = [self.choice(rung, run) for run in rung.runs]
        enough = [each for each in choices if each.error <= self.tolerance]
        shown = enough[0] if enough else min(choices, key=lambda each: each.error)
        both = [self.choice(rung, shown.run, of).parts for of in KINDS]
        errors = [parts[name] for parts in both for name in _PARTS[:2]]
        run = shown.run
        return [
            rung.name,
            str(rung.elements),
            *(f"{x:.1e}" for x in errors),
            f"{run.step:.3g}",
            f"{shown.parts['step']:.1e}",
            f"{run.seconds:.3g}",
            ", ".join(self.without_influence(rung)),
        ]


#: Parts of an error, first the parts due to the model and its mesh.
_PARTS: Final = ("model", "mesh", "step", "reference")


def _asked(of: ErrorOf | None) -> tuple[ErrorOf, ...]:
    return KINDS if of is None else (of,)


def error(difference: Array, exact: Array, of: ErrorOf) -> float:
    """Return the norm of a difference of value or gradient over the norm of the exact one."""
    rows = slice(1) if of == "objective" else slice(1, None)
    size, whole = (float(np.linalg.norm(x[rows])) for x in (difference, exact))
    return ratio(size, whole)


# -- measurements ------------------------------------------------------------------------------


# Fraction of the tolerance that the step of the finest run, or the last doubled mesh, may take.
_SHARE = 1 / 8
# Fraction of the model's own error below which errors by step and mesh need not be reduced.
_KNOWN = 1 / 8
# Number of steps of the first run; runs shorter than _SHORT seconds are timed three times.
_FIRST, _SHORT = 32, 0.05
# Number of runs whose differences show the order of convergence.
_SEEN = 3


@final
@dataclass(frozen=True)
class Question:
    """Objective and design to compute with every model; `scale` holds 1 and the design values."""

    objective: Objective
    t_end: float
    design: tuple[DesignVariable, ...]
    scale: Array
    tolerance: float
    max_steps: int

    def numbers(self, system: MechanicalSystem, integrator: HHT) -> Array:
        """Return objective and scaled derivatives, (1 + n_b,); 0 for variables a model lacks."""
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
        """Whether an error is small relative to the tolerance, or to the error of the model."""
        exact = at if richest is None else richest.numbers
        return all(
            error(difference, exact, of)
            <= max(_SHARE * self.tolerance, _KNOWN * error(at - exact, exact, of))
            for of in KINDS
        )

    def settled_mesh(self, rungs: Sequence[ModelVariant], richest: ModelVariant) -> bool:
        """Whether the mesh error of a model is so small that no finer mesh is needed."""
        if len(rungs) < 2 or not (rungs[-1].runs and rungs[-2].runs):
            return False
        fine, coarse = rungs[-1].numbers, rungs[-2].numbers
        return self.is_small(fine - coarse, fine, richest)


def refined_runs(
    model: Scene, design: Sequence[DesignVariable], question: Question, richest: ModelVariant | None
) -> tuple[tuple[VariantRun, ...], Array]:
    """Return runs from the longest step to one with a small error, and the error bar of that.

    The last run is one of more work than the best run of the richest model, at most.

    Raises
    ------
    InvalidInputError, UnfinishedRunError
        If the model lacks parts that the objective names, or its runs do not reach the end.
    """
    system, runs = assemble(model, design), list[VariantRun]()
    steps, size, left = _FIRST, system.n_q + system.n_lam, None
    while steps <= question.max_steps:
        try:
            if not runs:  # Preparations of a system on first use are not timed.
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
    return convergence_bars(np.diff([run.numbers for run in runs[-_SEEN:]], axis=0), HHT.order)[0]


# Fraction of the tolerance that the mesh error of the richest model, the reference, may take.
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
    """Compare simpler models, meshes and steps for a value and its gradient.

    Models are made from the scene: rigid beams, all or all but one; elements with fewer
    coordinates; no damping; each with some numbers of elements. Every one is run with halved steps
    until the error of the step is small, and compared with the declared scene on its finest mesh.

    Parameters
    ----------
    scene : Scene
        The most detailed model that makes sense, with a reasonable number of elements.
    objective, t_end, design, progress
        As in `gradient`. Errors are relative to the value, which must not vanish.
    tolerance : float
        Largest admissible relative error of value and gradient (dimensionless); the result can also
        recommend models for looser ones.
    alternatives : mapping of str to Scene, optional
        Further models by name, with the same names for everything that the objective uses.
    doublings : int
        How often the number of elements may be doubled to estimate the error of the mesh.
    max_steps : int
        Largest number of steps of a run; if the step error is then still large, it is in the part
        ``step``.
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
    """Return runs of the declared scene on finer and finer meshes until the mesh error is small."""
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
    """Return runs of simpler models, refined until no finer mesh is needed."""
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
    """Return a model on a mesh with its runs; without runs if it cannot be computed."""
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
    """Return the error bar of the finest mesh, and the orders observed in the last three."""
    numbers = [rung.numbers for rung in richest if rung.runs][-3:]
    return convergence_bars(np.diff(numbers, axis=0), MESH_ORDER)


def _is_fine(richest: Sequence[ModelVariant], tolerance: float) -> bool:
    bar, exact = _mesh_bar(richest)[0], richest[-1].numbers
    return all(error(bar, exact, of) <= _MESH * tolerance for of in KINDS)
