"""Base class of controllers: loads with states of their own, x' = f(x, s, s', r, r', b).

A controller measures coordinates s of the mechanism (`ControlAxis`) and laws of time r, and acts on
the same coordinates with efforts e(x, s, s', r, r', b): torques and forces. Each state x is the
rate of a coordinate y of its own with a mass w. So w y'' = w f is one of the equations of motion,
for all integrators, sensitivity methods and kernels (docs/theory/17-controllers.md).
"""

from __future__ import annotations

import abc
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.laws.law import Law
from ancfdae.model.loads.control_axes import ControlAxis
from ancfdae.model.loads.load import Load
from ancfdae.model.loads.sections import rate_of
from ancfdae.model.parts import Elements, StateVector, Vectors
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.jets import concatenate


@final
class ControllerInput(NamedTuple):
    """Input of the equations of a controller at one time; each field has one number per item.

    Attributes
    ----------
    states : tuple
        x, in the order of `Controller.states`.
    coordinates, rates : tuple
        s and s' of the axes; rad and rad/s, or m and m/s.
    laws, law_rates : tuple
        r and r' of the laws among the fields of the controller, in their order.
    """

    states: tuple[Array, ...]
    coordinates: tuple[Array, ...]
    rates: tuple[Array, ...]
    laws: tuple[Array, ...]
    law_rates: tuple[Array, ...]


@dataclass(frozen=True)
class Controller(Load):
    """A load with states: x' = f(x, s, s', r, r', b), with torques and forces of the same inputs.

    A subclass names its `states`, and writes `axes`, `equations` and, where states do not start
    from zero, `start`. Its fields that hold a `Law` are the laws r. It has no factor ``law``.
    """

    refers = True

    def __post_init__(self) -> None:
        super().__post_init__()
        where = f"load {self.name!r}"
        if self.law is not None:
            rule = "must be left out: a controller has no factor over time"
            repair = "Give a law as a field that `equations` reads."
            raise InvalidInputError(f"{where}, law", rule, repr(self.law), repair)
        if len(set(self.states)) < len(self.states):
            rule, repair = "must have different names", "Rename one of them."
            raise InvalidInputError(f"{where}, states", rule, self.states, repair)

    @final
    def numbers_of(self, name: str) -> dict[str, float]:
        """Return the numbers of a design field; of one of several laws by its field and theirs."""
        numbers = super().numbers_of(name)
        laws = [field for field, value in self._design_values() if isinstance(value, Law)]
        if len(laws) < 2 or name not in laws:
            return numbers
        return {f"{name}_{inner}": number for inner, number in numbers.items()}

    @abc.abstractmethod
    def axes(self, p: Array) -> tuple[ControlAxis, ...]:
        """Return the coordinates that the controller measures and drives; p as in `Load.force`."""

    @abc.abstractmethod
    def equations(self, at: ControllerInput, p: Array) -> tuple[Sequence[Any], Sequence[Any]]:
        """Return the rates x' of the states, and an effort on each axis; N m or N.

        In functions of NumPy. p has the values of `parameters`, as `split` takes them.
        """

    def start(self, p: Array) -> Sequence[Any]:
        """Return the states at t = 0; by default zero."""
        return [0.0] * len(self.states)

    @final
    def initial_states(self, p: Array) -> Sequence[Any]:
        """Return the states at t = 0, one number each, as the method `start` gives them."""
        given = tuple(self.start(p))
        self._require("start", given, self.states, "initial states", "state")
        return given

    def uses_velocity(self, driven: Collection[str]) -> bool:
        """Return true: states are velocities."""
        return True

    @final
    def vectors(self, elements: Elements) -> Vectors:
        """Return the vectors of the axes, and a vector for each state."""
        states = (StateVector(self.name, k) for k in range(len(self.states)))
        axes = self.axes(self._declared_values())
        if not all(isinstance(axis, ControlAxis) for axis in axes):
            where, repair = f"axes of {self.kind} {self.name!r}", "Return (RotationAxis(point),)."
            raise InvalidInputError(where, "must return axes", repr(axes), repair)
        of_axes = (axis.vectors(elements) for axis in axes)
        return (*(vector for some in of_axes for vector in some), *states)

    @final
    def signals(self, p: Array, t: Array, order: int) -> Array:
        """Return the laws and behind them their rates, or time derivatives of these, (k, n)."""
        values = zip(self._design_values(), self.split(p), strict=True)
        laws = [(x, its) for (_, x), its in values if isinstance(x, Law)]
        columns = [x.derivative(its, t, order + k) for k in (0, 1) for x, its in laws]
        if order == 0:
            self.check_laws([np.real(column) for column in columns[: len(laws)]])
        return np.stack(columns, axis=-1) if columns else np.zeros((len(t), 0))

    def check_laws(self, laws: Sequence[Array]) -> None:
        """Warn of values of laws that the equations do not expect; by default none."""
        return

    @final
    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return `force_at` with the laws as they are at t = 0."""
        return self.force_at(U, V, self.signals(p, np.zeros(1), 0), p, U_o)

    @final
    def force_at(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> Any:
        """Return e s_U on the vectors of the axes, and x' on component 0 of vectors of states."""
        still = 0.0 * V[..., :1, :1]
        at, gradients = self._input(U, V, signals, p, U_o)
        rates, efforts = (tuple(x) for x in self.equations(at, p))
        self._require("equations", rates, self.states, "rates of states", "state")
        self._require("equations", efforts, gradients, "efforts", "axis")
        unit = np.eye(U_o.shape[1])[:1]
        forces = [effort * s_U for effort, s_U in zip(efforts, gradients, strict=True)]
        return concatenate([*forces, *((still + rate) * unit for rate in rates)])

    def _require(
        self, method: str, given: Sequence[Any], wanted: Sequence[Any], what: str, each: str
    ) -> None:
        """Raise InvalidInputError unless a method returns as many numbers as are wanted."""
        if len(given) != len(wanted):
            where = f"{method} of {self.kind} {self.name!r}"
            rule, repair = f"must return {len(wanted)} {what}", f"Return one for each {each}."
            raise InvalidInputError(where, rule, len(given), repair)

    def _declared_values(self) -> Array:
        return np.array(list(self.parameters().values()), dtype=float)

    @final
    def efforts_at(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> tuple[Any, ...]:
        """Return the efforts on the axes, (..., 1, 1) each."""
        at, _ = self._input(U, V, signals, p, U_o)
        return tuple(self.equations(at, p)[1])

    def _input(
        self, U: Any, V: Any, signals: Any, p: Array, U_o: Array
    ) -> tuple[ControllerInput, list[Any]]:
        """Return the input of the equations, (..., 1, 1) each, and the gradients of the axes."""
        coordinates, rates, gradients, first = [], [], [], 0
        for axis in self.axes(p):
            count = axis.count(U_o.shape[1])
            its = slice(first, first + count)
            s, s_U = axis.coordinate(U[..., its, :], U_o[its])
            coordinates.append(s)
            rates.append(rate_of(s_U, V[..., its, :]))
            gradients.append(s_U)
            first += count
        n_x, n_r = len(self.states), signals.shape[-1] // 2
        x = tuple(V[..., first + k : first + k + 1, :1] for k in range(n_x))
        r = tuple(signals[..., k, None, None] for k in range(2 * n_r))
        at = ControllerInput(x, tuple(coordinates), tuple(rates), r[:n_r], r[n_r:])
        return at, gradients
