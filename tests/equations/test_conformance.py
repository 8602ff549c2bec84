"""`check_system` accepts right systems and convicts wrong ones."""

import numpy as np
import pytest

from ancfdae import (
    Beam,
    Clamp,
    FollowerForce,
    InitialVelocity,
    Material,
    Moment,
    Pin,
    RotationDriver,
    Scene,
    SpringDamper,
    assemble,
    check_system,
)
from ancfdae.equations.derived import Related, is_value, members
from ancfdae.errors import InvalidInputError
from ancfdae.extend import MechanicalSystem, SystemProperties
from ancfdae.laws import Harmonic
from ancfdae.results import SystemCheck
from ancfdae.sections import Rectangle
from tests.support.mechanisms import (
    CartesianPendulum,
    GuidedDoublePendulum,
    WhirlingPendulum,
    WrittenPendulum,
)
from tests.tools.sign_mutation import everything, negative
from validation.scenes import crank_slider, pendulum

# A start is judged by Phi and by its partials, which are there with design variables. Which loads
# of Q turn with the motion only the system knows: no value tells the sign of these.
UNTOLD = "start", "following_load"
VALUES = [name for name in members() if is_value(name) and name not in UNTOLD]


class Flipped(MechanicalSystem):
    """A system whose members have the wrong sign, seen from outside."""

    def __init__(self, right, wrong):
        self.right, self.wrong = right, wrong
        # Attributes shadow the properties of the class.
        for name in (*dir(MechanicalSystem), "n_q", "n_lam", "design_names", "b"):
            value = None if name.startswith("_") else getattr(right, name)
            if not (value is None or callable(value)):
                setattr(self, name, value)

    def with_values(self, b):
        return Flipped(self.right.with_values(b), self.wrong)


def member(name):
    def call(self, *arguments):
        value = getattr(self.right, name)(*arguments)
        return negative(value) if name in self.wrong else value

    return call


for _name in members():
    setattr(Flipped, _name, member(_name))
Flipped.__abstractmethods__ = frozenset()


def is_named(name, report):
    return any(finding.name.partition(",")[0] == name for finding in report.wrong)


@pytest.mark.parametrize("right", [everything, GuidedDoublePendulum])
def test_wrong_sign_of_any_formula_is_found(right):
    # All at once: each is compared with what the values make of it, none with another.
    system = right()
    formulas = [name for name in members() if not is_value(name)]
    report = check_system(Flipped(system, formulas), samples=1)
    unseen = [name for name in formulas if not is_named(name, report)]
    assert unseen == [], str(report)
    with pytest.raises(InvalidInputError, match="along_pull_back"):
        report.raise_if_wrong()


@pytest.mark.parametrize("name", VALUES)
def test_wrong_sign_of_any_value_is_found(name):
    # M, Q and Phi may have any sign: their derivatives tell.
    right = Declared(-1.0, 2.0) if name == "mass_along" else everything(())
    report = check_system(Flipped(right, [name]), samples=1)
    assert not report.passed
    # So do those of the rates of Phi, which changes its sign with them.
    if name in vars(Related) and name != "constraint":
        assert is_named(name, report), str(report)


class Slipping(CartesianPendulum):
    """Has one member that is wrong by one part in a hundred thousand."""

    def constraint_total(self, t, motion, motion_b=None):
        return 1.00001 * super().constraint_total(t, motion, motion_b)

    def with_values(self, b):
        return Slipping(self.angle, self.spin, b)


class Drifting(CartesianPendulum):
    """Declares a mass constant that changes by one part in a hundred million."""

    def mass(self, q):
        return super().mass(q) * (1 + 1e-8 * np.sin(q[0]))

    def with_values(self, b):
        return Drifting(self.angle, self.spin, b)


class BesideTheRod(CartesianPendulum):
    """Starts off its rod by one part in a million."""

    def start(self):
        q, v = super().start()
        return 1.000001 * q, v

    def with_values(self, b):
        return BesideTheRod(self.angle, self.spin, b)


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (Slipping, "constraint_total"),
        (Drifting, "constant_mass"),
        (BesideTheRod, "start, q on the constraints"),
    ],
)
def test_small_errors_are_found(kind, name):
    # Ten times the tolerances, which round-off of differences and sums leaves far below.
    report = check_system(kind(-1.0, 2.0), samples=1)
    assert name in [finding.name for finding in report.wrong], str(report)


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
    motor = RotationDriver(fore.at_start, Harmonic(0.5, 3.0), other=upper.at_end, name="motor")
    joints = [Clamp(upper.at_start), Pin(fore.at_start, upper.at_end), motor]
    return Scene([upper, fore], joints, project_start=True)


@pytest.mark.parametrize(
    "system",
    [
        CartesianPendulum(-1.0, 2.0),
        CartesianPendulum(),
        WrittenPendulum(-1.0, 2.0),
        GuidedDoublePendulum(1.0),
        assemble(
            pendulum(start=(InitialVelocity("pendulum", 2.0, (0.0, 0.0)),)), ["pendulum.height"]
        ),
        assemble(crank_slider(), ["rod.density"]),
        assemble(pushed(), ["rod.height"]),
        assemble(elbow(), ["motor.amplitude"]),
    ],
    ids=lambda system: type(system).__name__,
)
def test_right_systems_pass(system):
    report = check_system(system, samples=1)
    assert isinstance(report, SystemCheck)
    assert report.passed, str(report)
    report.raise_if_wrong()
    # Far below the tolerance: it is not what lets them pass.
    assert max(finding.error for finding in report.findings) < 1e-8


class Declared(WhirlingPendulum):
    """The pendulum in a whirling wind with declarations of the test's choice."""

    def with_values(self, b):
        return type(self)(self.angle, self.spin, b)


def test_undeclared_twin_passes():
    assert check_system(Declared(-1.0, 2.0), samples=1).passed


class ConstantMass(Declared):
    traits = SystemProperties(constant_mass=True)


class LinearConstraints(Declared):
    traits = SystemProperties(linear_constraints=True)


class ConstantConstraints(Declared):
    traits = SystemProperties(constant_constraints=True)


class NoVelocityForces(Declared):
    traits = SystemProperties(velocity_forces=False)


class Symmetric(Declared):
    traits = SystemProperties(symmetric=True)


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
    assert name in [finding.name for finding in check_system(kind(-1.0, 2.0), samples=1).wrong]


class OffTheRod(CartesianPendulum):
    def start(self):
        q, v = super().start()
        return 1.001 * q, v

    def with_values(self, b):
        return OffTheRod(self.angle, self.spin, b)


class WrongShape(CartesianPendulum):
    def constraint_total(self, t, motion, motion_b=None):
        return np.zeros(2)


class Forgetful(CartesianPendulum):
    def with_values(self, b):
        return CartesianPendulum(0.3, self.spin, b)


class Dropping(CartesianPendulum):
    """Loses the imaginary part of a complex step without a word."""

    def constraint(self, t, *motion):
        return super().constraint(t, *map(np.real, motion))

    def with_values(self, b):
        return Dropping(self.angle, self.spin, b)


class Following(CartesianPendulum):
    """Has a load that turns, and forgets its partial."""

    def following_load(self, t, q):
        return np.array([-q[1], q[0]]), np.zeros(4)

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
        (Filling, "force_and_total: complex numbers, refused by force"),
        (OffTheRod, "start, q on the constraints"),
        (WrongShape, "constraint_total"),
        (Forgetful, "with_values, there and back"),
        (Dropping, "constraint, by complex steps"),
        (Following, "following_load"),
    ],
)
def test_other_faults_are_found(kind, name):
    report = check_system(kind(-1.0, 2.0), samples=1)
    assert name in [finding.name for finding in report.wrong], str(report)
    assert f"{name:<58}" in str(report)
    assert "WRONG" in str(report)


def test_what_is_no_system_is_refused():
    with pytest.raises(InvalidInputError, match="MechanicalSystem"):
        check_system(pendulum())
    with pytest.raises(InvalidInputError, match="real"):
        check_system(CartesianPendulum(b=(1.0 + 0j, 9.81)))
    with pytest.raises(InvalidInputError, match="samples"):
        check_system(CartesianPendulum(), samples=0)
