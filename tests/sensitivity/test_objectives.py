"""Objectives: quadrature, smooth maximum, partials, and errors that name an instant.

Partials are compared with a complex step of `value` entry by entry, to round-off (EXACT, relative
to the largest partial of the group).
"""

import dataclasses

import numpy as np
import pytest

from ancfdae import Beam, Clamp, CriticalValue, Material, Pin, PointForce, Scene, assemble
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.sections import Rectangle
from ancfdae.sensitivity.objectives import (
    AtTimes,
    Integral,
    NonFiniteObjectiveError,
    Objective,
    SmoothMaximum,
    SmoothUpperBound,
    Terminal,
)
from ancfdae.sensitivity.observables.observable import States
from ancfdae.sensitivity.observables.points import deflection, position, slope_angle, velocity
from ancfdae.sensitivity.observables.quantities import (
    design_value,
    elapsed_time,
    kinetic_energy,
    reaction,
    strain_energy,
)
from ancfdae.sensitivity.observables.user_functions import apply, custom
from tests.support.mechanisms import CartesianPendulum

EXACT = 1e-12
EPS = 1e-40
ROD = Beam(
    "rod",
    (0.0, 0.0),
    (1.2, 0.3),
    2,
    Rectangle(height=0.06, width=0.04),
    Material(density=1100.0, youngs_modulus=1e6, poisson_ratio=0.3),
)
X, V = position(ROD.at(0.7), 0), velocity(ROD.at(0.7), 1)


@pytest.fixture(scope="module")
def system():
    scene = Scene([ROD], [Pin(ROD.at_start, name="pin")], (0.0, -9.81))
    return assemble(scene, ["rod.length", "rod.youngs_modulus", "rod.height"])


def states_at(system, t, seed=3):
    random = np.random.default_rng(seed)
    start, _ = system.start()
    return States(
        np.asarray(t),
        start + 0.05 * random.standard_normal((len(t), system.n_q)),
        random.standard_normal((len(t), system.n_q)),
        10.0 * random.standard_normal((len(t), system.n_lam)),
    )


@pytest.fixture(scope="module")
def states(system):
    return states_at(system, [0.0, 0.1, 0.25, 0.3, 0.5])


def work(t, q, v, lam, b):
    return t * q[:, 2] * v[:, 1] + lam[:, 0] * b[0] + np.cos(q[:, 4]) * b[2]


COLUMN = dataclasses.replace(ROD, start=(0.0, 0.0), end=(1.2, 0.0))
LOAD = PointForce(COLUMN.at_end, (0.0, 0.0), name="load")
BUCKLING = CriticalValue(
    Scene([COLUMN], [Clamp(COLUMN.at_start)], loads=[LOAD]),
    "load.force_x",
    -2.0,
    ["rod.length", "rod.height"],
)

OBJECTIVES = {
    "integral": Integral(X),
    "integral of everything": Integral(
        X * V * reaction("pin", 1) + elapsed_time() * design_value("rod.height")
    ),
    "integral of energies": Integral(strain_energy() - kinetic_energy()),
    "integral of a custom function": Integral(custom(work, "work")),
    "terminal": Terminal(X**2 * V),
    "terminal angle": Terminal(slope_angle(ROD.at_end)),
    "at an instant": AtTimes(X * V, 0.25),
    "between instants": AtTimes(np.sin(X) * V, [0.05, 0.4, 0.41, 0.5]),
    "smooth maximum": SmoothMaximum(deflection(ROD.at_end, ROD.at_start), 30.0),
    "smooth minimum": -SmoothMaximum(-X * V, 2.0),
    "upper maximum": SmoothUpperBound(deflection(ROD.at_end, ROD.at_start), 30.0),
    "ratio": Integral(X) / Integral(1.0 + V**2),
    "product in the same coordinates": Integral(X) * Terminal(X * V) - AtTimes(V, 0.1),
    "function of objectives": np.sqrt(1.0 + Terminal(X) ** 2) * np.exp(-Integral(V)) + 3.0,
    "shared": (Integral(X) - 2.0) * (Integral(X) - 2.0),
    "critical value": BUCKLING,
    "own function": np.log(2.0 + Integral(apply(lambda x, y: x / (2 + y * y), X, V)) ** 2),
}


def test_every_kind_of_objective_is_under_test():
    def below(kind):
        return {kind}.union(*(below(child) for child in kind.__subclasses__()))

    kinds = {kind for kind in below(Objective) if not kind.__abstractmethods__}
    ours = {kind for kind in kinds if kind.__module__.startswith("ancfdae.")}
    assert ours == {type(objective) for objective in OBJECTIVES.values()}


def assert_close(value, expected):
    if value is None:
        assert not np.any(expected)
        return
    assert value.shape == expected.shape
    assert np.max(np.abs(value - expected)) <= EXACT * np.max(np.abs(expected))


@pytest.mark.parametrize("name", OBJECTIVES)
def test_partials_are_those_of_the_value(system, states, name):
    objective = OBJECTIVES[name]
    objective.check(system, float(states.t[-1]))
    partials = objective.partials(system, states)
    assert isinstance(partials.value, float)
    assert partials.value == objective.value(system, states)
    for group in ("q", "v", "lam"):
        expected = np.zeros(getattr(states, group).shape)
        for entry in np.ndindex(expected.shape):
            moved = getattr(states, group).astype(complex)
            moved[entry] += 1j * EPS
            value = objective.value(system, dataclasses.replace(states, **{group: moved}))
            expected[entry] = np.imag(value) / EPS
        assert_close(getattr(partials, group), expected)
    expected = np.zeros(system.n_b)
    for i in range(system.n_b):
        b = system.b.astype(complex)
        b[i] *= 1 + 1j * EPS
        expected[i] = np.imag(objective.value(system.with_values(b), states)) / EPS
    assert_close(partials.b * system.b, expected)


@pytest.mark.parametrize("name", OBJECTIVES)
def test_partials_agree_with_central_differences(system, states, name):
    objective, random = OBJECTIVES[name], np.random.default_rng(11)
    partials = objective.partials(system, states)
    db = system.b * np.array([1.0, -0.4, 0.7])
    change = {
        group: random.standard_normal(getattr(states, group).shape) for group in ("q", "v", "lam")
    }
    terms = [partials.b * db]
    for group, direction in change.items():
        if getattr(partials, group) is not None:
            terms.append((getattr(partials, group) * direction).ravel())
    terms = np.concatenate(terms)

    def at(s):
        moved = {group: getattr(states, group) + s * change[group] for group in change}
        return objective.value(
            system.with_values(system.b + s * db), dataclasses.replace(states, **moved)
        )

    s = 1e-4
    difference = (8 * (at(s) - at(-s)) - (at(2 * s) - at(-2 * s))) / (12 * s)
    # s^4 / 30 times fifth derivatives, some thousands for elastic energies and sharpness 30.
    scale = np.sum(np.abs(terms)) + abs(partials.value)
    assert abs(difference - np.sum(terms)) <= 1e-8 * scale


def test_arithmetic_is_that_of_numbers(system, states):
    for function in (
        lambda x, y: 2.0 ** (x / 3.0) - 1.0 / (y + 4.0),
        lambda x, y: np.exp(-x) * (x - y) ** 2 / (3.0 - y),
    ):
        value = function(Integral(X), Terminal(V)).value(system, states)
        expected = function(Integral(X).value(system, states), Terminal(V).value(system, states))
        assert np.isclose(value, expected, rtol=1e-14)


def test_a_custom_function_serves_systems_without_names():
    system = CartesianPendulum()
    states = states_at(system, [0.0, 0.2, 0.3])
    objective = Integral(custom(lambda t, q, v, lam, b: q[:, 0] * v[:, 1] + b[1] * lam[:, 0], "p"))
    objective.check(system, 1.0)
    partials = objective.partials(system, states)
    w = np.array([0.1, 0.15, 0.05])
    value = w @ (states.q[:, 0] * states.v[:, 1] + 9.81 * states.lam[:, 0])
    assert np.isclose(partials.value, value, rtol=1e-14)
    assert np.allclose(partials.q[:, 0], w * states.v[:, 1], rtol=1e-14, atol=0)
    assert np.allclose(partials.v[:, 1], w * states.q[:, 0], rtol=1e-14, atol=0)
    assert np.allclose(partials.lam[:, 0], 9.81 * w, rtol=1e-14, atol=0)
    assert np.allclose(partials.b, [0.0, w @ states.lam[:, 0]], rtol=1e-14, atol=0)
    assert not np.any(partials.q[:, 1])


# ---------------------------------------------------------------- quadrature and interpolation


def instants(n, end=2.0):
    """Unequal instants whose spacing varies smoothly."""
    s = np.linspace(0.0, 1.0, n + 1)
    return end * (s + 0.1 * np.sin(2 * np.pi * s))


def test_integral_is_of_second_order_on_unequal_instants(system):
    objective, t = Integral(np.exp(elapsed_time()) * np.sin(3 * elapsed_time())), 2.0
    exact = (np.exp(t) * (np.sin(3 * t) - 3 * np.cos(3 * t)) + 3.0) / 10.0
    errors = [
        abs(objective.value(system, states_at(system, instants(n))) - exact) for n in (50, 100, 200)
    ]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(np.abs(orders - 2.0) < 0.02)


def test_integral_is_exact_for_linear_observables(system, states):
    assert np.isclose(Integral(1.0 + 2.0 * elapsed_time()).value(system, states), 0.75, rtol=1e-15)


def test_interpolation_between_instants_is_of_fourth_order(system):
    objective, exact = AtTimes(np.sin(3 * elapsed_time()), [0.777, 1.234]), np.sin(3 * 0.777)
    exact += np.sin(3 * 1.234)
    counts = np.array([50, 100, 200, 400, 800])
    errors = [abs(objective.value(system, states_at(system, instants(n))) - exact) for n in counts]
    # The place between the neighbours changes from grid to grid. The polynomial through four is off
    # by x^(4) / 24 times its distances from them, at most 9/16 h^4 of equal steps.
    spacing = 2.0 / counts * (1 + 0.2 * np.pi)
    assert np.all(errors <= 2 * 81 * spacing**4 * 9 / 16 / 24)
    assert max(errors) > 1e-7


def test_values_at_instants_are_taken_as_they_are(system, states):
    x = X.value(system, states)
    assert AtTimes(X, 0.25).value(system, states) == x[2]
    assert AtTimes(X, 0.0).value(system, states) == x[0]
    assert AtTimes(X, 0.5 * (1 + 1e-15)).value(system, states) == x[-1]
    assert AtTimes(X, 0.1 - 1e-15).value(system, states) == x[1]
    assert AtTimes(X, 0.1 + 1e-15).value(system, states) == x[1]
    assert Terminal(X).value(system, states) == x[-1]
    twice = AtTimes(X, [0.25, 0.25, 0.5]).value(system, states)
    assert np.isclose(twice, 2 * x[2] + x[-1], rtol=1e-15)
    middle = AtTimes(X, 0.275).value(system, states)
    through = np.polynomial.Polynomial.fit(states.t[1:5], x[1:5], 3)
    assert np.isclose(middle, through(0.275), rtol=1e-13)


def test_values_beyond_the_end_are_refused(system, states):
    # Round-off of a time passes, a millionth part of the run does not.
    for late in (0.5 * (1 + 1e-6), 0.6):
        with pytest.raises(InvalidInputError, match=r"AtTimes, times: must not exceed 0\.5"):
            AtTimes(X, [0.1, late]).value(system, states)


# ---------------------------------------------------------------- smooth maximum


def test_smooth_maximum_tends_to_the_maximum_from_below(system):
    # x = -t^2 over (-1, 1) shifted: int exp(-k t^2) dt tends to sqrt(pi / k).
    x = 5.0 - (elapsed_time() - 1.0) ** 2
    states = states_at(system, np.linspace(0.0, 2.0, 2001))
    gaps = []
    for k in (10.0, 100.0, 1000.0, 10000.0):
        gap = 5.0 - SmoothMaximum(x, k).value(system, states)
        assert np.isclose(gap, -np.log(np.sqrt(np.pi / k) / 2.0) / k, rtol=1e-5)
        gaps.append(gap)
    assert np.all(np.diff(gaps) < 0)
    assert gaps[-1] > 0


def test_smooth_maximum_of_a_constant_is_the_constant(system, states):
    for k in (1e-3, 1.0, 1e6):
        assert np.isclose(SmoothMaximum(2.0 + 0 * X, k).value(system, states), 2.0, rtol=1e-12)


@pytest.mark.parametrize("sharpness", [1e-6, 1e3, 1e300])
def test_smooth_maximum_never_overflows(system, states, sharpness):
    for scale in (1.0, 1e6, -1e6):
        objective = SmoothMaximum(scale * X, sharpness)
        partials = objective.partials(system, states)
        assert np.isfinite(partials.value)
        assert np.all(np.isfinite(partials.q))
        # Raising the observable everywhere raises the maximum by as much.
        raised = SmoothMaximum(scale * X + 1.0, sharpness).value(system, states)
        assert np.isclose(raised - partials.value, 1.0, rtol=1e-9)


@pytest.mark.parametrize("sharpness", [1.0, 30.0, 1e3, 1e300])
def test_upper_maximum_bounds_every_instant(system, states, sharpness):
    for scale in (1.0, -1e6):
        objective = SmoothUpperBound(scale * X, sharpness)
        values = scale * X.value(system, states)
        found = objective.partials(system, states)
        above = found.value - np.max(values)
        # The largest of n terms is one; all of them together are n at most. Round-off of the value.
        room = 1e-15 * np.abs(np.max(values))
        assert -room <= above <= np.log(len(values)) / sharpness + room
        assert np.isclose(objective.slopes(values, np.ones(len(values))).sum(), 1.0, rtol=1e-12)
        assert np.all(np.isfinite(found.q))


def test_smooth_maximum_of_one_instant_is_its_value(system, states):
    one = states.rows(slice(2, 3))
    assert SmoothMaximum(X, 7.0).value(system, one) == X.value(system, one)[0]


# ---------------------------------------------------------------- errors


def test_a_value_that_is_not_finite_names_its_instant(system, states):
    for objective in (
        Integral(1.0 / (elapsed_time() - 0.25)),
        SmoothMaximum(np.log(0.2 - elapsed_time()) * X, 1.0),
        Integral(np.sqrt(0.2 - elapsed_time())) + Terminal(X),
    ):
        for action in (objective.value, objective.partials):
            with pytest.raises(NonFiniteObjectiveError, match=r"at t = 0\.25") as error:
                action(system, states)
            assert error.value.time == 0.25


def test_complex_states_do_not_hide_a_value_that_is_not_real(system, states):
    moved = dataclasses.replace(states, q=states.q + 0j)
    with pytest.raises(NonFiniteObjectiveError) as error:
        Integral(np.sqrt(X * 0.0 + 0.2 - elapsed_time() + 1e-3)).value(system, moved)
    assert error.value.time == 0.25


def test_a_missing_derivative_names_its_instant(system, states):
    v = states.v.copy()
    v[1] = 0.0
    at_rest = dataclasses.replace(states, v=v)
    speed = np.sqrt(V**2)
    assert np.isfinite(Integral(speed).value(system, at_rest))
    with pytest.raises(NonFiniteObjectiveError, match="derivative") as error:
        Integral(speed).partials(system, at_rest)
    assert error.value.time == states.t[1]
    smooth = Integral(np.sqrt(V**2 + 1e-12)).partials(system, at_rest)
    assert np.all(np.isfinite(smooth.v))


def test_instants_that_do_not_matter_may_be_singular(system, states):
    v = states.v.copy()
    v[0] = 0.0
    at_rest = dataclasses.replace(states, v=v)
    for objective in (Terminal(np.sqrt(V**2)), AtTimes(X / V, 0.4)):
        partials = objective.partials(system, at_rest)
        assert np.all(np.isfinite(partials.v))
        assert not np.any(partials.v[0])


def test_a_function_of_objectives_that_is_not_finite_names_no_instant(system, states):
    for objective in (np.log(-Integral(X)), 1.0 / (Integral(X) - Integral(X))):
        for action in (objective.value, objective.partials):
            with pytest.raises(NonFiniteObjectiveError) as error:
                action(system, states)
            assert error.value.time is None
    with pytest.raises(NonFiniteObjectiveError, match="derivative"):
        np.sqrt(Integral(X) - Integral(X)).partials(system, states)


def test_names_and_times_are_checked_before_a_run(system):
    with pytest.raises(UnknownNameError, match="Known names: pin"):
        (1.0 + Integral(X) * Terminal(reaction("pinn", 0))).check(system, 1.0)
    with pytest.raises(InvalidInputError, match=r"must not exceed 1; got 1\.5"):
        (Integral(X) + AtTimes(X, [0.5, 1.5])).check(system, 1.0)
    AtTimes(X, [0.5, 1.0]).check(system, 1.0)


def test_a_run_that_ended_early_is_refused(system, states):
    with pytest.raises(InvalidInputError, match="The run ends before"):
        AtTimes(X, 0.6).value(system, states)


@pytest.mark.parametrize("times", [[], -0.1, [0.1, np.nan], np.inf])
def test_times_must_be_times(times):
    with pytest.raises(InvalidInputError, match="AtTimes, times"):
        AtTimes(X, times)


@pytest.mark.parametrize("sharpness", [0.0, -1.0, np.nan])
def test_sharpness_must_be_positive(sharpness):
    with pytest.raises(InvalidInputError, match="sharpness"):
        SmoothMaximum(X, sharpness)


def test_observables_and_objectives_do_not_mix():
    for action in (
        lambda: Integral(X) + X,
        lambda: X * Integral(X),
        lambda: np.power(X, Terminal(X)),
    ):
        with pytest.raises(InvalidInputError, match=r"Integral\(observable\)"):
            action()
    for kind in (Integral, Terminal, lambda x: AtTimes(x, 0.1), lambda x: SmoothMaximum(x, 1.0)):
        with pytest.raises(InvalidInputError, match="must be of type Observable"):
            kind(Integral(X))


def test_functions_without_derivative_are_refused():
    with pytest.raises(InvalidInputError, match="absolute"):
        abs(Integral(X))
    with pytest.raises(InvalidInputError, match="maximum"):
        np.maximum(Integral(X), Terminal(X))
    with pytest.raises(InvalidInputError, match="greater"):
        max(Integral(X), Terminal(X))
