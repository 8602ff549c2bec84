"""Damping in proportion to stiffness, D = tau K, as of one material free of stress.

The shapes are the undamped ones. A natural frequency omega, z = omega^2, has the exponents

    s^2 + tau z s + z = 0

Where tau omega > 2 both are real: one near -1/tau, where those of all stiff motions crowd, and one
near -tau omega^2. No method that starts from the matrices of s separates the exponents near -1/tau;
the natural frequencies do.
"""

from __future__ import annotations

import numpy as np

from ancfdae.modes.linearised import EPS, ROUND_OFF, Linearised
from ancfdae.numerics.arrays import Array


def retardation_time(small: Linearised) -> float | None:
    """Return tau with D = tau K to the round-off of their entries; None if there is none; s."""
    if small.D is None or not small.symmetric:
        return None
    pattern, root = small.system.pattern, np.sqrt(small.system.weights)
    sizes = root[pattern.rows] * root[pattern.columns]
    K, D = small.K / sizes, small.D / sizes
    squares = float(K @ K)
    if not squares:
        return None
    tau = float(K @ D) / squares
    left = float(np.max(np.abs(D - tau * K)))
    return tau if left <= ROUND_OFF * EPS * float(np.max(np.abs(D))) else None


def exponents(tau: float, z: Array, noise: Array) -> tuple[Array, Array, Array]:
    """Return the exponents s, their round-off, and the number of the shape of each.

    z = omega^2 with its round-off, shapes (n,). Rigid motions have s = 0 once; a vibration the
    exponent with Im s > 0; real exponents come in twos.
    """
    half, moves = 0.5 * tau * z, z != 0
    left = half**2 - z
    vibrates = left < 0
    root = np.sqrt(np.abs(left))
    # The larger of two real exponents has no cancellation, and their product is z.
    far = -half - np.copysign(root, half)
    near = z / np.where(far == 0, 1.0, far)
    first = np.where(vibrates, -half + 1j * root, near)
    creeps = np.flatnonzero(~vibrates & moves)
    number = np.concatenate([np.arange(len(z)), creeps])
    s = np.concatenate([first, far[creeps]])
    z, noise = z[number], noise[number]
    # ds = -(tau s + 1) dz / (2 s + tau z), and tau s + 1 = -s^2 / z; next to a double root ds is
    # the root of what (tau s + 1) dz moves.
    moved = np.abs(s) ** 2 / np.where(z == 0, 1.0, np.abs(z)) * noise
    slope = np.maximum(np.abs(2 * s + tau * z), np.sqrt(moved))
    return s, moved / np.where(slope == 0, 1.0, slope) + EPS * np.abs(s), number
