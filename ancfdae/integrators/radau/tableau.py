"""Coefficients of Radau IIA with three stages (Hairer & Wanner, Solving ODEs II, IV.5 and IV.8)."""

from __future__ import annotations

import numpy as np

from ancfdae.numerics.arrays import Array

_ROOT = np.sqrt(6.0)

#: Butcher matrix A.
BUTCHER = np.array(
    [
        [(88 - 7 * _ROOT) / 360, (296 - 169 * _ROOT) / 1800, (-2 + 3 * _ROOT) / 225],
        [(296 + 169 * _ROOT) / 1800, (88 + 7 * _ROOT) / 360, (-2 - 3 * _ROOT) / 225],
        [(16 - _ROOT) / 36, (16 + _ROOT) / 36, 1 / 9],
    ]
)
#: Places c of the stages in the step, as a column.
PLACES = np.array([[(4 - _ROOT) / 10], [(4 + _ROOT) / 10], [1.0]])
#: A^-1 and A^-2.
INVERSE = np.linalg.inv(BUTCHER)
SQUARED = INVERSE @ INVERSE
#: The places, A^-1 and A^-2 as `StageTableau` of the kernel has them.
TABLEAU = np.concatenate([x.ravel() for x in (PLACES, INVERSE, SQUARED)])
#: Weights e, a row, of the embedded formula: err = (gamma/h - J)^-1 (f_0 + sum e_i (Y_i - y_0)/h).
EMBEDDED = np.array([[-13 - 7 * _ROOT, -13 + 7 * _ROOT, -1]]) / 3


#: The real eigenvalue of A^-1.
GAMMA = float(min(np.linalg.eigvals(INVERSE), key=lambda x: abs(x.imag)).real)


def at_stages(matrix: Array, x: Array) -> Array:
    """Return sums over j of matrix_ij x_j for what stages hold, (3, ...)."""
    return np.asarray((matrix @ x.reshape(3, -1)).reshape(-1, *x.shape[1:]))


def continued(rows: Array, ahead: Array) -> Array:
    """Continue what a step holds at its start and stages, (4, n), to other places, a column.

    By the cubic; the unit is the size of the step.
    """
    places, shares = np.append(0.0, PLACES), []
    for k, place in enumerate(places):
        others = np.delete(places, k)
        shares.append(np.prod((ahead - others) / (place - others), axis=1))
    return np.asarray(np.transpose(shares) @ rows)
