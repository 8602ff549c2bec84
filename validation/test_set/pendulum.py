"""Simple pendulum in Cartesian coordinates (IFToMM library of benchmark problems, A01)."""

from typing import final

import numpy as np

from ancfdae.extend import SystemProperties
from ancfdae.numerics.arrays import Array
from validation.test_set.problem import TestProblem


@final
class SimplePendulum(TestProblem):
    """A point on a rod, let go from the horizontal at (-L, 0); design variables L, g and m."""

    title, source = "simple pendulum", "IFToMM library, A01"
    t_end, step = 2.0, 0.04
    published = -2.102437874436
    digits = 1e-12

    n_q, n_lam, design_names = 2, 1, ("L", "g", "m")
    values = (1.0, 9.81, 1.0)
    traits = SystemProperties(constant_mass=True, velocity_forces=False)

    def observed(self, q: Array, v: Array, b: Array) -> Array:
        """Return the momentum m v_x."""
        return b[2] * v[..., 0]

    def start(self) -> tuple[Array, Array]:
        """Return q and v at the start; q depends on the length L."""
        return np.array([-self.b[0], 0.0]), np.zeros(2)

    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix M, shape (n_q, n_q)."""
        return self.b[2] * np.eye(2)

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return the weight."""
        return np.array([0, -self.b[1] * self.b[2]])

    def position_constraint(self, t: float, q: Array) -> Array:
        """Return the constraints Phi, shape (n_lam,)."""
        return np.array([(q @ q - self.b[0] ** 2) / 2])

    def jacobian(self, t: float, q: Array) -> Array:
        """Return the constraint Jacobian Phi_q, shape (n_lam, n_q)."""
        return q[None]

    def gamma(self, t: float, q: Array, v: Array) -> Array:
        """Return d^2 Phi/dt^2 without accelerations."""
        return np.array([v @ v])
