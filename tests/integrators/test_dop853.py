"""Steps of DOP853 for equations of second order, against SciPy's for those of first order."""

import numpy as np
import pytest
import scipy

from ancfdae import (
    DOP853,
    Beam,
    Material,
    Pin,
    RotationDriver,
    Scene,
    assemble,
    differentiate,
    simulate,
)
from ancfdae.extend import FormulaSystem
from ancfdae.integrators.explicit import Dop853, Kept, Tolerances
from ancfdae.integrators.problem import Accelerations, InitialValueProblem, stacked
from ancfdae.kernels import SINGULAR
from ancfdae.laws import Harmonic
from ancfdae.sections import Rectangle
from validation.scenes import pendulum

# States, rates and coefficients are of size 1 to 40, and sums have sixteen terms.
ROUND_OFF = 1e-12
START = np.array([[[0.3, -0.7], [0.2, 0.4]], [[0.9, 0.1], [-0.5, 0.6]]])


def accelerations(t, state):
    """Accelerations of two coupled oscillators, from time and state (positions, velocities)."""
    y, u = state
    return -np.sin(3 * y) - 0.3 * u * np.abs(u) ** 2 + np.cos(5 * t) * y[::-1]


class Oscillators(Accelerations):
    """Accelerations of two oscillators without a system, singular after a time."""

    def __init__(self, until=np.inf, moved=0.0):
        self.factorisations, self._until, self._moved = 0, until, moved

    def for_kernel(self, rows):
        # As if there were multipliers: states are moved onto constraints.
        return self._found, lambda t, state: state + self._moved

    def _found(self, t, state):
        if t > self._until:
            return SINGULAR
        return np.column_stack([accelerations(t, state), np.full(len(state[0]), t)])


NONE = np.zeros(0, dtype=np.int32)
STAGES = np.arange(13, dtype=np.int32)
ROUGH = Tolerances(1e-2, np.ones((2, 2, 2)), np.zeros(2), 1)


def method_at(t, h, of=None):
    of = of or Oscillators()
    return Dop853(of, t, START, of.for_kernel(START.shape[1])[0](t, START), h)


def marched(method, tolerances, target, stop, kept):
    """Why steps end, and how many there are, without states at reported times."""
    return method.march(tolerances, np.array([target]), stop, kept)[:2]


def one(used=NONE):
    return Kept.room(1, used, 2, 2, 1)


def scipy_step(t, end):
    def rate(t, x):
        state = x.reshape(START.shape)
        return np.stack([state[1], accelerations(t, state)]).ravel()

    solver = scipy.integrate.DOP853(
        rate, t, START.ravel(), end, first_step=end - t, rtol=1e-2, atol=1.0
    )
    solver.step()
    assert solver.t == end
    return solver


def test_a_step_is_that_of_scipy():
    t, end = 0.4, 0.55
    method, other, kept = method_at(t, 1.0), scipy_step(t, end), one(STAGES)
    assert marched(method, ROUGH, 10.0, end, kept) == (0, 1)
    assert (method.t, method.end) == (t, end) == tuple(kept.spans[0])
    assert np.max(np.abs(method.after.ravel() - other.y)) < ROUND_OFF
    between, times = method.between(), np.linspace(t, end, 7)
    assert np.max(np.abs(between(times).reshape(7, -1).T - other.dense_output()(times))) < ROUND_OFF
    assert np.max(np.abs(between(times[2]) - between(times)[2])) < ROUND_OFF
    # What is kept: the state before, the stages, and the state after; multipliers are times here.
    assert np.max(np.abs(kept.states[0].reshape(13, 2, -1)[-1].ravel() - other.y)) < ROUND_OFF
    nodes = np.append(scipy.integrate.DOP853.C, 1.0)
    assert np.allclose(kept.lam[0, :, :, 0], (t + (end - t) * nodes)[:, None], rtol=1e-15)
    for state, row in zip(kept.states[0], other.K, strict=True):
        assert np.max(np.abs(state[1].ravel() - row[:4])) < ROUND_OFF


@pytest.mark.parametrize("moved", [0.0, 1e-3])
def test_states_at_reported_times_are_those_of_the_dense_output_of_scipy(moved):
    t, end = 0.4, 0.55
    times, other = np.append(np.linspace(t, end, 9)[1:], 0.7), scipy_step(t, end)
    # States are moved onto constraints at each time, as after the step.
    method = method_at(t, 1.0, Oscillators(moved=moved))
    why, taken, states = method.march(ROUGH, times, end, one())
    # The last time lies ahead of the step.
    assert (why, taken, states.shape) == (0, 1, (8, *START.shape))
    between = method.between()
    # Three stages for the dense output, once; twelve of the step.
    assert method.evaluations == 15
    expected = between(times[:-1]) + moved
    expected[-1] -= moved
    assert np.max(np.abs(states - expected)) < ROUND_OFF
    assert np.array_equal(states[-1], method.after)
    if not moved:
        exact = other.dense_output()(times[:-1]).T.reshape(states.shape)
        assert np.max(np.abs(states - exact)) < ROUND_OFF


class Swing(FormulaSystem):
    """An oscillator of one coordinate, q'' = -b^2 q, from rest at 1."""

    n_q, n_lam, design_names = 1, 0, ("rate",)

    def with_values(self, b):
        return Swing(b)

    def start(self):
        return np.ones(1), np.zeros(1)

    def mass_matrix(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return -(self.b**2) * q

    def position_constraint(self, t, q):
        return np.zeros(0)


def test_one_step_passes_more_reported_times_than_are_reached_at_once():
    run = differentiate(Swing([1.5]), 4.0, DOP853(1e-8, intervals=200))
    t, slopes = run.t, run.sensitivities
    assert len(t) == 1601
    assert run.statistics.steps * 64 < len(t)
    assert np.max(np.abs(run.q[:, 0] - np.cos(1.5 * t))) < 1e-7
    assert np.max(np.abs(run.v[:, 0] + 1.5 * np.sin(1.5 * t))) < 1e-7
    assert np.max(np.abs(slopes.q_b[:, 0, 0] + t * np.sin(1.5 * t))) < 1e-6
    rates = -3 * np.cos(1.5 * t) + 2.25 * t * np.sin(1.5 * t)
    assert np.max(np.abs(slopes.a_b[:, 0, 0] - rates)) < 1e-5


class Bob(FormulaSystem):
    """A pendulum in Cartesian coordinates, of unit mass and length, released from the side."""

    n_q, n_lam, design_names = 2, 1, ("gravity",)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        return np.array([1.0, 0.0]), np.zeros(2)

    def mass_matrix(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.array([0.0, -1.0]) * self.b[0]

    def position_constraint(self, t, q):
        return np.array([q @ q - 1])


def test_each_reported_time_costs_a_projection_and_a_solution():
    few, many = (simulate(Bob([9.81]), 1.0, DOP853(1e-8, intervals=n)) for n in (4, 8))
    # The last time is the end of a step, where the state is on the constraints.
    more = len(many.t) - len(few.t)
    counts = [x.statistics.factorisations - x.statistics.residuals for x in (few, many)]
    assert few.statistics.steps == many.statistics.steps
    assert counts[1] - counts[0] == 2 * more
    assert np.max(np.abs(np.sum(many.q**2, axis=1) - 1)) < 1e-14
    energies = np.sum(many.v**2, axis=1) / 2 + 9.81 * many.q[:, 1]
    assert np.max(np.abs(energies)) < 1e-6


@pytest.mark.parametrize("vector", [1, 2])
def test_errors_are_those_of_the_two_estimates(vector):
    t, end, place = 0.4, 0.55, np.array([5.0, -7.0])
    other, rtol = scipy_step(t, end), 1e-9
    floor = 1e-10 * np.arange(1.0, 9.0).reshape(2, 2, 2)
    method = method_at(t, 1.0)
    assert marched(method, Tolerances(rtol, floor, place, vector), 10.0, end, one()) == (0, 1)
    both = np.array([START, other.y.reshape(START.shape)])
    both[:, 0, 0] -= place
    if vector == 2:
        both = np.broadcast_to(np.sqrt(np.mean(both**2, axis=-1, keepdims=True)), both.shape)
    scale = (floor + rtol * np.max(np.abs(both), axis=0)).ravel()
    fine, coarse = (
        np.sqrt(np.mean((end - t) ** 2 * (other.K[:-1].T @ e[:-1] / scale) ** 2))
        for e in (other.E5, other.E3)
    )
    assert 1e-3 < method.error < 0.9
    assert abs(method.error - fine**2 / np.hypot(fine, 0.1 * coarse)) < 1e-8 * method.error


def test_a_step_is_shortened_until_its_error_is_within_the_tolerance():
    fine = ROUGH._replace(rtol=1e-9, floor=np.full((2, 2, 2), 1e-11))
    method, ends, kept = method_at(0.0, 5.0), [0.0], Kept.room(64, NONE, 2, 2, 1)
    while ends[-1] < 1.0:
        # Functions of Python are called step by step.
        assert marched(method, fine, 1.0, 3.0, kept) == (0, 1)
        assert tuple(kept.spans[0]) == (ends[-1], method.end)
        ends.append(method.end)
    assert ends[-2] < 1.0 <= ends[-1] < 3.0
    assert method.evaluations > 12 * (len(ends) - 1)

    def rate(t, x):
        state = x.reshape(START.shape)
        return np.stack([state[1], accelerations(t, state)]).ravel()

    exact = scipy.integrate.solve_ivp(
        rate, (0, method.end), START.ravel(), "DOP853", rtol=1e-13, atol=1e-13
    )
    assert np.max(np.abs(method.after.ravel() - exact.y[:, -1])) < 1e-7


def test_dense_output_ends_at_a_state_that_was_moved():
    method = method_at(0.0, 0.1, Oscillators(moved=1e-3))
    assert marched(method, ROUGH, 0.1, 0.1, one()) == (0, 1)
    unmoved = method_at(0.0, 0.1)
    marched(unmoved, ROUGH, 0.1, 0.1, one())
    assert np.max(np.abs(method.after - unmoved.after - 1e-3)) < ROUND_OFF
    moved, between = method.after, method.between()
    assert np.max(np.abs(between(0.1) - moved)) < ROUND_OFF
    # Its rate there is that of the moved state.
    slope = (between(0.1) - between(0.1 - 1e-6)) / 1e-6
    expected = np.stack([moved[1], accelerations(0.1, moved)])
    assert np.max(np.abs(slope - expected)) < 1e-4


def test_where_equations_fail_steps_come_near_and_say_why():
    method, kept = method_at(0.2, 0.1, Oscillators(until=0.25)), Kept.room(64, NONE, 2, 2, 1)
    why, ends = 0, [0.2]
    while why == 0:
        why, taken = marched(method, ROUGH, 1.0, 1.0, kept)
        ends += kept.spans[:taken, 1].tolist()
    assert why == SINGULAR
    assert 0.25 - 1e-12 < ends[-1] <= 0.25
    # Another run to the same end, step by step, is at the same state.
    again = method_at(0.2, 0.1)
    exact = scipy_step(0.2, ends[-1])
    marched(again, ROUGH, ends[-1], ends[-1], Kept.room(64, NONE, 2, 2, 1))
    assert np.max(np.abs(again.after.ravel() - exact.y)) < 1e-6


@pytest.fixture(scope="module", name="swinging")
def _swinging():
    return assemble(pendulum(), ["pendulum.youngs_modulus", "pendulum.height"])


def test_steps_at_the_limit_of_stability_are_hardly_rejected(swinging):
    run = simulate(swinging, 0.25, DOP853(1e-3, 1))
    steps, residuals = run.statistics.steps, run.statistics.residuals
    # At the limit of stability: the fastest wave of the section, 4108 rad/s, has w h = 5.7.
    assert 5.5 < 4108 * 0.25 / steps < 5.96
    # Twelve evaluations a step, three for each instant of the dense output, two for the first. With
    # the error estimate of one step alone a tenth of the steps is rejected.
    rejected = (residuals - 12 * steps - 3 * 8 - 2) / 11
    assert 0 <= rejected < 0.05 * steps


def test_derivatives_are_those_of_runs(swinging):
    explicit, share = DOP853(1e-11, 1), 1e-4
    found = differentiate(swinging, 0.02, explicit).sensitivities
    for i, b in enumerate(swinging.b):
        moved = share * b * np.eye(2)[i]
        ends = [
            simulate(swinging.with_values(swinging.b + x), 0.02, explicit) for x in (moved, -moved)
        ]
        for name in ("q", "v", "a", "lam"):
            values = [getattr(run, name)[-1] for run in ends]
            expected = (values[0] - values[1]) / (2 * share * b)
            own = getattr(found, f"{name}_b")[-1, :, i]
            # Differences err by share^2 = 1e-8 times the square of the phase of waves at the end,
            # 4108 rad/s times 0.02 s at most; slow motions dominate.
            assert np.max(np.abs(own - expected)) < 1e-5 * np.max(np.abs(expected)), name


def test_constant_constraints_hold_to_round_off(swinging):
    assert swinging.traits.constant_constraints
    run = differentiate(swinging, 0.05, DOP853(1e-4, 2))
    B, b = swinging.constraint_pattern, run.sensitivities
    Phi_q, size = swinging.constraint_q(0.0, run.q[0]), np.max(np.abs(run.q[-1]))
    for q, v, q_b, v_b in zip(run.q, run.v, b.q_b, b.v_b, strict=True):
        assert np.max(np.abs(swinging.constraint(0.0, q))) < 1e-14 * size
        for x in (v, q_b, v_b):
            assert np.max(np.abs(B.dot(Phi_q, x))) < 1e-13 * np.max(np.abs(x), initial=1.0)


def test_states_move_to_the_nearest_on_constant_constraints():
    # Away from the origin, where Phi is not Phi_q q.
    rod = Beam("a", (0.3, 0.2), (0.8, 0.2), 2, Rectangle(0.05, 0.04), Material(4000, 1e6, 0.3))
    system = assemble(Scene([rod], [Pin(rod.at_start)], (0, -9.81)), ["a.density", "a.height"])
    assert system.traits.constant_constraints
    problem = InitialValueProblem.of(system, 1.0).differentiated()
    first, b = problem.initial, problem.derivative
    rows = stacked(first.q, first.v, b.q_b, b.v_b)
    rows = rows + np.random.default_rng(1).uniform(-1e-2, 1e-2, rows.shape)
    # In the kernel, and in Python.
    for solver in (problem.accelerations, Accelerations(system, problem.matrices)):
        moved = solver.projected(0.0, rows)
        B, Phi_q = system.constraint_pattern, system.constraint_q(0.0, first.q)
        assert np.max(np.abs(system.constraint(0.0, moved[0, 0]))) < 1e-15
        assert np.max(np.abs(B.dot(Phi_q, moved.reshape(6, -1)[1:].T))) < 1e-15
        # M dx + Phi_q^T sigma = 0: no inertia along motions that the constraints allow, up to the
        # round-off of solving with M, whose condition number is 1e4.
        free = scipy.linalg.null_space(B.dense(Phi_q))
        change = system.mass_times(first.q, (moved - rows).reshape(6, -1).T)
        assert np.max(np.abs(free.T @ change)) < 1e-11 * np.max(np.abs(change))
        assert np.max(np.abs(moved - rows)) > 1e-4


def test_which_constraints_are_constant():
    rod = Beam("a", (0, 0), (0.5, 0), 1, Rectangle(0.05, 0.04), Material(4000, 1e6, 0.3))
    base, drive = (
        Pin(rod.at_start, name="base"),
        RotationDriver(rod.at_start, Harmonic(0.5, 4.0), name="m"),
    )
    for joints, design, constant in (
        ([base], ["a.height"], True),
        ([base], ["base.point_y"], False),
        ([base, drive], ["a.height"], False),
    ):
        system = assemble(Scene([rod], joints, (0, -9.81), project_start=True), design)
        assert system.traits.linear_constraints
        assert system.traits.constant_constraints == constant
        assert system.scleronomic == (drive not in joints)


class Led(Bob):
    """A pendulum whose point of suspension moves."""

    def position_constraint(self, t, q):
        x = q[0] - 0.1 * np.sin(3 * t) ** 2
        return np.array([x * x + q[1] * q[1] - 1])


@pytest.mark.parametrize(("kind", "scleronomic", "few"), [(Bob, True, True), (Led, False, False)])
def test_runs_of_driven_formulas_report_more_times_for_gradients(kind, scleronomic, few):
    # A driven motion is checked from one reported time to the next.
    system, explicit = kind([9.81]), DOP853(1e-6)
    assert system.scleronomic == scleronomic
    assert (explicit.at_end(system, 1.0) != explicit) == few
