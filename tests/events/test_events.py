"""Runs with events: impacts, switches and ends, with exact derivatives across them."""

import functools

import numpy as np
import pytest
import scipy

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Adjoint,
    AtTimes,
    ComplexStep,
    ContinuousAdjoint,
    DirectDifferentiation,
    EndEvent,
    FiniteDifference,
    Impact,
    InitialVelocity,
    Integral,
    Mode,
    PrescribedSteps,
    Radau,
    RigidBody,
    Scene,
    SmoothMaximum,
    Switch,
    Terminal,
    assemble,
    check_system,
    differentiate,
    gradient,
    gradients,
    simulate,
)
from ancfdae.errors import InvalidInputError, UnknownNameError, UnlikelyValueWarning
from ancfdae.events.phase_system import PhaseStart, PhaseSystem
from ancfdae.extend import FormulaSystem
from ancfdae.observables import (
    angular_momentum,
    custom,
    elapsed_time,
    kinetic_energy,
    multiplier,
    position,
    slope_angle,
    velocity,
)
from tests.support.balls import (
    BOUNCE,
    HEIGHT,
    RESTITUTION,
    Ball,
    ball_by_hand,
    of_design,
    slopes_by_hand,
)
from tests.support.mechanisms import GuidedDoublePendulum
from tests.support.rods_on_stops import falling_rod
from tests.support.scenes import planar_machine

EXACT = (DirectDifferentiation(), Adjoint(), ComplexStep())


@pytest.mark.parametrize(
    ("t_end", "value", "slopes"),
    [
        (1.9, 3.139918957, (0.837828113, 0.101531721, -0.103906844, 9.099954976)),
        (
            3.2,
            2.043656070001,
            (0.311880018998, -0.033280796140, 0.048092789540, 9.155137855557),
        ),
    ],
)
@pytest.mark.parametrize("integrator", [HHT(step=0.05), Radau(step=0.2), DOP853(1e-10), IDA(1e-9)])
def test_bouncing_ball_has_its_closed_form(integrator, t_end, value, slopes):
    methods = EXACT if isinstance(integrator, HHT | Radau) else (DirectDifferentiation(),)
    for method in methods:
        found = gradient(
            Ball(), Terminal(HEIGHT), t_end, integrator, method=method, events=[BOUNCE]
        )
        assert found.value == pytest.approx(value, abs=1e-9)
        np.testing.assert_allclose(found.gradient, slopes, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.gradient, slopes_by_hand(t_end, Ball().b), atol=1e-10)


def test_event_times_and_impulses_have_derivatives():
    solution = differentiate(Ball(), 3.2, HHT(step=0.1), events=[BOUNCE])
    z0, v0, g, e = Ball().b
    speed = np.sqrt(v0**2 + 2 * g * z0)
    first, second = solution.events
    assert first.time == pytest.approx((v0 + speed) / g, rel=1e-14)
    assert second.impulse == pytest.approx((1 + e) * e * speed, rel=1e-13)
    speed_b = np.array([g, v0, z0, 0.0]) / speed
    time_b = (speed_b + np.eye(4)[1]) / g - [0, 0, first.time / g, 0]
    np.testing.assert_allclose(first.time_b, time_b, atol=1e-13)
    unit = np.array([0.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(first.impulse_b, (1 + e) * speed_b + speed * unit, atol=1e-12)
    impulse_b = (1 + e) * e * speed_b + (1 + 2 * e) * speed * unit
    np.testing.assert_allclose(second.impulse_b, impulse_b, atol=1e-12)


def test_states_and_their_derivatives_stand_at_both_sides_of_an_event():
    solution = differentiate(Ball(), 3.2, HHT(step=0.1), events=[BOUNCE])
    assert np.all(np.diff(solution.t) >= 0)
    assert np.sum(np.diff(solution.t) == 0) == 2
    times = np.linspace(0.0, 3.2, 33)
    q, _ = solution.at(times)
    expected = [ball_by_hand(t, Ball().b) for t in times]
    np.testing.assert_allclose(q[:, 0], expected, atol=1e-12)
    for phase in solution.phases:
        inner = phase.t[1:-1]
        slopes = np.array([slopes_by_hand(t, Ball().b) for t in inner])
        np.testing.assert_allclose(phase.sensitivities.q_b[1:-1, 0], slopes, atol=1e-11)


def test_objectives_over_several_phases_are_differentiated_exactly():
    height_squared = HEIGHT**2 * (1 + elapsed_time())
    objectives = [
        Integral(height_squared),
        AtTimes(HEIGHT, [0.4, 1.234, 3.0]),
        SmoothMaximum(-HEIGHT, 3.0) * Terminal(elapsed_time() * HEIGHT),
    ]
    for integrator in (HHT(step=0.034), HHT(rtol=1e-5), Radau(step=0.23)):
        by_method = [
            gradients(Ball(), objectives, 3.2, integrator, method=m, events=[BOUNCE])
            for m in (*EXACT, FiniteDifference(1e-4, central=True))
        ]
        for direct, *others, differences in zip(*by_method, strict=True):
            for other in others:
                assert other.value == pytest.approx(direct.value, rel=1e-13)
                np.testing.assert_allclose(other.gradient, direct.gradient, rtol=1e-10, atol=1e-12)
            if integrator != HHT(rtol=1e-5):  # The steps of its runs differ.
                np.testing.assert_allclose(
                    differences.gradient, direct.gradient, rtol=1e-5, atol=1e-6
                )


def test_end_event_ends_the_run_and_its_time_has_a_derivative():
    up = EndEvent(HEIGHT - 1.0, direction=1, name="up")
    for method in EXACT:
        found = gradient(
            Ball(), Terminal(elapsed_time()), 9.0, HHT(step=0.1), method=method,
            events=[BOUNCE, up],
        )  # fmt: skip

        def reached(b):
            z0, v0, g, e = b
            speed = np.sqrt(v0 * v0 + 2 * g * z0)
            rise = e * speed
            return (v0 + speed) / g + (rise - np.sqrt(rise * rise - 2 * g)) / g

        assert found.value == pytest.approx(reached(Ball().b), rel=1e-13)
        steps = 1e-30j * np.eye(4)
        slopes = [np.imag(reached(Ball().b + x)) / 1e-30 for x in steps]
        np.testing.assert_allclose(found.gradient, slopes, atol=1e-12)
    assert [x.name for x in found.event_solution.events] == ["impact", "up"]


# -- a double pendulum in absolute coordinates, against minimal ones -------------------------------


class DoublePendulum(FormulaSystem):
    """Two point masses on massless rods, in positions; the elbow may be locked."""

    n_q, n_lam = 4, 2
    design_names = ("m2", "L1", "wall", "restitution")

    def __init__(self, spin=2.0, b=(1.5, 1.0, 0.35, 0.6)):
        self.spin = spin
        super().__init__(b)

    def with_values(self, b):
        return type(self)(self.spin, b)

    def start(self):
        L1 = self.b[1]
        first, second = np.array([0.0, -1.0]), np.array([np.sin(-0.7), -np.cos(-0.7)])
        p = L1 * first
        v = L1 * self.spin * np.array([1.0, 0.0])
        return np.concatenate([p, p + 0.8 * second]), np.concatenate([v, v])

    def mass_matrix(self, q):
        return np.diag([1.0, 1.0, self.b[0], self.b[0]])

    def force(self, t, q, v):
        return np.array([0.0, -9.81, 0.0, -9.81 * self.b[0]])

    def position_constraint(self, t, q):
        return np.array([(q[:2] @ q[:2] - self.b[1] ** 2) / 2, self.second_rod(q)])

    def second_rod(self, q):
        d = q[2:] - q[:2]
        return (d @ d - 0.64) / 2


class LockedPendulum(DoublePendulum):
    """The same with its elbow locked at a right angle."""

    n_lam = 3

    def position_constraint(self, t, q):
        d = q[2:] - q[:2]
        return np.array([(q[:2] @ q[:2] - self.b[1] ** 2) / 2, self.second_rod(q), q[:2] @ d])


def wall(t, q, v, lam, b):
    return b[2] - q[:, 2]


def elbow(t, q, v, lam, b):
    return q[:, 0] * (q[:, 2] - q[:, 0]) + q[:, 1] * (q[:, 3] - q[:, 1])


def tip(t, q, v, lam, b):
    return q[:, 3] + 2.0 * q[:, 0] * v[:, 3]


WALL = Impact(custom(wall, "wall"), custom(of_design, "restitution"))
LOCK = Switch(custom(elbow, "elbow"), "locked", -1, "lock")
TIP = custom(tip, "tip")


def kinematics(theta, L1):
    """Jacobian of the positions of both masses in the angles, and the positions."""
    (s1, s2), (c1, c2) = np.sin(theta), np.cos(theta)
    J = np.array([[L1 * c1, 0], [L1 * s1, 0], [L1 * c1, 0.8 * c2], [L1 * s1, 0.8 * s2]])
    return J, np.array([L1 * s1, -L1 * c1, L1 * s1 + 0.8 * s2, -L1 * c1 - 0.8 * c2])


def pendulum_by_scipy(b, t_end, lock=False):
    """`tip` at t_end in minimal coordinates, with SciPy's own event location."""
    m2, L1, x_wall, e = b

    def mass(theta):
        J, _ = kinematics(theta, L1)
        return J.T @ np.diag([1, 1, m2, m2]) @ J

    def rates(t, y):
        theta, omega = y[:2], y[2:]
        J, _ = kinematics(theta, L1)
        (s1, s2), (c1, c2) = np.sin(theta), np.cos(theta)
        w1, w2 = omega**2
        turning = np.array([-L1 * s1 * w1, L1 * c1 * w1])
        second = turning + 0.8 * np.array([-s2 * w2, c2 * w2])
        bias = np.concatenate([turning, second])
        M = np.diag([1, 1, m2, m2])
        force = J.T @ (np.array([0, -9.81, 0, -9.81 * m2]) - M @ bias)
        return np.concatenate([omega, np.linalg.solve(mass(theta), force)])

    def locked(t, y):
        # Both rods turn as one body.
        M, weight = np.array([1, 1, m2, m2]), np.array([0, -9.81, 0, -9.81 * m2])
        J = kinematics(y[:2], L1)[0].sum(axis=1)
        acceleration = J @ weight / (J @ (M * J))
        return np.array([y[2], y[2], acceleration, acceleration])

    def hit(t, y):
        return x_wall - kinematics(y[:2], L1)[1][2]

    def right_angle(t, y):
        return np.cos(y[1] - y[0])

    event = right_angle if lock else hit
    event.terminal, event.direction = True, -1
    settings = {"rtol": 1e-12, "atol": 1e-13, "method": "DOP853"}
    t, y, f = 0.0, np.array([0.0, -0.7, 5.0 if lock else 2.0, 0.0]), rates
    while True:
        events = event if f is rates else None
        run = scipy.integrate.solve_ivp(f, (t, t_end), y, events=events, **settings)
        t, y = run.t[-1], run.y[:, -1]
        if run.status == 0:
            break
        theta, omega = y[:2], y[2:]
        if lock:
            one = np.ones(2)
            common = one @ mass(theta) @ omega / (one @ mass(theta) @ one)
            y, f = np.concatenate([theta, common * one]), locked
            continue
        G = -kinematics(theta, L1)[0][2]
        inverse = np.linalg.solve(mass(theta), G)
        P = -(1 + e) * (G @ omega) / (G @ inverse)
        y = np.concatenate([theta, omega + inverse * P])
    J, p = kinematics(y[:2], L1)
    return p[3] + 2.0 * p[0] * (J @ y[2:])[3]


@functools.cache
def slopes_by_scipy(b, t_end, lock=False):
    """Derivatives of the tip by differences; of a lock those in mass and length, which act."""
    b, slopes = np.array(b), []
    for i in range(2 if lock else len(b)):

        def value(x, i=i):
            return pendulum_by_scipy(b + x * np.eye(len(b))[i], t_end, lock)

        h = 1e-3
        near = (value(h) - value(-h)) / (2 * h)
        far = (value(2 * h) - value(-2 * h)) / (4 * h)
        slopes.append((4 * near - far) / 3)
    return np.array(slopes)


@pytest.mark.parametrize("integrator", [DOP853(1e-11), Radau(rtol=1e-9)])
def test_pendulum_on_a_wall_follows_an_integration_in_minimal_coordinates(integrator):
    system = DoublePendulum()
    found = gradient(
        system, Terminal(TIP), 2.2, integrator, method=DirectDifferentiation(), events=[WALL]
    )
    assert len(found.event_solution.events) == 2
    assert found.value == pytest.approx(pendulum_by_scipy(system.b, 2.2), abs=1e-7)
    expected = slopes_by_scipy(tuple(system.b), 2.2)
    np.testing.assert_allclose(found.gradient, expected, rtol=1e-7, atol=1e-7)


def test_impact_after_long_steps_is_differentiated_exactly():
    """HHT-I3 satisfies the constraints of velocities to O(h^2): the impact projects them."""
    first, *others = (
        gradient(DoublePendulum(), Terminal(TIP), 0.8, HHT(step=0.04), method=method, events=[WALL])
        for method in EXACT
    )
    assert len(first.event_solution.events) == 1
    for other in others:
        np.testing.assert_allclose(other.gradient, first.gradient, rtol=1e-11)


def test_pendulum_that_locks_its_elbow_takes_the_impulse_of_the_lock():
    system, modes = DoublePendulum(spin=5.0), {"locked": Mode(LockedPendulum())}
    call = {"events": [LOCK], "modes": modes}
    direct = DirectDifferentiation()
    found = gradient(system, Terminal(TIP), 1.0, DOP853(1e-11), method=direct, **call)
    assert found.value == pytest.approx(pendulum_by_scipy(system.b, 1.0, lock=True), abs=1e-7)
    expected = slopes_by_scipy(tuple(system.b), 1.0, lock=True)
    np.testing.assert_allclose(found.gradient[:2], expected, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.gradient[2:], 0, atol=1e-12)
    (lock,) = found.event_solution.events
    assert (lock.name, lock.mode) == ("lock", "locked")
    first, *others = (
        gradient(system, Terminal(TIP), 1.0, HHT(step=5e-3), method=method, **call)
        for method in EXACT
    )
    assert first.value == pytest.approx(found.value, abs=4e-3)
    for other in others:
        np.testing.assert_allclose(other.gradient, first.gradient, rtol=1e-10, atol=1e-10)


# -- scenes: a flexible rod on a stop --------------------------------------------------------------


ROD_DESIGN = ["rod.youngs_modulus", "rod.height", "rod.density"]


def test_flexible_rod_keeps_momentum_and_energy_at_a_stop():
    rod, scene, _ = falling_rod(tip=1.0)
    stop = Impact(position(rod.at_end, 1) + 0.3, 0.5, "stop")
    solution = simulate(scene, 0.25, HHT(step=1e-3), events=[stop])
    assert solution.outcome.success
    (record,) = solution.events
    before, after = solution.phases
    system = assemble(scene)

    def at(observable, phase, k):
        states = (phase.t[[k]], phase.q[[k]], phase.v[[k]], phase.lam[[k]])
        from ancfdae.sensitivity.observables.observable import States

        return float(observable.value(system, States(*states))[0])

    gap, speed = position(rod.at_end, 1) + 0.3, velocity(rod.at_end, 1)
    assert abs(at(gap, before, -1)) < 1e-15
    u, w = at(speed, before, -1), at(speed, after, 0)
    assert w == pytest.approx(-0.5 * u, rel=1e-9)
    spin = angular_momentum(2)
    gained = at(spin, after, 0) - at(spin, before, -1)
    arm = at(position(rod.at_end, 0), before, -1)
    assert gained == pytest.approx(record.impulse * arm, rel=1e-6)
    energy = kinetic_energy()
    lost = at(energy, after, 0) - at(energy, before, -1)
    assert lost == pytest.approx(record.impulse * (u + w) / 2, rel=1e-6)


def test_rod_is_of_second_order_across_an_impact():
    rod, scene, _ = falling_rod(tip=1.0)
    stop = Impact(position(rod.at_end, 1) + 0.3, 0.5, "stop")
    objectives = [Terminal(position(rod.at_end, 1)), Terminal(velocity(rod.at_end, 0))]
    values, slopes = [], []
    for step in (4e-4, 2e-4, 1e-4, 5e-5):
        found = gradients(scene, objectives, 0.28, HHT(step=step), design=ROD_DESIGN, events=[stop])
        values.append([x.value for x in found])
        slopes.append([x.gradient * [2e8, 0.03, 1000.0] for x in found])
    for x in (np.array(values), np.array(slopes)):
        changes = [np.max(np.abs(x[k + 1] - x[k]), axis=-1) for k in range(3)]
        assert np.all(changes[0] / changes[1] > 3.0)
        assert np.all(changes[1] / changes[2] > 3.4)


def test_rod_rests_on_a_stop_and_leaves_it():
    rod, scene, held = falling_rod()
    stop = Impact(position(rod.at_end, 1) + 0.3, 0.5, "stop", rest="closed")
    off = Switch(-multiplier("stop", 0), "start", -1, "off")
    modes = {"closed": Mode(held, [off])}
    objectives = [
        Terminal(position(rod.at_end, 1)),
        Integral(position(rod.at(0.5), 0) ** 2 * elapsed_time()),
        AtTimes(velocity(rod.at_end, 1), [0.1, 0.25, 0.3331]),
    ]
    by_method = [
        gradients(
            scene, objectives, 0.35, HHT(step=4e-3), design=ROD_DESIGN[::2], method=method,
            events=[stop], modes=modes,
        )
        for method in (*EXACT, FiniteDifference(1e-6, central=True))
    ]  # fmt: skip
    scale = np.array([2e8, 1000.0])
    for direct, adjoint, stepped, differences in zip(*by_method, strict=True):
        for other in (adjoint, stepped):
            size = np.max(np.abs(direct.gradient * scale))
            np.testing.assert_allclose(
                other.gradient * scale, direct.gradient * scale, rtol=1e-9, atol=1e-10 * size
            )
        np.testing.assert_allclose(
            differences.gradient * scale, direct.gradient * scale, rtol=1e-4, atol=1e-5
        )
    records = direct.event_solution.events
    assert [x.name for x in records if x.name != "stop"] == ["off"]
    assert records[-2].mode == "closed"
    assert records[-1].mode == "start"
    # Without loads but gravity, stiffness and density alike leave the motion as it is.
    d_E, d_rho = direct.gradient * scale
    assert d_E == pytest.approx(-d_rho, rel=1e-6)


# -- what broke others -----------------------------------------------------------------------------


def test_saved_times_within_one_ulp_of_an_event():
    first = simulate(Ball(), 1.9, HHT(step=0.1), events=[BOUNCE]).events[0].time
    slope = slopes_by_hand(first * (1 - 1e-12), Ball().b)
    for time in (np.nextafter(first, 0), first, np.nextafter(first, 9)):
        for method in EXACT:
            at = AtTimes(HEIGHT, [time])
            with pytest.warns(UnlikelyValueWarning, match="an event happens at the time"):
                found = gradient(Ball(), at, 1.9, HHT(step=0.1), method=method, events=[BOUNCE])
            assert found.value == pytest.approx(0.0, abs=1e-14)
            if time <= first:
                np.testing.assert_allclose(found.gradient, slope, atol=1e-9)
        ended = simulate(Ball(), time, HHT(step=0.1), events=[BOUNCE])
        assert ended.outcome.success
        assert ended.t[-1] == pytest.approx(time, rel=1e-15)


class TwoBalls(FormulaSystem):
    """A block in a corner: it falls towards a floor and a wall at once."""

    n_q, n_lam = 2, 0
    design_names = ("x", "z")

    def __init__(self, b=(1.0, 1.0)):
        super().__init__(b)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        return self.b * 1, np.array([-1.0, -1.0])

    def mass_matrix(self, q):
        # The corner couples both directions.
        return np.array([[2.0, 0.5], [0.5, 1.0]])

    def force(self, t, q, v):
        return np.zeros(2) * q

    def position_constraint(self, t, q):
        return np.zeros(0)


def test_two_gaps_that_close_at_one_instant_share_their_equations():
    gaps = [custom(lambda t, q, v, lam, b, k=k: q[:, k], f"gap {k}") for k in (0, 1)]
    events = [Impact(gap, 0.5, f"{k}") for k, gap in enumerate(gaps)]
    solution = simulate(TwoBalls(), 2.0, HHT(step=0.1), events=events)
    assert [x.time for x in solution.events] == pytest.approx([1.0, 1.0], abs=1e-14)
    np.testing.assert_allclose(solution.v[-1], [0.5, 0.5], atol=1e-13)
    M = TwoBalls().mass_matrix(None)
    impulses = [x.impulse for x in solution.events]
    np.testing.assert_allclose(impulses, M @ [1.5, 1.5], atol=1e-12)


def test_impact_and_end_at_one_instant():
    solution = simulate(
        Ball(), 3.0, HHT(step=0.1), events=[BOUNCE, EndEvent(2 * HEIGHT, -1, "down")]
    )
    assert {x.name for x in solution.events} == {"impact", "down"}
    assert len(solution.phases) == 1


def test_event_at_the_start():
    class Low(Ball):
        def start(self):
            return 0 * self.b[:1], self.b[1:2] * 1

    b = (5.0, -2.0, 10.0, 0.8)
    for method in EXACT:
        found = gradient(
            Low(b), Terminal(HEIGHT), 0.3, HHT(step=0.1), method=method, events=[BOUNCE]
        )
        assert found.value == pytest.approx(1.6 * 0.3 - 5 * 0.09, abs=1e-13)
        np.testing.assert_allclose(found.gradient, [0, -0.24, -0.045, 0.6], atol=1e-13)
    assert found.event_solution.events[0].time == 0.0
    rising = EndEvent(HEIGHT, 1, "up")
    leaving = simulate(Low((5.0, 2.0, 10.0, 0.8)), 0.3, HHT(step=0.1), events=[BOUNCE, rising])
    assert leaving.events == ()


def test_events_that_do_not_happen_leave_the_run_as_it_is():
    plain = simulate(Ball(), 0.9, HHT(step=0.1))
    for never in (EndEvent(HEIGHT**2 + 1.0), EndEvent(0 * HEIGHT), EndEvent(HEIGHT, 1)):
        solution = simulate(Ball(), 0.9, HHT(step=0.1), events=[BOUNCE, never])
        assert solution.events == ()
        np.testing.assert_array_equal(solution.q, plain.q)


def test_zero_between_two_instants_that_values_at_the_instants_do_not_show():
    dip = EndEvent(HEIGHT - 4.9 + elapsed_time() * 0, -1, "dip")
    thrown = Ball((4.8999, 1.0, 10.0, 0.8))
    # It is above 4.9 for 0.2 s; steps of 0.5 s see neither crossing in their signs.
    solution = simulate(thrown, 0.5, HHT(step=0.5), events=[dip])
    root = (1 + np.sqrt(1 - 2 * 10 * 1e-4)) / 10
    assert solution.t[-1] == pytest.approx(root, rel=1e-12)


def test_a_thousand_impacts():
    solution = simulate(Ball((1.0, 0.0, 10.0, 1.0)), 450.0, HHT(step=1.0), events=[BOUNCE])
    assert solution.outcome.success
    assert len(solution.events) == 503
    period = 2 * np.sqrt(0.2)
    times = [x.time for x in solution.events]
    np.testing.assert_allclose(times, period * (np.arange(503) + 0.5), rtol=1e-12)


def test_infinitely_many_impacts_end_in_words_or_in_rest():
    ball = Ball((5.0, -0.1, 10.0, 0.5))
    solution = simulate(ball, 9.0, HHT(step=0.1), events=[BOUNCE])
    assert not solution.outcome.success
    assert "follow each other" in str(solution.outcome)
    speed = np.sqrt(0.01 + 100)
    rest = (-0.1 + speed) / 10 + 2 * speed / 10 * (0.5 / 0.5)
    assert solution.t[-1] == pytest.approx(rest, abs=1e-6)

    class Lying(Ball):
        n_lam = 1

        def position_constraint(self, t, q):
            return q

    modes = {"lying": Mode(Lying((5.0, -0.1, 10.0, 0.5)))}
    stop = Impact(HEIGHT, RESTITUTION, rest="lying")
    for method in EXACT:
        found = gradient(
            ball, AtTimes(HEIGHT, [2.5, 9.0]), 9.0, HHT(step=0.1), method=method, events=[stop],
            modes=modes,
        )  # fmt: skip
        assert found.value == pytest.approx(ball_by_hand(2.5, ball.b), abs=1e-11)
        np.testing.assert_allclose(found.gradient, slopes_by_hand(2.5, ball.b), atol=1e-9)
    assert found.event_solution.outcome.success


def test_plastic_impact_comes_to_rest_at_once():
    solution = simulate(Ball((5.0, -0.1, 10.0, 0.0)), 3.0, HHT(step=0.1), events=[BOUNCE])
    assert "follow each other" in str(solution.outcome)
    assert len(solution.phases) == 1


def test_grazing_has_no_derivative_and_says_so():
    top = 5.0 + 0.005
    thrown = Ball((5.0, 1.0, 10.0, 0.8))
    graze = EndEvent(HEIGHT - 5.05, 0, "top")
    solution = simulate(thrown, 0.3, HHT(step=0.05), events=[graze])
    assert solution.outcome.success or "touches zero" in str(solution.outcome)
    assert top < 5.05
    near = EndEvent(HEIGHT - 5.05 + 1e-16, 0, "top")
    with pytest.raises(Exception, match=r"touches|no gradient"):
        gradient(thrown, Terminal(HEIGHT), 0.3, HHT(step=0.05), events=[near])


# -- the machinery ---------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["formulas", "scene"])
def test_phase_is_a_mechanical_system(kind):
    rng = np.random.default_rng(0)
    if kind == "scene":
        base, t_0, D = assemble(planar_machine(), ["crank.height"]), 0.01, 0.02
    else:
        base, t_0, D = GuidedDoublePendulum(spin=0.5), 0.3, 0.7
    reached = simulate(base, t_0, HHT(step=t_0 / 20))
    n = base.n_b
    t_b, (q_b, v_b) = 0.1 * rng.normal(size=n), 0.1 * rng.normal(size=(2, base.n_q, n))
    start = PhaseStart(t_0, reached.q[-1], reached.v[-1], t_b, q_b, v_b)
    check_system(PhaseSystem(base, start, D, first=False)).raise_if_wrong()


def moving_circle(t, q, v, lam, b):
    """Distance of the tip from a disc that moves and whose radius is a design variable."""
    x = q[:, 2] - 0.9 + 0.1 * np.sin(3 * t)
    return np.sqrt(x**2 + (q[:, 3] + 1.6) ** 2) - b[2] - 0.15


def worn(t, q, v, lam, b):
    """A restitution that falls with the speed of the impact."""
    return b[3] / (1 + 0.05 * (v[:, 2] ** 2 + v[:, 3] ** 2) + 0.01 * t)


def test_moving_round_wall_with_a_restitution_that_depends_on_speed():
    hit = Impact(custom(moving_circle, "disc"), custom(worn, "worn"))
    objectives = [Terminal(TIP), Integral(TIP**2)]
    by_method = [
        gradients(DoublePendulum(), objectives, 1.0, Radau(step=0.031), method=m, events=[hit])
        for m in (*EXACT, FiniteDifference(1e-5, central=True))
    ]
    for direct, adjoint, stepped, differences in zip(*by_method, strict=True):
        assert len(direct.event_solution.events) >= 1
        for other in (adjoint, stepped):
            np.testing.assert_allclose(other.gradient, direct.gradient, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(differences.gradient, direct.gradient, rtol=1e-6, atol=1e-6)


def test_driven_scene_whose_forces_depend_on_time_passes_an_event():
    """Laws of time count through the starts and durations of phases."""
    scene = planar_machine()
    solution = simulate(scene, 0.05, HHT(step=1e-3))
    middle = position(scene.beams[1].at(0.5), 1)
    from ancfdae.observables import observe

    values = observe(middle, solution)
    level = 0.5 * (values[10] + values[20])
    end = Switch(middle - float(level), to="same", name="pass")
    modes = {"same": Mode(scene)}
    by_method = [
        gradient(
            scene, Terminal(middle + elapsed_time() * velocity(scene.beams[1].at(0.5), 0)), 0.05,
            HHT(step=1e-3), design=["crank.height", "rod.density"], method=m,
            events=[end], modes=modes,
        )
        for m in (*EXACT, FiniteDifference(1e-5, central=True))
    ]  # fmt: skip
    direct, adjoint, stepped, differences = by_method
    assert len(direct.event_solution.events) == 1
    for other in (adjoint, stepped):
        np.testing.assert_allclose(other.gradient, direct.gradient, rtol=1e-9)
    np.testing.assert_allclose(differences.gradient, direct.gradient, rtol=1e-4)


def test_gaps_that_say_the_same_are_one_impact():
    twice = Impact(2 * HEIGHT, RESTITUTION, "twice")
    for method in EXACT:
        found = gradient(
            Ball(), Terminal(HEIGHT), 3.2, HHT(step=0.1), method=method, events=[BOUNCE, twice]
        )
        np.testing.assert_allclose(found.gradient, slopes_by_hand(3.2, Ball().b), atol=1e-10)
    clock = Impact(custom(lambda t, q, v, lam, b: 1.0 - t, "clock"), 0.5)
    with pytest.raises(InvalidInputError, match="joints leave free"):
        simulate(Ball(), 3.2, HHT(step=0.1), events=[clock])


def test_bad_events_are_refused_in_words():
    ball, step = Ball(), HHT(step=0.1)
    with pytest.raises(InvalidInputError, match="must be finite along the run"):
        simulate(ball, 3.0, step, events=[EndEvent(1.0 + np.sqrt(HEIGHT - 2.0))])
    with pytest.raises(InvalidInputError, match="must not be negative"):
        simulate(ball, 3.0, step, events=[Impact(HEIGHT - 6.0)])
    with pytest.raises(InvalidInputError, match="function of positions"):
        simulate(ball, 3.0, step, events=[Impact(custom(speeding, "speeding"))])
    with pytest.raises(InvalidInputError, match="different names"):
        simulate(ball, 3.0, step, events=[BOUNCE, BOUNCE])
    with pytest.raises(InvalidInputError, match="must not be negative"):
        Impact(HEIGHT, -0.1)
    with pytest.raises(UnknownNameError, match="mode"):
        simulate(ball, 3.0, step, events=[Switch(HEIGHT, "nowhere")])
    modes, locked = {"other": Mode(TwoBalls())}, {"locked": Mode(LockedPendulum())}
    with pytest.raises(InvalidInputError, match="coordinates and the design"):
        simulate(ball, 3.0, step, events=[Switch(HEIGHT, "other")], modes=modes)
    early = Switch(LOCK.function - 0.3, "locked")
    with pytest.raises(InvalidInputError, match="joints must be closed"):
        simulate(DoublePendulum(spin=5.0), 1.0, HHT(step=0.01), events=[early], modes=locked)
    with pytest.raises(InvalidInputError, match="choose steps itself"):
        simulate(ball, 3.0, HHT(PrescribedSteps((0.0, 3.0))), events=[BOUNCE])
    with pytest.raises(InvalidInputError, match="after: must be"):
        simulate(ball, 3.0, step, events=[BOUNCE], after=simulate(ball, 1.0, step))
    with pytest.raises(InvalidInputError, match="complex numbers"):
        gradient(ball, Terminal(HEIGHT), 3.0, DOP853(), method=ComplexStep(), events=[BOUNCE])
    still = Ball((5.0, 0.0, 10.0, 0.8))
    with pytest.raises(InvalidInputError, match="must not be zero"):
        gradient(still, Terminal(HEIGHT), 3.0, step, method=FiniteDifference(), events=[BOUNCE])
    with pytest.raises(InvalidInputError, match="HHT or Radau"):
        gradient(ball, Terminal(HEIGHT), 3.0, DOP853(), method=Adjoint(), events=[BOUNCE])
    with pytest.raises(InvalidInputError, match="differentiates runs with events"):
        gradient(ball, Terminal(HEIGHT), 3.0, step, method=ContinuousAdjoint(), events=[BOUNCE])


def speeding(t, q, v, lam, b):
    return 3.0 + v[:, 0]


def closing_angle(t, q, v, lam, b):
    return 0.1 + 0.05 * np.sin(7 * t) - q[:, 0] + 0.1 * q[:, 1] ** 2


def test_constraints_and_gaps_that_depend_on_time_pass_several_impacts():
    """Times of events enter the constraints at an impact and the gaps of later phases."""
    hit = Impact(custom(closing_angle, "closing"), 0.7)
    objectives = [Terminal(custom(lambda t, q, v, lam, b: q[:, 0] + v[:, 1], "seen"))]
    by_method = [
        gradients(
            GuidedDoublePendulum(spin=1.0), objectives, 1.5, HHT(step=0.02), method=m, events=[hit]
        )[0]
        for m in (*EXACT, FiniteDifference(1e-6, central=True))
    ]
    direct, *others, differences = by_method
    assert len(direct.event_solution.events) >= 2
    for other in others:
        np.testing.assert_allclose(other.gradient, direct.gradient, rtol=1e-9)
    np.testing.assert_allclose(differences.gradient, direct.gradient, rtol=1e-5)


class Row(FormulaSystem):
    """Three balls of diameter 1 on a line; the first one moves, the others touch."""

    n_q, n_lam = 3, 0
    design_names = ("speed", "restitution")

    def __init__(self, b=(1.0, 1.0)):
        super().__init__(b)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        return np.array([-0.5, 1.0, 2.0]), self.b[0] * np.array([1.0, 0.0, 0.0])

    def mass_matrix(self, q):
        return np.eye(3)

    def force(self, t, q, v):
        return np.zeros(3)

    def position_constraint(self, t, q):
        return np.zeros(0)


def test_impact_that_closes_a_touching_gap_is_followed_by_its_impact():
    def bounce(t, q, v, lam, b):
        return b[1] + 0 * t

    events = [
        Impact(
            custom(lambda t, q, v, lam, b, k=k: q[:, k + 1] - q[:, k] - 1, f"gap {k}"),
            custom(bounce, "bounce"),
            f"{k}",
        )
        for k in (0, 1)
    ]
    last = Terminal(custom(lambda t, q, v, lam, b: q[:, 2] + 0 * t, "last"))
    for integrator in (HHT(step=0.1), Radau(step=0.1)):
        for method in EXACT:
            found = gradient(Row(), last, 1.0, integrator, method=method, events=events)
            # The last ball moves with u (1 + e)^2 / 4 from t = 1 / (2 u) on.
            assert found.value == pytest.approx(2.5, abs=1e-13)
            np.testing.assert_allclose(found.gradient, [1.0, 0.5], atol=1e-12)
        solution = found.event_solution
        assert [x.name for x in solution.events] == ["0", "1"]
        np.testing.assert_allclose(solution.phases[1].v[0], [0, 0, 1], atol=1e-13)


def test_impact_at_the_given_end_is_after_the_end():
    ball = Ball((0.8, 0.0, 10.0, 0.5))
    speed = Terminal(custom(lambda t, q, v, lam, b: v[:, 0], "speed"))
    for integrator in (HHT(step=0.05), Radau(step=0.05)):
        for method in EXACT:
            height, rate = gradients(
                ball, [Terminal(HEIGHT), speed], 0.8, integrator, method=method, events=[BOUNCE]
            )
            assert (height.value, rate.value) == pytest.approx((0.0, -2.0), abs=1e-12)
            np.testing.assert_allclose(
                [height.gradient[0], rate.gradient[0]], [1, 3.75], atol=1e-10
            )


def test_starts_on_a_stop_are_refused_where_they_have_no_answer():
    lying, falling = Ball((0.0, 0.0, 10.0, 0.5)), Ball((0.0, -1.0, 10.0, 0.5))
    with pytest.raises(InvalidInputError, match="keeps the gap closed"):
        simulate(lying, 0.3, HHT(step=0.1), events=[BOUNCE])
    assert len(simulate(falling, 0.05, HHT(step=0.01), events=[BOUNCE]).events) == 1
    for method in EXACT:
        with pytest.raises(InvalidInputError, match="gap that stays zero when the design changes"):
            gradient(
                falling, Terminal(HEIGHT), 0.05, HHT(step=0.01), method=method, events=[BOUNCE]
            )
    rod, scene, _ = falling_rod()
    turned = EndEvent(slope_angle(rod.at_start) + 0.1)
    with pytest.raises(InvalidInputError, match="counts turns"):
        simulate(scene, 0.1, HHT(step=0.01), events=[turned])


class Bead(FormulaSystem):
    """A bead on a line that turns about the origin: the Jacobian of its constraint turns too."""

    n_q, n_lam = 2, 1
    design_names = ("r0", "gravity", "rate")

    def __init__(self, b=(1.0, 9.81, 2.0)):
        super().__init__(b)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        r0, _, rate = self.b
        return np.array([r0, 0 * r0]), np.array([0.5 + 0 * r0, rate * r0])

    def mass_matrix(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.array([0.0, -1.0]) * self.b[1]

    def position_constraint(self, t, q):
        angle = self.b[2] * t
        return np.array([q[1] * np.cos(angle) - q[0] * np.sin(angle)])


def test_impact_on_a_turning_line_is_differentiated_exactly():
    rim = Impact(custom(lambda t, q, v, lam, b: 1.3 - q[:, 0] ** 2 - q[:, 1] ** 2, "rim"), 0.6)
    x = Terminal(custom(lambda t, q, v, lam, b: q[:, 0] + 0 * t, "x"))
    direct, *others = (
        gradient(Bead(), x, 0.9, HHT(step=0.05), method=method, events=[rim]) for method in EXACT
    )
    assert len(direct.event_solution.events) >= 1
    for other in others:
        np.testing.assert_allclose(other.gradient, direct.gradient, rtol=1e-10)


HALF = position(RigidBody("ball", (0.1, 1.0), mass=2.0, inertia=0.3).at(0, 0), 1) - 0.5


def _falling_body():
    body = RigidBody("ball", (0.1, 1.0), mass=2.0, inertia=0.3)
    return Scene(bodies=[body], gravity=(0, -10.0))


@pytest.mark.parametrize("steepness", [1e2, 1e3, 3e3, 1e4, 1e6])
@pytest.mark.parametrize("integrator", [HHT(0.01), HHT(0.001), Radau(0.03), IDA(1e-8)])
def test_steep_function_that_saturates_ends_the_run_where_it_is_zero(integrator, steepness):
    # y = 1 - 5 t^2, so that tanh(k (y - 0.5)) = w at 5 t^2 = 0.5 - artanh(w) / k.
    for w in (0.0, 0.5):
        end = EndEvent(np.tanh(steepness * HALF) - w)
        solution = simulate(_falling_body(), 1.0, integrator, events=[end])
        exact = np.sqrt((0.5 - np.arctanh(w) / steepness) / 5)
        assert solution.outcome.success
        assert solution.events[0].time == pytest.approx(exact, abs=1e-6)
        assert abs(np.tanh(steepness * (solution.q[-1, 1] - 0.5)) - w) < 1e-6


@pytest.mark.parametrize("integrator", [DOP853(1e-8)])
def test_pole_is_no_zero_and_leads_no_farther_than_the_end(integrator):
    solution = simulate(_falling_body(), 0.4, integrator, events=[EndEvent(1 / HALF)])
    assert "has a pole" in str(solution.outcome)
    assert not solution.outcome.success
    assert np.all(solution.t <= 0.4)


@pytest.mark.parametrize("later", 10.0 ** np.arange(-14.0, -8.0))
@pytest.mark.parametrize("integrator", [HHT(0.01), Radau(0.05), DOP853(1e-8)])
def test_impact_that_follows_another_one_at_once_is_not_lost(integrator, later):
    bodies = [
        RigidBody(f"ball {n}", (3 * n, 1.0 + n * later), mass=1.0 + n, inertia=0.3) for n in (0, 1)
    ]
    gaps = [position(body.at(0, 0), 1) for body in bodies]
    events = [Impact(gap, 0.5, f"floor {n}") for n, gap in enumerate(gaps)]
    scene = Scene(bodies=bodies, gravity=(0, -10.0))
    solution = simulate(scene, 0.6, integrator, events=events)
    fall = np.sqrt(0.2)
    after = 0.6 - fall
    assert solution.outcome.success
    assert len(solution.events) == 2
    heights = solution.q[-1, [1, solution.q.shape[1] // 2 + 1]]
    np.testing.assert_allclose(heights, 5 * fall * after - 5 * after**2, atol=1e-7)


@pytest.mark.parametrize("distance", 10.0 ** np.arange(-14.0, -6.0, 0.5))
def test_gap_that_is_nearly_closed_at_the_start_closes(distance):
    start = Ball((distance, -1.0, 1e-3, 0.5))
    solution = simulate(start, 10.0, HHT(0.5), events=[Impact(HEIGHT, 0.5)])
    assert solution.outcome.success
    assert solution.q[-1, 0] == pytest.approx(0.5 * 10 - 5e-4 * 100, abs=1e-5)


@pytest.mark.parametrize("speed", [1.0, 0.7, 1.3])
@pytest.mark.parametrize("integrator", [HHT(0.01), Radau(0.05), DOP853(1e-8)])
def test_bodies_that_stay_in_touch_after_a_plastic_impact_do_not_pass_each_other(integrator, speed):
    # 1 kg hits 3 kg, both go on at a quarter of the speed; a wall throws the second one back, and
    # both return at an eighth.
    starts = (("a", -0.5, 1.0), ("b", 1.0, 3.0))
    bodies = [RigidBody(name, (x, 0.0), mass=m, inertia=0.01) for name, x, m in starts]
    first, second = (position(body.at(0, 0), 0) for body in bodies)
    start = [InitialVelocity("a", 0.0, about=(0, 0), velocity=(speed, 0))]
    events = [Impact(second - first - 1.0, 0.0, "both"), Impact(2.0 - second, 1.0, "wall")]
    scene = Scene(bodies=bodies, start=start)
    solution = simulate(scene, 6.0 / speed, integrator, events=events)
    assert solution.outcome.success
    places = solution.q[-1, [0, solution.q.shape[1] // 2]]
    np.testing.assert_allclose(places, [0.8125, 1.8125], atol=1e-9)
