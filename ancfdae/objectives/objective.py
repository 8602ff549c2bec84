"""What an objective is: one number per run, Psi(b) of eq. (20), with partials in the states."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import Any, cast, final

import numpy as np

from ancfdae.errors import AncfdaeError
from ancfdae.numerics.arrays import Array
from ancfdae.observables import States
from ancfdae.observables.expression import (
    Expression,
    Operation,
    evaluated,
    leaf_weights,
    leaves,
)
from ancfdae.protocol import MechanicalSystem


@final
class NonFiniteObjective(AncfdaeError):
    """An objective, or its derivative, that is not a finite number.

    Attributes
    ----------
    time : float or None
        First instant at which its observable is not finite; None if every observable is finite
        but a function of objectives is not.
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
    sum_n (q[n] . q_b[n] + v[n] . v_b[n] + lam[n] . lam_b[n]) + b.

    Attributes
    ----------
    value : float
    q, v : array, shape (k, n_q), or None
        Row n is the derivative in the state at instant n, quadrature weights included; None if
        the objective does not depend on the argument.
    lam : array, shape (k, n_lam), or None
    b : array, shape (n_b,)
        Derivative in the design variables with the states held.
    """

    value: float
    q: Array | None
    v: Array | None
    lam: Array | None
    b: Array


class Objective(Expression["Objective"]):
    """One number per run.

    Objectives combine by + - * / ** and elementary NumPy functions with each other and with
    numbers into objectives.
    """

    def of(self, operation: Operation) -> Objective:
        """Return an operation on objectives as an objective."""
        return Combination(operation)

    def accepts(self, other: object) -> bool:
        """Whether the other expression is an objective."""
        return isinstance(other, Objective)

    @property
    @abc.abstractmethod
    def over_time(self) -> bool:
        """Whether it is a function of time integrals only, as eq. (20) has it."""

    @abc.abstractmethod
    def check(self, system: MechanicalSystem, t_end: float) -> None:
        """Refuse, before anything is integrated, what a run to `t_end` cannot yield.

        Raises
        ------
        UnknownName
            If an observable names what does not exist.
        InvalidInput
            If an instant lies outside the run, or an axis does not exist.
        """

    @abc.abstractmethod
    def value(self, system: MechanicalSystem, states: States) -> Any:
        """Return the value: a float, or a complex number for complex states or design values.

        Raises
        ------
        NonFiniteObjective
            If it is not finite.
        """

    @abc.abstractmethod
    def partials(self, system: MechanicalSystem, states: States) -> ObjectivePartials:
        """Return value and partials at real states.

        Raises
        ------
        NonFiniteObjective
            If the value is not finite, or there is no derivative.
        """


@final
@dataclass(frozen=True, eq=False)
class Combination(Objective):
    """A function of objectives."""

    operation: Operation

    @property
    def tree(self) -> object:
        """The operation."""
        return self.operation

    @property
    def over_time(self) -> bool:
        """Whether every objective in it is."""
        return all(objective.over_time for objective in self._leaves())

    def check(self, system: MechanicalSystem, t_end: float) -> None:
        """Check every objective in it."""
        for objective in self._leaves():
            objective.check(system, t_end)

    def value(self, system: MechanicalSystem, states: States) -> Any:
        """Evaluate every objective in it once."""
        nodes = evaluated(self.tree, lambda leaf: np.asarray(leaf.value(system, states)))
        value = list(nodes.values())[-1]
        _require_finite_number("the value", value)
        return value.item()

    def partials(self, system: MechanicalSystem, states: States) -> ObjectivePartials:
        """Chain rule over the objectives in it."""
        parts = {leaf: leaf.partials(system, states) for leaf in self._leaves()}
        nodes = evaluated(self.tree, lambda leaf: np.asarray(parts[leaf].value))
        value = list(nodes.values())[-1]
        _require_finite_number("the value", value)
        total: dict[str, Array | None] = dict.fromkeys(("q", "v", "lam"))
        b = np.zeros(system.n_b)
        for leaf, weight in leaf_weights(nodes, np.ones(())).items():
            _require_finite_number("the derivative", weight)
            part = parts[cast(Objective, leaf)]
            b = b + weight * part.b
            for name, so_far in total.items():
                rows: Array | None = getattr(part, name)
                if rows is not None:
                    total[name] = weight * rows if so_far is None else so_far + weight * rows
        return ObjectivePartials(float(value), total["q"], total["v"], total["lam"], b)

    def _leaves(self) -> list[Objective]:
        return cast("list[Objective]", leaves(self.tree))


def _require_finite_number(what: str, x: Array) -> None:
    if not np.isfinite(x):
        raise NonFiniteObjective("function of objectives", what, None)
