"""Index-reduced forms of eq. (1), as implicit systems F(t, x, x') = 0 that SUNDIALS can solve.

Stabilised index 2 (Gear, Gupta & Leimkuhler 1985), x = [q, v, lam, eta]:

    q' - v + W^{-1} Phi_q^T eta = 0
    M v' + Phi_q^T lam - Q      = 0
    Phi_q v - nu                = 0         nu = -Phi_t
    Phi                         = 0

eta vanishes along the exact solution; the weights W = diag(w) give its force the units of a
velocity. Index 1, x = [q, v, lam]:

    q' - v                      = 0
    M v' + Phi_q^T lam - Q      = 0
    Phi_q v' - gamma            = 0.

The design derivatives X = dx/db solve F_x X + F_x' X' + F_b = 0, and the iteration matrix is
J = F_x + c_j F_x'. With dPhi_q/dt and d^2Phi_q/dt^2 taken along the motion,

    (Phi_q v - nu)_q = dPhi_q/dt,   (Phi_q a - gamma)_q = d^2Phi_q/dt^2,   gamma_v = -2 dPhi_q/dt.

Unknowns and equations are scaled (`Scales`), so that tolerances are pure numbers.
"""

from __future__ import annotations

import abc
from enum import Enum
from typing import final

import numpy as np

from ancfdae.integrators.characteristic_sizes import Scales
from ancfdae.integrators.start import InitialSensitivity, InitialState
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import Pattern
from ancfdae.protocol import MechanicalSystem
from ancfdae.protocol.total_derivatives import constraint_force_total, inertia_total

# Absolute tolerance of multipliers, in their own scale: so loose that they stay out of the error
# test (any of 1 to 1e6 will do). They must where they are of index 2. In the index-1 form the test
# would stop at every jump of a force, and cost up to twice the steps for no better digits.
_LOOSE = 1e3
# Absolute tolerance of coordinates and velocities relative to their scale, per unit of rtol.
_SMALL = 1e-2


class IndexReduced(abc.ABC):
    """An index-reduced form of one system; arguments and results are scaled.

    Parameters
    ----------
    system : MechanicalSystem
    scales : Scales

    Attributes
    ----------
    n : int
        Number of unknowns.
    rows, columns : array of int
        Positions of the raw entries of J; entries at one position add up.
    """

    def __init__(self, system: MechanicalSystem, scales: Scales) -> None:
        self._system, self._scales = system, scales
        self._size, self._unit = self._scaling()
        self.n = len(self._size)
        blocks = self._blocks()
        self.rows = np.concatenate([rows for rows, _ in blocks])
        self.columns = np.concatenate([columns for _, columns in blocks])
        self._factors = self._size[self.columns] / self._unit[self.rows]

    # -- what a form states --------------------------------------------------------------------

    @abc.abstractmethod
    def _scaling(self) -> tuple[Array, Array]:
        """Sizes of the unknowns and of the equations, shape (n,)."""

    @abc.abstractmethod
    def _residual(self, t: float, x: Array, xp: Array) -> Array:
        """F."""

    @abc.abstractmethod
    def _residual_b(self, t: float, x: Array, xp: Array, X: Array, Xp: Array) -> Array:
        """F_x X + F_x' X' + F_b, shape (n, n_b)."""

    @abc.abstractmethod
    def _blocks(self) -> list[tuple[Array, Array]]:
        """Rows and columns of the blocks of J."""

    @abc.abstractmethod
    def _entries(
        self, system: MechanicalSystem, t: float, x: Array, xp: Array, c_j: float
    ) -> list[Array]:
        """Entries of the blocks of J, for the system or for one at moved design values."""

    @final
    def tolerances(self, rtol: float) -> Array:
        """Return absolute tolerances of scaled unknowns or their sensitivities, shape (n,).

        They error-control q and v only.
        """
        tested = 2 * self._system.n_q
        return np.repeat([_SMALL * rtol, _LOOSE], [tested, self.n - tested])

    # -- scaled --------------------------------------------------------------------------------

    @final
    def residual(self, t: float, y: Array, yp: Array) -> Array:
        """Return F, shape (n,)."""
        return self._residual(t, y * self._size, yp * self._size) / self._unit

    @final
    def residual_b(self, t: float, y: Array, yp: Array, Y: Array, Yp: Array) -> Array:
        """Return the residual of the sensitivity equations, shape (n, n_b).

        Column i of Y is the derivative in ln b_i (in b_i where it is zero), scaled as y.
        """
        b, size = self._scales.b, self._size[:, None]
        X, Xp = Y * size / b, Yp * size / b
        R = self._residual_b(t, y * self._size, yp * self._size, X, Xp)
        scaled: Array = R * b / self._unit[:, None]
        return scaled

    @final
    def jacobian(
        self,
        t: float,
        y: Array,
        yp: Array,
        c_j: float,
        system: MechanicalSystem | None = None,
    ) -> Array:
        """Return the raw entries of J; of another system of the same kind if one is given."""
        x, xp = y * self._size, yp * self._size
        entries = self._entries(self._system if system is None else system, t, x, xp, c_j)
        scaled: Array = np.concatenate(entries) * self._factors
        return scaled

    @final
    def start(self, initial: InitialState) -> tuple[Array, Array]:
        """Return y and y' of a consistent start."""
        y, yp = self._vectors(initial.q, initial.v, initial.a, initial.lam)
        return y / self._size, yp / self._size

    @final
    def start_b(self, initial: InitialSensitivity) -> tuple[Array, Array]:
        """Return Y and Y' of a consistent start, shape (n, n_b)."""
        Y, Yp = self._vectors(initial.q_b, initial.v_b, initial.a_b, initial.lam_b)
        factor = self._scales.b / self._size[:, None]
        return Y * factor, Yp * factor

    @final
    def coordinates(self, y: Array) -> tuple[Array, Array]:
        """Return q and v, shape (..., n_q), of unknowns, shape (..., n)."""
        n_q = self._system.n_q
        x = y[..., : 2 * n_q] * self._size[: 2 * n_q]
        return x[..., :n_q], x[..., n_q:]

    @final
    def coordinates_b(self, Y: Array) -> tuple[Array, Array]:
        """Return q_b and v_b, shape (n_q, n_b)."""
        q, v = self.coordinates(Y.T)
        return self.per_design(q), self.per_design(v)

    @final
    def per_design(self, x: Array) -> Array:
        """Return derivatives in b, shape (..., n_q, n_b), of those in ln b, (..., n_b, n_q)."""
        per: Array = np.swapaxes(x, -1, -2) / self._scales.b
        return per

    def _vectors(self, q: Array, v: Array, a: Array, lam: Array) -> tuple[Array, Array]:
        """Pack x and x' at the start; multipliers start with derivative zero."""
        rest = np.zeros((self.n - 2 * len(q) - len(lam), *q.shape[1:]))
        y = np.concatenate([q, v, lam, rest])
        yp = np.concatenate([v, a, np.zeros_like(lam), rest])
        return y, yp


@final
class StabilisedIndex2(IndexReduced):
    """Gear-Gupta-Leimkuhler form, x = [q, v, lam, eta]."""

    def _scaling(self) -> tuple[Array, Array]:
        s = self._scales
        size = np.concatenate([s.q, s.v, s.lam, s.eta])
        return size, np.concatenate([s.v, s.force, s.row * s.speed, s.row * s.position])

    def _split(self, x: Array) -> tuple[Array, Array, Array, Array]:
        n_q, n_lam = self._system.n_q, self._system.n_lam
        lam = 2 * n_q
        return x[:n_q], x[n_q:lam], x[lam : lam + n_lam], x[lam + n_lam :]

    def _residual(self, t: float, x: Array, xp: Array) -> Array:
        system = self._system
        q, v, lam, eta = self._split(x)
        qp, vp, _, _ = self._split(xp)
        side = system.constraint_pattern.dot(system.constraint_q(q, t), v)
        return np.concatenate(
            [
                qp - v + system.constraint_force(q, eta, t) / system.weights,
                system.mass_times(q, vp)
                + system.constraint_force(q, lam, t)
                - system.force(q, v, t),
                side - system.velocity_side(q, t),
                system.constraint(q, t),
            ]
        )

    def _residual_b(self, t: float, x: Array, xp: Array, X: Array, Xp: Array) -> Array:
        system = self._system
        q, v, lam, eta = self._split(x)
        _, vp, _, _ = self._split(xp)
        q_b, v_b, lam_b, eta_b = self._split(X)
        qp_b, vp_b, _, _ = self._split(Xp)
        B, pattern = system.constraint_q(q, t), system.constraint_pattern
        drift = constraint_force_total(system, q, eta, t, q_b) + pattern.dot_transposed(B, eta_b)
        force = system.mass_times(q, vp_b) + inertia_total(system, q, vp, q_b)
        force = force + constraint_force_total(system, q, lam, t, q_b)
        force = force + pattern.dot_transposed(B, lam_b)
        side = system.constraint_q_times_total(q, v, t, q_b) + pattern.dot(B, v_b)
        return np.concatenate(
            [
                qp_b - v_b + drift / system.weights[:, None],
                force - system.force_total(q, v, t, q_b, v_b),
                side - system.velocity_side_total(q, t, q_b),
                pattern.dot(B, q_b) + system.constraint_b(q, t),
            ]
        )

    def _blocks(self) -> list[tuple[Array, Array]]:
        n_q, n_lam = self._system.n_q, self._system.n_lam
        every = np.arange(n_q)
        K, B = self._system.pattern, self._system.constraint_pattern
        v, lam, eta = n_q, 2 * n_q, 2 * n_q + n_lam
        return [
            (every, every),
            (K.rows, K.columns),
            (every, v + every),
            (B.columns, eta + B.rows),
            (v + K.rows, K.columns),
            (v + K.rows, v + K.columns),
            (v + B.columns, lam + B.rows),
            (lam + B.rows, B.columns),
            (lam + B.rows, v + B.columns),
            (eta + B.rows, B.columns),
        ]

    def _entries(
        self, system: MechanicalSystem, t: float, x: Array, xp: Array, c_j: float
    ) -> list[Array]:
        q, v, lam, eta = self._split(x)
        _, vp, _, _ = self._split(xp)
        M, f_q, f_v, B = _local(system, t, q, v, vp, lam)
        w, one = system.weights, np.ones(system.n_q)
        curvature = np.zeros(system.pattern.size)
        if not system.linear_constraints:
            curvature = system.constraint_force_q(q, eta, t) / w[system.pattern.rows]
        return [
            c_j * one,
            curvature,
            -one,
            B / w[system.constraint_pattern.columns],
            f_q,
            c_j * M + f_v,
            B,
            system.constraint_q_rate(q, v, t),
            B,
            B,
        ]


@final
class Index1(IndexReduced):
    """Constraints differentiated twice, x = [q, v, lam]; positions drift."""

    def _scaling(self) -> tuple[Array, Array]:
        s = self._scales
        acceleration = s.load * s.row
        return np.concatenate([s.q, s.v, s.lam]), np.concatenate([s.v, s.force, acceleration])

    def _split(self, x: Array) -> tuple[Array, Array, Array]:
        n_q = self._system.n_q
        return x[:n_q], x[n_q : 2 * n_q], x[2 * n_q :]

    def _residual(self, t: float, x: Array, xp: Array) -> Array:
        system = self._system
        q, v, lam = self._split(x)
        qp, vp, _ = self._split(xp)
        force = system.mass_times(q, vp) + system.constraint_force(q, lam, t)
        side = system.constraint_pattern.dot(system.constraint_q(q, t), vp)
        return np.concatenate(
            [
                qp - v,
                force - system.force(q, v, t),
                side - system.acceleration_side(q, v, t),
            ]
        )

    def _residual_b(self, t: float, x: Array, xp: Array, X: Array, Xp: Array) -> Array:
        system = self._system
        q, v, lam = self._split(x)
        _, vp, _ = self._split(xp)
        q_b, v_b, lam_b = self._split(X)
        qp_b, vp_b, _ = self._split(Xp)
        B, pattern = system.constraint_q(q, t), system.constraint_pattern
        force = system.mass_times(q, vp_b) + inertia_total(system, q, vp, q_b)
        force = force + constraint_force_total(system, q, lam, t, q_b)
        force = force + pattern.dot_transposed(B, lam_b)
        side = system.constraint_q_times_total(q, vp, t, q_b) + pattern.dot(B, vp_b)
        return np.concatenate(
            [
                qp_b - v_b,
                force - system.force_total(q, v, t, q_b, v_b),
                side - system.acceleration_side_total(q, v, t, q_b, v_b),
            ]
        )

    def _blocks(self) -> list[tuple[Array, Array]]:
        n_q = self._system.n_q
        every = np.arange(n_q)
        K, B = self._system.pattern, self._system.constraint_pattern
        v, lam = n_q, 2 * n_q
        return [
            (every, every),
            (every, v + every),
            (v + K.rows, K.columns),
            (v + K.rows, v + K.columns),
            (v + B.columns, lam + B.rows),
            (lam + B.rows, B.columns),
            (lam + B.rows, v + B.columns),
        ]

    def _entries(
        self, system: MechanicalSystem, t: float, x: Array, xp: Array, c_j: float
    ) -> list[Array]:
        q, v, lam = self._split(x)
        _, vp, _ = self._split(xp)
        M, f_q, f_v, B = _local(system, t, q, v, vp, lam)
        one = np.ones(system.n_q)
        return [
            c_j * one,
            -one,
            f_q,
            c_j * M + f_v,
            B,
            system.constraint_q_second_rate(q, v, vp, t),
            c_j * B + 2 * system.constraint_q_rate(q, v, t),
        ]


def _local(
    system: MechanicalSystem, t: float, q: Array, v: Array, a: Array, lam: Array
) -> tuple[Array, Array, Array, Array]:
    """M, f_q, f_v and Phi_q at one instant."""
    local = system.linearise(np.array([t]), q[None], v[None], a[None], lam[None])
    f_v = np.zeros(system.pattern.size) if local.f_v is None else local.f_v[0]
    return local.M[0], local.f_q[0], f_v, local.Phi_q[0]


class IndexReduction(Enum):
    """How the constraints are brought to an index that SUNDIALS solves."""

    STABILISED_INDEX_2 = "positions and velocities on the constraints (Gear-Gupta-Leimkuhler)"
    INDEX_1 = "accelerations on the constraints; positions drift"

    def form(self, system: MechanicalSystem, scales: Scales) -> IndexReduced:
        """Return the equations of a system in this form."""
        if self is IndexReduction.INDEX_1:
            return Index1(system, scales)
        return StabilisedIndex2(system, scales)


@final
class ColumnStorage:
    """Compressed sparse columns of a block lower triangular matrix.

        [ J             ]
        [ L_1  J        ]
        [ ...      ...  ]
        [ L_m         J ]

    It is the iteration matrix of a form with m sensitivity equations appended; all blocks share the
    pattern of J.

    Parameters
    ----------
    form : IndexReduced
    m : int
    """

    def __init__(self, form: IndexReduced, m: int) -> None:
        n = form.n
        own = [(form.rows, form.columns)]
        below = [(n * (i + 1) + form.rows, form.columns) for i in range(m)]
        diagonal = [(n * (i + 1) + form.rows, n * (i + 1) + form.columns) for i in range(m)]
        blocks = own + below + diagonal
        rows = np.concatenate([r for r, _ in blocks])
        columns = np.concatenate([c for _, c in blocks])
        # A pattern sorts by rows; that of the transposed matrix by columns of the matrix.
        self._pattern = Pattern((n * (m + 1), n * (m + 1)), columns, rows)
        self._index = self._pattern.index(columns, rows)

    def sparsity(self) -> tuple[Array, Array]:
        """Return rows and columns of the stored entries."""
        return self._pattern.columns, self._pattern.rows

    def values(self, J: Array, below: list[Array]) -> Array:
        """Return the stored entries from raw entries of the blocks."""
        raw = np.concatenate([J, *below, *([J] * len(below))])
        return np.bincount(self._index, raw, minlength=self._pattern.size)
