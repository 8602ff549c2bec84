"""Rigid motions of all bodies of a scene, and descriptions of free motions in words.

A motion of a body is x = (u, g): a displacement u of its middle c, and a rotation about it by the
Gibbs vector g (`numerics/rotations.py`). Positions go to c + u + R(g) (r - c), slopes to R(g) r_k.

A motion without stiffness strains no beam, so each beam moves as a rigid body: v of its start and
omega are fitted to its node vectors. Several motions are combined so that each moves few beams in a
simple way (row echelon form of these numbers).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
import scipy

from ancfdae.assembly.layout import BodyLayout, Layout
from ancfdae.errors.text import listed
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.patterns import SparsityPattern
from ancfdae.numerics.rotations import cayley, cayley_partials, generators


@final
class RigidMotions:
    """Rigid motions of bodies, x of shape (n_bodies, n_x), and their effect on vectors.

    n_x counts d displacements, and one rotation in the plane or three in space. `owner` is the
    index of the body of each vector of the scene, `positions` whether the vector is a position or a
    slope.
    """

    def __init__(self, owner: Array, positions: Array, d: int) -> None:
        self._owner, self._d, self._count = owner, d, int(owner[-1]) + 1
        self._is_position = positions.astype(float)
        self._per_body = np.bincount(owner, self._is_position)
        self.n_x = d + (1 if d == 2 else 3)

    @property
    def none(self) -> Array:
        """The zero motion of all bodies, shape (n_bodies, n_x)."""
        return np.zeros((self._count, self.n_x))

    def place(self, Z: Array, x: Array) -> Array:
        """Return the vectors Z, shape (n_vectors, d), after the rigid motions x."""
        arms, centres = self._split(Z)
        turned = np.einsum("vij,vj->vi", cayley(x[:, self._d :], self._d)[self._owner], arms)
        return turned + self._on_positions(centres + x[:, : self._d])

    def tangent(self, Z: Array, x: Array) -> Array:
        """Return the partials of `place` in the motion of each vector's body, (n_vectors, d, n_x).

        At x = 0 they are the rigid velocities: translations, and e_k x (r - c).
        """
        arms, _ = self._split(Z)
        partials = cayley_partials(x[:, self._d :], self._d)[:, self._owner]
        turns = np.einsum("kvij,vj->vik", partials, arms)
        shifts = self._is_position[:, None, None] * np.eye(self._d)
        return np.concatenate([shifts, turns], axis=2)

    def matrix(self, T: Array) -> scipy.sparse.csr_array:
        """Return a tangent of the rigid motions as a sparse matrix, shape (n_q, n_bodies n_x)."""
        n, d, n_x = T.shape
        rows = np.broadcast_to(np.arange(n * d).reshape(n, d, 1), T.shape)
        columns = np.broadcast_to(self._owner[:, None, None] * n_x + np.arange(n_x), T.shape)
        shape = (n * d, self._count * n_x)
        return scipy.sparse.csr_array((T.ravel(), (rows.ravel(), columns.ravel())), shape=shape)

    def array(self, T: Array) -> Array:
        """Return a tangent of the rigid motions as a dense array, shape (n_q, n_bodies n_x)."""
        n, d, n_x = T.shape
        matrix = np.zeros((n, d, self._count, n_x), dtype=T.dtype)
        matrix[np.arange(n), :, self._owner] = T
        return matrix.reshape(n * d, -1)

    def velocities(self, T: Array, x: Array) -> Array:
        """Return the velocities, (n_q,), of rigid motions at rates x, (n_bodies, n_x)."""
        return np.asarray(np.einsum("vix,vx->vi", T, x[self._owner]).ravel())

    def reach(self, pattern: SparsityPattern, B: Array, T: Array) -> Array:
        """Return the largest change of each row of B in translations and rotations, (n_rows, 2).

        B are values of Phi_q on `pattern`, T the tangents of the rigid motions.
        """
        vector, axis = np.divmod(pattern.columns, self._d)
        pair = pattern.rows.astype(np.int64) * self._count + self._owner[vector]
        order = np.argsort(pair, kind="stable")
        begins = np.flatnonzero(np.diff(pair[order], prepend=-1))
        moved = np.abs(np.add.reduceat((B[:, None] * T[vector, axis])[order], begins))
        sizes = np.stack([x.max(axis=1) for x in np.split(moved, [self._d], axis=1)], axis=1)
        reach = np.zeros((pattern.shape[0], 2))
        np.maximum.at(reach, pair[order][begins] // self._count, sizes)
        return reach

    def blocks(self, values: Array) -> scipy.sparse.csr_array:
        """Return matrices of each body, (n_bodies, n_x, n_x), as one sparse block matrix."""
        first = np.arange(self._count)[:, None, None] * self.n_x
        rows, columns = np.indices(values.shape[1:])
        at = [np.broadcast_to(first + x, values.shape).ravel() for x in (rows, columns)]
        size = self._count * self.n_x
        return scipy.sparse.csr_array((values.ravel(), tuple(at)), shape=(size, size))

    def array_of_blocks(self, values: Array) -> Array:
        """Return matrices of each body, (n_bodies, n_x, n_x), as one dense block diagonal array."""
        count, n_x, _ = values.shape
        matrix = np.zeros((count, n_x, count, n_x), dtype=values.dtype)
        matrix[np.arange(count), :, np.arange(count)] = values
        return matrix.reshape(count * n_x, -1)

    def collect(self, T: Array, f: Array) -> Array:
        """Return T^T f, (n_bodies, n_x): the forces f, (n_q,), on the rigid motions."""
        work = np.einsum("vix,vi->vx", T, f.reshape(-1, self._d))
        total = np.zeros((self._count, self.n_x), dtype=work.dtype)
        np.add.at(total, self._owner, work)
        return total

    def curvature(self, Z: Array, x: Array, f: Array) -> Array:
        """Return the partial of T^T f in x at fixed f, (n_bodies, n_x, n_x), due to rotations."""
        result = np.zeros((self._count, self.n_x, self.n_x))
        for k in range(self._d, self.n_x):
            moved = x.astype(complex)
            moved[:, k] += 1j * STEP
            result[:, :, k] = self.collect(self.tangent(Z, moved), f).imag / STEP
        return result

    def _split(self, Z: Array) -> tuple[Array, Array]:
        """Return node vectors with positions relative to the middle of their body, and middles."""
        total = np.zeros((self._count, self._d), dtype=Z.dtype)
        np.add.at(total, self._owner, self._is_position[:, None] * Z)
        centres = total / self._per_body[:, None]
        return Z - self._on_positions(centres), centres

    def _on_positions(self, of_bodies: Array) -> Array:
        return self._is_position[:, None] * of_bodies[self._owner]


# Relative size below which a component of a motion is round-off of its null vector.
_SMALL = 1e-6
# Residual of the rigid fit, relative to the motion, above which the beam deforms.
_RIGID = 1e-3
# Motion of nodes over motion of slopes up to which a bent round bar rotates within its shape.
_STAYS = 0.05
# Number of beams whose motion is described.
_SHOWN = 3


def motions_in_words(layout: Layout, q: Array, motions: Array) -> str:
    """Return a text on which bodies move, and how, in motions without stiffness, (n_q, k)."""
    bodies, fits, size = _fitted(layout, q, motions)
    deformed = [b for b, fit in zip(bodies, fits, strict=True) if fit.left > _RIGID * size]
    if deformed:
        return listed(body.bent_words(motions, size) for body in deformed)
    texts = []
    for motion in _simplified(np.concatenate([fit.rigid for fit in fits])).T:
        parts = np.split(motion, len(bodies))
        large = _SMALL * np.max(np.abs(motion))
        both = zip(bodies, parts, strict=True)
        words = [body.words(part) for body, part in both if np.max(np.abs(part)) > large]
        more = [f"{len(words) - _SHOWN} more beams move"] if len(words) > _SHOWN else []
        texts.append(" while ".join(words[:_SHOWN] + more))
    return "; ".join(texts)


def deforms(layout: Layout, q: Array, motions: Array) -> bool:
    """Return whether motions, (n_q, k), change the shape of a body, against its stiffness."""
    bodies, fits, size = _fitted(layout, q, motions)
    both = zip(bodies, fits, strict=True)
    return any(fit.left > _RIGID * size and not body.stays(motions, size) for body, fit in both)


def _fitted(layout: Layout, q: Array, motions: Array) -> tuple[list[_Body], list[_Fit], float]:
    """Return bodies, rigid motions fitted to them, and the size of the largest motion."""
    bodies = [_Body.of(beam, layout.d, q) for beam in layout.bodies]
    fits = [body.fit(motions) for body in bodies]
    return bodies, fits, max(fit.size for fit in fits)


def _simplified(basis: Array) -> Array:
    """Return combinations of the columns with ones where the other columns are zero."""
    basis = basis.copy()
    size, row = np.max(np.abs(basis)), 0
    for k in range(basis.shape[1]):
        while row < len(basis) and np.max(np.abs(basis[row, k:])) <= _SMALL * size:
            row += 1
        if row == len(basis):
            return basis[:, :k]
        best = k + int(np.argmax(np.abs(basis[row, k:])))
        basis[:, [k, best]] = basis[:, [best, k]]
        basis[:, k] /= basis[row, k]
        others = [j for j in range(basis.shape[1]) if j != k]
        basis[:, others] -= np.outer(basis[:, k], basis[row, others])
        row += 1
    return basis


@final
@dataclass(frozen=True)
class _Fit:
    """Rigid motions as columns with rows v/L and omega; norms of motions and of the residual."""

    rigid: Array
    size: float
    left: float


@final
@dataclass(frozen=True)
class _Body:
    """A beam or rigid body in its configuration: vectors X, shape (count, d), and size, m.

    `positions` are the indices of positions among the vectors.
    """

    name: str
    X: Array
    positions: Array
    length: float
    columns: slice

    @staticmethod
    def of(beam: BodyLayout, d: int, q: Array) -> _Body:
        columns = slice(beam.first_vector * d, (beam.first_vector + beam.count) * d)
        positions = beam.positions - beam.first_vector
        return _Body(beam.name, q[columns].reshape(-1, d), positions, beam.size, columns)

    @property
    def r(self) -> Array:
        """Positions of the nodes, shape (n, d)."""
        return self.X[self.positions]

    def fit(self, motions: Array) -> _Fit:
        """Return the rigid motions of the body fitted to motions of the scene, (n_q, k)."""
        (n, d), count = self.X.shape, motions.shape[1]
        # Positions are divided by the length.
        unit = np.ones((n, 1))
        unit[self.positions] = self.length
        arms = self.X / unit
        arms[self.positions] -= arms[0]
        turned = np.einsum("kij,nj->nik", generators(d), arms)
        shifted = np.zeros((n, d, d))
        shifted[self.positions] = np.eye(d)
        A = np.concatenate([shifted, turned], axis=2).reshape(self.X.size, -1)
        right = motions[self.columns].reshape(*self.X.shape, count) / unit[..., None]
        right = right.reshape(-1, count)
        # A rotation of a straight cable about its axis moves nothing.
        x = np.linalg.lstsq(A, right, rcond=_SMALL)[0]
        return _Fit(x, float(np.max(np.abs(right))), float(np.max(np.abs(right - A @ x))))

    def stays(self, motions: Array, size: float) -> bool:
        """Return whether only slopes move, as of a bent round bar that turns within its shape.

        `size` is the largest entry of the motions.
        """
        moved = motions[self.columns].reshape(*self.X.shape, -1)[self.positions] / self.length
        return bool(np.max(np.abs(moved)) <= _STAYS * size)

    def bent_words(self, motions: Array, size: float) -> str:
        """Return a text on how the body deforms in motions whose largest entry is `size`."""
        if self.stays(motions, size):
            return f"{self.name} turns about its own axis, bent as it is"
        return f"{self.name} deforms"

    def words(self, motion: Array) -> str:
        """Return a text on how the body moves, from v/L and omega in one array."""
        d = self.r.shape[1]
        v, spin = motion[:d] * self.length, motion[d:]
        turning = float(np.linalg.norm(spin))
        if turning * self.length <= _SMALL * np.linalg.norm(v):
            return f"{self.name} moves along {_direction(v)}"
        if d == 2:
            centre = self.r[0] + np.array([-v[1], v[0]]) / spin[0]
            return f"{self.name} turns about {self._place(centre)}"
        axis = spin / turning
        centre = self.r[0] + np.cross(axis, v) / turning
        about = f"the axis {_direction(axis)} through {self._place(centre, axis)}"
        chord = (self.r[-1] - self.r[0]) / self.length
        along = np.any(chord) and np.linalg.norm(np.cross(axis, chord)) <= _SMALL
        if along and self._near(self.r[0], centre, axis):
            about = "its own axis"
        pitch = abs(v @ axis) > _SMALL * turning * self.length
        return f"{self.name} turns about {about}{' and moves along it' if pitch else ''}"

    def _place(self, centre: Array, axis: Array | None = None) -> str:
        names = ("its origin",) if len(self.r) == 1 else ("its start", "its end")
        for name, place in zip(names, (self.r[0], self.r[-1]), strict=False):
            if self._near(place, centre, axis):
                return name
        rounded = self.length * np.round(centre / self.length, 6) + 0.0
        return f"({', '.join(f'{x:.4g}' for x in rounded)})"

    def _near(self, place: Array, centre: Array, axis: Array | None) -> bool:
        """Whether a position is at the centre of rotation, or on the axis through it."""
        arm = place - centre
        if axis is not None:
            arm = arm - (arm @ axis) * axis
        return bool(np.linalg.norm(arm) <= _SMALL * self.length)


def _direction(v: Array) -> str:
    """Return the name of an axis, such as ``x``, or else its components as text."""
    unit = v / np.linalg.norm(v)
    for name, component in zip("xyz", unit, strict=False):
        if abs(component) >= 1.0 - _SMALL:
            return name
    first = next(x for x in unit if abs(x) > _SMALL)
    return f"({', '.join(f'{x:.3g}' for x in np.sign(first) * unit + 0.0)})"
