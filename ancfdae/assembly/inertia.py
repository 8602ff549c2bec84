"""Mass matrix of a scene, its design derivatives, gravity, and inertia forces in a rotating frame.

Elements, rigid bodies, rigid beams and point masses are mass blocks. With vectors X of its body
each block has the kinetic energy 1/2 sum_ij m_ij X_i' . X_j', so that the mass matrix is the sum of
m (x) I_d over all blocks (docs/theory/03-joints-and-loads.md):

    element       m = int rho s s^T dV_o
    rigid body    m = int [1, x] [1, x]^T dm, x the position in the axes of the body
    rigid beam    m = sum over its elements of W^T m_e W, with node vectors W (frame of the body)
    point mass    m = mass w w^T, with position sum_a w_a X_a

**Rotating frame** (docs/theory/15-steady-rotation.md). All coordinates are vectors that rotate with
the frame, and the mass matrix m (x) I_d is the same in it. In the frame the acceleration of a
material point has the additional term

    c(q, v) = 2 w J v + w^2 J^2 (q - p),

with the rate w, J x = axis x x and p the position of the axis (zero for slopes): the residual M a +
Phi_q^T lam - Q has the additional term M c, which is linear in v and affine in q.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np

from ancfdae.assembly.block import ElementForms
from ancfdae.assembly.layout import BeamLayout
from ancfdae.assembly.naming import PointVector, SceneNaming
from ancfdae.assembly.numbering import Numbering, coupled
from ancfdae.assembly.parameters import ParameterMap
from ancfdae.model.bodies import BeamBody, Quantity, RigidBody
from ancfdae.model.elements import ElementParameter
from ancfdae.model.scene import Scene
from ancfdae.model.turning_frame import RotatingFrame
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.patterns import LinearMap, SparsityPattern


class MassPartials(NamedTuple):
    """Derivatives of mass blocks m, one per pair of block and design variable.

    `block` and `variable`, of int, have the shape (n_pairs,), `m_b` (n_pairs, k, k).
    """

    block: Array
    variable: Array
    m_b: Array


@final
@dataclass(frozen=True)
class MassBlocks:
    """Mass blocks of n objects with k vectors each; design derivatives are made on first use."""

    vectors: Array  # of int, (n, k)
    m: Array  # (n, k, k)
    # of int, (n,): owner of each block: index among the bodies of the scene, then its point masses.
    owners: Array
    derivative: Callable[[], MassPartials]

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes to pickle: derivatives instead of the closure that makes them."""
        return {**vars(self), "partials": self.partials, "derivative": None}

    @cached_property
    def partials(self) -> MassPartials:
        """Derivatives of the mass blocks in the design variables that change them."""
        return self.derivative()

    def chosen(self, owner: int | None) -> Array:
        """Return a mask, one or zero, of the mass blocks of an owner or of the scene, (n,)."""
        return np.ones(len(self.m)) if owner is None else (self.owners == owner).astype(float)


@final
@dataclass(frozen=True, eq=False)
class _Mass:
    """One mass block m, and its derivatives in all design variables, made on first use."""

    m: Array  # (k, k)
    derivative: Callable[[], Array]

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes to pickle: derivatives in place of the closure that makes them."""
        return {**vars(self), "m_b": self.m_b, "derivative": None}

    @cached_property
    def m_b(self) -> Array:
        """Derivatives of the mass block m, shape (n_b, k, k)."""
        return self.derivative()


#: Cache: by index among the bodies of a scene, parameters of a rigid body or point mass, and its
#: mass.
KnownMasses: TypeAlias = dict[int, tuple[Any, Any]]


def other_masses(
    scene: Scene, naming: SceneNaming, mapping: ParameterMap, b: Array, known: KnownMasses
) -> tuple[MassBlocks, ...]:
    """Return the mass blocks of rigid bodies, rigid beams and point masses.

    `known` caches masses; a mass whose parameters are unchanged is reused.
    """
    layout, single, elements = naming.layout, list[tuple[Array, int, _Mass]](), mapping.values(b)
    for owner, member in enumerate(scene.members):
        if isinstance(member, RigidBody):
            numbers, masses = mapping.numbers(member.name, b)[0], partial(_of_body, member)
        elif member.rigid:
            place = layout.beam(member.name)
            numbers, masses = elements[place.elements], partial(_of_rigid_beam, member, place)
        else:
            continue
        key = numbers.dtype, numbers.tobytes()
        before, its = known.get(owner, ((), None))
        if before != key:
            its = masses(mapping, b)
            known[owner] = key, its
        single.append((layout.bodies[owner].vectors, owner, its))
    for owner, mass in enumerate(scene.point_masses, start=len(scene.members)):
        p, p_b = mapping.numbers(mass.name, b)
        of_point = p.dtype, p.tobytes(), naming.lengths.tobytes()
        before, its = known.get(owner, ((), None))
        if before != of_point:
            its = _of_point(naming.vector(mass.point, Quantity.POSITION, (p[1:], p_b[1:])), p, p_b)
            known[owner] = of_point, its
        single.append((its[0], owner, its[1]))
    sizes = sorted({len(vectors) for vectors, *_ in single})
    return tuple(_together([x for x in single if len(x[0]) == size]) for size in sizes)


def of_states(numbering: Numbering) -> MassBlocks:
    """Return the mass blocks of state vectors, which have no owner and no design variable."""
    masses, none = numbering.masses, np.zeros(0, dtype=np.int64)
    vectors = numbering.n_q // numbering.d - len(masses) + np.arange(len(masses))
    nobody = np.full(len(masses), -1)
    derivative = lambda: MassPartials(none, none, np.zeros((0, 1, 1)))  # noqa: E731
    return MassBlocks(vectors[:, None], masses[:, None, None], nobody, derivative)


def _together(blocks: Sequence[tuple[Array, int, _Mass]]) -> MassBlocks:
    """Return mass blocks of equal size, with their vectors and owners, as one `MassBlocks`."""
    vectors, owners, masses = zip(*blocks, strict=True)

    def derivative() -> MassPartials:
        m_b = np.stack([mass.m_b for mass in masses])
        block, variable = np.nonzero(np.any(m_b != 0, axis=(2, 3)))
        return MassPartials(block, variable, m_b[block, variable])

    m = np.stack([mass.m for mass in masses])
    return MassBlocks(np.stack(vectors), m, np.array(owners), derivative)


def _of_point(at: PointVector, p: Array, p_b: Array) -> tuple[Array, _Mass]:
    """Return the vectors of the body that carries a point mass, and the block p w w^T."""
    w, w_b = at.weights, at.weights_b.T

    def derivative() -> Array:
        once = p[0] * w_b[:, :, None] * w
        return p_b[0][:, None, None] * np.outer(w, w) + once + once.transpose(0, 2, 1)

    return at.vectors, _Mass(p[0] * np.outer(w, w), derivative)


def _of_body(body: RigidBody, mapping: ParameterMap, b: Array) -> _Mass:
    """Return the mass block of a rigid body, differentiated by complex steps."""
    p, p_b = mapping.numbers(body.name, b)
    m = body.moments(p)

    def derivative() -> Array:
        m_b = np.zeros((len(b), *m.shape))
        for i in np.flatnonzero(np.any(p_b, axis=0)):
            m_b[i] = body.moments(p.real + 1j * STEP * p_b[:, i]).imag / STEP
        return m_b

    return _Mass(m, derivative)


def _of_rigid_beam(beam: BeamBody, place: BeamLayout, mapping: ParameterMap, b: Array) -> _Mass:
    """Return the mass block sum of W^T m_e W of a rigid beam, with derivatives of m_e and W."""
    rows = np.arange(place.elements.start, place.elements.stop)
    driven, element, nodes = mapping.only(rows), beam.element, place.rigid
    assert nodes is not None
    block = ElementForms.of(element, [beam], driven).at(b)
    lengths = driven.values(b)[:, ElementParameter.LENGTH]
    W = nodes.weights(lengths, element.n_s)
    W_e = np.concatenate([W[:-1], W[1:]], axis=1)  # of the nodes of each element
    m = np.sum(W_e.mT @ block.m @ W_e, axis=0)

    def derivative() -> Array:
        m_b = np.zeros((len(b), *m.shape), dtype=m.dtype)
        at, variables = driven.elements[block.mass_pairs], driven.variables[block.mass_pairs]
        np.add.at(m_b, variables, W_e[at].mT @ block.partials.m_b @ W_e[at])
        moved = nodes.positions_b(driven.lengths_b(len(b)))
        momenta = block.m @ W_e
        for first, node in ((0, slice(None, -1)), (element.n_s, slice(1, None))):
            change = np.einsum("ndb,nj->bdj", moved[node], momenta[:, first])
            m_b[:, 1:] += change
            m_b[:, :, 1:] += change.transpose(0, 2, 1)
        return m_b

    return _Mass(m, derivative)


@final
@dataclass(frozen=True, eq=False)
class MassPlaces:
    """Indices of mass blocks in the mass matrix, equal at all designs with equal vectors.

    `at` are the indices of the entries of all m (x) I_d on a pattern, `directions` the coordinates
    of the axes of rigid bodies, (n, d, d) of int, `positions` the vectors that are positions.
    """

    vectors: tuple[Array, ...]
    at: Array
    directions: Array
    positions: Array


# Smallest weight of a direction of a rigid body, over its largest.
_LEAST = 1e-12


@final
class Inertia:
    """The mass matrix M, its design derivatives M_b, and the force of gravity.

    `gravity` is the acceleration, (d,), m/s^2, with its design derivatives, (d, n_b). The pattern
    is that of the system's matrices and must hold the entries of every block. `values` are M on it;
    `weights`, (n_q,), are its real diagonal, bounded from below for rigid bodies; `positions`, (n_q
    / d,), are one for vectors that are positions, zero for slopes. Indices of `before` are reused
    if the blocks have the same vectors.
    """

    def __init__(
        self,
        blocks: Sequence[MassBlocks],
        numbering: Numbering,
        n_b: int,
        pattern: SparsityPattern,
        gravity: tuple[Array, Array],
        before: MassPlaces | None = None,
    ) -> None:
        n_q, d = numbering.n_q, numbering.d
        self._n_b, self._n_q, self._d, self._blocks = n_b, n_q, d, blocks
        vectors = tuple(x.vectors for x in blocks)
        same = before is not None and len(vectors) == len(before.vectors)
        if before is None or not (same and all(map(np.array_equal, before.vectors, vectors))):
            at = pattern.index(*coupled(map(numbering.coordinates, vectors)))
            directions = numbering.coordinates(numbering.frames[:, 1:])
            positions = np.concatenate([body.positions for body in numbering.bodies])
            before = MassPlaces(vectors, at, directions, positions)
        self.places = before
        values = np.concatenate([np.repeat(x.m.ravel(), d) for x in blocks])
        self._pattern, at, count = pattern, self.places.at, pattern.size
        self.values = np.bincount(at, values.real, minlength=count)
        if np.iscomplexobj(values):
            self.values = self.values + 1j * np.bincount(at, values.imag, minlength=count)
        directions = self.places.directions
        self.weights = self.values[pattern.diagonal].real.copy()
        # A direction of a rigid body may have no inertia: a rigid straight cable has none across
        # its axis, and its integral is round-off.
        weights = self.weights[directions]
        self.weights[directions] = np.maximum(
            weights, _LEAST * np.max(weights, axis=1, keepdims=True)
        )
        (field, field_b), shape = gravity, (n_q // d, d)
        self.positions = np.zeros(shape[0])
        self.positions[self.places.positions] = 1.0
        self._field = np.outer(self.positions, field)
        # Rows of the variables that gravity depends on, to save memory.
        self._field_active = np.flatnonzero(np.any(field_b != 0, axis=0))
        self._field_b = np.zeros((len(self._field_active), *shape))
        self._field_b[:, self.places.positions] = field_b[:, self._field_active].T[:, None]

    @cached_property
    def M(self) -> LinearMap:
        """Map from vectors, (..., n_q), to their product with the mass matrix."""
        # Two of three entries of a spatial element are zero: masses do not couple directions.
        kept, pattern = np.flatnonzero(self.values), self._pattern
        before = np.append(0, np.cumsum(self.values != 0))
        first = before[pattern.places[0]]
        return LinearMap((first, pattern.columns[kept], self.values[kept]), self._n_q)

    @cached_property
    def M_b(self) -> LinearMap:
        """Map from accelerations a to (M a)_b as a flattened (n_b, n_q) array."""
        pairs = [x.partials for x in self._blocks]
        vectors = [x.vectors[of.block] for x, of in zip(self._blocks, pairs, strict=True)]
        rows, columns = coupled(x[..., None] * self._d + np.arange(self._d) for x in vectors)
        values = np.concatenate([np.repeat(of.m_b.ravel(), self._d) for of in pairs])
        counts = [self._d * x.vectors.shape[1] ** 2 for x in self._blocks]
        variables = zip((of.variable for of in pairs), counts, strict=True)
        variable = np.concatenate([np.repeat(numbers, count) for numbers, count in variables])
        shape = (self._n_q * self._n_b, self._n_q)
        return LinearMap.of(variable * self._n_q + rows, columns, values, shape)

    @cached_property
    def gravity(self) -> Array:
        """Force of gravity, shape (n_q,), N: M times the field g on all positions (eq. 12)."""
        return self.M(self._field.ravel())

    @cached_property
    def gravity_b(self) -> Array:
        """Design partials of the force of gravity, shape (n_q, n_b); N per unit of the variable."""
        Q_b = self.times_b(self._field.ravel())
        if len(self._field_active):
            fields = self._field_b.reshape(len(self._field_b), -1)
            Q_b = Q_b.copy()
            Q_b[:, self._field_active] += self.times(fields.T)
        return Q_b

    @cached_property
    def gravity_rows(self) -> Array:
        """The force of gravity and its design partials as rows, shape (1 + n_b, n_q)."""
        return np.concatenate([self.gravity[None], self.gravity_b.T])

    def times(self, x: Array) -> Array:
        """Return M x for a vector x, (n_q,), or for columns, (n_q, n)."""
        return self.M(x.T).T

    def times_b(self, a: Array) -> Array:
        """Return the design partial (M a)_b for one a or for rows, shape (..., n_q, n_b)."""
        return self.M_b(a).reshape((*a.shape[:-1], self._n_b, self._n_q)).mT

    def pull_back(self, a: Array, x: Array, gravity: bool = True) -> Array:
        """Return the sum over times of (M a - gravity)_b^T x, (n_b,); a, x of shape (k, n_q)."""
        a = a - self._field.ravel() if gravity else a
        total = np.zeros(self._n_b, dtype=np.result_type(a, x))
        # Node vectors first, each at all time points.
        A, X = (
            np.concatenate(y.reshape(len(y), -1, self._d), axis=1, dtype=total.dtype)
            for y in (a, x)
        )
        for block in self._blocks:
            # Sums over time points and axes first: x^T M_b a = M_b : (x a^T).
            of = block.partials
            at = block.vectors[of.block]
            sums = X[at] @ A[at].mT
            np.add.at(total, of.variable, np.einsum("pij,pij->p", of.m_b, sums))
        if gravity and len(self._field_active):
            fields = self._field_b.reshape(len(self._field_b), -1)
            total[self._field_active] -= fields @ self.times(np.sum(x, axis=0))
        return total

    def quadratic_b(self, v: Array, owner: int | None) -> Array:
        """Return the design partial of v^T M v of one owner or of the scene, shape (k, n_b)."""
        result, V = np.zeros((len(v), self._n_b), dtype=v.dtype), v.reshape(len(v), -1, self._d)
        for block in self._blocks:
            of = block.partials
            V_p = V[:, block.vectors[of.block]]
            products = np.einsum("kpad,pab,kpbd->kp", V_p, of.m_b, V_p, optimize=True)
            np.add.at(result.T, of.variable, (products * block.chosen(owner)[of.block]).T)
        return result

    def owner_times(self, v: Array, owner: int) -> Array:
        """Return M v with the masses of one owner only, for rows of v, shape (k, n_q)."""
        X = v.reshape(len(v), -1, self._d)
        # Vectors first: repeated entries are added along the first axis.
        result = np.zeros((X.shape[1], len(v), self._d), dtype=np.result_type(v, self.values))
        for block in self._blocks:
            chosen = np.flatnonzero(block.chosen(owner))
            products = np.einsum("nab,knbd->nakd", block.m[chosen], X[:, block.vectors[chosen]])
            np.add.at(result, block.vectors[chosen], products)
        return result.swapaxes(0, 1).reshape(v.shape)


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
