"""Controllers, motors and lags: states x' = f(x, s, s', r, r', b) beside the mechanism.

Closed forms of linear circuits, and minimal coordinates integrated by SciPy, which share nothing
with the equations of the package.
"""

import functools
import warnings
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    IDAS,
    PID,
    AdaptiveSteps,
    Adjoint,
    Beam,
    ComplexStep,
    ContinuousAdjoint,
    DCMotor,
    DirectDifferentiation,
    EquilibriumStart,
    FirstOrderLag,
    Integral,
    Material,
    Mode,
    Pin,
    PointMass,
    PointOnLine,
    PrescribedSteps,
    Prismatic,
    Radau,
    Revolute,
    RigidBody,
    RotatingFrame,
    Scene,
    Switch,
    Terminal,
    TorsionalSpringDamper,
    assemble,
    check_system,
    critical_load,
    gradient,
    gradients,
    load_solution,
    simulate,
)
from ancfdae.errors import InvalidInputError, UnknownNameError, UnlikelyValueWarning
from ancfdae.extend import (
    LAW_FIELD,
    Controller,
    Law,
    MaterialPoint,
    RotationAxis,
    TranslationAxis,
    design_numbers,
    require_law,
)
from ancfdae.laws import Constant, ConstantAcceleration, Harmonic
from ancfdae.observables import (
    effort,
    elapsed_time,
    inertia,
    kinetic_energy,
    linear_momentum,
    load_power,
    position,
    reaction,
    state,
)
from ancfdae.observables import observe as values
from ancfdae.sections import Rectangle

U, R, L, K, J = 12.0, 1.5, 0.02, 0.08, 2e-3


def motor_scene(u=U, r=R, l=L, k=K, j=J, i=0.5):
    """A disc on the shaft of a motor with resistance and inductance."""
    disc = RigidBody("disc", (0.3, 0.2), mass=1.0, inertia=j)
    motor = DCMotor(disc.origin, Constant(u), r, l, k, i, name="motor")
    return Scene(bodies=[disc], joints=[Pin(disc.origin)], loads=[motor])


def motor_by_hand(t, u=U, r=R, l=L, k=K, j=J, i=0.5):
    """Current and speed: [i, w]' = A [i, w] + [u/L, 0], by the exponential of the matrix."""
    A = np.array([[-r / l, -k / l, u / l], [k / j, 0, 0], [0, 0, 0]])
    return (expm(A * t) @ [i, 0.0, 1.0])[:2]


MOTOR = {"motor.value": "u", "motor.resistance": "r", "motor.inductance": "l"}
MOTOR |= {"motor.torque_constant": "k", "disc.inertia": "j", "motor.initial_current": "i"}
SPAN = 0.25


def current(run, scene):
    return values(state("motor", "current"), run, assemble(scene))


@pytest.mark.parametrize("method", [Radau(rtol=1e-11), DOP853(1e-12), IDA(1e-12)], ids=repr)
def test_a_motor_with_inductance_is_its_closed_form(method):
    scene = motor_scene()
    run = simulate(scene, SPAN, method)
    assert run.outcome.success
    i = np.array([motor_by_hand(t)[0] for t in run.t])
    # The largest current is 6 A; IDA errs by a hundred tolerances.
    assert np.max(np.abs(current(run, scene) - i)) < 1e-9
    disc = run.velocity(scene.bodies[0].at(1.0))[-1] @ run.slope(scene.bodies[0].origin, 1)[-1]
    assert disc == pytest.approx(motor_by_hand(run.t[-1])[1], abs=1e-8)


def test_states_are_of_second_order_with_numerical_damping_and_without():
    for alpha in (-0.3, -0.05):
        errors = []
        for n in (8, 9, 10, 11):
            scene = motor_scene()
            run = simulate(scene, SPAN, HHT(SPAN / 2**n, hht_alpha=alpha))
            i = np.array([motor_by_hand(t)[0] for t in run.t])
            errors.append(np.max(np.abs(current(run, scene) - i)))
        slopes = np.log2(np.array(errors[:-1]) / errors[1:])
        assert slopes == pytest.approx([2.0] * 3, abs=0.05)


def test_derivatives_of_states_are_of_second_order():
    name = "motor.inductance"
    h = 1e-5 * L
    exact = (motor_by_hand(SPAN, l=L + h)[0] - motor_by_hand(SPAN, l=L - h)[0]) / (2 * h)
    ends = [
        gradient(
            motor_scene(),
            Terminal(state("motor", "current")),
            SPAN,
            HHT(SPAN / 2**n),
            design=[name],
        ).gradient[0]
        for n in (8, 9, 10)
    ]
    errors = np.abs(np.array(ends) - exact)
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.1)


def test_a_stiff_winding_does_not_oscillate():
    # L/R = 1e-6 s, and steps a thousand times as long: the current follows (u - k w)/R, and
    # numerical damping keeps it of second order from the first step on.
    scene, errors = motor_scene(l=1.5e-6, i=U / R), []
    for n in (250, 500, 1000):
        run = simulate(scene, SPAN, HHT(SPAN / n))
        exact = np.array([motor_by_hand(t, l=1.5e-6, i=U / R)[0] for t in run.t])
        errors.append(np.max(np.abs(current(run, scene) - exact)))
    assert errors[2] < 1e-4 * U / R
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.05)


@pytest.mark.parametrize("method", [DOP853(1e-11), Radau(rtol=1e-10)], ids=repr)
def test_derivatives_of_the_motor_are_those_of_its_closed_form(method):
    objective = Terminal(state("motor", "current"))
    found = gradient(motor_scene(), objective, SPAN, method, design=list(MOTOR)).gradient
    numbers = {"u": U, "r": R, "l": L, "k": K, "j": J, "i": 0.5}
    for slope, name in zip(found, MOTOR.values(), strict=True):
        x, h = numbers[name], 1e-4 * numbers[name]
        a, b, c, d = (motor_by_hand(SPAN, **{name: x + m * h})[0] for m in (2, 1, -1, -2))
        # Of fourth order: 1e-16 truncated, 1e-12 of round-off over h.
        assert slope * x == pytest.approx((8 * (b - c) - (a - d)) / 12e-4, abs=1e-8)


# ---------------------------------------------------------------- PID of a rigid arm

MASS, INERTIA, CENTRE, GRAVITY = 1.2, 0.03, 0.35, 9.81
GAINS = {"proportional": 25.0, "integral": 40.0, "derivative": 1.5}
REFERENCE = Harmonic(0.6, 1.5, 0.3)
TIME = 1.5


@dataclass(frozen=True)
class Units:
    """Units of length, mass and time relative to m, kg and s, and the place in m."""

    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0
    place: float = 0.0

    @property
    def torque(self):
        return self.mass * self.length**2 / self.time**2

    def law(self):
        return Harmonic(REFERENCE.amplitude, REFERENCE.frequency / self.time, REFERENCE.phase)


def arm_scene(units=Units()):
    """An arm on a pin under gravity, turned to a reference by a controller."""
    length, m = units.length, units.mass
    arm = RigidBody(
        "arm",
        (units.place * length, 2 * units.place * length),
        mass=MASS * m,
        inertia=INERTIA * m * length**2,
        centre=(CENTRE * length, 0.0),
    )
    gains = np.array([*GAINS.values()]) * units.torque * units.time ** np.array([0, -1, 1])
    pid = PID(arm.origin, units.law(), *gains.tolist(), name="pid")
    gravity = (0.0, -GRAVITY * length / units.time**2)
    return Scene(bodies=[arm], joints=[Pin(arm.origin)], loads=[pid], gravity=gravity)


def arm_by_hand(t_end=TIME, mass=MASS, **changes):
    """Angle, speed and integral at the end, in minimal coordinates."""
    P, I, D = (GAINS | changes).values()

    def rate(t, y):
        e, e_t = REFERENCE.at(t) - y[0], REFERENCE.at(t, 1) - y[1]
        torque = P * e + I * y[2] + D * e_t - mass * GRAVITY * CENTRE * np.cos(y[0])
        return [y[1], torque / (INERTIA + mass * CENTRE**2), e]

    settings = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}
    return solve_ivp(rate, (0, t_end), [0, 0, 0], **settings).y[:, -1]


ARM = [*(f"pid.{name}" for name in GAINS), "arm.mass"]
ENDS = [position(arm_scene().bodies[0].at(1.0), 1), state("pid", "integral")]


@pytest.mark.parametrize("method", [DOP853(1e-12), Radau(rtol=1e-11), IDA(1e-12)], ids=repr)
def test_a_controlled_arm_is_that_of_minimal_coordinates(method):
    scene = arm_scene()
    run = simulate(scene, TIME, method)
    theta, _, z = arm_by_hand()
    ends = [values(x, run, assemble(scene))[-1] for x in ENDS]
    assert ends == pytest.approx([np.sin(theta), z], abs=1e-9)


@functools.cache
def arm_slopes():
    """Derivatives of both ends, of fourth order in changes of a thousandth: 1e-10."""
    columns = []
    for name, x in (GAINS | {"mass": MASS}).items():
        a, b, c, d = (arm_by_hand(**{name: x * (1 + m * 1e-3)}) for m in (2, 1, -1, -2))
        columns.append((8 * (b - c) - (a - d)) / (12e-3 * x))
    theta = arm_by_hand()[0]
    theta_b, _, z_b = np.array(columns).T
    return np.array([np.cos(theta) * theta_b, z_b])


@pytest.mark.parametrize("method", [DOP853(1e-12), Radau(rtol=1e-11), IDA(1e-12)], ids=repr)
def test_derivatives_in_gains_are_those_of_minimal_coordinates(method):
    found = gradients(arm_scene(), [Terminal(end) for end in ENDS], TIME, method, design=ARM)
    for ours, expected in zip(found, arm_slopes(), strict=True):
        assert ours.gradient == pytest.approx(expected, abs=1e-7 * np.max(np.abs(expected)))


@pytest.mark.idas
@pytest.mark.parametrize("way", [DirectDifferentiation(), Adjoint()], ids=repr)
def test_idas_has_the_same_derivatives_forward_and_backward(way):
    for objective, expected in zip(map(Terminal, ENDS), arm_slopes(), strict=True):
        found = gradient(arm_scene(), objective, TIME, IDAS(1e-11), design=ARM, method=way).gradient
        assert found == pytest.approx(expected, abs=1e-7 * np.max(np.abs(expected)))


def test_motion_reactions_and_states_are_of_second_order_under_a_moving_reference():
    # The reference moves from the start, so that its rates enter the start of the recurrence.
    scene, t_end, errors = arm_scene(), 0.5, []
    scene = replace(scene, joints=[Pin(scene.bodies[0].origin, name="pin")])
    system, exact = assemble(scene), simulate(scene, t_end, DOP853(1e-12, 512))
    observables = [*ENDS, reaction("pin", 1), effort("pid")]
    for n in (7, 8, 9):
        run = simulate(scene, t_end, HHT(2.0**-n))
        places = np.searchsorted(exact.t, run.t - 1e-9)
        assert exact.t[places] == pytest.approx(run.t, abs=1e-12)
        pairs = [(values(x, run, system), values(x, exact, system)[places]) for x in observables]
        errors.append([np.max(np.abs(x - y)) for x, y in pairs])
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(
        np.full((2, 4), 2.0), abs=0.02
    )


def compared(scene, objective, t_end, method, design, tolerance):
    """Direct differentiation, the discrete adjoint and complex steps agree."""
    call = scene, objective, t_end, method
    ways = DirectDifferentiation(), Adjoint(), ComplexStep()
    direct, *others = (gradient(*call, design=design, method=way) for way in ways)
    b = assemble(scene, design).b
    size = np.max(np.abs(direct.gradient * b))
    assert np.all(direct.gradient != 0)
    for other in others:
        assert np.max(np.abs((direct.gradient - other.gradient) * b)) <= tolerance * size
    return direct.gradient


@pytest.mark.parametrize("method", [HHT(2.0**-7), Radau(2.0**-8), HHT(rtol=1e-4)], ids=repr)
def test_direct_differentiation_adjoint_and_complex_step_agree(method):
    if isinstance(method.steps, AdaptiveSteps):
        times = simulate(arm_scene(), TIME / 4, method).t
        method = HHT(PrescribedSteps(times))
    for objective in (*map(Terminal, ENDS), Integral(effort("pid") ** 2)):
        design = [*ARM, "pid.amplitude", "pid.frequency"]
        compared(arm_scene(), objective, TIME / 4, method, design, 1e-10)
    design = [name for name in MOTOR if name != "motor.value"]
    objective = Integral(load_power("motor") + state("motor", "current") ** 2)
    if not isinstance(method.steps, PrescribedSteps):
        compared(motor_scene(), objective, SPAN / 4, method, design, 1e-10)


def test_the_continuous_adjoint_converges_to_the_derivative():
    objective, errors = Integral(effort("pid") ** 2), []
    exact = gradient(arm_scene(), objective, TIME, DOP853(1e-11), design=ARM).gradient
    for n in (7, 8):
        way = ContinuousAdjoint()
        found = gradient(arm_scene(), objective, TIME, HHT(2.0**-n), design=ARM, method=way)
        errors.append(np.max(np.abs(found.gradient - exact) / np.max(np.abs(exact))))
    assert errors[1] < 0.01
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.2)


# Powers of two, so that the same numbers are rounded.
OTHER = Units(1024.0, 2.0**-10, 0.125)


@pytest.mark.parametrize(
    "method",
    [
        lambda s: HHT(2.0**-7 * s),
        lambda s: HHT(rtol=1e-5),
        lambda s: Radau(rtol=1e-6),
        lambda s: IDA(1e-8),
        lambda s: DOP853(1e-8),
    ],
    ids=["HHT", "HHT(rtol)", "Radau", "IDA", "DOP853"],
)
def test_nothing_depends_on_units(method):
    ends, steps, slopes = [], [], []
    for units in (Units(), OTHER):
        scene, t_end = arm_scene(units), TIME * units.time
        run = simulate(scene, t_end, method(units.time))
        z = values(state("pid", "integral"), run, assemble(scene))[-1] / units.time
        ends.append([run.position(scene.bodies[0].at(1.0))[-1, 1], z])
        steps.append(run.statistics.steps)
        objective = Terminal(state("pid", "integral"))
        found = gradient(scene, objective, t_end, method(units.time), design=ARM[:3]).gradient
        b = assemble(scene, ARM[:3]).b
        slopes.append(found * b / units.time)
    assert steps[0] == steps[1]
    # IDA measures its first step in seconds, and no other method in anything.
    assert ends[1] == pytest.approx(ends[0], abs=1e-10)
    assert slopes[1] == pytest.approx(slopes[0], abs=1e-9)


@dataclass(frozen=True)
class Solenoid(Controller):
    """A torque with the square of a current, which is written in a unit: zero at the start."""

    point: MaterialPoint
    drive: Law
    unit: float

    kind = "solenoid"
    states = ("current",)
    design_fields = (("drive", require_law), ("unit", lambda where, value: None), LAW_FIELD)

    def axes(self, p):
        return (RotationAxis(self.point),)

    def equations(self, at, p):
        unit, current = self.split(p)[1], at.states[0]
        return [(unit * at.laws[0] - current) / 0.05], [0.02 * (current / unit) ** 2]


@pytest.mark.parametrize("method", [HHT(rtol=1e-4), IDA(1e-8), Radau(rtol=1e-6)], ids=repr)
@pytest.mark.parametrize("law", [Harmonic(1.0, 50.0), Constant(1.0)], ids=repr)
def test_an_effort_that_starts_with_a_partial_of_zero_has_no_unit(method, law):
    ends, steps = [], []
    for unit in (1.0, 2.0**-30, 2.0**30):
        arm = RigidBody("arm", (0, 0), mass=1.0, inertia=1e-2)
        load = Solenoid(arm.origin, law, unit, name="coil")
        scene = Scene(bodies=[arm], joints=[Pin(arm.origin)], loads=[load])
        run = simulate(scene, 0.3, method)
        x = values(state("coil", "current"), run, assemble(scene))[-1]
        ends.append([x / unit, *run.velocity(arm.at(1.0))[-1]])
        steps.append(run.statistics.steps)
    assert steps[0] == steps[1] == steps[2]
    assert np.array(ends[1:]) == pytest.approx(np.array([ends[0]] * 2), rel=1e-8)


@pytest.mark.parametrize("method", [HHT(2.0**-7), HHT(rtol=1e-5), Radau(rtol=1e-6), DOP853(1e-8)])
def test_nothing_depends_on_the_place(method):
    ends = []
    for place in (0.0, 1e3):
        scene = arm_scene(Units(place=place))
        run = simulate(scene, TIME, method)
        z = values(state("pid", "integral"), run, assemble(scene))[-1]
        theta = run.slope(scene.bodies[0].origin, 0)[-1]
        objective = Terminal(state("pid", "integral"))
        ends.append([z, *theta, *gradient(scene, objective, TIME, method, design=ARM).gradient])
    # Positions of 1000 m have 1e-13 m.
    assert ends[1] == pytest.approx(ends[0], abs=1e-9)


def test_the_mass_of_a_state_is_without_influence(monkeypatch):
    from ancfdae.assembly import numbers

    own = numbers.state_masses
    expected = simulate(arm_scene(), TIME, HHT(2.0**-7))
    for factor in (1e-4, 1e4):
        monkeypatch.setattr(numbers, "state_masses", lambda *x, f=factor: f * own(*x))
        run = simulate(arm_scene(), TIME, HHT(2.0**-7))
        assert not np.array_equal(run.v, expected.v)
        # Newton's method leaves 1e-14 of forces, which the factor shares out otherwise.
        assert np.max(np.abs(run.v - expected.v)) < 1e-9


def test_states_are_no_masses():
    scene = arm_scene()
    # Velocities that meet the joints, for the power.
    system, run = assemble(scene), simulate(arm_scene(), TIME, DOP853(1e-10))
    assert np.ptp(values(state("pid", "integral"), run, system)) > 0.01
    for whole in (kinetic_energy, inertia, functools.partial(linear_momentum, 0)):
        its = whole(beam="arm")
        assert values(whole(), run, system) == pytest.approx(values(its, run, system), rel=1e-12)
    theta_t = (
        run.velocity(scene.bodies[0].at(1.0))
        @ [0.0, 1.0]
        / run.slope(scene.bodies[0].origin, 0)[:, 0]
    )
    power = values(load_power("pid"), run, system)
    assert power == pytest.approx(values(effort("pid"), run, system) * theta_t, abs=1e-9)


# ---------------------------------------------------------------- a flexible arm


def flexible_scene(d=2):
    """A flexible arm with a mass at its tip, turned about its root by a controller."""
    end = (0.5, 0.0, 0.0)[:d]
    arm = Beam("arm", (0.0,) * d, end, 3, Rectangle(0.012, 0.02), Material(2700, 7e8, 0.3, 2e-3))
    tip = PointMass(arm.at_end, 0.05, name="tip")
    pid = PID(arm.at_start, Harmonic(0.5, 6.0), 6.0, 20.0, 0.5, name="pid")
    axis = Pin(arm.at_start) if d == 2 else Revolute(arm.at_start, axis=(0, 0, 1), ground=(0, 0, 0))
    return Scene([arm], [axis], bodies=[tip], loads=[pid])


@pytest.mark.parametrize("d", [2, 3])
def test_gradients_of_a_controlled_flexible_arm_are_differences_of_the_call(d):
    scene, t_end, method = flexible_scene(d), 0.25, HHT(2.0**-9)
    design = ["pid.proportional", "pid.integral", "pid.derivative", "arm.height", "tip.mass"]
    design += ["arm.length", "arm.youngs_modulus"]
    arm = scene.beams[0]
    objective = Integral((position(arm.at_end, 1) - 0.2) ** 2 + 1e-3 * effort("pid") ** 2)
    found = compared(scene, objective, t_end, method, design, 1e-9)
    b = assemble(scene, design).b
    size = np.max(np.abs(found * b))

    def value(name, x):
        moved = scene.with_values({name: x})
        return objective.value(*states_of(moved, t_end, method))

    for name, x, slope in zip(design, b, found, strict=True):
        a, b_, c, e = (value(name, x * (1 + m * 2e-4)) for m in (2, 1, -1, -2))
        assert abs((8 * (b_ - c) - (a - e)) / 24e-4 - slope * x) < 1e-7 * size, name


def states_of(scene, t_end, method):
    from ancfdae.sensitivity.observables.observable import states_of

    return assemble(scene), states_of(simulate(scene, t_end, method))


def test_bodies_follow_their_joints_beside_states():
    # A slider-crank, whose bodies are moved onto their joints where the crank has another length.
    parts = Rectangle(0.03, 0.03), Material(2700, 7e10, 0.3)
    crank = Beam("crank", (0, 0), (0.2, 0.2), 1, *parts, rigid=True)
    rod = Beam("rod", (0.2, 0.2), (0.8, 0.0), 1, *parts, rigid=True)
    joints = [
        Pin(crank.at_start),
        Pin(crank.at_end, rod.at_start),
        PointOnLine(rod.at_end, direction=(1, 0)),
    ]
    motor = DCMotor(crank.at_start, Constant(U), R, L, 5 * K, 0.5, name="motor")
    scene = Scene([crank, rod], joints, loads=[motor], assemble=True)
    objective, design = Terminal(state("motor", "current")), ["crank.length", "motor.inductance"]
    method = HHT(2.0**-9)
    found = compared(scene, objective, 0.125, method, design, 1e-9)

    def end(x):
        moved = scene.with_values({"crank.length": x})
        return values(objective.observable, simulate(moved, 0.125, method), assemble(moved))[-1]

    length = 0.2 * 2**0.5
    a, b, c, e = (end(length * (1 + m * 1e-3)) for m in (2, 1, -1, -2))
    slope = (8 * (b - c) - (a - e)) / (12e-3 * length)
    assert found[0] == pytest.approx(slope, rel=1e-7)


# ---------------------------------------------------------------- other parts and axes


def test_a_lagging_force_pushes_a_mass_as_its_closed_form():
    """m x'' = F, F' = (c - F)/tau: x' = (c t - tau (c - F_0)(1 - exp(-t/tau)))/m."""
    c, tau, F_0, m = 3.0, 0.1, -1.0, 2.0
    body = RigidBody("body", (0.0, 0.0), mass=m, inertia=1.0)
    way = np.array([3.0, 4.0])
    lag = FirstOrderLag(body.origin, Constant(c), tau, F_0, direction=way, name="lag")
    for rail in ([], [Prismatic(body.origin, tuple(way))]):
        scene = Scene(bodies=[body], joints=rail, loads=[lag])
        run = simulate(scene, 0.5, DOP853(1e-12))
        t, decay = run.t, np.exp(-run.t / tau)
        speed = (c * t - tau * (c - F_0) * (1 - decay)) / m
        assert run.velocity(body.origin) == pytest.approx(np.outer(speed, way / 5), abs=1e-10)
        force = values(effort("lag"), run, assemble(scene))
        assert force == pytest.approx(c + (F_0 - c) * decay, abs=1e-10)


def test_a_motor_between_two_bodies_in_space_is_the_planar_one():
    axis = np.array([1.0, 2.0, 2.0]) / 3
    box = {"mass": 1.0, "inertia": (0.02, 0.03, 0.04)}
    base = RigidBody("base", (0.1, 0.0, 0.2), **box)
    across = np.linalg.svd(axis[None])[2][1:]
    across[1] = np.cross(axis, across[0])
    wheel = RigidBody("wheel", (0.1, 0.0, 0.2), mass=1.0, inertia=(J, J, J), frame=[*across, axis])
    motor = DCMotor(wheel.origin, Constant(U), R, L, K, 0.5, tuple(axis), base.origin, name="motor")
    held = TorsionalSpringDamper(base.origin, 1e7, 0.0, 0.0, tuple(axis))
    joints = [
        Revolute(wheel.origin, axis=tuple(axis), other=base.origin),
        Revolute(base.origin, axis=tuple(axis), ground=(0.1, 0.0, 0.2)),
    ]
    scene = Scene(bodies=[base, wheel], joints=joints, loads=[motor])
    run = simulate(scene, SPAN, DOP853(1e-11))
    # The base turns back with the same torque: w is the difference, of the reduced inertia.
    own = float(axis @ np.diag(box["inertia"]) @ axis)
    exact = [motor_by_hand(t, j=1 / (1 / J + 1 / own))[0] for t in run.t]
    assert current(run, scene) == pytest.approx(np.array(exact), abs=1e-8)
    assert held.stiffness > 0


@dataclass(frozen=True)
class Follower(Controller):
    """A mass on two rails that follows two laws, with a filter for each, and their sum."""

    point: MaterialPoint
    to_x: Law
    to_y: Law
    gain: float

    kind = "follower"
    states = ("x", "y", "sum")
    design_fields = (
        ("to_x", lambda where, value: None),
        ("to_y", lambda where, value: None),
        ("gain", lambda where, value: None),
        LAW_FIELD,
    )

    def axes(self, p):
        return tuple(TranslationAxis(self.point, e) for e in np.eye(2))

    def equations(self, at, p):
        gain = self.split(p)[2]
        errors = [r - s for r, s in zip(at.laws, at.coordinates, strict=True)]
        rates = [20 * (e - x) for e, x in zip(errors, at.states, strict=False)]
        damped = [gain * (x - 0.2 * v) for x, v in zip(at.states, at.rates, strict=False)]
        return [*rates, at.states[0] + at.states[1]], damped


def test_states_of_a_controller_with_two_axes_and_laws_are_a_linear_system():
    body = RigidBody("body", (1.0, 2.0), mass=2.0, inertia=1.0)
    laws = ConstantAcceleration(0.1, 0.2), Constant(0.3)
    load = Follower(body.origin, *laws, 50.0, name="follower")
    scene = Scene(bodies=[body], loads=[load])
    run = simulate(scene, 0.6, DOP853(1e-12))
    # [s, v, x] of an axis: s' = v, 2 v' = 50 (x - v/5), x' = 20 (r - s - x).
    A = np.array([[0, 1, 0], [0, -5, 25], [-20, 0, -20]])
    for axis, law in enumerate(laws):
        r, r_t = law.at(0.0), law.at(0.0, 1)
        whole = np.zeros((5, 5))
        whole[:3, :3], whole[2, 3], whole[3, 4] = A, 20, 1
        end = expm(whole * 0.6) @ [0, 0, 0, r, r_t]
        assert run.position(body.origin)[-1, axis] - (1 + axis) == pytest.approx(end[0], abs=1e-11)
        x = values(state("follower", "xy"[axis]), run, assemble(scene))
        assert x[-1] == pytest.approx(end[2], abs=1e-11)
    design = ["follower.to_x_speed", "follower.to_y_value", "follower.gain", "body.mass"]
    objective = Terminal(state("follower", "sum") + effort("follower", 1))
    compared(scene, objective, 0.6, HHT(0.01), design, 1e-10)
    # The third state meets states only: it counts as they do over the time of their filters.
    masses = assemble(scene).weights.reshape(-1, 2)[-3:, 0]
    assert masses[2] == pytest.approx(20**2 * masses[0])
    assert check_system(assemble(scene, design), samples=1).passed


def test_a_motion_starts_from_an_equilibrium_of_other_loads():
    # A spring holds the arm before the controller takes over.
    scene = arm_scene()
    arm = scene.bodies[0]
    held = TorsionalSpringDamper(arm.origin, 30.0, name="held")
    scene = replace(scene, start=[EquilibriumStart(loads=[held])])
    run = simulate(scene, TIME, HHT(2.0**-7))
    theta = np.arctan2(*run.slope(arm.origin, 0)[0][::-1])
    # 30 theta + m g c cos(theta) = 0
    assert 30 * theta + MASS * GRAVITY * CENTRE * np.cos(theta) == pytest.approx(0, abs=1e-9)
    objective, design = Terminal(ENDS[0]), ["held.stiffness", *ARM]
    found = compared(scene, objective, TIME, HHT(2.0**-7), design, 1e-9)

    def end(k):
        moved = scene.with_values({"held.stiffness": k})
        return values(ENDS[0], simulate(moved, TIME, HHT(2.0**-7)), assemble(moved))[-1]

    assert found[0] == pytest.approx((end(30.003) - end(29.997)) / 0.006, rel=1e-5)


def test_initial_states_follow_the_design_beside_an_equilibrium():
    disc = RigidBody("disc", (0.3, 0.2), mass=1.0, inertia=J)
    motor = DCMotor(disc.origin, Constant(U), R, L, K, 0.5, name="motor")
    held = TorsionalSpringDamper(disc.origin, 1.0, free_angle=0.1)
    start = [EquilibriumStart(loads=[held])]
    scene = Scene(bodies=[disc], joints=[Pin(disc.origin)], loads=[motor], start=start)
    objective, design = Terminal(state("motor", "current")), ["motor.initial_current"]
    call, short = (scene, objective, 0.02), {"design": design}
    # The circuit is linear: a difference of its closed form is exact.
    expected = motor_by_hand(0.02, i=1.5)[0] - motor_by_hand(0.02, i=0.5)[0]
    found = gradient(*call, DOP853(1e-11), **short).gradient[0]
    assert found == pytest.approx(expected, rel=1e-8)
    method = Radau(2.0**-11)
    for way in (DirectDifferentiation(), Adjoint(), ComplexStep()):
        found = gradient(*call, method, method=way, **short).gradient[0]
        assert found == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("d", [2, 3])
def test_a_displacement_counts_from_the_reference_on_a_line_that_turns(d):
    rng, e = np.random.default_rng(4), np.array([0.3, -0.8, 0.4])[:d]
    points = MaterialPoint("slider"), MaterialPoint("rail")
    axis = TranslationAxis(points[0], e, points[1])
    # Position of the slider, position and section of the rail.
    U_o = np.concatenate([rng.uniform(-1, 1, (2, d)), np.eye(d)[1:]])
    assert len(U_o) == axis.count(d)
    assert axis.coordinate(U_o, U_o)[0] == pytest.approx(0.0, abs=1e-15)
    spin = rng.uniform(-1, 1, (d, d))
    turned = expm(spin - spin.T)
    moved = U_o @ turned.T
    moved[:2] += rng.uniform(-1, 1, d)
    shift = moved.copy()
    unit = e / np.linalg.norm(e)
    shift[0] += 0.7 * turned @ unit
    assert axis.coordinate(moved, U_o)[0] == pytest.approx(0.0, abs=1e-14)
    assert axis.coordinate(shift, U_o)[0] == pytest.approx(0.7, rel=1e-14)
    # The gradient differentiates the value, also where the section of the rail is no longer square.
    U = shift + 0.1 * rng.uniform(-1, 1, shift.shape)
    gradient_ = axis.coordinate(U, U_o)[1]
    for k in np.ndindex(U.shape):
        step = np.zeros(U.shape, complex)
        step[k] = 1e-30j
        slope = np.imag(axis.coordinate(U + step, U_o)[0]).item() / 1e-30
        assert gradient_[k] == pytest.approx(slope, abs=1e-14)


def test_a_saved_run_knows_its_states(tmp_path):
    run = simulate(motor_scene(), SPAN, HHT(SPAN / 64))
    again = load_solution(run.save(tmp_path / "run.npz"))
    system = assemble(motor_scene())
    known = values(state("motor", "current"), again, system)
    assert np.array_equal(known, current(run, motor_scene()))
    assert again.naming.coordinate_names()[-2:] == [
        "motor.current integral.x",
        "motor.current integral.y",
    ]
    with pytest.raises(UnknownNameError, match="current"):
        values(state("motor", "voltage"), again, system)
    with pytest.raises(UnknownNameError, match="motor"):
        values(state("moto", "current"), again, system)


# ---------------------------------------------------------------- what is refused, in words


def test_what_states_cannot_do_is_refused_in_words():
    scene, arm = arm_scene(), arm_scene().bodies[0]
    with pytest.raises(InvalidInputError, match="no controllers with states"):
        critical_load(scene, "pid.proportional", 30.0)
    with pytest.raises(InvalidInputError, match=r"Scene.frame.*pid"):
        replace(scene, gravity=None, frame=RotatingFrame(2.0))
    with pytest.raises(InvalidInputError, match="effort of 'pid': must lie in 0 to 0"):
        values(effort("pid", 1), simulate(scene, 0.1, HHT(0.05)), assemble(scene))
    with pytest.raises(InvalidInputError, match="law: must be left out"):
        PID(arm.origin, REFERENCE, 1.0, law=REFERENCE)
    with pytest.raises(InvalidInputError, match="reference"):
        PID(arm.origin, 1.0, 1.0)
    with pytest.raises(InvalidInputError, match="inductance"):
        DCMotor(arm.origin, Constant(U), R, 0.0, K)
    with pytest.raises(InvalidInputError, match="torque_constant: must not be zero"):
        DCMotor(arm.origin, Constant(U), R, L, 0.0)
    with pytest.raises(InvalidInputError, match="axis: must be left out where a direction"):
        FirstOrderLag(arm.origin, Constant(1.0), 0.1, direction=(1, 0, 0), axis=(0, 0, 1))


def test_equations_that_do_not_fit_are_refused():
    body = RigidBody("body", (0.0, 0.0), mass=2.0, inertia=1.0)

    def made(**methods):
        kind = type("Broken", (Follower,), methods)
        laws = Constant(0.1), Constant(0.2)
        return assemble(Scene(bodies=[body], loads=[kind(body.origin, *laws, 1.0)]))

    with pytest.raises(InvalidInputError, match="must return 3 rates of states; got 1"):
        made(equations=lambda self, at, p: ([0.0], [0.0, 0.0]))
    with pytest.raises(InvalidInputError, match="must return 2 efforts; got 0"):
        made(equations=lambda self, at, p: ([0.0] * 3, []))
    with pytest.raises(InvalidInputError, match="must have different names"):
        made(states=("x", "x", "y"))
    with pytest.raises(InvalidInputError, match=r"numpy\.abs"):
        made(equations=lambda self, at, p: ([np.abs(at.states[0])] * 3, [0.0] * 2))
    with pytest.raises(InvalidInputError, match="must return 3 initial states; got 1"):
        made(start=lambda self, p: [0.0])
    with pytest.raises(InvalidInputError, match="must return axes"):
        made(axes=lambda self, p: (RotationAxis,))


def test_a_mode_has_the_same_controllers_in_the_same_order():
    def scene(u, *names):
        made = motor_scene(u)
        pid = PID(made.bodies[0].origin, Constant(0.3), 0.0, name="pid")
        loads = {"motor": made.loads[0], "pid": pid}
        return replace(made, loads=[loads[name] for name in names])

    def switched(mode):
        off = Switch(elapsed_time() - 0.1, to="off")
        first = scene(U, "motor", "pid")
        return simulate(first, SPAN, Radau(0.005), events=[off], modes={"off": Mode(mode)})

    solution = switched(scene(0.0, "motor", "pid"))
    half = motor_by_hand(0.1)
    A = np.array([[-R / L, -K / L], [K / J, 0]])
    exact = expm(A * (SPAN - 0.1)) @ half
    last = solution.phases[-1]
    found = current(last, scene(0.0, "motor", "pid"))[-1]
    assert found == pytest.approx(exact[0], rel=1e-6)
    with pytest.raises(InvalidInputError, match=r"'pid.integral.* in place of 'motor.current"):
        switched(scene(0.0, "pid", "motor"))


def test_a_mode_cannot_change_a_design_variable():
    off = Switch(elapsed_time() - 0.1, to="off")
    objective, modes_ = Terminal(state("motor", "current")), {"off": Mode(motor_scene(0.0))}
    with pytest.raises(InvalidInputError, match=r"got 0 in place of 12 for design.*'motor.value'"):
        gradient(
            motor_scene(),
            objective,
            0.2,
            HHT(0.01),
            design=["motor.value"],
            events=[off],
            modes=modes_,
        )


@dataclass(frozen=True)
class Named(Controller):
    """x' = (U1 - x) / Tau, with names of design fields in capitals and digits."""

    point: MaterialPoint
    U1: float = 2.0
    Tau: float = 0.1

    kind = "named"
    states = ("x",)
    design_fields = (*design_numbers("U1", "Tau"), LAW_FIELD)

    def axes(self, p):
        return (RotationAxis(self.point),)

    def equations(self, at, p):
        U1, Tau, _ = self.split(p)
        return [(U1 - at.states[0]) / Tau], [0.0 * at.rates[0]]


def test_design_fields_may_have_capitals_and_digits():
    body = RigidBody("body", (0.0, 0.0), mass=2.0, inertia=1.0)
    scene = Scene(bodies=[body], loads=[Named(body.origin, name="c")])
    found = gradient(scene, Terminal(state("c", "x")), 0.1, Radau(0.01), design=["c.U1", "c.Tau"])
    assert found.value == pytest.approx(2 * (1 - np.exp(-1)), rel=1e-8)
    assert found.gradient == pytest.approx([1 - np.exp(-1), -20 * np.exp(-1)], rel=1e-7)


def test_axes_name_points_that_are_fields():
    body = RigidBody("body", (0.0, 0.0), mass=2.0, inertia=1.0)
    kind = type("Elsewhere", (Named,), {"axes": lambda self, p: (RotationAxis(body.at(1, 0)),)})
    with pytest.raises(InvalidInputError, match=r"vectors of load 'c': must be vectors of points"):
        assemble(Scene(bodies=[body], loads=[kind(body.origin, name="c")]))


@pytest.mark.parametrize("method", [HHT(0.01), Radau(0.02), DOP853(1e-6), IDA(1e-6)], ids=repr)
def test_a_reference_beyond_half_a_turn_is_warned_of(method):
    body = RigidBody("body", (0.0, 0.0), mass=2.0, inertia=1.0)

    def run(angle):
        ramp = ConstantAcceleration(angle / 0.5)
        pid = PID(body.origin, ramp, 30.0, 0.0, 10.0, name="pid")
        return simulate(Scene(bodies=[body], joints=[Pin(body.origin)], loads=[pid]), 0.5, method)

    with pytest.warns(UnlikelyValueWarning, match="reference of pid 'pid' is beyond half a turn"):
        run(3.2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert run(3.1).outcome.success
