"""Inertia forces of a scene in a rotating frame (docs/theory/15-steady-rotation.md).

All coordinates are vectors that rotate with the frame, and the mass matrix m (x) I_d is the same in
it. In the frame the acceleration of a material point has the additional term

    c(q, v) = 2 w J v + w^2 J^2 (q - p),

with the rate w, J x = axis x x and p the position of the axis (zero for slopes): the residual M a +
Phi_q^T lam - Q has the additional term M c, which is linear in v and affine in q.
"""

from collections.abc import Callable
from functools import cached_property
from typing import final

import numpy as np

from ancfdae.assembly.inertia import Inertia
from ancfdae.model.turning_frame import RotatingFrame
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.patterns import SparsityPattern


@final
class TurningForces:
    """Inertia force M c of a rotating frame, and its derivatives.

    The `numbers` are the parameters p of the frame with their design derivatives.
    """

    def __init__(
        self,
        frame: RotatingFrame,
        numbers: tuple[Array, Array],
        inertia: Inertia,
        pattern: SparsityPattern,
    ) -> None:
        self._frame, self._inertia, self._pattern = frame, inertia, pattern
        (self._p, self._p_b), self._d = numbers, pattern.shape[0] // len(inertia.positions)
        self._active = np.flatnonzero(np.any(self._p_b != 0, axis=0))

    # -- the force and its tangents ----------------------------------------------------------------

    def force(self, q: Array, v: Array) -> Array:
        """Return the inertia force M c of the rotating frame, shape (n_q,)."""
        return self._inertia.times(self._c(q, v))

    def force_along(self, dq: Array, dv: Array) -> Array:
        """Return the derivative M (c_q dq + c_v dv) of the frame's inertia force, shape (n_q,)."""
        return self._inertia.times(self._c_along(dq, dv))

    @cached_property
    def tangents(self) -> tuple[Array, Array]:
        """Values of the frame's tangents M c_q and M c_v on the pattern of the system."""
        rate, J, _ = self._frame.turn(self._p, self._d)
        return self._product(rate**2 * J @ J), self._product(2 * rate * J)

    def potential(self, q: Array) -> Array:
        """Return the potential of the centrifugal force for rows of q, shape (k,); J."""
        rate, J, through = self._frame.turn(self._p, self._d)
        v = (rate * self._arms(q, through) @ J.T).reshape(q.shape)
        return np.asarray(-0.5 * np.sum(v * self._inertia.times(v.T).T, axis=1))

    # -- design derivatives ------------------------------------------------------------------------

    def rows(self, q_rows: Array, v_rows: Array) -> Array:
        """Return the frame's inertia force M c and its total design derivatives, (1 + n_b, n_q)."""
        c, along = self._c(q_rows[0], v_rows[0]), self._c_along(q_rows[1:], v_rows[1:])
        columns = self._inertia.times(np.concatenate([c[None], along]).T).T
        columns[1:] += self._held_b(c, lambda p: self._c(q_rows[0], v_rows[0], p)).T
        return columns

    def partials(self, q: Array, v: Array) -> Array:
        """Return design partials (M c)_b of the frame's inertia force, shape (k, n_q, n_b)."""
        return self._held_b(self._c(q, v), lambda p: self._c(q, v, p))

    def pull_back(self, q: Array, v: Array, mu: Array) -> Array:
        """Return the sum over k times of mu^T (M c)_b of the frame's inertia force, (n_b,)."""
        on_b = self._inertia.pull_back(self._c(q, v), mu, gravity=False)
        momenta = self._inertia.times(mu.T).T
        for i, change in self._changes(lambda p: self._c(q, v, p)):
            on_b[i] += np.sum(momenta * change)
        return on_b

    def along_total(self, dq: Array, dv: Array, dq_b: Array, dv_b: Array) -> Array:
        """Return total design derivatives of M (c_q dq + c_v dv) of the frame, (n_q, n_b)."""
        total = self._held_b(self._c_along(dq, dv), lambda p: self._c_along(dq, dv, p))
        return total + self._inertia.times(self._c_along(dq_b.T, dv_b.T).T)

    def along_pull_back(self, dq: Array, dv: Array, mu: Array) -> Array:
        """Return design partials of mu^T M (c_q dq + c_v dv) of the frame, shape (n_b,)."""
        on_b = self._inertia.pull_back(self._c_along(dq, dv)[None], mu[None], gravity=False)
        momenta = self._inertia.times(mu)
        for i, change in self._changes(lambda p: self._c_along(dq, dv, p)):
            on_b[i] += momenta @ change
        return on_b

    def _held_b(self, c: Array, value: Callable[[Array], Array]) -> Array:
        """Return (M c)_b at fixed q and v, from c and from `value`, which gives c for p."""
        on_b = self._inertia.times_b(c).copy()
        for i, change in self._changes(value):
            on_b[..., i] += self._inertia.times(change.T).T
        return on_b

    def _changes(self, value: Callable[[Array], Array]) -> list[tuple[int, Array]]:
        """Return (index, derivative of value(p)) for each design variable that p depends on."""
        steps = ((int(i), self._p.real + 1j * STEP * self._p_b[:, i]) for i in self._active)
        return [(i, np.imag(value(p)) / STEP) for i, p in steps]

    # -- accelerations -----------------------------------------------------------------------------

    def _c(self, q: Array, v: Array, p: Array | None = None) -> Array:
        """Return the frame's acceleration c for a state or rows of states, shape of q."""
        _, _, through = self._frame.turn(self._p if p is None else p, self._d)
        return self._c_along(self._arms(q, through).reshape(q.shape), v, p)

    def _c_along(self, dq: Array, dv: Array, p: Array | None = None) -> Array:
        rate, J, _ = self._frame.turn(self._p if p is None else p, self._d)
        positions, velocities = (x.reshape(*x.shape[:-1], -1, self._d) for x in (dq, dv))
        c = rate**2 * (positions @ (J @ J).T) + 2 * rate * (velocities @ J.T)
        return np.asarray(c.reshape(dq.shape))

    def _arms(self, q: Array, through: Array) -> Array:
        """Return the vectors of q, positions relative to the axis, shape (..., n_q / d, d)."""
        vectors = q.reshape(*q.shape[:-1], -1, self._d)
        return np.asarray(vectors - self._inertia.positions[:, None] * through)

    def _product(self, block: Array) -> Array:
        """Return the values on the pattern of M times the same (d, d) block for every vector."""
        M, n = self._pattern.csr(self._inertia.values), len(self._inertia.positions)
        vectors = np.arange(n)[:, None, None] * self._d
        i, j = np.indices((self._d, self._d))
        shape = self._pattern.shape
        blocks = SparsityPattern(shape, (vectors + i).ravel(), (vectors + j).ravel())
        turned = M @ blocks.csr(np.tile(block.ravel(), (n, 1)).reshape(n, self._d, self._d).ravel())
        turned = turned.tocoo()
        kept = turned.data != 0
        return self._pattern.gather(turned.row[kept], turned.col[kept], turned.data[kept])
