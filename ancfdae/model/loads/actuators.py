"""Actuators with a state: a motor with inductance, and a force or torque with a lag."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from ancfdae.errors.checks import require_direction, require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.design import design_numbers
from ancfdae.model.laws.law import Law, require_law
from ancfdae.model.loads.controller import (
    ControlAxis,
    Controller,
    ControllerInput,
    RotationAxis,
    TranslationAxis,
)
from ancfdae.model.loads.load import LAW_FIELD
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class DCMotor(Controller):
    """A direct-current motor about an axis: its winding has a resistance and an inductance.

    u is the voltage and w the speed of the section at `point`, as a revolute joint turns it. The
    state ``current`` i obeys L i' = u - R i - k w. The torque is k i, and the opposite acts on
    `other`. Design targets: ``resistance``, ``inductance``, ``torque_constant``,
    ``initial_current``, ``axis_x`` ..., and the parameters of the law.

    Parameters
    ----------
    point : MaterialPoint
    voltage : Law
        u; V.
    resistance : float
        R, positive; ohm.
    inductance : float
        L, positive; H.
    torque_constant : float
        k, of the torque and of the back electromotive force, not zero; N m/A, the same as V s/rad.
    initial_current : float, optional
        i at t = 0; A.
    axis, other
        As in `MotorTorque`.
    """

    point: MaterialPoint
    voltage: Law
    resistance: float
    inductance: float
    torque_constant: float
    initial_current: float = 0.0
    axis: Sequence[float] | None = None
    other: MaterialPoint | None = None

    kind = "dc-motor"
    states = ("current",)
    design_fields = (
        ("voltage", require_law),
        ("resistance", require_positive),
        ("inductance", require_positive),
        *design_numbers("torque_constant", "initial_current"),
        ("axis", require_direction),
        LAW_FIELD,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.torque_constant == 0:
            where, repair = f"load {self.name!r}, torque_constant", "Give it in N m/A."
            raise InvalidInputError(where, "must not be zero", self.torque_constant, repair)

    def axes(self, p: Array) -> tuple[RotationAxis, ...]:
        """Return the axis of the motor: the angle of the shaft."""
        return (RotationAxis(self.point, self.split(p)[5], self.other),)

    def start(self, p: Array) -> Sequence[Any]:
        """Return the current at t = 0; A."""
        return [self.split(p)[4]]

    def equations(self, at: ControllerInput, p: Array) -> tuple[Sequence[Any], Sequence[Any]]:
        """Return i' = (u - R i - k w) / L, A/s, and the torque k i, N m."""
        _, resistance, inductance, k, *_ = self.split(p)
        current = at.states[0]
        return [(at.laws[0] - resistance * current - k * at.rates[0]) / inductance], [k * current]


@final
@dataclass(frozen=True)
class FirstOrderLag(Controller):
    """A torque or force that follows its command with a lag of first order.

    The state ``effort`` x obeys x' = (c - x) / tau with the command c. Without `direction` it is a
    torque on the section at `point` about an axis, with it a force on `point` along this direction;
    the opposite acts on `other`. Design targets: ``time_constant``, ``initial_effort``, ``axis_x``
    ..., ``direction_x`` ..., and the parameters of the law.

    Parameters
    ----------
    point : MaterialPoint
    command : Law
        c; N m or N.
    time_constant : float
        tau, positive; s.
    initial_effort : float, optional
        x at t = 0; N m or N.
    direction : sequence of float, optional
        Direction of the force in the reference configuration; it rotates with `other`.
    axis, other
        As in `MotorTorque`; not `axis` with a direction.
    """

    point: MaterialPoint
    command: Law
    time_constant: float
    initial_effort: float = 0.0
    direction: Sequence[float] | None = None
    axis: Sequence[float] | None = None
    other: MaterialPoint | None = None

    kind = "lag"
    states = ("effort",)
    design_fields = (
        ("command", require_law),
        ("time_constant", require_positive),
        *design_numbers("initial_effort"),
        ("direction", require_direction),
        ("axis", require_direction),
        LAW_FIELD,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.direction is not None and self.axis is not None:
            where = f"load {self.name!r}, axis"
            rule, repair = "must be left out where a direction is given", "Leave one of them out."
            raise InvalidInputError(where, rule, self.axis, repair)

    def axes(self, p: Array) -> tuple[ControlAxis, ...]:
        """Return one axis: an angle about `axis`, or a displacement along `direction`."""
        *_, direction, axis, _ = self.split(p)
        if direction is None:
            return (RotationAxis(self.point, axis, self.other),)
        return (TranslationAxis(self.point, direction, self.other),)

    def start(self, p: Array) -> Sequence[Any]:
        """Return the effort at t = 0; N m or N."""
        return [self.split(p)[2]]

    def equations(self, at: ControllerInput, p: Array) -> tuple[Sequence[Any], Sequence[Any]]:
        """Return x' = (c - x) / tau and the effort x, N m or N."""
        effort = at.states[0]
        return [(at.laws[0] - effort) / self.split(p)[1]], [effort]
