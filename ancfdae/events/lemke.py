"""Lemke's method for linear complementarity problems."""

from __future__ import annotations

import numpy as np

from ancfdae.numerics.arrays import Array

#: Pivots and differences of ratios below this fraction of the largest entry are round-off.
ROUND_OFF = 1e-11
# Number of starts, and the number whose multiples, modulo 1, are added to 1 in their coefficients.
_STARTS, _SPREAD = 16, 0.6180339887498949


def solution(M: Array, q: Array) -> Array:
    """Return a solution x, (n,), of the problem of `lemke`; a failed attempt is repeated.

    Attempts differ in `cover`, since round-off may end one on a ray.
    """
    for n in range(_STARTS):
        try:
            return lemke(M, q, 1.0 + np.modf(n * _SPREAD * np.arange(len(q)))[0])
        except ArithmeticError:
            if n == _STARTS - 1:
                raise
    raise AssertionError


def lemke(M: Array, q: Array, cover: Array) -> Array:
    """Return x >= 0 with w = M x + q >= 0 and x^T w = 0, (n,), by Lemke's method.

    The artificial variable has the coefficients `cover`, (n,), positive. Ties between pivots are
    broken lexicographically, so that it does not cycle. ArithmeticError if it ends on a ray:
    copositive problems have no solution then.
    """
    n = len(q)
    if np.all(q >= 0):
        return np.zeros(n)
    # Columns: w, x, the artificial variable, the right side. Rows: basic variables.
    table = np.hstack([np.eye(n), -M, -cover[:, None], q[:, None]])
    basis, entering = np.arange(n), 2 * n
    row = _first(np.column_stack([q, table[:, :n]]) / cover[:, None], np.arange(n))
    for _ in range(50 * (n + 2)):
        leaving = int(basis[row])
        table[row] /= table[row, entering]
        others = np.arange(n) != row
        table[others] -= np.outer(table[others, entering], table[row])
        basis[row] = entering
        if leaving == 2 * n:
            x = np.zeros(2 * n + 1)
            x[basis] = np.maximum(table[:, -1], 0.0)
            return x[n : 2 * n]
        entering = leaving + n if leaving < n else leaving - n
        column = table[:, entering]
        good = np.flatnonzero(column > ROUND_OFF * max(1.0, float(np.max(np.abs(column)))))
        if not len(good):
            raise ArithmeticError
        ratios = np.column_stack([table[:, -1], table[:, :n]])[good] / column[good, None]
        artificial = np.flatnonzero(basis[good] == 2 * n)
        if len(artificial) and ratios[artificial[0], 0] <= np.min(ratios[:, 0]) + ROUND_OFF:
            row = int(good[artificial[0]])
            continue
        row = int(good[_first(ratios, np.arange(len(good)))])
    raise ArithmeticError


def _first(rows: Array, among: Array) -> int:
    """Return the index, among `among`, of the lexicographically least row, up to round-off."""
    for column in rows.T:
        values = column[among]
        among = among[
            values <= np.min(values) + ROUND_OFF * max(1.0, float(np.max(np.abs(values))))
        ]
        if len(among) == 1:
            break
    return int(among[0])
