"""Observables: values, exact partials, what is refused, and when.

Partials are compared with a complex step of `value` column by column, to round-off (EXACT, relative
to the largest partial), and with central differences in one direction of all arguments at once
(DIFFERENCE: steps of 1e-5 leave 1e-10 of third derivatives and 1e-11 of round-off, both times a
hundred for steep expressions).
"""

import dataclasses
import functools

import numpy as np
import pytest

from ancfdae import (
    BEAM_3D,
    CABLE_3D,
    HHT,
    PID,
    Beam,
    Clamp,
    FollowerForce,
    InitialVelocity,
    Material,
    Pin,
    RotationDriver,
    Scene,
    SpringDamper,
    assemble,
    differentiate,
    simulate,
)
from ancfdae.errors import InvalidInputError, UnknownNameError
from ancfdae.laws import Harmonic
from ancfdae.sections import Rectangle
from ancfdae.sensitivity.observables.expression import _FUNCTIONS, require_vectorised
from ancfdae.sensitivity.observables.mass import (
    MassIntegral,
    angular_momentum,
    centre_of_mass,
    inertia,
    linear_momentum,
    mass,
)
from ancfdae.sensitivity.observables.observable import Leaf, States, observe, states_of
from ancfdae.sensitivity.observables.orientation import orientation, rotation_angle
from ancfdae.sensitivity.observables.points import (
    acceleration,
    angular_velocity,
    axial_strain,
    deflection,
    position,
    slide_distance,
    slope,
    slope_angle,
    velocity,
)
from ancfdae.sensitivity.observables.quantities import (
    design_value,
    driver_torque,
    effort,
    elapsed_time,
    gravitational_energy,
    joint_power,
    kinetic_energy,
    load_power,
    multiplier,
    reaction,
    spring_energy,
    state,
    strain_energy,
)
from ancfdae.sensitivity.observables.sections import (
    axial_force,
    bending_moment,
    maximum_von_mises,
    shear_force,
    von_mises,
)
from ancfdae.sensitivity.observables.user_functions import apply, custom
from tests.support.mechanisms import CartesianPendulum
from validation import scenes

EXACT = 1e-12
DIFFERENCE = 1e-8
EPS = 1e-40
STEP = 1 / 128
SOFT = Material(density=1100.0, youngs_modulus=1e6, poisson_ratio=0.3)
DAMPED = dataclasses.replace(SOFT, damping_time=2e-3)
DESIGN = ["rod.length", "rod.youngs_modulus", "arm.height", "arm.density", "arm.length"]
DESIGN += ["rod.damping_time", "rod.height[1]", "rod.poisson_ratio"]

DRIVEN_DESIGN = [*DESIGN, "motor.frequency", "push.frequency", "spring.free_length"]
DRIVEN_DESIGN += ["servo.derivative", "servo.amplitude"]


def mechanism(dimension, driven=False):
    """A clamped arm carries a swinging rod of two elements; a drive may turn its end."""
    z = (0.0,) * (dimension - 2)
    section = Rectangle(height=0.06, width=0.04)
    arm = Beam("arm", (0.0, 0.0, *z), (0.5, 0.1, *z), 1, section, SOFT)
    rod = Beam("rod", (0.5, 0.1, *z), (1.3, -0.2, *z), 2, section, DAMPED)
    joints = [Clamp(arm.at_start, name="wall"), Pin(arm.at_end, rod.at_start, name="pivot")]
    joints += [RotationDriver(rod.at_end, Harmonic(0.5, 6.0), name="motor")] if driven else []
    spin = 2.0 if dimension == 2 else (0.3, -0.5, 2.0)
    gravity = (0.5, -9.81, 1.0)[:dimension]
    spring = SpringDamper(rod.at(0.6), 30.0, 0.2, 2.0, arm.at(0.5), name="spring")
    push = FollowerForce(
        rod.at(0.8), (1.0, 2.0, 0.5)[:dimension], law=Harmonic(1.0, 3.0), name="push"
    )
    start = [InitialVelocity("rod", spin, (0.5, 0.1, *z))]
    servo = PID(rod.at(0.3), Harmonic(0.4, 5.0), 3.0, 2.0, 0.5, other=arm.at_end, name="servo")
    loads = [spring, push, servo] if driven else []
    return Scene([arm, rod], joints, gravity, start, loads=loads)


ARM, ROD = mechanism(2).beams
INNER = ROD.at(0.7, y=0.01)


def states_around_start(system, count=5, seed=1):
    random, q = np.random.default_rng(seed), system.start()[0]
    # Vectors of states come last, one for each controller here.
    n = len(q) - system.vector_size * len(system.controllers)
    moved, v, lam = (random.standard_normal((count, k)) for k in (n, n, system.n_lam))
    x, x_t = random.standard_normal((2, count, len(q) - n))
    return States(
        np.linspace(0.0, 0.4, count),
        q + 0.05 * np.hstack([moved, x]),
        np.hstack([v, x_t]),
        10.0 * lam,
    )


@pytest.fixture(scope="module", params=[2, 3], ids=["planar", "spatial"])
def system(request):
    return assemble(
        mechanism(request.param, driven=True),
        DRIVEN_DESIGN,
    )


def power(t, q, v, lam, b):
    return np.sin(t) * q[:, 3] ** 2 * v[:, 1] + lam[:, 0] * b[0] + np.exp(q[:, -1]) * b[3] / 1e3


LEAVES = {
    "position": position(ROD.at_end, 1),
    "position between nodes": position(INNER, 0),
    "velocity": velocity(INNER, 1),
    "acceleration": acceleration(INNER, 1),
    "angular velocity": angular_velocity(INNER),
    "energy of springs": spring_energy(),
    "direction": orientation(INNER, (1.0, 0.3, 0.0), 1),
    "angle of rotation": rotation_angle(INNER),
    "angle of rotation against another body": rotation_angle(INNER, other=ARM.at(0.3)),
    "tangent between nodes": slope(INNER, 0, 0),
    "height axis": slope(ROD.at(0.3), 1, 0),
    "axial strain": axial_strain(ROD.at_end),
    "axial strain between nodes": axial_strain(INNER),
    "angle": slope_angle(INNER),
    "axial force": axial_force(ROD.at(0.7)),
    "axial force at a node": axial_force(ROD.at(0.5)),
    "shear force": shear_force(ROD.at(0.7)),
    "shear force without damping": shear_force(ARM.at(0.2)),
    "bending moment": bending_moment(ROD.at_end),
    "bending moment without damping": bending_moment(ARM.at_start),
    "stress": von_mises(INNER),
    "stress without damping": von_mises(ARM.at(0.9, y=-0.02)),
    # So smooth that differences of fourth order see it.
    "maximum stress": maximum_von_mises("rod", 1e-5),
    "maximum stress without damping": maximum_von_mises("arm", 1e-4),
    "mass": mass("rod"),
    "energy of the weight": gravitational_energy(),
    "mass times place": MassIntegral("rod", right=1),
    "mass times places": MassIntegral(None, left=0, right=1),
    "mass times square of a place": MassIntegral("arm", left=1, right=1),
    "mass times velocity": MassIntegral(None, right=0, rate=True),
    "mass times place and velocity": MassIntegral("rod", left=1, right=0, rate=True),
    "multiplier": multiplier("wall", 2),
    "torque of a drive": driver_torque("motor"),
    "power": joint_power("motor"),
    "power of a spring": load_power("spring"),
    "power of a follower": load_power("push"),
    "state": state("servo", "integral"),
    "torque of a controller": effort("servo"),
    "power of a controller": load_power("servo"),
    "strain energy": strain_energy(),
    "strain energy of a beam": strain_energy("rod"),
    "kinetic energy": kinetic_energy(),
    "kinetic energy of a beam": kinetic_energy("arm"),
    "time": elapsed_time(),
    "design": design_value("rod.length"),
    "custom": custom(power, "power"),
}
X, Y, V = position(INNER, 0), position(INNER, 1), velocity(ROD.at_end, 0)
EXPRESSIONS = {
    "sum": X + Y + 2.0,
    "number first": 2.0 - X,
    "scaled": 3 * X / 4,
    "quotient": 1.0 / X - Y / X,
    "product with itself": X * X * X,
    "shared part": (X * Y) * (X * Y) + X,
    "equal leaves built twice": position(INNER, 0) * X,
    "negative": -X + (+Y),
    "square": (X - 0.3) ** 2,
    "power of powers": 2.0 ** (X**1.5),
    "power of two observables": X**Y,
    "functions": np.sin(X) * np.exp(-Y) + np.arctan(V),
    "speed": np.sqrt(V**2 + velocity(ROD.at_end, 1) ** 2),
    "mixed": strain_energy("rod") * kinetic_energy() / (1.0 + elapsed_time())
    + design_value("arm.density") * V,
    "reaction": reaction("pivot", 1),
    "reaction and lengths": reaction("wall", 0) * X * design_value("rod.length"),
    "numpy number": np.float64(2.0) * X + np.array(1.5) - np.int64(1),
    "numpy function of two": np.multiply(X, np.power(X, 3)),
    "own function": apply(lambda x, y: np.log(1 + x * x) * y, X, Y),
    "function of own function": np.tanh(apply(np.cos, X) * V),
    "custom in a function": np.sin(custom(power, "power")) * X,
    "centre of mass": centre_of_mass(1),
    "moment of inertia": inertia(beam="rod"),
    "product of inertia": inertia(0, 1, about=ARM.at_end),
    "angular momentum": angular_momentum(beam="rod") / linear_momentum(0),
    "deflection": deflection(ROD.at_end, ROD.at_start),
    "angle times place": slope_angle(INNER) * Y,
    "angle of a point, in the third quadrant": np.arctan2(-Y - 4.0, -X),
}
ALL = LEAVES | EXPRESSIONS


# ---------------------------------------------------------------- partials


def test_every_kind_of_leaf_is_under_test():
    def below(kind):
        return {kind}.union(*(below(child) for child in kind.__subclasses__()))

    kinds = {kind for kind in below(Leaf) if not kind.__abstractmethods__}
    ours = {kind for kind in kinds if kind.__module__.startswith("ancfdae.")}
    # Scenes with a sliding joint are in tests/model/test_sliding.py.
    ours -= {type(slide_distance("guide"))}
    assert ours == {type(leaf) for observable in LEAVES.values() for leaf in observable.leaves()}


def stepped(system, states, group, column):
    moved = getattr(states, group).astype(complex)
    moved[:, column] += 1j * EPS
    return system, dataclasses.replace(states, **{group: moved})


@functools.cache
def stepped_design(system, i):
    # Relative, for a modulus of 1e6 beside a length of one.
    b = system.b.astype(complex)
    b[i] *= 1 + 1j * EPS
    return system.with_values(b)


@functools.cache
def beside(system, s):
    """The system with all design values moved."""
    return system.with_values(system.b * (1 + s * np.cos(np.arange(system.n_b))))


def assert_partial(partial, expected):
    if partial is None:
        assert not np.any(expected)
        return
    assert partial.shape == expected.shape
    assert np.max(np.abs(partial - expected), initial=0) <= EXACT * np.max(np.abs(expected))


@pytest.mark.parametrize("name", ALL)
def test_partials_are_those_of_the_value(system, name):
    observable, states = ALL[name], states_around_start(system)
    observable.check(system)
    partials = observable.partials(system, states)
    assert np.array_equal(partials.value, observable.value(system, states))
    for group in ("q", "v", "lam"):
        columns = [
            observable.value(*stepped(system, states, group, c)).imag / EPS
            for c in range(getattr(states, group).shape[1])
        ]
        assert_partial(getattr(partials, group), np.stack(columns, axis=1))
    columns = []
    for i in range(system.n_b):
        columns.append(observable.value(stepped_design(system, i), states).imag / EPS)
    assert_partial(partials.b * system.b, np.stack(columns, axis=1))


@pytest.mark.parametrize("name", ALL)
def test_partials_agree_with_central_differences(system, name):
    observable, states = ALL[name], states_around_start(system)
    partials, random = observable.partials(system, states), np.random.default_rng(8)
    change = {
        group: random.standard_normal(getattr(states, group).shape) for group in ("q", "v", "lam")
    }
    db = system.b * np.cos(np.arange(system.n_b))
    expected, size = partials.b @ db, np.abs(partials.b) @ np.abs(db)
    for group, direction in change.items():
        rows = getattr(partials, group)
        if rows is not None:
            expected = expected + np.sum(rows * direction, axis=1)
            size = size + np.sum(np.abs(rows * direction), axis=1)

    def along(s):
        moved = {group: getattr(states, group) + s * change[group] for group in change}
        return observable.value(beside(system, s), dataclasses.replace(states, **moved))

    # Fourth order: elastic energies bend strongly over the size of a slope.
    s = 1e-4
    difference = (8 * (along(s) - along(-s)) - (along(2 * s) - along(-2 * s))) / (12 * s)
    scale = np.max(size) + np.max(np.abs(partials.value))
    assert np.max(np.abs(difference - expected)) <= DIFFERENCE * scale


def test_total_derivative_is_that_of_the_complex_solution():
    scene = mechanism(2)
    solution = differentiate(scene, 8 * STEP, HHT(STEP), design=DESIGN)
    s, system = solution.sensitivities, assemble(scene, DESIGN)
    for name in ("position between nodes", "velocity", "tangent between nodes", "reaction"):
        for observable in (ALL[name], np.sin(ALL[name]) * X, slope_angle(INNER) + ALL[name]):
            p = observable.partials(system, states_of(solution))
            total = p.b
            for part, part_b in ((p.q, s.q_b), (p.v, s.v_b), (p.lam, s.lam_b)):
                if part is not None:
                    total = total + np.einsum("tn,tnb->tb", part, part_b)
            expected = solution.derivative(lambda run, x=observable: observe(x, run))
            assert np.max(np.abs(expected)) > 0
            assert_partial(total * system.b, expected * system.b)


def test_partials_vanish_where_a_weight_of_zero_meets_a_singular_point(system):
    states = states_around_start(system, 3)
    x = velocity(ROD.at_end, 0)
    speed = np.sqrt(x * x)
    v = states.v.copy()
    v[1] = 0.0
    states = dataclasses.replace(states, v=v)
    values = speed.node_values(system, states)
    at_rest = speed.weighted_partials(system, states, values, np.ones(3)).v
    assert np.array_equal(np.all(np.isfinite(at_rest), axis=1), [True, False, True])
    elsewhere = speed.weighted_partials(system, states, values, np.array([1.0, 0.0, 1.0])).v
    assert np.all(np.isfinite(elsewhere))
    assert not np.any(elsewhere[1])
    assert np.any(elsewhere[0])


def test_partials_need_real_states(system):
    states = stepped(system, states_around_start(system), "q", 0)[1]
    with pytest.raises(InvalidInputError, match="real states"):
        strain_energy().partials(system, states)


def test_sums_of_thousands_of_terms_need_no_recursion(system):
    states = states_around_start(system, 2)
    total = sum(X for _ in range(3000)) + sum(Y for _ in range(3000))
    expected = 3000 * (X.value(system, states) + Y.value(system, states))
    assert np.allclose(total.value(system, states), expected, rtol=1e-12, atol=0)
    one = X.partials(system, states).q + Y.partials(system, states).q
    assert np.allclose(total.partials(system, states).q, 3000 * one, rtol=1e-12, atol=0)


# ---------------------------------------------------------------- functions


@pytest.mark.parametrize("ufunc", _FUNCTIONS, ids=lambda ufunc: ufunc.__name__)
def test_slopes_of_functions_agree_with_differences(ufunc):
    function = _FUNCTIONS[ufunc]
    x = np.array([0.07, 0.3, 0.55, 0.93]) + (1.0 if ufunc is np.arccosh else 0.0)
    operands = [x, np.array([0.4, -1.3, 2.0, 3.0])][: ufunc.nin]
    s = 1e-4
    for k in range(ufunc.nin):

        def at(shift, k=k):
            return ufunc(*(y + shift * (j == k) for j, y in enumerate(operands)))

        difference = (8 * (at(s) - at(-s)) - (at(2 * s) - at(-2 * s))) / (12 * s)
        slope = function.slope(operands, k)
        # s^4 / 30 times fifth derivatives: below 1e7 for 1/x at 0.07 and arcsin at 0.93.
        assert np.max(np.abs(slope - difference) / (1 + np.abs(slope))) <= 1e-6


@pytest.mark.parametrize(
    ("ufunc", "operands"),
    [
        (np.sqrt, [-1.0]),
        (np.sqrt, [0.0]),
        (np.log, [-2.0]),
        (np.log2, [-2.0]),
        (np.log10, [-2.0]),
        (np.arcsin, [1.0]),
        (np.arcsin, [1.5]),
        (np.arccos, [-1.0]),
        (np.arccosh, [1.0]),
        (np.arctanh, [1.2]),
        (np.power, [-2.0, 0.5]),
        (np.power, [0.0, 0.5]),
    ],
)
def test_complex_continuations_beyond_the_real_domain_count_as_not_finite(ufunc, operands):
    x = [np.array([value]) for value in operands]
    with np.errstate(all="ignore"):
        assert np.isnan(_FUNCTIONS[ufunc].slope(x, 0))
        x[0] = x[0] + 0j
        assert np.isnan(_FUNCTIONS[ufunc](x))


def test_whole_powers_of_negative_numbers_have_slopes():
    slope = _FUNCTIONS[np.power].slope([np.array([-2.0, 0.0]), np.array(3.0)], 0)
    # At zero the step itself, squared.
    assert np.allclose(slope, [12.0, 0.0], rtol=1e-14, atol=1e-79)


REFUSED = [
    (abs, "sqrt(x**2 + eps**2)"),
    (np.abs, "sqrt(x**2 + eps**2)"),
    (np.sign, "tanh(x / eps)"),
    (np.floor, "no derivative"),
    (np.rint, "no derivative"),
    (np.conjugate, "apply"),
    (np.cbrt, "x**(1 / 3)"),
    (np.isfinite, "tanh"),
    (lambda x: np.maximum(x, 0.0), "SmoothMaximum"),
    (lambda x: np.minimum(1.0, x), "SmoothMaximum"),
    (lambda x: np.clip(x, 0.0, 1.0), "tanh"),
    (lambda x: np.hypot(x, x), "sqrt(x**2 + y**2)"),
    (lambda x: np.heaviside(x, 0.5), "tanh"),
    (lambda x: x // 2, "no derivative"),
    (lambda x: x % 2, "no derivative"),
    (lambda x: x < 1, "tanh"),
    (lambda x: x > 1, "tanh"),
    (lambda x: x >= 1, "tanh"),
    (lambda x: x <= 1, "tanh"),
    (lambda x: max(x, 2 * x), "tanh"),
    (lambda x: x and 1.0, "tanh"),
    (lambda x: np.add(x, 1.0, where=True), "Write the expression out"),
    (lambda x: np.add.outer(x, 1.0), "Write the expression out"),
]


@pytest.mark.parametrize(("action", "repair"), REFUSED)
def test_functions_without_derivative_are_refused_with_a_repair(action, repair):
    with pytest.raises(InvalidInputError) as error:
        action(position(ROD.at_end, 0))
    assert repair in error.value.repair


@pytest.mark.parametrize("operand", [None, "1", True, np.nan, 1j, [1.0], np.ones(2), np.inf])
def test_only_single_finite_numbers_combine(operand):
    for action in (lambda: X + operand, lambda: operand * X, lambda: np.add(operand, X)):
        with pytest.raises(InvalidInputError, match="operand"):
            action()


def conjugated(x):
    return x * np.conj(x)


def scalar_only(x):
    return np.array([float(x)])


@pytest.mark.parametrize(
    ("function", "name"),
    [
        (np.abs, "absolute"),
        (np.real, "real"),
        (lambda x: np.arctan2(x, 1.0), "<lambda>"),
        (conjugated, "conjugated"),
        (lambda x: np.where(x.real > 0, x, x.real), "<lambda>"),
        (lambda x: x - np.mean(x), "<lambda>"),
        (np.cumsum, "cumsum"),
        (scalar_only, "scalar_only"),
        (lambda x: np.sum(x), "<lambda>"),
        (lambda x: x > 0, "<lambda>"),
    ],
)
def test_own_functions_without_complex_derivative_are_refused(function, name):
    with pytest.raises(InvalidInputError) as error:
        apply(function, X)
    assert error.value.where == name


@pytest.mark.parametrize(
    "function", [np.sin, lambda x: np.tanh(1e6 * (x - 0.3)), lambda x: 0 * x, np.sqrt, np.log]
)
def test_own_functions_that_are_steep_flat_or_partly_undefined_are_accepted(function):
    apply(function, X)


def test_own_functions_are_tried_again_where_the_motion_goes(system):
    # Far from the numbers that `apply` tries.
    hidden = apply(lambda x: np.where(x.real > 100.0, x.real, x), X + 200.0)
    with pytest.raises(InvalidInputError, match="complex step"):
        hidden.partials(system, states_around_start(system))


def test_apply_needs_observables():
    for action in (lambda: apply(np.sin), lambda: apply(np.add, X, 1.0)):
        with pytest.raises(InvalidInputError, match=r"apply\((sin|add)\)"):
            action()


@pytest.mark.parametrize(
    "function",
    [
        lambda t, q, v, lam, b: np.abs(q[:, 0] - 10.0),
        lambda t, q, v, lam, b: q,
        lambda t, q, v, lam, b: np.sum(q),
        lambda t, q, v, lam, b: q[:, 0] - np.mean(q[:, 0]),
        lambda t, q, v, lam, b: q[:, 1000],
    ],
)
def test_custom_functions_are_tried_before_a_run(system, function):
    with pytest.raises(InvalidInputError) as error:
        custom(function, "mine").check(system)
    assert error.value.where == "mine"


def test_custom_functions_are_tried_again_where_the_motion_goes(system):
    hidden = custom(lambda t, q, v, lam, b: np.where(t > 0.3, q[:, 0].real, q[:, 0]), "hidden")
    hidden.check(system)
    with pytest.raises(InvalidInputError, match=r"hidden.*complex step"):
        hidden.partials(system, states_around_start(system))


def test_custom_functions_are_tried_near_the_start():
    def near(t, q, v, lam, b):
        return np.where(q[:, 0].real < -0.9, q[:, 0].real, q[:, 0])

    system = CartesianPendulum()
    assert system.start()[0][0] == -1.0
    with pytest.raises(InvalidInputError, match="complex step"):
        custom(near, "near").check(system)


def test_custom_functions_are_tried_where_they_vanish_too():
    def late(t, q, v, lam, b):
        return np.where(t > 0.3, q[:, 0].real, q[:, 0])

    system = CartesianPendulum()
    t = np.linspace(0.0, 1.0, 5)
    nothing = States(t, np.zeros((5, 2)), np.zeros((5, 2)), np.zeros((5, 1)))
    with pytest.raises(InvalidInputError, match=r"late.*complex step"):
        custom(late, "late").partials(system, nothing)


def test_custom_functions_serve_systems_without_names():
    system = CartesianPendulum()
    energy = custom(lambda t, q, v, lam, b: 0.5 * np.sum(v * v, axis=1) + b[1] * q[:, 1], "energy")
    energy.check(system)
    solution = simulate(system, 16 * STEP, HHT(STEP))
    value = observe(energy, solution, system)
    # The method is of second order: 9.81^2 h^2 = 6e-3 at this step.
    assert np.allclose(value, value[0], rtol=0, atol=1e-2)
    partials = energy.partials(system, states_of(solution))
    assert np.allclose(partials.v, solution.v, rtol=1e-14, atol=0)
    assert np.allclose(partials.q, [0.0, 9.81], rtol=1e-14, atol=0)
    assert np.allclose(partials.b[:, 1], solution.q[:, 1], rtol=1e-14, atol=0)
    with pytest.raises(InvalidInputError, match="assembled scene"):
        position(ROD.at_end, 0).check(system)
    with pytest.raises(InvalidInputError, match="assembled scene"):
        strain_energy().check(system)


# ---------------------------------------------------------------- values


@pytest.fixture(scope="module", params=[2, 3], ids=["planar", "spatial"])
def run(request):
    scene = mechanism(request.param)
    solution = simulate(scene, 12 * STEP, HHT(STEP))
    assert solution.outcome.success
    return solution, assemble(scene)


def same(value, expected):
    # Sums of eight products in another order.
    return np.shape(value) == np.shape(expected) and np.allclose(
        value, expected, rtol=1e-14, atol=1e-14 * np.max(np.abs(expected))
    )


def test_vectors_are_those_of_the_solution(run):
    solution, system = run
    d = system.naming.layout.d
    for point in (ARM.at_start, ARM.at_end, ROD.at_end, INNER):
        for axis in range(d):
            expected = solution.position(point)[:, axis]
            assert same(observe(position(point, axis), solution), expected)
            assert same(observe(position(point, axis), solution, system), expected)
            expected = solution.velocity(point)[:, axis]
            assert same(observe(velocity(point, axis), solution), expected)
            for along in range(d):
                expected = solution.slope(point, along)[:, axis]
                assert same(observe(slope(point, along, axis), solution), expected)
        tangent = solution.slope(point)
        expected = 0.5 * (np.sum(tangent**2, axis=1) - 1)
        # A difference of numbers of size one half.
        strain = observe(axial_strain(point), solution, system)
        assert np.allclose(strain, expected, rtol=0, atol=1e-14)


def test_forces_are_those_of_the_solution(run):
    solution, system = run
    for joint in ("wall", "pivot"):
        assert np.any(solution.reaction(joint))
        for axis in range(system.naming.layout.d):
            expected = solution.reaction(joint)[:, axis]
            assert np.array_equal(observe(reaction(joint, axis), solution), expected)
        for row in range(solution.multipliers(joint).shape[1]):
            expected = solution.multipliers(joint)[:, row]
            assert np.array_equal(observe(multiplier(joint, row), solution), expected)


def test_energies_are_those_of_the_system(run):
    solution, system = run
    strain = np.sum(system._elastic.energies(solution.q), axis=1)
    kinetic = np.array([0.5 * v @ system.mass_times(None, v) for v in solution.v])
    assert np.allclose(observe(strain_energy(), solution, system), strain, rtol=1e-12, atol=0)
    assert np.allclose(observe(kinetic_energy(), solution, system), kinetic, rtol=1e-12, atol=0)
    for energy, total in ((strain_energy, strain), (kinetic_energy, kinetic)):
        parts = [observe(energy(beam), solution, system) for beam in ("arm", "rod")]
        assert np.allclose(parts[0] + parts[1], total, rtol=1e-12, atol=0)
        assert all(np.max(part) > 1e-6 * np.max(total) for part in parts)
    rod = solution.naming.layout.beam("rod").first_element
    expected = np.sum(system._elastic.energies(solution.q)[:, rod:], axis=1)
    assert np.allclose(observe(strain_energy("rod"), solution, system), expected, rtol=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_deflection_is_that_of_the_reports(dimension):
    scene = scenes.pendulum(dimension, elements=2)
    solution = simulate(scene, 12 * STEP, HHT(STEP))
    (beam,) = scene.beams
    value = observe(deflection(beam.at_end, beam.at_start), solution)
    expected = scenes.pendulum_deflection(solution)
    assert np.max(np.abs(expected)) > 1e-3
    # Round-off of coordinates of size one.
    assert np.allclose(value, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("turns", [3.2, -2.7])
def test_slope_angle_counts_full_turns(system, turns):
    t = np.linspace(0.0, 1.0, 40)
    start = 0.4
    expected = start + 2 * np.pi * turns * t**2
    # Every slope along the beam is the same multiple of a unit tangent.
    d = system.naming.layout.d
    q = np.zeros((len(t), system.n_q // d, d))
    q[:, 1 :: d + 1, 0] = 1.3 * np.cos(expected)[:, None]
    q[:, 1 :: d + 1, 1] = 1.3 * np.sin(expected)[:, None]
    states = States(t, q.reshape(len(t), -1), q.reshape(len(t), -1), np.zeros((len(t), 0)))
    angle = slope_angle(ROD.at_end)
    assert np.allclose(angle.value(system, states), expected, rtol=1e-14, atol=1e-14)
    # Turning the tangent by s turns the angle by s.
    turned = np.zeros_like(q)
    turned[..., 0], turned[..., 1] = -q[..., 1], q[..., 0]
    change = np.sum(angle.partials(system, states).q * turned.reshape(len(t), -1), axis=1)
    assert np.allclose(change, 1.0, rtol=1e-14, atol=0)


ARITHMETIC = [
    lambda x, y: x + y - 2.0 * x / y,
    lambda x, y: 1.0 - x,
    lambda x, y: 1.0 / x,
    lambda x, y: 1.5 + (-x) - (+y),
    lambda x, y: 2.0**x,
    lambda x, y: x**3 - x**0.5,
    lambda x, y: x**y,
    lambda x, y: np.float64(2.0) ** x - np.int64(3) / y,
    lambda x, y: np.subtract(3.0, np.divide(x, y)),
]


@pytest.mark.parametrize("function", ARITHMETIC)
def test_arithmetic_is_that_of_numbers(system, function):
    states = states_around_start(system)
    expected = function(X.value(system, states), (2 + Y).value(system, states))
    assert same(function(X, 2 + Y).value(system, states), expected)


@pytest.mark.parametrize("ufunc", _FUNCTIONS, ids=lambda ufunc: ufunc.__name__)
def test_functions_are_those_of_numpy(system, ufunc):
    states = states_around_start(system)
    shift = 1.0 if ufunc is np.arccosh else 0.0
    x, y = np.tanh(X) ** 2 + shift, 2 + Y
    values = [x.value(system, states), y.value(system, states)]
    value = ufunc(*[x, y][: ufunc.nin]).value(system, states)
    assert np.array_equal(value, ufunc(*values[: ufunc.nin]))


def test_time_and_design_are_what_they_say(system):
    states = states_around_start(system)
    assert np.array_equal(elapsed_time().value(system, states), states.t)
    value = design_value("rod.youngs_modulus").value(system, states)
    assert np.array_equal(value, np.full(len(states.t), 1e6))
    b = design_value("rod.youngs_modulus").partials(system, states).b
    assert np.array_equal(b, np.tile(np.arange(system.n_b) == 1, (len(states.t), 1)))


# ---------------------------------------------------------------- what does not exist


@pytest.mark.parametrize(
    ("observable", "known"),
    [
        (position(dataclasses.replace(ROD, name="rood").at_end, 0), "arm, rod"),
        (axial_strain(dataclasses.replace(ROD, name="rood").at_end), "arm, rod"),
        (slope_angle(dataclasses.replace(ROD, name="rood").at_end), "arm, rod"),
        (strain_energy("rood"), "arm, rod"),
        (kinetic_energy("rood"), "arm, rod"),
        (reaction("pivott", 0), "motor, pivot, wall"),
        (multiplier("pivott", 0), "motor, pivot, wall"),
        (
            design_value("rod.width"),
            ", ".join(sorted(DRIVEN_DESIGN)),
        ),
        (np.sin(X * reaction("pivott", 0)), "motor, pivot, wall"),
    ],
)
def test_unknown_names_are_refused_before_a_run(system, observable, known):
    with pytest.raises(UnknownNameError) as error:
        observable.check(system)
    assert error.value.repair == f"Known names: {known}."


@pytest.mark.parametrize(
    "observable",
    [
        position(ROD.at_end, 2),
        velocity(ROD.at_end, 2),
        slope(ROD.at_end, 2, 0),
        slope(ROD.at_end, 0, 2),
        reaction("pivot", 2),
        multiplier("pivot", 2),
        1.0 + np.sin(position(ROD.at_end, 2)),
    ],
)
def test_axes_that_a_plane_lacks_are_refused_before_a_run(observable):
    with pytest.raises(InvalidInputError, match="from 0 to 1"):
        observable.check(assemble(mechanism(2)))


@pytest.mark.parametrize("axis", [3, -1, 1.0, True, "x", None])
def test_axes_that_cannot_exist_are_refused_at_once(axis):
    for action in (
        lambda: position(ROD.at_end, axis),
        lambda: velocity(ROD.at_end, axis),
        lambda: slope(ROD.at_end, axis, 0),
        lambda: slope(ROD.at_end, 0, axis),
        lambda: reaction("wall", axis),
    ):
        with pytest.raises(InvalidInputError, match="from 0 to 2"):
            action()


def test_points_must_be_points():
    for action in (lambda: position("rod", 0), lambda: axial_strain(("rod", 1.0))):
        with pytest.raises(InvalidInputError, match="must be of type MaterialPoint"):
            action()


def test_reaction_needs_a_joint_that_holds_a_point(system):
    layout = system.naming.layout
    loose = tuple(dataclasses.replace(joint, holds_position=False) for joint in layout.joints)
    naming = dataclasses.replace(system.naming, layout=dataclasses.replace(layout, joints=loose))
    named = dataclasses.replace(simulate(mechanism(layout.d), STEP, HHT(STEP)), naming=naming)
    with pytest.raises(InvalidInputError, match=r"multiplier\(joint, row\)"):
        observe(reaction("wall", 0), named)
    assert observe(multiplier("wall", 0), named).shape == (2,)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_energy_of_the_weight_is_that_of_its_centre_of_mass(dimension):
    """-m g . r_c and its derivatives, also in gravity, which is a design variable."""
    scene = mechanism(dimension)
    design = ["arm.height", "rod.density", "rod.length", "scene.gravity_y"]
    system, solution = assemble(scene, design), simulate(scene, 12 * STEP, HHT(STEP))
    found = gravitational_energy().partials(system, states_of(solution))
    g = scene.gravity
    at = sum(g[i] * centre_of_mass(i) for i in range(dimension) if g[i])
    exact = (-1.0 * mass() * at).partials(system, states_of(solution))
    assert same(found.value, exact.value)
    assert np.allclose(np.broadcast_to(found.q, exact.q.shape), exact.q, rtol=1e-12, atol=1e-12)
    varied = design.index("scene.gravity_y")
    fall = observe(mass() * centre_of_mass(1), solution, system)
    assert np.allclose(found.b[:, varied], -fall, rtol=1e-12)
    others = [0, 1, 2]
    assert np.allclose(found.b[:, others], exact.b[:, others], rtol=1e-10, atol=1e-12)


def test_a_solution_alone_has_no_energies(run):
    solution, _ = run
    for observable in (strain_energy(), design_value("rod.length"), custom(power, "power")):
        with pytest.raises(InvalidInputError, match="assemble"):
            observe(observable, solution)


def test_a_complex_solution_needs_a_complex_system():
    scene = mechanism(2)
    solution = differentiate(scene, 2 * STEP, HHT(STEP), design=["rod.length"])
    system = assemble(scene, ["rod.length"])
    with pytest.raises(InvalidInputError, match="complex design values"):
        solution.derivative(lambda moved: observe(strain_energy(), moved, system))


# ---------------------------------------------------------------- accelerations and rotation


@pytest.mark.parametrize("dimension", [2, 3])
def test_accelerations_are_those_that_the_run_found(dimension):
    system = assemble(mechanism(dimension))
    solution = simulate(system, 0.25, HHT(STEP))
    for axis in range(dimension):
        found = observe(acceleration(INNER, axis), solution, system)
        known = solution.acceleration(INNER)[:, axis]
        # Newton iterations end at 1e-8 of the accelerations of a step.
        assert np.max(np.abs(found - known)) <= 1e-6 * np.max(np.abs(solution.a))


def test_a_falling_body_is_accelerated_by_gravity_and_a_turning_one_towards_its_centre():
    rod = Beam(
        "rod", (1e3, 0.0, 0.0), (1e3 + 1.0, 0.0, 0.0), 2, Rectangle(0.1, 0.1), SOFT, rigid=True
    )
    spin, mark = (0.0, 0.0, 3.0), rod.at(0.25, y=0.02)
    start = [InitialVelocity("rod", spin, (1e3 + 0.5, 0.0, 0.0))]
    solution = simulate(scene := Scene([rod], [], (0.0, -9.81, 0.0), start), 0.25, HHT(STEP))
    system = assemble(scene)
    centre = rod.at(0.5)
    assert np.allclose(observe(acceleration(centre, 1), solution, system), -9.81, rtol=1e-9)
    for axis in range(2):
        arm = solution.position(mark)[:, axis] - solution.position(centre)[:, axis]
        towards = -9.0 * arm + (0.0, -9.81)[axis]
        assert np.allclose(observe(acceleration(mark, axis), solution, system), towards, atol=1e-3)


@pytest.mark.parametrize("rigid", [True, False])
@pytest.mark.parametrize("element", [BEAM_3D, CABLE_3D])
def test_angular_velocity_is_that_of_the_start(rigid, element):
    spin, tangent = np.array([0.3, -0.5, 2.0]), np.array([2.0, 1.0, -2.0]) / 3
    start = [InitialVelocity("rod", tuple(spin), (0.0, 0.0, 0.0))]
    rod = Beam("rod", (0, 0, 0), tuple(tangent), 2, Rectangle(0.1, 0.1), SOFT, element=element)
    rod = dataclasses.replace(rod, rigid=rigid)
    system = assemble(Scene([rod], start=start))
    states = States(np.zeros(1), *(x[None] for x in system.start()), np.zeros((1, system.n_lam)))
    found = [angular_velocity(rod.at(0.3), k).value(system, states)[0] for k in range(3)]
    known = spin if rigid or element is BEAM_3D else spin - (spin @ tangent) * tangent
    assert np.allclose(found, known, rtol=1e-12)


def test_angular_velocity_of_a_driven_rod_is_the_rate_of_its_law():
    rod = Beam("rod", (0.0, 0.0), (1.0, 0.0), 1, Rectangle(0.1, 0.1), SOFT, rigid=True)
    joints = [Pin(rod.at_start), RotationDriver(rod.at_start, Harmonic(0.5, 6.0))]
    start = [InitialVelocity("rod", 3.0, (0.0, 0.0))]
    solution = simulate(Scene([rod], joints, start=start), 1.0, HHT(1e-3))
    # To the second order of the steps.
    assert np.allclose(
        observe(angular_velocity(rod.at_end), solution), 3.0 * np.cos(6.0 * solution.t), atol=1e-3
    )
    with pytest.raises(InvalidInputError, match=r"must be 2, the z axis, in the plane; got 0"):
        observe(angular_velocity(rod.at_end, 0), solution)
    with pytest.raises(InvalidInputError, match="assembled scene"):
        observe(acceleration(rod.at_end, 0), solution)


@pytest.mark.parametrize(("alone", "last"), [(1.0, np.inf), (1.0, np.nan), (-np.inf, np.inf)])
def test_a_value_that_depends_on_other_instants_is_refused_where_it_is_not_finite(alone, last):
    """A function of several times that has another value for one of them alone is refused."""
    values = np.array([1.0, 2.0, last])

    def rows(which):
        return values[which] if which == slice(None) else np.array([alone])

    with pytest.raises(InvalidInputError, match="instant by instant"):
        require_vectorised("f", rows, 3)
    values[-1] = alone
    assert np.array_equal(require_vectorised("f", rows, 3), values)
