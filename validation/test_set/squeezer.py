"""Andrews' squeezing mechanism (Test Set for IVP Solvers; Hairer & Wanner, Solving ODEs II, VII.7).

Seven bodies in a plane, driven by a constant torque, one spring; the angles are
q = (beta, Theta, gamma, Phi, delta, Omega, epsilon).
"""

from typing import Final, final

import numpy as np

from ancfdae.extend import SystemProperties
from ancfdae.numerics.arrays import Array
from validation.test_set.problem import TestProblem

_m1, _m2, _m3, _m4, _m5, _m6 = 0.04325, 0.00365, 0.02373, 0.00706, 0.07050, 0.00706
_xa, _ya, _xb, _yb, _xc, _yc = -0.06934, -0.00227, -0.03635, 0.03273, 0.014, 0.072
_i1, _i2, _i3, _i4, _i5, _i6, _i7 = (
    2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5,
)  # fmt: skip
_d, _da, _e, _ea, _rr, _ra, _l0 = 28e-3, 115e-4, 2e-2, 1421e-5, 7e-3, 92e-5, 7785e-5
_ss, _sa, _sb, _sc, _sd = 35e-3, 1874e-5, 1043e-5, 18e-3, 2e-2
_ta, _tb, _u, _ua, _ub, _zf, _zt, _fa = (
    2308e-5, 916e-5, 4e-2, 1228e-5, 449e-5, 2e-2, 4e-2, 1421e-5,
)  # fmt: skip
_e4, _f6 = _e - _ea, _zf - _fa
# Angles to the x axis are _SUMS q. With e(s) = (cos s, sin s) the chain over the crank ends where
# each of three others does: Phi = sum over k of _ALONG e(s_k) + _ACROSS e(s_k + pi/2), less _ENDS.
_SUMS: Final = np.array(
    [
        [1, 0, 0, 0, 0, 0, 0],
        [1, 1, 0, 0, 0, 0, 0],
        [0, 0, 1, 0, 0, 0, 0],
        [0, 0, 0, 1, 1, 0, 0],
        [0, 0, 0, 0, 1, 0, 0],
        [0, 0, 0, 0, 0, 1, 1],
        [0, 0, 0, 0, 0, 0, 1],
    ]
)
_ALONG: Final = np.array(
    [[_rr, -_d, 0, 0, 0, 0, 0], [_rr, -_d, 0, 0, -_zt, 0, 0], [_rr, -_d, 0, 0, 0, -_zf, 0]]
)
_ACROSS: Final = np.array([[0, 0, _ss, 0, 0, 0, 0], [0, 0, 0, _e, 0, 0, 0], [0, 0, 0, 0, 0, 0, _u]])
_ENDS: Final = np.array([_xb, _xa, _xa, _yb, _ya, _ya])
_START: Final = np.array(
    [
        -0.0617138900142764496358948458001,
        0.0,
        0.455279819163070380255912382449,
        0.222668390165885884674473185609,
        0.487364979543842550225598953530,
        -0.222668390165885884674473185609,
        1.23054744454982119249735015568,
    ]
)


@final
class Squeezer(TestProblem):
    """The mechanism; design variables are the torque, the spring and the mass of body 7."""

    title, source = "Andrews' squeezer", "IVP test set"
    t_end, step = 0.03, 2.5e-5
    published = 15.81077119629904
    digits = 1e-11

    n_q, n_lam, design_names = 7, 6, ("mom", "c0", "m7")
    values = (0.033, 4530.0, 0.05498)
    traits = SystemProperties(constant_mass=False, velocity_forces=True)

    def observed(self, q: Array, v: Array, b: Array) -> Array:
        """Return beta, the angle of the crank."""
        return q[..., 0]

    def start(self) -> tuple[Array, Array]:
        """Return the start at rest."""
        return _START, np.zeros(7)

    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix M, shape (7, 7)."""
        c_th, s_ph, s_om = np.cos(q[1]), np.sin(q[3]), np.sin(q[5])
        M = np.zeros((7, 7), dtype=np.result_type(q, self.b))
        M[0, 0] = _m1 * _ra**2 + _m2 * (_rr**2 - 2 * _da * _rr * c_th + _da**2) + _i1 + _i2
        M[0, 1] = M[1, 0] = _m2 * (_da**2 - _da * _rr * c_th) + _i2
        M[1, 1] = _m2 * _da**2 + _i2
        M[2, 2] = _m3 * (_sa**2 + _sb**2) + _i3
        M[3, 3] = _m4 * _e4**2 + _i4
        M[3, 4] = M[4, 3] = _m4 * (_e4**2 + _zt * _e4 * s_ph) + _i4
        M[4, 4] = _m4 * (_zt**2 + 2 * _zt * _e4 * s_ph + _e4**2) + _i4
        M[4, 4] += _m5 * (_ta**2 + _tb**2) + _i5
        M[5, 5] = _m6 * _f6**2 + _i6
        M[5, 6] = M[6, 5] = _m6 * (_f6**2 - _u * _f6 * s_om) + _i6
        M[6, 6] = _m6 * (_f6**2 - 2 * _u * _f6 * s_om + _u**2) + _i6
        M[6, 6] += self.b[2] * (_ua**2 + _ub**2) + _i7
        return M

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return torque, spring, and the terms of inertia that are quadratic in v."""
        mom, c0, _ = self.b
        c_ga, s_ga = np.cos(q[2]), np.sin(q[2])
        arm = np.array([_sd * c_ga + _sc * s_ga, _sd * s_ga - _sc * c_ga])
        span = arm + np.array([_xb - _xc, _yb - _yc])
        pull = -c0 * (1 - _l0 / np.sqrt(span @ span)) * span
        two, four, six = _m2 * _da * _rr, _m4 * _zt * _e4, _m6 * _u * _f6
        return np.array(
            [
                mom - two * v[1] * (v[1] + 2 * v[0]) * np.sin(q[1]),
                two * v[0] ** 2 * np.sin(q[1]),
                pull[1] * arm[0] - pull[0] * arm[1],
                four * v[4] ** 2 * np.cos(q[3]),
                -four * v[3] * (v[3] + 2 * v[4]) * np.cos(q[3]),
                -six * v[6] ** 2 * np.cos(q[5]),
                six * v[5] * (v[5] + 2 * v[6]) * np.cos(q[5]),
            ]
        )

    def position_constraint(self, t: float, q: Array) -> Array:
        """Return the constraints Phi, shape (n_lam,)."""
        return np.sum(_chains(_SUMS @ q), axis=1) - _ENDS

    def jacobian(self, t: float, q: Array) -> Array:
        """Return the constraint Jacobian Phi_q, shape (n_lam, n_q)."""
        return _chains(_SUMS @ q + np.pi / 2) @ _SUMS

    def gamma(self, t: float, q: Array, v: Array) -> Array:
        """Return d^2 Phi/dt^2 without accelerations."""
        return -_chains(_SUMS @ q) @ (_SUMS @ v) ** 2


def _chains(angles: Array) -> Array:
    """Return the links at the angles, shape (6, 7): x of three chains, then y."""
    x = _ALONG * np.cos(angles) - _ACROSS * np.sin(angles)
    y = _ALONG * np.sin(angles) + _ACROSS * np.cos(angles)
    return np.concatenate([x, y])
