"""Slider-crank of the SUNDIALS example ``idasSlCrank_FSA_dns`` (C. Petra and R. Serban, LLNL).

Crank angle q, slider x, angle p of the rod; a damped spring joins the middles of crank and rod, a
force F pulls the slider and the middle of the rod.
"""

from typing import final

import numpy as np

from ancfdae.extend import SystemProperties
from ancfdae.numerics.arrays import Array
from validation.test_set.problem import TestProblem

# Length of the crank (that of the rod is 1), J_1, m_2, J_2, free length of the spring.
_A, _INERTIA, _FREE = 0.5, np.array([1.0, 1.0, 2.0]), 1.0


@final
class CrankWithSpring(TestProblem):
    """The mechanism; design variables are the spring's stiffness k and damping c, and F."""

    title, source = "slider-crank with a spring", "SUNDIALS"
    t_end, step, integral = 10.0, 0.02, True
    published = 3.33661556
    digits = 1e-5

    n_q, n_lam, design_names = 3, 2, ("k", "c", "F")
    values = (1.0, 1.0, 1.0)
    traits = SystemProperties(constant_mass=True, velocity_forces=True)

    def observed(self, q: Array, v: Array, b: Array) -> Array:
        """Return the kinetic energy."""
        return v**2 @ (0.5 * _INERTIA)

    def start(self) -> tuple[Array, Array]:
        """Return the crank upright, at rest."""
        p = np.arcsin(-_A)
        return np.array([np.pi / 2, np.cos(p), p]), np.zeros(3)

    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix M, shape (n_q, n_q)."""
        return np.diag(_INERTIA)

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return the spring's pull on both middles, and F."""
        k, c, push = self.b
        (ca, cp), (sa, sp) = np.cos(q[::2]), np.sin(q[::2])
        # From the middle of the crank to that of the rod, and its derivatives with respect to q.
        apart = np.array([q[1] - (cp + _A * ca) / 2, -(sp + _A * sa) / 2])
        apart_q = np.array([[_A * sa / 2, 1, sp / 2], [-_A * ca / 2, 0, -cp / 2]])
        square = apart @ apart
        rate = apart @ apart_q @ v / square
        pull = k * (1 - _FREE / np.sqrt(square)) + c * rate
        return -pull * (apart @ apart_q) + push * np.array([0, 1, -sp])

    def position_constraint(self, t: float, q: Array) -> Array:
        """Return the constraints Phi, shape (n_lam,)."""
        (ca, cp), (sa, sp) = np.cos(q[::2]), np.sin(q[::2])
        return np.array([q[1] - _A * ca - cp, -_A * sa - sp])

    def jacobian(self, t: float, q: Array) -> Array:
        """Return the constraint Jacobian Phi_q, shape (n_lam, n_q)."""
        (ca, cp), (sa, sp) = np.cos(q[::2]), np.sin(q[::2])
        return np.array([[_A * sa, 1, sp], [-_A * ca, 0, -cp]])

    def gamma(self, t: float, q: Array, v: Array) -> Array:
        """Return d^2 Phi/dt^2 without accelerations."""
        (ca, cp), (sa, sp), (w, u) = np.cos(q[::2]), np.sin(q[::2]), v[::2] ** 2
        return np.array([_A * ca * w + cp * u, _A * sa * w + sp * u])
