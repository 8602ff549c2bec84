"""Slider-crank of the SUNDIALS example ``idasSlCrank_FSA_dns`` (C. Petra and R. Serban, LLNL).

Crank angle q, slider x, angle p of the rod; a damped spring joins the middles of crank and rod.
With the square of its length and the tension over the length

    N = x^2 - x (cos p + a cos q) + (1 + a^2)/4 + (a/2) cos(p - q),
    f = k (1 - l_0/sqrt N) + c N'/(2 N),

the forces are Q = -f N_q/2 + (0, F, -F sin p), and the loop closes by

    Phi = (x, 0) - a e(q) - e(p) = 0,   e(s) = (cos s, sin s).

Every derivative below is one of N, f and e; those in k and c are complex steps.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from ancfdae import Integral
from ancfdae.extend import StateDirection
from ancfdae.numerics.arrays import Array
from ancfdae.observables import custom
from ancfdae.sensitivity.objectives import Objective
from validation.external.scleronomic import Scleronomic

_CRANK: Final = 0.5  # Length of the crank, a; that of the rod is 1.
_INERTIA: Final = np.array([1.0, 1.0, 2.0])  # J_1, m_2, J_2.
_FREE_LENGTH: Final = 1.0  # l_0.
_PUSH: Final = 1.0  # F.
_ARMS: Final = np.array([_CRANK, 1.0])
_ANGLES: Final = np.array([0, 2])  # Places of q and p among the coordinates.


@dataclass(frozen=True)
class _Spring:
    """The spring at one state: n = N_q, w = N' = n v, and f as a function of N and w."""

    N: Array
    n: Array
    H: Array
    w: Array
    f: Array
    f_N: Array
    f_w: Array


class SliderCrank(Scleronomic):
    """The mechanism with the stiffness k and the damping c of its spring as design variables."""

    def __init__(self, b: npt.ArrayLike = (1.0, 1.0)) -> None:
        super().__init__(np.diag(_INERTIA), ("slider", "guide"), ("k", "c"), b)

    def with_values(self, b: Array) -> Self:
        """Return the mechanism with another spring."""
        return type(self)(b)

    def start(self) -> tuple[Array, Array]:
        """Return the crank upright, at rest."""
        p = np.arcsin(-_CRANK)
        return np.array([np.pi / 2, np.cos(p), p]), np.zeros(3)

    # -- forces --------------------------------------------------------------------------------

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return the force Q, shape (n_q,)."""
        s = self._spring(q, v)
        return -0.5 * s.f * s.n + _PUSH * np.array([0.0, 1.0, -np.sin(q[2])])

    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Return Q_q dq + Q_v dv."""
        s, dq, dv = self._spring(q, v), direction.q, direction.v
        n_s = s.H @ dq
        f_s = s.f_N * (s.n @ dq) + s.f_w * (v @ n_s + s.n @ dv)
        push = np.array([0.0, 0.0, -_PUSH * np.cos(q[2]) * dq[2]])
        return -0.5 * (f_s * s.n + s.f * n_s) + push

    def _spring(self, q: Array, v: Array) -> _Spring:
        a, k, c, x = _CRANK, self.b[0], self.b[1], q[1]
        (c_q, c_p), (s_q, s_p) = np.cos(q[_ANGLES]), np.sin(q[_ANGLES])
        c_21, s_21 = np.cos(q[2] - q[0]), np.sin(q[2] - q[0])
        N = x * x - x * (c_p + a * c_q) + (1 + a * a) / 4 + 0.5 * a * c_21
        n = np.array([a * (x * s_q + 0.5 * s_21), 2 * x - c_p - a * c_q, x * s_p - 0.5 * a * s_21])
        bend = 0.5 * a * c_21
        H = np.array(
            [[a * x * c_q - bend, a * s_q, bend], [a * s_q, 2.0, s_p], [bend, s_p, x * c_p - bend]]
        )
        w = n @ v
        stretch, rate = 1 - _FREE_LENGTH / np.sqrt(N), w / (2 * N)
        f_N = 0.5 * k * _FREE_LENGTH * N**-1.5 - c * rate / N
        return _Spring(N, n, H, w, k * stretch + c * rate, f_N, c / (2 * N))

    # -- constraints ---------------------------------------------------------------------------

    def constraint(self, t: float, *motion: Array) -> Array:
        """Return Phi and its rates: (x, 0) less those of both directions e, by the chain rule."""
        q, *rates = motion
        e, normal = _directions(q)
        w, *turns = [rate[_ANGLES] for rate in rates] or [np.zeros(2)]
        turned = [e, w * normal]
        if len(rates) > 1:
            turned.append(turns[0] * normal - w**2 * e)
        if len(rates) > 2:
            turned.append((turns[1] - w**3) * normal - 3 * w * turns[0] * e)
        return np.array([motion[-1][1], 0.0]) - turned[len(rates)] @ _ARMS

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Return Phi_q and dPhi_q/dt."""
        if len(motion) > 2:
            return super().constraint_q(t, *motion)
        e, normal = _directions(motion[0])
        if len(motion) == 2:
            return _spread(_ARMS * motion[1][_ANGLES] * e).ravel()
        Phi_q = _spread(-_ARMS * normal)
        Phi_q[0, 1] = 1.0
        return Phi_q.ravel()


def kinetic_energy_integral() -> Objective:
    """Return G, the integral of (J_1 q'^2 + m_2 x'^2 + J_2 p'^2)/2 over the run."""

    def energy(t: Array, q: Array, v: Array, lam: Array, b: Array) -> Array:
        return v**2 @ (0.5 * _INERTIA)

    return Integral(custom(energy, "kinetic energy"))


def _directions(q: Array) -> tuple[Array, Array]:
    """Return e and e' of both angles as columns, shape (2, 2)."""
    cosine, sine = np.cos(q[_ANGLES]), np.sin(q[_ANGLES])
    return np.array([cosine, sine]), np.array([-sine, cosine])


def _spread(columns: Array) -> Array:
    """Put two columns at the places of the angles."""
    matrix = np.zeros((2, 3), dtype=columns.dtype)
    matrix[:, _ANGLES] = columns
    return matrix
