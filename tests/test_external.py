"""External problems: the hand-written partials are right and the published numbers come out."""

import importlib.util

import numpy as np
import pytest

from ancfdae import (
    HHT,
    IDA,
    IDAS,
    Adjoint,
    ComplexStep,
    ContinuousAdjoint,
    Direct,
    Explicit,
    FiniteDifference,
    differentiate,
    gradient,
    simulate,
)
from validation.external import published
from validation.external.rods import Rods, cartesian_pendulum, double_four_bar, four_bar_minimal
from validation.external.slider_crank import SliderCrank, kinetic_energy_integral

STEP = 1e-30  # complex step: its square vanishes against one
SYSTEMS = {
    "slider-crank": SliderCrank((1.3, 0.7)),
    "pendulum": cartesian_pendulum((1.2, 9.0)),
    "four-bar": double_four_bar((1.2, 9.0)),
}
needs_idas = pytest.mark.skipif(
    importlib.util.find_spec("sundials4py") is None, reason="sundials4py is not installed"
)


@pytest.fixture(params=SYSTEMS)
def system(request):
    return SYSTEMS[request.param]


class State:
    """A random state with random derivatives; nothing satisfies the constraints."""

    def __init__(self, system):
        rng = np.random.default_rng(11)

        def draw(*shape):
            return rng.uniform(0.3, 1.2, shape) * rng.choice([-1.0, 1.0], shape)

        n_q, n_lam, n_b = system.n_q, system.n_lam, system.n_b
        self.q, self.v, self.a, self.x = draw(n_q), draw(n_q), draw(n_q), draw(n_q)
        self.lam = draw(n_lam)
        self.q_b, self.v_b, self.a_b = draw(n_q, n_b), draw(n_q, n_b), draw(n_q, n_b)
        self.lam_b = draw(n_lam, n_b)
        self.jerk = draw(n_q)


def in_vector(function, x):
    """Partials of function in a vector by complex steps, along a last axis."""
    columns = [np.imag(function(x + 1j * STEP * unit)) / STEP for unit in np.eye(len(x))]
    return np.stack(columns, axis=-1)


def in_design(system, function):
    """Total derivatives of function(system, moved) where moved(x, x_b) follows the design."""
    columns = []
    for i, unit in enumerate(np.eye(system.n_b)):
        other = system.with_values(system.b + 1j * STEP * unit)
        value = function(other, lambda x, x_b, i=i: x + 1j * STEP * x_b[:, i])
        columns.append(np.imag(value) / STEP * np.ones(np.shape(value)))
    return np.stack(columns, axis=-1)


def along(function, s):
    """Rate of function(q, v, a) along q' = v, v' = a, a' = jerk."""
    moved = (s.q + 1j * STEP * s.v, s.v + 1j * STEP * s.a, s.a + 1j * STEP * s.jerk)
    return np.imag(function(*moved)) / STEP


def pairs(system):
    """Every hand-written derivative and the same by complex steps, by name."""
    s, t = State(system), 0.0
    dense = system.constraint_pattern.dense
    square = system.pattern.dense
    q, v, a, lam, x = s.q, s.v, s.a, s.lam, s.x
    zero = np.zeros_like(s.q_b)

    def total(function):
        return in_design(system, function)

    yield "force_q", square(system.force_q(q, v, t)), in_vector(lambda q: system.force(q, v, t), q)
    yield "force_v", square(system.force_v(q, v, t)), in_vector(lambda v: system.force(q, v, t), v)
    yield "force_b", system.force_b(q, v, t), total(lambda other, _: other.force(q, v, t))
    rate = along(lambda q, v, a: system.force(q, v, t), s)
    yield "force_rate", system.force_rate(q, v, a, t), rate
    yield (
        "force_rate_total",
        system.force_rate_total(q, v, a, t, s.q_b, s.v_b, s.a_b),
        total(lambda o, m: o.force_rate(m(q, s.q_b), m(v, s.v_b), m(a, s.a_b), t)),
    )
    Phi_q = dense(system.constraint_q(q, t))
    yield "constraint_q", Phi_q, in_vector(lambda q: system.constraint(q, t), q)
    yield "constraint_b", system.constraint_b(q, t), total(lambda o, _: o.constraint(q, t))
    yield "constraint_force", system.constraint_force(q, lam, t), Phi_q.T @ lam
    K = in_vector(lambda q: system.constraint_force(q, lam, t), q)
    yield "constraint_force_q", square(system.constraint_force_q(q, lam, t)), K
    by_design = total(lambda o, _: o.constraint_force(q, lam, t))
    yield "constraint_force_b", system.constraint_force_b(q, lam, t), by_design
    yield (
        "constraint_q_times_total",
        system.constraint_q_times_total(q, x, t, s.q_b),
        total(lambda o, m: dense(o.constraint_q(m(q, s.q_b), t)) @ x),
    )
    first = along(lambda q, v, a: system.constraint_q(q, t), s)
    yield "constraint_q_rate", system.constraint_q_rate(q, v, t), first
    second = along(lambda q, v, a: system.constraint_q_rate(q, v, t), s)
    yield "constraint_q_second_rate", system.constraint_q_second_rate(q, v, a, t), second
    gamma = system.acceleration_side(q, v, t)
    yield "acceleration_side", gamma, -dense(system.constraint_q_rate(q, v, t)) @ v
    yield (
        "acceleration_side_total",
        system.acceleration_side_total(q, v, t, s.q_b, s.v_b),
        total(lambda o, m: o.acceleration_side(m(q, s.q_b), m(v, s.v_b), t)),
    )
    gamma_t = along(lambda q, v, a: system.acceleration_side(q, v, t), s)
    S = gamma_t - dense(system.constraint_q_rate(q, v, t)) @ a
    yield "jerk_side", system.jerk_side(q, v, a, t), S
    yield (
        "jerk_side_total",
        system.jerk_side_total(q, v, a, t, s.q_b, s.v_b, s.a_b),
        total(lambda o, m: o.jerk_side(m(q, s.q_b), m(v, s.v_b), m(a, s.a_b), t)),
    )
    turning = along(lambda q, v, a: system.constraint_force(q, lam, t), s)
    yield "constraint_force_rate", system.constraint_force_rate(q, v, lam, t), turning
    yield (
        "constraint_force_rate_total",
        system.constraint_force_rate_total(q, v, lam, t, s.q_b, s.v_b, s.lam_b),
        total(
            lambda o, m: o.constraint_force_rate(m(q, s.q_b), m(v, s.v_b), m(lam, s.lam_b), t)
        ),
    )
    for k, name in enumerate(("start_q_b", "start_v_b")):
        yield name, system.start_b()[k], total(lambda o, _, k=k: o.start()[k])
    mass = np.stack([system.mass_times(q, unit) for unit in np.eye(system.n_q)], axis=1)
    yield "mass", square(system.mass(q)), mass
    yield "mass_b_times", system.mass_b_times(q, a), zero


NAMES = [name for name, _, _ in pairs(SYSTEMS["pendulum"])]


@pytest.mark.parametrize("name", NAMES)
def test_partials_of_the_external_systems(system, name):
    (_, mine, other), = [pair for pair in pairs(system) if pair[0] == name]
    assert mine.shape == other.shape
    # A dozen roundings of terms that may exceed the result tenfold.
    assert np.max(np.abs(mine - other), initial=0.0) <= 1e-13 * max(1.0, np.max(np.abs(other)))
