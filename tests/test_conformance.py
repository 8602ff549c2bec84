"""`check_system` accepts right systems and convicts wrong ones."""

from dataclasses import replace

import numpy as np
import pytest

from ancfdae import (
    Beam,
    Clamp,
    Conformance,
    Drive,
    FollowerForce,
    Harmonic,
    InvalidInput,
    Material,
    Moment,
    Pin,
    Rectangle,
    RigidMotion,
    Scene,
    SpringDamper,
    assemble,
    check_system,
)
from validation.scenes import crank_slider, pendulum

from mechanisms import CartesianPendulum, GuidedDoublePendulum, WrittenPendulum

# Every partial and every product of the protocol; M, Q, Phi and the start define the others.
DERIVED = [
    "mass_times",
    "mass_b_times",
    "inertia_q",
    "inertia_rate_total",
    "force_q",
    "force_v",
    "force_b",
    "force_total",
    "force_rate",
    "force_rate_total",
    "force_q_times",
    "force_q_times_total",
    "force_q_times_q",
    "pull_back_force_q_times",
    "constraint_q",
    "constraint_b",
    "constraint_force",
    "constraint_force_q",
    "constraint_force_b",
    "constraint_q_times_total",
    "constraint_q_rate",
    "constraint_q_second_rate",
    "velocity_side",
    "velocity_side_total",
    "acceleration_side",
    "acceleration_side_total",
    "jerk_side",
    "jerk_side_total",
    "constraint_force_rate",
    "constraint_force_rate_total",
    "start_b",
    "start_pull_back",
    "linearise",
    "design_partials",
    "pull_back",
]
# Values of the right system; the same arguments come again for every flipped member.
KNOWN, RIGHT = {}, {}


class Flipped(GuidedDoublePendulum):
    """A system in which every partial is nonzero, one of them with the wrong sign."""

    def __init__(self, wrong, spin=0.7, b=(1.5, 1.0, 0.3, 0.1)):
        key = np.asarray(b).tobytes()
        if key not in RIGHT:
            RIGHT[key] = GuidedDoublePendulum(spin, b)
        self.wrong, self.right = wrong, RIGHT[key]
        super().__init__(spin, b)

    def with_values(self, b):
        return Flipped(self.wrong, self.spin, b)


def member(name):
    def call(self, *arguments):
        flat = [x for y in arguments for x in (y if isinstance(y, tuple) else (y,))]
        key = (name, self.b.tobytes(), *(np.asarray(x).tobytes() for x in flat))
        if key not in KNOWN:
            KNOWN[key] = getattr(self.right, name)(*arguments)
        return negative(KNOWN[key]) if name == self.wrong else KNOWN[key]

    return call


def negative(value):
    if isinstance(value, tuple):
        return tuple(-x for x in value)
    if isinstance(value, np.ndarray):
        return -value
    return replace(value, **{name: -array for name, array in vars(value).items()})


for _name in DERIVED:
    setattr(Flipped, _name, member(_name))


def test_unflipped_twin_passes():
    assert check_system(Flipped(None), samples=1).passed


@pytest.mark.parametrize("name", DERIVED)
def test_wrong_sign_of_any_member_is_found(name):
    report = check_system(Flipped(name), samples=1)
    assert any(finding.name.split()[0].rstrip(":,") == name for finding in report.wrong), str(
        report
    )
    with pytest.raises(InvalidInput, match=name):
        report.raise_if_wrong()


def pushed():
    """A beam under loads that turn with it, and a spring."""
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 1, Rectangle(0.1, 0.1), Material(1000.0, 1e6, 0.3))
    loads = [
        FollowerForce(rod.at_end, (1.0, 5.0)),
        Moment(rod.at(0.5), 3.0),
        SpringDamper(rod.at_end, 50.0, ground=(1.0, 1.0)),
    ]
    return Scene([rod], [Clamp(rod.at_start)], loads=loads)


def elbow():
    """Two links with a motor between them: coefficients of products that depend on time."""
    section, soft = Rectangle(0.1, 0.1), Material(1000.0, 1e6, 0.3)
    upper = Beam("upper", (0.0, 0.0), (1.0, 0.0), 1, section, soft)
    fore = Beam("fore", (1.0, 0.0), (1.6, 0.5), 1, section, soft)
    motor = Drive(fore.at_start, Harmonic(0.5, 3.0), other=upper.at_end, name="motor")
    joints = [Clamp(upper.at_start), Pin(fore.at_start, upper.at_end), motor]
    return Scene([upper, fore], joints, project_start=True)


@pytest.mark.parametrize(
    "system",
    [
        CartesianPendulum(-1.0, 2.0),
        CartesianPendulum(),
        WrittenPendulum(-1.0, 2.0),
        GuidedDoublePendulum(1.0),
        assemble(pendulum(start=(RigidMotion("pendulum", 2.0, (0.0, 0.0)),)), ["pendulum.height"]),
        assemble(crank_slider(), ["rod.density"]),
        assemble(pushed(), ["rod.height"]),
        assemble(elbow(), ["motor.amplitude"]),
    ],
    ids=lambda system: type(system).__name__,
)
def test_right_systems_pass(system):
    report = check_system(system, samples=1)
    assert isinstance(report, Conformance)
    assert report.passed, str(report)
    report.raise_if_wrong()
    # Far below the tolerance: it is not what lets them pass.
    assert max(finding.error for finding in report.findings) < 1e-8


class Declared(GuidedDoublePendulum):
    """The double pendulum with declarations of the test's choice."""

    def with_values(self, b):
        return type(self)(self.spin, b)


class ConstantMass(Declared):
    constant_mass = True


class LinearConstraints(Declared):
    linear_constraints = True


class ConstantConstraints(Declared):
    constant_constraints = True


class NoVelocityForces(Declared):
    velocity_forces = False


class Symmetric(Declared):
    symmetric = True


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (ConstantMass, "constant_mass"),
        (LinearConstraints, "linear_constraints"),
        (ConstantConstraints, "constant_constraints"),
        (ConstantConstraints, "constant_constraints, Phi_q"),
        (NoVelocityForces, "velocity_forces"),
        (Symmetric, "symmetric"),
    ],
)
def test_false_declarations_are_found(kind, name):
    assert name in [finding.name for finding in check_system(kind(), samples=1).wrong]


class OffTheRod(CartesianPendulum):
    def start(self):
        q, v = super().start()
        return 1.001 * q, v

    def with_values(self, b):
        return OffTheRod(self.angle, self.spin, b)


class WrongShape(CartesianPendulum):
    def constraint_b(self, q, t):
        return np.zeros(2)


class Forgetful(CartesianPendulum):
    def with_values(self, b):
        return CartesianPendulum(0.3, self.spin, b)


class Dropping(CartesianPendulum):
    """Loses the imaginary part of a complex step without a word."""

    def constraint(self, t, q):
        return super().constraint(t, np.real(q))

    def with_values(self, b):
        return Dropping(self.angle, self.spin, b)


class Following(CartesianPendulum):
    """Has a load that turns, and forgets its partial."""

    def following_load(self, q, t):
        return np.array([-q[1], q[0]])

    def with_values(self, b):
        return Following(self.angle, self.spin, b)


class Filling(CartesianPendulum):
    """Fills an array of floats, which refuses complex numbers."""

    def force(self, t, q, v):
        Q = np.zeros(2)
        Q[1] = -self.b[1]
        return Q

    def with_values(self, b):
        return Filling(self.angle, self.spin, b)


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (
            Filling,
            "force accepts complex numbers, as force_q, force_v, force_b, force_total need",
        ),
        (OffTheRod, "start, q on the constraints"),
        (WrongShape, "shape and kind of constraint_b"),
        (Forgetful, "with_values, there and back"),
        (Dropping, "complex step of constraint: differences"),
        (Following, "following_load_q: differences of following_load"),
    ],
)
def test_other_faults_are_found(kind, name):
    report = check_system(kind(-1.0, 2.0), samples=1)
    assert name in [finding.name for finding in report.wrong], str(report)
    assert f"{name:<58}" in str(report)
    assert "WRONG" in str(report)


def test_what_is_no_system_is_refused():
    with pytest.raises(InvalidInput, match="MechanicalSystem"):
        check_system(pendulum())
    with pytest.raises(InvalidInput, match="real"):
        check_system(CartesianPendulum(b=(1.0 + 0j, 9.81)))
    with pytest.raises(InvalidInput, match="samples"):
        check_system(CartesianPendulum(), samples=0)
