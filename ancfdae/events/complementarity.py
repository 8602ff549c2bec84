"""Impulses of contacts with Coulomb's friction: a linear complementarity problem and its branch.

m contacts have impulses N >= 0 along their normals; k of them are rough and have impulses T along
their lines of sliding. With the rates r of gaps and of sliding before, and the inverse mass A,

    (g', s) = A (N, T) + r,   0 <= N - N_0  complementary to  g' >= 0,
    |T| <= mu N,   T = -mu N sign(s) where s is not zero.

N_0 is zero, or what expansion adds to an impulse at least (Poisson's law). Lemke's method solves
the problem in the form of D. E. Stewart and J. C. Trinkle (Int. J. Numer. Meth. Eng. 39, 1996).
Its matrix is copositive; ties are broken by a lexicographic rule. The solution lies on a *branch*:
which contacts push, which stick, and which slide in what direction. On a branch the equations are
linear. They are solved once more, so that complex numbers and derivatives follow from them, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.numerics.arrays import Array

# Pivots, and differences of ratios, below this part of the largest entry are round-off.
_ROUND_OFF = 1e-11
# Impulses and rates below this part of the largest ones are zero on a branch, which ends there.
_TIE = 1e-9
# Starts of Lemke's method, whose coefficients are 1 plus fractions of multiples of a number.
_STARTS, _SPREAD = 16, 0.6180339887498949
# Singular values below this part of the largest one belong to impulses that move nothing.
_MOVES_NOTHING = 1e-12


@final
@dataclass(frozen=True)
class Contacts:
    """The inverse mass A, (m + k, m + k), which contacts are rough, (k,), and their mu, (k,)."""

    inverse_mass: Array
    rough: Array
    friction: Array

    @property
    def count(self) -> int:
        """Number m of contacts in the impact."""
        return len(self.inverse_mass) - len(self.rough)

    def sizes(self) -> Array:
        """Return square roots of the inverse masses, (m + k,); 1 where no impulse acts."""
        own = np.diag(self.inverse_mass).real.copy()
        own[own <= _ROUND_OFF**2 * np.max(own, initial=0.0)] = 1.0
        return np.sqrt(own)

    def branch(self, rates: Array, least: Array) -> Branch:
        """Return the branch of the solution from real rates r, (m + k,), and N_0, (m,).

        ArithmeticError if there is no solution.
        """
        m, k, size = self.count, len(self.rough), self.sizes()
        A, mu = self._scaled()
        r = rates.real / size
        low = least.real * size[:m]
        r = r + A[:, :m] @ low
        scale = float(np.max(np.abs(r), initial=0.0)) or 1.0
        M, q = np.zeros((m + 3 * k, m + 3 * k)), np.zeros(m + 3 * k)
        up, down, slide = m + np.arange(k), m + k + np.arange(k), m + 2 * k + np.arange(k)
        M[:m, :m], M[:m, up], M[:m, down] = A[:m, :m], A[:m, m:], -A[:m, m:]
        for rows, sign in ((up, 1.0), (down, -1.0)):
            M[rows, :m], M[np.ix_(rows, up)] = sign * A[m:, :m], sign * A[m:, m:]
            M[np.ix_(rows, down)] = -sign * A[m:, m:]
            M[rows, slide] = 1.0
            M[slide, rows] = -1.0
            q[rows] = sign * r[m:]
        M[slide, self.rough] = mu
        q[:m], q[slide] = r[:m], mu * low[self.rough]
        x = _solution(M, q / scale) * scale
        N, T = x[:m] + low, x[up] - x[down]
        loaded = N[self.rough] > _ROUND_OFF * scale
        slides = np.where(loaded & (x[slide] > _ROUND_OFF * scale), np.sign(-T), 0.0)
        found = np.concatenate([N, T]) / size
        return Branch(x[:m] > _ROUND_OFF * scale, loaded & (slides == 0), slides, found)

    def _scaled(self) -> tuple[Array, Array]:
        """Return A with a unit diagonal, and mu for impulses in these units, real."""
        size = self.sizes()
        ratio = size[self.count :] / size[self.rough]
        return self.inverse_mass.real / np.outer(size, size), self.friction.real * ratio

    def tie(self, branch: Branch, impulses: Array, rates: Array, least: Array) -> int | None:
        """Return a contact whose solution lies on two branches, from g', s and N, T; or None."""
        size, m = self.sizes(), self.count
        P, y = impulses.real * size, rates.real / size
        _, mu = self._scaled()
        small, slow = _TIE * np.max(np.abs(P), initial=0.0), _TIE * np.max(np.abs(y), initial=0.0)
        more = P[:m] - least.real * size[:m]
        # A gap that closes alone is struck, however slowly.
        tied = np.where(branch.pushes, more <= small, y[:m] <= slow) & (m > 1)
        sliding, T = y[m:], P[m:]
        held = np.abs(T) >= mu * P[self.rough] - small
        on_edge = (branch.sticks & held) | ((branch.slides != 0) & (np.abs(sliding) <= slow))
        on_edge &= np.diag(self.inverse_mass).real[m:] > 0
        tied[self.rough] |= on_edge
        return int(np.argmax(tied)) if np.any(tied) else None


@final
@dataclass(frozen=True)
class Branch:
    """Which contacts push beyond N_0, (m,), and which rough ones stick or slide (by sign), (k,).

    `near` are N and T, (m + k,), as Lemke's method found them. Where contacts depend on each other
    impulses are not unique, and these lie within the cones of friction.
    """

    pushes: Array
    sticks: Array
    slides: Array
    near: Array

    def impulses(self, contacts: Contacts, rates: Array, least: Array) -> Array:
        """Return N and T, (m + k,), of numbers of any kind."""
        zero = np.zeros(len(self.sticks))
        side = np.concatenate([
            np.where(self.pushes, -rates[: contacts.count], least),
            np.where(self.sticks, -rates[contacts.count :], zero),
        ])  # fmt: skip
        return self._solved(contacts, side[:, None], self.near[:, None])[:, 0]

    def along(
        self, contacts: Contacts, normal: Array, changes: tuple[Array, Array, Array]
    ) -> Array:
        """Return derivatives of N and T, (m + k, d), along d directions.

        `normal` is N, (m,); `changes` are the derivatives of rates with impulses held, of N_0, and
        of mu. ArithmeticError if no impulses on the branch fit them.
        """
        rates_b, least_b, mu_b = changes
        m, rough = contacts.count, contacts.rough
        slid = -(self.slides * normal[rough])[:, None] * mu_b
        side = np.vstack([
            np.where(self.pushes[:, None], -rates_b[:m], least_b),
            np.where(self.sticks[:, None], -rates_b[m:], slid),
        ])  # fmt: skip
        return self._solved(contacts, side, np.zeros_like(side))

    def _solved(self, contacts: Contacts, side: Array, near: Array) -> Array:
        """Return the impulses on the branch that are nearest to given ones, (m + k, d)."""
        m, rough, size = contacts.count, contacts.rough, contacts.sizes()
        scaled = contacts.inverse_mass / np.outer(size, size)
        K = np.eye(len(size), dtype=np.result_type(scaled, contacts.friction))
        held = np.concatenate([self.pushes, self.sticks])
        K[held] = scaled[held]
        for j in np.flatnonzero(self.slides).tolist():
            ratio = size[m + j] / size[rough[j]]
            K[m + j, rough[j]] = self.slides[j] * contacts.friction[j] * ratio
        factor = np.where(held, 1 / size, size)
        right, begin = side * factor[:, None], near * size[:, None]
        miss = right - K @ begin
        found = begin + np.linalg.lstsq(K, miss, rcond=_MOVES_NOTHING)[0]
        off = np.abs(K @ found - right)
        if np.any(off > _TIE * np.max(np.abs(right), axis=0, initial=0.0)):
            raise ArithmeticError
        return found / size[:, None]


def _solution(M: Array, q: Array) -> Array:
    """Return a solution x, (n,), by Lemke's method; after a ray by round-off from a new start."""
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
        good = np.flatnonzero(column > _ROUND_OFF * max(1.0, float(np.max(np.abs(column)))))
        if not len(good):
            raise ArithmeticError
        ratios = np.column_stack([table[:, -1], table[:, :n]])[good] / column[good, None]
        artificial = np.flatnonzero(basis[good] == 2 * n)
        if len(artificial) and ratios[artificial[0], 0] <= np.min(ratios[:, 0]) + _ROUND_OFF:
            row = int(good[artificial[0]])
            continue
        row = int(good[_first(ratios, np.arange(len(good)))])
    raise ArithmeticError


def _first(rows: Array, among: Array) -> int:
    """Return the lexicographically least of some rows, up to round-off."""
    for column in rows.T:
        values = column[among]
        among = among[
            values <= np.min(values) + _ROUND_OFF * max(1.0, float(np.max(np.abs(values))))
        ]
        if len(among) == 1:
            break
    return int(among[0])
