"""Work of a driven joint: its power, and the torque or force that is conjugate to its motion.

A joint exerts -Phi_q^T lam, and Phi_q v = -Phi_t: its power is lam . Phi_t. A law x(t) enters it by
its rate, Phi_t = Phi_x x', so that lam . Phi_x, the power at x' = 1, is what does work on x.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import final

import numpy as np

from ancfdae.ancf.constraints import JointConstraints
from ancfdae.joints import Joint, Law
from ancfdae.joints.laws import require_law
from ancfdae.naming import JointLayout
from ancfdae.numerics.arrays import Array


@final
class DrivenJoint:
    """Power of one joint, at the rate of its law or at a rate of one.

    Parameters
    ----------
    constraints : JointConstraints
        Of this joint alone.
    place : JointLayout
        Of its multipliers among all.
    """

    def __init__(self, constraints: JointConstraints, place: JointLayout) -> None:
        self._constraints = constraints
        self.rows = slice(place.first_row, place.first_row + place.rows)

    def value(self, t: Array, q: Array, lam: Array) -> Array:
        """Return lam . Phi_t or lam . Phi_x, shape (k,); lam has those of all joints."""
        return self._constraints.works(q, lam[:, self.rows], t)

    def partials(self, t: Array, q: Array, lam: Array) -> tuple[Array, Array, Array]:
        """Return partials in q, the multipliers of the joint and b; shape (k, n) each."""
        return self._constraints.works_partials(q, lam[:, self.rows], t)


@final
@dataclass(frozen=True)
class _UnitRate(Law):
    """A law with its own values and a rate of one, at every instant."""

    law: Law

    design_fields = (("law", require_law),)

    def derivatives(self, p: Array, t: float) -> tuple[Array, Array, Array, Array]:
        """x, 1, 0, 0."""
        x = self.law.derivatives(p, t)[0]
        zero = np.zeros_like(x)
        return x, zero + 1, zero, zero


def at_unit_rate(joint: Joint) -> Joint:
    """Return the joint with all its laws at a rate of one."""
    found = {each.name: getattr(joint, each.name) for each in fields(joint)}  # type: ignore[arg-type]
    laws = {name: _UnitRate(law) for name, law in found.items() if isinstance(law, Law)}
    return replace(joint, **laws)  # type: ignore[type-var]
