"""The numeric data of one joint, and the right angles of sections that joints keep."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.layout import Layout
from ancfdae.errors.checks import require_index
from ancfdae.model.elements import Quantity
from ancfdae.model.joints.formula_joint import FormulaJoint
from ancfdae.model.joints.joint import Joint, JointEquations, RightAngle
from ancfdae.numerics.arrays import STEP, Array

_FLAT = frozenset((Quantity.SLOPE_Y, Quantity.SLOPE_Z))
# Fraction of the element length within which two locations count as one.
_NEAR = 1e-6


@final
class HeldAngles:
    """The right angles of sections that joints keep so far.

    Slopes of a section are linear along an element, and so is the change of its right angle: two
    sections of an element fix it in every other one. Bodies in `rigid` keep their shape by
    themselves; elements without a section have no right angle.
    """

    def __init__(self, layout: Layout, rigid: Container[str] = ()) -> None:
        self._layout, self._rigid = layout, rigid
        self._named: set[RightAngle] = set()
        self._flat: dict[str, Array] = {}

    def add(self, angle: RightAngle) -> bool:
        """Add a right angle of a section; return whether it needs an equation."""
        if angle.fraction is None or angle.beam in self._rigid or angle in self._named:
            return False
        beam = self._layout.beam(angle.beam)
        if Quantity.SLOPE_Y not in beam.element.quantities:
            return False
        self._named.add(angle)
        if angle.slopes != _FLAT:
            return True
        element, xi = beam.locate(angle.fraction, angle.before)
        weights = np.zeros((1, beam.element_count + 1))
        weights[0, element], weights[0, element + 1] = 1 - xi, xi
        held = self._flat.get(angle.beam, weights[:0])
        both = np.vstack([held, weights])
        if np.linalg.matrix_rank(both, tol=_NEAR) == len(held):
            return False
        self._flat[angle.beam] = both
        return True


@final
@dataclass(frozen=True)
class JointInput:
    """One joint with its parameters, (n_p,), reference vectors, (n_vectors, d), and partials.

    `reference_b` holds the design derivatives of the reference vectors by design variable. The
    equations `dropped` are left out. `alike` caches the equations of joints of one kind with the
    same numbers.
    """

    joint: Joint
    p: Array
    p_b: Array
    reference: Array
    reference_b: dict[int, Array]
    dropped: tuple[int, ...] = ()
    alike: dict[object, tuple[Joint, list[JointEquations]]] = field(
        default_factory=dict, repr=False
    )

    @cached_property
    def kind(self) -> tuple[object, ...]:
        """Cache key of a joint's coefficients: equal for joints of one class with equal numbers."""
        joint, p, numbers = self.joint, self.p, self.reference
        which: tuple[object, ...] = (joint.name,)
        if joint.by_slopes:
            places = {(x.beam, x.fraction, x.before) for x in joint.points}
            which, numbers = (type(joint), len(places)), numbers[len(joint.points) :]
        return (*which, p.dtype, p.tobytes(), numbers.dtype, numbers.tobytes(), self.dropped)

    @cached_property
    def parts(self) -> list[JointEquations]:
        """Joint coefficients constant in time, then those multiplied by each factor of time."""
        joint, p, reference = self.joint, self.p, self.reference
        if self.kind in self.alike:
            other, parts = self.alike[self.kind]
            if other is not joint and any(c.shapes for c in parts):
                parts = [c.at_points(other.points, joint.points) for c in parts]
            return parts
        if self.dropped:
            parts = [c.without(self.dropped) for c in replace(self, dropped=()).parts]
        else:
            parts = [joint.checked_coefficients(p, reference), *joint.moving(p, reference)]
        self.alike[self.kind] = joint, parts
        return parts

    @property
    def input_count(self) -> int:
        """Number of inputs of formulas: parameters, reference vectors, and laws; 0 without."""
        if not isinstance(self.joint, FormulaJoint):
            return 0
        return len(self.p) + self.reference.size + len(self.joint.laws)

    def inputs(self) -> Array:
        """Return the inputs of all parts, (n_parts, input_count); a law is 1 in its own part."""
        laws, count = len(self.parts) - 1, self.input_count
        inputs = np.zeros((1 + laws, count), np.result_type(self.p, self.reference))
        if count:
            inputs[0, : count - laws] = np.concatenate([self.p, self.reference.ravel()])
            inputs[1:, count - laws :] = np.eye(laws)
        return inputs

    def factors(self, t: Array, order: int) -> Array:
        """Return the factors of time, or a time derivative of them, shape (n_factors, k)."""
        return self.joint.factors(self.p, t, order)

    def by_turn(self, t: Array) -> Array:
        """Return the derivatives of the factors in a prescribed angle, shape (n_factors, k)."""
        return self.joint.by_turn(self.p, t)

    def turn_rate(self, t: Array) -> Array:
        """Return the rate of a prescribed angle at times t, shape (k,); rad/s."""
        return self.joint.turn_rate(self.p, t)

    def shaped(self, held: HeldAngles, left_out: Sequence[int] = ()) -> JointInput:
        """Return the joint without right angles that are kept already, and without `left_out`."""
        c = self.parts[0]
        shapes = enumerate(c.shapes, len(c.offset) - len(c.shapes))
        dropped = [row for row, angle in shapes if not held.add(angle)]
        for row in left_out:
            require_index(
                f"Scene.left_out, equation of {self.joint.name!r}",
                row,
                len(c.offset),
                "Counted from 0.",
            )
        dropped = sorted({*dropped, *left_out})
        return replace(self, dropped=tuple(dropped)) if dropped else self

    @property
    def active(self) -> set[int]:
        """Design variables on which the coefficients may depend."""
        return {*np.flatnonzero(np.any(self.p_b, axis=0)).tolist(), *self.reference_b}

    def moved(self, i: int) -> JointInput:
        """Return the joint with design variable i perturbed by an imaginary step."""
        p, reference = self.p + 1j * STEP * self.p_b[:, i], self.reference
        if i in self.reference_b:
            reference = reference + 1j * STEP * self.reference_b[i]
        return replace(self, p=p, reference=reference, alike={})

    def structure(self) -> JointEquations:
        """Return joint coefficients whose zeros are zero for all parameters and times."""
        # Generic parameters: a coefficient that is not zero by structure is nonzero here.
        p = self.p * (1 + 1j * STEP) + 1j * STEP * np.sqrt(1.0 + np.arange(len(self.p)))
        reference = self.reference + 1j * STEP * sum(self.reference_b.values())
        parts = [*self.parts, *replace(self, p=p, reference=reference).parts]

        def size(x: Sequence[Array]) -> Array:
            return np.asarray(sum(np.abs(part.real) + np.abs(part.imag) for part in x))

        linear, bilinear = size([c.linear for c in parts]), size([c.bilinear for c in parts])
        return JointEquations(linear, bilinear, parts[0].offset)
