"""Robertson's reactions (SUNDIALS, example ``idasHessian_ASA_FSA``), as velocities.

    y_1' = -p_1 y_1 + p_2 y_2 y_3,   y_3' = p_3 y_2^2,   y_1 + y_2 + y_3 = 1

With v = y and M = 1 these are equations of motion, y_2' = -y_1' - y_3', and q is the integral of y.
The example differentiates the integral of |y|^2/2 with respect to p_1 and p_2.
"""

from typing import Any, final

import numpy as np
from scipy.integrate import solve_ivp

from ancfdae.extend import SystemProperties
from ancfdae.numerics.arrays import Array
from validation.test_set.problem import TestProblem


@final
class Roberts(TestProblem):
    """The reactions; design variables are their rates."""

    title, source = "Robertson's reactions", "SUNDIALS"
    t_end, step, integral, stiff = 80.0, 0.1, True, True
    published = 25.042
    digits = 2e-5

    n_q, n_lam, design_names = 3, 0, ("p1", "p2", "p3")
    values = (0.04, 1e4, 3e7)
    traits = SystemProperties(constant_mass=True, velocity_forces=True)

    def observed(self, q: Array, v: Array, b: Array) -> Array:
        """Return |y|^2/2."""
        return np.sum(v * v, axis=-1) / 2

    def start(self) -> tuple[Array, Array]:
        """Return the start."""
        return np.zeros(3), np.array([1.0, 0.0, 0.0])

    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix M, shape (n_q, n_q)."""
        return np.eye(3)

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return the rates of the reactions."""
        p1, p2, p3 = self.b
        first, last = -p1 * v[0] + p2 * v[1] * v[2], p3 * v[1] ** 2
        return np.array([first, -first - last, last])

    def position_constraint(self, t: float, q: Array) -> Array:
        """Return an empty array: this problem has no constraints."""
        return np.zeros(0)

    def jacobian(self, t: float, q: Array) -> Array:
        """Return an empty array: this problem has no constraints."""
        return np.zeros((0, 3))

    def gamma(self, t: float, q: Array, v: Array) -> Array:
        """Return an empty array: this problem has no constraints."""
        return np.zeros(0)

    def reference(self, t_end: float, rtol: float) -> Array:
        """Return the objective and its gradient by SciPy's Radau and the variational equations."""
        p1, p2, p3 = self.b

        def rate(t: float, z: Any) -> Any:
            y, Y = z[:3], z[3:12].reshape(3, 3)
            a, c = np.array([-p1, p2 * y[2], p2 * y[1]]), np.array([0, 2 * p3 * y[1], 0])
            A = np.stack([a, -a - c, c])
            a_p, c_p = np.array([-y[0], y[1] * y[2], 0]), np.array([0, 0, y[1] ** 2])
            A_p = np.stack([a_p, -a_p - c_p, c_p])
            rates = self.force(t, y, y), (A @ Y + A_p).ravel(), [y @ y / 2], y @ Y
            return np.concatenate(rates)

        # Sizes of y, of y_p and of the integrals.
        sizes = np.array([1, 1e-4, 1])
        scale = np.concatenate([sizes, np.outer(sizes, 1 / self.b).ravel(), [30], 30 / self.b])
        start = np.concatenate([[1.0], np.zeros(15)])
        tolerances = {"rtol": max(rtol, 3e-14), "atol": rtol * 1e-3 * scale}
        return solve_ivp(rate, (0.0, t_end), start, "Radau", **tolerances).y[12:, -1]
