"""Constraints of all joints at once, from the coefficients that the joints state.

With the point vectors U = L q of all joints they are polynomials in U. Constant maps turn the raw
entries of Phi_U into Phi_q on its pattern and into Phi_q^T lam.
docs/theory/03-joints-and-loads.md lists every other quantity.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import final

import numpy as np
import scipy

from ancfdae.assembly.joint_coefficients import Coefficients, Slot, Values, structure
from ancfdae.assembly.joint_input import JointInput
from ancfdae.assembly.joint_polynomials import JointPolynomials
from ancfdae.assembly.vectors import Vectors
from ancfdae.errors import InconsistentStart
from ancfdae.kernels import Joints
from ancfdae.model.joints import DrivenJoint
from ancfdae.numerics.arrays import STEP, Array, only
from ancfdae.numerics.linear_map import LinearMap
from ancfdae.numerics.patterns import Pattern


@final
class JointConstraints:
    """Phi and all that follows from it, from joints and their vectors in the same order.

    Arrays of states have instants as leading axis, (k, n_q); methods that take one instant say
    so.
    """

    def __init__(self, inputs: Sequence[JointInput], vectors: Vectors, n_b: int, d: int) -> None:
        self._vectors, self._n_b, self._d = vectors, n_b, d
        self._slots, entries, self.joints = structure(inputs, d)
        self.n_lam = sum(joint.rows for joint in self.joints)
        self._rows = np.ones(self.n_lam, dtype=bool)
        self._coefficients = Coefficients(self._slots, self.n_lam)
        self.driven, self.linear = self._coefficients.driven, len(entries.s_row) == 0
        self._poly = JointPolynomials(entries, self.n_lam, d, self._coefficients.turning)
        self._moved, self._parts_moved = (
            dict[int, JointConstraints](),
            dict[int, JointConstraints](),
        )
        self._place()
        self.active = self._find_active()
        self.constant = self._simple and not self.active

    # -- structure -----------------------------------------------------------------------------

    def _place(self) -> None:
        """Constant maps from raw entries to Phi_q on its pattern, and to Phi_q^T lam."""
        spread = self._place_forces()
        rows = self._poly.raw_row[spread.row]
        self.pattern = Pattern((self.n_lam, self._vectors.matrix.shape[1]), rows, spread.col)
        index = self.pattern.index(rows, spread.col)
        shape = (self.pattern.size, len(self._poly.raw_row))
        self._to_values = LinearMap.of(index, spread.row, spread.data, shape)
        self._simple = self.linear and not self.driven
        if self._simple:
            self._B_values = self._to_values(self._coefficients.at(0.0).a)
            self._B = LinearMap(self.pattern.csr(self._B_values))

    def _place_forces(self) -> scipy.sparse.coo_array:
        """Constant map from raw entries to Phi_q^T lam.

        Returns what raw entries are made of, (n_raw, n_q).
        """
        L, at = self._vectors.matrix, self._poly.raw_at
        n_q, count = L.shape[1], len(at)
        spread = L[at].tocoo() if count else scipy.sparse.coo_array((0, n_q))
        self._to_force = LinearMap.of(spread.col, spread.row, spread.data, (n_q, count))
        return spread

    def plan(self) -> Joints:
        """Return the arrays that a kernel evaluates constraints from."""
        values = np.zeros(self.pattern.size)
        maps = self._to_values.csr, self.pattern.rows_of(values), self._curvature.csr
        c = self._coefficients.parts
        return Joints(self._vectors.csr, *self._poly.entries.arrays, c.a, c.s, c.offset, *maps)

    def factors(self, t: Array, order: int) -> Array:
        """Return what the parts of the coefficients are multiplied with, shape (k, n_parts)."""
        return self._coefficients.factors(t, order)

    def couplings(self) -> tuple[Array, Array, Array, Array]:
        """Rows, columns, weights and bilinear entry of the products L_i^T L_j + L_j^T L_i."""
        d, L, entries = self._d, self._vectors.matrix, self._poly.entries
        entry = np.repeat(np.arange(len(entries.s_row)), d)
        axis = np.tile(np.arange(d), len(entries.s_row))
        left, right = entries.s_i[entry] * d + axis, entries.s_j[entry] * d + axis
        sizes = np.diff(L.indptr)
        # Every entry of one row of L with every entry of the other.
        pairs = sizes[left] * sizes[right]
        of = np.repeat(np.arange(len(entry)), pairs)
        count = np.arange(len(of)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
        i = L.indptr[left][of] + count // sizes[right][of]
        j = L.indptr[right][of] + count % sizes[right][of]
        rows, columns = L.indices[i], L.indices[j]
        weights, numbers = np.tile(L.data[i] * L.data[j], 2), np.tile(entry[of], 2)
        rows, columns = np.concatenate([rows, columns]), np.concatenate([columns, rows])
        return rows, columns, weights, numbers

    def place_curvature(self, pattern: Pattern) -> None:
        """Prepare (Phi_q^T lam)_q on the system's pattern, which must hold the couplings."""
        rows, columns, weights, numbers = self.couplings()
        shape = (pattern.size, len(self._poly.entries.s_row))
        self._curvature = LinearMap.of(pattern.index(rows, columns), numbers, weights, shape)

    def _U(self, x: Array) -> Array:
        """Vectors of one instant."""
        return only(self._vectors.of(x[None]))

    def _states(self, states: Sequence[Array]) -> Array:
        """Vectors of some states, with them as leading axis."""
        return self._vectors.of(np.stack(states))

    def _find_active(self) -> list[int]:
        """Design variables that constraints depend on with q held."""
        moves = {int(i) for i in np.flatnonzero(self._vectors.moves)}
        changes = {i for slot in self._slots for i in slot.item.active if slot.changes(i)}
        return sorted(moves | changes)

    def moved(self, i: int) -> JointConstraints:
        """Return the constraints moved in design variable i by an imaginary step."""
        if i not in self.active:
            return self
        if i not in self._moved:
            slots = [slot.moved(i) for slot in self._slots]
            other = self._with(slots, self._vectors.moved(i), np.ones(self.n_lam, dtype=bool))
            other._place()
            self._moved[i] = other
        return self._moved[i]

    def _reaching(self, i: int) -> JointConstraints:
        """Return the joints that design variable i reaches, moved by an imaginary step.

        Of the others they know the rows only, as zeros.
        """
        if i not in self._parts_moved:
            touched, rows = self._vectors.moved_by(i), np.zeros(self.n_lam, dtype=bool)
            reached = [
                slot.moved(i)
                for slot in self._slots
                if i in slot.item.active or np.any(touched[slot.vectors])
            ]
            for slot in reached:
                rows[slot.rows] = True
            other = self._with(reached, self._vectors.moved(i), rows)
            other._place_forces()
            self._parts_moved[i] = other
        return self._parts_moved[i]

    @property
    def is_complex(self) -> bool:
        """Whether coefficients carry a complex perturbation."""
        return self._coefficients.is_complex

    def _with(self, slots: list[Slot], vectors: Vectors, rows: Array) -> JointConstraints:
        """Return constraints of some of the joints, those of the rows given."""
        other = copy.copy(self)
        other._slots, other._vectors, other._rows = slots, vectors, rows
        other._coefficients, other._poly = Coefficients(slots, self.n_lam), self._poly.only(rows)
        other.driven = other._coefficients.driven
        return other

    def _seen(self, moved: JointConstraints, q: Array, U: Array) -> Array:
        """Return the vectors of moved constraints: those known unless the move is theirs."""
        return U if moved._vectors is self._vectors else moved._vectors.of(q)

    def _partial(self, of: Callable[[JointConstraints], Array], shape: tuple[int, ...]) -> Array:
        """Design partial of something of this shape that the constraints give, (*shape, n_b)."""
        result = np.zeros((*shape, self._n_b))
        for i in self.active:
            result[..., i] = of(self._reaching(i)).imag / STEP
        return result

    def _together(self, t: float, order: int) -> Values:
        """Coefficients moved in every design variable, with a leading axis n_b."""
        c = self._coefficients.at(t, order)
        if not self.active:
            return c
        entries = self._poly.entries
        together = Values(
            *(np.repeat(x[None].astype(complex), self._n_b, 0) for x in (c.a, c.s, c.offset))
        )
        for i in self.active:
            moved = self._reaching(i)
            m = moved._coefficients.at(t, order)
            a, s = (moved._rows[row] for row in (entries.a_row, entries.s_row))
            together.a[i, a], together.s[i, s] = m.a, m.s
            together.offset[i] += 1j * m.offset.imag
        return together

    # -- values, one instant -------------------------------------------------------------------

    def constraint(self, t: float, *motion: Array) -> Array:
        """Phi or its time derivative, of the order of the number of rates."""
        if self._simple:
            value = self._B(motion[-1])
            return value if len(motion) > 1 else value - self._coefficients.at(0.0).offset
        if len(motion) == 1:
            return self._poly.phi(self._coefficients.at(t), self._U(motion[0]))
        return self._rate(t, *motion)

    def _rate(self, t: float, *motion: Array) -> Array:
        """Phi or its time derivative, whether or not constant maps are there."""
        series = self._coefficients.series(t, len(motion))
        return self._poly.rate(series, *self._states(motion))

    def refuse_opposite(self, q: Array, t: float) -> None:
        """Refuse a start at which a drive is half a turn off, where its equation holds as well."""
        name = self.opposite(q, t)
        if name is not None:
            raise InconsistentStart(
                f"joint {name!r}",
                "the section must start at the angle of the law",
                "one that points the other way",
                "Add pi to the offset of the law, or declare the body turned to that angle.",
            )

    def opposite(self, q: Array, t: float) -> str | None:
        """Return the name of a drive that is half a turn off, None without one."""
        U = self._U(q).real if self.driven else np.zeros(0)
        for slot in self._slots:
            item = slot.item
            p, reference = item.p.real, item.reference.real
            if isinstance(item.joint, DrivenJoint) and not item.joint.faces(
                p, reference, U[slot.vectors], t
            ):
                return item.joint.name
        return None

    def constraint_q(self, t: float, *motion: Array) -> Array:
        """Values of Phi_q or its time derivative, one instant."""
        if self._simple:
            return self._B_values if len(motion) == 1 else np.zeros(self.pattern.size)
        if len(motion) == 1:
            return self._to_values(self._poly.raw(self._coefficients.at(t), self._U(motion[0])))
        return self._to_values(self._raw_rate(t, *motion))

    def reaction(self, t: float, q: Array, lam: Array) -> Array:
        """Phi_q^T lam, one instant."""
        return self.pattern.dot_transposed(self.constraint_q(t, q), lam)

    def constraint_force_q(self, lam: Array, t: Array) -> Array:
        """Values of (Phi_q^T lam)_q for rows of lam, shape (k, nnz); independent of q."""
        return self._curvature.rows(lam[:, self._poly.entries.s_row] * self._coefficients.over(t).s)

    def constraint_force_t_q(self, lam: Array, t: float) -> Array:
        """Values of (Phi_qt^T lam)_q, one instant; only driven products depend on time."""
        weights = lam[self._poly.entries.s_row] * self._coefficients.at(t, 1).s
        return only(self._curvature.rows(weights[None]))

    # -- values, many instants -----------------------------------------------------------------

    def constraints_q(self, q: Array, t: Array) -> Array:
        """Values of Phi_q, shape (k, nnz)."""
        if self._simple:
            same = self._B_values[None]
            return same if len(q) == 1 else np.repeat(same, len(q), axis=0)
        return self._to_values.rows(self._poly.raw(self._coefficients.over(t), self._vectors.of(q)))

    def constraints(self, q: Array, t: Array) -> Array:
        """Phi, shape (k, n_lam)."""
        return self._poly.phi(self._coefficients.over(t), self._vectors.of(q))

    def constraints_b(self, q: Array, t: Array) -> Array:
        """Phi_b, shape (k, n_lam, n_b)."""
        if not self.active:
            return np.zeros((len(q), self.n_lam, self._n_b))
        U = self._vectors.of(q)
        return self._partial(
            lambda moved: moved._poly.phi(moved._coefficients.over(t), self._seen(moved, q, U)),
            (len(q), self.n_lam),
        )

    def constraint_forces_b(self, q: Array, lam: Array, t: Array) -> Array:
        """(Phi_q^T lam)_b, shape (k, n_q, n_b)."""
        if not self.active:
            return np.zeros((*q.shape, self._n_b))
        U = self._vectors.of(q)

        def force(moved: JointConstraints) -> Array:
            raw = moved._poly.raw(moved._coefficients.over(t), self._seen(moved, q, U))
            return moved._to_force.rows(raw * lam[:, moved._poly.raw_row])

        return self._partial(force, q.shape)

    def pull_back(self, q: Array, lam: Array, t: Array, mu: Array, zeta: Array) -> Array:
        """Sum over instants of (Phi_q^T lam)_b^T mu + Phi_b^T zeta, shape (n_b,)."""
        U_o, X_o = self._vectors.of(q), self._vectors.of(mu)

        def work(moved: JointConstraints) -> Array:
            U, X = self._seen(moved, q, U_o), self._seen(moved, mu, X_o)
            c = moved._coefficients.over(t)
            terms = lam * moved._poly.jacobian_times([c], U, X) + zeta * moved._poly.phi(c, U)
            return np.asarray(np.sum(terms))

        return self._partial(work, ())

    # -- what drives do, many instants ---------------------------------------------------------

    def works(self, q: Array, lam: Array, t: Array) -> Array:
        """Lam . Phi_t, shape (k,)."""
        rates: Array = self._poly.phi(self._coefficients.over(t, 1), self._vectors.of(q))
        return np.asarray(np.sum(lam * rates, axis=1))

    def works_partials(self, q: Array, lam: Array, t: Array) -> tuple[Array, Array, Array]:
        """Return partials of `works` in q, lam and b; shape (k, n) each."""
        c, U = self._coefficients.over(t, 1), self._vectors.of(q)
        on_q = self._to_force.rows(self._poly.raw(c, U) * lam[:, self._poly.raw_row])
        return on_q, self._poly.phi(c, U), self._partial(lambda x: x.works(q, lam, t), (len(q),))

    # -- rates and their total derivatives, one instant ------------------------------------------

    def _raw_rate(self, t: float, *motion: Array) -> Array:
        """Time derivative of the raw entries of Phi_U, of the order of the number of rates."""
        series = self._coefficients.series(t, len(motion))
        return self._poly.raw_rate(series, *self._states(motion))

    def constraint_total(
        self, t: float, motion: tuple[Array, ...], motion_b: tuple[Array, ...] | None
    ) -> Array:
        """Total design derivative of `constraint`; partial, with the motion held, without b."""
        if self._simple and not self.active:
            if motion_b is None:
                return np.zeros((self.n_lam, self._n_b))
            return np.asarray(self._B.columns(motion_b[-1]))
        if motion_b is None:
            return self._partial(lambda moved: moved._rate(t, *motion), (self.n_lam,))
        return self._total(self._poly.rate, t, len(motion), motion, motion_b)

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
        total = self._force_rate_total(t, states, states_b)
        if share == 1 or not self.driven:
            return total
        (q, dq, lam), (q_b, dq_b, lam_b) = states, states_b
        rest = (q, 0 * dq, lam), (q_b, 0 * dq_b, lam_b)
        return total - (1 - share) * self._force_rate_total(t, *rest)

    def _force_rate_total(
        self, t: float, states: tuple[Array, ...], states_b: tuple[Array, ...]
    ) -> Array:
        """Total design derivative of (dPhi_q^T/dt) lam; states are q, its rate and lam."""
        (q, v, lam), (q_b, v_b, lam_b) = states, states_b
        loads = (lam + 1j * STEP * lam_b.T)[:, self._poly.raw_row]

        def entries(series: Sequence[Values], U: Array, V: Array) -> Array:
            return self._poly.raw_rate(series, U, V) * loads

        total = self._to_force.columns(self._total(entries, t, 2, (q, v), (q_b, v_b)))
        still = self._raw_rate(t, q, v) * lam[self._poly.raw_row]
        for i in np.flatnonzero(self._vectors.moves):
            moved = self._reaching(int(i))
            total[:, i] += moved._to_force(still[moved._rows[self._poly.raw_row]]).imag / STEP
        return total

    def force_along_pull_back(
        self, t: float, states: tuple[Array, Array, Array], share: float, mu: Array
    ) -> Array:
        """Design partial of mu . the derivative of Phi_q^T lam along (share, dq), shape (n_b,)."""
        q, dq, lam = states

        def work(moved: JointConstraints) -> Array:
            raw = moved._raw_rate(t, q, dq)
            if share != 1 and moved.driven:
                raw = raw - (1 - share) * moved._raw_rate(t, q, 0 * dq)
            return mu @ moved._to_force(raw * lam[moved._poly.raw_row])

        return self._partial(work, ())

    def _total(
        self,
        function: Callable[..., Array],
        t: float,
        orders: int,
        states: tuple[Array, ...],
        states_b: tuple[Array, ...],
    ) -> Array:
        """Differentiate a polynomial of coefficients and vectors along the design."""
        U, U_b = self._vectors.of(np.stack(states)), self._vectors.of_b(np.stack(states))
        moved = [self._together(t, n) for n in range(orders)]
        arguments = []
        for k, x_b in enumerate(states_b):
            along = self._vectors.of(x_b.T) + np.moveaxis(U_b[k], -1, 0)
            arguments.append(U[k] + 1j * STEP * along)
        columns: Array = function(moved, *arguments).imag / STEP
        return columns.T
