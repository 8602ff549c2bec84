"""Car axis (Mazzia and Magherini, Test Set for IVP Solvers, release 2.4)."""

from typing import final

import numpy as np

from ancfdae.extend import SystemProperties
from ancfdae.numerics.arrays import Array
from validation.test_set.problem import TestProblem

# Length of the axis, circular frequency of the road, square of the small number eps.
_L, _OMEGA, _EPS2 = 1.0, 10.0, 1e-4


@final
class CarAxis(TestProblem):
    """Half of a car on a bumpy road; design variables L0, M and the height r of the bumps.

    Masses at the ends of a light rod of length L rest on springs of the length L0; the left one
    ends at the origin, where its direction stays across the road, the right one on the road at
    (sqrt(L^2 - y^2), y), y = r sin(omega t). The equations have M eps^2/2 as mass.
    """

    title, source = "car axis", "IVP test set"
    t_end, step = 3.0, 1e-2
    published = 0.493455784275402809122e-1
    digits = 1e-13

    n_q, n_lam, design_names = 4, 2, ("L0", "M", "r")
    values = (0.5, 10.0, 0.1)
    traits = SystemProperties(constant_mass=True, velocity_forces=False)

    def observed(self, q: Array, v: Array, b: Array) -> Array:
        """Return x_l, the x coordinate of the left end; m."""
        return q[..., 0]

    def start(self) -> tuple[Array, Array]:
        """Return the start: y_b' = r omega turns the left spring."""
        L0, _, r = self.b
        v = -L0 * r * _OMEGA / _L
        return np.array([0, L0, _L, L0]), np.array([v, 0, v, 0])

    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix M, shape (4, 4)."""
        return self.b[1] * _EPS2 / 2 * np.eye(4)

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return springs and weight."""
        ends = q[:2], q[2:] - self._road(t)[0]
        forces = [(self.b[0] / np.sqrt(end @ end) - 1) * end for end in ends]
        weight: Array = self.b[1] * _EPS2 / 2 * np.array([0, 1, 0, 1])
        return np.concatenate(forces) - weight

    def position_constraint(self, t: float, q: Array) -> Array:
        """Return the constraints Phi, shape (n_lam,)."""
        rod = q[:2] - q[2:]
        return np.array([q[:2] @ self._road(t)[0], rod @ rod - _L**2])

    def jacobian(self, t: float, q: Array) -> Array:
        """Return the constraint Jacobian Phi_q, shape (n_lam, n_q)."""
        rod = q[:2] - q[2:]
        return np.array([[*self._road(t)[0], 0, 0], [*(2 * rod), *(-2 * rod)]])

    def gamma(self, t: float, q: Array, v: Array) -> Array:
        """Return d^2 Phi/dt^2 without accelerations."""
        _, rate, second = self._road(t)
        turn = v[:2] - v[2:]
        return np.array([2 * v[:2] @ rate + q[:2] @ second, 2 * turn @ turn])

    def _road(self, t: float) -> tuple[Array, Array, Array]:
        """Return (x_b, y_b) and its first two time derivatives."""
        r = self.b[2]
        y, y_t = r * np.sin(_OMEGA * t), r * _OMEGA * np.cos(_OMEGA * t)
        y_tt = -(_OMEGA**2) * y
        x = np.sqrt(_L**2 - y * y)
        x_t = -y * y_t / x
        x_tt = -(y_t * y_t + y * y_tt + x_t * x_t) / x
        return np.array([x, y]), np.array([x_t, y_t]), np.array([x_tt, y_tt])
