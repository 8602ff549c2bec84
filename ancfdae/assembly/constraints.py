"""Constraints of all joints at once, from the coefficients that the joints state.

With the point vectors U = L q of all joints they are polynomials in U, or formulas that became
lists of operations (`assembly/joint_formulas.py`); kernels evaluate both.
docs/theory/03-joints-and-loads.md lists the quantities that follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.joint_factors import JointFactors, JointPartials
from ancfdae.assembly.joint_structure import JointStructure
from ancfdae.errors.kinds import InconsistentStartError
from ancfdae.kernels import (
    ConstraintPlan,
    Constraints,
    constraint_curvature,
    constraint_gradient,
    constraint_totals,
    constraints,
)
from ancfdae.numerics.arrays import STEP, Array, only
from ancfdae.numerics.patterns import SparsityPattern


@final
@dataclass(frozen=True, eq=False)
class JointConstraints:
    """Phi and all that follows from it.

    Arrays of states have instants as leading axis, (k, n_q); methods that take one instant say so.
    """

    structure: JointStructure
    # of int: places of the structure's couplings among values of the system's pattern.
    curved: Array
    n_curved: int  # number of these values
    n_b: int

    @staticmethod
    def on(pattern: SparsityPattern, structure: JointStructure, n_b: int) -> JointConstraints:
        """Return constraints whose curvature is placed on a pattern that holds the couplings."""
        curved = pattern.index(*structure.couplings)
        return JointConstraints(structure, curved, pattern.size, n_b)

    # -- structure -----------------------------------------------------------------------------

    @cached_property
    def plan(self) -> ConstraintPlan:
        """The constraints as arrays for the compiled kernels."""
        return self.structure.plan(self.curved, self.n_curved)

    @cached_property
    def factors(self) -> JointFactors:
        """Factors of time of the driven joints."""
        return JointFactors(self.structure.slots)

    @cached_property
    def _partials(self) -> JointPartials:
        return JointPartials(self.structure, self.factors, self.n_b)

    @property
    def linear(self) -> bool:
        """Whether no equation has a product or a formula."""
        return len(self.structure.couplings[0]) == 0

    @cached_property
    def _tangent(self) -> Array | None:
        """Values of Phi_q where they are the same at all states and times."""
        if self.factors.driven or not self.linear:
            return None
        none = np.zeros(self.structure.vectors.n_q)
        return constraints(self.plan, Constraints.VALUES, self.factors.at(0.0), None, none)

    @property
    def active(self) -> list[int]:
        """Design variables that constraints depend on with q held."""
        return self._partials.active

    @property
    def constant(self) -> bool:
        """Whether the constraints are linear and the same at all times and designs."""
        return self._tangent is not None and not self.active

    @property
    def is_complex(self) -> bool:
        """Whether coefficients carry a complex perturbation."""
        return any(np.iscomplexobj(c) for c in self.structure.parts)

    def moved(self, i: int) -> JointConstraints:
        """Return the constraints moved in design variable i by an imaginary step."""
        return replace(self, structure=self.structure.moved(i)) if i in self.active else self

    def refuse_opposite(self, q: Array, t: float) -> None:
        """Refuse a start at which a drive is half a turn off, where its equation holds as well."""
        name = self.opposite(q, t)
        if name is not None:
            raise InconsistentStartError(
                f"joint {name!r}",
                "the section must start at the angle of the law",
                "one that points the other way",
                "Add pi to the offset of the law, or declare the body turned to that angle.",
            )

    def opposite(self, q: Array, t: float) -> str | None:
        """Return the name of a drive that is half a turn off, None without one."""
        U = only(self.structure.vectors.of(q[None])).real
        for slot in self.structure.slots:
            item = slot.item
            p, reference = item.p.real, item.reference.real
            if not item.joint.faces(p, reference, U[slot.vectors], t):
                return item.joint.name
        return None

    @property
    def turns(self) -> bool:
        """Whether a joint prescribes an angle."""
        return self.factors.turns

    def by_turn(self, q: Array, t: Array) -> Array:
        """Return the derivatives of Phi in prescribed angles at many instants, (k, n_lam)."""
        factors = np.concatenate([self.factors.over(t), self.factors.by_turn(t)])
        return constraints(self.plan, Constraints.RATE, factors, None, q, np.zeros_like(q))

    # -- values, one instant -------------------------------------------------------------------

    def constraint(self, t: float, *motion: Array) -> Array:
        """Phi or its time derivative, of the order of the number of rates."""
        factors = self.factors.at(t, len(motion))
        return constraints(self.plan, Constraints.RATE, factors, None, *motion)

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Values of Phi_q or its time derivative."""
        if self._tangent is not None and len(motion) == 1:
            return self._tangent
        factors = self.factors.at(t, len(motion))
        return constraints(self.plan, Constraints.VALUES, factors, None, *motion)

    def reaction(self, t: float, q: Array, lam: Array) -> Array:
        """Return Phi_q^T lam, the forces of the joints times -1, shape (n_q,)."""
        return constraints(self.plan, Constraints.FORCE, self.factors.at(t), lam, q)

    def force_q_along(self, t: float, states: tuple[Array, Array, Array], share: float) -> Array:
        """Values of the derivative of (Phi_q^T lam)_q along (share, dq); states are q, dq, lam."""
        (q, dq, lam), factors = states, self.factors.at(t, 2)
        total = constraint_curvature(self.plan, factors, lam, q, dq)
        if share == 1 or not self.factors.driven:
            return total
        return total - (1 - share) * constraint_curvature(self.plan, factors, lam, q, 0 * dq)

    # -- values, many instants -----------------------------------------------------------------

    def constraint_force_q(self, q: Array, lam: Array, t: Array) -> Array:
        """Values of (Phi_q^T lam)_q for rows of q and lam, shape (k, nnz)."""
        return constraint_curvature(self.plan, self.factors.over(t), lam, q)

    def constraints_q(self, t: Array, *motion: Array) -> Array:
        """Values of Phi_q or its time derivative, shape (k, nnz)."""
        if self._tangent is not None and len(motion) == 1:
            return np.repeat(self._tangent[None], len(t), axis=0)
        factors = self.factors.over(t, len(motion))
        return constraints(self.plan, Constraints.VALUES, factors, None, *motion)

    def pull_back(self, q: Array, lam: Array, t: Array, mu: Array, zeta: Array) -> Array:
        """Sum over instants of (Phi_q^T lam)_b^T mu + Phi_b^T zeta, shape (n_b,)."""
        if not self.active:
            return np.zeros(self.n_b)
        # Design partials of the derivative of lam . Phi along mu, and of zeta . Phi.
        return self._pulled(t, (q + 1j * STEP * mu,), lam + 1j * STEP * zeta)

    # -- what drives do, many instants ---------------------------------------------------------

    def works(self, q: Array, lam: Array, t: Array) -> Array:
        """Power of the driven joints, lam . Phi_t, shape (k,); W."""
        return np.asarray(np.sum(lam * self._by_time(q, t), axis=1))

    def works_partials(self, q: Array, lam: Array, t: Array) -> tuple[Array, Array, Array]:
        """Return partials of `works` in q, lam and b; shape (k, n) each."""
        factors, at_rest = self.factors.over(t, 2), (q, np.zeros_like(q))
        on_q = constraints(self.plan, Constraints.FORCE, factors, lam, *at_rest)
        factors_b = self.factors.partials(t, 2, self.n_b)
        rows = constraint_totals(
            self.plan, self._partials.arrays, factors, factors_b, None, None, at_rest, None
        )
        return on_q, self._by_time(q, t), np.einsum("kbn,kn->kb", rows, lam)

    def _by_time(self, q: Array, t: Array) -> Array:
        """Return Phi_t, (k, n_lam): the rate of Phi at rest."""
        factors = self.factors.over(t, 2)
        return constraints(self.plan, Constraints.RATE, factors, None, q, np.zeros_like(q))

    # -- rates and their total derivatives, one instant ------------------------------------------

    def force_along_total(
        self,
        t: float,
        states: tuple[Array, Array, Array],
        states_b: tuple[Array, Array, Array],
        share: float,
    ) -> Array:
        """Total design derivative of the derivative of Phi_q^T lam along (share, dq).

        States are q, dq and lam. What the rate is at rest belongs to time.
        """
        (q, dq, lam), (q_b, dq_b, lam_b) = states, states_b
        total = self.total(t, (q, dq), (q_b, dq_b), (lam, lam_b))
        if share == 1 or not self.factors.driven:
            return total
        return total - (1 - share) * self.total(t, (q, 0 * dq), (q_b, 0 * dq_b), (lam, lam_b))

    def force_along_pull_back(
        self, t: float, states: tuple[Array, Array, Array], share: float, mu: Array
    ) -> Array:
        """Design partial of mu . the derivative of Phi_q^T lam along (share, dq), shape (n_b,)."""
        q, dq, lam = (x[None] for x in states)
        time, moved = np.array([t]), q + 1j * STEP * mu
        total = self._pulled(time, (moved, dq), lam)
        if share == 1 or not self.factors.driven:
            return total
        return total - (1 - share) * self._pulled(time, (moved, 0 * dq), lam)

    def _pulled(self, t: Array, motion: tuple[Array, ...], weights: Array) -> Array:
        """Design partial of the imaginary part of weights . Phi, or its rate, of all instants."""
        if not self.active:
            return np.zeros(self.n_b)
        factors = self.factors.over(t, len(motion))
        on_l, on_c = constraint_gradient(self.plan, factors, weights, *motion)
        return self._partials.contract(on_l.imag / STEP, on_c.imag / STEP, t)

    def total(
        self,
        t: float,
        motion: Sequence[Array],
        motion_b: Sequence[Array] | None,
        multipliers: tuple[Array, Array] | None = None,
    ) -> Array:
        """Total design derivative of Phi, or of Phi_q^T lam, or of its rate, at one instant.

        Without derivatives of the motion it is partial: the motion is held.
        """
        states = tuple(x[None] for x in motion)
        rows = None if motion_b is None else tuple(x.T[None] for x in motion_b)
        loads = None if multipliers is None else (multipliers[0][None], multipliers[1].T[None])
        return only(self.totals(np.array([t]), states, rows, loads))

    def totals(
        self,
        t: Array,
        motion: tuple[Array, ...],
        motion_b: tuple[Array, ...] | None = None,
        multipliers: tuple[Array, Array | None] | None = None,
    ) -> Array:
        """Return `total` at many instants, (k, n, n_b); derivatives given are rows."""
        orders, (lam, lam_b) = len(motion), multipliers or (None, None)
        if motion_b is None and not self.active:
            n = self.structure.n_lam if lam is None else motion[0].shape[1]
            return np.zeros((len(t), n, self.n_b))
        factors = self.factors.spread(t, orders)
        factors_b = self.factors.partials(t, orders, self.n_b)
        total = constraint_totals(
            self.plan, self._partials.arrays, factors, factors_b, lam, lam_b, motion, motion_b
        )
        return np.swapaxes(total, 1, 2)
