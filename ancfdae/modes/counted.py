"""Modes of large symmetric pencils, from the lowest or the highest on, with a proof by counting.

Growing motions have z = -s^2 < 0, and may lie far below all slow vibrations: a column beyond its
critical load next to a strip of rubber. K - z M has a negative eigenvalue for each mode below z
(Sylvester). Counts at z that decrease by a factor, down to one below which there are no modes, show
how many growing motions each interval has. Lanczos's method with a shift at its lower end finds
these, one interval after the other from the lowest on, and then the other modes with a shift of
their own magnitude. Modes already found are deflated from the following Krylov spaces, so that each
space finds one copy or more of coinciding modes; it is repeated until the count agrees.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.errors.kinds import SingularMatrix
from ancfdae.modes.eigenpairs import floor, rigid_motions
from ancfdae.modes.lanczos import BETWEEN, NEAR_ZERO, Count, Lanczos, ritz
from ancfdae.modes.linearised import EPS, Linearised
from ancfdae.numerics.arrays import Array

# Shift over the largest value searched; growth factor of intervals; largest |z| over the largest
# entry of K; and largest number of Krylov spaces for one interval.
_BELOW, _FACTOR, _FAR, _SPACES = 1.5, 4.0, 1e4, 100


@final
@dataclass(frozen=True)
class _Found:
    """Values and shapes, orthonormal in M, found so far; -z in place of z for the highest."""

    small: Linearised
    z: Array
    X: Array

    def extended(self, shift: float | None, count: int) -> tuple[_Found, float] | None:
        """Return the modes with `count` more next to a shift, and the next value, or None."""
        count = min(count, self.small.n_free - len(self.z))
        if count <= 0:
            return None
        space = Lanczos(self.small, shift, count, self.X)
        if not space.converge(count):
            return None
        z = space.z if shift is not None else -space.z
        X = space.X
        # A space of all remaining motions has no next value.
        beyond = float(z[count]) if len(z) > count else np.inf
        found = np.append(self.z, z[:count]), np.hstack([self.X, X])
        order = np.argsort(found[0], kind="stable")
        return _Found(self.small, found[0][order], found[1][:, order]), beyond

    def with_rigid(self, R: Array) -> _Found:
        """Return the modes with the rigid motions R, orthonormal in M, added."""
        z = np.einsum("ij,ij->j", R, self.small.times(self.small.K, R))
        return _Found(self.small, np.append(self.z, z), np.hstack([self.X, R]))

    def below(self, cut: float) -> int:
        """Return the number of values below `cut`."""
        return int(np.sum(self.z < cut))


def lowest_of_all(small: Linearised, count: int, asked: int) -> tuple[Array, Array, Array] | None:
    """Return the lowest z = -s^2 of symmetric K, increasing, with shapes and errors of z.

    None unless counts prove that none of the first `asked` is missing, nor any that coincides with
    them. Rigid motions are returned all together, with the next mode.
    """
    try:
        top, rigid = _sizes(small, count)
        least = rigid.shape[1] + 2
        if least > count:
            count, asked = least, least - 1
        grown = _growing(small, -top, count)
        if grown is None:
            return None
        found, cut = grown
        if len(found.z) < count:
            found = found.with_rigid(rigid)
            completed = _completed(found, -top, count, asked)
            if completed is None:
                return None
            found = completed
        return _as_pairs(found, cut)
    except SingularMatrix:
        return None


def highest_of_all(small: Linearised, count: int, asked: int) -> tuple[Array, Array, Array] | None:
    """Return the highest z of symmetric K, decreasing, shapes, and zero errors.

    None as in `lowest_of_all`.
    """
    found = _completed(_none(small), None, count, asked)
    if found is None:
        return None
    return -found.z, found.X, np.zeros(len(found.z))


def _none(small: Linearised) -> _Found:
    return _Found(small, np.zeros(0), np.zeros((small.system.n_q, 0)))


def _sizes(small: Linearised, count: int) -> tuple[float, Array]:
    """Return the distance below zero of a shift for the lowest modes, and the rigid motions."""
    space = Lanczos(small, -NEAR_ZERO * small.size, count)
    space.converge(0)
    z, X = space.z[:count], space.X
    soft = np.abs(z) <= NEAR_ZERO * small.size
    R = rigid_motions(small) if np.any(soft) else X[:, :0]
    if R.size:
        # In one space with motions without stiffness the other modes have few digits.
        few = max(count - R.shape[1], 2)
        space = Lanczos(small, -NEAR_ZERO * small.size, few, R)
        space.converge(0)
        z = space.z[:few]
        X = np.hstack([X, R])
    noise = float(np.max(floor(small, X)))
    return max(_BELOW * float(np.max(np.abs(z))), noise / EPS**0.5), R


def _growing(small: Linearised, start: float, count: int) -> tuple[_Found, float] | None:
    """Return all modes below a negative start, or at least the first `count` of them, and a cut.

    All modes below the cut are known. None if counts cannot confirm this.
    """
    found, cuts = _none(small), [start]
    counts = [Count(small, start)]
    while counts[-1].number:
        cuts.append(_FACTOR * cuts[-1])
        if abs(cuts[-1]) > _FAR * small.size:
            return None
        counts.append(Count(small, cuts[-1]))
    cut = cuts[-1]
    for j in range(len(cuts) - 2, -1, -1):
        if len(found.z) >= count:
            break
        cut = cuts[j]
        for _ in range(_SPACES):
            lacking = counts[j].number - found.below(cut)
            if lacking <= 0:
                break
            more = found.extended(cuts[j + 1], lacking)
            if more is None:
                return None
            found = more[0]
        distance = float(np.min(np.abs(found.z - cut), initial=abs(cut)))
        if found.below(cut) != counts[j].number or not counts[j].is_certain(found.X, distance):
            return None
    below = found.z < cut
    return replace(found, z=found.z[below], X=found.X[:, below]), cut


def _completed(found: _Found, shift: float | None, count: int, asked: int) -> _Found | None:
    """Return at least `count` modes next to a shift, with those found, confirmed by a count."""
    lacking, beyond = count - len(found.z), np.inf
    for _ in range(_SPACES):
        more = found.extended(shift, lacking)
        if more is None:
            return None
        found, beyond = more[0], min(beyond, more[1])
        if len(found.z) == found.small.n_free:
            return found
        # The widest gap after the requested modes: a group of coinciding modes is not cut.
        ends = np.append(found.z[found.z < beyond], beyond)[asked - 1 :]
        if len(ends) < 2:
            return None
        size = np.abs(ends[1:]) + EPS**0.5 * abs(shift or 0.0)
        widest = int(np.argmax(np.diff(ends) / size))
        cut = ends[widest] + BETWEEN * (ends[widest + 1] - ends[widest])
        counted = Count(found.small, cut if shift is not None else -cut, shift is None)
        known = found.below(cut)
        if counted.is_certain(found.X[:, :known], cut - ends[widest]):
            lacking = counted.number - known
            if not lacking:
                return found
        elif counted.fails:
            return None
        else:  # All known modes coincide: the end of the group is searched.
            lacking = max(lacking, count)
    return None


def _as_pairs(found: _Found, cut: float) -> tuple[Array, Array, Array] | None:
    """Return z, shapes and changes of z by Ritz's method, separate for z below and above a cut."""
    parts = []
    for side in (found.z < cut, found.z >= cut):
        if np.any(side):
            better = ritz(found.small, found.X[:, side])
            if better is None:
                return None
            parts.append((*better, np.abs(better[0] - found.z[side])))
    z, X, change = (np.concatenate([part[k] for part in parts], axis=-1) for k in range(3))
    return z, X, change
