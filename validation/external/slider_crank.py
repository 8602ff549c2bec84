"""Slider-crank of the SUNDIALS example ``idasSlCrank_FSA_dns`` (C. Petra and R. Serban, LLNL).

Crank angle q, slider x, angle p of the rod; a damped spring joins the middles of crank and rod.
With the square of its length and the tension over the length

    N = x^2 - x (cos p + a cos q) + (1 + a^2)/4 + (a/2) cos(p - q),
    f = k (1 - l_0/sqrt N) + c N'/(2 N),

the forces are Q = -f N_q/2 + (0, F, -F sin p), and the loop closes by

    Phi = (x, 0) - a e(q) - e(p) = 0,   e(s) = (cos s, sin s).

Every derivative below is one of N, f and e.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from ancfdae import Integral, custom
from ancfdae.objectives import Objective
from validation.external.scleronomic import Array, Scleronomic

__all__ = ["SliderCrank", "kinetic_energy_integral"]

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
    f_b: Array


class SliderCrank(Scleronomic):
    """The mechanism with the stiffness k and the damping c of its spring as design variables."""

    velocity_forces = True

    def __init__(self, b: npt.ArrayLike = (1.0, 1.0)) -> None:
        super().__init__(np.diag(_INERTIA), ("slider", "guide"), ("k", "c"), b)

    def with_values(self, b: Array) -> Self:
        """Return the mechanism with another spring."""
        return type(self)(b)

    def start(self) -> tuple[Array, Array]:
        """Return the crank upright, at rest."""
        p = np.arcsin(-_CRANK)
        return np.array([np.pi / 2, np.cos(p), p]), np.zeros(3)

    def start_b(self) -> tuple[Array, Array]:
        """Return zero."""
        return np.zeros((3, 2)), np.zeros((3, 2))

    # -- forces --------------------------------------------------------------------------------

    def force(self, q: Array, v: Array, t: float) -> Array:
        """Return Q."""
        s = self._spring(q, v)
        return -0.5 * s.f * s.n + _PUSH * np.array([0.0, 1.0, -np.sin(q[2])])

    def force_q(self, q: Array, v: Array, t: float) -> Array:
        """Return Q_q."""
        s = self._spring(q, v)
        f_q = s.f_N * s.n + s.f_w * (s.H @ v)
        Q_q = -0.5 * (np.outer(s.n, f_q) + s.f * s.H)
        Q_q[2, 2] -= _PUSH * np.cos(q[2])
        return Q_q.ravel()

    def force_v(self, q: Array, v: Array, t: float) -> Array:
        """Return Q_v."""
        s = self._spring(q, v)
        Q_v: Array = -0.5 * s.f_w * np.outer(s.n, s.n)
        return Q_v.ravel()

    def force_b(self, q: Array, v: Array, t: float) -> Array:
        """Return Q_b."""
        s = self._spring(q, v)
        Q_b: Array = -0.5 * np.outer(s.n, s.f_b)
        return Q_b

    def force_rate(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Return dQ/dt."""
        s = self._spring(q, v)
        n_t = s.H @ v
        f_t = s.f_N * s.w + s.f_w * (v @ n_t + s.n @ a)
        push = np.array([0.0, 0.0, -_PUSH * np.cos(q[2]) * v[2]])
        Q_t: Array = -0.5 * (f_t * s.n + s.f * n_t) + push
        return Q_t

    def force_rate_total(
        self, q: Array, v: Array, a: Array, t: float, q_b: Array, v_b: Array, a_b: Array
    ) -> Array:
        """Return the total design derivative of dQ/dt."""
        s, k, c = self._spring(q, v), self.b[0], self.b[1]
        H_t, n_t = _hessian_rate(q, v), s.H @ v
        w_t = v @ n_t + s.n @ a
        f_t = s.f_N * s.w + s.f_w * w_t
        N_b, n_b, n_tb = s.n @ q_b, s.H @ q_b, H_t @ q_b + s.H @ v_b
        w_b = n_t @ q_b + s.n @ v_b
        w_tb = v @ n_tb + n_t @ v_b + a @ n_b + s.n @ a_b
        f_NN = c * s.w / s.N**3 - 0.75 * k * _FREE_LENGTH * s.N**-2.5
        own = np.array([0.5 * _FREE_LENGTH * s.N**-1.5, -s.w / (2 * s.N**2)])
        f_Nb = f_NN * N_b - c / (2 * s.N**2) * w_b + own
        f_wb = np.array([0.0, 1.0]) / (2 * s.N) - c / (2 * s.N**2) * N_b
        f_b = s.f_N * N_b + s.f_w * w_b + s.f_b
        f_tb = f_Nb * s.w + s.f_N * w_b + f_wb * w_t + s.f_w * w_tb
        total = np.outer(s.n, f_tb) + f_t * n_b + np.outer(n_t, f_b) + s.f * n_tb
        push = np.zeros_like(total)
        push[2] = _PUSH * (np.sin(q[2]) * v[2] * q_b[2] - np.cos(q[2]) * v_b[2])
        return push - 0.5 * total

    def _spring(self, q: Array, v: Array) -> _Spring:
        a, k, c, x = _CRANK, self.b[0], self.b[1], q[1]
        (c_q, c_p), (s_q, s_p) = np.cos(q[_ANGLES]), np.sin(q[_ANGLES])
        c_21, s_21 = np.cos(q[2] - q[0]), np.sin(q[2] - q[0])
        N = x * x - x * (c_p + a * c_q) + (1 + a * a) / 4 + 0.5 * a * c_21
        n = np.array([a * (x * s_q + 0.5 * s_21), 2 * x - c_p - a * c_q, x * s_p - 0.5 * a * s_21])
        bend = 0.5 * a * c_21
        H = np.array(
            [
                [a * x * c_q - bend, a * s_q, bend],
                [a * s_q, 2.0, s_p],
                [bend, s_p, x * c_p - bend],
            ]
        )
        w = n @ v
        stretch, rate = 1 - _FREE_LENGTH / np.sqrt(N), w / (2 * N)
        f_N = 0.5 * k * _FREE_LENGTH * N**-1.5 - c * rate / N
        f_b = np.array([stretch, rate])
        return _Spring(N, n, H, w, k * stretch + c * rate, f_N, c / (2 * N), f_b)

    # -- constraints ---------------------------------------------------------------------------

    def constraint(self, q: Array, t: float) -> Array:
        """Return Phi."""
        e, _ = _directions(q)
        Phi: Array = np.array([q[1], 0.0]) - e @ _ARMS
        return Phi

    def constraint_q(self, q: Array, t: float) -> Array:
        """Return Phi_q."""
        _, normal = _directions(q)
        Phi_q = _spread(-_ARMS * normal)
        Phi_q[0, 1] = 1.0
        return Phi_q.ravel()

    def constraint_b(self, q: Array, t: float) -> Array:
        """Return zero."""
        return np.zeros((2, 2))

    def constraint_force(self, q: Array, lam: Array, t: float) -> Array:
        """Return Phi_q^T lam."""
        reaction: Array = self.constraint_q(q, t).reshape(2, 3).T @ lam
        return reaction

    def constraint_force_q(self, q: Array, lam: Array, t: float) -> Array:
        """Return (Phi_q^T lam)_q."""
        e, _ = _directions(q)
        pull = _ARMS * (lam @ e)
        return np.diag([pull[0], 0.0 * pull[0], pull[1]]).ravel()

    def constraint_q_times_total(self, q: Array, x: Array, t: float, q_b: Array) -> Array:
        """Return the total design derivative of Phi_q x."""
        e, _ = _directions(q)
        total: Array = (_ARMS * x[_ANGLES] * e) @ q_b[_ANGLES]
        return total

    def constraint_q_rate(self, q: Array, v: Array, t: float) -> Array:
        """Return dPhi_q/dt."""
        e, _ = _directions(q)
        return _spread(_ARMS * v[_ANGLES] * e).ravel()

    def constraint_q_second_rate(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Return d^2 Phi_q/dt^2."""
        (e, normal), w = _directions(q), v[_ANGLES]
        return _spread(_ARMS * (w**2 * normal + a[_ANGLES] * e)).ravel()

    def acceleration_side(self, q: Array, v: Array, t: float) -> Array:
        """Return gamma."""
        e, _ = _directions(q)
        gamma: Array = -e @ (_ARMS * v[_ANGLES] ** 2)
        return gamma

    def acceleration_side_total(
        self, q: Array, v: Array, t: float, q_b: Array, v_b: Array
    ) -> Array:
        """Return the total design derivative of gamma."""
        (e, normal), w = _directions(q), v[_ANGLES]
        on_q, on_v = -_ARMS * w**2 * normal, -2 * _ARMS * w * e
        total: Array = on_q @ q_b[_ANGLES] + on_v @ v_b[_ANGLES]
        return total

    def jerk_side(self, q: Array, v: Array, a: Array, t: float) -> Array:
        """Return S."""
        (e, normal), w = _directions(q), v[_ANGLES]
        S: Array = -(w**3 * normal + 3 * w * a[_ANGLES] * e) @ _ARMS
        return S

    def jerk_side_total(
        self, q: Array, v: Array, a: Array, t: float, q_b: Array, v_b: Array, a_b: Array
    ) -> Array:
        """Return the total design derivative of S."""
        (e, normal), w, w_t = _directions(q), v[_ANGLES], a[_ANGLES]
        on_q = _ARMS * (w**3 * e - 3 * w * w_t * normal)
        on_v = -3 * _ARMS * (w**2 * normal + w_t * e)
        on_a = -3 * _ARMS * w * e
        total: Array = on_q @ q_b[_ANGLES] + on_v @ v_b[_ANGLES] + on_a @ a_b[_ANGLES]
        return total

    def constraint_force_rate(self, q: Array, v: Array, lam: Array, t: float) -> Array:
        """Return (dPhi_q^T/dt) lam."""
        rate: Array = self.constraint_q_rate(q, v, t).reshape(2, 3).T @ lam
        return rate

    def constraint_force_rate_total(
        self, q: Array, v: Array, lam: Array, t: float, q_b: Array, v_b: Array, lam_b: Array
    ) -> Array:
        """Return the total design derivative of (dPhi_q^T/dt) lam."""
        (e, normal), w = _directions(q), v[_ANGLES, None]
        total = np.zeros((3, q_b.shape[1]), dtype=np.result_type(q, v, lam, q_b, v_b, lam_b))
        turned = (lam @ normal)[:, None] * w * q_b[_ANGLES]
        total[_ANGLES] = turned + (lam @ e)[:, None] * v_b[_ANGLES] + w * (e.T @ lam_b)
        total[_ANGLES] *= _ARMS[:, None]
        return total


def kinetic_energy_integral() -> Objective:
    """Return G, the integral of (J_1 q'^2 + m_2 x'^2 + J_2 p'^2)/2 over the run."""

    def energy(t: Array, q: Array, v: Array, lam: Array, b: Array) -> Array:
        return v**2 @ (0.5 * _INERTIA)

    return Integral(custom(energy, "kinetic energy"))


def _directions(q: Array) -> tuple[Array, Array]:
    """Return e and e' of both angles as columns, shape (2, 2)."""
    cosine, sine = np.cos(q[_ANGLES]), np.sin(q[_ANGLES])
    return np.stack([cosine, sine]), np.stack([-sine, cosine])


def _spread(columns: Array) -> Array:
    """Put two columns at the places of the angles."""
    matrix = np.zeros((2, 3), dtype=columns.dtype)
    matrix[:, _ANGLES] = columns
    return matrix


def _hessian_rate(q: Array, v: Array) -> Array:
    """Rate of the Hessian of N along v."""
    a, x = _CRANK, q[1]
    (c_q, c_p), (s_q, s_p) = np.cos(q[_ANGLES]), np.sin(q[_ANGLES])
    turn = 0.5 * a * np.sin(q[2] - q[0]) * (v[2] - v[0])
    return np.array(
        [
            [a * (c_q * v[1] - x * s_q * v[0]) + turn, a * c_q * v[0], -turn],
            [a * c_q * v[0], 0.0 * turn, c_p * v[2]],
            [-turn, c_p * v[2], c_p * v[1] - x * s_p * v[2] + turn],
        ]
    )
