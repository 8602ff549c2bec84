"""Whether the steps of a motion stay on its branch of the constraints Phi(t, q) = 0.

Phi(t, q) = 0 holds on several branches: the open and the crossed four-bar, a slider-crank on both
sides of its dead point. They part where Phi_q loses rank. Let B be Phi_q at a state c of the
motion, W the diagonal of the weights and P = W^-1 B^T (B W^-1 B^T)^-1, so that B P = I. Then

    X(t, q) = (Phi_q(t, q) - B) P,      Phi_q(t, q) P = I + X,

and Phi_q has full rank wherever norm(X) < 1. Let constraints be quadratic in q; for constraints
given as formulas the following is a rule without proof. Halfway between two solutions of one time
Phi_q has not full rank, for

    0 = Phi(t, q_1) - Phi(t, q_2) = Phi_q(t, (q_1 + q_2)/2) (q_1 - q_2),

so norm(X) >= 1 at one of the two, wherever c lies. A step with norm(X) <= 1/2 is taken to be on the
branch of c. Any other step is followed in parts for which this holds,

    Phi(t, q) = 0 from t_n to t_n+1 along q' = -P Phi_t + (I - P Phi_q) d,

where d leads to the cubic through the positions and velocities at the ends of the step: the motion
in the directions that constraints leave free. The step is right if the state that this path reaches
at t_n+1 is its solution. Where Phi_q loses rank on the way, branches cross, and the path goes on
along the one with bounded accelerations, if there is one (a parallelogram that is stretched).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias, final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.saddle_points import velocity_side
from ancfdae.kernels import finite, norm
from ancfdae.numerics.arrays import Array

# Coordinates, (n_q,), that the motion in the free directions is to pass, as a function of time.
Aim: TypeAlias = Callable[[float], Array]

# Largest norm of X on one branch: half of the least at which it may be another.
CHANGED = 0.5
# A part of a step is accepted if Newton's first correction is below _CURVED times its length (then
# the second is below its square) and later corrections shrink at least as fast. A rejected part is
# shortened, down to _SHORTEST times the remaining time.
_CURVED, _SHORTEST, _ITERATIONS = 0.1, 1e-9, 8
# Most parts, accepted or not, in which one call follows a step: next to a dead point parts of the
# size of round-off would go on without an end.
_PARTS = 2000
# Corrections below _SMALL times the size of the system, plus _LAST units in the last place of its
# coordinates, are round-off.
_SMALL, _LAST = 1e-11, 8 * float(np.finfo(float).eps)
# Two configurations differ if their distance exceeds APART times the distance that a step moves.
APART = 1e-3
# A motion is extrapolated across a place without rank from configurations at times _NODES before it
# to times _BEYOND after it, in units of each of _REACHES times the time followed before. The
# distance to a solution must be below _CROSSING times the motion since the place; on branches
# that jump it is of order one. Next to the place round-off is magnified: later times help.
_REACHES, _NODES, _BEYOND = (1.0, 0.1, 1e-2, 1e-3), np.array([1.0, 0.6, 0.2]), (0.2, 5.0, 100.0)
_CROSSING = 1e-2
# Most places without rank that are crossed in one call.
_CROSSINGS = 1000
# Most moves along the constraints from the end of a followed path towards the solution of the step:
# from nearly half a turn away the moves begin tiny, and double.
_MOVES = 400
# Up to _DENSE constraints matrices are dense; above, norm(X) is estimated by _PRODUCTS products.
_DENSE, _PRODUCTS = 100, 4
# Powers of X are formed for several states at once, of _NUMBERS entries in total: only the states
# up to the first with norm(X) > CHANGED matter, so a larger batch would be wasted.
_NUMBERS = 1000
# Phi_q has not full rank if the ratio of the diagonals of its triangular factor is below this.
_SINGULAR = 1e-13


@final
class Form:
    """Scales that make coordinates and rows of Phi_q comparable, independent of their units.

    Coordinates are scaled as sqrt(w_i) q_i; rows of Phi_q have length one in these coordinates at
    the first state of the motion. `taken` is a mask, (n_lam,), of the constraints that are
    examined; `used` are the indices of the coordinates that occur in them. `magnified` is whether
    changes count as round-off that last places of coordinates make next to a place without rank.
    """

    def __init__(
        self,
        system: MechanicalSystem,
        values: Array,
        taken: Array | None = None,
        magnified: bool = False,
    ) -> None:
        self.system, self.magnified, pattern = system, magnified, system.constraint_pattern
        self.taken: Array | slice = slice(None)
        self._entries: Array | slice = slice(None)
        if taken is None:
            (self.used, self.columns), self.rows, n_lam = (
                pattern.used,
                pattern.rows.astype(int),
                system.n_lam,
            )
        else:
            self.taken, self._entries = taken, np.flatnonzero(taken[pattern.rows])
            self.used, self.columns = np.unique(pattern.columns[self._entries], return_inverse=True)
            self.rows = (np.cumsum(taken) - 1)[pattern.rows[self._entries]]
            n_lam = int(np.sum(taken))
        self.shape = n_lam, len(self.used)
        self.root = np.sqrt(system.weights[self.used])
        scaled = values[self._entries] / self.root[self.columns]
        squares = np.bincount(self.rows, scaled * scaled, minlength=self.shape[0])
        self.lengths = np.sqrt(np.where(squares > 0, squares, 1.0))
        self._scale = 1 / (self.root[self.columns] * self.lengths[self.rows])
        self._flat = self.rows * len(self.used) + self.columns

    def matrices(self, rows: Array) -> Array:
        """Return scaled matrices Phi_q, (k, n_lam, n_used), from rows of entries, (k, nnz)."""
        matrices = np.zeros((len(rows), self.shape[0] * self.shape[1]))
        matrices[:, self._flat] = rows[:, self._entries] * self._scale
        return matrices.reshape(-1, *self.shape)

    def sparse(self, values: Array) -> scipy.sparse.csr_array:
        """Return the scaled matrix Phi_q, (n_lam, n_used), sparse, from its entries, (nnz,)."""
        places = self.rows, self.columns
        return scipy.sparse.csr_array(
            (values[self._entries] * self._scale, places), shape=self.shape
        )


@final
class Place:
    """A reference state c of the motion: entries of Phi_q at c, (nnz,), and its right inverse P."""

    def __init__(self, form: Form, values: Array) -> None:
        self._form, self._values = form, values
        self._P: Array | None = None
        self._factors: scipy.sparse.linalg.SuperLU | None = None
        # Factors that balance X, so that its norm is nearly its largest eigenvalue.
        self._balance: Array | None = None
        if form.shape[0] <= _DENSE:
            self._P = self._pseudo_inverse()
        else:
            self._factors = self._factorised()

    def changes(self, rows: Array) -> Array:
        """Return norm(X), (k,), for k rows of entries of Phi_q; infinite if P does not exist."""
        changes = rows - self._values
        if self._factors is not None:
            sizes = np.array([self._estimated(x) for x in changes])
        elif self._P is None:
            return np.full(len(rows), np.inf)
        else:
            sizes = self._norms(changes)
        return np.where(np.isfinite(sizes), sizes, np.inf)

    def _norms(self, changes: Array) -> Array:
        """Return the Frobenius norms of X, (k,); large ones near the largest eigenvalue of X."""
        n_lam, n_used = self._form.shape
        X = self._form.matrices(changes).reshape(-1, n_used) @ self._P
        X = X.reshape(-1, n_lam, n_lam)
        sizes = np.sqrt((X * X).sum(axis=(1, 2)))
        if not np.any(sizes > CHANGED):
            return sizes
        if self._balance is None and np.all(np.isfinite(X[-1])):
            scale = scipy.linalg.lapack.dgebal(X[-1], scale=1)[3]
            self._balance = (scale[None] / scale[:, None]) ** 2
        if self._balance is not None:
            sizes = np.sqrt(np.einsum("kij->k", X * X * self._balance))
        large = np.flatnonzero(sizes > CHANGED)
        together = max(1, _NUMBERS // n_lam**2)
        for first in range(0, len(large), together):
            rows = large[first : first + together]
            power = X[rows] / sizes[rows, None, None]
            for _ in range(3):
                power = power @ power
            sizes[rows] *= (power * power).sum(axis=(1, 2)) ** 0.0625
            if np.any(sizes[rows] > CHANGED):  # Rows after the first that is far do not matter.
                break
        return sizes

    def nearest(self, side: Array, x: Array) -> Array | None:
        """Return the solution of Phi_q y = side nearest to x, (n_q,); None without full rank."""
        form = self._form
        missing = side - form.system.constraint_pattern.dot(self._values, x)
        missing = missing[form.taken] / form.lengths
        if self._P is not None:
            change = self._P @ missing
        elif self._factors is not None:
            change = self._lifted(missing)
        else:
            return None
        x = x.copy()
        x[form.used] += change / form.root
        return x if finite(x) else None

    def _pseudo_inverse(self) -> Array | None:
        """Return P, shape (n_used, n_lam), dense; None where Phi_q has not full rank."""
        n_lam, n_used = self._form.shape
        if n_used < n_lam:
            return None
        # B^T = Q R, and P^T = R^-1 Q^T.
        lapack = scipy.linalg.lapack
        QR, tau, _, _ = lapack.dgeqrf(self._form.matrices(self._values[None])[0].T)
        pivots = np.abs(QR.diagonal())
        if not pivots.min() > _SINGULAR * pivots.max():
            return None
        return np.asarray(lapack.dtrtrs(QR[:n_lam], lapack.dorgqr(QR, tau)[0].T)[0].T)

    def _factorised(self) -> scipy.sparse.linalg.SuperLU | None:
        """Return the sparse factors of [I B^T; B 0]; None if this matrix is singular."""
        B, one = self._form.sparse(self._values), scipy.sparse.eye_array(self._form.shape[1])
        try:
            return scipy.sparse.linalg.splu(scipy.sparse.bmat([[one, B.T], [B, None]], "csc"))
        except RuntimeError:
            return None

    def _lifted(self, y: Array) -> Array:
        """Return P y, the least coordinate change x with Phi_q x = y, (n_used,)."""
        assert self._factors is not None
        n_used = self._form.shape[1]
        return np.asarray(self._factors.solve(np.concatenate([np.zeros(n_used), y]))[:n_used])

    def _estimated(self, change: Array) -> float:
        """Estimate the largest eigenvalue of X by the growth of a vector in some products."""
        change_B, size = self._form.sparse(change), 0.0
        y = np.cos(np.arange(self._form.shape[0]))  # no eigenvector of anything
        for _ in range(_PRODUCTS):
            y, before = change_B @ self._lifted(y), np.linalg.norm(y)
            size = float(np.linalg.norm(y) / before)
            if not 0 < size < np.inf:
                break
        return size


def followed(
    system: MechanicalSystem,
    t: float,
    q: Array,
    end: float,
    guide: Aim | None = None,
    taken: Array | None = None,
    magnified: bool = False,
) -> tuple[float, Array]:
    """Follow a motion on its branch from (t, q) to `end`; return the time reached, and q there.

    Where Phi_q loses rank on the way, the motion goes on along the branch on which its velocities
    are continuous; without such a branch the time is less than `end`. `guide` gives the
    aim of the motion where constraints leave motions free; `taken` is a mask, (n_lam,), of the
    constraints that are followed, by default all; `magnified` as in `Form`.
    """
    how = guide, taken, magnified
    for _ in range(_CROSSINGS):
        lost = to_singular(system, t, q, end, *how)
        beyond = None if lost[0] == end else _across(system, (t, q), lost, end, *how)
        if beyond is None:
            return lost
        t, q = beyond
    return t, q


def _across(
    system: MechanicalSystem,
    begin: tuple[float, Array],
    lost: tuple[float, Array],
    end: float,
    guide: Aim | None,
    taken: Array | None,
    magnified: bool,
) -> tuple[float, Array] | None:
    """Return time and configuration beyond a place where Phi_q loses rank, or None.

    `begin` and `lost` are time and configuration before the place and next to it. There branches
    cross at an angle, and velocities are continuous on one of them only. The parabola through
    configurations before the place is off this branch by the cube of the distance, and off branches
    with jumps by its first power. At a dead point that stops a drive there is no solution beyond.
    """
    (t_0, q_0), (t_1, q_1) = begin, lost
    for share in _REACHES:
        reach, t, q = share * (t_1 - t_0), t_0, q_0
        before, rows = t_1 - reach * _NODES, list[Array]()
        for time in before.tolist():
            if time > t:
                t, q = to_singular(system, t, q, time, guide, taken, magnified)
            rows.append(q)
        if t < before[-1] or t == t_0:
            return None
        extrapolated = scipy.interpolate.KroghInterpolator(before, np.array(rows))
        form = Form(system, system.constraint_q(t, q), taken, magnified)
        for factor in _BEYOND:
            beyond = min(end, t_1 + factor * reach)
            guess = extrapolated(beyond)
            allowed = _CROSSING * norm(guess - q_1, system.weights)
            found = _solved(form, beyond, guess, allowed)
            if found is not None and beyond > t_1:
                return beyond, found
    return None


def to_singular(
    system: MechanicalSystem,
    t: float,
    q: Array,
    end: float,
    guide: Aim | None = None,
    taken: Array | None = None,
    magnified: bool = False,
) -> tuple[float, Array]:
    """Follow a motion as `followed` does, but only up to where Phi_q loses rank."""
    h, least = end - t, _SHORTEST * (end - t)
    values = system.constraint_q(t, q)
    form = Form(system, values, taken, magnified)
    place = Place(form, values)
    for _ in range(_PARTS):
        if t == end:
            break
        h = min(h, end - t)
        later = end if h == end - t else t + h
        aim = np.zeros(system.n_q) if guide is None else guide(later) - q
        solved = _part(form, place, (t, q), later, aim)
        if solved is not None:
            q, place = solved
            t, h = later, 2 * h
        elif h <= least:
            return t, q
        else:
            h /= 4
    else:
        return t, q
    return t, q if guide is None else _settled(form, place, t, q, guide(t))


def _settled(form: Form, place: Place, t: float, q: Array, aim: Array) -> Array:
    """Return the configuration q, (n_q,), nearest to `aim` that constraints at time t permit."""
    system, share = form.system, 1.0
    none = np.zeros(system.n_lam)
    for _ in range(_MOVES):
        moved = _part(form, place, (t, q), t, share * (aim - q))
        if moved is None:
            share /= 4
            continue
        (new, place), before = moved, q
        q, share = new, min(1.0, 2 * share)
        ahead = place.nearest(none, aim - q)
        least = 10 * small(system, q)
        if ahead is None or norm(ahead, system.weights) <= max(
            least, APART**2 * norm(q - before, system.weights)
        ):
            break
    return q


def _part(
    form: Form, place: Place, begin: tuple[float, Array], end: float, aim: Array
) -> tuple[Array, Place] | None:
    """Return q at time `end`, (n_q,), and its `Place`, after one part of a step (Newton's method).

    None if Newton's method does not converge, or if norm(X) > CHANGED there.
    """
    (t, q), system = begin, form.system
    side = (end - t) * velocity_side(system, t, q) if end > t else np.zeros(system.n_lam)
    step = place.nearest(side, aim)
    if step is None:
        return None
    solved = _solved(form, end, q + step, _CURVED * norm(step, system.weights))
    if solved is None:
        return None
    values = system.constraint_q(end, solved)
    on = place.changes(values[None])[0] <= CHANGED
    return (solved, Place(form, values)) if on else None


def closed(
    system: MechanicalSystem, t: float, q: Array, taken: Array | None, magnified: bool = False
) -> Array | None:
    """Return q with the constraints `taken` closed to round-off; None if Newton's method fails."""
    form = Form(system, system.constraint_q(t, q), taken, magnified)
    return _solved(form, t, q, APART * norm(system.centred(q), system.weights))


def small(system: MechanicalSystem, q: Array) -> float:
    """Return the norm below which a change of the coordinates q is round-off, wherever they are."""
    w = system.weights
    return _SMALL * norm(system.centred(q), w) + _LAST * norm(q, w)


def _solved(form: Form, t: float, q: Array, allowed: float) -> Array | None:
    """Return q with its constraints closed; None unless corrections fall from `allowed` on."""
    system, none = form.system, np.zeros(form.system.n_q)
    w = system.weights
    least = _SMALL * norm(q, w) if form.magnified else small(system, q)
    for _ in range(_ITERATIONS):
        change = Place(form, system.constraint_q(t, q)).nearest(system.constraint(t, q), none)
        size = np.inf if change is None else norm(change, w)
        if change is None or size > max(allowed, least):
            return None
        q, allowed = q - change, _CURVED * size
        if size <= least:
            return q
    return None
