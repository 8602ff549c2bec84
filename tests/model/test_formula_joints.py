"""Joints by formulas: closed forms, minimal coordinates, and twins among other joints."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Adjoint,
    Beam,
    ComplexStep,
    Cylindrical,
    DirectDifferentiation,
    Distance,
    FiniteDifference,
    InitialVelocity,
    Integral,
    Material,
    Moment,
    Pin,
    Prismatic,
    Radau,
    RigidBody,
    RotationDriver,
    Scene,
    Spherical,
    SpringDamper,
    TorsionalSpringDamper,
    TranslationDriver,
    assemble,
    check_system,
    equilibrium,
    equilibrium_gradient,
    gradient,
    modes,
    simulate,
)
from ancfdae.errors import InconsistentStartError, InvalidInputError, RedundantConstraintsError
from ancfdae.extend import (
    ExternalFunction,
    FormulaJoint,
    Law,
    MaterialPoint,
    Quantity,
    design_numbers,
    require_law,
)
from ancfdae.laws import ConstantAcceleration, Harmonic
from ancfdae.observables import joint_power, position
from ancfdae.sections import Rectangle

G = 9.81


@dataclass(frozen=True)
class Ellipse(FormulaJoint):
    """A point on an ellipse, in units of its own or, scaled, of an area."""

    point: MaterialPoint
    centre_x: float
    centre_y: float
    width: float
    height: float

    kind = "ellipse"
    design_fields = design_numbers("centre_x", "centre_y", "width", "height")

    def equations(self, U, p, reference, laws):
        x, y, a, b = self.split(p)
        return ((U[0, 0] - x) / a) ** 2 + ((U[0, 1] - y) / b) ** 2 - 1


@dataclass(frozen=True)
class Gears(FormulaJoint):
    """Teeth of two planar bodies: teeth * angle + other_teeth * other angle stays."""

    point: MaterialPoint
    other: MaterialPoint
    teeth: int
    other_teeth: int

    kind = "gears"
    takes_part = (Quantity.SLOPE_X,)

    def equations(self, U, p, reference, laws):
        (x, y), (x_o, y_o) = U.T, reference.T
        turned = np.arctan2(y, x) - np.arctan2(y_o, x_o)
        angle = self.teeth * turned[0] + self.other_teeth * turned[1]
        return np.arctan2(np.sin(angle), np.cos(angle))


@dataclass(frozen=True)
class Rod(FormulaJoint):
    """Distance of two points, or of one from the origin, that follows a law."""

    point: MaterialPoint
    length: Law
    other: MaterialPoint | None = None

    kind = "rod"
    design_fields = (("length", require_law),)

    def equations(self, U, p, reference, laws):
        r = U[0] - U[1] if self.other else U[0]
        return np.sqrt(r @ r) - laws[0]


def bead(place=(0.0, 0.0), unit=1.0, angle=0.3, assembled=False):
    """A bead on an ellipse of 2 and 1 m: place in lengths, lengths in `unit`s, and its angle."""
    a, b = 2.0 * unit, 1.0 * unit
    x, y = (unit * s for s in place)
    at = x + a * np.cos(angle), y + b * np.sin(angle)
    body = RigidBody("bead", at, mass=1.5, inertia=0.1 * unit**2)
    # A point beside the origin of the body, which does not turn for symmetry.
    slot = Ellipse(body.at(0, 0), x, y, a, b, name="slot")
    return Scene([], [slot], (0, -G * unit), bodies=[body], assemble=assembled), body


def bead_angle(t, angle=0.3, a=2.0, b=1.0):
    """The angle in minimal coordinates, to 1e-12."""

    def rates(_, x):
        s, c = np.sin(x[0]), np.cos(x[0])
        inertia = a * a * s * s + b * b * c * c
        return x[1], -((a * a - b * b) * s * c * x[1] ** 2 + G * b * c) / inertia

    return solve_ivp(rates, (0, t), (angle, 0.0), method="DOP853", rtol=1e-13, atol=1e-14).y[0, -1]


INTEGRATORS = {
    "DOP853": DOP853(1e-11),
    "Radau": Radau(rtol=1e-9),
    "HHT": HHT(rtol=1e-5),
    "IDA": IDA(1e-9),
}


@pytest.mark.parametrize("integrator", INTEGRATORS.values(), ids=INTEGRATORS)
@pytest.mark.parametrize(("place", "unit"), [((0, 0), 1.0), ((800, -600), 1.0), ((0, 0), 1e3)])
def test_a_bead_on_an_ellipse_moves_as_in_minimal_coordinates(integrator, place, unit):
    scene, body = bead(place, unit)
    run = simulate(scene, 1.5, integrator)
    angle = bead_angle(1.5)
    exact = np.add(place, (2 * np.cos(angle), np.sin(angle)))
    assert abs(run.position(body.at(0, 0))[-1] / unit - exact).max() < 1e-4


def test_hht_converges_with_its_order_on_an_ellipse():
    scene, body = bead()
    exact = 2 * np.cos(bead_angle(1.0))
    errors = [
        abs(simulate(scene, 1.0, HHT(h)).position(body.at(0, 0))[-1, 0] - exact)
        for h in (2.0**-7, 2.0**-8, 2.0**-9)
    ]
    assert np.diff(np.log2(errors)) == pytest.approx(-2, abs=0.1)


def test_small_motions_and_rest_in_an_elliptic_bowl():
    scene, _ = bead(angle=-np.pi / 2)
    # The bead turns freely about itself.
    found = modes(scene, 2, design=["slot.width", "slot.height", "bead.mass"])
    frequency = np.sqrt(G * 1.0) / 2.0  # sqrt(g b) / a
    assert found.natural_frequencies[-1] == pytest.approx(frequency, rel=1e-10)
    slopes = np.array([-frequency / 2.0, frequency / 2, 0.0])
    assert found.frequencies_b[-1] == pytest.approx(slopes, abs=1e-9)


def test_equilibrium_of_a_bead_on_a_spring():
    scene, body = bead(angle=-1.0)
    spring = SpringDamper(body.at(0, 0), 12.0, free_length=1.0, ground=(3.0, 0.5), name="spring")
    hold = TorsionalSpringDamper(body.at(0, 0), 1.0, name="hold")
    scene = Scene([], scene.joints, (0, -G), bodies=[body], loads=[spring, hold])
    design = ["slot.width", "slot.height", "slot.centre_x", "bead.mass", "spring.stiffness"]
    x, y = equilibrium(scene).solution.position(body.at(0, 0))[0]
    # The force is normal to the ellipse: F x grad = 0.
    d = np.array([3.0 - x, 0.5 - y])
    F = 12.0 * (1 - 1.0 / np.hypot(*d)) * d - (0, 1.5 * G)
    assert abs(F[0] * y / 1.0 - F[1] * x / 4.0) < 1e-9
    assert (x / 2) ** 2 + y**2 == pytest.approx(1, abs=1e-12)
    height = position(body.at(0, 0), 1)
    found = equilibrium_gradient(scene, height, design=design).gradient
    for name, slope in zip(design, found, strict=True):
        owner, field = name.split(".")
        values = {x.name: x for x in (*scene.joints, *scene.loads, *scene.bodies)}[owner]
        h, b = 1e-4, values.parameters()[field]
        moved = [
            equilibrium(scene.with_values({name: b + s * h})).solution.position(body.at(0, 0))[0, 1]
            for s in (-1, 1)
        ]
        assert slope == pytest.approx((moved[1] - moved[0]) / (2 * h), rel=2e-6, abs=1e-8)


def gear_train(far=0.0):
    bodies = [
        RigidBody(name, (far + x, far), mass=1.0, inertia=inertia)
        for name, x, inertia in (("wheel", 0.0, 0.3), ("pinion", 1.0, 0.05))
    ]
    wheel, pinion = (body.at(0, 0) for body in bodies)
    joints = [Pin(wheel), Pin(pinion), Gears(wheel, pinion, 3, 1, name="mesh")]
    loads = [Moment(wheel, 2.0, name="motor")]
    return Scene([], joints, bodies=bodies, loads=loads), bodies


@pytest.mark.parametrize("integrator", INTEGRATORS.values(), ids=INTEGRATORS)
def test_gears_far_away_turn_many_times_as_in_the_closed_form(integrator):
    scene, (wheel, pinion) = gear_train(1e3)
    run = simulate(scene, 3.0, integrator)
    # I_1 w' = M + 3 lam, I_2 (-3 w)' = lam.
    angle = 2.0 * 3.0**2 / 2 / (0.3 + 9 * 0.05)
    assert 3 * angle > 6 * np.pi
    for body, turned in ((wheel, angle), (pinion, -3 * angle)):
        arm = run.position(body.at(1, 0))[-1] - run.position(body.at(0, 0))[-1]
        assert arm == pytest.approx((np.cos(turned), np.sin(turned)), abs=1e-3)


def test_a_law_of_length_swings_a_pendulum_and_does_work():
    mass = RigidBody("mass", (1.0, 0.0), mass=2.0, inertia=0.1)
    rod = Rod(mass.at(0, 0), Harmonic(0.2, 3.0, np.pi / 2, offset=0.8), name="rod")
    scene = Scene([], [rod], (0, -G), bodies=[mass])

    def rates(t, x):
        L, dL = 0.8 + 0.2 * np.cos(3.0 * t), -0.6 * np.sin(3.0 * t)
        return x[1], -2 * dL / L * x[1] - G / L * np.cos(x[0])

    angle = solve_ivp(rates, (0, 1.2), (0.0, 0.0), method="DOP853", rtol=1e-13, atol=1e-14).y[0, -1]
    length = 0.8 + 0.2 * np.cos(3.6)
    run = simulate(scene, 1.2, DOP853(1e-12))
    exact = length * np.array([np.cos(angle), np.sin(angle)])
    assert run.position(mass.at(0, 0))[-1] == pytest.approx(exact, abs=1e-9)
    # What the law does is the change of energy.
    power = Integral(joint_power("rod"))
    work = gradient(scene, power, 1.2, DOP853(1e-12), design=["mass.mass"]).value
    v = run.velocity(mass.at(0, 0))[-1]
    energy = v @ v + 2.0 * G * exact[1]
    assert work == pytest.approx(energy, abs=1e-7)


def cam_profile(p, angle):
    """Height of a flat follower on a cam: smooth, with a rise of two harmonics."""
    base, first, second = p
    return base + first * np.cos(angle) + second * np.cos(2 * angle)


@dataclass(frozen=True)
class Cam(FormulaJoint):
    """The follower's height above the shaft of the cam follows its profile."""

    point: MaterialPoint
    other: MaterialPoint
    base: float
    first: float
    second: float

    kind = "cam"
    takes_part = (Quantity.POSITION, Quantity.SLOPE_X)
    design_fields = design_numbers("base", "first", "second")

    def equations(self, U, p, reference, laws):
        follower, shaft, _, (c, s) = U
        base, first, second = self.split(p)
        return follower[1] - shaft[1] - cam_profile((base, first, second), np.arctan2(s, c))


def cam_shaft(unit=1.0, far=0.0):
    numbers = [unit * x for x in (0.30, 0.05, -0.02)]
    place = unit * far
    cam = RigidBody("cam", (place, place), mass=1.0, inertia=0.02 * unit**2)
    top = place + cam_profile(numbers, 0.0)
    follower = RigidBody("follower", (place, top), mass=0.4, inertia=0.01 * unit**2)
    shaft, tip = cam.at(0, 0), follower.at(0, 0)
    joints = [
        Pin(shaft),
        RotationDriver(shaft, ConstantAcceleration(0.0, acceleration=8.0), name="motor"),
        Cam(tip, shaft, *numbers, name="lift"),
        Prismatic(tip, (0, 1), name="guide"),
    ]
    return Scene([], joints, (0, -G * unit), bodies=[cam, follower]), tip


@pytest.mark.parametrize(("unit", "far"), [(1.0, 0.0), (1.0, 300.0), (1e3, 0.0)])
def test_a_follower_on_a_cam_moves_as_its_profile_says(unit, far):
    scene, tip = cam_shaft(unit, far)
    for integrator in (HHT(2.0**-9), DOP853(1e-10), Radau(rtol=1e-8)):
        run = simulate(scene, 1.5, integrator)
        exact = unit * (far + cam_profile((0.30, 0.05, -0.02), 4.0 * run.t**2))
        assert abs(run.position(tip)[:, 1] - exact).max() < 1e-9 * unit * (1 + far)
    run = simulate(scene, 1.0, DOP853(1e-10))
    # lam = force on the follower: m (y'' + g).
    h, t = 1e-4, run.t[-1]
    y = [cam_profile((0.30, 0.05, -0.02), 4.0 * (t + s) ** 2) for s in (-h, 0.0, h)]
    force = -0.4 * unit * ((y[0] - 2 * y[1] + y[2]) / h**2 + G)
    row = assemble(scene).constraint_names.index("lift")
    assert run.lam[-1, row] == pytest.approx(force, rel=1e-5)


# -- twins ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class DistanceTwin(FormulaJoint):
    """`Distance` by a root, a function that is not bilinear."""

    point: MaterialPoint
    length: float
    other: MaterialPoint | None = None

    kind = "twin"
    design_fields = design_numbers("length")

    def equations(self, U, p, reference, laws):
        (length,) = self.split(p)
        r = U[0] - U[1]
        return np.sqrt(np.sum(r**2)) - length


@dataclass(frozen=True)
class BallTwin(FormulaJoint):
    """`Spherical` whose equations are mixed up by functions that vanish where theirs do."""

    point: MaterialPoint
    other: MaterialPoint

    kind = "ball twin"
    equation_count = 3

    def equations(self, U, p, reference, laws):
        x, y, z = U[0] - U[1]
        return [np.exp(x) * (1 + y) - 1, np.sin(y) + x * z, z + x**3]


def ropeway(joint):
    """A beam in the plane whose end is tied to a body by a distance."""
    rod = Beam("rod", (0, 0), (0.8, 0.1), 3, Rectangle(0.04, 0.03), Material(2000, 1e7, 0.3))
    pen = RigidBody("pen", (1.2, 0.5), mass=0.5, inertia=0.01)
    apart = float(np.hypot(1.1 - 0.56, 0.55 - 0.07))
    tie = joint(rod.at(0.7), apart, pen.at(-0.1, 0.05))
    guide = TranslationDriver(pen.at(0, 0), (0, 1), Harmonic(0.1, 4.0, np.pi / 2, -0.1))
    return Scene([rod], [Pin(rod.at_start), tie, guide], (0, -G), bodies=[pen]), rod.at_end


def spatial_chain(joint):
    boxes = [
        RigidBody(x, (s, 0, 0.1 * s), mass=1.0, inertia=(0.02, 0.03, 0.04))
        for x, s in (("upper", 0.5), ("lower", 1.5))
    ]
    upper, lower = boxes
    joints = [
        Spherical(upper.at(-0.5, 0, -0.05)),
        joint(upper.at(0.5, 0.0, 0.05), lower.at(-0.5, 0, -0.05), name="ball"),
    ]
    start = [InitialVelocity(x, (0.0, 0.5, 0.0), (0, 0, 0)) for x in ("upper", "lower")]
    return Scene([], joints, (0, 0, -G), start, bodies=boxes), lower.at(0.5, 0, 0)


TWINS = {
    "distance": (ropeway, Distance, DistanceTwin),
    "ball": (spatial_chain, Spherical, BallTwin),
}


@pytest.mark.parametrize(("build", "joint", "twin"), TWINS.values(), ids=TWINS)
@pytest.mark.parametrize("integrator", [HHT(2.0**-8), Radau(rtol=1e-7), DOP853(1e-8)], ids=repr)
def test_a_formula_moves_as_the_joint_of_the_package(build, joint, twin, integrator):
    pairs = map(build, (joint, twin))
    runs = [simulate(scene, 0.05, integrator).position(point)[-1] for scene, point in pairs]
    assert runs[1] == pytest.approx(runs[0], abs=1e-7)


def test_modes_and_equilibria_are_those_of_the_joint_of_the_package():
    found = []
    for joint in (Distance, DistanceTwin):
        scene, end = ropeway(joint)
        design = ["rod.height", "pen.mass", "rod.length"]
        found.append(
            [
                *modes(scene, 4, design=design, at=equilibrium(scene)).frequencies_b.ravel(),
                *equilibrium_gradient(scene, position(end, 1), design=design).gradient,
            ]
        )
    assert found[1] == pytest.approx(found[0], rel=1e-6)


# -- derivatives -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Screw(FormulaJoint):
    """A nut on a screw along z: its height grows with its angle about z by a pitch, m/rad."""

    point: MaterialPoint
    pitch: float

    kind = "screw"
    takes_part = (Quantity.POSITION, Quantity.SLOPE_X)
    design_fields = design_numbers("pitch")

    def equations(self, U, p, reference, laws):
        (pitch,) = self.split(p)
        angle = np.arctan2(U[1, 1], U[1, 0]) - np.arctan2(reference[1, 1], reference[1, 0])
        turns = (U[0, 2] - reference[0, 2]) / pitch - angle
        return pitch * np.arctan2(np.sin(turns), np.cos(turns))


def nut(far=0.0):
    body = RigidBody("nut", (far, far, far), mass=0.7, inertia=(0.02, 0.03, 0.04))
    joints = [Cylindrical(body.at(0, 0, 0), (0, 0, 1)), Screw(body.at(0, 0, 0), 0.05, name="screw")]
    return Scene([], joints, (0, 0, -G), bodies=[body]), body.at(0, 0, 0)


@pytest.mark.parametrize("far", [0.0, 1e3])
def test_a_nut_falls_along_a_screw_as_in_the_closed_form(far):
    scene, point = nut(far)
    fall = -G * 0.7 / (0.7 + 0.04 / 0.05**2) / 2
    for integrator in (HHT(2.0**-9), DOP853(1e-9), Radau(rtol=1e-7)):
        run = simulate(scene, 1.5, integrator)
        assert abs(run.position(point)[:, 2] - far - fall * run.t**2).max() < 1e-4


SCENES = {
    "bead": (bead, ["slot.width", "slot.height", "slot.centre_x", "bead.mass", "slot.point_y"]),
    "gears": (gear_train, ["motor.moment", "wheel.inertia", "pinion.inertia"]),
    "cam": (cam_shaft, ["lift.first", "lift.second", "motor.acceleration", "follower.mass"]),
    "rope": (lambda: ropeway(DistanceTwin), ["rod.height", "rod.length", "pen.mass"]),
    "ball": (lambda: spatial_chain(BallTwin), ["upper.mass", "lower.inertia_y", "ball.point_x"]),
    "screw": (nut, ["screw.pitch", "nut.mass", "nut.inertia_z"]),
}


@pytest.mark.parametrize("case", SCENES.values(), ids=SCENES)
def test_every_derivative_of_the_equations_is_that_of_their_values(case):
    build, design = case
    report = check_system(assemble(build()[0], design), samples=1)
    assert report.passed, report


@pytest.mark.parametrize("case", SCENES.values(), ids=SCENES)
@pytest.mark.parametrize("integrator", [HHT(2.0**-7), Radau(2.0**-6)], ids=repr)
def test_gradients_are_exact(case, integrator):
    build, design = case
    scene, point = build()
    body = next(x for x in (*scene.bodies, *scene.beams) if x.name != "wheel")
    where = point if isinstance(point, MaterialPoint) else body.at(*np.full(scene.dimension, 0.1))
    objective = Integral(position(where, scene.dimension - 1))
    call = scene, objective, 0.25, integrator
    direct, adjoint, stepped = (
        gradient(*call, design=design, method=method()).gradient
        for method in (DirectDifferentiation, Adjoint, ComplexStep)
    )
    size = np.maximum(np.abs(stepped), 1e-4 * np.max(np.abs(stepped)))
    assert np.max(np.abs(direct - stepped) / size) < 1e-10
    assert np.max(np.abs(adjoint - stepped) / size) < 1e-10
    method, b = FiniteDifference(1e-4, central=True), assemble(scene, design).b
    differences = gradient(*call, design=np.array(design)[b != 0].tolist(), method=method).gradient
    size = np.max(np.abs(stepped))
    assert differences == pytest.approx(stepped[b != 0], rel=1e-6, abs=1e-7 * size)


# -- starts, redundancy, refusals --------------------------------------------------------------


@pytest.mark.parametrize(("place", "unit"), [((0, 0), 1.0), ((1500, 700), 1.0), ((0, 0), 1e3)])
def test_bodies_beside_the_curve_are_moved_onto_its_nearest_point(place, unit):
    a, b, angle = 2.0, 1.0, 0.7
    on = np.array([a * np.cos(angle), b * np.sin(angle)])
    normal = on / (a * a, b * b)
    # On the normal, inside and outside: the nearest place on the ellipse stays where it is.
    for beside in (0.02, -0.02):
        x, y = unit * (np.array(place) + on + beside * normal)
        body = RigidBody("bead", (x, y), mass=1.0, inertia=0.1 * unit**2)
        size = unit * a, unit * b
        slot = Ellipse(body.at(0, 0), unit * place[0], unit * place[1], *size, name="slot")
        # A wire of the size of the mechanism, which lengths of the assembly are measured by.
        scene = Scene([], [slot], bodies=[body], assemble=True)
        with pytest.raises(InconsistentStartError, match="slot"):
            simulate(Scene([], [slot], bodies=[body]), 0.1, HHT(0.05))
        found = simulate(scene, 0.1, HHT(0.05)).position(body.at(0, 0))[0]
        assert found / unit - place == pytest.approx(on, abs=1e-9)


def test_a_start_follows_the_design():
    scene, _ = bead()
    at = assemble(scene, ["slot.width", "slot.height", "slot.centre_x"])
    db = 1e-3 * np.arange(1, 4)
    (before, _), (slope, _) = at.start(), at.start_b()
    assert at.with_values(at.b + db).start()[0] == pytest.approx(before + slope @ db, abs=1e-5)


def test_equations_that_say_the_same_are_refused():
    scene, body = bead()
    (slot,) = scene.joints
    twice = Scene([], [slot, replace(slot, name="again")], (0, -G), bodies=[body])
    with pytest.raises(RedundantConstraintsError, match="again"):
        simulate(twice, 0.1, HHT(0.01))


COUNT = itertools.count()


@dataclass(frozen=True)
class Careless(FormulaJoint):
    """Equations that go wrong in the way that a field says."""

    point: MaterialPoint
    radius: float
    way: str = "right"

    kind = "careless"
    design_fields = design_numbers("radius")

    def equations(self, U, p, reference, laws):
        (radius,) = self.split(p)
        ways = {
            "right": lambda: [U[0] @ U[0] - radius**2],
            "field": lambda: [U[0] @ U[0] - self.radius**2],
            "two": lambda: [U[0, 0], U[0, 1]],
            "if": lambda: [U[0, 0] if U[0, 1] > 0 else U[0, 1]],
            "abs": lambda: [abs(U[0, 0]) - radius],
            "float": lambda: [float(U[0, 0]) - radius],
            "state": lambda: [U[0] @ U[0] - radius**2 - next(COUNT)],
            "kind": lambda: [U[0] @ U[0] - radius**2 - (U.dtype == object)],
        }
        return ways[self.way]()


@pytest.mark.parametrize(
    ("way", "message"),
    [
        ("field", "take the values of design fields from p"),
        ("two", "as many as `equation_count`, 1"),
        ("if", "a comparison of the state"),
        ("abs", "abs, which has a kink"),
        ("float", "a number where the state"),
        ("state", "other equations at the second call"),
        ("kind", "other values for numbers than for symbols, by 1"),
    ],
)
def test_equations_that_cannot_be_formulas_are_refused(way, message):
    body = RigidBody("body", (1.0, 0.0), mass=1.0, inertia=0.1)
    joint = Careless(body.at(0, 0), 1.0, way, name="careless")
    with pytest.raises(InvalidInputError, match="equations of joint 'careless'") as caught:
        assemble(Scene([], [joint], bodies=[body]))
    assert message in str(caught.value)


@dataclass(frozen=True)
class Rail(FormulaJoint):
    """A point on a rail whose height is a table with its derivatives."""

    point: MaterialPoint

    kind = "rail"

    def equations(self, U, p, reference, laws):
        return U[0, 1] - RAIL(U[0, 0])


SHAPE = CubicSpline(np.linspace(-2, 2, 41), 0.3 * np.cos(np.linspace(-2, 2, 41)))
RAIL = ExternalFunction(
    lambda x: SHAPE(x),
    ExternalFunction(
        lambda x: SHAPE(x, 1), ExternalFunction(lambda x: SHAPE(x, 2), lambda x: SHAPE(x, 3))
    ),
)


def test_a_rail_may_be_a_table():
    x = 1.0
    body = RigidBody("car", (x, float(SHAPE(x))), mass=1.0, inertia=0.1)
    scene = Scene([], [Rail(body.at(0, 0))], (0, -G), bodies=[body])
    run = simulate(scene, 0.3, HHT(2.0**-8))
    place = run.position(body.at(0, 0))
    assert place[:, 1] == pytest.approx(SHAPE(place[:, 0]), abs=1e-10)
    v = run.velocity(body.at(0, 0))[-1]
    assert v @ v / 2 + G * place[-1, 1] == pytest.approx(G * place[0, 1], abs=1e-3)


@pytest.mark.parametrize("change", [lambda x: x[:-1], lambda x: x - 1000, lambda x: x + 1000])
def test_indices_of_a_formula_that_do_not_fit_are_no_plan(change):
    plan = assemble(cam_shaft()[0])._constraints.plan
    kind, (indices, *others, lists) = plan.__reduce__()
    assert len(lists) == 12
    kind(indices, *others, lists)
    for k, array in enumerate(indices):
        if np.size(array):
            wrong = change(np.asarray(array)).astype(np.int32)
            with pytest.raises((ValueError, TypeError)):
                kind((*indices[:k], wrong, *indices[k + 1 :]), *others, lists)
    for some in ((), lists[:-1], lists[::-1]):
        with pytest.raises(ValueError, match=r"list|indices"):
            kind(indices, *others, some)


def test_a_formula_is_met_anew_where_no_other_equation_has_products():
    rod = Beam("rod", (0.5, 0), (1.4, 0.2), 3, Rectangle(0.04, 0.03), Material(2000, 1e6, 0.3))
    radius = float(np.hypot(1.4, 0.2))
    ends = [
        simulate(Scene([rod], [Pin(rod.at_start), tie], (0, -G)), 0.4, HHT(2.0**-8)).position(
            rod.at_end
        )[-1]
        for tie in (
            Distance(rod.at_end, radius, ground=(0.0, 0.0)),
            Careless(rod.at_end, radius, name="tie"),
        )
    ]
    assert abs(ends[0] - (1.4, 0.2)).max() > 1e-2
    assert ends[1] == pytest.approx(ends[0], abs=1e-9)


def test_joints_share_lists_only_where_their_operations_are_the_same():
    balls = [RigidBody(f"ball {k}", (1.0 * k, 0.0), mass=1.0, inertia=1.0) for k in range(4)]
    points = [ball.at(0.0, 0.0) for ball in balls]
    joints = [
        Distance(points[1], 0.5, points[0], name="first"),
        Distance(points[2], 0.9, points[1], name="second"),
        Distance(points[3], 2.0, ground=(5.0, 0.0), name="third"),
    ]
    system = assemble(Scene([], joints, bodies=balls))
    # (|r|^2/L - L)/2 at |r| = 1, 1 and 2.
    expected = [(1 / 0.5 - 0.5) / 2, (1 / 0.9 - 0.9) / 2, (4 / 2.0 - 2.0) / 2]
    Phi = system.constraint(0.0, system._reference.q)
    names = np.array(system.constraint_names)
    for name, value in zip(("first", "second", "third"), expected, strict=True):
        assert Phi[names == name] == pytest.approx([value], abs=1e-15)
    first, second, third = (x.lists for x in system._constraints.structure.slots if x.lists)
    assert first is second
    assert third is not first
