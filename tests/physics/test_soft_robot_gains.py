"""Gains of a controller of a soft robot, against soromox 0.5.0 (PyPI; Stölzle and others, JAX).

A planar rod of one segment of constant strain (`PlanarPCS`) is clamped at one end, straight and at
rest. Its `PIDController` drives the angle of the tip to 0.8 rad by a torque there. The study of
gains in its repository does so by tendons. The cost is the integral of the squared error over 1 s.

soromox made the numbers below: `rollout_closed_loop_to` with Tsit5 at steps of 0.2 ms, the cost by
the trapezoidal rule over the steps, and central differences of that cost. Its own gradient, by
reverse mode, was -0.60995, -0.18355, 1.17246: 0.6 to 0.8 % beside the differences of its cost.
"""

import numpy as np
import pytest

from ancfdae import (
    DOP853,
    Adjoint,
    DirectDifferentiation,
    Integral,
    Radau,
    check_system,
    gradient,
)
from ancfdae.extend import FormulaSystem
from ancfdae.observables import custom

LENGTH, RADIUS, E, RHO, TARGET = 0.3, 0.01, 1e6, 1070.0, 0.8
GAINS = (0.05, 0.1, 0.005)
COST = 0.06558605972327648
DIFFERENCES = (-0.6065207137015416, -0.18201917228177764, 1.1629893055808969)
AREA, MOMENT = np.pi * RADIUS**2, np.pi * RADIUS**4 / 4
# Gauss points of a unit length.
X, W = (lambda x, w: ((x + 1) / 2, w / 2))(*np.polynomial.legendre.leggauss(8))


class Segment(FormulaSystem):
    """Curvature k, stretch a - 1, shear c, and the integral of the error of the tip's angle.

    The section at s is turned by k s and lies at p = s sum w_j R(k s x_j) (a, c), by Gauss points.
    The integral z of the error e = target - L k obeys z'' = e', z(0) = 0 and z'(0) = e(0).
    """

    n_q, n_lam = 4, 0
    design_names = ("P", "I", "D")

    def __init__(self, b=GAINS):
        super().__init__(b)

    def with_values(self, b):
        return Segment(b)

    def start(self):
        return np.zeros(4), np.array([0.0, 0.0, 0.0, TARGET])

    @staticmethod
    def points(q, v):
        """Mass, partials of p, p'' at constant q', and s, of the Gauss points."""
        k, a, c = q[0], 1 + q[1], q[2]
        for x, w in zip(X, W, strict=True):
            s = LENGTH * x
            cos, sin, arm = np.cos(k * s * X), np.sin(k * s * X), s * X
            C, S = s * (W @ cos), s * (W @ sin)
            C_k, S_k = -s * (W @ (arm * sin)), s * (W @ (arm * cos))
            C_kk, S_kk = -s * (W @ (arm**2 * cos)), -s * (W @ (arm**2 * sin))
            J = np.array([[a * C_k - c * S_k, C, -S], [a * S_k + c * C_k, S, C]])
            turning = v[0] ** 2 * np.array([a * C_kk - c * S_kk, a * S_kk + c * C_kk])
            sliding = 2 * v[0] * np.array([v[1] * C_k - v[2] * S_k, v[1] * S_k + v[2] * C_k])
            yield w * LENGTH * RHO, J, turning + sliding, s

    def mass_matrix(self, q):
        M = np.zeros((4, 4), dtype=q.dtype)
        M[3, 3] = 1.0
        for m, J, _, s in self.points(q, q):
            M[:3, :3] += m * AREA * (J.T @ J)
            M[0, 0] += m * MOMENT * s * s
        return M

    def force(self, t, q, v):
        P, I, D = self.b
        torque = P * (TARGET - LENGTH * q[0]) + I * q[3] - D * LENGTH * v[0]
        stiffness = LENGTH * np.array([E * MOMENT, E * AREA, E / 2 * AREA])
        inner = -stiffness * q[:3]
        for m, J, turning, _ in self.points(q, v):
            inner = inner - m * AREA * (J.T @ turning)
        return np.concatenate([inner + torque * np.array([LENGTH, 0, 0]), [-LENGTH * v[0]]])

    def position_constraint(self, t, q):
        return np.zeros(0)


@pytest.mark.parametrize(
    ("integrator", "method"),
    [(DOP853(1e-10), DirectDifferentiation()), (Radau(2e-3), Adjoint())],
)
def test_cost_and_derivatives_in_the_gains_are_those_of_soromox(integrator, method):
    """The trapezoidal rule over steps h errs by h^2 |f'(1)| / 12, 5e-8 of the cost."""
    segment = Segment()
    error = custom(lambda t, q, v, lam, b: (LENGTH * q[:, 0] - TARGET) ** 2)
    found = gradient(segment, Integral(error), 1.0, integrator, method=method)
    assert found.value == pytest.approx(COST, rel=1e-7)
    assert found.gradient == pytest.approx(DIFFERENCES, rel=1e-6)


def test_the_formulas_of_the_segment_hold():
    check_system(Segment(), samples=1).raise_if_wrong()
