"""Models side by side: what each neglects, what it costs, which is enough.

The error of a run of a rung against the truth of the richest model has four parts, whose sizes are
added: the *model* (the rung's kind and the richest model, each on its finest mesh), the *mesh* (the
rung and its kind on the finest mesh), the *step* (the run and the finest one of the rung, with the
bar of that) and the *reference* (bars of mesh and step of the richest model itself).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final, Literal, final

import numpy as np

from ancfdae.equations.solution_parts import pandas
from ancfdae.errors.checks import require_positive
from ancfdae.errors.kinds import AncfdaeError, InvalidInputError
from ancfdae.errors.text import PrintedTable, TableText, columns
from ancfdae.integrators.hht.method import HHT
from ancfdae.model.design import DesignVariable
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array

ErrorOf = Literal["objective", "gradient"]
KINDS: Final[tuple[ErrorOf, ...]] = ("objective", "gradient")


@final
@dataclass(frozen=True)
class VariantRun:
    """One run of value and gradient.

    Attributes
    ----------
    step : float
        Size of the step; s.
    work : int
        Number of steps times the number of coordinates and multipliers. Choices compare it: it is
        the same in every call, unlike the time that a run takes.
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
        What was exchanged, ``"rigid"`` say.
    level : int
        Binary logarithm of the number of elements over that declared.
    outcome : str
        Why it has no runs, or "done".
    scene : Scene
    design : tuple of DesignVariable
        Those that the model has, with the targets that it has.
    runs : tuple of VariantRun
        From the longest step to the shortest.
    bar : array, shape (1 + n_b,)
        Estimated error of the last run by its step, of each of `numbers`; unit of the objective.
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
        """Value and derivatives times their variables, of the finest run, shape (1 + n_b,)."""
        return self.runs[-1].numbers

    @property
    def elements(self) -> int:
        """Number of elements of the model that deform."""
        beams = () if self.scene is None else self.scene.beams
        return sum(beam.element_count for beam in beams if not beam.rigid)


@final
@dataclass(frozen=True)
class ModelChoice:
    """A rung with a step, and the parts of its relative error in the value or the gradient.

    `of` tells in which: that asked for, or the one with the larger error if both were.
    """

    rung: ModelVariant
    run: VariantRun
    of: ErrorOf
    parts: dict[str, float]

    @property
    def error(self) -> float:
        """Estimated relative error of the chosen model: the sum of `parts`."""
        return sum(self.parts.values())

    def __repr__(self) -> str:
        """Return the model, its step, its cost and what it errs by."""
        shares = ", ".join(f"{name} {size:.1g}" for name, size in self.parts.items())
        return (
            f"{self.rung.name}, {self.rung.elements} elements, step {self.run.step:.3g} s: "
            f"{self.run.seconds:.3g} s, error {self.error:.2g} in the {self.of} ({shares})"
        )


@final
class NoAccurateModelError(AncfdaeError):
    """No model that was measured is accurate enough; `best` is the most accurate one."""

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
    """Rungs of a ladder of models, the richest one last.

    Attributes
    ----------
    rungs : tuple of ModelVariant
    names : tuple of str
        Of the design variables.
    tolerance : float
        Largest relative error that was asked for; dimensionless.
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
        """Return a table of pandas with a row for each run: model, step, cost, error and parts.

        The error is that in the value or the gradient, whichever is larger (``of``).
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
        """Runs of the richest model, against which all others are measured."""
        return self.rungs[-1]

    @property
    def chosen(self) -> ModelChoice:
        """The cheapest within the tolerance in both value and gradient; see `recommend`."""
        return self.recommend(self.tolerance)

    def recommend(self, tolerance: float, of: ErrorOf | None = None) -> ModelChoice:
        """Return the run with the least `work` among those whose errors are within the tolerance.

        Parameters
        ----------
        tolerance : float
            Largest relative error that was asked for; dimensionless.
            Largest relative error, the sum of the parts.
        of : {"objective", "gradient"}, optional
            What must be within the tolerance; by default both the value and the gradient. The
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
        """Return all runs of all rungs with their errors; `of` as in `recommend`."""
        if of is not None and str(of) not in KINDS:
            repair = "Choose one, or leave it out for both."
            raise InvalidInputError("of", f"must be one of {', '.join(KINDS)}", repr(of), repair)
        return [self.choice(rung, run, of) for rung in self.rungs for run in rung.runs]

    def without_influence(self, rung: ModelVariant) -> tuple[str, ...]:
        """Return the variables that the rung's value does not depend on, but the richest's does."""
        lost = (rung.numbers[1:] == 0) & (self.richest.numbers[1:] != 0) if rung.runs else []
        return tuple(name for name, x in zip(self.names, lost, strict=bool(rung.runs)) if x)

    def table(self) -> str:
        """Return all rungs as a table in plain text: errors at their best steps, and costs.

        The step shown is the longest one with which the rung is within the tolerance in both value
        and gradient, or, for a rung that never is, the step with the smallest error.
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
        """Return a run of a rung with the parts of its error; `of` as in `recommend`."""
        exact, numbers = self.richest.numbers, rung.numbers
        finest = max((x for x in self.rungs if x.name == rung.name and x.runs), key=_level)
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


#: Parts of an error, those of the model first.
_PARTS: Final = ("model", "mesh", "step", "reference")


def _asked(of: ErrorOf | None) -> tuple[ErrorOf, ...]:
    return KINDS if of is None else (of,)


def error(difference: Array, exact: Array, of: ErrorOf) -> float:
    """Return a difference of value or gradient relative to the size of the exact one."""
    rows = slice(1) if of == "objective" else slice(1, None)
    size, whole = (float(np.linalg.norm(x[rows])) for x in (difference, exact))
    return size / whole if whole else (np.inf if size else 0.0)


def _level(rung: ModelVariant) -> int:
    return rung.level
