"""Lists of operations in the making: derivatives, copies, and numbers that do not fit."""

import pickle

import numpy as np
import pytest

from ancfdae.extend import ExternalFunction
from ancfdae.kernels import OperationTrace
from ancfdae.numerics.arrays import STEP
from ancfdae.numerics.operations import Operations, Traced

FORMULAS = {
    "add": lambda x, y: x + y + 1,
    "subtract": lambda x, y: (x - y) * (2 - x),
    "multiply": lambda x, y: x * y * y,
    "divide": lambda x, y: x / y + 1 / x,
    # NumPy has no angle of complex numbers.
    "angle": lambda x, y: np.arctan(x / y) if np.iscomplexobj(x + y) else np.arctan2(x, y),
    "power": lambda x, y: x**2.5 + y**-1.5 + x**3 * y**-2 + y**0.5 + x**0,
    "power of a number": lambda x, y: x**y + 2.0**x,
    "negative": lambda x, y: -(x * y),
    "sqrt": lambda x, y: np.sqrt(x * x + y),
    "exp": lambda x, y: np.exp(x * y),
    "log": lambda x, y: np.log(x * y),
    "sin": lambda x, y: np.sin(x * y),
    "cos": lambda x, y: np.cos(x * y),
    "tan": lambda x, y: np.tan(x * y),
    "sinh": lambda x, y: np.sinh(x * y),
    "cosh": lambda x, y: np.cosh(x * y),
    "tanh": lambda x, y: np.tanh(x * y),
    "arctan": lambda x, y: np.arctan(x * y),
    "arcsin": lambda x, y: np.arcsin(x * y / 4),
    "square": lambda x, y: np.square(x * y),
    "reciprocal": lambda x, y: np.reciprocal(x * y),
    "called": lambda x, y: CALLED(x, y) * x,
}
CALLED = ExternalFunction(lambda x, y: np.exp(x) / y)
PLACE = np.array([0.7, 1.3])


def traced(formula):
    operations = Operations(2)
    x, y = Traced.array(operations, np.arange(2))
    return operations, Traced.numbers(operations, formula(x, y))


@pytest.mark.parametrize("name", FORMULAS)
def test_first_and_second_derivatives_are_complex_steps(name):
    formula = FORMULAS[name]
    operations, output = traced(formula)
    one = operations.constant(1.0)
    first = operations.along(output, {0: one}, {1: one})
    numbers = np.array([output, *first, *operations.along(np.stack(first), {0: one})[0]])
    value, *slopes = operations.compiled(numbers, range(2)).values(PLACE)
    assert value == pytest.approx(formula(*PLACE), rel=1e-14)

    def slope(i, x):
        return formula(*(x + 1j * STEP * np.eye(2)[i])).imag / STEP

    expected = [slope(0, PLACE), slope(1, PLACE)]
    assert slopes[:2] == pytest.approx(expected, rel=1e-13, abs=1e-14)
    h = np.array([1e-4, 0.0])
    second = [(slope(i, PLACE + h) - slope(i, PLACE - h)) / 2e-4 for i in range(2)]
    assert slopes[2:] == pytest.approx(second, rel=1e-6, abs=1e-8)
    backwards = operations.partials(int(output))
    numbers = np.array([backwards.get(i, operations.constant(0.0)) for i in range(2)])
    by_partials = operations.compiled(numbers, range(2)).values(PLACE)
    assert by_partials == pytest.approx(expected, rel=1e-13, abs=1e-14)


@pytest.mark.parametrize("name", FORMULAS)
def test_copies_have_the_same_numbers(name):
    operations, output = traced(FORMULAS[name])
    again = pickle.loads(pickle.dumps(operations)) if name != "called" else operations
    one = operations.constant(1.0)
    assert again.constant(1.0) == one
    assert again.rows(output) == operations.rows(output)
    assert np.array_equal(again.along(output, {0: one}), operations.along(output, {0: one}))
    assert again.inputs(output) == operations.inputs(output)


def test_what_is_known_is_not_listed_again():
    operations = Operations(2)
    x, y = Traced.array(operations, np.arange(2))
    assert (x * y).at == (x * y).at
    assert operations.trace.sizes() == (1, 0)
    zero, one = operations.constant(0.0), operations.constant(1.0)
    assert (0 * x).at == (x * 0.0).at == (0 / x).at == zero == operations.constant(-0.0)
    assert (1 * x).at == (x / 1).at == (x + 0).at == (0 + x).at == (x - 0).at == x.at
    assert operations.apply(np.add, one, one) == operations.constant(2.0)
    assert operations.value(operations.constant(2 + 3j)) == 2 + 3j
    assert operations.trace.sizes()[0] == 1


def test_numbers_that_do_not_fit_are_refused():
    trace = OperationTrace(2)
    product = trace.apply(2, 0, 1)
    call = trace.call(np.array([0, product], np.int32), 2)
    numbers = np.array([product, call + 1], np.int32)
    none = np.zeros((1, 2), np.int32)
    wrong = [
        lambda: OperationTrace(-1),
        lambda: trace.apply(99, 0, 1),
        lambda: trace.apply(2, 0, 77),
        lambda: trace.apply(2, -50, 0),
        lambda: trace.apply(2**40, 0, 0),
        lambda: trace.value(0),
        lambda: trace.value(-50),
        lambda: trace.power(99, 2.0),
        lambda: trace.call(np.array([99], np.int32), 1),
        lambda: trace.along(numbers + 90, none, lambda i, x: numbers),
        lambda: trace.along(numbers, none[:, :1], lambda i, x: numbers),
        lambda: trace.along(numbers, none + 90, lambda i, x: numbers),
        lambda: trace.along(numbers, none, lambda i, x: numbers[:1]),
        lambda: trace.along(numbers, none, lambda i, x: numbers + 90),
        lambda: trace.partials(99),
        lambda: trace.rows(numbers + 90),
        lambda: trace.inputs(numbers - 90),
        lambda: trace.placed(numbers, np.array([0], np.int32)),
        lambda: trace.placed(numbers, np.array([0, 99], np.int32)),
    ]
    for call in wrong:
        with pytest.raises((ValueError, TypeError)):
            call()
