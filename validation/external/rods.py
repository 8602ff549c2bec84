"""Points joined by rigid massless rods: the Cartesian pendulum and the double four-bar.

With d_k = P_k q + c_k the vector along rod k, everything is quadratic:

    Phi_k = (d_k . d_k - l_k^2)/2,   Phi_qk = d_k^T P_k,   (Phi_q^T lam)_q = sum lam_k P_k^T P_k.

Design variables of both systems are a length L and the gravity g.
"""

from dataclasses import dataclass
from typing import Final, Self, final

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

from ancfdae.extend import StateDirection, SystemProperties
from ancfdae.numerics.arrays import Array
from validation.external.scleronomic import Scleronomic


@final
@dataclass(frozen=True)
class Geometry:
    """Numbers of a system of rods that no design variable changes.

    `ends` are P_k, shape (n_lam, 2, n_q), and `offsets` c_k, shape (n_lam, 2). Lengths of rods are
    l_k = 1 + shares_k (L - 1): a share is one for a rod of length L, zero for length 1. `weight`
    is the force at g = 1. The start is q = rest + L along, v = L across. Names are of the rods.
    """

    mass_matrix: Array
    ends: Array
    offsets: Array
    shares: Array
    weight: Array
    rest: Array
    along: Array
    across: Array
    names: tuple[str, ...]


class Rods(Scleronomic):
    """Points joined by rods under gravity; design variables L and g.

    Parameters
    ----------
    geometry : Geometry
    b : array_like
        L and g.
    """

    traits = SystemProperties(constant_mass=True, velocity_forces=False)

    def __init__(self, geometry: Geometry, b: npt.ArrayLike = (1.0, 9.81)) -> None:
        super().__init__(geometry.mass_matrix, geometry.names, ("L", "g"), b)
        self._geometry, self._P, self._c = geometry, geometry.ends, geometry.offsets
        self._flat = self._P.reshape(-1, self.n_q)

    def with_values(self, b: Array) -> Self:
        """Return the same points and rods at another L and g."""
        return type(self)(self._geometry, b)

    def start(self) -> tuple[Array, Array]:
        """Return the start, which depends on L."""
        L: float = self.b[0]
        return self._geometry.rest + L * self._geometry.along, L * self._geometry.across

    # -- forces --------------------------------------------------------------------------------

    def force(self, t: float, q: Array, v: Array) -> Array:
        """Return the force Q, shape (n_q,)."""
        return self.b[1] * self._geometry.weight

    def force_along(self, t: float, q: Array, v: Array, direction: StateDirection) -> Array:
        """Return the derivative of the force along a direction: zero, since it is constant."""
        return np.zeros(self.n_q)

    # -- constraints ---------------------------------------------------------------------------

    def constraint(self, t: float, *motion: Array) -> Array:
        """Return Phi and its rates, of |d|^2/2."""
        d, *rates = self._along(motion[0]) + self._c, *map(self._along, motion[1:])
        if not rates:
            lengths = 1 + self._geometry.shares * (self.b[0] - 1)
            return 0.5 * (_dot(d, d) - lengths**2)
        rate: Array = _dot(d, rates[-1])
        if len(rates) == 2:
            rate = rate + _dot(rates[0], rates[0])
        if len(rates) == 3:
            rate = rate + 3 * _dot(rates[0], rates[1])
        return rate

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Return Phi_q and its rates: it is linear in q."""
        d = self._along(motion[-1])
        return self._gradient(d + self._c if len(motion) == 1 else d)

    def _along(self, x: Array) -> Array:
        """P_k x, shape (n_lam, 2)."""
        return (self._flat @ x).reshape(self.n_lam, 2)

    def _matrix(self, d: Array) -> Array:
        """Rows d_k^T P_k."""
        return (d[:, None, :] @ self._P)[:, 0, :]

    def _gradient(self, d: Array) -> Array:
        return self._matrix(d).ravel()


def _dot(x: Array, y: Array) -> Array:
    """Products row by row."""
    return np.sum(x * y, axis=1)


def cartesian_pendulum(
    b: npt.ArrayLike = (1.0, 9.81), angle: float = np.pi, spin: float = 0.0
) -> Rods:
    """Return a point of 1 kg on a rod, by default at rest at (-L, 0) (IFToMM library, A01).

    `angle` is that of the rod to the x axis at the start, `spin` its rate.
    """
    along = np.array([-1.0, 0.0] if angle == np.pi else [np.cos(angle), np.sin(angle)])
    geometry = Geometry(
        mass_matrix=np.eye(2),
        ends=np.eye(2)[None],
        offsets=np.zeros((1, 2)),
        shares=np.ones(1),
        weight=np.array([0.0, -1.0]),
        rest=np.zeros(2),
        along=along,
        across=spin * np.array([-along[1], along[0]]),
        names=("rod",),
    )
    return Rods(geometry, b)


# Turning at the start; rad/s.
_SPIN: Final = 1.0
# Points B_i above the bearings A_i = (i, 0), i = 0, 1, 2.
_BEARINGS: Final = np.array([0.0, 0.0, 1.0, 0.0, 2.0, 0.0])


def double_four_bar(b: npt.ArrayLike = (1.0, 9.81)) -> Rods:
    """Return the double four-bar (IFToMM library, A02) in the coordinates of its points B_i.

    Five uniform bars of 1 kg: cranks A_i B_i of length L, couplers B_0 B_1 and B_1 B_2 of 1 m. It
    starts upright and turns clockwise at 1 rad/s. With all bars in one line, two of the five
    constraints depend on the others.
    """
    eye, zero = np.eye(2), np.zeros((2, 2))
    blocks = [(eye, zero, zero), (zero, eye, zero), (zero, zero, eye)]
    blocks += [(-eye, eye, zero), (zero, -eye, eye)]
    # A bar with ends that move at v_1 and v_2 has the energy m (v_1^2 + v_1 v_2 + v_2^2)/6.
    mass = np.array([[4.0, 1.0, 0.0], [1.0, 6.0, 1.0], [0.0, 1.0, 4.0]]) / 6.0
    geometry = Geometry(
        mass_matrix=np.kron(mass, eye).astype(np.float64),
        ends=np.array([np.hstack(row) for row in blocks]),
        offsets=-np.concatenate([_BEARINGS.reshape(3, 2), np.zeros((2, 2))]),
        shares=np.array([1.0, 1.0, 1.0, 0.0, 0.0]),
        weight=-np.array([0.0, 1.0, 0.0, 1.5, 0.0, 1.0]),
        rest=_BEARINGS,
        along=np.tile([0.0, 1.0], 3),
        across=np.tile([_SPIN, 0.0], 3),
        names=("crank 0", "crank 1", "crank 2", "coupler 0", "coupler 1"),
    )
    return Rods(geometry, b)


def four_bar_minimal(times: Array, b: npt.ArrayLike = (1.0, 9.81)) -> tuple[Array, Array]:
    """Return point B_0 of the double four-bar from its only degree of freedom.

    With phi from the upright position, phi'' = s sin phi and s = 3.5 g/(3 L), nothing is singular;
    the variational equations come along. Times, shape (k,), rise from zero; b holds L and g. Return
    x, y and their rates, shape (k, 4), and their derivatives in L and g, shape (k, 4, 2).
    """
    L, g = np.asarray(b, dtype=float)
    s = 3.5 * g / (3 * L)
    s_b = np.array([-s / L, s / g])

    def rate(_: float, y: Array) -> Array:
        swing = s * np.cos(y[0]) * y[2:4] + s_b * np.sin(y[0])
        return np.concatenate([[y[1], s * np.sin(y[0])], y[4:6], swing])

    start = np.array([0.0, _SPIN, 0.0, 0.0, 0.0, 0.0])
    run = solve_ivp(rate, (0.0, times[-1]), start, "DOP853", t_eval=times, rtol=3e-14, atol=1e-14).y
    (phi, phi_t), phi_b, phi_tb = run[:2], run[2:4].T, run[4:6].T
    e, e_t = np.array([np.sin(phi), np.cos(phi)]), np.array([np.cos(phi), -np.sin(phi)])
    states = L * np.concatenate([e, phi_t * e_t]).T
    on_q = np.einsum("ik,kb->kib", L * e_t, phi_b)
    on_v = np.einsum("ik,kb->kib", -L * phi_t * e, phi_b) + np.einsum("ik,kb->kib", L * e_t, phi_tb)
    states_b = np.concatenate([on_q, on_v], axis=1)
    states_b[:, :, 0] += states / L
    return states, states_b
