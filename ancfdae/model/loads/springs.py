"""Springs with dampers: between two points, and elastic bearings (bushings)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.errors.checks import require_axial, require_not_negative, require_vector
from ancfdae.model.bodies import MaterialPoint, Quantity
from ancfdae.model.design import design_numbers
from ancfdae.model.loads.load import LAW_FIELD, Load, require_damping
from ancfdae.model.loads.sections import CarriedAxes, rate_of, section_of, turn
from ancfdae.model.parts import Elements, Stroke, Vectors
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.vector_formulas import concatenate, direction, dot


def _require_length(where: str, value: object) -> None:
    require_not_negative(where, value, "Zero is a spring that pulls its ends together.")


@final
@dataclass(frozen=True)
class SpringDamper(Load):
    """Linear spring and damper along the line between two points.

    With e = r(point) - r(other), l = |e| and n = e/l: F(point) = -(k (l - l_0) + c l') n, and
    the opposite on the other point. Design targets: ``stiffness``, ``damping``,
    ``free_length``, and ``ground_x`` ... where `ground` is given.

    Parameters
    ----------
    point : MaterialPoint
    stiffness : float
        k; N/m. May be negative, for example for a spring that pushes away from its centre position.
    damping : float
        c, not negative; N s/m.
    free_length : float
        l_0, not negative; m.
    other : MaterialPoint, optional
    ground : sequence of float, optional
        Position on the ground; m. Give either `other` or `ground`.
    """

    point: MaterialPoint
    stiffness: float
    damping: float = 0.0
    free_length: float = 0.0
    other: MaterialPoint | None = None
    ground: Sequence[float] | None = None

    sharp = False
    stores = True
    kind = "spring"
    stroke = Stroke.SPRING
    elastic = True
    design_fields = (
        *design_numbers("stiffness"),
        ("damping", require_damping),
        ("free_length", _require_length),
        ("ground", require_vector),
        LAW_FIELD,
    )
    damping_fields = ("damping",)
    needs_other_end = True

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vectors that the force acts on: the positions of the points."""
        return tuple((point, Quantity.POSITION) for point in self.points)

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return -(k (l - l_0) + c l') n on the first point, and the opposite on the second; N."""
        k, damping, free_length, ground, _ = self.split(p)
        e, w = U[..., :1, :], V[..., :1, :]
        e, w = (e - ground, w) if self.other is None else (e - U[..., 1:, :], w - V[..., 1:, :])
        l, n = direction(e)
        F = -(k * (l - free_length) + damping * dot(n, w)) * n
        return F if self.other is None else concatenate([F, -F])

    def energy(self, U: Any, p: Array, U_o: Array) -> Any:
        """Return the elastic energy k (l - l_0)^2/2, shape (k,); J."""
        k, _, free_length, ground, _ = self.split(p)
        e = U[..., :1, :] - (ground if self.other is None else U[..., 1:, :])
        return (k * (direction(e)[0] - free_length) ** 2 / 2)[..., 0, 0]


@final
@dataclass(frozen=True)
class Bushing(Load):
    """Linear springs and dampers along and about axes, unloaded in the reference configuration.

    With x_m the component of r(point) - r(other) along axis m, beyond its reference value, and
    theta_m the angle about it (docs/theory/03-joints-and-loads.md): forces -(k_m x_m + c_m x_m')
    and torques -(k_m theta_m + c_m theta_m'). The axes are x, y and z of the reference; they rotate
    with the section of `other`. Angles stay well below pi. Design targets: ``stiffness_x`` ...,
    ``damping_x`` ..., and in space ``turn_stiffness_x`` ..., ``turn_damping_x`` ..., in the plane
    ``turn_stiffness`` and ``turn_damping``.

    Parameters
    ----------
    point : MaterialPoint
    stiffness : sequence of float
        Stiffness k_m along each axis, may be negative; N/m.
    damping : sequence of float, optional
        Damping c_m along each axis, not negative; N s/m.
    turn_stiffness, turn_damping : float or sequence of float, optional
        One number in the plane, a sequence of three in space, about x, y and z; N m/rad and
        N m s/rad. Damping is not negative.
    other : MaterialPoint, optional
        Body to which the bearing is fixed; the ground by default.
    """

    point: MaterialPoint
    stiffness: Sequence[float]
    damping: Sequence[float] | None = None
    turn_stiffness: float | Sequence[float] | None = None
    turn_damping: float | Sequence[float] | None = None
    other: MaterialPoint | None = None

    sharp = False
    stores = True
    kind = "bushing"
    elastic = True
    design_fields = (
        ("stiffness", require_vector),
        ("damping", require_vector),
        ("turn_stiffness", require_axial),
        ("turn_damping", require_axial),
        LAW_FIELD,
    )
    vector_words: ClassVar[Mapping[str, str]] = {
        "turn_stiffness": "turn_stiffness",
        "turn_damping": "turn_damping",
    }
    damping_fields = ("damping", "turn_damping")
    refers = True

    def __post_init__(self) -> None:
        super().__post_init__()
        for field in self.damping_fields:
            for name, value in self.numbers_of(field).items():
                require_damping(f"load {self.name!r}, {name}", value)

    def vectors(self, elements: Elements) -> Vectors:
        """Return the positions of the points and the slopes of their sections."""
        places = tuple((point, Quantity.POSITION) for point in self.points)
        return (*places, *section_of(self.points, elements))

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return the forces of springs and dampers on the vectors.

        They are -(k x + c x') x_U - (k theta + c theta') theta_U with the displacement x and the
        angle theta of the section at `point` relative to the section of `other`.
        """
        k, c, k_turn, c_turn, _ = self.split(p)
        n = len(self.points)
        F = -_resistance(*self._travel(U[..., None, :, :], U_o), V, k, c)
        turning = turn(U[..., n:, :], U_o[n:], np.eye(3))
        M = -_resistance(*turning, V[..., n:, :], k_turn, c_turn)
        return concatenate([F[..., :n, :], F[..., n:, :] + M])

    def energy(self, U: Any, p: Array, U_o: Array) -> Any:
        """Return the sum of k x^2/2 and k theta^2/2 over the axes, shape (k,); J."""
        k, _, k_turn, _, _ = self.split(p)
        n = len(self.points)
        travels = self._travel(U[..., None, :, :], U_o)[0][..., 0, 0]
        angles = turn(U[..., n:, :], U_o[n:], np.eye(3))[0][..., 0, 0]
        total = np.sum(k * travels**2, axis=-1) / 2
        return total if k_turn is None else total + np.sum(k_turn * angles**2, axis=-1) / 2

    def _travel(self, U: Any, U_o: Array) -> tuple[Any, Any]:
        """Return components of r - r_other minus the reference, (..., d, 1, 1), and gradients."""
        d, n = U_o.shape[1], len(self.points)
        rows, carrier = np.eye(d)[:, None, :], CarriedAxes(U[..., n + d - 1 :, :], U_o[n + d - 1 :])
        axes = carrier.of(rows) + 0.0 * U[..., :1, :]
        still = 0.0 * (U[..., n : n + d - 1, :] + axes)
        if self.other is None:
            x = dot(U[..., :1, :] - U_o[:1], axes)
            return x, concatenate([axes, still])
        e, e_o = U[..., :1, :] - U[..., 1:2, :], U_o[:1] - U_o[1:2]
        on_axes = carrier.pull_back(rows, e + 0.0 * axes)
        return dot(e, axes) - dot(e_o, rows), concatenate([axes, -axes, still, on_axes])


def _resistance(x: Any, x_U: Any, V: Any, k: Any, c: Any) -> Any:
    """Return the sum over the axes of a bushing of (k x + c x') x_U: minus its force."""
    total = 0.0 * x
    if k is not None:
        total = total + np.reshape(k, (-1, 1, 1)) * x
    if c is not None:
        total = total + np.reshape(c, (-1, 1, 1)) * rate_of(x_U, V[..., None, :, :])
    return (total * x_U).sum(axis=-3)
