"""Forces on points and beams, follower forces, moments, motor torques, torsional springs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from ancfdae.errors.checks import require_axial, require_direction, require_flag, require_vector
from ancfdae.model.bodies import MaterialPoint, Quantity
from ancfdae.model.design import design_numbers
from ancfdae.model.loads.load import LAW_FIELD, ConstantLoad, Load, SectionLoad, require_damping
from ancfdae.model.loads.sections import QUARTER_TURN, rate_of, turn, unit_axes
from ancfdae.model.parts import CentreLine, Elements, Vectors
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.vector_formulas import concatenate, cross, direction, dot


@final
@dataclass(frozen=True)
class PointForce(ConstantLoad):
    """A force on a point, fixed in direction (eq. 11).

    Design targets: ``force_x``, ``force_y``(, ``force_z``).

    Parameters
    ----------
    point : MaterialPoint
    force_vector : sequence of float
        Components in space; N.
    """

    point: MaterialPoint
    force_vector: Sequence[float]

    kind = "force"
    design_fields = (("force_vector", require_vector), LAW_FIELD)

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vector that the force acts on: the position of the point."""
        return ((self.point, Quantity.POSITION),)


@final
@dataclass(frozen=True)
class DistributedForce(ConstantLoad):
    """A force fixed in direction per unit of reference length.

    Design targets: ``force_x``, ``force_y``(, ``force_z``).

    Parameters
    ----------
    beam : str
        Name of the beam.
    force_per_length : sequence of float
        Components in space; N/m.
    """

    beam: str
    force_per_length: Sequence[float]

    kind = "line-load"
    design_fields = (("force_per_length", require_vector), LAW_FIELD)

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vector that the force acts on: the integral of position over the line."""
        return (CentreLine(self.beam),)


@final
@dataclass(frozen=True)
class FollowerForce(Load):
    """A force with given components along the section's axes.

    F = sum_k f_k r_k / |r_k| over the slope vectors r_k of the point. Design targets:
    ``force_x`` (along the beam), ``force_y``(, ``force_z``).

    Parameters
    ----------
    point : MaterialPoint
    force_components : sequence of float
        Components along tangent, height axis(, width axis); N.
    """

    point: MaterialPoint
    force_components: Sequence[float]

    sharp = False
    kind = "follower"
    design_fields = (("force_components", require_vector), LAW_FIELD)

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vectors that the force depends on: position and slopes of the point."""
        return tuple((self.point, quantity) for quantity in list(Quantity)[: elements.d + 1])

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return the force F on the position of the point, and zero on its slopes; N."""
        axes = direction(U[..., 1:, :])[1]
        F = (self.split(p)[0][:, None] * axes).sum(axis=-2, keepdims=True)
        return concatenate([F, 0.0 * axes])


# -- torques -----------------------------------------------------------------------------------


@final
@dataclass(frozen=True)
class Moment(SectionLoad):
    """A moment on a section of a beam.

    It does the work M . dphi on a rotation dphi of the section. The rotation is that of the plane
    of the section, and within this plane the mean rotation of its slopes: with n perpendicular to
    r_y and r_z, and r^y, r^z dual to them in the plane, the force on r_k is (M - (M . n) n / 2) x
    r^k. In a planar scene the section rotates with r_y (a cable, which has none, with its tangent),
    and the force is M x r_y / |r_y|^2 (docs/theory/03-joints-and-loads.md). Cables in space have no
    section on which a moment could act. Design targets: ``moment`` in the plane; ``moment_x``,
    ``moment_y``, ``moment_z`` in space.

    Parameters
    ----------
    point : MaterialPoint
    moment : float or sequence of float
        A number in the plane, from x to y; three components in space; N m.
    follower : bool, optional
        Whether the components are along n and the height and width slopes, and rotate with them,
        instead of being fixed in space. In the plane there is no difference.
    """

    point: MaterialPoint
    moment: float | Sequence[float]
    follower: bool = False

    sharp = False
    kind = "moment"
    design_fields = (("moment", require_axial), LAW_FIELD)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_flag("moment, follower", self.follower)

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return the forces (M - (M . n) n / 2) x r^k of the moment M on the slopes r_k; N."""
        M = self.split(p)[0]
        if U_o.shape[1] == 2:
            return M * (U @ QUARTER_TURN) / dot(U, U)
        r_y, r_z = U[..., :1, :], U[..., 1:, :]
        s, n = direction(cross(r_y, r_z))
        if self.follower:
            axes = concatenate([n, direction(U)[1]])
            M = (M[:, None] * axes).sum(axis=-2, keepdims=True)
        duals = concatenate([cross(r_z, n), cross(n, r_y)]) / s
        return cross(M - 0.5 * dot(M, n) * n, duals)


@final
@dataclass(frozen=True)
class MotorTorque(SectionLoad):
    """A motor: a torque on a section about an axis, and the opposite on another section or ground.

    It does the work T dtheta on the angle between them (docs/theory/03-joints-and-loads.md).
    If the sections rotate about the axis only, as in a revolute joint, the moment is T times the
    axis. Design targets: ``torque``, ``axis_x`` ..., and the parameters of the law.

    Parameters
    ----------
    point : MaterialPoint
    torque : float
        T; N m.
    axis : sequence of float, optional
        Axis in space, in the reference configuration; it rotates with `other`. z by default.
    other : MaterialPoint, optional
        Point of the body that carries the motor; the ground by default.
    """

    point: MaterialPoint
    torque: float
    axis: Sequence[float] | None = None
    other: MaterialPoint | None = None

    sharp = False
    kind = "torque"
    design_fields = (*design_numbers("torque"), ("axis", require_direction), LAW_FIELD)
    refers = True

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return the forces T theta_U on the slopes U of a torque T about the angle theta; N m."""
        torque, axis, _ = self.split(p)
        return (torque * turn(U, U_o, unit_axes(axis))[1])[..., 0, :, :]


@final
@dataclass(frozen=True)
class TorsionalSpringDamper(SectionLoad):
    """Linear spring and damper about an axis between two sections, or a section and the ground.

    The torque on the section is -(k (theta - theta_0) + c theta'), with theta the angle from the
    reference, between -pi and pi (docs/theory/03-joints-and-loads.md). Beyond pi the angle
    continues at -pi: there the torque of the spring jumps, and a run cannot pass. Design targets:
    ``stiffness``, ``damping``, ``free_angle`` and ``axis_x`` ...

    Parameters
    ----------
    point : MaterialPoint
    stiffness : float
        k; N m/rad. It may be negative.
    damping : float
        c, not negative; N m s/rad.
    free_angle : float
        theta_0; rad.
    axis, other
        As in `MotorTorque`; the spring is fixed to the section of `other`, or to the ground.
    """

    point: MaterialPoint
    stiffness: float
    damping: float = 0.0
    free_angle: float = 0.0
    axis: Sequence[float] | None = None
    other: MaterialPoint | None = None

    sharp = False
    kind = "torsion-spring"
    elastic = True
    stores = True
    design_fields = (
        *design_numbers("stiffness"),
        ("damping", require_damping),
        *design_numbers("free_angle"),
        ("axis", require_direction),
        LAW_FIELD,
    )
    damping_fields = ("damping",)
    refers = True

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """Return -(k (theta - theta_0) + c theta') theta_U, the forces on the slopes; N m."""
        k, damping, free_angle, axis, _ = self.split(p)
        theta, theta_U = turn(U, U_o, unit_axes(axis))
        torque = k * (theta - free_angle) + damping * rate_of(theta_U, V[..., None, :, :])
        return -(torque * theta_U)[..., 0, :, :]

    def energy(self, U: Any, p: Array, U_o: Array) -> Any:
        """Return the elastic energy k (theta - theta_0)^2/2, shape (k,); J."""
        k, _, free_angle, axis, _ = self.split(p)
        theta = turn(U, U_o, unit_axes(axis))[0]
        return (k * (theta - free_angle) ** 2 / 2)[..., 0, 0, 0]
