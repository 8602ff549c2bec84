"""Derivatives from whole runs at perturbed designs: finite differences, and the complex step.

Finite differences are the check that the paper uses; the complex step gives derivatives of the
discrete solution to round-off.
"""

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.derived import design_sizes
from ancfdae.equations.solution import Solution
from ancfdae.equations.solution_parts import Sensitivities
from ancfdae.errors.checks import require_flag, require_kind, require_positive
from ancfdae.errors.kinds import InvalidInputError, UnknownNameError
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.threads import in_one_thread
from ancfdae.sensitivity.method import Gradient, Method, Run, require_differentiable
from ancfdae.sensitivity.objectives import Objective

_STATES = ("q", "v", "a", "lam")


class Perturbation(Method):
    """Method that runs at the design, and once or more with each design variable perturbed."""

    @abc.abstractmethod
    def check(self, run: Run) -> None:
        """Raise InvalidInputError, before the first run, if the method cannot differentiate it."""

    @abc.abstractmethod
    def sizes_of(self, system: MechanicalSystem) -> Array:
        """Return the sizes, (n_b,), to which perturbations of the variables are relative."""

    @abc.abstractmethod
    def changes(self, size: float) -> Sequence[complex]:
        """Return the perturbations of a design variable of this size, one per run."""

    @abc.abstractmethod
    def quotient(self, size: float, base: Array, moved: Sequence[Array]) -> Array:
        """Return the derivative, shape of `base`, from values of unperturbed and perturbed runs."""

    def differentiate(self, run: Run) -> Solution:
        """Return the solution with design derivatives of its trajectory, one variable at a time.

        All trajectories are cut to the shortest one; the outcome is taken from the run that ended
        first.
        """
        self.check(run)
        solution = run.solution()
        changed = [(x, [y.solution() for y in runs]) for x, runs in self._changed(run, solution)]
        every = [solution, *(x for _, moved in changed for x in moved)]
        rows = min(len(x.t) for x in every)
        cut = {name: getattr(solution, name)[:rows] for name in ("t", *_STATES)}
        parts = [np.zeros((*cut[name].shape, len(changed))) for name in _STATES]
        for part, name in zip(parts, _STATES, strict=True):
            for i, (size, moved) in enumerate(changed):
                states = [getattr(x, name)[:rows] for x in moved]
                part[..., i] = self.quotient(size, cut[name], states)
        return replace(
            solution,
            **cut,
            outcome=min((x.outcome for x in every), key=lambda outcome: outcome.step),
            sensitivities=Sensitivities(run.system.design_names, run.system.b, *parts),
        )

    @in_one_thread
    def gradients(self, run: Run, objectives: Sequence[Objective]) -> list[Gradient]:
        """Return value and gradient of every objective from whole runs."""
        self.check(run)
        solution, base = run.values(objectives)
        slopes = np.zeros((len(objectives), run.system.n_b))
        for i, (size, runs) in enumerate(self._changed(run, solution)):
            slopes[:, i] = self.quotient(size, base, [each.values(objectives)[1] for each in runs])
        return [
            Gradient(float(value), slope, run.system.design_names, self, solution)
            for value, slope in zip(base, slopes, strict=True)
        ]

    def _changed(self, run: Run, solution: Solution) -> list[tuple[float, list[Run]]]:
        """Return for every design variable its size, and its perturbed runs."""
        again, b = run.repeating(solution), run.system.b.real
        sizes, along = self.sizes_of(run.system).tolist(), np.eye(len(b))
        return [
            (size, [again.at(b + change * e) for change in self.changes(size)])
            for size, e in zip(sizes, along, strict=True)
        ]


@final
@dataclass(frozen=True)
class FiniteDifference(Perturbation):
    """Gradients by forward or central differences of whole runs.

    Parameters
    ----------
    relative_step : float
        Perturbation of each design variable relative to its value, between 0 and 1; the paper uses
        0.01.
    central : bool
        Whether to use central differences, with two runs per variable in place of one.
    sizes : mapping of str to float, optional
        Sizes, by name of the design variable, to which perturbations are relative in place of the
        values; unit of the variable. A variable that is 0 needs one:
        ``FiniteDifference(sizes={"load.force_x": 10.0})``.
    """

    relative_step: float = 0.01
    central: bool = False
    sizes: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_positive("FiniteDifference.relative_step", self.relative_step)
        require_flag("FiniteDifference.central", self.central)
        if self.relative_step >= 1:
            rule, repair = "must be below 1", "0.01 perturbs by one per cent."
            raise InvalidInputError(
                "FiniteDifference.relative_step", rule, self.relative_step, repair
            )
        where, repair = "FiniteDifference.sizes", "For example {'load.force_x': 10.0}."
        require_kind(where, self.sizes, (Mapping,), repair)
        for name, size in self.sizes.items():
            require_positive(f"{where}[{name!r}]", size)

    def check(self, run: Run) -> None:
        """Raise InvalidInputError for a variable that is zero and has no entry in `sizes`."""
        for name in self.sizes:
            if name not in run.system.design_names:
                raise UnknownNameError("design variable", name, run.system.design_names)
        for name, size in zip(run.system.design_names, self.sizes_of(run.system), strict=True):
            if size == 0:
                raise InvalidInputError(
                    f"design variable {name!r}",
                    "must not be zero, as its perturbation is relative to it",
                    size,
                    f"Say what a change of it is relative to: FiniteDifference(sizes={{{name!r}: "
                    "...}); or use DirectDifferentiation or ComplexStep.",
                )

    def sizes_of(self, system: MechanicalSystem) -> Array:
        """Return the given sizes, or else the values of the variables, shape (n_b,)."""
        values = zip(system.design_names, system.b.real.tolist(), strict=True)
        return np.array([self.sizes.get(name, value) for name, value in values])

    def changes(self, size: float) -> Sequence[complex]:
        """Return the forward perturbation, and for central differences the backward one."""
        step = size * self.relative_step
        return (step, -step) if self.central else (step,)

    def quotient(self, size: float, base: Array, moved: Sequence[Array]) -> Array:
        """Return the derivative, difference of values over the perturbation; shape of `base`."""
        step = size * self.relative_step
        difference = (moved[0] - moved[1]) / 2 if self.central else moved[0] - base
        return np.asarray(difference / step)


@final
@dataclass(frozen=True)
class ComplexStep(Perturbation):
    """Gradients by whole runs at complex design values b_i (1 + i eps), one per variable.

    The imaginary part over eps b_i is the derivative, free of subtraction: an independent check of
    direct differentiation. Needs a system that computes in complex numbers, as every ANCF scene
    does.
    """

    def check(self, run: Run) -> None:
        """Raise InvalidInputError for integrators in real numbers only (IDA, IDAS, DOP853)."""
        if run.integrator.real_only:
            raise InvalidInputError(
                "ComplexStep",
                "needs an integrator that computes in complex numbers",
                repr(run.integrator),
                "Use HHT or Radau, or FiniteDifference().",
            )

    def _changed(self, run: Run, solution: Solution) -> list[tuple[float, list[Run]]]:
        states, errors = (solution.t, solution.q, solution.v), solution.estimated_errors
        require_differentiable(run.system, *states, errors)
        return super()._changed(run, solution)

    def sizes_of(self, system: MechanicalSystem) -> Array:
        """Return the magnitudes of the design variables, (n_b,), with 1 for a zero variable."""
        return design_sizes(system)

    def changes(self, size: float) -> Sequence[complex]:
        """Return the imaginary perturbation of a design variable, far below round-off."""
        return (1j * STEP * size,)

    def quotient(self, size: float, base: Array, moved: Sequence[Array]) -> Array:
        """Return the derivative, imaginary part of the perturbed value over the step; its shape."""
        return np.asarray(moved[0].imag / (STEP * size))
