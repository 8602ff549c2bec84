"""Base class of objectives: one number per run, Psi(b) of eq. (20), with partials in the states."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias, cast, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.kinds import AncfdaeError
from ancfdae.integrators.integrator import Density
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.expression import (
    Expression,
    Function,
    Operation,
    evaluated,
    leaf_weights,
    leaves,
)
from ancfdae.sensitivity.observables.observable import States

if TYPE_CHECKING:
    from ancfdae.sensitivity.objectives.reductions import Total


@final
class NonFiniteObjectiveError(AncfdaeError):
    """Raised if an objective, or its derivative, is not a finite number.

    `time` (s) is the first time at which its observable is not finite; None if every observable is
    finite but a function of objectives is not.
    """

    def __init__(self, objective: str, what: str, time: float | None) -> None:
        when = "although its terms are" if time is None else f"at t = {time:.6g}"
        super().__init__(
            f"{objective}: {what} is not finite {when}. Check for divisions by zero, and for "
            "roots, logarithms and powers at the edge of their domain; sqrt(x**2 + eps**2) is "
            "smooth."
        )
        self.time = time


@final
@dataclass(frozen=True)
class ObjectivePartials:
    """Value and partial derivatives of an objective.

    The design derivative of the objective is sum_n (q[n] . q_b[n] + v[n] . v_b[n] + lam[n] .
    lam_b[n]) + b, plus the derivative through the states of integrals taken during the steps, where
    these were integrated without sensitivities.

    Row n of q, v and lam is the derivative in the state at time point n, quadrature weights
    included; None if the objective does not depend on it. b, (n_b,), is the derivative in the
    design variables at fixed states; `densities` are pairs of weight and partials of the integrals
    taken during the steps.
    """

    value: float
    q: Array | None
    v: Array | None
    lam: Array | None
    b: Array
    densities: tuple[tuple[float, Density], ...] = ()


#: Objectives whose integrals the integrator took during its steps, with these integrals.
Totals: TypeAlias = "Mapping[object, Total]"
NO_TOTALS: Totals = {}


class Objective(Expression["Objective"]):
    """A function of a whole run with one number as value.

    Objectives combine by + - * / ** and elementary NumPy functions with each other and with numbers
    into objectives.
    """

    def of(self, function: Function, operands: tuple[object, ...]) -> Objective:
        """Return a function of objectives as an objective."""
        return Combination(function, operands)

    def accepts(self, other: object) -> bool:
        """Return whether `other` is an objective."""
        return isinstance(other, Objective)

    @abc.abstractmethod
    def check(self, system: MechanicalSystem, t_end: float) -> None:
        """Raise, before anything is integrated, if a run to `t_end` (s) lacks the objective."""

    @abc.abstractmethod
    def value(self, system: MechanicalSystem, states: States, totals: Totals = NO_TOTALS) -> Any:
        """Return the value: a float, or a complex number for complex states or design values.

        `totals` holds the objectives whose integrals the integrator took; others are sums over the
        states. Raises NonFiniteObjectiveError.
        """

    @abc.abstractmethod
    def partials(
        self, system: MechanicalSystem, states: States, totals: Totals = NO_TOTALS
    ) -> ObjectivePartials:
        """Return value and partials at real states, or raise NonFiniteObjectiveError."""


@final
@dataclass(frozen=True, eq=False)
class Combination(Operation, Objective):
    """A function of objectives, such as their sum, as an objective."""

    def check(self, system: MechanicalSystem, t_end: float) -> None:
        """Check every objective in this function of objectives against the run."""
        for objective in self._leaves():
            objective.check(system, t_end)

    def value(self, system: MechanicalSystem, states: States, totals: Totals = NO_TOTALS) -> Any:
        """Return the value of the function of objectives, each of them evaluated once."""
        nodes = evaluated(self, lambda leaf: np.asarray(leaf.value(system, states, totals)))
        value = list(nodes.values())[-1]
        require_finite_number("the value", value)
        return value.item()

    def partials(
        self, system: MechanicalSystem, states: States, totals: Totals = NO_TOTALS
    ) -> ObjectivePartials:
        """Return value and partials by the chain rule over the objectives in the function."""
        parts = {leaf: leaf.partials(system, states, totals) for leaf in self._leaves()}
        nodes = evaluated(self, lambda leaf: np.asarray(parts[leaf].value))
        value = list(nodes.values())[-1]
        require_finite_number("the value", value)
        total: dict[str, Array | None] = dict.fromkeys(("q", "v", "lam"))
        b, densities = np.zeros(system.n_b), list[tuple[float, Density]]()
        for leaf, weight in leaf_weights(nodes, np.ones(())).items():
            require_finite_number("the derivative", weight)
            part = parts[cast(Objective, leaf)]
            b = b + weight * part.b
            densities += [(float(weight) * w, density) for w, density in part.densities]
            for name, so_far in total.items():
                partial: Array | None = getattr(part, name)
                if partial is not None:
                    total[name] = weight * partial if so_far is None else so_far + weight * partial
        rows = (total["q"], total["v"], total["lam"])
        return ObjectivePartials(float(value), *rows, b, tuple(densities))

    def _leaves(self) -> list[Objective]:
        return cast("list[Objective]", leaves(self))


def require_finite_number(what: str, x: Array) -> None:
    """Raise NonFiniteObjectiveError unless a value or derivative of a combination is finite."""
    if not np.isfinite(x):
        raise NonFiniteObjectiveError("function of objectives", what, None)
