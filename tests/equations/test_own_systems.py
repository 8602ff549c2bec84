"""Systems that are given by their physics: exact partials, and a mass that depends on q."""

import itertools

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Adjoint,
    ComplexStep,
    ContinuousAdjoint,
    DirectDifferentiation,
    Integral,
    Terminal,
    differentiate,
    gradient,
    simulate,
    sweep,
)
from ancfdae.equations import StateDirection, reaction
from ancfdae.equations.held import held_q
from ancfdae.errors import InvalidInputError, NotTracedWarning
from ancfdae.extend import FormulaSystem
from ancfdae.numerics.extrapolation import real_derivative
from ancfdae.observables import custom
from tests.support.mechanisms import (
    CalledPendulum,
    CarAxis,
    CartesianPendulum,
    GuidedDoublePendulum,
    WrittenPendulum,
)

STATE = {"t": 0.3}
_rng = np.random.default_rng(4)
for _name in ("q", "v", "a", "x"):
    STATE[_name] = _rng.uniform(-1, 1, 2)
for _name in ("q_b", "v_b", "a_b"):
    STATE[_name] = _rng.uniform(-1, 1, (2, 2))
STATE["lam"], STATE["lam_b"] = _rng.uniform(-1, 1, 1), _rng.uniform(-1, 1, (1, 2))


T, Q, V, A, J, MU = (STATE[x] for x in ("t", "q", "v", "a", "x", "x"))
Q_B, V_B, A_B, LAM, LAM_B = (STATE[x] for x in ("q_b", "v_b", "a_b", "lam", "lam_b"))
HELD, L = np.zeros((2, 2)), 1.0
NOW = np.array([T]), Q[None], V[None], A[None], LAM[None]
STATES, ALONG = (Q, V, A, LAM), StateDirection(1.0, V, A)
DIRECTION, TANGENT = np.array([-np.sin(1.0), -np.cos(1.0)]), np.array([np.cos(1.0), -np.sin(1.0)])

# Terms of the pendulum with the angle -1 and the spin 2, and what they are by hand.
TERMS = {
    "start_b": (
        lambda s: s.start_b(),
        [np.outer(DIRECTION, [1, 0]), np.outer(2 * TANGENT, [1, 0])],
    ),
    "mass": (lambda s: s.mass(Q), np.eye(2).ravel()),
    "mass_times": (lambda s: s.mass_times(Q, J), J),
    "force_and_total": (
        lambda s: s.force_and_total(T, np.array([Q, *Q_B.T]), np.array([V, *V_B.T])),
        [[0.0, -9.81], [0.0, 0.0], [0.0, -1.0]],
    ),
    "force_along": (lambda s: s.force_along(T, Q, V, ALONG), np.zeros(2)),
    "constraint, order 1": (lambda s: s.constraint(T, Q, V), [Q @ V]),
    "constraint, order 2": (lambda s: s.constraint(T, Q, V, A), [V @ V + Q @ A]),
    "constraint, order 3": (lambda s: s.constraint(T, Q, V, A, J), [3 * V @ A + Q @ J]),
    "constraint_q": (lambda s: s.constraint_q(T, Q), Q),
    "constraint_q, order 1": (lambda s: s.constraint_q(T, Q, V), V),
    "constraint_q, order 2": (lambda s: s.constraint_q(T, Q, V, A), A),
    "constraint_q, order 3": (lambda s: s.constraint_q(T, Q, V, A, J), J),
    "constraint_total": (lambda s: s.constraint_total(T, (Q,), (Q_B,)), [Q @ Q_B - [L, 0]]),
    "constraint_total, held": (lambda s: s.constraint_total(T, (Q,)), [[-L, 0.0]]),
    "constraint_total, order 1": (
        lambda s: s.constraint_total(T, (Q, V), (Q_B, V_B)),
        [Q @ V_B + V @ Q_B],
    ),
    "constraint_total, order 2": (
        lambda s: s.constraint_total(T, (Q, V, A), (Q_B, V_B, A_B)),
        [2 * V @ V_B + A @ Q_B + Q @ A_B],
    ),
    "constraint_total, order 3": (
        lambda s: s.constraint_total(T, (Q, V, A, J), (Q_B, V_B, A_B, HELD)),
        [3 * (A @ V_B + V @ A_B) + J @ Q_B],
    ),
    "f_q": (lambda s: s.linearise(*NOW).f_q[0], (np.eye(2) * LAM[0]).ravel()),
    "f_b": (lambda s: s.design_partials(*NOW).f_b[0], [[0.0, 0.0], [0.0, 1.0]]),
    "along_total": (
        lambda s: s.along_total(T, STATES, ALONG, (Q_B, V_B, A_B, LAM_B), (V_B, A_B)),
        V_B * LAM[0] + np.outer(V, LAM_B[0]),
    ),
    "along_pull_back": (lambda s: s.along_pull_back(T, STATES, ALONG, MU), np.zeros((3, 2))),
}


@pytest.mark.parametrize("kind", [WrittenPendulum, CalledPendulum, CartesianPendulum])
@pytest.mark.parametrize("name", TERMS)
def test_terms_are_those_written_by_hand(name, kind):
    term, exact = TERMS[name]
    ours, exact = np.array(term(kind(-1.0, 2.0))), np.array(exact)
    assert ours.shape == exact.shape
    # The claim: 1e-12 of values of order one.
    assert np.max(np.abs(ours - exact)) < 1e-12 * max(1.0, np.max(np.abs(exact)))


@pytest.mark.parametrize("kind", [WrittenPendulum, CalledPendulum])
@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e4])
def test_accuracy_does_not_depend_on_the_unit_of_length(factor, kind):
    b = (factor, 9.81 * factor)
    ours, exact = kind(-1.0, 2.0, b), CartesianPendulum(-1.0, 2.0, b)
    motion = tuple(x * factor for x in (Q, V, A, 0 * J))
    motion_b = Q_B, V_B, A_B, HELD
    for order in (2, 3):
        for term in (
            lambda s, order=order: s.constraint(0.0, *motion[: order + 1]),
            lambda s, order=order: s.constraint_total(
                0.0, motion[: order + 1], motion_b[: order + 1]
            ),
        ):
            value, expected = term(ours), term(exact)
            assert np.max(np.abs(value - expected)) < 1e-12 * np.max(np.abs(expected)), order


class Driven(FormulaSystem):
    """A point on a spring; x follows a harmonic of any frequency."""

    n_q, n_lam = 2, 1
    design_names = ("k", "w")

    def with_values(self, b):
        return Driven(b)

    def start(self):
        return np.array([1.0, 0.5]), np.array([0.2 * self.b[1], 0.0])

    def mass_matrix(self, q):
        return np.diag([1.0, 2.0])

    def force(self, t, q, v):
        spring = self.b[0] * (1 - 0.3 / np.sqrt(q @ q))
        return -spring * q - 0.1 * v * np.sqrt(1e-2 + v @ v)

    def position_constraint(self, t, q):
        return np.array([q[0] - 1 - 0.2 * np.sin(self.b[1] * t)])


@pytest.mark.parametrize("w", [1e-3, 1.0, 1e3, 1e6])
def test_sides_of_a_prescribed_motion_of_any_frequency(w):
    system, t = Driven((3.0, w)), 0.3 / w
    # Slow enough beside the prescribed motion not to limit the circles.
    q, v, a = np.array([1.1, 0.2]), np.array([0.1, 0.03]) * w, np.array([0.2, 0.1]) * w**2
    sine, cosine = 0.2 * np.sin(0.3), 0.2 * np.cos(0.3)
    zero = np.zeros((2, 2))
    held = np.zeros(2)
    for ours, exact in (
        (system.constraint(t, q, held)[0], -w * cosine),
        (system.constraint(t, q, v, held)[0], w**2 * sine),
        (system.constraint(t, q, v, a, held)[0], w**3 * cosine),
        (
            system.constraint_total(t, (q, v, held), (zero, zero, zero))[0, 1],
            2 * w * sine + w * 0.3 * cosine,
        ),
    ):
        assert abs(ours - exact) < 1e-12 * abs(exact)


@pytest.mark.parametrize("kind", [WrittenPendulum, CalledPendulum])
def test_pendulum_moves_and_differentiates_like_the_one_written_by_hand(kind):
    ours, exact = (
        differentiate(x(-1.0, 2.0), 1.0, HHT(2.0**-6)) for x in (kind, CartesianPendulum)
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
        gradient(system, OBJECTIVES[kind], 0.5, integrator, method=DirectDifferentiation()).gradient
        * system.b
    )
    # The claims: 1e-10, and order 1.8.
    assert_near(adjoint, direct, 1e-10)
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(orders > 1.8), (orders, errors)


class Kept(WrittenPendulum):
    def with_values(self, b):
        return type(self)(self.angle, self.spin, b)


class FilledIn(Kept):
    def force(self, t, q, v):
        Q = np.zeros(2)
        Q[1] = -self.b[1]
        return Q


class Absolute(Kept):
    def position_constraint(self, t, q):
        return np.array([np.sum(np.abs(q) ** 2) - self.b[0] ** 2])


class Compared(Kept):
    def force(self, t, q, v):
        return super().force(t, q, v) * (1.0 if t < 2.0 else 0.5)


class Drag(Kept):
    """A drag that vanishes beside gravity at the start."""

    def force(self, t, q, v):
        return super().force(t, q, v) - 1e-3 * np.abs(v) * v


class DragOneWay(Kept):
    """Differs from the analytic -v^2 only where v_0 is negative."""

    def force(self, t, q, v):
        size = np.abs(v[0]) if v[0].real < -0.1 else v[0]
        return super().force(t, q, v) - 1e-3 * size * v


class OneNumber(Kept):
    def position_constraint(self, t, q):
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
        (Absolute, "Absolute.position_constraint"),
        (Compared, "Compared.force"),
        (Drag, "Drag.force"),
        (DragOneWay, "DragOneWay.force"),
        (OneNumber, "OneNumber.position_constraint"),
        (FloatStart, "FloatStart.start"),
        (BadMass, "BadMass.mass_matrix"),
        (NoMass, "NoMass.weights"),
    ],
)
def test_what_complex_arithmetic_cannot_differentiate_is_refused_by_name(kind, where):
    with pytest.raises(InvalidInputError, match=where):
        kind()


def test_wrong_number_of_design_values_is_refused():
    with pytest.raises(InvalidInputError, match=r"WrittenPendulum\.b"):
        WrittenPendulum(b=(1.0,))


def test_matrices_carry_the_perturbation_of_state_and_design():
    step = 1e-40
    system, b = GuidedDoublePendulum(0.7), np.array([1.5, 1.0, 0.3, 0.1])
    db, (q, v, a) = np.array([0.3, -0.2, 0.1, 0.4]), (STATE[x] for x in ("q", "v", "a"))
    moved = system.with_values(b + 1j * step * db)
    for value in (
        lambda x, e: x.mass_along(q + e * v, a),
        lambda x, e: x.constraint_q(0.3, q + e * v),
        lambda x, e: x.constraint_q(0.3, q + e * v, v + e * a),
    ):
        expected = real_derivative(lambda e, value=value: value(system.with_values(b + e * db), e))
        ours = np.imag(value(moved, 1j * step)) / step
        assert np.max(np.abs(expected)) > 0
        assert_near(ours, expected, 1e-8)


class Kinked(Kept):
    """A kink beside the start, which only the state meets."""

    def position_constraint(self, t, q):
        stop = np.where(np.real(q[0]) > 0.5, (q[0] - 0.5) * 1.0, 0.0)
        return super().position_constraint(t, q) + stop


def test_a_kink_in_a_constraint_is_told():
    with pytest.warns(NotTracedWarning, match=r"calls position_constraint.*np\.where"):
        Kinked(-1.0, 2.0)


def test_the_car_axis_of_the_ivp_test_set():
    # Held to ten times the tolerance, in units of the size of the car.
    run = simulate(CarAxis(), 3.0, IDA(rtol=1e-5))
    assert run.outcome.success, str(run.outcome)
    assert np.max(np.abs(run.q[-1] - CarAxis.published)) < 1e-4
    # By a method of another kind, which asks for accelerations at every stage.
    explicit = simulate(CarAxis(), 0.1, DOP853(rtol=1e-5))
    assert np.max(np.abs(explicit.q[-1] - run.at(0.1).q[0])) < 1e-4


class FarBar(FormulaSystem):
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

    def force(self, t, q, v):
        return 0 * q

    def position_constraint(self, t, q):
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
        assert abs(system.constraint(0.3, q, velocities, 0 * q)[0] + exact) < 1e-12


class Forgetful(FarBar):
    """Does not hand on the values of its design variables."""

    def with_values(self, b):
        return Forgetful(1.0)


class ForgetfulPendulum(CartesianPendulum):
    def with_values(self, b):
        return ForgetfulPendulum(self.angle, self.spin)


def test_values_that_are_forgotten_are_told():
    """`with_values` that drops the values was an endless recursion, or gave zero derivatives."""
    for call in (
        lambda: Forgetful(1.0),
        lambda: gradient(
            ForgetfulPendulum(), Terminal(custom(lambda t, q, v, lam, b: q[:, 1])), 0.1, HHT(0.01)
        ),
        lambda: sweep(ForgetfulPendulum(), [[1.1, 9.0]], len).failed[0],
    ):
        try:
            told = str(call())
        except InvalidInputError as error:
            told = str(error)
        assert "with_values: must return the system at the values b that it is given" in told


class TwoBars(FormulaSystem):
    """Two bars in the plane, x, y and angle each, on a pin and joined by another."""

    n_q, n_lam = 6, 4
    design_names = ("a", "b", "m")

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

    def force(self, t, q, v):
        weight = np.array([0.0, -9.81, 0.0, 0.0, -9.81 * self.b[2], 0.0])
        return (weight - 0.1 * v.T).T - 0.2 * np.sin(q) * v

    def position_constraint(self, t, q):
        a, b, _ = self.b
        x, y = a / 2 * np.cos(q[2]), a / 2 * np.sin(q[2])
        u, w = b / 2 * np.cos(q[5]), b / 2 * np.sin(q[5])
        return np.array([q[0] - x, q[1] - y, q[0] + x - q[3] + u, q[1] + y - q[4] + w])


class Mixing(TwoBars):
    """Constraints in a sum over all of q."""

    def position_constraint(self, t, q):
        return super().position_constraint(t, q) + 0.1 * np.sin(np.sum(q)) * q[0]


def test_second_derivatives_of_constraints_along_sums_of_coordinates_are_exact():
    system = Mixing()
    q, lam = system.start()[0] + 0.1, np.array([0.3, -0.7, 1.1, 0.2])
    exact = [np.imag(reaction(system, 0.0, q + 1e-40j * unit, lam)) / 1e-40 for unit in np.eye(6)]
    found = held_q(system, 0.0, q, 0 * q, lam).reshape(6, 6)
    # Differences of second derivatives along sums: a few times the 1e-13 of each.
    np.testing.assert_allclose(found, np.transpose(exact), rtol=1e-11, atol=1e-12)


def test_constraint_forces_that_vanish_have_derivatives():
    # At the start the bars pull nothing along x: two multipliers are round-off.
    system = TwoBars()
    q, _ = system.start()
    inertia = held_q(system, 0.0, q, 0 * q, np.zeros(4))
    assert np.all(inertia == 0)
    found = differentiate(system, 2.0**-4, HHT(2.0**-6)).sensitivities.q_b[-1]
    exact = differentiate(system, 2.0**-4, HHT(2.0**-6), method=ComplexStep())
    np.testing.assert_allclose(found, exact.sensitivities.q_b[-1], rtol=1e-10, atol=1e-12)
