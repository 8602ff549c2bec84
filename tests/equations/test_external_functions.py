"""Tables and other functions that formulas call, against SciPy on minimal coordinates."""

import pickle

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from ancfdae import (
    DOP853,
    HHT,
    Adjoint,
    ComplexStep,
    DirectDifferentiation,
    Radau,
    Terminal,
    check_system,
    gradient,
    simulate,
)
from ancfdae.errors import InvalidInputError, NotTracedWarning
from ancfdae.extend import ExternalFunction, FormulaSystem
from ancfdae.numerics.operations import Operations, Traced
from ancfdae.observables import custom

GRID = np.linspace(-2.0, 2.0, 33)
#: A wire and a spring as measured, by splines.
WIRE = CubicSpline(GRID, np.cosh(GRID) - 1 + 0.1 * np.sin(3 * GRID))
SPRING = CubicSpline(GRID, 4 * np.sin(GRID) + 2 * GRID**3)
#: Moment of inertia against the angle.
INERTIA = CubicSpline(GRID, 1.5 + 0.5 * np.cos(GRID))


def table(s):
    """A spline of SciPy, which takes no complex numbers, with its derivatives."""
    first, second = s.derivative(), s.derivative(2)
    return ExternalFunction(s, ExternalFunction(first, ExternalFunction(second, s.derivative(3))))


class Bead(FormulaSystem):
    """A bead on the wire y = k s(x), pulled by a spring p(x) and damped; M, Q, Phi use tables."""

    n_q, n_lam, design_names = 3, 1, ("k", "c")
    wire, spring, inertia = table(WIRE), table(SPRING), table(INERTIA)

    def __init__(self, b=(0.8, 0.2)):
        super().__init__(b)

    def with_values(self, b):
        return type(self)(b)

    def start(self):
        return np.stack([0.7 + 0 * self.b[0], self.b[0] * WIRE(0.7), 0.4]), np.array([0.0, 0.0, 1])

    def mass_matrix(self, q):
        return np.diag(np.array([1.0, 1.0, self.inertia(q[2])]))

    def force(self, t, q, v):
        # The rotor keeps I(q) v^2 / 2, and does not act on the bead.
        spin = 0.5 * self.slope(q[2]) * v[2] ** 2
        pull = self.spring(q[0])
        return np.array([-pull - self.b[1] * v[0], -9.81 - self.b[1] * v[1], -spin])

    slope = table(INERTIA.derivative())

    def position_constraint(self, t, q):
        return np.array([q[1] - self.b[0] * self.wire(q[0])])


def minimal(b, t_end):
    """x, x' and the angle at the end, by SciPy on (x, angle)."""
    k, c = b

    def rate(t, z):
        x, u, angle, w = z
        s1, s2 = k * WIRE(x, 1), k * WIRE(x, 2)
        force = -SPRING(x) - c * u * (1 + s1**2) - 9.81 * s1 - s1 * s2 * u**2
        return [u, force / (1 + s1**2), w, -0.5 * INERTIA(angle, 1) * w**2 / INERTIA(angle)]

    return solve_ivp(rate, (0, t_end), [0.7, 0, 0.4, 1.0], "DOP853", rtol=1e-12, atol=1e-12).y[
        :, -1
    ]


END = Terminal(custom(lambda t, q, v, lam, b: q[:, 0] + q[:, 2] ** 2))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("method", "tolerance"),
    [(HHT(2.0**-9, -0.05), 3e-4), (Radau(2.0**-7), 1e-7), (DOP853(1e-9), 1e-7)],
)
def test_a_bead_on_a_measured_wire_moves_like_its_minimal_coordinate(method, tolerance):
    system = Bead()
    found = gradient(system, END, 0.25, method)

    def value(b):
        x, _, angle, _ = minimal(b, 0.25)
        return x + angle**2

    assert found.value == pytest.approx(value(system.b), abs=tolerance)
    for i, step in enumerate(1e-3 * np.eye(2)):
        ends = (value(system.b + s * step) for s in (-2, -1, 1, 2))
        slope = np.dot((1, -8, 8, -1), list(ends)) / 12e-3
        assert abs(slope) > 1e-3
        assert found.gradient[i] == pytest.approx(slope, abs=10 * tolerance)
        # Finite differences of the very call.
        ends = (gradient(Bead(system.b + s * step), END, 0.25, method).value for s in (1, -1))
        difference = np.subtract(*ends) / 2e-3
        assert found.gradient[i] == pytest.approx(difference, rel=1e-4)


@pytest.mark.parametrize("method", [HHT(2.0**-7), Radau(2.0**-6)])
def test_gradients_forwards_and_back_are_equal(method):
    system = Bead()
    found = [
        gradient(system, END, 0.25, method, method=x).gradient
        for x in (DirectDifferentiation(), Adjoint())
    ]
    np.testing.assert_allclose(*found, rtol=1e-10)


def test_members_follow_from_tables():
    check_system(Bead(), samples=1).raise_if_wrong()
    copy = pickle.loads(pickle.dumps(Bead()))
    q, v = copy.start()
    np.testing.assert_array_equal(copy.force(0.0, q, v), Bead().force(0.0, q, v))


class AnalyticWire(Bead):
    """Phi as a whole is called: it decides, and accepts complex numbers."""

    def position_constraint(self, t, q):
        height = np.cosh(q[0]) - 1 + 0.1 * np.sin(3 * q[0])
        return np.array([q[1] - self.b[0] * height]) if q[0].real < 9 else np.zeros(1)

    def start(self):
        height = np.cosh(0.7) - 1 + 0.1 * np.sin(2.1)
        return np.stack([0.7 + 0 * self.b[0], self.b[0] * height, 0.4]), np.array([0.0, 0.0, 1])


class WrittenWire(AnalyticWire):
    """The same without the decision."""

    def position_constraint(self, t, q):
        height = np.cosh(q[0]) - 1 + 0.1 * np.sin(3 * q[0])
        return np.array([q[1] - self.b[0] * height])


METHODS = [HHT(2.0**-6), Radau(2.0**-5), DOP853(1e-3, intervals=1)]


@pytest.mark.filterwarnings("ignore::ancfdae.errors.NotTracedWarning")
def test_derivatives_of_a_constraint_that_is_called_are_those_of_one_that_is_traced():
    called, written, rng = AnalyticWire(), WrittenWire(), np.random.default_rng(5)
    motion = tuple(rng.uniform(-0.8, 0.8, (4, 3)))
    on = tuple(rng.uniform(-1, 1, (4, 3, 2)))
    # At the start too, where most velocities vanish, and so does Phi.
    still = called.start()[0], np.array([1e-9, 0.0, 1.0]), *motion[2:]
    for at in (motion, still):
        for order, tolerance in enumerate((1e-14, 1e-11, 1e-10, 1e-8)):
            x = at[: order + 1]
            for value in (
                lambda s, x=x: s.constraint(0.1, *x),
                lambda s, x=x: s.constraint_q(0.1, *x),
                lambda s, x=x: s.constraint_total(0.1, x, on[: len(x)]),
            ):
                ours, exact = value(called), value(written)
                size = max(1.0, np.max(np.abs(exact)))
                np.testing.assert_allclose(ours, exact, rtol=0, atol=tolerance * size)


@pytest.mark.parametrize("method", METHODS)
def test_a_constraint_that_is_called_moves_like_one_that_is_traced(method):
    with pytest.warns(NotTracedWarning, match=r"calls position_constraint.*q\[0\]\.real < 9"):
        called = AnalyticWire()
    ours, exact = (gradient(x, END, 0.0625, method) for x in (called, WrittenWire()))
    assert ours.value == pytest.approx(exact.value, rel=1e-9)
    np.testing.assert_allclose(ours.gradient, exact.gradient, rtol=1e-6)


class WrongTable(Bead):
    spring = ExternalFunction(SPRING, lambda x: -SPRING(x, 1))


class NoDerivative(Bead):
    spring = ExternalFunction(SPRING)


class TwoForOne(Bead):
    spring = ExternalFunction(lambda x: np.array([x, x]), lambda x: 1.0)


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        (WrongTable, r"WrongTable\.force: .*differs from the finite difference"),
        (NoDerivative, r"must accept complex numbers|complex step"),
        (TwoForOne, r"must return one number"),
    ],
)
def test_tables_that_do_not_fit_are_refused(kind, told):
    with pytest.raises(InvalidInputError, match=told):
        kind()


class Broken(Bead):
    """A table that fails beyond a place that the start does not show."""

    @staticmethod
    def limited(x):
        if x < 0.65:
            raise OverflowError("beyond the table")
        return float(SPRING(x))

    spring = ExternalFunction(limited, table(SPRING.derivative()))


@pytest.mark.parametrize("method", METHODS)
def test_what_a_table_raises_reaches_the_caller(method):
    with pytest.raises(OverflowError, match="beyond the table"):
        simulate(Broken(), 1.0, method)


def test_functions_of_several_numbers_and_values():
    def pair(x, y):
        return np.array([x * np.exp(y), x**2 * y])

    def partials(x, y):
        return np.array([[np.exp(y), x * np.exp(y)], [2 * x * y, x**2]])

    at, d, e = np.array([0.7, -0.3]), np.array([0.4, 1.1]), np.array([-0.8, 0.3])
    steps = ExternalFunction(pair, size=2)
    flat = ExternalFunction(lambda x, y: partials(x, y).ravel(), size=4)
    for external, tolerance in (
        (steps, 1e-11),
        (ExternalFunction(pair, partials, size=2), 1e-14),
        (ExternalFunction(pair, flat, size=2), 1e-13),
    ):
        operations = Operations(2)
        x = Traced.array(operations, np.arange(2))
        outputs = Traced.numbers(operations, external(*x))
        number = operations.constant
        (first,) = operations.along(outputs, {0: number(d[0]), 1: number(d[1])})
        (second,) = operations.along(first, {0: number(e[0]), 1: number(e[1])})
        values = [operations.compiled(y, [0, 1]).values(at) for y in (outputs, first, second)]
        a, b = at
        H = np.array([[[0, np.exp(b)], [np.exp(b), a * np.exp(b)]], [[2 * b, 2 * a], [2 * a, 0]]])
        exact = [pair(*at), partials(*at) @ d, (H @ e) @ d]
        for ours, value, size in zip(values, exact, (1e-15, 1e-14, tolerance), strict=True):
            np.testing.assert_allclose(ours, value, rtol=max(size, 4e-15))
    rows = np.array([0.7, 0.1]), np.array([-0.3, 0.2])
    np.testing.assert_allclose(steps(*rows), [pair(*x) for x in zip(*rows, strict=True)])


class Wired(Bead):
    """The bead on a wire whose table comes with its first derivative only."""

    wire = ExternalFunction(WIRE, WIRE.derivative())


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("method", [HHT(2.0**-8), Radau(2.0**-6)])
def test_a_complex_step_follows_derivatives_that_take_real_numbers_only(method):
    """The derivative of a spline drops imaginary parts; the complex step was 1.5 % off."""
    found = [
        gradient(Wired(), END, 0.25, method, method=by).gradient
        for by in (DirectDifferentiation(), ComplexStep())
    ]
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6)
