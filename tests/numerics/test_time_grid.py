"""Integrals and values between instants have the degree that a grid promises."""

from math import factorial

import numpy as np
import pytest

from ancfdae.numerics.time_grid import LOBATTO_DEGREE, TimeGrid

T_END = 1.7


def powers(t, degree):
    return (np.asarray(t) / T_END) ** degree


@pytest.mark.parametrize("panels", [1, 2, 5])
def test_lobatto_instants_run_from_zero_to_the_end_in_equal_panels(panels):
    t = TimeGrid.lobatto(T_END, panels).t
    assert len(t) == LOBATTO_DEGREE * panels + 1
    assert np.all(np.diff(t) > 0)
    assert (t[0], t[-1]) == (0.0, T_END)
    ends = T_END * np.arange(panels + 1) / panels
    np.testing.assert_allclose(t[::LOBATTO_DEGREE], ends, rtol=1e-15)
    np.testing.assert_allclose(t, T_END - t[::-1], atol=1e-15 * T_END)


@pytest.mark.parametrize("panels", [1, 3])
@pytest.mark.parametrize("degree", range(16))
def test_lobatto_quadrature_is_exact_to_degree_15(panels, degree):
    grid = TimeGrid.lobatto(T_END, panels)
    assert grid.weights() @ powers(grid.t, degree) == pytest.approx(T_END / (degree + 1), rel=1e-13)


def test_lobatto_quadrature_is_not_exact_at_degree_16():
    grid = TimeGrid.lobatto(T_END, 1)
    error = grid.weights() @ powers(grid.t, 16) / T_END - 1 / 17
    # Known error of the rule of n = 9 points on (-1, 1) for f with constant f^(16), here 16!/2^16,
    # in parts of the length 2 of the interval (Abramowitz & Stegun 25.4.32; it is negative).
    n = 9
    known = n * (n - 1) ** 3 * 2 ** (2 * n - 1) * factorial(n - 2) ** 4
    known /= (2 * n - 1) * factorial(2 * n - 2) ** 3
    assert error == pytest.approx(known * factorial(16) / 2**16 / 2, rel=1e-5)


@pytest.mark.parametrize("degree", range(9))
def test_interpolation_is_exact_to_degree_8(degree):
    grid = TimeGrid.lobatto(T_END, 3)
    values = powers(grid.t, degree)
    for time in np.linspace(0, T_END, 41):
        instants, weights = grid.interpolation(time)
        assert weights @ values[instants] == pytest.approx(powers(time, degree), abs=1e-13)


def test_interpolation_is_not_exact_at_degree_9():
    grid = TimeGrid.lobatto(T_END, 1)
    instants, weights = grid.interpolation(0.4 * T_END)
    assert abs(weights @ powers(grid.t, 9)[instants] - 0.4**9) > 1e-7


@pytest.mark.parametrize("count", [1, 2, 4, 8])
def test_a_last_panel_cut_short_keeps_the_degree_that_its_instants_allow(count):
    whole = TimeGrid.lobatto(T_END, 3)
    t = whole.t[: 2 * LOBATTO_DEGREE + count + 1]
    cut = TimeGrid(t, LOBATTO_DEGREE)
    weights, last = cut.weights(), t[-1] / T_END
    for degree in range(count + 1):
        exact = T_END * last ** (degree + 1) / (degree + 1)
        assert weights @ powers(t, degree) == pytest.approx(exact, rel=1e-13)
        time = 0.5 * (t[-2] + t[-1])
        instants, share = cut.interpolation(time)
        assert share @ powers(t, degree)[instants] == pytest.approx(powers(time, degree), rel=1e-12)
    # Whole panels are untouched.
    first = slice(0, 2 * LOBATTO_DEGREE)
    np.testing.assert_array_equal(weights[first], whole.weights()[first])


def test_a_run_that_ended_at_its_start_integrates_to_zero():
    grid = TimeGrid(np.zeros(1), LOBATTO_DEGREE)
    np.testing.assert_array_equal(grid.weights(), [0.0])
    assert grid.interpolation(0.0)[0] == slice(0, 1)


@pytest.mark.parametrize("count", [2, 3, 10])
def test_degree_one_is_the_trapezoidal_rule_with_cubics_between_steps(count):
    rng = np.random.default_rng(0)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 1.0, count - 1))])
    values, grid = rng.standard_normal(count), TimeGrid(t, 1)
    assert grid.weights() @ values == pytest.approx(np.trapezoid(values, t), rel=1e-14)
    degree = min(3, count - 1)
    cubic = np.polynomial.Polynomial(rng.standard_normal(degree + 1))
    for time in rng.uniform(0, t[-1], 20):
        instants, weights = grid.interpolation(time)
        assert weights @ cubic(t)[instants] == pytest.approx(cubic(time), rel=1e-10)
        # The step itself lies in the middle of the four, except at the ends of the run.
        step = np.searchsorted(t, time) - 1
        assert instants.start <= step
        assert instants.stop >= step + 2


@pytest.mark.parametrize("degree", [1, LOBATTO_DEGREE])
def test_a_time_that_is_an_instant_but_for_round_off_is_that_instant(degree):
    grid = TimeGrid(TimeGrid.lobatto(T_END, 2).t, degree)
    for index in (0, 3, LOBATTO_DEGREE, len(grid.t) - 1):
        instants, weights = grid.interpolation(grid.t[index] * (1 + 1e-15))
        assert instants == slice(index, index + 1)
        np.testing.assert_array_equal(weights, [1.0])
