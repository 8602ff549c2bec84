"""Steps of finite length that would pass over a pole of the equations end the run before it."""

from dataclasses import dataclass

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    HHT,
    IDA,
    Adjoint,
    DirectDifferentiation,
    InitialVelocity,
    Radau,
    RigidBody,
    Scene,
    Terminal,
    gradient,
    simulate,
)
from ancfdae.errors import UnfinishedRunError
from ancfdae.extend import LAW_FIELD, FormulaSystem, Load, MaterialPoint, Quantity, positive
from ancfdae.integrators.poles import passed_pole
from ancfdae.integrators.recorder import Rows
from ancfdae.numerics.operations import Operations, Traced
from ancfdae.observables import custom
from ancfdae.results import Verdict

FIXED = [HHT(0.01), HHT(0.1), HHT(0.02, hht_alpha=-0.05), Radau(0.01), Radau(0.1)]


class Particle(FormulaSystem):
    """A particle of mass one, with the force of a function of k, t, q and v."""

    n_lam, design_names = 0, ("k",)

    def __init__(self, force, q, v=None, b=(1.0,)):
        self.law, self.place, self.n_q = force, np.array(q, dtype=float), len(q)
        self.rate = np.zeros(self.n_q) if v is None else np.array(v, dtype=float)
        super().__init__(b)

    def with_values(self, b):
        return Particle(self.law, self.place, self.rate, b)

    def start(self):
        return self.place, self.rate

    def mass_matrix(self, q):
        return np.eye(self.n_q)

    def force(self, t, q, v):
        return self.law(self.b[0], t, q, v)

    def position_constraint(self, t, q):
        return np.zeros(0)


# Forces with the time at which an exact motion reaches the pole; energy integrals.
POLES = {
    # From rest at 1: t = integral of dq / sqrt(2 (1/q - 1)) = pi / sqrt(8).
    "attraction": (lambda k, t, q, v: -k / q**2, [1.0], None, np.pi / np.sqrt(8)),
    # v^2 / 2 = log(1.5 / (1.5 - x)): t = 1.5 sqrt(pi / 2).
    "end of a line": (lambda k, t, q, v: k / (1.5 - q), [0.0], None, 1.5 * np.sqrt(np.pi / 2)),
    "logarithm": (lambda k, t, q, v: -k / q, [1.0], None, np.sqrt(np.pi / 2)),
    # q^2 = 1 - t^2.
    "cube": (lambda k, t, q, v: -(q**-3), [1.0], None, 1.0),
    "time": (lambda k, t, q, v: k / (1.003 - t) + 0 * q, [0.0], None, 1.003),
    # In the plane the divisor |q|^3 has a minimum and no change of sign.
    "thrown at a centre": (
        lambda k, t, q, v: k * 1e-3 * q / (q @ q) ** 1.5,
        [0.6, 0.8],
        [-3.0, -4.0],
        0.2,
    ),
    "tangent": (lambda k, t, q, v: np.tan(q) - 1.6, [0.0], [5.0], 0.36),
}


@pytest.mark.parametrize("integrator", FIXED, ids=repr)
@pytest.mark.parametrize("name", POLES)
def test_no_run_of_a_system_ends_beyond_a_pole(name, integrator):
    force, q, v, end = POLES[name]
    system = Particle(force, q, v)
    run = integrator.integrate(system, 3.0)
    # A repulsive centre may turn the particle back.
    assert not run.outcome.success or np.all(run.q @ q > 0)
    # Coarse runs reach the place of the pole early or late by the error of one of their steps.
    assert run.outcome.success or run.t[-1] <= end + integrator.steps.step
    assert np.all(system.divisors(run.t, run.q, run.v)["force"] > 0)
    if run.outcome.verdict is Verdict.POLE:
        assert "a divisor in force vanishes" in run.outcome.advice


def test_the_place_of_a_pole_is_found():
    """q = 1 - t in one step, at 1/q: the zero at t = 1 is found to round-off."""
    system = Particle(lambda k, t, q, v: k / q, [1.0], [-1.0])
    t = np.array([0.0, 0.7, 1.7, 2.0])
    rows = Rows(t, 1 - t[:, None], -np.ones((4, 1)))
    first, words = passed_pole(system, rows)
    assert first == 1
    assert "from t = 0.7 to 1.7" in words
    assert "at about t = 1;" in words


def straight(force):
    """Return the pole found in a step from q = 1 to q = -2 at constant speed, or None."""
    rows = Rows(np.array([0.0, 1.0]), np.array([[1.0], [-2.0]]), np.full((2, 1), -3.0))
    return passed_pole(Particle(force, [1.0]), rows)


def test_a_pole_counts_that_is_infinite_on_one_side_only():
    assert straight(lambda k, t, q, v: positive(q) / q**3) is not None
    assert straight(lambda k, t, q, v: positive(-q) / q**3) is not None
    assert straight(lambda k, t, q, v: positive(q) / q) is None


def test_a_narrow_peak_is_no_pole():
    """1/(q^2 + c^2) with c = 3e-6 is finite, though no step resolves it."""
    assert straight(lambda k, t, q, v: 1 / (q**2 + 1e-11)) is None
    assert straight(lambda k, t, q, v: 1 / q**2) is not None


def test_a_step_that_crosses_a_pole_and_returns_passes_over_it():
    """q falls from 1 to -1/2 and rises again within the step: only its middle shows it."""
    system = Particle(lambda k, t, q, v: 1 / q, [1.0])
    rows = Rows(np.array([0.0, 1.0]), np.ones((2, 1)), np.array([[-6.0], [6.0]]))
    assert passed_pole(system, rows) is not None
    assert passed_pole(system, Rows(rows.t, rows.q, -rows.v)) is None


# Formulas that are finite on the way although a divisor vanishes or becomes small.
FINITE = {
    "sin(q)/q": lambda k, t, q, v: -10 * np.sin(q) / q,
    "(1 - cos q)/q": lambda k, t, q, v: -10 * (1 - np.cos(q)) / q - q,
    # A pole of order 1/2: energy 2 sqrt|q| is finite, and the motion crosses q = 0.
    "order one half": lambda k, t, q, v: -q / (q * q) ** 0.75,
    "friction": lambda k, t, q, v: -20 * q - 0.3 * v / np.sqrt(v * v + 1e-6),
    "smoothed": lambda k, t, q, v: -q / (q * q + 1e-2) ** 1.5,
    "constants": lambda k, t, q, v: -10 * q / (k - 3.0) ** 2,
}


@pytest.mark.parametrize(
    "integrator", [HHT(0.013), HHT(rtol=1e-5), IDA(1e-5), DOP853(1e-6)], ids=repr
)
@pytest.mark.parametrize("name", FINITE)
def test_formulas_that_stay_finite_are_passed(name, integrator):
    run = integrator.integrate(Particle(FINITE[name], [1.0]), 3.0)
    assert run.outcome.success, run.outcome
    assert np.min(run.q) < 0


@pytest.mark.parametrize("closest", [1e-4, 1e-2, 0.3])
def test_a_comet_passes_its_sun(closest):
    """Orbits of |q|^-2 that turn around the pole within a few steps pass no pole."""
    v = np.sqrt(2 * closest / (1 + closest))  # Apsides at 1 and `closest`.
    system = Particle(lambda k, t, q, v: -k * q / (q @ q) ** 1.5, [1.0, 0.0], [0.0, v])
    t = np.linspace(0.0, 6.0, 40)
    run = DOP853(1e-9).integrate(system, 6.0)
    assert run.outcome.success
    # Output far apart: chords pass near the sun, where the motion did not.
    assert passed_pole(system, Rows(t, run.at(t).q, run.at(t).v)) is None


def test_half_a_turn_between_two_states_passes_no_pole():
    """The chord of half a circle leads through the centre; the cubic does not."""
    system = Particle(lambda k, t, q, v: -k * q / (q @ q) ** 1.5, [1.0, 0.0], [0.0, 1.0])
    t = np.pi * np.arange(8.0)
    circle = np.stack([np.cos(t), np.sin(t)], axis=1)
    assert passed_pole(system, Rows(t, circle, np.stack([-circle[:, 1], circle[:, 0]], 1))) is None


@dataclass(frozen=True)
class Pull(Load):
    """F = -1e-4 e / |e|^3, e from the origin to the point."""

    point: MaterialPoint
    kind = "pull"
    design_fields = (LAW_FIELD,)

    def vectors(self, elements):
        return ((self.point, Quantity.POSITION),)

    def force(self, U, V, p, U_o):
        return -1e-4 * U / (U * U).sum(axis=-1, keepdims=True) ** 1.5


def falling(speed, aside=0.0):
    ball = RigidBody("ball", (1.0, aside), mass=1.0, inertia=1.0)
    start = [InitialVelocity("ball", 0.0, ball.position, (-speed, 0.0))]
    pull = Pull(ball.at(0.0, 0.0), name="sun")
    return Scene(bodies=[ball], loads=[pull], start=start), ball


@pytest.mark.parametrize("integrator", [HHT(0.01), HHT(0.05), Radau(0.02), Radau(0.1)], ids=repr)
def test_no_run_of_a_scene_ends_beyond_a_pole(integrator):
    scene, ball = falling(4.0)
    run = simulate(scene, 1.0, integrator)
    wanted = Verdict.POLE if isinstance(integrator, Radau) else Verdict.NO_CONVERGENCE
    # Newton's method of HHT finds no solution beyond the pole.
    assert run.outcome.verdict is wanted
    if isinstance(integrator, Radau):
        assert "a divisor in load 'sun' vanishes" in run.outcome.advice
    assert np.min(run.position(ball.at(0.0, 0.0))[:, 0]) > 0
    # Its speed is 4 until the last steps.
    assert run.t[-1] == pytest.approx(0.25, abs=1.01 * integrator.steps.step)


def test_a_scene_whose_load_is_passed_beside_its_pole_runs_on():
    scene, ball = falling(4.0, 0.02)
    run = simulate(scene, 1.0, HHT(0.01))
    assert run.outcome.success
    assert run.position(ball.at(0.0, 0.0))[-1, 0] < 0


def test_gradients_of_runs_over_poles_are_refused():
    system = Particle(POLES["logarithm"][0], [1.0])
    end = Terminal(custom(lambda t, q, v, lam, b: q[:, 0]))
    for method in (DirectDifferentiation(), Adjoint(), Adjoint(memory="1 MB")):
        with pytest.raises(UnfinishedRunError, match="pole"):
            gradient(system, end, 3.0, HHT(0.1), method=method)


def numbers_of(formula, n=3):
    """Divisors of a formula of n inputs, as functions of the inputs."""
    operations = Operations(n)
    x = Traced.array(operations, np.arange(n))
    outputs = Traced.numbers(operations, [formula(*x)])
    found = operations.divisors(outputs)
    return operations.compiled(found, np.arange(n)).values


@pytest.mark.parametrize(
    ("formula", "divisors"),
    [
        (lambda x, y, z: x / y, lambda x, y, z: [y]),
        (lambda x, y, z: x / (y * z), lambda x, y, z: [y, z]),
        (lambda x, y, z: x / (y - z) ** 3, lambda x, y, z: [y - z]),
        (lambda x, y, z: x / np.sqrt(y**2 * (x + z)), lambda x, y, z: [y, x + z]),
        (lambda x, y, z: (x + y) ** -1.5, lambda x, y, z: [x + y]),
        (lambda x, y, z: (x + y) ** 1.5, lambda x, y, z: []),
        (lambda x, y, z: np.tan(x * y), lambda x, y, z: [np.cos(x * y)]),
        (lambda x, y, z: x / (y / z), lambda x, y, z: [y, z]),
        (lambda x, y, z: x / (3.0 * np.exp(y)) + 1 / np.cosh(z), lambda x, y, z: []),
        (lambda x, y, z: np.reciprocal(-z), lambda x, y, z: [z]),
        (lambda x, y, z: x * y / 2.0 + z, lambda x, y, z: []),
    ],
)
def test_divisors_are_factors_that_can_vanish(formula, divisors):
    at = np.array([0.7, 1.3, -0.4])
    found = numbers_of(formula)(at)
    assert sorted(found.tolist()) == pytest.approx(sorted(divisors(*at)))


@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("place", [1.505393, 1.53, 1.55, 1.58])
def test_error_control_ends_at_a_pole_that_its_shortest_steps_reach(place, rtol):
    """x'' = k/(c - x): steps shrink to the last digits of x beside c, which x meets at a speed."""
    system = Particle(lambda k, t, q, v: [1e-3 * k / (place - q[0])], [0.0], [1.0])
    run = simulate(system, 3.0, Radau(rtol=rtol))
    # Where the pole itself is not met, no step passes the error test.
    assert run.outcome.verdict in (Verdict.POLE, Verdict.ERROR_TEST)
    assert run.t[-1] == pytest.approx(place - 0.0015, abs=1e-3)


@pytest.mark.parametrize("integrator", [HHT(0.01), Radau(0.05), Radau(rtol=1e-6), DOP853(1e-7)])
@pytest.mark.parametrize("place", [0.53, 1.53, 101.53])
def test_a_numerator_that_vanishes_with_its_slope_is_no_pole(place, integrator):
    """(1 - cos y)/y^2 = 1/2 - y^2/24 ...: y = q - c has the round-off of q and c."""

    def force(k, t, q, v):
        return [k * (1 - np.cos(q[0] - place)) / (q[0] - place) ** 2]

    system = Particle(force, [place - 0.53], [1.0])
    assert simulate(system, 1.0, integrator).outcome.success
