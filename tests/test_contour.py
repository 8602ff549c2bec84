"""Derivatives by sums over circles: when a circle resolves a function, and when none does."""

import numpy as np
import pytest

from ancfdae import InvalidInput
from ancfdae.numerics.contour import circle_size, derivative


def test_circles_shrink_until_a_near_pole_is_out_of_reach():
    # 1/(1 - z/1.2) on the unit circle: 24 points alias 1.2^-24 = 1.3 % into every coefficient.
    def f(z):
        return np.array([1 / (1 - z / 1.2)])

    assert circle_size(f, 1.0) is None
    for order, expected in ((2, 2 / 1.2**2), (3, 6 / 1.2**3)):
        # eps k! (R/r)^k with R/r = 19 where the pole is far enough.
        assert derivative(f, (1.0,), order)[0] == pytest.approx(expected, rel=1e-10)


def test_what_does_not_vary_as_a_power_series_is_refused():
    with pytest.raises(InvalidInput, match="analytic"):
        derivative(lambda z: np.array([np.sqrt(z * z)]), (1.0,), 2)


def test_round_off_of_large_terms_is_none_of_the_function():
    # What is left of 1e3 is noise of 1e-13 on every circle: no series, but nothing either.
    def f(z):
        return np.array([(np.exp(z) + 1e3) - 1e3 - np.exp(z)])

    with pytest.raises(InvalidInput, match="analytic"):
        derivative(f, (1.0,), 2)
    assert abs(derivative(f, (1.0,), 2, lambda: np.array([1e3]))[0]) < 1e-11


@pytest.mark.parametrize(
    ("radius", "order"), [(0.0, 1), (0.0, 2), (1e-170, 2), (1e-110, 3), (np.nan, 1), (np.nan, 2)]
)
def test_a_state_that_no_circle_is_small_enough_for_has_no_derivative(radius, order):
    # Its powers are zero: the velocity of a run that diverges, not a function to be refused.
    assert np.isnan(derivative(lambda z: np.array([np.sin(z), z]), (radius,), order)).all()
