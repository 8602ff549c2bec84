"""Redundant joint equations, which other equations imply, left out of a scene on request.

Rows of Phi_q, scaled by the weights of the coordinates and to unit length, are combined to zero by
the columns of N, a basis of the null space of the transpose. Rows may be left out together where
their part of N is a regular matrix. As many as N has columns are chosen one after the other by
pivots: the length of a row of N after its part along the rows chosen before is taken off. The last
one of the rows with similar pivots is taken. Directions of hinges are left out before positions of
points, and never rows of bodies that are rigid, of driven joints and of formulas.

The remaining rows should be independent wherever the mechanism moves; they are dependent where the
determinant of the chosen rows of N changes its sign. The determinant is computed along curves
through the declared position, and rows are exchanged until it keeps its sign.

Rows may also depend on each other at one position only, a dead point, where two branches of the
motion cross. Redundant equations hold along every motion that the remaining equations admit: this
is checked at the beginning of the curves, at a distance `_STEP` times the size of the mechanism.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ancfdae.assembly.geometry import Rigidity
from ancfdae.assembly.joint_structure import JointStructure
from ancfdae.assembly.system import AncfSystem, assemble
from ancfdae.errors.checks import require_kind
from ancfdae.errors.kinds import RedundantConstraintsError
from ancfdae.errors.text import listed
from ancfdae.model.joints.joint import FormulaJoint
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array

# Singular value below which rows of unit length are dependent; round-off leaves 1e-16 times the
# number of rows and the condition of the mechanism.
_DEPENDENT = 1e-8
# Smallest pivot, over the largest one, that counts as similar. A kind of row is skipped if its
# largest pivot is below _POOR.
_SIMILAR, _POOR = 0.4, 1e-3
# Number of pairs of curves in opposite directions; lengths of their first and of further steps over
# the size of the mechanism; largest number of steps, and of steps times rows.
_PAIRS, _STEP, _STRIDE, _STEPS, _ROWS = 2, 0.02, 0.1, 40, 4000
# Smallest cosine of the rotation of the null space in a step; the step is halved below it, down to
# _SHORTEST times the size of the mechanism.
_NEAR, _SHORTEST = 0.7, 1e-3
# Smallest determinant, over the largest along the curves, that counts as regular.
_LASTING = 0.1
# Largest violation of the equations at the end of a step over the step: at a dead point about
# _STEP.
_VIOLATED = 1e-8
# Largest number of Newton iterations onto the equations, and the correction, over the size of the
# mechanism, at which they end.
_ITERATIONS, _CLOSED = 12, 1e-13


def drop_redundant(scene: Scene) -> Scene:
    """Return the scene without the equations of joints that other joints imply.

    A closed chain of hinges in space holds some directions twice: of a planar four-bar with four
    `Revolute` joints three equations are redundant, of Bricard's mechanism one. Motion and design
    derivatives do not depend on which of them are left out. Gradients refuse a variable that opens
    a joint of which an equation is left out: the motion has no derivative in the length of one
    crank of a parallelogram with three. Multipliers, and with them reactions, depend on the choice:
    in rigid bodies no equation says how redundant joints share a force. A joint keeps its position
    as long as directions of axes can be left out instead, and as the equations that stay are then
    independent along the motion.

    Returns
    -------
    Scene
        The scene with `left_out`: pairs of the name of a joint and the number of an equation of it,
        counted from 0; the scene prints them. The scene itself if no equation is redundant.

    Raises
    ------
    RedundantConstraintsError
        If equations depend on each other at the declared position only, which is a dead point, or
        if a driven joint or a joint by formulas is redundant.
    """
    require_kind("drop_redundant, scene", scene, (Scene,), "Call Scene(...).")
    scene = replace(scene, left_out=())
    rows = _Rows(assemble(scene.at_rest() or scene))
    N = rows.null_space()
    if not N.shape[1]:
        return scene
    redundant = _pivots(N, rows.kinds)
    rows.require_movable(redundant)
    spaces = np.stack([N, *rows.null_spaces(N, redundant)])
    redundant = _exchanged(spaces, redundant, rows.kinds)
    return replace(scene, left_out=[rows.labels[row] for row in redundant])


class _Rows:
    """Rows of Phi_q of an assembled scene, with labels, kinds, and the rows of moving joints.

    `labels` are pairs (joint, equation). `kinds` are 0 for rows that are never left out, 1 for
    positions and 2 for all others. `moving` are the rows without driven joints.
    """

    def __init__(self, system: AncfSystem) -> None:
        self._system, self._q = system, system.start()[0]
        rows = list(_labelled(system.inputs.joints(), system.naming.layout.d))
        self.labels = [label for label, *_ in rows]
        self.kinds = np.array([kind for _, kind, _ in rows], dtype=int)
        self.moving = np.flatnonzero([not driven for *_, driven in rows])
        self._root = np.sqrt(system.weights)
        self._size = float(np.linalg.norm(self._root * system.centred(self._q)))

    def null_space(self) -> Array:
        """Return combinations of all rows that vanish at the start, orthonormal, (n_lam, m)."""
        U, s, _ = _decomposed(self._scaled(self._q, np.arange(len(self.labels)))[0])
        return U[:, np.count_nonzero(s > _DEPENDENT) :]

    def null_spaces(self, N: Array, redundant: Array) -> list[Array]:
        """Return the null space N at each step along all curves, (n_lam, m) each.

        Raises RedundantConstraintsError, with the joints of redundant rows, at a dead point.
        """
        moving, count = self.moving, int(np.clip(_ROWS // len(N), 2, _STEPS))
        _, s, V = _decomposed(self._scaled(self._q, moving)[0])
        rank = int(np.count_nonzero(s > _DEPENDENT))
        self._require_everywhere(redundant, len(moving) - rank == len(redundant))
        rng, found = np.random.default_rng(1), list[Array]()
        for _ in range(_PAIRS):
            along = rng.normal(size=len(self._q))
            along -= V[:rank].T @ (V[:rank] @ along)
            # The mechanism cannot move: equations that hold at the start always hold.
            if np.linalg.norm(along) < _DEPENDENT * np.sqrt(len(along)):
                break
            for way in (along, -along):
                curve = self._curve(way, rank, N[moving], redundant)
                found += itertools.islice(curve, count)
        spaces = np.zeros((len(found), *N.shape))
        spaces[:, moving] = np.reshape(found, (len(found), len(moving), -1))
        return list(spaces)

    def _curve(self, along: Array, rank: int, N: Array, redundant: Array) -> Iterator[Array]:
        """Yield the null space N of the moving rows after each step along a curve.

        The curve ends where the equations do not hold; in the first step RedundantConstraintsError
        is raised.
        """
        q, step = self._q, _STEP * self._size
        while step > _SHORTEST * self._size:
            end = q + step / np.linalg.norm(along) * along / self._root
            for _ in range(_ITERATIONS):
                A, left = self._scaled(end, self.moving)
                U, s, V = _decomposed(A)
                change = V[:rank].T @ ((U[:, :rank].T @ left) / s[:rank])
                if np.linalg.norm(change) <= _CLOSED * self._size:
                    break
                end = end - change / self._root
            if not np.all(np.abs(left) <= _VIOLATED * step):
                self._require_everywhere(redundant, q is not self._q)
                return
            P, cosines, Q = np.linalg.svd(U[:, rank:].T @ N)
            if np.min(cosines) < _NEAR:
                step /= 2
                continue
            N = U[:, rank:] @ P @ Q
            yield N
            along, q = self._root * (end - q), end
            along -= V[:rank].T @ (V[:rank] @ along)
            step = min(2 * step, _STRIDE * self._size)

    def _scaled(self, q: Array, rows: Array) -> tuple[Array, Array]:
        """Return `rows` of Phi_q over root weights, of unit length, and Phi scaled alike."""
        system = self._system
        B = system.constraint_pattern.dense(system.constraint_q(0.0, q))[rows] / self._root
        length = np.linalg.norm(B, axis=1)
        length[length == 0] = 1.0
        return B / length[:, None], system.constraint(0.0, q)[rows] / length

    def require_movable(self, redundant: Array) -> None:
        """Raise RedundantConstraintsError if a redundant row must not be left out (kind 0)."""
        fixed = redundant[self.kinds[redundant] == 0]
        if fixed.size:
            raise RedundantConstraintsError(
                self._joints(fixed),
                "driven joints, joints by formulas and rigid bodies must be independent",
                f"{fixed.size} of their equations that others imply",
                "Remove one of the joints that hold the same.",
            )

    def _require_everywhere(self, redundant: Array, holds: bool) -> None:
        """Raise RedundantConstraintsError unless redundant rows `holds` near the start, too."""
        if not holds:
            raise RedundantConstraintsError(
                self._joints(redundant),
                "equations that are left out must follow from the others in every position",
                "equations that do so at the declared position only: a dead point, or two "
                "drivers of one motion",
                "Declare the mechanism beside this position, or remove a driver.",
            )

    def _joints(self, rows: Array) -> str:
        """Return a text with the names of the joints of some rows."""
        return f"joints {listed(map(repr, sorted({self.labels[row][0] for row in rows})))}"


def _labelled(structure: JointStructure, d: int) -> Iterator[tuple[tuple[str, int], int, bool]]:
    """Yield, for each joint equation, joint and row, its kind, and whether the joint is driven."""
    for slot, layout in zip(structure.slots, structure.joints, strict=True):
        joint = slot.item.joint
        rows = np.delete(np.arange(layout.rows + len(slot.item.dropped)), slot.item.dropped)
        by_formulas = isinstance(joint, FormulaJoint) and len(rows) != 1
        fixed = joint.driven or isinstance(joint, Rigidity) or by_formulas
        for row in rows.tolist():
            kind = 0 if fixed else 1 if joint.holds_position and row < d else 2
            yield (layout.name, row), kind, joint.driven


def _decomposed(B: Array) -> tuple[Array, Array, Array]:
    """Return the singular value decomposition U, s, V^T of rows, with all columns of U."""
    return np.linalg.svd(B, full_matrices=len(B) > B.shape[1])


def _pivots(N: Array, kinds: Array) -> Array:
    """Return the indices of rows to leave out, (m,), from a null space, (n, m)."""
    left, chosen = N.copy(), list[int]()
    for _ in range(N.shape[1]):
        pivots = np.linalg.norm(left, axis=1)
        for which in (kinds == 2, kinds > 0, kinds >= 0):
            largest = np.max(pivots[which], initial=0.0)
            if largest > _POOR:
                break
        row = np.flatnonzero(which & (pivots >= _SIMILAR * largest))[-1]
        chosen.append(row)
        u = left[row] / pivots[row]
        left -= np.outer(left @ u, u)
    return np.sort(np.array(chosen, dtype=int))


def _exchanged(spaces: Array, redundant: Array, kinds: Array) -> Array:
    """Return rows to leave out, (m,), exchanged until the determinant keeps its sign.

    `spaces`, (k, n, m), are the null spaces at the start and along the curves.
    """
    for _ in redundant:
        M = spaces[:, redundant]
        signs, logarithms = np.linalg.slogdet(M)
        sizes = signs * np.exp(logarithms - np.max(logarithms))
        lasting = _lasting(sizes)
        if lasting >= _LASTING:
            break
        # Row j in place of the chosen row i multiplies the determinant by the entry (j, i).
        factors = spaces @ np.linalg.pinv(M)
        new = _lasting(sizes[:, None, None] * factors)
        new[np.abs(factors[0]) < _POOR] = -np.inf
        new[redundant] = -np.inf
        for which in (kinds == 2, kinds > 0):
            best = np.max(new[which], initial=-np.inf)
            if best >= _LASTING:
                break
        similar = best - (1 - _SIMILAR) * abs(best)
        if lasting >= similar:
            break
        row, chosen = np.argwhere(which[:, None] & (new >= similar))[-1]
        redundant[chosen] = row
    return np.sort(redundant)


def _lasting(sizes: Array) -> Array:
    """Return least over largest of k determinants, (k, ...); negative if their signs differ."""
    return np.min(sizes * np.sign(sizes[0]), axis=0) / np.max(np.abs(sizes), axis=0)
