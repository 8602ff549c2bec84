"""Modes and equilibria of mechanisms with controllers, against characteristic equations.

Poles of rigid bodies are roots of polynomials. Poles of a flexible arm are roots of the determinant
of Euler and Bernoulli's beam with the controller as its boundary condition. Neither has coordinates
of the package.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import brentq, newton

from ancfdae import (
    HHT,
    PID,
    Adjoint,
    Beam,
    Clamp,
    ComplexStep,
    DCMotor,
    DirectDifferentiation,
    EquilibriumStart,
    FirstOrderLag,
    Material,
    Pin,
    PointForce,
    PointMass,
    Radau,
    Revolute,
    RigidBody,
    Scene,
    SlidingJoint,
    Terminal,
    TorsionalSpringDamper,
    assemble,
    critical_load,
    equilibrium,
    equilibrium_gradient,
    gradient,
    modes,
    simulate,
    suggest_step,
)
from ancfdae.errors import FreeMotionError, InvalidInputError
from ancfdae.extend import (
    LAW_FIELD,
    Controller,
    Law,
    MaterialPoint,
    RotationAxis,
    design_numbers,
    require_law,
)
from ancfdae.laws import Constant
from ancfdae.modes.linearised import LinearisationPoint
from ancfdae.observables import observe, position, rotation_angle, state
from ancfdae.sections import Rectangle

MASS, INERTIA, ARM, G = 2.0, 0.3, 0.5, 9.81
P, I, D, R = 30.0, 60.0, 6.0, 0.3
DESIGN = ["servo.proportional", "servo.integral", "servo.derivative", "servo.value", "bar.mass"]


def bar_scene(p=P, i=I, d=D, r=R, m=MASS, at=(0.0, 0.0), unit=1.0, space=False):
    """Return a bar on a pin, held against its weight by a PID; lengths in `unit` of a metre."""
    # Torques and inertias grow with the square of the lengths' numbers.
    square, more = unit**-2, (0.0,) * space
    J = (INERTIA * square,) * 3 if space else INERTIA * square
    bar = RigidBody("bar", (*at, *more), mass=m, inertia=J, centre=(ARM / unit, 0.0, *more))
    axis = {"axis": (0, 0, 1)} if space else {}
    gains = (x * square for x in (p, i, d))
    servo = PID(bar.origin, Constant(r), *gains, name="servo", **axis)
    joint = Revolute(bar.origin, axis=(0, 0, 1)) if space else Pin(bar.origin)
    return Scene([], [joint], bodies=[bar], loads=[servo], gravity=(0, -G / unit, *more))


def bar_poles(p, i, d, r, m):
    """Return the poles with Im s >= 0 of the bar at rest at its reference r."""
    roots = np.roots([INERTIA + m * ARM**2, d, p - m * G * ARM * np.sin(r), i])
    return roots[roots.imag >= 0]


def nearest(s, roots):
    return roots[np.argmin(np.abs(roots - s))]


@pytest.mark.parametrize("space", [False, True])
@pytest.mark.parametrize(("at", "unit"), [((0, 0), 1.0), ((700, -3e3), 1.0), ((0, 0), 1e-3)])
def test_poles_of_a_held_bar_are_the_roots_of_its_polynomial(at, unit, space):
    scene = bar_scene(at=at, unit=unit, space=space)
    rest = equilibrium(scene)
    system = assemble(scene)
    assert rest.outcome.success
    assert rest.outcome.growth is None
    if not space:
        turned = observe(rotation_angle(scene.bodies[0].origin), rest.solution, system)
        assert turned == pytest.approx(R, rel=1e-9)
    held = MASS * G * ARM * np.cos(R) / I
    assert observe(state("servo", "integral"), rest.solution, system) == pytest.approx(
        held, rel=1e-9
    )
    found, expected = modes(scene, 6, at=rest), bar_poles(P, I, D, R, MASS)
    assert len(found.exponents) == 2
    for s in found.exponents:
        assert s == pytest.approx(nearest(s, expected), rel=1e-8)


def test_derivatives_of_poles_include_the_equilibrium_and_its_state():
    scene = bar_scene()
    rest = equilibrium(scene)
    found = modes(scene, 2, at=rest, design=DESIGN)
    back = modes(scene, 2, at=rest, design=DESIGN, method=Adjoint())
    assert back.derivatives.exponents_b == pytest.approx(found.derivatives.exponents_b, rel=1e-9)
    b = np.array([P, I, D, R, MASS])
    for s, s_b in zip(found.exponents, found.derivatives.exponents_b, strict=True):
        for k, h in enumerate(1e-6 * b):
            up, down = (nearest(s, bar_poles(*(b + e * np.eye(5)[k]))) for e in (h, -h))
            assert s_b[k] == pytest.approx((up - down) / (2 * h), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("gains", [(30, 600, 6), (-30, 60, 6), (30, 60, 0.5)])
def test_equilibrium_says_that_controllers_do_not_hold_it(gains):
    rest = equilibrium(bar_scene(*gains))
    growing = max(bar_poles(*gains, R, MASS), key=lambda s: s.real)
    assert rest.outcome.success
    assert rest.outcome.growth == pytest.approx(growing, rel=1e-7)
    assert "unstable with its damping and controllers" in str(rest.outcome)


def test_a_motor_against_a_spring_rests_at_the_current_of_its_resistance():
    J, resistance, L, k, c, u = 2e-3, 1.5, 0.02, 0.08, 0.5, 3.0
    disc = RigidBody("disc", (0, 0), mass=1.0, inertia=J)
    motor = DCMotor(disc.origin, Constant(u), resistance, L, k, name="motor")
    spring = TorsionalSpringDamper(disc.origin, stiffness=c)
    scene = Scene([], [Pin(disc.origin)], bodies=[disc], loads=[motor, spring])
    rest, system = equilibrium(scene), assemble(scene)
    assert observe(state("motor", "current"), rest.solution, system) == pytest.approx(
        u / resistance
    )
    turned = observe(rotation_angle(disc.origin), rest.solution, system)
    assert turned == pytest.approx(k * u / resistance / c, rel=1e-12)
    roots = np.roots([J * L, J * resistance, c * L + k * k, c * resistance])
    for s in modes(scene, 4, at=rest).exponents:
        assert s == pytest.approx(nearest(s, roots), rel=1e-9)
    value = equilibrium_gradient(
        scene, rotation_angle(disc.origin), design=["motor.value", "motor.resistance"]
    )
    assert value.gradient == pytest.approx([k / resistance / c, -k * u / resistance**2 / c])


@pytest.mark.parametrize("voltage", [0.0, 1.0])
def test_a_motor_that_nothing_holds_is_free(voltage):
    disc = RigidBody("disc", (0, 0), mass=1.0, inertia=2e-3)
    motor = DCMotor(disc.origin, Constant(voltage), 1.5, 0.02, 0.08)
    scene = Scene([], [Pin(disc.origin)], bodies=[disc], loads=[motor])
    with pytest.raises(FreeMotionError, match="disc turns"):
        equilibrium(scene)
    if not voltage:
        found = modes(scene, 6)
        roots = np.roots([2e-3 * 0.02, 2e-3 * 1.5, 0.08**2])
        assert found.exponents[0] == 0
        assert sorted(found.exponents[1:].real) == pytest.approx(sorted(roots), rel=1e-9)


# ---------------------------------------------------------------- a flexible arm


ALLOY = Material(2700, 7e10, 0.33, damping_time=1e-4)
LENGTH, HEIGHT, WIDTH, TIP = 1.0, 0.003, 0.04, 0.1
GAINS = 2.0, 5.0, 0.4


def arm_scene(gains=GAINS, elements=16, reference=0.0, **others):
    arm = Beam("arm", (0, 0), (LENGTH, 0), elements, Rectangle(HEIGHT, WIDTH), ALLOY)
    servo = PID(arm.at_start, Constant(reference), *gains, name="servo")
    loads = [servo, *others.pop("loads", [])]
    mass = PointMass(arm.at_end, TIP)
    return Scene([arm], [Pin(arm.at_start)], bodies=[mass], loads=loads, **others)


def arm_determinant(s, gains=GAINS):
    """Return the determinant of a beam with a PID at its root and a mass at its end.

    w = 0 and E I w'' = (P + I/s + D s) w' at the root, w'' = 0 and E I w''' = m s^2 w at the end.
    """
    p, i, d = gains
    EI = 7e10 * (1 + 1e-4 * s) * WIDTH * HEIGHT**3 / 12
    k = (-2700 * WIDTH * HEIGHT * s * s / EI) ** 0.25
    c, n, C, N = (f(k * LENGTH) for f in (np.cos, np.sin, np.cosh, np.sinh))
    # w = a (cos - cosh) + b sin + e sinh fulfils w(0) = 0.
    hub, mass = p + i / s + d * s, TIP * s * s
    rows = [
        [-2 * EI * k * k, -hub * k, -hub * k],
        [-c - C, -n, N],
        [
            EI * k**3 * (n - N) - mass * (c - C),
            -EI * k**3 * c - mass * n,
            EI * k**3 * C - mass * N,
        ],
    ]
    return np.linalg.det(np.array(rows))


@pytest.mark.parametrize("elements", [16, 60])
def test_poles_of_a_flexible_arm_are_those_of_a_beam_with_a_controller(elements):
    found = modes(arm_scene(elements=elements), 4)
    assert found.unbalanced == 0
    for s in found.exponents:
        root = newton(arm_determinant, s, tol=1e-12, maxiter=100)
        # Shear and the inertia of sections take (h/L)^2 n^2 of a frequency, and the mesh 1e-5.
        assert s == pytest.approx(root, rel=4e-4)
    assert len({round(s.imag, 3) for s in found.exponents}) == 4


def test_gain_at_which_the_arm_becomes_unstable():
    """The integral gain at which poles cross the axis, by the determinant and by the modes."""

    def growth(integral):
        gains = GAINS[0], integral, GAINS[2]
        return max(modes(arm_scene(gains), 2).exponents.real)

    def crossing(integral):
        gains = GAINS[0], integral, GAINS[2]
        guess = modes(arm_scene(gains), 1).exponents[0]
        return newton(arm_determinant, guess, args=(gains,), tol=1e-12, maxiter=100).real

    ends = 0.5, 5.0
    assert growth(ends[0]) < 0 < growth(ends[1])
    assert brentq(growth, *ends, xtol=1e-4) == pytest.approx(
        brentq(crossing, *ends, xtol=1e-4), rel=1e-3
    )


def test_no_motion_from_the_equilibrium_of_an_arm_and_its_controller():
    scene = arm_scene(elements=4, reference=0.4, gravity=(0, -G), start=[EquilibriumStart()])
    system = assemble(scene)
    for integrator in (HHT(2**-7), Radau(2**-5)):
        run = simulate(scene, 0.25, integrator)
        assert np.ptp(observe(position(scene.beams[0].at_end, 1), run, system)) < 1e-12
        assert np.ptp(observe(state("servo", "integral"), run, system)) < 1e-12


def test_derivatives_of_a_motion_include_the_states_of_its_equilibrium():
    arm = arm_scene(elements=4).beams[0]
    push = PointForce(arm.at_end, (0, 1.0), name="push")
    scene = arm_scene(elements=4, reference=0.4, gravity=(0, -G), loads=[push])
    held = scene.loads[0]
    scene = replace(scene, start=[EquilibriumStart(loads=[held])])
    design = ["servo.integral", "servo.value", "arm.height", "push.force_y"]
    cost = Terminal(position(scene.beams[0].at_end, 1) + 0.1 * state("servo", "integral"))
    found = {
        type(method): gradient(scene, cost, 0.125, HHT(2**-7), design=design, method=method)
        for method in (DirectDifferentiation(), Adjoint(), ComplexStep())
    }
    direct = found[DirectDifferentiation].gradient
    assert found[Adjoint].gradient == pytest.approx(direct, rel=1e-9)
    assert found[ComplexStep].gradient == pytest.approx(direct, rel=1e-9)
    system = assemble(scene, design)
    for k, h in enumerate(1e-4 * system.b):
        values = []
        for e in (h, -h):
            b = system.b + e * np.eye(4)[k]
            values.append(gradient(system.with_values(b), cost, 0.125, HHT(2**-7)).value)
        assert (values[0] - values[1]) / (2 * h) == pytest.approx(direct[k], rel=1e-5)


def test_states_that_do_not_act_in_the_equilibrium_start_as_declared():
    scene = arm_scene(elements=4, reference=0.4, gravity=(0, -G))
    hub = scene.beams[0].at_start
    lag = FirstOrderLag(hub, Constant(0.3), 0.05, initial_effort=0.1, name="lag")
    both = replace(
        scene, loads=[lag, *scene.loads], start=[EquilibriumStart(loads=list(scene.loads))]
    )
    run, rest = simulate(both, 0.01, HHT(0.01)), equilibrium(scene)
    starts = [
        observe(state(*x), run, assemble(both))[0]
        for x in (("lag", "effort"), ("servo", "integral"))
    ]
    alone = observe(state("servo", "integral"), rest.solution, assemble(scene))[0]
    assert starts == pytest.approx([0.1, alone], rel=1e-12)


# ---------------------------------------------------------------- controllers of one's own


@dataclass(frozen=True)
class Limited(Controller):
    """A filtered measurement, and a torque that saturates: its slope depends on the state."""

    point: MaterialPoint
    reference: Law
    gain: float
    damping: float
    filter_time: float
    largest: float

    kind = "limited"
    states = ("measured",)
    design_fields = (
        ("reference", require_law),
        *design_numbers("gain", "damping", "filter_time", "largest"),
        LAW_FIELD,
    )

    def axes(self, p):
        return (RotationAxis(self.point),)

    def equations(self, at, p):
        _, gain, damping, tau, largest, _ = self.split(p)
        wanted = gain * (at.laws[0] - at.states[0]) - damping * at.rates[0]
        return [(at.coordinates[0] - at.states[0]) / tau], [largest * np.tanh(wanted / largest)]


def test_a_saturated_torque_acts_with_the_slope_of_the_equilibrium():
    gain, damping, tau, largest, r = 25.0, 4.0, 0.02, 12.0, 0.8
    bar = RigidBody("bar", (0, 0), mass=MASS, inertia=INERTIA, centre=(ARM, 0))
    servo = Limited(bar.origin, Constant(r), gain, damping, tau, largest, name="servo")
    scene = Scene([], [Pin(bar.origin)], bodies=[bar], loads=[servo], gravity=(0, -G))
    rest = equilibrium(scene)
    weight = MASS * G * ARM

    def left(angle):
        return largest * np.tanh(gain * (r - angle) / largest) - weight * np.cos(angle)

    angle = brentq(left, -1.0, 1.0, xtol=1e-14)
    system = assemble(scene)
    assert observe(rotation_angle(bar.origin), rest.solution, system) == pytest.approx(angle)
    assert observe(state("servo", "measured"), rest.solution, system) == pytest.approx(angle)
    slope = 1 - np.tanh(gain * (r - angle) / largest) ** 2
    J, stiffness = INERTIA + MASS * ARM**2, -weight * np.sin(angle)
    # J a + slope (damping v + gain x) + stiffness q = 0, tau x' = q - x.
    roots = np.roots(
        [
            J * tau,
            J + slope * damping * tau,
            slope * damping + stiffness * tau,
            stiffness + slope * gain,
        ]
    )
    for s in modes(scene, 4, at=rest).exponents:
        assert s == pytest.approx(nearest(s, roots), rel=1e-9)
    unmoved = modes(scene, 4, at=LinearisationPoint.of(rest.solution))
    assert unmoved.exponents == pytest.approx(modes(scene, 4, at=rest).exponents, rel=1e-12)


# ---------------------------------------------------------------- guides, and what is refused


def test_a_guide_starts_from_the_equilibrium():
    beam = Beam("beam", (0, 0), (1, 0), 4, Rectangle(0.01, 0.01), ALLOY)
    bead = RigidBody("bead", (0.3, 0), mass=0.2, inertia=1e-4)
    guide = SlidingJoint("beam", bead.origin, fraction=0.3, rolling_mass=1e-3)
    scene = Scene(
        [beam],
        [Clamp(beam.at_start), Pin(beam.at_end), guide],
        bodies=[bead],
        loads=[TorsionalSpringDamper(bead.origin, stiffness=1.0)],
        gravity=(0, -G),
        start=[EquilibriumStart()],
    )
    run = simulate(scene, 0.05, HHT(0.005))
    assert run.outcome.success
    assert np.ptp(observe(position(bead.origin, 0), run, assemble(scene))) < 1e-10
    moving = replace(guide, speed=0.1)
    with pytest.raises(InvalidInputError, match="guides must not slide"):
        replace(scene, joints=[*scene.joints[:2], moving])


def test_what_controllers_leave_open_is_refused():
    scene = bar_scene()
    with pytest.raises(InvalidInputError, match=r"damped.*controllers"):
        modes(scene, damped=False)
    with pytest.raises(InvalidInputError, match="no controllers with states"):
        critical_load(scene, "servo.proportional", 1.0)


def test_a_step_follows_the_mechanism_with_its_gains():
    scene = bar_scene(i=0.0, r=0.0)
    period = 2 * np.pi / np.sqrt(P / (INERTIA + MASS * ARM**2))
    assert suggest_step(scene, 20.0).slowest == pytest.approx(period, rel=1e-9)


# ---------------------------------------------------------------- loops without a stiffness


@pytest.mark.parametrize(("damping", "filter_time"), [(2.0, 0.02), (0.5, 1e-3), (0.0, 0.02)])
def test_a_position_that_acts_through_a_state_alone_is_not_free(damping, filter_time):
    """The arm of docs/howto/control.md, whose torque is saturated at the start."""
    arm = RigidBody("arm", (0, 0), mass=1.0, inertia=0.1)
    servo = Limited(arm.origin, Constant(1.0), 10.0, damping, filter_time, 1.5, name="servo")
    scene = Scene([], [Pin(arm.origin)], bodies=[arm], loads=[servo])
    rest = equilibrium(scene)
    roots = np.roots(np.polyadd(np.polymul([0.1, damping, 0.0], [filter_time, 1.0]), [10.0]))
    found = modes(scene, 4, at=rest).exponents
    assert len(found) == 2
    for s in found:
        assert s == pytest.approx(nearest(s, roots), rel=1e-8)
    assert (rest.outcome.growth is None) == (max(roots.real) < 0)


def test_an_integral_alone_drives_its_loop_unstable():
    disc = RigidBody("disc", (0, 0), mass=1.0, inertia=0.19)
    servo = PID(disc.origin, Constant(0.2), 0.0, 10.0, name="servo")
    rest = equilibrium(Scene([], [Pin(disc.origin)], bodies=[disc], loads=[servo]))
    roots = np.roots([0.19, 0.0, 0.0, 10.0])
    assert rest.outcome.growth == pytest.approx(max(roots, key=lambda s: (s.real, s.imag)))


def test_derivatives_of_the_poles_of_a_free_rotor():
    J, R, L, k = 0.1, 1.5, 0.02, 0.08
    rotor = RigidBody("rotor", (0, 0), mass=1.0, inertia=J)
    motor = DCMotor(rotor.origin, Constant(0.0), R, L, k, name="m")
    scene = Scene([], [Pin(rotor.origin)], bodies=[rotor], loads=[motor])
    found = modes(scene, 3, design=["m.resistance", "m.inductance", "m.torque_constant"])
    for s, s_b in zip(found.exponents, found.derivatives.exponents_b, strict=True):
        if s == 0:
            assert np.all(s_b == 0)
            continue
        # J L s^2 + J R s + k^2 = 0.
        slope = 2 * J * L * s + J * R
        assert s_b == pytest.approx(-np.array([J * s, J * s * s, 2 * k]) / slope, rel=1e-7)


def test_a_state_without_a_value_at_rest_is_named():
    disc = RigidBody("disc", (0, 0), mass=1.0, inertia=0.19)
    servo = PID(disc.origin, Constant(0.2), 3.0, 0.0, 1.0, name="servo")
    with pytest.raises(FreeMotionError, match="states of 'servo'"):
        equilibrium(Scene([], [Pin(disc.origin)], bodies=[disc], loads=[servo]))


@pytest.mark.parametrize("count", [1, 2])
def test_the_highest_poles_are_as_many_as_were_asked_for(count):
    scene = bar_scene()
    found = modes(scene, count, at=equilibrium(scene), highest=True).exponents
    farthest = sorted(bar_poles(P, I, D, R, MASS), key=abs, reverse=True)[:count]
    assert sorted(found, key=abs, reverse=True) == pytest.approx(farthest, rel=1e-8)
