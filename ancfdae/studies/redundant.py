"""Redundant joint equations, which other equations imply, left out of a scene on request.

Rows of Phi_q, scaled by the weights of the coordinates and to unit length, are processed one after
the other; a row is redundant if it lies in the span of the rows before. Rows of rigid bodies, of
driven joints and of formulas come first, then positions, then all others, so that directions of
hinges are left out before positions of points.

Rows may also be dependent at one position only, a dead point, where two branches of the motion
cross. Redundant equations hold along every motion that the other equations admit: this is checked
at positions at a distance of `_STEP` times the size of the mechanism.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ancfdae.assembly.joint_structure import JointStructure
from ancfdae.assembly.part_inputs import Rigidity
from ancfdae.assembly.system import AncfSystem, assemble
from ancfdae.errors.checks import require_kind
from ancfdae.errors.kinds import RedundantConstraintsError
from ancfdae.errors.text import listed
from ancfdae.model.joints.formula_joint import FormulaJoint
from ancfdae.model.scene import Scene
from ancfdae.numerics.arrays import Array

# Length of the part of a unit row outside the span of other rows below which it is redundant;
# round-off leaves 1e-16 times the number of rows and the condition of the mechanism.
_DEPENDENT = 1e-8
# Number of positions near the declared one, their distance in units of the size, and the violation
# of equations left out that is admitted there, over the distance. At a dead point it is about
# _STEP.
_POSITIONS, _STEP, _VIOLATED = 3, 0.02, 1e-8
# Newton iterations onto the other equations, from a violation of _STEP^2.
_ITERATIONS = 12


def drop_redundant(scene: Scene) -> Scene:
    """Return the scene without the equations of joints that other joints imply.

    A closed chain of hinges in space holds some directions twice: of a planar four-bar with four
    `Revolute` joints three equations are redundant, of Bricard's mechanism one. Motion and design
    derivatives do not depend on which of them are left out. Multipliers, and with them reactions,
    do: in rigid bodies no equation says how redundant joints share a force. A joint keeps
    its position as long as directions of axes can be left out instead.

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
    system = assemble(scene.at_rest() or scene)
    names = _Rows(system)
    kept = _independent(names.scaled(system.start()[0]), np.argsort(names.kinds, kind="stable"))
    redundant = np.setdiff1d(np.arange(system.n_lam), kept)
    if not redundant.size:
        return scene
    names.require_movable(redundant)
    names.require_everywhere(kept, redundant)
    return replace(scene, left_out=[names.labels[row] for row in redundant])


class _Rows:
    """Rows of Phi_q of an assembled scene: labels, kinds, and values at a configuration.

    `labels` are pairs (joint, equation). `kinds` are 0 for rows that are never left out, 1 for
    positions and 2 for all others. `driven` is whether rows belong to driven joints.
    """

    def __init__(self, system: AncfSystem) -> None:
        self._system = system
        rows = list(_labelled(system.inputs.joints(), system.naming.layout.d))
        self.labels = [label for label, *_ in rows]
        self.kinds = np.array([kind for _, kind, _ in rows], dtype=int)
        self.driven = np.array([driven for *_, driven in rows], dtype=bool)

    def scaled(self, q: Array) -> Array:
        """Return Phi_q at q, columns over sqrt(weights), rows of unit length, (n_lam, n_q)."""
        system = self._system
        B = system.constraint_pattern.dense(system.constraint_q(0.0, q))
        B = B / np.sqrt(system.weights)
        length = np.linalg.norm(B, axis=1, keepdims=True)
        return B / np.where(length > 0, length, 1.0)

    def require_movable(self, redundant: Array) -> None:
        """Raise RedundantConstraintsError if a redundant row must not be left out (kind 0)."""
        fixed = redundant[self.kinds[redundant] == 0]
        if fixed.size:
            names = sorted({self.labels[row][0] for row in fixed})
            raise RedundantConstraintsError(
                f"joints {listed(map(repr, names))}",
                "driven joints, joints by formulas and rigid bodies must be independent",
                f"{fixed.size} of their equations that others imply",
                "Remove one of the joints that hold the same.",
            )

    def require_everywhere(self, kept: Array, redundant: Array) -> None:
        """Raise RedundantConstraintsError unless redundant rows also hold near the start."""
        held = kept[~self.driven[kept]]
        for q, way in self._beside(held):
            B = self._system.constraint_pattern.dense(self._system.constraint_q(0.0, q))
            size = np.linalg.norm(B / np.sqrt(self._system.weights), axis=1)
            violated = np.abs(self._system.constraint(0.0, q)) > _VIOLATED * way * size
            wrong = redundant[violated[redundant]]
            if wrong.size:
                names = sorted({self.labels[row][0] for row in wrong})
                raise RedundantConstraintsError(
                    f"joints {listed(map(repr, names))}",
                    "equations that are left out must follow from the others in every position",
                    "equations that do so at the declared position only: a dead point, or two "
                    "drivers of one motion",
                    "Declare the mechanism beside this position, or remove a driver.",
                )

    def _beside(self, held: Array) -> Iterator[tuple[Array, float]]:
        """Yield states q that satisfy the joint equations `held`, and distances from the start."""
        system, (q, _) = self._system, self._system.start()
        root, rng = np.sqrt(system.weights), np.random.default_rng(1)
        size = float(np.linalg.norm(root * system.centred(q)))
        B = self.scaled(q)[held]
        for _ in range(_POSITIONS):
            along = rng.normal(size=len(q))
            along -= np.linalg.pinv(B) @ (B @ along)
            length = np.linalg.norm(along)
            # The mechanism cannot move: equations that hold at the start always hold.
            if length < _DEPENDENT * np.sqrt(len(q)):
                return
            beside = q + _STEP * size / length * along / root
            for _ in range(_ITERATIONS):
                A = system.constraint_pattern.dense(system.constraint_q(0.0, beside))[held]
                left = system.constraint(0.0, beside)[held]
                beside = beside - np.linalg.lstsq(A / root, left, rcond=None)[0] / root
            yield beside, _STEP * size


def _labelled(structure: JointStructure, d: int) -> Iterator[tuple[tuple[str, int], int, bool]]:
    """Yield, for each joint equation, joint and row, its kind, and whether the joint is driven."""
    for slot, layout in zip(structure.slots, structure.joints, strict=True):
        joint = slot.item.joint
        fixed = joint.driven or isinstance(joint, (Rigidity, FormulaJoint))
        rows = np.delete(np.arange(layout.rows + len(slot.item.dropped)), slot.item.dropped)
        for row in rows.tolist():
            kind = 0 if fixed else 1 if joint.holds_position and row < d else 2
            yield (layout.name, row), kind, joint.driven


def _independent(rows: Array, order: Array) -> Array:
    """Return the indices, (n,), of the rows outside the span of rows earlier in `order`, sorted."""
    basis, kept = np.zeros((min(rows.shape), rows.shape[1])), list[int]()
    for row in order.tolist():
        if len(kept) == len(basis):
            break
        own, taken = rows[row], basis[: len(kept)]
        # Once more, since the first difference is not orthogonal to round-off.
        for _ in range(2):
            own = own - taken.T @ (taken @ own)
        length = np.linalg.norm(own)
        if length > _DEPENDENT:
            basis[len(kept)] = own / length
            kept.append(row)
    return np.sort(np.array(kept, dtype=int))
