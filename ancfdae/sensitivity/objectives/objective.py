"""Base class of objectives: one number per run, Psi(b) of eq. (20), with partials in the states."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.kinds import AncfdaeError
from ancfdae.integrators.integrand import Density
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


@final
class NonFiniteObjectiveError(AncfdaeError):
    """An objective, or its derivative, that is not a finite number.

    `time` is the first instant at which its observable is not finite; None if every observable is
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

    The design derivative of the objective is
    sum_n (q[n] . q_b[n] + v[n] . v_b[n] + lam[n] . lam_b[n]) + b, plus that through the states of
    the integrals taken beside the motion, where these were integrated without sensitivities.

    Row n of q, v and lam is the derivative in the state at instant n, quadrature weights included;
    None if the objective does not depend on it. b, (n_b,), is that in the design variables with the
    states of the instants held, `densities` are weights and partials of these integrals.
    """

    value: float
    q: Array | None
    v: Array | None
    lam: Array | None
    b: Array
    densities: tuple[tuple[float, Density], ...] = ()


class Integrated(abc.ABC):
    """An objective whose integral the integrator took beside the motion."""

    @abc.abstractmethod
    def value(self) -> float:
        """Return the value of the integral over the run; see `Objective.value`."""

    @abc.abstractmethod
    def partials(self) -> ObjectivePartials:
        """Return the partials; b is the total derivative if sensitivities were integrated."""


Totals = Mapping[object, Integrated]
NO_TOTALS: Totals = {}


class Objective(Expression["Objective"]):
    """One number per run.

    Objectives combine by + - * / ** and elementary NumPy functions with each other and with
    numbers into objectives.
    """

    def of(self, function: Function, operands: tuple[object, ...]) -> Objective:
        """Return a function of objectives as an objective."""
        return Combination(function, operands)

    def accepts(self, other: object) -> bool:
        """Whether the other expression is an objective."""
        return isinstance(other, Objective)

    @abc.abstractmethod
    def check(self, system: MechanicalSystem, t_end: float) -> None:
        """Refuse, before anything is integrated, what a run to `t_end` cannot yield."""

    @abc.abstractmethod
    def value(self, system: MechanicalSystem, states: States, totals: Totals = NO_TOTALS) -> Any:
        """Return the value: a float, or a complex number for complex states or design values.

        `totals` has the objectives whose integrals the integrator took; the others are sums over
        the states. Raises NonFiniteObjectiveError.
        """

    @abc.abstractmethod
    def partials(
        self, system: MechanicalSystem, states: States, totals: Totals = NO_TOTALS
    ) -> ObjectivePartials:
        """Return value and partials at real states, or raise NonFiniteObjectiveError."""


@final
@dataclass(frozen=True, eq=False)
class Combination(Operation, Objective):
    """A function of objectives."""

    def check(self, system: MechanicalSystem, t_end: float) -> None:
        """Check every objective in it."""
        for objective in self._leaves():
            objective.check(system, t_end)

    def value(self, system: MechanicalSystem, states: States, totals: Totals = NO_TOTALS) -> Any:
        """Evaluate every objective in it once."""
        nodes = evaluated(self, lambda leaf: np.asarray(leaf.value(system, states, totals)))
        value = list(nodes.values())[-1]
        require_finite_number("the value", value)
        return value.item()

    def partials(
        self, system: MechanicalSystem, states: States, totals: Totals = NO_TOTALS
    ) -> ObjectivePartials:
        """Chain rule over the objectives in it."""
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
    """Refuse a value of a function of objectives, or a derivative, that is no number."""
    if not np.isfinite(x):
        raise NonFiniteObjectiveError("function of objectives", what, None)
