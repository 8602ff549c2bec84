"""Formulas of a user as lists of operations, against derivatives of another kind."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from ancfdae import (
    DOP853,
    HHT,
    Adjoint,
    ComplexStep,
    DirectDifferentiation,
    Integral,
    Radau,
    Terminal,
    check_system,
    differentiate,
    gradient,
    simulate,
)
from ancfdae.equations import saddle_points as prepared
from ancfdae.equations.saddle_points import saddle_point
from ancfdae.equations.system import StateDirection, called_plan
from ancfdae.errors import InvalidInputError, NotTracedWarning, StabilityWarning
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.extend import FormulaSystem, SystemProperties, positive
from ancfdae.integrators.problem import Accelerations, CompiledAccelerations, accelerations
from ancfdae.kernels import (
    RULES,
    ExplicitRun,
    ListAccelerations,
    Model,
    OperationList,
)
from ancfdae.numerics.complex_step import scaled_derivative
from ancfdae.numerics.operations import NotTraceable, Operations, Traced
from ancfdae.observables import custom
from ancfdae.sensitivity.observables import user_functions

# ---- single rules, by means over circles -------------------------------------------------------

# Formulas with an argument, and the same formula in complex numbers where NumPy has none.
FUNCTIONS = {
    "sqrt": (np.sqrt, 0.7),
    "exp": (np.exp, -0.4),
    "log": (np.log, 1.9),
    "sin": (np.sin, 0.8),
    "cos": (np.cos, 0.8),
    "tan": (np.tan, 0.8),
    "sinh": (np.sinh, 0.8),
    "cosh": (np.cosh, 0.8),
    "tanh": (np.tanh, 0.8),
    "arctan": (np.arctan, 0.8),
    "arcsin": (np.arcsin, -0.6),
    "arccos": (np.arccos, -0.6),
    "square": (np.square, -0.6),
    "reciprocal": (np.reciprocal, -0.6),
    "negative": (np.negative, -0.6),
    "positive": (np.positive, -0.6),
    "cube": (lambda x: x**3, -0.6),
    "zeroth power": (lambda x: x**0 + x, -0.6),
    "first power": (lambda x: np.power(x, 1), -0.6),
    "seventh power": (lambda x: np.power(x, 7), -0.6),
    "large power": (lambda x: x**101, 0.9),
    "negative power": (lambda x: x**-3, -0.6),
    "real power": (lambda x: x**2.3, 0.6),
    "negative real power": (lambda x: x**-0.7, 0.6),
    "root": (lambda x: x**0.5, 0.6),
    "exponential": (lambda x: 2.0**x, 0.6),
    "own power": (lambda x: x**x, 0.6),
    "angle": (
        lambda x: np.arctan2(x, x * x - 2),
        0.6,
        lambda x: np.arctan(x / (x * x - 2)) + np.pi,
    ),
    "angle of a constant": (
        lambda x: np.arctan2(0 * x + 1.5, x),
        -0.6,
        lambda x: np.pi / 2 - np.arctan(x / 1.5),
    ),
    "angle beside a number": (
        lambda x: np.arctan2(1.5, x),
        0.6,
        lambda x: np.pi / 2 - np.arctan(x / 1.5),
    ),
    "hypot": (lambda x: np.hypot(x, 2.0), 0.6, lambda x: np.sqrt(x * x + 4)),
    "sum": (lambda x: 2 - x + (x - 3), 0.6),
    "products": (lambda x: (x * 3) * (x - 1), 0.6),
    "quotient": (lambda x: (1 + x) / (2 - x * x), 0.6),
    "quotient by a constant": (lambda x: x / 4.0, 0.6),
}
# A circle and its radius; roots of unity.
RADIUS, ROOTS = 0.15, np.exp(2j * np.pi * np.arange(64) / 64)


def traced(function, n):
    """Return a list of operations, its inputs and outputs of a function of an array."""
    operations = Operations(n)
    x = Traced.array(operations, np.arange(n))
    return operations, Traced.numbers(operations, function(x))


def evaluated(operations, outputs, x):
    inputs = range(len(x))
    return operations.compiled(outputs, list(inputs)).values(np.asarray(x))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_and_its_first_three_derivatives_are_means_over_a_circle(name):
    ours, at, *analytic = FUNCTIONS[name]
    exact = analytic[0] if analytic else ours
    around = np.array([exact(x) for x in at + RADIUS * ROOTS])
    operations, outputs = traced(lambda x: [ours(x[0])], 1)
    one = operations.constant(1.0)
    for order in range(4):
        factor = math.factorial(order) / RADIUS**order
        expected = factor * np.mean(around * ROOTS**-order).real
        (found,) = evaluated(operations, outputs, [at])
        # Round-off of the mean; the nearest singularity is four radii away.
        assert abs(found - expected) <= 1e-14 * factor * np.max(np.abs(around)), order
        # A complex step through the list is the next derivative.
        (outputs_b,) = operations.along(outputs, {0: one})
        step = evaluated(operations, outputs, [at + 1e-40j])[0].imag / 1e-40
        (slope,) = evaluated(operations, outputs_b, [at])
        assert abs(step - slope) <= 1e-13 * max(1.0, abs(slope)), order
        outputs = outputs_b


def arrays(x):
    """Every way of NumPy that formulas of a mechanism are written in."""
    A = np.array([[1, 2, 0], [0, -1, 3], [2, 0, 1]])
    u, w = x[:3], np.stack([x[3], x[4], x[5]])
    out = np.zeros(6, dtype=x.dtype)
    out[0] = u @ w
    out[1] += np.sum(u * w) - np.dot(u, A @ w)
    out[2:4] = np.concatenate([u, w])[1:3]
    out[4] = np.sqrt(np.vdot(u - w, u - w) if x.dtype != complex else (u - w) @ (u - w)) + sum(
        x
    ) * np.prod(u)
    out[5] = np.trace(np.outer(u, w)) + np.mean(w)
    M = np.diag(u) + np.outer(w, w) + np.eye(3)
    c, s = np.cos(x[0]), np.sin(x[0])
    R = np.array([[c, -s], [s, c]])
    return [
        out,
        *(M @ R.ravel()[:3]).reshape(1, 3),
        np.cross(u, w),
        np.einsum("ij,j->i", M, w),
        np.hstack([R @ x[:2], x[:1]]),
        np.vstack([u, w]).T[0],
        np.tile(u, 2)[::-1],
        np.where([True, False, True], u, w),
        np.flip(np.cumsum(u)),
        np.array([[1.5, x[1]], [2, 3]]).ravel(),
        np.kron(u[:2], w[:2]),
        np.power(w, 2) - w**-1 + 3 / u - np.square(u),
        np.array(2.0) * u + np.float64(3.0) * w[0] - np.int64(2) * w,
        np.block([[u[0], u[1]], [w[0], w[1]]]).ravel()
        if x.dtype == float
        else R.ravel() * 0 + np.array([u[0], u[1], w[0], w[1]]),
    ]


def test_arrays_of_numpy_are_traced_as_they_are_computed():
    def flat(x):
        return np.concatenate([np.ravel(y) for y in arrays(x)])

    x = np.array([0.3, -0.7, 1.1, 0.4, 0.9, -1.3])
    operations, outputs = traced(flat, 6)
    np.testing.assert_allclose(evaluated(operations, outputs, x), flat(x), rtol=1e-14)
    # Rows of states: one, fewer and more than are evaluated together.
    rows = x + 0.01 * np.arange(19)[:, None]
    inputs = list(range(6))
    values = operations.compiled(outputs, inputs).values(rows)
    np.testing.assert_allclose(values, [flat(row) for row in rows], rtol=1e-13, atol=1e-14)
    # Columns of the Jacobian against complex steps of the function.
    units = [{i: operations.constant(1.0)} for i in inputs]
    for i, column in enumerate(operations.along(outputs, *units)):
        step = flat(x + 1e-40j * np.eye(6)[i]).imag / 1e-40
        np.testing.assert_allclose(evaluated(operations, column, x), step, rtol=1e-13, atol=1e-14)


def random_formula(rng, x, depth):
    """Return a smooth formula of random operations; sizes stay of order one."""
    if depth == 0:
        return x[rng.integers(len(x))] if rng.random() < 0.8 else float(rng.uniform(0.5, 2.0))
    a, b = (random_formula(rng, x, depth - 1) for _ in range(2))
    kind = rng.integers(8)
    if kind == 0:
        return a + b
    if kind == 1:
        return a - 0.5 * b
    if kind == 2:
        return a * b
    if kind == 3:
        return a / (2.0 + np.sin(b))
    if kind == 4:
        return np.sqrt(1.0 + a**2) - np.exp(-(b**2))
    if kind == 5:
        return np.tanh(a) * np.cos(b)
    if kind == 6:
        return np.arctan(a + b) ** 3
    return (1.5 + np.sin(a)) ** 1.7 - np.log(2.0 + np.cos(b))


@pytest.mark.parametrize("seed", range(20))
def test_second_derivatives_of_random_formulas(seed):
    def formula(x):
        return [np.sin(random_formula(np.random.default_rng(seed), x, 5)) + 0.0 * x[0]]

    operations, outputs = traced(formula, 4)
    x, d = np.random.default_rng(seed + 100).uniform(-1, 1, (2, 4))
    direction = dict(enumerate(operations.constant(y) for y in d.tolist()))
    (first,) = operations.along(outputs, direction)
    (second,) = operations.along(first, direction)
    step = np.asarray(formula(x + 1e-40j * d))[0].imag / 1e-40
    assert evaluated(operations, outputs, x)[0] == pytest.approx(formula(x)[0], rel=1e-13)
    assert evaluated(operations, first, x)[0] == pytest.approx(step, rel=1e-11, abs=1e-13)
    # By central differences of the complex step, extrapolated.
    slopes = [
        (np.asarray(formula(x + s * d + 1e-40j * d))[0].imag
         - np.asarray(formula(x - s * d + 1e-40j * d))[0].imag) / (2e-40 * s)
        for s in (1e-3, 5e-4)
    ]  # fmt: skip
    expected = (4 * slopes[1] - slopes[0]) / 3
    assert evaluated(operations, second, x)[0] == pytest.approx(expected, rel=1e-7, abs=1e-8)


def test_functions_take_numbers_beside_symbols():
    x = np.array([0.4, -0.7])
    operations, outputs = traced(
        lambda x: np.concatenate([np.arctan2([2.0, 1.5], x), np.hypot(x, 3.0), 2.0 ** x[:1]]), 2
    )
    exact = [*np.arctan2([2.0, 1.5], x), *np.hypot(x, 3.0), 2.0 ** x[0]]
    np.testing.assert_allclose(evaluated(operations, outputs, x), exact, rtol=1e-15)


def test_lists_hold_no_operation_twice_and_none_that_is_not_needed():
    operations, outputs = traced(lambda x: [np.sin(x[0]) * x[1], x[1] * np.sin(x[0]) * 1 + 0], 2)
    constants, op, *_ = operations.arrays(outputs)
    assert len(constants) == 0
    assert len(op) <= 3
    (rate,) = operations.along(outputs[:1], {1: operations.constant(1.0)})
    assert len(operations.arrays(rate)[1]) == 1  # sin x


@pytest.mark.parametrize(
    ("formula", "told"),
    [
        (lambda x: [x[0] if x[0] > 0 else x[1]], "comparison"),
        (lambda x: [x[0] if x[0] else x[1]], "decision"),
        (lambda x: np.where(x > 0, x, 0), "comparison"),
        (lambda x: np.maximum(x, 0.0), "comparison.*positive"),
        (lambda x: np.abs(x), "abs.*positive"),
        (lambda x: [float(x[0])], "number"),
        (lambda x: [np.zeros(2).__setitem__(0, x[0])], "array of floats"),
        (lambda x: [x[0] * 1j], "complex"),
        (lambda x: x.astype(float), "number"),
    ],
)
def test_formulas_that_need_numbers_say_which(formula, told):
    with pytest.raises(NotTraceable, match=told):
        traced(formula, 2)


class Kinked(FormulaSystem):
    """Two masses on springs that are stiffer in compression, pushed by a force that ends."""

    n_q, n_lam = 2, 0
    design_names = ("k", "c")

    def __init__(self, b=(3.0, 0.2)):
        super().__init__(b)

    def with_values(self, b):
        return Kinked(b)

    def start(self):
        return np.array([1.0, 0.5]), np.array([0.0, 0.1])

    def mass_matrix(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        k, c = self.b
        pushes = positive(np.array([0.3 - t, 0.7 - t]))
        return -k * (positive(q) - 1.5 * positive(-q)) - c * v + pushes

    def position_constraint(self, t, q):
        return np.zeros(0)


def test_positive_makes_formulas_with_kinks_that_are_traced():
    """Value and derivatives equal SciPy's integration with np.maximum, and differences of it."""
    end = Terminal(custom(lambda t, q, v, lam, b: positive(q).sum(axis=1) + q[:, 0]))

    def value(b):
        def rates(t, y):
            pull = np.maximum(y[:2], 0) - 1.5 * np.maximum(-y[:2], 0)
            pushes = np.maximum([0.3 - t, 0.7 - t], 0)
            return np.append(y[2:], -b[0] * pull - b[1] * y[2:] + pushes)

        start = [1.0, 0.5, 0.0, 0.1]
        run = solve_ivp(rates, (0, 2), start, rtol=1e-12, atol=1e-13, max_step=5e-3)
        return np.sum(np.maximum(run.y[:2, -1], 0)) + run.y[0, -1]

    b, h = np.array([3.0, 0.2]), 1e-4
    slopes = [(value(b + h * e) - value(b - h * e)) / (2 * h) for e in np.eye(2)]
    found = [gradient(Kinked(), end, 2.0, Radau(2e-3), method=m()) for m in (Adjoint, ComplexStep)]
    # In a step that passes a kink the value has an error of h^3 times the jump of the third
    # derivative, at most about 4 here, and the derivative one of h^2 times it. Four are passed.
    assert abs(found[0].value - value(b)) < 16 * 2e-3**3
    assert np.max(np.abs(found[0].gradient - slopes)) < 16 * 2e-3**2
    assert np.max(np.abs(found[0].gradient - found[1].gradient)) < 1e-12
    assert check_system(Kinked()).passed


@pytest.mark.parametrize("index", [-1, 3, 99])
def test_lists_that_do_not_fit_are_refused(index):
    operations, outputs = traced(lambda x: [x[0] + x[1]], 2)
    constants, op, a, b, to = operations.arrays(outputs)
    bad, none = np.array([index], np.int32), (np.zeros(0, np.int32), ())
    with pytest.raises(ValueError, match="list of operations"):
        OperationList(2, constants, op, bad, b, to, *none)
    with pytest.raises(ValueError, match="list of operations"):
        OperationList(2, constants, op, a, b, bad, *none)
    fine = OperationList(2, constants, op, a, b, to, *none)
    for x in (np.zeros(3), np.zeros((2, 1)), np.zeros(())):
        with pytest.raises(ValueError, match=r"number for each|too few axes"):
            fine.values(x)
    assert fine.values(np.zeros((0, 2))).shape == (0, 1)
    # Inputs in parts: one row for all, and rows that must be equally many.
    parts = np.array([1.0]), np.array([[2.0], [3.0]])
    whole = fine.values(np.array([[1.0, 2.0], [1.0, 3.0]]))
    assert np.array_equal(fine.values(*parts), whole)
    for wrong in ((np.ones((3, 1)), parts[1]), (np.ones(1),), (np.ones((2, 1, 1)), parts[1])):
        with pytest.raises(ValueError, match=r"equally many rows|for each input"):
            fine.values(*wrong)
    assert pickle.loads(pickle.dumps(fine)).values(np.array([1.0, 2.0])) == 3.0


# ---- systems -----------------------------------------------------------------------------------


class Swing(FormulaSystem):
    """A pendulum of length L whose pivot moves by A sin 3t along x; one angle, no constraint."""

    n_q, n_lam, design_names = 1, 0, ("L", "A", "unused")

    def __init__(self, b=(0.8, 0.1, 3.0)):
        super().__init__(b)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        return np.array([0.5]), np.array([0.0])

    def mass_matrix(self, q):
        return [[self.b[0] ** 2]]

    def force(self, t, q, v):
        L, A, _ = self.b
        pivot = -9 * A * np.sin(3 * t)
        return [-9.81 * L * np.sin(q[0]) - L * np.cos(q[0]) * pivot]

    def position_constraint(self, t, q):
        return []


class SwingInSpace(Swing):
    """The same in x and y, with the rod as a constraint; a redundant coordinate, and L = 2 z."""

    n_q, n_lam = 3, 2

    def start(self):
        L, A, _ = self.b
        return (
            np.stack([L * np.sin(0.5), -L * np.cos(0.5), L / 2]),
            np.stack([3 * A, 0 * A, 0 * A]),
        )

    def mass_matrix(self, q):
        return np.eye(3)

    def force(self, t, q, v):
        Q = np.zeros(3, dtype=q.dtype)
        Q[1] = -9.81
        return Q

    def position_constraint(self, t, q):
        x = q[0] - self.b[1] * np.sin(3 * t)
        return np.array([np.hypot(x, q[1]) - self.b[0], q[2] - self.b[0] / 2])


HEIGHTS = {
    Swing: Terminal(custom(lambda t, q, v, lam, b: -b[0] * np.cos(q[:, 0]))),
    SwingInSpace: Terminal(custom(lambda t, q, v, lam, b: q[:, 1])),
}


@pytest.mark.parametrize("kind", [Swing, SwingInSpace])
def test_members_follow_from_the_values(kind):
    check_system(kind(), samples=2).raise_if_wrong()


def test_redundant_coordinates_move_like_the_angle():
    ends = []
    for kind, height in HEIGHTS.items():
        system = kind()
        found = gradient(system, height, 1.0, DOP853(1e-11))
        ends.append([found.value, *found.gradient])
        for i in range(3):
            step = 1e-4 * np.eye(3)[i]
            pair = (
                gradient(system.with_values(system.b + s * step), height, 1.0, DOP853(1e-12)).value
                for s in (1, -1)
            )
            difference = np.subtract(*pair) / 2e-4
            assert found.gradient[i] == pytest.approx(difference, rel=1e-6, abs=1e-8), (kind, i)
        assert found.gradient[2] == 0
    # Two runs of a tolerance of 1e-11.
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-8)


def test_what_a_system_is_constant_in_is_found():
    found = SwingInSpace().traits
    assert found.constant_mass
    assert not found.linear_constraints
    assert not found.velocity_forces
    assert not Swing().traits.linear_constraints or Swing.n_lam == 0


class Sliding(SwingInSpace):
    """Linear constraints with a constant, a design variable or time as their right side."""

    side = staticmethod(lambda t, b: 0.3)

    def start(self):
        return np.stack([0.2, 0.1, 0.3 + 0 * self.b[0]]), np.zeros(3)

    def position_constraint(self, t, q):
        return np.array([q[0] + 2 * q[1] - 0.4, q[2] - self.side(t, self.b)])


class SlidingInTime(Sliding):
    side = staticmethod(lambda t, b: 0.3 + t**2)


class SlidingByDesign(Sliding):
    side = staticmethod(lambda t, b: 0.375 * b[0])

    def start(self):
        return np.stack([0.2, 0.1, 0.375 * self.b[0]]), np.zeros(3)


def test_constraints_that_stay_are_found():
    kinds = (Sliding, SlidingInTime, SlidingByDesign)
    assert [x().traits.constant_constraints for x in kinds] == [True, False, False]
    assert all(x().traits.linear_constraints for x in kinds)
    # (x, y) slides down a line of slope -1/2: a tangential acceleration of g/sqrt 5.
    for kind in kinds[::2]:
        for method in (HHT(2.0**-6), Radau(2.0**-5), DOP853(1e-9)):
            run = differentiate(kind(), 0.5, method)
            y = 0.1 - 9.81 / 5 * 0.5**2 / 2
            np.testing.assert_allclose(run.q[-1], [0.4 - 2 * y, y, 0.3], rtol=1e-9)
            exact = [0, 0, 0.375 * (kind is SlidingByDesign)]
            np.testing.assert_allclose(run.sensitivities.q_b[-1][:, 0], exact, atol=1e-10)


def test_formulas_run_once():
    calls = []

    class Counted(Swing):
        def force(self, t, q, v):
            calls.append(1)
            return super().force(t, q, v)

    system = Counted()
    before = len(calls)
    simulate(system, 0.1, HHT(0.01))
    differentiate(system.with_values((0.9, 0.1, 1.0)), 0.1, HHT(0.01))
    assert len(calls) == before


def test_systems_pickle():
    system = pickle.loads(pickle.dumps(SwingInSpace()))
    q, v = system.start()
    np.testing.assert_array_equal(system.force(0.1, q, v), SwingInSpace().force(0.1, q, v))


class Iterated(Swing):
    def mass_matrix(self, q):
        M = np.zeros((1, 1), dtype=np.result_type(q, self.b))
        while M[0, 0].real < 0.6:  # a decision
            M[0, 0] = M[0, 0] + self.b[0] ** 2
        return M


def test_a_warning_names_the_line_and_what_it_costs():
    with pytest.warns(
        NotTracedWarning,
        match=r"calls mass_matrix, .*hundred times as long.*M\[0, 0\]\.real < 0\.6",
    ):
        system = Iterated()
    # Handed on, without another trial and warning.
    moved = system.with_values((0.9, 0.1, 3.0))
    run, exact = (simulate(x, 0.2, HHT(0.01)).q for x in (moved, Swing((0.9, 0.1, 3.0))))
    np.testing.assert_allclose(run, exact, rtol=1e-12)


class Remembering(Swing):
    """Not a function: it returns something else each time."""

    count = 0

    def force(self, t, q, v):
        Remembering.count += 1
        return [Remembering.count * self.b[0] - q[0]]


class Forgetting(Swing):
    def with_values(self, b):
        return Forgetting()


class Floats(Swing):
    def force(self, t, q, v):
        Q = np.zeros(1)
        Q[0] = -q[0]
        return Q


def test_formulas_that_are_none_are_refused():
    with pytest.raises(
        InvalidInputError, match=r"with_values: must return the system at the values b"
    ):
        Forgetting()
    with pytest.raises(InvalidInputError, match=r"Floats\.force") as told:
        Floats()
    assert any("np.zeros(n, dtype=q.dtype)" in note for note in told.value.__notes__)
    with pytest.raises(InvalidInputError, match=r"Remembering\.force"):
        Remembering()


def test_round_off_of_constraints_at_the_start_is_no_other_value():
    class Closed(Swing):
        """NumPy adds these terms in another order than the list."""

        n_q, n_lam = 40, 1

        def start(self):
            q = np.sin(np.arange(40.0)) * self.b[0]
            return np.append(q[:-1], -sum(q[:-1])), np.zeros(40)

        def mass_matrix(self, q):
            return np.eye(40)

        def force(self, t, q, v):
            return -q

        def position_constraint(self, t, q):
            return [np.sum(q)]

    system = Closed()
    assert np.abs(system.constraint(0.0, system.start()[0])) < 1e-14


class Corner(Swing):
    """A force that is not defined at rest: v / |v|."""

    traits = SystemProperties(constant_mass=True)

    def force(self, t, q, v):
        return [-q[0] - 0.1 * v[0] / np.sqrt(v[0] ** 2)]


def test_a_division_by_zero_at_the_start_is_told():
    with pytest.warns(StabilityWarning, match=r"no derivative.*`return \[-q\[0\] - 0.1"):
        corner = Corner()
    with pytest.raises(InvalidInputError, match="must be finite"):
        simulate(corner, 0.1, HHT(0.01))


# ---- accelerations in the kernel ---------------------------------------------------------------


class Elbow(FormulaSystem):
    """Two links in the plane, ten variables: M depends on q, Q on v and t, Phi on t."""

    n_q, n_lam = 4, 2
    design_names = tuple(f"b{i}" for i in range(10))

    def __init__(self, b=tuple(1 + 0.1 * i for i in range(10))):
        super().__init__(b)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        b = self.b
        return np.stack([0.3 * b[0], b[1], 0.5 * b[2], -0.2 * b[3]]), 0.1 * b[4:8]

    def mass_matrix(self, q):
        b = self.b
        M = np.diag(b[:4] + np.cos(q) ** 2)
        M[0, 3] = M[3, 0] = 0.3 * np.sin(q[1]) * b[4]
        return M

    def force(self, t, q, v):
        b = self.b
        return -b[5] * q * (q @ q) - b[6] * v * np.sqrt(1 + v @ v) + np.sin(b[7] * t)

    def position_constraint(self, t, q):
        b = self.b
        return np.array(
            [q[0] ** 2 + b[8] * q[1] * q[2] - np.cos(t) * b[0], np.sin(q[3]) * q[1] - b[9] * t**2]
        )


@pytest.mark.parametrize("with_derivatives", [False, True])
def test_accelerations_of_lists_are_those_of_the_protocol(with_derivatives):
    system, rng = Elbow(), np.random.default_rng(3)
    matrices = saddle_point(system, 0.0)
    ours = accelerations(system, matrices)
    assert isinstance(ours, CompiledAccelerations)
    states = rng.uniform(0.5, 1.5, (5, 2, 1 + 10 * with_derivatives, 4))
    t = rng.uniform(0, 1, 5)
    exact = Accelerations(system, matrices)
    for of in ("rows_of", "projected_of"):
        found, expected = (getattr(x, of)(t, states) for x in (ours, exact))
        assert found.shape == expected.shape
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11)
        assert np.max(np.abs(found - states.mean())) > 0.1


def test_what_has_no_accelerations_is_told():
    system = Elbow()
    ours = accelerations(system, saddle_point(system, 0.0))
    q, v = (np.ones((1, 4)) for _ in range(2))
    with pytest.raises(SingularMatrix):
        ours.rows(0.0, 0 * q, v)
    assert np.all(np.isnan(ours.rows(0.0, q * np.nan, v)))
    assert np.all(np.isfinite(ours.rows(0.0, q, v)))


def found_at(x):
    equations = ListAccelerations(x["lists"], x["b"], x["scale"])
    return equations.at(x["projected"], x["t"], x["states"])


@pytest.mark.parametrize("wrong", ["lists", "b", "scale", "t", "states", "stages"])
def test_arguments_that_do_not_fit_are_refused(wrong):
    system = Elbow()
    arguments = {
        "lists": system.index_1(True),
        "b": system.b,
        "scale": np.ones(6),
        "t": np.zeros(2),
        "states": np.ones((2, 2, 11, 4)),
    }
    if wrong == "stages":
        step = [np.zeros((18, 44)), np.zeros((16, 2, 11, 4)), np.zeros((16, 11, 6)), np.zeros(7)]
        tables = [np.zeros((16, 2, 18)), np.zeros((2, 2, 12)), np.zeros(16), np.zeros((4, 16))]
        equations = ListAccelerations(*(arguments[x] for x in ("lists", "b", "scale")))
        # The dense output is at hand: no stage is evaluated.
        terms = ExplicitRun(equations, tuple(tables), tuple(step)).terms()
        assert np.array_equal(terms, np.zeros((7, 2, 11, 4)))
        for arrays in (step, tables):
            for i in range(len(arrays)):
                short = [
                    tuple(x[:-1] if x is arrays[i] else x for x in these)
                    for these in (tables, step)
                ]
                with pytest.raises(ValueError, match=r"fit|shape"):
                    ExplicitRun(equations, *short)
        kept = [np.zeros((2, 2)), np.zeros((2, 1, 2, 11, 4)), np.zeros((2, 1, 11, 2))]
        kept.append(np.zeros(1, dtype=np.int32))
        tolerances = [1e-3, np.ones((2, 11, 4)), np.zeros(4), 1]
        march, times = ExplicitRun(equations, tuple(tables), tuple(step)).march, np.zeros(1)
        *found, states = march(tuple(tolerances), times, 1.0, 2, tuple(kept))
        # The time is the end of the step, and the state that after it.
        assert (found, states.shape) == ([0, 0], (1, 2, 11, 4))
        with pytest.raises(ValueError, match="a time to reach"):
            march(tuple(tolerances), np.zeros(0), 1.0, 2, tuple(kept))
        for i, bad in ((1, np.ones((2, 11, 3))), (2, np.zeros(3)), (3, 3), (3, 0)):
            changed = (*tolerances[:i], bad, *tolerances[i + 1 :])
            with pytest.raises(ValueError, match=r"fit|shapes"):
                march(changed, times, 1.0, 2, tuple(kept))
        for i, bad in ((0, np.zeros((1, 2))), (1, np.zeros((2, 2, 2, 11, 4)))):
            changed = (*kept[:i], bad, *kept[i + 1 :])
            with pytest.raises(ValueError, match=r"room|shapes|no such stage"):
                march(tuple(tolerances), times, 1.0, 2, changed)
        beyond = (*kept[:3], np.full(1, 16, dtype=np.int32))
        with pytest.raises(ValueError, match=r"room|shapes|no such stage"):
            march(tuple(tolerances), times, 1.0, 2, beyond)
        return
    lists = arguments["lists"]
    for projected in (False, True):
        good = dict.fromkeys(("lists", "b", "scale", "projected"), projected) | arguments
        found_at(good)
        # Without derivatives three lists are enough.
        alone = {**good, "lists": system.index_1(False), "states": np.ones((2, 2, 1, 4))}
        assert len(alone["lists"]) == 3
        found_at(alone)
        bad = {
            "lists": [lists[:5], lists[::-1], lists[:3], (1,) * 6],
            "b": [system.b[:5], np.ones(11)],
            "scale": [np.ones(3), np.ones(7)],
            "t": [np.zeros(3)],
            "states": [np.ones((2, 2, 3, 4)), np.ones((2, 1, 11, 4)), np.ones((2, 2, 11, 5))],
        }[wrong]
        for value in bad:
            with pytest.raises(ValueError, match=r"fit|lists|type|time"):
                found_at({**good, wrong: value})


# ---- steps in the kernel -----------------------------------------------------------------------


class InPython:
    """A system whose equations functions of Python evaluate, in place of lists."""

    list_plan = property(called_plan)


class ElbowInPython(InPython, Elbow):
    pass


class SwingInPython(InPython, Swing):
    pass


class SymmetricSwing(SwingInSpace):
    """A pendulum whose matrices are stored as an envelope."""

    traits = SystemProperties(symmetric=True)


class SymmetricSwingInPython(InPython, SymmetricSwing):
    pass


PAIRS = [(Elbow, ElbowInPython), (Swing, SwingInPython), (SymmetricSwing, SymmetricSwingInPython)]
STEPS = {
    "HHT": (HHT(2.0**-6), 0.5),
    "short": (HHT(1e-9), 2e-8),
    "controlled": (HHT(rtol=1e-4), 0.5),
    "Radau": (Radau(2.0**-5), 0.5),
}


def counting(taken):
    """A model that appends the number of steps that its kernel takes."""

    class Counted:
        def __init__(self, *arguments):
            self.model = Model(*arguments)
            self.differentiate_steps = self.model.differentiate_steps

        def march(self, *x):
            found = self.model.march(*x)
            taken.append(found[0])
            return found

        def march_controlled(self, *x):
            found = self.model.march_controlled(*x)
            taken.append(found[0])
            return found

        def march_stages(self, *x):
            found = self.model.march_stages(*x)
            taken.append(found[0])
            return found

    return Counted


@pytest.mark.parametrize("how", STEPS)
@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair[0].__name__)
def test_steps_in_the_kernel_are_those_of_python(pair, how):
    method, t_end = STEPS[how]
    with pytest.MonkeyPatch.context() as patch:
        taken = []

        patch.setattr(prepared, "Model", counting(taken))
        runs, counts = [], []
        for kind in pair:
            system = kind()
            system.traits = replace(system.traits, project_start=True)
            runs.append(simulate(system, t_end, method))
            counts.append(sum(taken))
    ours, python = (run.statistics for run in runs)
    assert counts[0] >= ours.steps
    # Round-off may decide whether a step takes another iteration.
    assert abs(ours.iterations - python.iterations) <= 1 + 0.02 * python.iterations
    assert len(runs[0].t) == len(runs[1].t)
    for name in ("q", "v", "a", "lam"):
        ours, exact = (getattr(run, name) for run in runs)
        # Newton's tolerance; of multipliers of short steps round-off of q over h^2.
        size = np.max(np.abs(exact), initial=0.0)
        tolerance = 1e-4 if how == "short" else 1e-9
        np.testing.assert_allclose(ours, exact, rtol=0, atol=tolerance * size)


@pytest.mark.parametrize("method", [HHT(2.0**-6), Radau(2.0**-5)])
def test_gradients_of_steps_in_the_kernel_are_differences(method):
    system, end = Elbow(), Terminal(custom(lambda t, q, v, lam, b: q[:, 0] + q[:, 2] * b[1]))
    system.traits = replace(system.traits, project_start=True)

    def value(b):
        moved = Elbow(b)
        moved.traits = system.traits
        return gradient(moved, end, 0.25, method)

    found = value(system.b).gradient
    for i in (0, 1, 5, 8, 9):
        step = 1e-4 * np.eye(10)[i]
        difference = (value(system.b + step).value - value(system.b - step).value) / 2e-4
        assert found[i] == pytest.approx(difference, rel=1e-6, abs=1e-7), i


class Chain(FormulaSystem):
    """60 point masses on rods in a row, each damped, level at first: 180 unknowns."""

    design_names = ("m", "L")
    count = 60
    n_q, n_lam = 2 * count, count

    def __init__(self, b=(1.2, 0.1)):
        super().__init__(b)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        x = self.b[1] * np.arange(1, self.count + 1)
        return np.stack([x, 0 * x], axis=1).ravel(), np.zeros(self.n_q)

    def mass_matrix(self, q):
        return self.b[0] * np.eye(self.n_q)

    def force(self, t, q, v):
        return -9.81 * self.b[0] * np.tile([0.0, 1.0], self.count) - 0.5 * v

    def position_constraint(self, t, q):
        rods = np.diff(np.concatenate([np.zeros(2), q]).reshape(-1, 2), axis=0)
        return np.sum(rods * rods, axis=1) - self.b[1] ** 2


class ChainInPython(InPython, Chain):
    pass


def swung(t_end, m, L, n=60):
    """The heights of the chain by SciPy on its angles below the level."""
    below = n - np.maximum(*np.indices((n, n)))

    def rate(t, y):
        a, w = np.split(y, 2)
        away = a[:, None] - a
        M = m * L**2 * below * np.cos(away)
        Q = m * L * 9.81 * np.diag(below) * np.cos(a) - 0.5 / m * M @ w
        return np.append(w, np.linalg.solve(M, Q - m * L**2 * below * np.sin(away) @ w**2))

    run = solve_ivp(rate, (0, t_end), np.zeros(2 * n), "DOP853", rtol=1e-10, atol=1e-12)
    return -L * np.cumsum(np.sin(run.y[:n, -1]))


def test_a_long_chain_marches_on_its_sparse_pattern(monkeypatch):
    system, taken = Chain(), []
    monkeypatch.setattr(prepared, "Model", counting(taken))
    assert system.pattern.size == system.n_q + 2 * 2 * (system.count - 1)
    assert system.constraint_pattern.size == 2 * system.n_q - 2
    ends = [simulate(system, 0.25, HHT(2.0**-k, -0.05)).q[-1, 1::2] for k in (7, 8)]
    assert sum(taken) == 32 + 64
    exact = swung(0.25, *system.b)
    errors = [np.max(np.abs(end - exact)) for end in ends]
    # 0.3 m of fall, at second order.
    assert errors[1] < 2e-4
    assert 3 < errors[0] / errors[1] < 5
    heights = Terminal(custom(lambda t, q, v, lam, b: q[:, -1] + q[:, 61] * b[0]))
    pair = [gradient(x, heights, 0.125, HHT(2.0**-7)) for x in (system, ChainInPython())]
    np.testing.assert_allclose(pair[0].gradient, pair[1].gradient, rtol=1e-8)
    ends = (gradient(Chain((1.2, L)), heights, 0.125, HHT(2.0**-7)).value for L in (0.101, 0.099))
    assert pair[0].gradient[1] == pytest.approx(np.subtract(*ends) / 2e-3, rel=1e-4)


class Coupled(Chain):
    """Masses without rods that pull one another, each pair in one way alone."""

    n_q, n_lam = 70, 0

    def start(self):
        return np.cos(np.arange(70.0)), np.zeros(70)

    def mass_matrix(self, q):
        M = np.diag(2.0 + 0 * q)
        M[0, 9] = M[9, 0] = 0.5
        return M

    def force(self, t, q, v):
        Q = -q
        Q[3] -= 0.3 * q[20]
        Q[4] -= 0.2 * v[30]
        return Q

    def position_constraint(self, t, q):
        return []


def test_patterns_hold_what_couples_and_nothing_else():
    system = Coupled()
    pairs = set(zip(system.pattern.rows.tolist(), system.pattern.columns.tolist(), strict=True))
    coupled = {(0, 9), (3, 20), (4, 30)}
    assert pairs == {(i, i) for i in range(70)} | coupled | {(j, i) for i, j in coupled}
    # Closed form: q'' = -A q - B q' is linear with constant matrices.
    A, B, M = np.eye(70), np.zeros((70, 70)), 2 * np.eye(70)
    A[3, 20], B[4, 30] = 0.3, 0.2
    M[0, 9] = M[9, 0] = 0.5
    top = np.concatenate([np.zeros((70, 70)), np.eye(70)], axis=1)
    below = np.concatenate([-np.linalg.solve(M, A), -np.linalg.solve(M, B)], axis=1)
    exact = (expm(np.concatenate([top, below])) @ np.append(*system.start()))[:70]
    for method in (Radau(2.0**-4), DOP853(1e-9)):
        np.testing.assert_allclose(simulate(system, 1.0, method).q[-1], exact, atol=1e-7)


# ---- observables -------------------------------------------------------------------------------


def bent(t, q, v, lam, b):
    angle = np.arctan2(q[:, 1], 2.0 + q[:, 0] ** 2)
    return np.exp(-t) * angle * v[:, 2] + b[3] * np.linalg.norm(q, axis=1) - lam[:, 0] * t**2


def stepped(t, q, v, lam, b):
    """The same for complex steps, which take no arctan2; it decides, and is called."""
    angle = np.arctan(q[:, 1] / (2.0 + q[:, 0] ** 2))
    size = np.sqrt(np.sum(q * q, axis=1)) if np.real(q[0, 0]) > -99 else 0.0
    return np.exp(-t) * angle * v[:, 2] + b[3] * size - lam[:, 0] * t**2


@pytest.mark.parametrize("method", [DirectDifferentiation(), Adjoint()], ids=["direct", "adjoint"])
def test_partials_of_an_observable_are_those_of_its_complex_steps(method):
    system = Elbow()
    system.traits = replace(system.traits, project_start=True)
    assert user_functions._traced(bent, 4, 2, 10) is not None
    assert user_functions._traced(stepped, 4, 2, 10) is None
    ours, exact = (
        gradient(system, Integral(custom(f)), 0.25, HHT(2.0**-6), method=method)
        for f in (bent, stepped)
    )
    assert ours.value == pytest.approx(exact.value, rel=1e-14)
    np.testing.assert_allclose(ours.gradient, exact.gradient, rtol=1e-12)


def test_a_real_part_in_an_observable_is_traced_and_takes_complex_steps_all_the_same():
    end = Terminal(custom(lambda t, q, v, lam, b: np.real(q[:, 0]) * np.conj(b[0]) + v[:, 0].real))
    ours, exact = (
        gradient(Swing(), end, 0.25, HHT(2.0**-6), method=x).gradient
        for x in (DirectDifferentiation(), ComplexStep())
    )
    assert np.all(np.abs(ours[:2]) > 1e-3)
    np.testing.assert_allclose(ours, exact, rtol=1e-11)


def test_an_observable_that_changes_is_not_taken_for_what_it_was():
    factor = [1.0]

    def scaled(t, q, v, lam, b):
        return factor[0] * q[:, 0] ** 2

    system, end = Swing(), Terminal(custom(scaled))
    first = gradient(system, end, 0.25, HHT(2.0**-6)).gradient
    factor[0] = 3.0
    np.testing.assert_allclose(gradient(system, end, 0.25, HHT(2.0**-6)).gradient, 3 * first)


def test_partials_of_one_output_are_derivatives_along_its_inputs():
    def formula(x):
        return [np.sin(x[0] * x[1]) / x[2] - x[1] * x[1] + np.arctan2(x[0], x[2]) ** 3 + x[4]]

    operations, outputs = traced(formula, 6)
    partials = operations.partials(int(outputs[0]))
    assert sorted(partials) == [0, 1, 2, 4]
    x = np.array([0.3, -0.7, 1.1, 0.4, 0.9, -1.3])
    one = operations.constant(1.0)
    for i, number in partials.items():
        (column,) = operations.along(outputs, {i: one})
        ours, exact = (evaluated(operations, y, x)[0] for y in (np.array([number]), column))
        assert ours == pytest.approx(exact, rel=1e-14)


# ---- functions that are called -----------------------------------------------------------------


class CalledElbow(Elbow):
    """M and Q that cannot be traced."""

    def mass_matrix(self, q):
        return np.linalg.solve(np.eye(4), super().mass_matrix(q))

    def force(self, t, q, v):
        return np.linalg.solve(np.eye(4), super().force(t, q, v))


@pytest.fixture
def called_elbow():
    with pytest.warns(NotTracedWarning, match="calls mass_matrix and force,"):
        return CalledElbow()


def test_members_follow_from_called_values(called_elbow):
    called_elbow.traits = replace(called_elbow.traits, project_start=True)
    check_system(called_elbow, samples=1).raise_if_wrong()


def test_derivatives_of_called_functions_are_those_of_lists(called_elbow):
    listed, rng = Elbow(), np.random.default_rng(8)
    q, v, a = rng.uniform(0.5, 1.5, (3, 4))
    lam, t, step = rng.uniform(-1, 1, 2), 0.3, 1e-40
    b = listed.b + 1j * step * rng.uniform(-1, 1, 10)
    moved = [x.with_values(b) for x in (called_elbow, listed)]
    direction = StateDirection(0.7, v + 1j * step * a, a - 1j * step * q)
    for name, arguments in {
        "force_along": (t, q + 1j * step * v, v - 1j * step * a, direction),
        "mass_along": (q + 1j * step * v, a - 1j * step * q),
    }.items():
        ours, exact = (getattr(x, name)(*arguments) for x in moved)
        np.testing.assert_allclose(ours.real, exact.real, rtol=1e-13, atol=1e-14)
        # Means over circles.
        size = np.max(np.abs(exact.imag))
        np.testing.assert_allclose(ours.imag, exact.imag, rtol=0, atol=1e-9 * size)
    states = np.array([t]), *(x[None] for x in (q, v, a, lam))
    for name in ("linearise", "design_partials"):
        ours, exact = (vars(getattr(x, name)(*states)) for x in (called_elbow, listed))
        for part in exact:
            np.testing.assert_allclose(ours[part], exact[part], rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("method", [HHT(2.0**-5), Radau(2.0**-4), DOP853(1e-8)])
def test_runs_of_called_functions_are_those_of_lists(called_elbow, method):
    ends = []
    for system in (called_elbow, Elbow()):
        system.traits = replace(system.traits, project_start=True)
        run = differentiate(system, 0.125, method)
        ends.append(
            [run.q[-1], run.lam[-1], *run.sensitivities.q_b[-1], *run.sensitivities.lam_b[-1]]
        )
    for ours, exact in zip(*ends, strict=True):
        size = max(1.0, np.max(np.abs(exact)))
        np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-8 * size)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_derivatives_of_functions_of_any_scale(scale):
    x = 0.3 * scale
    for f, exact in (
        (lambda s: np.array([np.sin((x + s) / scale)]), np.cos(0.3) / scale),
        (lambda s: 1e-40 * np.array([np.exp((x + s) / scale)]), 1e-40 * np.exp(0.3) / scale),
        (lambda s: np.array([3.0 + 0 * s]), 0.0),
        (lambda s: np.array([1e6 + (x + s) / scale]), 1 / scale),
        (lambda s: np.array([0.0 * s]), 0.0),
    ):
        tolerance = 1e-8 * abs(exact)
        assert abs(scaled_derivative(f)[0] - exact) <= tolerance, exact


def test_a_table_without_derivatives_is_refused():
    class Table(Swing):
        n_lam = 1

        def position_constraint(self, t, q):
            return np.array([np.interp(q[0], [0.0, 1.0], [0.0, 1.0])])

    with pytest.raises(
        InvalidInputError, match=r"Table\.position_constraint: .*ExternalFunc"
    ) as told:
        Table()
    assert "np.interp(q[0]" in told.value.__notes__[-1]

    class Checked(Swing):
        def __init__(self, b=(0.8, 0.1, 3.0)):
            if np.real(b[0]) <= 0:
                raise ValueError
            super().__init__(b)

    with pytest.warns(NotTracedWarning, match=r"mass_matrix and force.*b\[0\]\) <= 0.*comparison"):
        system = Checked()
    run, exact = (simulate(x, 0.2, HHT(0.01)).q for x in (system, Swing()))
    np.testing.assert_allclose(run, exact, rtol=1e-12)


WRONG_PLANS = {
    "lists": [(), (1,) * 6, "reversed"],
    "b": [np.ones(9), np.ones(11)],
    "weights": [np.ones(3), np.ones(5)],
    "inverse_weights": [np.ones(3)],
    "velocity": [False],
    "B": ["short"],
    "K": ["short"],
}


@pytest.mark.parametrize("field", WRONG_PLANS)
def test_plans_of_lists_that_do_not_fit_are_refused(field):
    system = Elbow()
    plan, rules = system.list_plan, np.zeros(RULES)
    layout = saddle_point(system, 0.0).layout(band=True)
    Model(plan, layout, rules, None)
    for value in WRONG_PLANS[field]:
        if isinstance(value, str) and value == "reversed":
            value = plan.lists[::-1]
        elif isinstance(value, str):
            first, columns, values = getattr(plan, field)
            value = first, columns[:-1], values[:-1]
        with pytest.raises((ValueError, TypeError)):
            Model(plan._replace(**{field: value}), layout, rules, None)


CALL, RESULT = 21, 22


def doubled(rows):
    return 2.0 * rows[:, :1]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"calls": [1, 1, 3, 3]}, "list of operations"),
        ({"calls": [1, 1, 0, 2]}, "list of operations"),
        ({"calls": [1, 1, 0, 4]}, "list of operations"),
        ({"calls": [1, 9, 0, 3]}, "list of operations"),
        ({"calls": [-1, 1, 0, 3]}, "list of operations"),
        ({"calls": []}, "list of operations"),
        ({"a": [7, 2]}, "list of operations"),
        ({"a": [0, 3]}, "list of operations"),
        ({"b": [1, 2]}, "list of operations"),
        ({"op": [CALL, 0]}, "list of operations"),
        ({"functions": (lambda rows: rows[:2],)}, "another shape"),
        ({"functions": (lambda rows: None,)}, "missing"),
    ],
)
def test_calls_of_lists_that_do_not_fit_are_refused(change, told):
    given = {"op": [CALL, RESULT], "a": [0, 2], "b": [0, 2], "to": [3], "calls": [1, 1, 0, 3]}

    def values(functions=(doubled,), **changed):
        indices = [np.array(x, np.int32) for x in (given | changed).values()]
        return OperationList(2, np.zeros(0), *indices, functions).values(np.ones((19, 2)))

    np.testing.assert_array_equal(values(), 2.0)
    with pytest.raises(ValueError, match=told):
        values(**change)


class Sprung(FormulaSystem):
    """A mass on a spring whose stiffness is no design variable."""

    n_q, n_lam, design_names = 1, 0, ("mass",)

    def __init__(self, b, stiffness):
        self.stiffness = stiffness
        super().__init__(b)

    def with_values(self, b):
        return Sprung(b, self.stiffness)

    def start(self):
        return np.ones(1), np.zeros(1)

    def mass_matrix(self, q):
        return self.b[0] * np.eye(1)

    def force(self, t, q, v):
        return -self.stiffness * q

    def position_constraint(self, t, q):
        return np.zeros(0)


def test_systems_share_lists_where_their_formulas_are_the_same():
    first, same, other = Sprung([2.0], 8.0), Sprung([3.0], 8.0), Sprung([2.0], 18.0)
    assert first._formulas is same._formulas
    assert first._formulas is not other._formulas
    for system, rate in ((first, 2.0), (same, np.sqrt(8 / 3)), (other, 3.0), (first, 2.0)):
        run = simulate(system, 1.0, DOP853(1e-10, intervals=1))
        assert run.q[-1, 0] == pytest.approx(np.cos(rate), abs=1e-8)
