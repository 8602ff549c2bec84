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
#: Weights e, a row, of the embedded formula: err = (gamma/h - J)^-1 (f_0 + sum e_i (Y_i - y_0)/h).
EMBEDDED = np.array([[-13 - 7 * _ROOT, -13 + 7 * _ROOT, -1]]) / 3


def _diagonalised() -> tuple[tuple[float, Array, Array], tuple[complex, Array, Array]]:
    values, vectors = np.linalg.eig(INVERSE)
    rows = np.linalg.inv(vectors)
    real, pair = int(np.argmin(np.abs(values.imag))), int(np.argmax(values.imag))
    size = vectors[0, real]  # The real pair of vectors may be written with a complex factor.
    first = float(values[real].real), (vectors[:, real] / size).real, (rows[real] * size).real
    return first, (complex(values[pair]), vectors[:, pair], rows[pair])


#: A^-1 = T diag(gamma, mu, conj(mu)) T^-1; column of T and row of T^-1 for gamma and for mu.
(GAMMA, REAL_COLUMN, REAL_ROW), (MU, COLUMN, ROW) = _diagonalised()


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
