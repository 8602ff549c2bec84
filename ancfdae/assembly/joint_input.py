"""One joint as numbers: values and partials of its parameters and reference vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.assembly.held_angles import HeldAngles
from ancfdae.model.joints import Equations, Joint
from ancfdae.numerics.arrays import STEP, Array


@final
@dataclass(frozen=True)
class JointInput:
    """One joint with its parameters, (n_p,), reference vectors, (n_vectors, d), and partials.

    `reference_b` has those of the design variables that move the reference. Equations `dropped`
    say nothing here.
    """

    joint: Joint
    p: Array
    p_b: Array
    reference: Array
    reference_b: dict[int, Array]
    dropped: tuple[int, ...] = ()

    def parts(self) -> list[Equations]:
        """Return the constant coefficients, and what goes with each factor."""
        joint = self.joint
        parts = [joint.coefficients(self.p, self.reference), *joint.moving(self.p, self.reference)]
        return [c.without(self.dropped) for c in parts]

    def factors(self, t: Array, order: int) -> Array:
        """Return the time derivative of the factors, shape (n_factors, k)."""
        return self.joint.factors(self.p, t, order)

    def shaped(self, held: HeldAngles) -> JointInput:
        """Leave out right angles that are held without this joint."""
        c = self.joint.checked_coefficients(self.p, self.reference)
        shapes = enumerate(c.shapes, len(c.offset) - len(c.shapes))
        return replace(self, dropped=tuple(row for row, angle in shapes if not held.add(angle)))

    @property
    def active(self) -> set[int]:
        """Design variables that the coefficients may depend on."""
        return {*np.flatnonzero(np.any(self.p_b, axis=0)).tolist(), *self.reference_b}

    def moved(self, i: int) -> JointInput:
        """Return the joint moved in design variable i by an imaginary step."""
        p, reference = self.p + 1j * STEP * self.p_b[:, i], self.reference
        if i in self.reference_b:
            reference = reference + 1j * STEP * self.reference_b[i]
        return replace(self, p=p, reference=reference)

    def structure(self) -> Equations:
        """Return coefficients that vanish only where they do at all times and parameters."""
        # Generic parameters: a coefficient that is not zero by structure shows.
        p = self.p * (1 + 1j * STEP) + 1j * STEP * np.sqrt(1.0 + np.arange(len(self.p)))
        reference = self.reference + 1j * STEP * sum(self.reference_b.values())
        parts = [*self.parts(), *replace(self, p=p, reference=reference).parts()]

        def size(x: Sequence[Array]) -> Array:
            return np.asarray(sum(np.abs(part.real) + np.abs(part.imag) for part in x))

        linear, bilinear = size([c.linear for c in parts]), size([c.bilinear for c in parts])
        return Equations(linear, bilinear, parts[0].offset)
