"""Reference motion of a planar rod that turns with a hub: polynomials along the whole rod.

The exact planar rod (Reissner 1972) in the frame of the hub, which turns by psi(t). Displacements
and the turn of the section are polynomials of degree N over the whole length, orthonormal in the
mass, that vanish at the hub; the equations of motion are those of Galerkin, integrated by Radau
IIA of order five. For smooth motions N = 8 leaves nothing that double precision shows here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.legendre import Legendre, leggauss
from scipy.integrate import solve_ivp

from ancfdae.numerics.arrays import Array

Turning = Callable[[float], tuple[float, float, float]]


@dataclass(frozen=True)
class HubRod:
    """A uniform rod clamped to a hub at the origin.

    Stiffnesses are EA, GA with its shear factor, and EI; masses per length are rho A and rho I.
    Below a tolerance of 1e-7 Newton's iteration of Radau meets the round-off of the axial
    stiffness.
    """

    length: float
    stretch: float
    shear: float
    bend: float
    mass: float
    turning_mass: float
    degree: int = 8
    tolerance: float = 1e-7

    def tip(self, turning: Turning, times: Array) -> Array:
        """Return the displacement of the tip in the frame of the hub, shape (2, k).

        `turning` returns psi, psi' and psi'' at a time. The k times rise from zero, where the
        rod is at rest.
        """
        N, basis = self.degree, self._basis()
        inertia = np.repeat([self.mass, self.mass, self.turning_mass], N)
        in_plane = np.repeat([1.0, 1.0, 0.0], N)
        # The frame turns vectors (x, y) to (-y, x).
        J = np.zeros((3 * N, 3 * N))
        J[:N, N : 2 * N], J[N : 2 * N, :N] = -np.eye(N), np.eye(N)
        place = np.zeros(3 * N)
        place[:N] = basis.B.T @ (basis.w * basis.x)
        ones = np.zeros(3 * N)
        ones[2 * N :] = basis.B.T @ basis.w

        def rate(t: float, y: Array) -> Array:
            u, v = y[: 3 * N], y[3 * N :]
            _, w, a = turning(t)
            X = in_plane * u + place
            inner = self._inner(basis, u)[0]
            return np.concatenate(
                [v, -inner / inertia - 2 * w * (J @ v) - a * (J @ X + ones) + w * w * X]
            )

        def rate_y(t: float, y: Array) -> Array:
            _, w, a = turning(t)
            result = np.zeros((6 * N, 6 * N))
            result[: 3 * N, 3 * N :] = np.eye(3 * N)
            K = self._inner(basis, y[: 3 * N])[1]
            result[3 * N :, : 3 * N] = -K / inertia[:, None] - a * J + w * w * np.diag(in_plane)
            result[3 * N :, 3 * N :] = -2 * w * J
            return result

        run = solve_ivp(
            rate,
            (0.0, times[-1]),
            np.zeros(6 * N),
            "Radau",
            t_eval=times,
            jac=rate_y,
            rtol=self.tolerance,
            atol=1e-3 * self.tolerance,
        )
        return np.array([basis.end @ run.y[:N], basis.end @ run.y[N : 2 * N]])

    def _inner(self, basis: "_Basis", u: Array) -> tuple[Array, Array]:
        """Return the elastic forces and their derivative."""
        N, w = self.degree, basis.w
        a, b, k = 1 + basis.D @ u[:N], basis.D @ u[N : 2 * N], basis.D @ u[2 * N :]
        phi = basis.B @ u[2 * N :]
        c, s = np.cos(phi), np.sin(phi)
        # Extension and shear, and their derivatives in a, b and phi.
        stretch, shear = c * a + s * b - 1, -s * a + c * b
        F, V = self.stretch * stretch, self.shear * shear
        G = np.array([[c, s, shear], [-s, c, -(stretch + 1)]])
        H = np.einsum("iaq,i,ibq->abq", G, np.array([self.stretch, self.shear]), G)
        H[0, 2] += -s * F - c * V
        H[1, 2] += c * F - s * V
        H[2, 0], H[2, 1] = H[0, 2], H[1, 2]
        H[2, 2] -= F * (stretch + 1) + V * shear
        p = np.einsum("iaq,iq->aq", G, np.array([F, V]))
        Z = (basis.D, basis.D, basis.B)
        force = np.concatenate([Z[i].T @ (w * p[i]) for i in range(3)])
        force[2 * N :] += basis.D.T @ (w * self.bend * k)
        K = np.block([[(Z[i].T * (w * H[i, j])) @ Z[j] for j in range(3)] for i in range(3)])
        K[2 * N :, 2 * N :] += self.bend * (basis.D.T * w) @ basis.D
        return force, K

    def _basis(self) -> "_Basis":
        points, weights = leggauss(2 * self.degree + 2)
        x, w = (points + 1) / 2, weights / 2 * self.length
        P = [Legendre.basis(k, domain=[0, 1]) for k in range(self.degree)]
        B = np.array([x * p(x) for p in P]).T
        D = np.array([p(x) + x * p.deriv()(x) for p in P]).T / self.length
        C = np.linalg.inv(np.linalg.cholesky((B.T * w) @ B)).T
        return _Basis(self.length * x, w, B @ C, D @ C, np.ones(self.degree) @ C)


@dataclass(frozen=True)
class _Basis:
    """Points and weights along the rod, polynomials and their derivatives there, and at the end."""

    x: Array
    w: Array
    B: Array
    D: Array
    end: Any
