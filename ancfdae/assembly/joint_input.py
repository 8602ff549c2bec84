"""The numeric data of one joint."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.model.joints.formula_joint import FormulaJoint
from ancfdae.model.joints.joint import Joint, JointEquations
from ancfdae.numerics.arrays import STEP, Array


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
        linear, bilinear = (
            np.asarray(sum(np.abs(x.real) + np.abs(x.imag) for x in coefficients))
            for coefficients in ([c.linear for c in parts], [c.bilinear for c in parts])
        )
        return JointEquations(linear, bilinear, parts[0].offset)
