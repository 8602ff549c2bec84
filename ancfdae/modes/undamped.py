"""Modes without damping.

What is rigid, and which modes coincide, is decided by the round-off of x^T K x itself, so that
neither units nor stiff waves of the section matter.
"""

from __future__ import annotations

import numpy as np

from ancfdae.modes import dense, sparse
from ancfdae.modes.linearised import ROUND_OFF, Linearised
from ancfdae.modes.pairs import Eigenpairs, finished, likely_error
from ancfdae.modes.precise import ALLOWED, NoModes, lost, precise_modes, refuse_lost
from ancfdae.modes.rigid import floor, rigid_motions, with_zeros
from ancfdae.modes.sharpening import each_sharpened, sharpened
from ancfdae.numerics.arrays import Array

# Up to this many independent motions dense matrices are faster; damped ones have twice as many
# exponents, all of which dense methods find (docs/measurements.md, "Modes").
_DENSE, _DENSE_DAMPED = 300, 120
# ARPACK needs room for its basis.
_ROOM = 40
# Part of the next value that one counts as freed by a load at.
_FREED = 1e-3


def undamped(small: Linearised, count: int, highest: bool) -> Eigenpairs:
    """Return the lowest z = -s^2, or the highest, and their shapes.

    NoModes if one of them could be off by more than a part of 2e-6.
    """
    if not small.symmetric:
        return _asymmetric(small, count, highest)
    z, X = (dense if is_small(small, count) else sparse).undamped(small, count, highest)
    change = np.zeros(len(z))
    if not highest:
        z, X, change = with_zeros(small, *sharpened(small, z, X))
    order = np.argsort(-z if highest else z, kind="stable")
    pairs = finished(small, z[order], X[:, order])
    left = likely_error(small, pairs, change[order])
    missing = lost(pairs.z, left)
    if highest or not (len(missing) or _mixed(small, pairs)):
        return pairs
    try:
        z, X, noise = precise_modes(small, pairs.X)
        # Before round-off is named zero: the rigid motions are, and no other is one of them.
        refuse_lost(small, z, noise)
        precise = _sorted(finished(small, z, X, noise))
    except NoModes:
        if _freed(pairs.z, left, missing):
            return pairs
        raise
    return precise


def _mixed(small: Linearised, pairs: Eigenpairs) -> bool:
    """Whether modes with z = 0 may be, or contain, others that are not rigid.

    `separated` leaves them a part (sigma / z)^3 of a shape with z, which takes its square of z; and
    all shapes with z below sigma are zero to round-off.
    """
    zero = pairs.z == 0
    if not np.any(zero):
        return False
    sigma = ROUND_OFF * float(np.max(floor(small, pairs.X[:, zero])))
    least = np.min(np.abs(pairs.z[~zero]), initial=np.inf)
    return bool(sigma > ALLOWED ** (1 / 6) * least)


def _sorted(pairs: Eigenpairs) -> Eigenpairs:
    """By growing z, of which round-off may be named zero since they were found."""
    order = np.argsort(pairs.z, kind="stable")
    return Eigenpairs(pairs.z[order], pairs.X[:, order], pairs.noise[order])


def _asymmetric(small: Linearised, count: int, highest: bool) -> Eigenpairs:
    rigid = rigid_motions(small)
    if is_small(small, count):
        z, X = dense.asymmetric(small, rigid)
    else:
        z, X = sparse.undamped(small, count, highest, rigid)
    order = np.lexsort((z.imag, -z.real if highest else z.real))[:count]
    z, X, change = with_rigid(rigid, *each_sharpened(small, z[order], X[:, order]))
    order = np.argsort(-z.real if highest else z.real, kind="stable")[:count]
    pairs = finished(small, z[order], X[:, order])
    refuse_lost(small, pairs.z, likely_error(small, pairs, change[order]))
    return pairs


def with_rigid(rigid: Array, z: Array, X: Array, change: Array) -> tuple[Array, Array, Array]:
    """Return values, shapes and changes of values with those of rigid motions in front."""
    none = np.zeros(rigid.shape[1])
    return np.append(none, z), np.hstack([rigid, X]), np.append(none, change)


def _freed(z: Array, noise: Array, missing: Array) -> bool:
    """Whether a load has all but freed these motions, so that round-off counts beside the others.

    Next to a critical load z passes through zero. Neighbouring z of beams without a load differ by
    a factor of 40 at most.
    """
    others = np.setdiff1d(np.flatnonzero(z != 0), missing)
    least = np.min(np.abs(z[others]), initial=np.inf)
    if not np.isfinite(least):
        return False
    small = np.abs(z[missing]) < _FREED * least
    return bool(np.all(small & (noise[missing] <= ALLOWED * least)))


def is_small(small: Linearised, count: int) -> bool:
    """Whether `count` modes are found faster with dense matrices."""
    size = _DENSE if small.D is None else _DENSE_DAMPED
    return small.n_free <= max(size, 3 * count + _ROOM)
