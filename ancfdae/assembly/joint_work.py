"""Work of a driven joint: its power, and the torque or force that is conjugate to its motion.

A joint exerts -Phi_q^T lam, and Phi_q v = -Phi_t: its power is lam . Phi_t. A law x(t) enters it by
its rate, Phi_t = Phi_x x', so that lam . Phi_x, the power at x' = 1, is what does work on x.
"""

from dataclasses import dataclass, fields, replace
from typing import Any, final

import numpy as np

from ancfdae.assembly.constraints import JointConstraints
from ancfdae.assembly.joint_input import JointInput
from ancfdae.assembly.joint_structure import JointStructure
from ancfdae.assembly.vectors import Vectors
from ancfdae.model.joints import DrivenJoint
from ancfdae.model.laws import Law
from ancfdae.model.laws.law import require_law
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import Pattern


@final
class JointWork:
    """Power of one driven joint, as it is or `at_unit_rate`, with its multipliers' first row."""

    def __init__(self, item: JointInput, vectors: Vectors, first_row: int) -> None:
        # The last equations hold the shape of sections, whatever the time.
        c = item.joint.coefficients(item.p, item.reference)
        moving = len(c.offset) - len(c.shapes)
        alone = replace(item, dropped=tuple(range(moving, len(c.offset))))
        structure = JointStructure.of([alone], vectors)
        pattern = Pattern((vectors.n_q, vectors.n_q), *structure.couplings)
        self._constraints = JointConstraints.on(pattern, structure, vectors.n_b)
        self.rows = slice(first_row, first_row + moving)

    def value(self, t: Array, q: Array, lam: Array) -> Array:
        """Return lam . Phi_t or lam . Phi_x, shape (k,); lam has those of all joints."""
        return self._constraints.works(q, lam[:, self.rows], t)

    def partials(self, t: Array, q: Array, lam: Array) -> tuple[Array, Array, Array]:
        """Return partial derivatives by q, the multipliers of `rows` and b; shape (k, n) each."""
        return self._constraints.works_partials(q, lam[:, self.rows], t)


@final
@dataclass(frozen=True)
class _UnitRate(Law):
    """A law with its own values and a rate of one, at every instant."""

    law: Law

    design_fields = (("law", require_law),)

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Return x, 1, 0, 0."""
        x = self.law.derivative(p, t, 0)
        return x if order == 0 else np.full_like(x, float(order == 1))


def at_unit_rate(joint: DrivenJoint) -> DrivenJoint:
    """Return the joint with its law at a rate of one."""
    values = {each.name: getattr(joint, each.name) for each in fields(joint)}
    laws = {name: _UnitRate(law) for name, law in values.items() if isinstance(law, Law)}
    return replace(joint, **laws)  # type: ignore[arg-type]
