"""Mechanical systems that several tests share."""

import warnings

import numpy as np

from ancfdae import (
    Beam,
    Distance,
    InitialVelocity,
    Material,
    Pin,
    RotationDriver,
    Scene,
    SpringDamper,
    assemble,
)
from ancfdae.errors import NotTracedWarning
from ancfdae.extend import FormulaSystem, MechanicalSystem, SystemProperties
from ancfdae.laws import Harmonic
from ancfdae.sections import Rectangle


class CartesianPendulum(MechanicalSystem):
    """Point mass on a rod in Cartesian coordinates; design variables L and g.

    m q'' + Phi_q^T lam = (0, -m g), Phi = (x^2 + y^2 - L^2)/2, m = 1. It starts at the angle
    `angle` from the vertical with the angular velocity `spin`; q_0 depends on L.
    """

    n_q, n_lam = 2, 1
    design_names = ("L", "g")
    constraint_names = ("rod",)
    traits = SystemProperties(constant_mass=True, velocity_forces=False)

    def __init__(self, angle=-np.pi / 2, spin=0.0, b=(1.0, 9.81)):
        self.angle, self.spin, self.b = angle, spin, np.asarray(b)
        self._direction = np.array([np.sin(angle), -np.cos(angle)])
        self._tangent = np.array([np.cos(angle), np.sin(angle)])

    def with_values(self, b):
        return CartesianPendulum(self.angle, self.spin, b)

    def start(self):
        return self.b[0] * self._direction, self.b[0] * self.spin * self._tangent

    def mass(self, q):
        return np.eye(2).ravel()

    def force(self, t, q, v):
        return np.array([0.0, -1.0]) * self.b[1]

    def force_along(self, t, q, v, direction):
        return np.zeros(2)

    def constraint(self, t, q, v=None, a=None, jerk=None):
        if v is None:
            return np.array([(q @ q - self.b[0] ** 2) / 2])
        if a is None:
            return np.array([q @ v])
        if jerk is None:
            return np.array([v @ v + q @ a])
        return np.array([3 * v @ a + q @ jerk])

    def constraint_q(self, t, *motion):
        return motion[-1]


class WhirlingPendulum(CartesianPendulum):
    """A pendulum of varying mass in a wind that pushes across: Q_v is not symmetric."""

    traits = SystemProperties()

    def with_values(self, b):
        return WhirlingPendulum(self.angle, self.spin, b)

    def mass(self, q):
        return super().mass(q) * (2 + q[0])

    def mass_along(self, q, dq):
        return super().mass(q) * dq[0]

    def force(self, t, q, v):
        return super().force(t, q, v) + np.array([v[1], -v[0]])

    def force_along(self, t, q, v, direction):
        return np.array([direction.v[1], -direction.v[0]])


class NeverRight(CartesianPendulum):
    """A pendulum whose force is NaN after the start."""

    def with_values(self, b):
        return NeverRight(self.angle, self.spin, b)

    def force(self, t, q, v):
        return super().force(t, q, v) * (np.nan if t > 0 else 1.0)


class WrittenPendulum(FormulaSystem):
    """`CartesianPendulum` by its physics alone."""

    n_q, n_lam = 2, 1
    design_names = ("L", "g")
    traits = SystemProperties(constant_mass=True, velocity_forces=False)

    def __init__(self, angle=-np.pi / 2, spin=0.0, b=(1.0, 9.81)):
        self.angle, self.spin = angle, spin
        super().__init__(b)

    def with_values(self, b):
        return type(self)(self.angle, self.spin, b)

    def start(self):
        direction = np.array([np.sin(self.angle), -np.cos(self.angle)])
        tangent = np.array([np.cos(self.angle), np.sin(self.angle)])
        return self.b[0] * direction, self.b[0] * self.spin * tangent

    def mass_matrix(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.array([0.0, -1.0]) * self.b[1]

    def position_constraint(self, t, q):
        return np.array([(q @ q - self.b[0] ** 2) / 2])


class CalledPendulum(WrittenPendulum):
    """The same by a force that cannot be traced: it is called with complex numbers."""

    def __init__(self, *values):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotTracedWarning)
            super().__init__(*values)

    def force(self, t, q, v):
        return np.linalg.solve(np.eye(2), super().force(t, q, v))


class GuidedDoublePendulum(FormulaSystem):
    """Double pendulum in absolute angles whose tip is held on a moving vertical line.

    Massless rods of lengths L1 and 0.8 carry point masses 1 and m2 under gravity; both joints are
    damped by c. The tip keeps x = x_0 + A sin(w t), w = 5. It starts at angles -0.4 and 1.1 from
    the vertical; `spin` is the first angular velocity, the second follows from the line.
    M depends on q, Phi on t, and Q holds the quadratic velocity forces.
    """

    n_q, n_lam = 2, 1
    design_names = ("m2", "L1", "c", "A")
    constraint_names = ("line",)
    gravity, second, w, angles = 9.81, 0.8, 5.0, np.array([-0.4, 1.1])

    def __init__(self, spin=0.0, b=(1.5, 1.0, 0.3, 0.1)):
        self.spin = spin
        super().__init__(b)

    def with_values(self, b):
        return type(self)(self.spin, b)

    def tip(self, q):
        return self.b[1] * np.sin(q[0]) + self.second * np.sin(q[1])

    def start(self):
        _, L1, _, A = self.b
        first, second = self.angles
        turning = (A * self.w - L1 * np.cos(first) * self.spin) / (self.second * np.cos(second))
        return self.angles.copy(), np.array([self.spin, turning])

    def mass_matrix(self, q):
        m2, L1, _, _ = self.b
        coupling = m2 * L1 * self.second * np.cos(q[0] - q[1])
        return np.array([[(1 + m2) * L1**2, coupling], [coupling, m2 * self.second**2]])

    def force(self, t, q, v):
        m2, L1, c, _ = self.b
        pull = m2 * L1 * self.second * np.sin(q[0] - q[1])
        joint = c * (v[1] - v[0])
        return np.array(
            [
                -pull * v[1] ** 2 - (1 + m2) * self.gravity * L1 * np.sin(q[0]) - c * v[0] + joint,
                pull * v[0] ** 2 - m2 * self.gravity * self.second * np.sin(q[1]) - joint,
            ]
        )

    def position_constraint(self, t, q):
        return np.array([self.tip(q) - self.tip(self.angles) - self.b[3] * np.sin(self.w * t)])


class HeldDoublePendulum(GuidedDoublePendulum):
    """A `GuidedDoublePendulum` whose guiding line does not move."""

    w = 0.0


class CarAxis(FormulaSystem):
    """Half of a car on a bumpy road (Mazzia & Magherini, Test Set for IVP Solvers, index 3).

    A light rod of length L = 1 with two masses rests on springs of the length L0; the left one ends
    at the origin, where its direction stays across the road, the right one on the road at
    (sqrt(L^2 - y^2), y), y = sin(10 t)/10. Half of eps^2 times the mass M, eps = 0.01, stands
    before the accelerations.
    """

    n_q, n_lam = 4, 2
    design_names = ("L0", "M")
    traits = SystemProperties(constant_mass=True, velocity_forces=False)
    # At t = 3, by the test set.
    published = np.array(
        [0.04934557842755629, 0.4969894602303324, 1.041742524885400, 0.3739110272652214]
    )

    def __init__(self, b=(0.5, 10.0)):
        super().__init__(b)

    def with_values(self, b):
        return CarAxis(b)

    def road(self, t):
        y = np.sin(10 * t) / 10
        return np.array([np.sqrt(1 - y * y), y])

    def start(self):
        L0 = self.b[0]
        return np.array([0.0, L0, 1.0, L0]), np.array([-L0, 0.0, -L0, 0.0])

    def mass_matrix(self, q):
        return self.b[1] * 0.01**2 / 2 * np.eye(4)

    def force(self, t, q, v):
        weight = self.b[1] * 0.01**2 / 2
        springs = []
        for x, y in ((q[0], q[1]), (q[2] - self.road(t)[0], q[3] - self.road(t)[1])):
            pull = self.b[0] / np.sqrt(x * x + y * y) - 1
            springs += [pull * x, pull * y - weight]
        return np.array(springs)

    def position_constraint(self, t, q):
        x, y = self.road(t)
        return np.array([q[0] * x + q[1] * y, (q[0] - q[2]) ** 2 + (q[1] - q[3]) ** 2 - 1])


CHAIN_DESIGN = ("a.height", "b.length", "m.frequency", "s.damping", "d.length", "a.damping_time")


def chain(length=1.0, mass=1.0, time=1.0, design=CHAIN_DESIGN, frequency=4.0):
    """Two damped beams, driven, with curved constraints and a spring-damper; in given units."""
    force, section = mass * length / time**2, Rectangle(0.05 * length, 0.04 * length)
    density, modulus = 4000 * mass / length**3, 1e6 * force / length**2
    soft = Material(density, modulus, 0.3, damping_time=1e-3 * time)
    a = Beam("a", (0, 0), (0.5 * length, 0), 2, section, soft)
    b = Beam("b", (0.5 * length, 0), (1.1 * length, 0), 1, section, soft)
    spring = SpringDamper(
        a.at_end,
        300.0 * force / length,
        5.0 * force * time / length,
        0.2 * length,
        other=b.at(0.6),
        name="s",
    )
    joints = [
        Pin(a.at_start),
        RotationDriver(a.at_start, Harmonic(0.5, frequency / time), name="m"),
        Pin(a.at_end, b.at_start),
        Distance(b.at_end, 0.8 * length, ground=(1.1 * length, 0.8 * length), name="d"),
    ]
    start = [InitialVelocity(name, 2.0 / time, (0, 0)) for name in "ab"]
    gravity = (0, -9.81 * length / time**2)
    scene = Scene([a, b], joints, gravity, start, [spring], project_start=True)
    return assemble(scene, design)
