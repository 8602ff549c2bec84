"""Controllers: loads with states of their own, x' = f(x, s, s', r, r', b), and a PID of an angle.

A controller measures coordinates s of the mechanism (`ControlAxis`), an angle of a section or a
displacement of a point, and laws of time r. It acts on the same coordinates with efforts e(x, s,
s', r, r', b): torques and forces. Each state x is the rate of an additional coordinate y with a
mass w. So w y'' = w f is one of the equations of motion, for all integrators, sensitivity methods
and kernels (docs/theory/17-controllers.md).
"""

from __future__ import annotations

import abc
import math
import warnings
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np

from ancfdae.errors.checks import require_direction
from ancfdae.errors.kinds import InvalidInputError, UnlikelyValueWarning
from ancfdae.model.bodies import MaterialPoint, Quantity, require_point
from ancfdae.model.design import design_numbers
from ancfdae.model.laws.law import Law, require_law
from ancfdae.model.loads.load import LAW_FIELD, Load
from ancfdae.model.loads.sections import rate_of, section_of, travel, turn, unit_axes
from ancfdae.model.parts import Elements, StateVector, Vectors
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.vector_formulas import concatenate


class ControlAxis(abc.ABC):
    """Base class of coordinates s that a controller measures and acts on with an effort.

    An effort e, a torque or a force, does the work e ds: the forces on the vectors U of its points
    are e s_U.
    """

    @abc.abstractmethod
    def vectors(self, elements: Elements) -> Vectors:
        """Return the vectors of points that the coordinate s depends on."""

    @abc.abstractmethod
    def count(self, d: int) -> int:
        """Return the number of vectors that the coordinate depends on in d dimensions."""

    @abc.abstractmethod
    def coordinate(self, U: Any, U_o: Array) -> tuple[Any, Any]:
        """Return the coordinate s, (..., 1, 1), and its gradient s_U, (..., n_vectors, d).

        U are the vectors and U_o the vectors in the reference configuration, where s is zero.
        """


def _require_points(where: str, point: object, other: object) -> None:
    """Raise InvalidInputError unless both are material points; `other` may be None."""
    require_point(f"{where}, point", point)
    if other is not None:
        require_point(f"{where}, other", other)


def _require_components(where: str, value: object, sizes: tuple[int, ...]) -> None:
    """Raise InvalidInputError unless `value` is an array with one of these sizes."""
    given = np.asarray(value)
    if given.dtype.kind not in "iufc" or given.ndim != 1 or len(given) not in sizes:
        rule = f"must be an array of {' or '.join(map(str, sizes))} numbers"
        raise InvalidInputError(where, rule, repr(value), "For example np.array([1.0, 0.0, 0.0]).")


@final
@dataclass(frozen=True)
class RotationAxis(ControlAxis):
    """The angle of a section about an axis, from the reference, between -pi and pi; rad.

    Its effort is a torque, in N m. The angle jumps at half a turn; its rate does not.

    Parameters
    ----------
    point : MaterialPoint
    axis : array, shape (3,), optional
        Axis in space, in the reference configuration; it rotates with `other`. z by default.
    other : MaterialPoint, optional
        Section that the angle counts from and that takes the opposite torque; ground by default.
    """

    point: MaterialPoint
    axis: Array | None = None
    other: MaterialPoint | None = None

    def __post_init__(self) -> None:
        _require_points("RotationAxis", self.point, self.other)
        if self.axis is not None:
            _require_components("RotationAxis, axis", self.axis, (3,))

    def vectors(self, elements: Elements) -> Vectors:
        """Return the slopes that span the sections of `point` and `other`."""
        points = (self.point,) if self.other is None else (self.point, self.other)
        return section_of(points, elements)

    def count(self, d: int) -> int:
        """Return the number of slopes: d - 1 for each section."""
        return (d - 1) * (1 if self.other is None else 2)

    def coordinate(self, U: Any, U_o: Array) -> tuple[Any, Any]:
        """Return the angle, (..., 1, 1), rad, and its gradient in the slopes."""
        angle, gradient = turn(U, U_o, unit_axes(self.axis))
        return angle[..., 0, :, :], gradient[..., 0, :, :]


@final
@dataclass(frozen=True)
class TranslationAxis(ControlAxis):
    """The displacement of a point along a direction since the reference; m. Its effort is a force.

    Parameters
    ----------
    point : MaterialPoint
    direction : array, shape (d,)
        Direction in the reference configuration; it rotates with the section of `other`.
    other : MaterialPoint, optional
        Point that the displacement counts from and that takes the opposite force; ground by
        default.
    """

    point: MaterialPoint
    direction: Array
    other: MaterialPoint | None = None

    def __post_init__(self) -> None:
        _require_points("TranslationAxis", self.point, self.other)
        _require_components("TranslationAxis, direction", self.direction, (2, 3))

    def vectors(self, elements: Elements) -> Vectors:
        """Return the positions of the points, and the slopes that span the section of `other`."""
        others = () if self.other is None else (self.other,)
        places = tuple((point, Quantity.POSITION) for point in (self.point, *others))
        return (*places, *section_of(others, elements))

    def count(self, d: int) -> int:
        """Return the number of vectors: one position, or two positions and d - 1 slopes."""
        return 1 if self.other is None else d + 1

    def coordinate(self, U: Any, U_o: Array) -> tuple[Any, Any]:
        """Return the displacement, (..., 1, 1), m, and its gradient in positions and slopes."""
        return travel(U, U_o, self.direction, self.other is not None)


# -- controllers -------------------------------------------------------------------------------


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
    has_efforts = True

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
        """Return the numbers of a design field by name.

        If there are several laws, the numbers of each begin with the name of its field.
        """
        numbers = super().numbers_of(name)
        laws = [field for field, value in self._design_values() if isinstance(value, Law)]
        if len(laws) < 2 or name not in laws:
            return numbers
        return {f"{name}_{inner}": number for inner, number in numbers.items()}

    @abc.abstractmethod
    def axes(self, p: Array) -> tuple[ControlAxis, ...]:
        """Return the coordinates that the controller measures and acts on; p as in `Load.force`."""

    @abc.abstractmethod
    def equations(self, at: ControllerInput, p: Array) -> tuple[Sequence[Any], Sequence[Any]]:
        """Return the rates x' of the states, and one effort per axis; N m or N.

        The formulas use functions of NumPy. p holds the values of `parameters`, as `split` takes
        them.
        """

    def start(self, p: Array) -> Sequence[Any]:
        """Return the states at t = 0, zero by default."""
        return [0.0] * len(self.states)

    @final
    def initial_states(self, p: Array) -> Sequence[Any]:
        """Return the states at t = 0, one number each, as `start` gives them."""
        given = tuple(self.start(p))
        self._require("start", given, self.states, "initial states", "state")
        return given

    def uses_velocity(self, driven: Collection[str]) -> bool:
        """Return true: the states are velocities of additional coordinates."""
        return True

    @final
    def vectors(self, elements: Elements) -> Vectors:
        """Return the vectors of the axes, and one vector for each state."""
        states = (StateVector(self.name, k) for k in range(len(self.states)))
        axes = self.axes(np.array(list(self.parameters().values()), dtype=float))
        if not all(isinstance(axis, ControlAxis) for axis in axes):
            where, repair = f"axes of {self.kind} {self.name!r}", "Return (RotationAxis(point),)."
            raise InvalidInputError(where, "must return axes", repr(axes), repair)
        of_axes = (axis.vectors(elements) for axis in axes)
        return (*(vector for some in of_axes for vector in some), *states)

    @final
    def signals(self, p: Array, t: Array, order: int) -> Array:
        """Return the laws and their rates, or a time derivative of these, shape (k, n)."""
        values = zip(self._design_values(), self.split(p), strict=True)
        laws = [(x, its) for (_, x), its in values if isinstance(x, Law)]
        columns = [x.derivative(its, t, order + k) for k in (0, 1) for x, its in laws]
        if order == 0:
            self.check_laws([np.real(column) for column in columns[: len(laws)]])
        return np.stack(columns, axis=-1) if columns else np.zeros((len(t), 0))

    def check_laws(self, laws: Sequence[Array]) -> None:
        """Warn of law values that the equations do not expect; by default no check."""
        return

    @final
    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return `force_at` with the laws at their values at t = 0."""
        return self.force_at(U, V, self.signals(p, np.zeros(1), 0), p, U_o)

    @final
    def force_at(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> Any:
        """Return efforts times ds/dU as forces on the axes' vectors, and rates of the states."""
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
        """Raise InvalidInputError unless a controller's method returns `wanted` values."""
        if len(given) != len(wanted):
            where = f"{method} of {self.kind} {self.name!r}"
            rule, repair = f"must return {len(wanted)} {what}", f"Return one for each {each}."
            raise InvalidInputError(where, rule, len(given), repair)

    @final
    def effort_count(self, p: Array) -> int:
        """Return the number of efforts, one per axis."""
        return len(self.axes(p))

    @final
    def efforts_at(self, U: Any, V: Any, signals: Any, p: Array, U_o: Array) -> tuple[Any, ...]:
        """Return the efforts on the axes, shape (..., 1, 1) each; N m or N."""
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


@final
@dataclass(frozen=True)
class PID(Controller):
    """A proportional-integral-derivative controller of an angle, by a torque on it.

    theta is the angle of the section at `point`, as a joint turns it, and r its reference. The
    torque is P e + I z + D e' with the error e = r - theta and the state ``integral`` z, z' = e.
    It acts on the section, and its opposite on `other`. The angle counts from the reference
    configuration and lies between -pi and pi. Design targets: ``proportional``, ``integral``,
    ``derivative``, ``axis_x`` ..., and the parameters of the law.

    Parameters
    ----------
    point : MaterialPoint
    reference : Law
        r; rad.
    proportional : float
        P; N m/rad.
    integral : float
        I; N m/(rad s).
    derivative : float
        D; N m s/rad.
    axis, other
        As in `MotorTorque`.
    """

    point: MaterialPoint
    reference: Law
    proportional: float
    integral: float = 0.0
    derivative: float = 0.0
    axis: Sequence[float] | None = None
    other: MaterialPoint | None = None

    kind = "pid"
    states = ("integral",)
    design_fields = (
        ("reference", require_law),
        *design_numbers("proportional", "integral", "derivative"),
        ("axis", require_direction),
        LAW_FIELD,
    )

    def axes(self, p: Array) -> tuple[RotationAxis, ...]:
        """Return the axis of the controller: the angle of the section at `point`."""
        return (RotationAxis(self.point, self.split(p)[4], self.other),)

    def equations(self, at: ControllerInput, p: Array) -> tuple[Sequence[Any], Sequence[Any]]:
        """Return z' = e and the torque P e + I z + D e'."""
        _, proportional, integral, derivative, *_ = self.split(p)
        e, e_t = at.laws[0] - at.coordinates[0], at.law_rates[0] - at.rates[0]
        return [e], [proportional * e + integral * at.states[0] + derivative * e_t]

    def check_laws(self, laws: Sequence[Array]) -> None:
        """Warn of a reference that the angle, between -pi and pi, cannot reach."""
        if np.max(np.abs(laws[0]), initial=0.0) > math.pi:
            warnings.warn(
                f"reference of pid {self.name!r} is beyond half a turn, where the angle jumps "
                "from pi to -pi: the controlled section does not follow it and may run away. "
                "Let the reference stay within -pi to pi, or turn it back.",
                UnlikelyValueWarning,
                stacklevel=2,
            )
