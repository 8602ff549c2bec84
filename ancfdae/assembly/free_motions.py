"""Description of the free motions of a mechanism: which beams and bodies move, and how.

A motion without stiffness strains no beam, so each beam moves as a rigid body: v of its start and
omega are fitted to its node vectors. Several motions are combined so that each moves few beams in
a simple way (row echelon form of these numbers).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.assembly.layout import BodyLayout, Layout
from ancfdae.errors.text import listed
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.rotations import generators

# Parts of a motion below this are round-off of its null vector.
_SMALL = 1e-6
# A motion that is less rigid than this deforms the beam.
_RIGID = 1e-3
# A round bar turns in its bent shape: its nodes move by less than this part of its slopes.
_STAYS = 0.05
# Number of beams whose motion is described.
_SHOWN = 3


def motions_in_words(layout: Layout, q: Array, motions: Array) -> str:
    """Say which beams and bodies move, and how, in motions without stiffness, shape (n_q, k)."""
    bodies = [_Body.of(beam, layout.d, q) for beam in layout.bodies]
    fits = [body.fit(motions) for body in bodies]
    basis = np.concatenate([fit.rigid for fit in fits])
    size = max(fit.size for fit in fits)
    deformed = [b for b, fit in zip(bodies, fits, strict=True) if fit.left > _RIGID * size]
    if deformed:
        return listed(body.bent_words(motions, size) for body in deformed)
    texts = []
    for motion in _simplified(basis).T:
        parts = np.split(motion, len(bodies))
        large = _SMALL * np.max(np.abs(motion))
        both = zip(bodies, parts, strict=True)
        words = [body.words(part) for body, part in both if np.max(np.abs(part)) > large]
        more = [f"{len(words) - _SHOWN} more beams move"] if len(words) > _SHOWN else []
        texts.append(" while ".join(words[:_SHOWN] + more))
    return "; ".join(texts)


def _simplified(basis: Array) -> Array:
    """Combine columns so that each has a one where the others vanish, in the first rows."""
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
    """Rigid motions as columns, rows v/L and omega; size of the motions, and of the residual."""

    rigid: Array
    size: float
    left: float


@final
@dataclass(frozen=True)
class _Body:
    """A beam or a rigid body in its configuration: vectors X, shape (count, d), and size.

    `positions` are the places of positions among them.
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
        """Fit rigid motions to the given ones."""
        (n, d), count = self.X.shape, motions.shape[1]
        # Positions count over the length.
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
        # A turn of a straight cable about itself moves nothing.
        x = np.linalg.lstsq(A, right, rcond=_SMALL)[0]
        return _Fit(x, float(np.max(np.abs(right))), float(np.max(np.abs(right - A @ x))))

    def bent_words(self, motions: Array, size: float) -> str:
        """Say how it deforms without stiffness, in motions whose largest entry has this size."""
        moved = motions[self.columns].reshape(*self.X.shape, -1)[self.positions] / self.length
        if np.max(np.abs(moved)) <= _STAYS * size:
            return f"{self.name} turns about its own axis, bent as it is"
        return f"{self.name} deforms without stiffness"

    def words(self, motion: Array) -> str:
        """Say how it moves; v/L and omega in one array."""
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
        """Whether a place is the centre, or on the axis through it."""
        arm = place - centre
        if axis is not None:
            arm = arm - (arm @ axis) * axis
        return bool(np.linalg.norm(arm) <= _SMALL * self.length)


def _direction(v: Array) -> str:
    """Name an axis, or give its components."""
    unit = v / np.linalg.norm(v)
    for name, component in zip("xyz", unit, strict=False):
        if abs(component) >= 1.0 - _SMALL:
            return name
    first = next(x for x in unit if abs(x) > _SMALL)
    return f"({', '.join(f'{x:.3g}' for x in np.sign(first) * unit + 0.0)})"
