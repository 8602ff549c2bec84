"""Systems that are given by their physics: exact partials, and a mass that depends on q."""

import itertools

import numpy as np
import pytest

from ancfdae import (
    HHT,
    IDA,
    Adjoint,
    ComplexStep,
    ComplexStepSystem,
    ContinuousAdjoint,
    Direct,
    Explicit,
    Integral,
    InvalidInput,
    Terminal,
    custom,
    differentiate,
    gradient,
    simulate,
    sweep,
)
from ancfdae.numerics.extrapolation import real_derivative

from mechanisms import CarAxis, CartesianPendulum, GuidedDoublePendulum, WrittenPendulum

STATE = {"t": 0.3}
_rng = np.random.default_rng(4)
for _name in ("q", "v", "a", "x"):
    STATE[_name] = _rng.uniform(-1, 1, 2)
for _name in ("q_b", "v_b", "a_b"):
    STATE[_name] = _rng.uniform(-1, 1, (2, 2))
STATE["lam"], STATE["lam_b"] = _rng.uniform(-1, 1, 1), _rng.uniform(-1, 1, (1, 2))


class PendulumByHand(CartesianPendulum):
    """Every member by a formula, also what the base class derives."""

    def start_b(self):
        zero = np.zeros(2)
        q_b = np.stack([self._direction, zero], axis=1)
        return q_b, np.stack([self.spin * self._tangent, zero], axis=1)

    def mass_times(self, q, x):
        return x

    def mass_b_times(self, q, a):
        return np.zeros((2, 2))

    def inertia_q(self, q, a):
        return np.zeros(4)

    def inertia_rate_total(self, q, v, a, q_b, v_b, a_b):
        return np.zeros((2, 2))

    def force_q(self, q, v, t):
        return np.zeros(4)

    def force_v(self, q, v, t):
        return np.zeros(4)

    def force_b(self, q, v, t):
        return np.array([[0.0, 0.0], [0.0, -1.0]])

    def force_rate_total(self, q, v, a, t, q_b, v_b, a_b):
        return np.zeros((2, 2))

    def constraint_b(self, q, t):
        return np.array([[-self.b[0], 0.0]])

    def constraint_force(self, q, lam, t):
        return q * lam[0]

    def constraint_force_q(self, q, lam, t):
        return (np.eye(2) * lam[0]).ravel()

    def constraint_force_b(self, q, lam, t):
        return np.zeros((2, 2))

    def constraint_q_times_total(self, q, x, t, q_b):
        return (x @ q_b)[None]

    def constraint_q_second_rate(self, q, v, a, t):
        return a

    def velocity_side_total(self, q, t, q_b):
        return np.zeros((1, 2))

    def acceleration_side_total(self, q, v, t, q_b, v_b):
        return -2 * (v @ v_b)[None]

    def jerk_side_total(self, q, v, a, t, q_b, v_b, a_b):
        return -3 * (a @ v_b + v @ a_b)[None]

    def constraint_force_rate(self, q, v, lam, t):
        return v * lam[0]

    def constraint_force_rate_total(self, q, v, lam, t, q_b, v_b, lam_b):
        return v_b * lam[0] + np.outer(v, lam_b[0])


MEMBERS = {
    "mass": "q",
    "mass_times": "q x",
    "mass_b_times": "q a",
    "inertia_q": "q a",
    "inertia_rate_total": "q v a q_b v_b a_b",
    "force_q": "q v t",
    "force_v": "q v t",
    "force_b": "q v t",
    "force_rate": "q v a t",
    "force_rate_total": "q v a t q_b v_b a_b",
    "constraint_q": "q t",
    "constraint_b": "q t",
    "constraint_force": "q lam t",
    "constraint_force_q": "q lam t",
    "constraint_force_b": "q lam t",
    "constraint_q_times_total": "q x t q_b",
    "constraint_q_rate": "q v t",
    "constraint_q_second_rate": "q v a t",
    "velocity_side": "q t",
    "velocity_side_total": "q t q_b",
    "acceleration_side": "q v t",
    "acceleration_side_total": "q v t q_b v_b",
    "jerk_side": "q v a t",
    "jerk_side_total": "q v a t q_b v_b a_b",
    "constraint_force_rate": "q v lam t",
    "constraint_force_rate_total": "q v lam t q_b v_b lam_b",
    "start_b": "",
}


@pytest.mark.parametrize("kind", [WrittenPendulum, CartesianPendulum])
@pytest.mark.parametrize("name", MEMBERS)
def test_partials_are_those_written_by_hand(name, kind):
    arguments = [STATE[x] for x in MEMBERS[name].split()]
    ours, exact = (
        np.array(getattr(kind(-1.0, 2.0), name)(*arguments)) for kind in (kind, PendulumByHand)
    )
    assert ours.shape == exact.shape
    # The claim: 1e-12 of values of order one.
    assert np.max(np.abs(ours - exact)) < 1e-12 * max(1.0, np.max(np.abs(exact)))


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e4])
def test_accuracy_does_not_depend_on_the_unit_of_length(factor):
    b = (factor, 9.81 * factor)
    ours, exact = WrittenPendulum(-1.0, 2.0, b), CartesianPendulum(-1.0, 2.0, b)
    q, v, a, q_b, v_b, a_b = (STATE[x] * factor for x in ("q", "v", "a", "q_b", "v_b", "a_b"))
    for name, arguments in (
        ("acceleration_side", (q, v, 0.0)),
        ("jerk_side", (q, v, a, 0.0)),
        ("jerk_side_total", (q, v, a, 0.0, q_b / factor, v_b / factor, a_b / factor)),
    ):
        value, expected = (np.array(getattr(x, name)(*arguments)) for x in (ours, exact))
        assert np.max(np.abs(value - expected)) < 1e-12 * np.max(np.abs(expected)), name


class Driven(ComplexStepSystem):
    """A point on a spring; x follows a harmonic of any frequency."""

    n_q, n_lam = 2, 1
    design_names = ("k", "w")

    def with_values(self, b):
        return Driven(b)

    def start(self):
        return np.array([1.0, 0.5]), np.array([0.2 * self.b[1], 0.0])

    def mass_matrix(self, q):
        return np.diag([1.0, 2.0])

    def force(self, q, v, t):
        spring = self.b[0] * (1 - 0.3 / np.sqrt(q @ q))
        return -spring * q - 0.1 * v * np.sqrt(1e-2 + v @ v)

    def constraint(self, q, t):
        return np.array([q[0] - 1 - 0.2 * np.sin(self.b[1] * t)])


@pytest.mark.parametrize("w", [1e-3, 1.0, 1e3, 1e6])
def test_sides_of_a_prescribed_motion_of_any_frequency(w):
    system, t = Driven((3.0, w)), 0.3 / w
    # Slow enough beside the prescribed motion not to limit the circles.
    q, v, a = np.array([1.1, 0.2]), np.array([0.1, 0.03]) * w, np.array([0.2, 0.1]) * w**2
    sine, cosine = 0.2 * np.sin(0.3), 0.2 * np.cos(0.3)
    zero = np.zeros((2, 2))
    for ours, exact in (
        (system.velocity_side(q, t)[0], w * cosine),
        (system.acceleration_side(q, v, t)[0], -(w**2) * sine),
        (system.jerk_side(q, v, a, t)[0], -(w**3) * cosine),
        (
            system.acceleration_side_total(q, v, t, zero, zero)[0, 1],
            -2 * w * sine - w * 0.3 * cosine,
        ),
    ):
        assert abs(ours - exact) < 1e-12 * abs(exact)


def test_pendulum_moves_and_differentiates_like_the_one_written_by_hand():
    ours, exact = (
        differentiate(kind(-1.0, 2.0), 1.0, HHT(2.0**-6))
        for kind in (WrittenPendulum, CartesianPendulum)
    )
    for name in ("q", "v", "a", "lam"):
        assert_near(getattr(ours, name), getattr(exact, name), 1e-10)
        derivative = f"{name}_b"
        pair = (getattr(run.sensitivities, derivative) for run in (ours, exact))
        assert_near(*pair, 1e-10)


def assert_near(ours, exact, tolerance):
    assert np.max(np.abs(ours - exact)) <= tolerance * np.max(np.abs(exact))


@pytest.mark.parametrize("hht_alpha", [-0.05, -0.3])
@pytest.mark.parametrize("spin", [0.0, 1.0])
def test_motion_with_a_mass_that_depends_on_q_converges_with_order_two(spin, hht_alpha):
    system = GuidedDoublePendulum(spin)
    runs = [simulate(system, 0.5, HHT(2.0**-k, hht_alpha)) for k in (6, 7, 8)]
    for run in runs:
        assert run.outcome.success, str(run.outcome)
    for name in ("q", "v", "a", "lam"):
        values = [getattr(run, name) for run in runs]
        changes = [np.max(np.abs(x - y[::2])) for x, y in itertools.pairwise(values)]
        order = np.log2(changes[-2] / changes[-1])
        # The claim: 2 within 0.15.
        assert abs(order - 2) < 0.15, (name, order)


def test_motion_keeps_the_balance_of_energy():
    # Undamped and on a line at rest nothing does work; what HHT-I3 takes away is of order h^2.
    losses = []
    for step in (2.0**-8, 2.0**-9):
        system = GuidedDoublePendulum(1.0, (1.5, 1.0, 0.0, 0.0))
        run = simulate(system, 0.5, HHT(step, -0.05))
        m2, L1, _, _ = system.b
        kinetic = [v @ system.mass_matrix(q) @ v / 2 for q, v in zip(run.q, run.v, strict=True)]
        first, second = -np.cos(run.q).T * system.gravity
        energy = kinetic + (1 + m2) * L1 * first + m2 * system.second * second
        losses.append(np.max(np.abs(energy - energy[0])))
    # Of energies of the order of ten.
    assert losses[1] < 1e-2
    assert losses[0] / losses[1] > 3.5


@pytest.mark.parametrize("spin", [0.0, 1.0])
def test_direct_differentiation_is_the_complex_step_of_the_run(spin):
    system, integrator = GuidedDoublePendulum(spin), HHT(2.0**-5)
    direct = differentiate(system, 0.25, integrator).sensitivities
    check = differentiate(system, 0.25, integrator, method=ComplexStep()).sensitivities
    for name in ("q_b", "v_b", "a_b", "lam_b"):
        for i in range(system.n_b):
            # The claim: 1e-9.
            assert_near(getattr(direct, name)[..., i], getattr(check, name)[..., i], 1e-9)


OBJECTIVES = {
    "q": Integral(custom(lambda t, q, v, lam, b: q[:, 0] ** 2 + q[:, 1] * v[:, 0])),
    "lam": Integral(custom(lambda t, q, v, lam, b: lam[:, 0] ** 2)),
}


@pytest.mark.parametrize("kind", OBJECTIVES)
def test_discrete_adjoint_is_direct_differentiation_and_the_continuous_one_approaches(kind):
    system, errors = GuidedDoublePendulum(1.0), []
    for exponent in (5, 6, 7):
        integrator = HHT(2.0**-exponent)
        adjoint, continuous = (
            gradient(system, OBJECTIVES[kind], 0.5, integrator, method=method).gradient * system.b
            for method in (Adjoint(), ContinuousAdjoint())
        )
        errors.append(np.linalg.norm(continuous - adjoint) / np.linalg.norm(adjoint))
    direct = (
        gradient(system, OBJECTIVES[kind], 0.5, integrator, method=Direct()).gradient * system.b
    )
    # The claims: 1e-10, and order 1.8.
    assert_near(adjoint, direct, 1e-10)
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(orders > 1.8), (orders, errors)


class Kept(WrittenPendulum):
    def with_values(self, b):
        return type(self)(self.angle, self.spin, b)


class FilledIn(Kept):
    def force(self, q, v, t):
        Q = np.zeros(2)
        Q[1] = -self.b[1]
        return Q


class Absolute(Kept):
    def constraint(self, q, t):
        return np.array([np.sum(np.abs(q) ** 2) - self.b[0] ** 2])


class Compared(Kept):
    def force(self, q, v, t):
        return super().force(q, v, t) * (1.0 if t < 2.0 else 0.5)


class Drag(Kept):
    """A drag that vanishes beside gravity at the start."""

    def force(self, q, v, t):
        return super().force(q, v, t) - 1e-3 * np.abs(v) * v


class DragOneWay(Kept):
    """Differs from the analytic -v^2 only where v_0 is negative."""

    def force(self, q, v, t):
        size = np.abs(v[0]) if v[0].real < -0.1 else v[0]
        return super().force(q, v, t) - 1e-3 * size * v


class OneNumber(Kept):
    def constraint(self, q, t):
        return (q @ q - self.b[0] ** 2) / 2


class FloatStart(Kept):
    def start(self):
        q, v = super().start()
        return q.real.copy(), v


class BadMass(Kept):
    def mass_matrix(self, q):
        return np.ones(2)


class NoMass(Kept):
    def mass_matrix(self, q):
        return np.diag([1.0, 0.0])


@pytest.mark.parametrize(
    ("kind", "where"),
    [
        (FilledIn, "FilledIn.force"),
        (Absolute, "Absolute.constraint"),
        (Compared, "Compared.force"),
        (Drag, "Drag.force"),
        (DragOneWay, "DragOneWay.force"),
        (OneNumber, "OneNumber.constraint"),
        (FloatStart, "FloatStart.start"),
        (BadMass, "BadMass.mass_matrix"),
        (NoMass, "NoMass.weights"),
    ],
)
def test_what_complex_arithmetic_cannot_differentiate_is_refused_by_name(kind, where):
    with pytest.raises(InvalidInput, match=where):
        kind()


def test_wrong_number_of_design_values_is_refused():
    with pytest.raises(InvalidInput, match=r"WrittenPendulum\.b"):
        WrittenPendulum(b=(1.0,))


def test_matrices_carry_the_perturbation_of_state_and_design():
    step = 1e-40
    system, b = GuidedDoublePendulum(0.7), np.array([1.5, 1.0, 0.3, 0.1])
    db, (q, v, a) = np.array([0.3, -0.2, 0.1, 0.4]), (STATE[x] for x in ("q", "v", "a"))
    moved = system.with_values(b + 1j * step * db)
    for value in (
        lambda x, e: x.inertia_q(q + e * v, a),
        lambda x, e: x.constraint_q(q + e * v, 0.3),
        lambda x, e: x.constraint_q_rate(q + e * v, v + e * a, 0.3),
    ):
        expected = real_derivative(lambda e, value=value: value(system.with_values(b + e * db), e))
        ours = np.imag(value(moved, 1j * step)) / step
        assert np.max(np.abs(expected)) > 0
        assert_near(ours, expected, 1e-8)


def test_imaginary_parts_that_are_no_perturbation_are_refused():
    system = WrittenPendulum(-1.0, 2.0)
    with pytest.raises(InvalidInput, match="complex step"):
        system.acceleration_side(STATE["q"] + 1e-6j, STATE["v"], 0.0)
    with pytest.raises(InvalidInput, match="complex step"):
        WrittenPendulum(b=(1.0 + 0.1j, 9.81)).constraint_q(STATE["q"], 0.0)


class Kinked(Kept):
    """A kink beside the start, which only the state meets."""

    def constraint(self, q, t):
        stop = np.where(np.real(q[0]) > 0.5, (q[0] - 0.5) * 1.0, 0.0)
        return super().constraint(q, t) + stop


def test_a_kink_is_refused_and_not_differentiated():
    system = Kinked(-1.0, 2.0)
    with pytest.raises(InvalidInput, match="analytic"):
        system.acceleration_side(np.array([0.5, -0.5]), np.array([1.0, 0.0]), 0.0)


def test_the_car_axis_of_the_ivp_test_set():
    # Held to ten times the tolerance, in units of the size of the car.
    run = simulate(CarAxis(), 3.0, IDA(rtol=1e-5))
    assert run.outcome.success, str(run.outcome)
    assert np.max(np.abs(run.q[-1] - CarAxis.published)) < 1e-4
    # By a method of another kind, which asks for accelerations at every stage.
    explicit = simulate(CarAxis(), 0.1, Explicit(rtol=1e-5))
    assert np.max(np.abs(explicit.q[-1] - run.at(0.1).q[0])) < 1e-4


class FarBar(ComplexStepSystem):
    """A bar between two masses, far from the origin, in flight."""

    n_q, n_lam, design_names = 4, 1, ("L",)

    def __init__(self, away, b=(1.0,)):
        self.away = away
        super().__init__(b)

    def with_values(self, b):
        return FarBar(self.away, b)

    def start(self):
        return np.array([self.away, 0.3, self.away + 0.6, 1.1]), np.array([0.4, 0.3, 0.4, 0.3])

    def mass_matrix(self, q):
        return np.eye(4)

    def force(self, q, v, t):
        return 0 * q

    def constraint(self, q, t):
        x, y = q[2] - q[0], q[3] - q[1]
        return np.array([(x * x + y * y - self.b[0] ** 2) / 2])


@pytest.mark.parametrize("away", [1.0, 1e3, 1e6])
def test_a_bar_that_does_not_turn_has_accelerations(away):
    # Its constraint is round-off of terms of order one on every circle along the motion. That of
    # the ends grows with `away`, and so does the radius.
    system = FarBar(away)
    q, v = system.start()
    turning = v + np.array([0.0, 0.0, -0.8, 0.6])
    # gamma = -|v_2 - v_1|^2
    for velocities, exact in ((v, 0.0), (turning, -1.0)):
        assert abs(system.acceleration_side(q, velocities, 0.3)[0] - exact) < 1e-12


class Forgetful(FarBar):
    """Does not hand on the values of its design variables."""

    def with_values(self, b):
        return Forgetful(1.0)


class ForgetfulPendulum(CartesianPendulum):
    def with_values(self, b):
        return ForgetfulPendulum(self.angle, self.spin)


def test_values_that_are_forgotten_are_told():
    """They were an endless recursion, or derivatives of zero."""
    for call in (
        lambda: Forgetful(1.0),
        lambda: gradient(
            ForgetfulPendulum(), Terminal(custom(lambda t, q, v, lam, b: q[:, 1])), 0.1, HHT(0.01)
        ),
        lambda: sweep(ForgetfulPendulum(), [[1.1, 9.0]], len).failed[0],
    ):
        try:
            told = str(call())
        except InvalidInput as error:
            told = str(error)
        assert "with_values: must return the system at the values b that it is given" in told


# ---- many states in one call


class TwoBars(ComplexStepSystem):
    """Two bars in the plane, x, y and angle each, on a pin and joined by another."""

    n_q, n_lam = 6, 4
    design_names = ("a", "b", "m")
    calls = 0

    def __init__(self, b=(1.0, 0.8, 1.3)):
        super().__init__(b)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        a, b, _ = self.b
        at = [a + b / 2 * np.cos(0.3), b / 2 * np.sin(0.3), 0.3]
        return np.array([a / 2, 0.0, 0.0, *at]), np.zeros(6)

    def mass_matrix(self, q):
        a, b, m = self.b
        return np.diag(np.array([1.0, 1.0, a**2 / 12, m, m, m * b**2 / 12]))

    def force(self, q, v, t):
        return np.array([0.0, -9.81, 0.0, 0.0, -9.81 * self.b[2], 0.0]) - 0.1 * v

    def constraint(self, q, t):
        TwoBars.calls += 1
        a, b, _ = self.b
        x, y = a / 2 * np.cos(q[2]), a / 2 * np.sin(q[2])
        u, w = b / 2 * np.cos(q[5]), b / 2 * np.sin(q[5])
        return np.array([q[0] - x, q[1] - y, q[0] + x - q[3] + u, q[1] + y - q[4] + w])


class OneByOne(TwoBars):
    """The same where a function takes single states only."""

    def constraint(self, q, t):
        return super().constraint(np.array([1.0 * x for x in q]).reshape(6), t)


class Mixing(TwoBars):
    """Constraints in a sum over all of q, which an array of states would mix."""

    def constraint(self, q, t):
        return super().constraint(q, t) + 0.1 * np.sin(np.sum(q)) * q[0]


class MixedApart(Mixing):
    """The same with a sum that takes single states and arrays of them."""

    def constraint(self, q, t):
        return TwoBars.constraint(self, q, t) + 0.1 * np.sin(sum(q)) * q[0]


@pytest.mark.parametrize(("plain", "other"), [(TwoBars, OneByOne), (MixedApart, Mixing)])
def test_functions_of_single_states_give_the_same_partials(plain, other):
    rng = np.random.default_rng(2)
    q, lam = plain().start()[0] + 0.1 * rng.uniform(-1, 1, 6), rng.uniform(-1, 1, 4)
    for name, arguments in (("constraint_q", (q, 0.0)), ("constraint_force_q", (q, lam, 0.0))):
        ours, theirs = (getattr(kind(), name)(*arguments) for kind in (plain, other))
        # Complex steps are exact to round-off, second derivatives on circles to 1e-13.
        np.testing.assert_allclose(theirs, ours, rtol=1e-12, atol=1e-12)


def test_second_derivatives_of_constraints_along_sums_of_coordinates_are_exact():
    system = MixedApart()
    q, lam = system.start()[0] + 0.1, np.array([0.3, -0.7, 1.1, 0.2])
    exact = [
        np.imag(system.constraint_force(q + 1e-40j * unit, lam, 0.0)) / 1e-40 for unit in np.eye(6)
    ]
    found = system.constraint_force_q(q, lam, 0.0).reshape(6, 6)
    # Differences of second derivatives along sums: a few times the 1e-13 of each.
    np.testing.assert_allclose(found, np.transpose(exact), rtol=1e-11, atol=1e-12)


def test_constraint_forces_that_vanish_have_derivatives():
    # At the start the bars pull nothing along x: two multipliers are round-off.
    system = TwoBars()
    q, _ = system.start()
    assert np.all(system.constraint_force_q(q, np.zeros(4), 0.0) == 0)
    found = differentiate(system, 2.0**-4, HHT(2.0**-6)).sensitivities.q_b[-1]
    exact = differentiate(system, 2.0**-4, HHT(2.0**-6), method=ComplexStep())
    np.testing.assert_allclose(found, exact.sensitivities.q_b[-1], rtol=1e-10, atol=1e-12)


def test_a_step_takes_few_evaluations():
    system, method = TwoBars(), HHT(2.0**-6)

    def calls(call, t_end):
        TwoBars.calls = 0
        call(system, t_end, method)
        return TwoBars.calls

    for call, most in ((simulate, 120), (differentiate, 500)):
        per_step = (calls(call, 0.5) - calls(call, 0.25)) / 16
        # State by state a linearisation alone took 504 evaluations, and derivatives 1,500.
        assert 10 < per_step < most, per_step
