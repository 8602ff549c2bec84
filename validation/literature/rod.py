"""Reference solution of rods in statics: shooting on the equations of the exact rod.

A rod with extension, shear, torsion and bending (Reissner 1972; Simo 1985). Along the arc length s
of the unloaded rod, with R = (d_1, d_2, d_3) the axes of the section (d_1 along the rod):

    r' = R (e_1 + C_n^-1 R^T n),   d_i' = R (kappa_0 + C_m^-1 R^T m) x d_i,   m' = -r' x n,

where n is constant between concentrated forces. Nothing here is shared with the elements of the
package. Numbers may be complex, so that every derivative is a complex step.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.integrate import solve_ivp

from ancfdae.numerics.arrays import Array

_TOLERANCE: Final = 1e-11
_STEP: Final = 1e-30
# Of the permutation symbol: a x b = b @ (a @ _CROSS).reshape(3, 3).
_CROSS: Final = np.cross(np.eye(3)[:, None], np.eye(3)).reshape(3, 9)


@dataclass(frozen=True)
class Rod:
    """A uniform rod.

    `stretch` is EA and the two shear stiffnesses, `bend` GJ and the bending stiffnesses about
    d_2 and d_3, `curvature` kappa_0 in the axes of the section; each of shape (3,).
    """

    length: Any
    stretch: Array
    bend: Array
    curvature: tuple[float, ...] = (0.0, 0.0, 0.0)

    def march(self, start: Array, n: Array, part: float = 1.0) -> Array:
        """Integrate from one end over a part of the length, for k rods at once.

        A state is r, d_1, d_2, d_3 and m, shape (k, 15); n is the force that the rest of the rod
        exerts on the section, shape (k, 3).
        """
        k = len(start)
        along, bent = np.array([1.0, 0.0, 0.0]), np.array(self.curvature)
        pulled = (n @ _CROSS).reshape(k, 3, 3)

        def rate(_: float, y: Array) -> Array:
            y = y.reshape(k, 5, 3)
            axes, m = y[:, 1:4], y[:, 4]
            gamma = (axes @ n[..., None])[..., 0] / self.stretch + along
            kappa = (axes @ m[..., None])[..., 0] / self.bend + bent
            y_s = np.empty_like(y)
            y_s[:, :1] = gamma[:, None] @ axes
            y_s[:, 1:4] = axes @ (kappa[:, None] @ axes @ _CROSS).reshape(k, 3, 3)
            y_s[:, 4:] = y_s[:, :1] @ pulled
            return (self.length * y_s).ravel()

        scale = np.ones((k, 5, 3))
        scale[:, 0] = abs(self.length)
        scale[:, 4] = np.abs(self.bend[1]) / abs(self.length)
        run = solve_ivp(
            rate,
            (0.0, part),
            start.ravel(),
            "DOP853",
            rtol=_TOLERANCE,
            atol=1e-2 * _TOLERANCE * scale.ravel(),
        )
        return run.y[:, -1].reshape(k, 15)


def solve(residual: Callable[[Array], Array], guess: Array) -> tuple[Array, Array]:
    """Solve residual(z) = 0 by Newton's method; return z and the derivative of the residual.

    The residual takes k candidates at once, shape (k, n), and returns shape (k, n).
    """
    z = np.array(guess, dtype=float)
    n = len(z)
    step = 1j * _STEP * np.eye(n)
    last = np.inf
    for _ in range(60):
        rows = residual(z + step)
        F, J = rows[0].real, rows.imag.T / _STEP
        change = np.linalg.solve(J, F)
        z = z - change
        size = float(np.max(np.abs(change)) / np.max(np.abs(z) + 1e-300))
        # Quadratic convergence ends where the tolerance of the integration begins.
        if size < 1e-13 or (size < 1e-8 and size >= last):
            return z, J
        last = size
    raise ArithmeticError("the reference solution did not converge")


def derivatives(
    quantity: Callable[[Array, Array], tuple[Array, Array]], z: Array, b: Array
) -> tuple[Array, Array]:
    """Return quantities of a solution, shape (m,), and their total derivatives, shape (m, n_b).

    ``quantity(z, b)`` returns the residual, shape (n,), and the quantities; z is the solution
    at the parameters b.
    """

    def columns(of_z: Array, of_b: Array) -> tuple[Array, Array]:
        pairs = [
            quantity(z + 1j * _STEP * dz, b + 1j * _STEP * db)
            for dz, db in zip(of_z, of_b, strict=True)
        ]
        return tuple(np.array([p[i].imag for p in pairs]).T / _STEP for i in (0, 1))  # type: ignore[return-value]

    n, n_b = len(z), len(b)
    F_z, x_z = columns(np.eye(n), np.zeros((n, n_b)))
    F_b, x_b = columns(np.zeros((n_b, n)), np.diag(b))
    x = quantity(z.astype(complex), b.astype(complex))[1].real
    return x, (x_b - x_z @ np.linalg.solve(F_z, F_b)) / b


def tip_loaded(
    rod: Rod, force: Array, axes: Array | None = None, steps: int = 1
) -> tuple[Array, Array, Array]:
    """Clamp a rod at its start and pull its end by a dead force, in load steps.

    The axes d_1, d_2, d_3 at the clamp are rows, by default those of the frame. Return the
    state of the loaded end, shape (15,), the moment at the clamp, and the derivative of the
    moment at the end in it, shape (3, 3), which is singular at bifurcations.
    """
    moment, J = np.zeros(3), np.eye(3)
    for load in np.linspace(0, 1, steps + 1)[1:]:
        moment, J = solve(lambda m: clamped(rod, m, load * force, axes)[:, 12:], moment)  # noqa: B023
    return clamped(rod, moment[None], force, axes)[0], moment, J


def clamped(rod: Rod, moment: Array, force: Array, axes: Array | None = None) -> Array:
    """Return the states of the ends of rods clamped with given moments, shape (k, 15)."""
    frame = np.eye(3) if axes is None else axes
    k = len(moment)
    fixed = np.broadcast_to(np.concatenate([np.zeros(3), frame.ravel()]), (k, 12))
    start = np.concatenate([fixed, moment], axis=1).astype(complex)
    return rod.march(start, np.broadcast_to(force, (k, 3)).astype(complex))
