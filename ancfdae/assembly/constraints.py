"""Constraints of all joints at once, with their dependence on time and on the design.

With the point vectors U = L q of all joints they are polynomials in U, or formulas recorded as
lists of operations (`assembly/joint_input.py`); compiled kernels evaluate both.
docs/theory/03-joints-and-loads.md lists the derived quantities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.joint_structure import JointStructure, Slot
from ancfdae.kernels import ConstraintPlan, Constraints
from ancfdae.numerics.arrays import STEP, Array, only

_ORDERS = 4
# Number of times whose factors are cached; the start and the checks of a run use four.
_KEPT = 8
# Largest number of times of a cached table of factors: designs of a sweep often share their steps.
_FEW = 1000


@final
class JointFactors:
    """Time factors of driven joints, (orders, k, n_parts), cached.

    The first part of the coefficients is constant in time: its factor is one, its rates are zero. A
    scene without driven joints has one row for all times. Factors at single times and short tables
    are cached, because iterations and the designs of a sweep use them again.
    """

    def __init__(self, slots: Sequence[Slot]) -> None:
        self._slots = [slot for slot in slots if slot.parts.start < slot.parts.stop]
        self._count = 1 + sum(slot.parts.stop - slot.parts.start for slot in self._slots)
        self.driven = len(self._slots) > 0
        self._still = np.eye(_ORDERS, 1)[:, :, None]
        self._known: dict[float, Array] = {}
        self._tables: dict[tuple[bytes, int], Array] = {}

    @property
    def active(self) -> set[int]:
        """Design variables that change a time factor of a joint."""
        return {int(i) for slot in self._slots for i in np.flatnonzero(np.any(slot.item.p_b, 0))}

    def at(self, t: float, orders: int = 1) -> Array:
        """Return the factors at time t, s, and their time derivatives, shape (k, 1, n_parts).

        The order of derivatives goes from 0 to k - 1 with k >= `orders`.
        """
        if not self.driven:
            return self._still
        factors = self._known.get(t)
        if factors is None or len(factors) < orders:
            # The start of a run needs one order after the other.
            factors = self._over(np.array([t]), orders if factors is None else _ORDERS)
            if len(self._known) >= _KEPT:
                self._known = {}
            self._known[t] = factors
        return factors

    def over(self, t: Array, orders: int = 1) -> Array:
        """Return time factors and rates at times t, s, (orders, k, n_parts); k = 1 if undriven."""
        if not self.driven:
            return self._still[:orders]
        return self._table(t, orders)

    def _table(self, t: Array, orders: int) -> Array:
        """Return the cached table of `over`, or of `by_turn` if `orders` is 0; (orders, k, n)."""
        key = t.tobytes(), orders
        if key in self._tables:
            return self._tables[key]
        if orders:
            table = self._over(t, orders)
        else:
            each = [slot.item.joint.by_turn(slot.item.p, t).T for slot in self._slots]
            table = np.concatenate([np.zeros((len(t), 1)), *each], axis=1)[None]
        if len(self._tables) >= _KEPT:
            self._tables = {}
        if len(t) <= _FEW:
            self._tables[key] = table
        return table

    def _over(self, t: Array, orders: int) -> Array:
        each = [
            [slot.item.joint.factors(slot.item.p, t, order).T for order in range(orders)]
            for slot in self._slots
        ]
        still = np.zeros((orders, len(t), 1))
        still[0] = 1.0
        return np.concatenate([still, *(np.array(x) for x in each)], axis=2)

    def spread(self, t: Array, orders: int = 1) -> Array:
        """Return time factors and rates at times t, one row per time, (orders, k, n_parts)."""
        factors = self.over(t, orders)
        return factors if self.driven else np.repeat(factors, len(t), axis=1)

    @cached_property
    def turns(self) -> bool:
        """Whether one of the joints prescribes an angle."""
        return self.driven and bool(np.any(self.by_turn(np.zeros(1))))

    def by_turn(self, t: Array) -> Array:
        """Return derivatives of the time factors in prescribed angles at t, (1, k, n_parts)."""
        return self._table(t, 0)

    def turn_rate(self, t: Array) -> Array:
        """Return the largest rate of a prescribed angle at times t, shape (k,); rad/s."""
        items = [slot.item for slot in self._slots]
        rates = [np.abs(item.joint.turn_rate(item.p, t)) for item in items]
        return np.max([np.zeros(len(t)), *rates], axis=0)

    def partials(self, t: Array, orders: int, n_b: int) -> Array | None:
        """Return the design partials of `spread`, (n_b, orders, k, n_parts); None without any."""
        if not (self.driven and self.active):
            return None
        result = np.zeros((n_b, orders, len(t), self._count))
        for slot in self._slots:
            for i in np.flatnonzero(np.any(slot.item.p_b, axis=0)).tolist():
                moved = slot.item.moved(i)
                for order in range(orders):
                    slopes = moved.joint.factors(moved.p, t, order).imag.T / STEP
                    result[i, order, :, slot.parts] = slopes
        return result


@final
@dataclass(frozen=True, eq=False)
class JointConstraints:
    """Constraints Phi(q, t) = 0 of all joints, with their time and design derivatives.

    Arrays of states have time as leading axis, (k, n_q); methods for a single time say so.
    """

    structure: JointStructure
    # of int: indices of the structure's couplings among the values of the system's pattern.
    curved: Array
    n_curved: int  # number of these values
    n_b: int

    # -- structure -----------------------------------------------------------------------------

    @cached_property
    def plan(self) -> ConstraintPlan:
        """Data of the constraints as arrays for the compiled kernels."""
        return self.structure.plan(self.curved, self.n_curved)

    @cached_property
    def factors(self) -> JointFactors:
        """Factors of time of the driven joints."""
        return JointFactors(self.structure.slots)

    @cached_property
    def partials(self) -> tuple[Array, ...]:
        """Design partials of the coefficients and of L, as the kernel takes them.

        The arrays are variable, number of the joint, first, part, entry and value.
        """
        numbers, variable, first, changes = [], [0], [0], [(np.zeros(0, dtype=np.int64),) * 3]
        for i in range(self.n_b):
            for number, change in self._reached(i):
                numbers.append(number)
                changes.append(change)
                first.append(first[-1] + len(change[0]))
            variable.append(len(numbers))
        part, entry, value = (np.concatenate(x) for x in zip(*changes, strict=True))
        indices = (np.asarray(x, np.int32) for x in (variable, numbers, first, part, entry))
        return *indices, value.real.astype(float)

    def _reached(self, i: int) -> list[tuple[int, tuple[Array, Array, Array]]]:
        """Return the joints that design variable i changes: index, parts, entries and values."""
        structure, reached = self.structure, []
        vectors = structure.vectors
        chosen = vectors.variable == i
        changed, change = vectors.changed[chosen], vectors.change[chosen]
        entries = len(vectors.value)
        for number, slot in enumerate(structure.slots):
            ends = vectors.first[[slot.vectors.start * vectors.d, slot.vectors.stop * vectors.d]]
            within = slice(*np.searchsorted(changed, ends).tolist())
            changes = [(np.zeros_like(changed[within]), changed[within], change[within])]
            driven = False
            if i in slot.item.active:
                part, at, value = slot.partials(i)
                changes.append((part, entries + at, value))
                driven = slot.parts.start < slot.parts.stop and bool(np.any(slot.item.p_b[:, i]))
            part, at, value = (np.concatenate(x) for x in zip(*changes, strict=True))
            if driven or len(at):
                reached.append((number, (part, at, value)))
        return reached

    @property
    def linear(self) -> bool:
        """Whether all equations are linear in the coordinates."""
        return len(self.structure.couplings[0]) == 0

    @cached_property
    def tangent(self) -> Array | None:
        """Values of Phi_q if they are the same at all states and times; otherwise None."""
        if self.factors.driven or not self.linear:
            return None
        none = np.zeros(self.structure.vectors.n_q)
        return self.plan.evaluate(Constraints.VALUES, self.factors.at(0.0), None, none)

    @cached_property
    def active(self) -> list[int]:
        """Design variables that constraints depend on at fixed q."""
        return np.flatnonzero(np.diff(self.partials[0])).tolist()

    @property
    def is_complex(self) -> bool:
        """Whether the joint coefficients carry an imaginary perturbation."""
        return any(np.iscomplexobj(c) for c in self.structure.parts)

    def moved(self, i: int) -> JointConstraints:
        """Return the constraints with design variable i perturbed by an imaginary step."""
        return replace(self, structure=self.structure.moved(i)) if i in self.active else self

    def opposite(self, q: Array, t: float) -> str | None:
        """Return the name of a driven joint that is half a turn off its angle; None without one."""
        U = only(self.structure.vectors.of(q[None])).real
        for slot in self.structure.slots:
            item = slot.item
            p, reference = item.p.real, item.reference.real
            if not item.joint.faces(p, reference, U[slot.vectors], t):
                return item.joint.name
        return None

    def by_turn(self, q: Array, t: Array) -> Array:
        """Return the derivatives of Phi in prescribed angles at times t, shape (k, n_lam)."""
        factors = np.concatenate([self.factors.over(t), self.factors.by_turn(t)])
        return self.plan.evaluate(Constraints.RATE, factors, None, q, np.zeros_like(q))

    # -- values, one time ----------------------------------------------------------------------

    def constraint(self, t: float, *motion: Array) -> Array:
        """Return Phi, or its time derivative of the order of the rates in `motion`, (n_lam,)."""
        factors = self.factors.at(t, len(motion))
        return self.plan.evaluate(Constraints.RATE, factors, None, *motion)

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Return the values of Phi_q, or of its time derivative, on its sparsity pattern."""
        if self.tangent is not None and len(motion) == 1:
            return self.tangent
        factors = self.factors.at(t, len(motion))
        return self.plan.evaluate(Constraints.VALUES, factors, None, *motion)

    def reaction(self, t: float, q: Array, lam: Array) -> Array:
        """Return Phi_q^T lam, minus the generalised forces of the joints, shape (n_q,)."""
        return self.plan.evaluate(Constraints.FORCE, self.factors.at(t), lam, q)

    def force_q_along(self, t: float, states: tuple[Array, Array, Array], share: float) -> Array:
        """Return the values of the derivative of (Phi_q^T lam)_q along (share, dq).

        `states` are q, dq, lam at one time; `share` is the change of time.
        """
        (q, dq, lam), factors = states, self.factors.at(t, 2)
        total = self.plan.curvature(factors, lam, q, dq)
        if share == 1 or not self.factors.driven:
            return total
        return total - (1 - share) * self.plan.curvature(factors, lam, q, 0 * dq)

    # -- values, many times --------------------------------------------------------------------

    def constraint_force_q(self, q: Array, lam: Array, t: Array) -> Array:
        """Return the values of (Phi_q^T lam)_q at times t for rows of q and lam, shape (k, nnz)."""
        return self.plan.curvature(self.factors.over(t), lam, q)

    def constraints_q(self, t: Array, *motion: Array) -> Array:
        """Return the values of Phi_q, or of its time derivative, at times t, shape (k, nnz)."""
        if self.tangent is not None and len(motion) == 1:
            return np.repeat(self.tangent[None], len(t), axis=0)
        factors = self.factors.over(t, len(motion))
        return self.plan.evaluate(Constraints.VALUES, factors, None, *motion)

    def pull_back(self, q: Array, lam: Array, t: Array, mu: Array, zeta: Array) -> Array:
        """Return the sum over times of (Phi_q^T lam)_b^T mu + Phi_b^T zeta, shape (n_b,)."""
        if not self.active:
            return np.zeros(self.n_b)
        # Design partials of the derivative of lam . Phi along mu, and of zeta . Phi.
        return self._pulled(t, (q + 1j * STEP * mu,), lam + 1j * STEP * zeta)

    # -- power of driven joints, many times ----------------------------------------------------

    def works(self, q: Array, lam: Array, t: Array) -> Array:
        """Return the power of the driven joints, lam . Phi_t, shape (k,); W."""
        return np.asarray(np.sum(lam * self._by_time(q, t), axis=1))

    def works_partials(self, q: Array, lam: Array, t: Array) -> tuple[Array, Array, Array]:
        """Return the partials of `works` in q, lam and b; shape (k, n) each."""
        factors, at_rest = self.factors.over(t, 2), (q, np.zeros_like(q))
        on_q = self.plan.evaluate(Constraints.FORCE, factors, lam, *at_rest)
        factors_b = self.factors.partials(t, 2, self.n_b)
        rows = self.plan.totals(self.partials, factors, factors_b, None, None, at_rest, None)
        return on_q, self._by_time(q, t), np.einsum("kbn,kn->kb", rows, lam)

    def _by_time(self, q: Array, t: Array) -> Array:
        """Return Phi_t at times t, the rate of Phi at zero velocity, shape (k, n_lam)."""
        factors = self.factors.over(t, 2)
        return self.plan.evaluate(Constraints.RATE, factors, None, q, np.zeros_like(q))

    # -- rates and their total derivatives, one time ---------------------------------------------

    def force_along_total(
        self,
        t: float,
        states: tuple[Array, Array, Array],
        states_b: tuple[Array, Array, Array],
        share: float,
    ) -> Array:
        """Return the total design derivative of the derivative of Phi_q^T lam along (share, dq).

        States are q, dq and lam at one time, `states_b` their design derivatives. The rate at dq =
        0 is the part due to time and is multiplied by `share`.
        """
        (q, dq, lam), (q_b, dq_b, lam_b) = states, states_b
        total = self.total(t, (q, dq), (q_b, dq_b), (lam, lam_b))
        if share == 1 or not self.factors.driven:
            return total
        return total - (1 - share) * self.total(t, (q, 0 * dq), (q_b, 0 * dq_b), (lam, lam_b))

    def force_along_pull_back(
        self, t: float, states: tuple[Array, Array, Array], share: float, mu: Array
    ) -> Array:
        """Return mu^T d/db of the derivative of Phi_q^T lam along (share, dq), (n_b,).

        The design partial is at fixed states q, dq and lam, at one time.
        """
        q, dq, lam = (x[None] for x in states)
        time, moved = np.array([t]), q + 1j * STEP * mu
        total = self._pulled(time, (moved, dq), lam)
        if share == 1 or not self.factors.driven:
            return total
        return total - (1 - share) * self._pulled(time, (moved, 0 * dq), lam)

    def _pulled(self, t: Array, motion: tuple[Array, ...], weights: Array) -> Array:
        """Return d/db of weights . Phi, or of its rate, summed over times, by an imaginary step."""
        if not self.active:
            return np.zeros(self.n_b)
        orders, structure = len(motion), self.structure
        # Gradients in entries of L, (k, n_l), and in coefficients for each order, (k, orders, n_c).
        gradients = self.plan.gradient(self.factors.over(t, orders), weights, *motion)
        on_l, on_c = (x.imag / STEP for x in gradients)
        variable, _, first, part, entry, value = self.partials
        on_parts = np.einsum("koc,okp->pc", on_c, self.factors.spread(t, orders))
        of_l = entry < on_l.shape[1]
        on_entries = np.where(
            of_l,
            np.sum(on_l, axis=0)[np.where(of_l, entry, 0)] if on_l.size else 0.0,
            on_parts[part, np.where(of_l, 0, entry - on_l.shape[1])] if on_parts.size else 0.0,
        )
        owner = np.repeat(np.arange(self.n_b), first[variable[1:]] - first[variable[:-1]])
        result = np.bincount(owner, value * on_entries, self.n_b)
        factors_b = self.factors.partials(t, orders, self.n_b)
        if factors_b is None:
            return result
        _, at, parts, moving = structure.moving()
        on_factors = np.zeros((factors_b.shape[-1], len(t), orders))
        np.add.at(on_factors, parts, np.moveaxis(on_c[..., at] * moving, -1, 0))
        return np.asarray(result + np.einsum("bokp,pko->b", factors_b, on_factors))

    def total(
        self,
        t: float,
        motion: Sequence[Array],
        motion_b: Sequence[Array] | None,
        multipliers: tuple[Array, Array] | None = None,
    ) -> Array:
        """Return the total design derivative of Phi, Phi_q^T lam or its rate, at one time.

        If `motion_b` is None it is the partial derivative at fixed motion.
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
        """Return `total` at times t, shape (k, n, n_b).

        The derivatives of the motion and of multipliers are given as rows, (k, n_b, n).
        """
        orders, (lam, lam_b) = len(motion), multipliers or (None, None)
        if motion_b is None and not self.active:
            n = self.structure.n_lam if lam is None else motion[0].shape[1]
            return np.zeros((len(t), n, self.n_b))
        factors = self.factors.spread(t, orders)
        factors_b = self.factors.partials(t, orders, self.n_b)
        total = self.plan.totals(self.partials, factors, factors_b, lam, lam_b, motion, motion_b)
        return np.swapaxes(total, 1, 2)
