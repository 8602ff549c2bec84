"""Time derivatives of functions by interpolation."""

import numpy as np
from numpy.polynomial import chebyshev

# Derivatives along a curve: an interpolant of degree DEGREE at Chebyshev points of [t - WINDOW,
# t + WINDOW]. Truncation: the curve is cubic and laws have frequencies below 4 rad/s, so that
# coefficients fall like (4 WINDOW / 2)^n / n! and the last is below 1e-18. Round-off: DEGREE
# coefficients of 1 eps, times T_n''' < n^3 at the middle, over WINDOW^3: 16 * 4096 * eps * 64 =
# 1e-9 at worst, relative to Phi.
DEGREE, WINDOW = 16, 0.25
CURVE = 1e-9


def rates_of(function, t):
    """Values of function and of its first three time derivatives at t, stacked."""
    nodes = chebyshev.chebpts1(DEGREE + 1)
    values = np.array([function(t + WINDOW * x) for x in nodes])
    coefficients = chebyshev.chebfit(nodes, values.reshape(len(nodes), -1), DEGREE)
    rates = [
        chebyshev.chebval(0.0, chebyshev.chebder(coefficients, n)) / WINDOW**n for n in range(4)
    ]
    return np.array(rates).reshape(4, *values.shape[1:])
