"""Flexible slider-crank (B. Simeon, Math. Modelling of Systems 2, 1996; Test Set for IVP Solvers).

A rigid crank turns at a constant rate; the rod bends in two sine modes (amplitudes q_1, q_2) and
stretches between two nodes of a quadratic function (displacements q_3, q_4); linear stiffness, no
damping, no gravity. With phi_1, phi_2 the angles of crank and rod, x_3 the slider, and
q = (phi_1, phi_2, x_3, q_1, ..., q_4), the velocities give the rod's points

    l_1 e(phi_1)' + ((x + u, w) turned by phi_2)',

so that with C = cos(phi_1 - phi_2), S = sin(phi_1 - phi_2) the mass matrix has the entries below.
"""

from typing import Final, final

import numpy as np

from ancfdae.extend import SystemProperties
from ancfdae.numerics.arrays import Array
from validation.test_set.problem import TestProblem

# Masses and inertias of crank, rod and slider; lengths; density and width of the rod; rate.
_J1, _M2, _J2, _L1, _L2 = 0.002727, 0.151104, 0.0045339259, 0.15, 0.30
_RHO, _WIDTH, _OMEGA = 7870.0, 0.008, 150.0
# As the source has it.
_PI: Final = 3.1415927


@final
class FlexibleCrank(TestProblem):
    """The mechanism; design variables E and the height of the rod, and the mass of the slider."""

    title, source = "flexible slider-crank", "IVP test set"
    t_end, step = 0.1, 1e-4
    published = 1.893192460247178e-4
    # The source's start is consistent to nine digits.
    digits = 1e-6

    n_q, n_lam, design_names = 7, 3, ("E", "h", "m_3")
    values = (0.2e12, 0.008, 0.075552)
    traits = SystemProperties(constant_mass=False, velocity_forces=True)

    def observed(self, q: Array, v: Array, b: Array) -> Array:
        """Return q_1, the amplitude of the first bending mode."""
        return q[..., 3]

    def start(self) -> tuple[Array, Array]:
        """Return the start on the slow motion, where the rod is in line with the crank."""
        q3, q4 = 0.103339863e-4, 0.169327969e-4
        bend, rates = 0.444896105, (0.463434311e-2, -0.178591076e-5, -0.268938672e-5)
        q = np.array([0, 0, _L1 + _L2 + q4, 0, 0, q3, q4])
        turn = -_OMEGA * _L1 / (_L2 + q4)
        return q, np.array([_OMEGA, turn, rates[-1], bend, *rates])

    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix M, shape (n_q, n_q)."""
        M_q, _, B, c1, c2, c12, c21 = self._rod()
        u = q[3:]
        C, S = np.cos(q[0] - q[1]), np.sin(q[0] - q[1])
        coupled = 0.5 * _L1 * _L2 * _M2 * C + _RHO * _L1 * (S * (c2 @ u) + C * (c1 @ u))
        M = np.zeros((7, 7), dtype=np.result_type(M_q, q))
        M[0, 0] = _J1 + _M2 * _L1**2
        M[0, 1] = M[1, 0] = coupled
        M[1, 1] = _J2 + u @ M_q @ u + 2 * _RHO * (c12 @ u)
        M[2, 2] = self.b[2]
        M[0, 3:] = M[3:, 0] = _RHO * _L1 * (C * c2 - S * c1)
        M[1, 3:] = M[3:, 1] = _RHO * (c21 + u @ B)
        M[3:, 3:] = M_q
        return M

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return forces of stiffness and the terms of inertia that are quadratic in v."""
        M_q, K, B, c1, c2, c12, _ = self._rod()
        u, w, (v1, v2) = q[3:], v[3:], v[:2]
        C, S = np.cos(q[0] - q[1]), np.sin(q[0] - q[1])
        rigid = 0.5 * _L1 * _L2 * _M2 * S
        along, across = C * c1 + S * c2, C * c2 - S * c1
        crank = -rigid * v2**2 + _RHO * _L1 * (v2**2 * (across @ u) - 2 * v2 * (along @ w))
        rod = rigid * v1**2 - _RHO * _L1 * v1**2 * (across @ u)
        rod = rod - 2 * v2 * (_RHO * (c12 @ w) + w @ M_q @ u) - _RHO * (w @ B @ w)
        bent = v2**2 * (M_q @ u + _RHO * c12) + _RHO * (_L1 * v1**2 * along + 2 * v2 * (B @ w))
        return np.array([crank, rod, 0, *(bent - K @ u)])

    def position_constraint(self, t: float, q: Array) -> Array:
        """Return the constraints Phi, shape (n_lam,)."""
        l2 = _L2 + q[6]
        return np.array(
            [
                _L1 * np.sin(q[0]) + l2 * np.sin(q[1]),
                q[2] - _L1 * np.cos(q[0]) - l2 * np.cos(q[1]),
                q[0] - _OMEGA * t,
            ]
        )

    def jacobian(self, t: float, q: Array) -> Array:
        """Return the constraint Jacobian Phi_q, shape (n_lam, n_q)."""
        l2, (s1, s2), (c1, c2) = _L2 + q[6], np.sin(q[:2]), np.cos(q[:2])
        return np.array(
            [
                [_L1 * c1, l2 * c2, 0, 0, 0, 0, s2],
                [_L1 * s1, l2 * s2, 1, 0, 0, 0, -c2],
                [1, 0, 0, 0, 0, 0, 0],
            ]
        )

    def gamma(self, t: float, q: Array, v: Array) -> Array:
        """Return d^2 Phi/dt^2 without accelerations."""
        l2, (s1, s2), (c1, c2) = _L2 + q[6], np.sin(q[:2]), np.cos(q[:2])
        across = -_L1 * s1 * v[0] ** 2 - l2 * s2 * v[1] ** 2 + 2 * v[1] * c2 * v[6]
        along = _L1 * c1 * v[0] ** 2 + l2 * c2 * v[1] ** 2 + 2 * v[1] * s2 * v[6]
        return np.array([across, along, 0])

    def _rod(self) -> tuple[Array, ...]:
        """Return M_q, K, B and the vectors c_1, c_2, c_12, c_21 of the rod's shape functions."""
        E, height, _ = self.b
        volume = _WIDTH * height * _L2
        M_q = _RHO * volume * np.array([[0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 8, 1], [0, 0, 1, 2]])
        slender = (height / _L2) ** 2 * _PI**4
        K = np.zeros((4, 4), dtype=np.result_type(E, height))
        K[0, 0], K[1, 1] = slender / 24, slender * 2 / 3
        K[2:, 2:] = np.array([[16, -8], [-8, 7]]) / 3
        third = 8 / _PI**3 - 1 / _PI
        B = np.zeros((4, 4))
        B[0, 2:], B[1, 3] = (-16 / _PI**3, third), 0.5 / _PI
        vectors = ([0, 0, 2 / 3, 1 / 6], [2 / _PI, 0, 0, 0])
        moments = ([0, 0, 1 / 3, 1 / 6], [1 / _PI, -0.5 / _PI, 0, 0])
        c1, c2 = (volume * np.array(x) for x in vectors)
        c12, c21 = (_L2 * volume * np.array(x) for x in moments)
        return M_q, E * _WIDTH * height / _L2 * K, volume * (B - B.T), c1, c2, c12, c21
