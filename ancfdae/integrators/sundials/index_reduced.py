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

The design derivatives X = dx/db solve F_x X + F_x' X' + F_b = 0, and the iteration matrix is J =
F_x + c_j F_x'. With dPhi_q/dt and d^2Phi_q/dt^2 taken along the motion,

    (Phi_q v - nu)_q = dPhi_q/dt,   (Phi_q a - gamma)_q = d^2Phi_q/dt^2,   gamma_v = -2 dPhi_q/dt.

Unknowns and equations are scaled, and positions count from the mean position of the start
(`Scales.place`), so that tolerances are pure numbers, independent of where a scene stands.

Integrals need the motion between the steps of SUNDIALS. Within a step of length h, from its ends
and with s = (t - t_n) / h,

    q = q_n + H (q_n+1 - q_n) + h (G_0 v_n + G_1 v_n+1) + h^2 (F_0 a_n + F_1 a_n+1),
    v = dq/dt,

the quintic polynomials that match q, v and a at both ends: of order six, one more than the
solver's. Asking the solver for states within every step would cost as much as its steps.
"""

import abc
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, final

import numpy as np

from ancfdae.equations import MechanicalSystem, reaction
from ancfdae.equations.saddle_points import force_total, held_q, held_total
from ancfdae.errors.checks import require_kind
from ancfdae.integrators.high_order import HighOrder
from ancfdae.integrators.integrator import Points
from ancfdae.integrators.problem import Scales
from ancfdae.integrators.quadrature import KRONROD, SHARES, Quadrature, Trajectory
from ancfdae.integrators.start import InitialSensitivity, InitialState
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import SparsityPattern

# Least relative tolerance: with a smaller one round-off would dominate the error of a step.
_LEAST_RTOL = 1e-13
# Absolute tolerance of multipliers, in their own scale: so loose that the error test ignores them
# (any of 1 to 1e6 will do), as it must where they are of index 2. In the index-1 form the test
# would stop at every jump of a force, and cost up to twice the steps without a smaller error.
_LOOSE = 1e3
# Absolute tolerance of coordinates and velocities relative to their scale, per unit of rtol.
_SMALL = 1e-2


class _Unknowns(NamedTuple):
    """The parts q, v, lam, eta of x, x' or their derivatives; eta is empty in the index-1 form."""

    q: Array
    v: Array
    lam: Array
    eta: Array


class _Instant(NamedTuple):
    """A system with its unknowns x and x' at time t (s), and the entries of Phi_q there."""

    system: MechanicalSystem
    t: float
    x: _Unknowns
    xp: _Unknowns
    Phi_q: Array


class IndexReduced(abc.ABC):
    """An index-reduced form F(t, x, x') = 0 of a system; its arguments and results are scaled.

    Positions among the n unknowns count from `place`, (n_q,). The iteration matrix J has raw
    entries at `rows` and `columns`; entries at the same position add up.
    """

    def __init__(self, system: MechanicalSystem, scales: Scales) -> None:
        self._system, self._scales, self.place = system, scales, scales.place
        self._size, self._unit = self._scaling()
        self.n = len(self._size)
        n_q, every = system.n_q, np.arange(system.n_q)
        K, B = system.pattern, system.constraint_pattern
        blocks = [
            (every, every),
            (every, n_q + every),
            (n_q + K.rows, K.columns),
            (n_q + K.rows, n_q + K.columns),
            (n_q + B.columns, 2 * n_q + B.rows),
            *self._blocks(),
        ]
        self.rows = np.concatenate([rows for rows, _ in blocks])
        self.columns = np.concatenate([columns for _, columns in blocks])
        self._factors = self._size[self.columns] / self._unit[self.rows]

    # -- equations of a form -------------------------------------------------------------------

    @abc.abstractmethod
    def _scaling(self) -> tuple[Array, Array]:
        """Return the scales of the unknowns and of the equations, shape (n,) each."""

    @abc.abstractmethod
    def _residual(self, at: _Instant) -> list[Array]:
        """Return the term that F adds to q' - v, and the rows of F below the force rows."""

    @abc.abstractmethod
    def _residual_b(self, at: _Instant, X: _Unknowns, Xp: _Unknowns) -> list[Array]:
        """Return F_x X + F_x' X' + F_b of the module, n_b columns, in the rows of `_residual`."""

    @abc.abstractmethod
    def _blocks(self) -> list[tuple[Array, Array]]:
        """Return rows and columns of the blocks of J that only this form has."""

    @abc.abstractmethod
    def _entries(self, at: _Instant, c_j: float) -> list[Array]:
        """Return the entries of the blocks of J that only this form has, as in `_blocks`."""

    @final
    def tolerances(self, rtol: float) -> Array:
        """Return absolute tolerances of the scaled unknowns, (n,); they control q and v only."""
        tested = 2 * self._system.n_q
        return np.repeat([_SMALL * rtol, _LOOSE], [tested, self.n - tested])

    # -- scaled --------------------------------------------------------------------------------

    @final
    def residual(self, t: float, y: Array, yp: Array) -> Array:
        """Return the scaled residual F(t, y, y') of this form, shape (n,)."""
        system, at = self._system, self._at(self._system, t, y, yp)
        x, xp = at.x, at.xp
        drift, *sides = self._residual(at)
        force = system.mass_times(x.q, xp.v) + reaction(system, t, x.q, x.lam)
        force = force - system.force(t, x.q, x.v)
        return np.concatenate([xp.q - x.v + drift, force, *sides]) / self._unit

    @final
    def residual_b(self, t: float, y: Array, yp: Array, Y: Array, Yp: Array) -> Array:
        """Return the residual of the sensitivity equations, shape (n, n_b).

        Column i of Y is the derivative of y in ln b_i (in b_i where that is zero).
        """
        system, at, b = self._system, self._at(self._system, t, y, yp), self._scales.b
        X, Xp = (self._split(Z * self._size[:, None] / b) for Z in (Y, Yp))
        x, (drift, *sides) = at.x, self._residual_b(at, X, Xp)
        force = system.mass_times(x.q, Xp.v)
        force = force + held_total(system, t, x.q, at.xp.v, x.lam, X.q)
        force = force + system.constraint_pattern.dot_transposed(at.Phi_q, X.lam)
        force = force - force_total(system, t, x.q, x.v, X.q, X.v)
        R = np.concatenate([Xp.q - X.v + drift, force, *sides])
        return np.asarray(R * b / self._unit[:, None])

    @final
    def jacobian(
        self, t: float, y: Array, yp: Array, c_j: float, system: MechanicalSystem | None = None
    ) -> Array:
        """Return the raw entries of J; of another system of the same structure if it is given."""
        at = self._at(system or self._system, t, y, yp)
        states = (z[None] for z in (at.x.q, at.x.v, at.xp.v, at.x.lam))
        local = at.system.linearise(np.array([t]), *states)
        one, rates = np.ones(at.system.n_q), c_j * local.M[0]
        if local.f_v is not None:
            rates = rates + local.f_v[0]
        form_entries = self._entries(at, c_j)
        entries = np.concatenate([c_j * one, -one, local.f_q[0], rates, at.Phi_q, *form_entries])
        return np.asarray(entries * self._factors)

    @final
    def start(self, initial: InitialState) -> tuple[Array, Array]:
        """Return the scaled unknowns y and y' of a consistent start, shape (n,) each."""
        q = initial.q - self.place
        y, yp = self._vectors(q, initial.v, initial.a, initial.lam)
        return y / self._size, yp / self._size

    @final
    def start_b(self, initial: InitialSensitivity) -> tuple[Array, Array]:
        """Return the scaled sensitivities Y and Y' of a consistent start, (n, n_b) each."""
        Y, Yp = self._vectors(*initial)
        factor = self._scales.b / self._size[:, None]
        return Y * factor, Yp * factor

    @final
    def coordinates(self, y: Array) -> tuple[Array, Array]:
        """Return q and v, shape (..., n_q), of scaled unknowns y, shape (..., n)."""
        q, v = self.unscaled(y)
        return q + self.place, v

    @final
    def unscaled(self, y: Array) -> tuple[Array, Array]:
        """Return q - p and v, or their rates or derivatives, (..., n_q), from scaled (..., n)."""
        n_q = self._system.n_q
        x = y[..., : 2 * n_q] * self._size[: 2 * n_q]
        return x[..., :n_q], x[..., n_q:]

    @final
    def coordinates_b(self, Y: Array) -> tuple[Array, Array]:
        """Return q_b and v_b, shape (n_q, n_b), of scaled sensitivities Y, shape (n, n_b)."""
        q, v = self.unscaled(Y.T)
        return self.per_design(q), self.per_design(v)

    @final
    def per_design(self, x: Array) -> Array:
        """Turn derivatives by ln b, (..., n_b, n_q), into derivatives by b, (..., n_q, n_b)."""
        return np.asarray(np.swapaxes(x, -1, -2) / self._scales.b)

    def _vectors(self, q: Array, v: Array, a: Array, lam: Array) -> tuple[Array, Array]:
        """Return x and x' of a start from its parts; multipliers have the rate zero."""
        rest = np.zeros((self.n - 2 * len(q) - len(lam), *q.shape[1:]))
        y = np.concatenate([q, v, lam, rest])
        yp = np.concatenate([v, a, np.zeros_like(lam), rest])
        return y, yp

    def _split(self, x: Array) -> _Unknowns:
        v = self._system.n_q
        lam, eta = 2 * v, 2 * v + self._system.n_lam
        return _Unknowns(x[:v], x[v:lam], x[lam:eta], x[eta:])

    def _at(self, system: MechanicalSystem, t: float, y: Array, yp: Array) -> _Instant:
        x, xp = self._split(y * self._size), self._split(yp * self._size)
        x = x._replace(q=x.q + self.place)
        return _Instant(system, t, x, xp, system.constraint_q(t, x.q))


@final
class StabilisedIndex2(IndexReduced):
    """Stabilised index-2 form of Gear, Gupta and Leimkuhler, x = [q, v, lam, eta]."""

    def _scaling(self) -> tuple[Array, Array]:
        s = self._scales
        size = np.concatenate([s.q, s.v, s.lam, s.eta])
        return size, np.concatenate([s.v, s.force, s.row * s.speed, s.row * s.position])

    def _residual(self, at: _Instant) -> list[Array]:
        system, t, x = self._system, at.t, at.x
        drift = reaction(system, t, x.q, x.eta) / system.weights
        return [drift, system.constraint(t, x.q, x.v), system.constraint(t, x.q)]

    def _residual_b(self, at: _Instant, X: _Unknowns, Xp: _Unknowns) -> list[Array]:
        system, B, t, x = self._system, self._system.constraint_pattern, at.t, at.x
        drift = held_total(system, t, x.q, np.zeros_like(x.q), x.eta, X.q)
        drift = drift + B.dot_transposed(at.Phi_q, X.eta)
        side = system.constraint_total(t, (x.q, x.v), (X.q, X.v))
        Phi_total = system.constraint_total(t, (x.q,), (X.q,))
        return [drift / system.weights[:, None], side, Phi_total]

    def _blocks(self) -> list[tuple[Array, Array]]:
        K, B = self._system.pattern, self._system.constraint_pattern
        v, lam = self._system.n_q, 2 * self._system.n_q
        eta = lam + self._system.n_lam
        return [
            (K.rows, K.columns),
            (B.columns, eta + B.rows),
            (lam + B.rows, B.columns),
            (lam + B.rows, v + B.columns),
            (eta + B.rows, B.columns),
        ]

    def _entries(self, at: _Instant, c_j: float) -> list[Array]:
        system, Phi_q, x, w = at.system, at.Phi_q, at.x, at.system.weights
        curvature = np.zeros(system.pattern.size)
        if not system.traits.linear_constraints:
            turned = held_q(system, at.t, x.q, np.zeros_like(x.q), x.eta)
            curvature = turned / w[system.pattern.rows]
        rate = system.constraint_q(at.t, x.q, x.v)
        return [curvature, Phi_q / w[system.constraint_pattern.columns], rate, Phi_q, Phi_q]


@final
class Index1(IndexReduced):
    """Index-1 form, with constraints differentiated twice, x = [q, v, lam]; positions drift."""

    def _scaling(self) -> tuple[Array, Array]:
        s = self._scales
        acceleration = s.load * s.row
        return np.concatenate([s.q, s.v, s.lam]), np.concatenate([s.v, s.force, acceleration])

    def _residual(self, at: _Instant) -> list[Array]:
        side = self._system.constraint(at.t, at.x.q, at.x.v, at.xp.v)
        return [np.zeros_like(at.x.q), side]

    def _residual_b(self, at: _Instant, X: _Unknowns, Xp: _Unknowns) -> list[Array]:
        motion, motion_b = (at.x.q, at.x.v, at.xp.v), (X.q, X.v, Xp.v)
        return [np.zeros_like(X.q), self._system.constraint_total(at.t, motion, motion_b)]

    def _blocks(self) -> list[tuple[Array, Array]]:
        B, n_q = self._system.constraint_pattern, self._system.n_q
        return [(2 * n_q + B.rows, B.columns), (2 * n_q + B.rows, n_q + B.columns)]

    def _entries(self, at: _Instant, c_j: float) -> list[Array]:
        system, x, t = at.system, at.x, at.t
        rate = c_j * at.Phi_q + 2 * system.constraint_q(t, x.q, x.v)
        return [system.constraint_q(t, x.q, x.v, at.xp.v), rate]


class IndexReduction(Enum):
    """Index-reduced forms of the equations of motion that IDA and IDAS can solve."""

    STABILISED_INDEX_2 = "positions and velocities on the constraints (Gear-Gupta-Leimkuhler)"
    INDEX_1 = "accelerations on the constraints; positions drift"

    def form(self, system: MechanicalSystem, scales: Scales) -> IndexReduced:
        """Return the equations of motion of a system in this index-reduced form."""
        if self is IndexReduction.INDEX_1:
            return Index1(system, scales)
        return StabilisedIndex2(system, scales)


@dataclass(frozen=True, repr=False)
class SundialsIntegrator(HighOrder):
    """An integrator of SUNDIALS for the index-reduced equations `form`."""

    form: IndexReduction = IndexReduction.STABILISED_INDEX_2

    def __post_init__(self) -> None:
        self.require_settings(_LEAST_RTOL)
        where = f"{type(self).__name__}.form"
        require_kind(where, self.form, (IndexReduction,), "Use a member of IndexReduction.")


@final
class ColumnStorage:
    """Compressed sparse columns of the iteration matrix with m sensitivity equations.

    J stands on the diagonal m + 1 times; blocks with the pattern of J stand below the first one.
    """

    def __init__(self, form: IndexReduced, m: int) -> None:
        n = form.n
        corner = [(form.rows, form.columns)]
        below = [(n * (i + 1) + form.rows, form.columns) for i in range(m)]
        diagonal = [(n * (i + 1) + form.rows, n * (i + 1) + form.columns) for i in range(m)]
        blocks = corner + below + diagonal
        rows = np.concatenate([r for r, _ in blocks])
        columns = np.concatenate([c for _, c in blocks])
        # A pattern sorts by rows; that of the transposed matrix by columns of the matrix.
        self._pattern = SparsityPattern((n * (m + 1), n * (m + 1)), columns, rows)
        self._index = self._pattern.index(columns, rows)

    def sparsity(self) -> tuple[Array, Array]:
        """Return rows and columns of the stored entries of the iteration matrix."""
        return self._pattern.columns, self._pattern.rows

    def values(self, J: Array, below: list[Array]) -> Array:
        """Return the stored entries from raw entries of J and of the blocks below it."""
        raw = np.concatenate([J, *below, *([J] * len(below))])
        return np.bincount(self._index, raw, minlength=self._pattern.size)


# Coefficients of s^0 to s^5 in the quintics H, G_0, G_1, F_0 and F_1 (rows).
_QUINTIC = np.array(
    [
        [0, 0, 0, 10, -15, 6],
        [0, 1, 0, -6, 8, -3],
        [0, 0, 0, -4, 7, -3],
        [0, 0, 0.5, -1.5, 1.5, -0.5],
        [0, 0, 0, 0.5, -1, 0.5],
    ]
)
_QUINTIC_SLOPE = _QUINTIC[:, 1:] * np.arange(1, 6)
# Panels per step: where high-frequency modes limit the step and the integrand is smooth, one panel
# over many steps is enough. One panel in every step sees none of the kinks between the quintics.
_PANELS_PER_STEP = (1 / 8, 1, 4, 8)
# Most steps that are added to the integrals in one batch, and most numbers that their points hold.
_STEPS, _NUMBERS = 128, 5_000_000


@final
class StepPoints:
    """Collects steps of SUNDIALS, with m sensitivities, and passes points to the integrals."""

    def __init__(self, form: IndexReduced, quadrature: Quadrature, m: int) -> None:
        self._form, self._quadrature, self._m = form, quadrature, m
        per_step = 4 * form.n * (m + 1) * len(SHARES) * _PANELS_PER_STEP[-1]
        self._most = int(np.clip(_NUMBERS / per_step, 1, _STEPS))
        self._t: list[float] = []
        self._y: list[Array] = []
        self._yp: list[Array] = []

    @property
    def wanted(self) -> bool:
        """Whether there are integrals, for which steps must be collected."""
        return self._quadrature.wanted

    def add(self, t: float, y: Array, yp: Array) -> None:
        """Store a step to t, or the start; y and yp, shape ((m + 1) n,), are not copied."""
        self._t.append(t)
        self._y.append(y)
        self._yp.append(yp)
        if len(self._t) > self._most:
            self.finish()

    def finish(self) -> None:
        """Pass the stored steps to the integrals; the end of the last step starts the next part."""
        if len(self._t) > 1:
            t, y, yp = np.array(self._t), self._unscaled(self._y), self._unscaled(self._yp)
            y[0][:, 0] += self._form.place
            steps = self._motion(t, *y)._replace(a=yp[1][:, 0])
            self._quadrature.add(self._choices(t, y, yp[1]), steps)
        for kept in (self._t, self._y, self._yp):
            del kept[:-1]

    def _choices(self, t: Array, y: tuple[Array, Array], a: Array) -> Iterator[Points]:
        q, v = y
        data = (np.diff(q, axis=0), v[:-1], v[1:], a[:-1], a[1:])
        for density in _PANELS_PER_STEP:
            ends = _panels(t, density)
            h = np.diff(ends)
            times = ends[:-1, None] + np.outer(h, SHARES)
            times[:, -1] = ends[1:]
            step = np.clip(np.searchsorted(t, times.ravel(), side="right") - 1, 0, len(t) - 2)
            within = _between(times.ravel(), t, step, q, data)
            yield Points(KRONROD, h, *self._motion(times.ravel(), *within))

    def _unscaled(self, rows: list[Array]) -> tuple[Array, Array]:
        """Return q - p and v, or their rates, with sensitivities, shape (steps, m + 1, n_q)."""
        return self._form.unscaled(np.array(rows).reshape(len(rows), self._m + 1, -1))

    def _motion(self, t: Array, q: Array, v: Array) -> Trajectory:
        derivatives = (self._form.per_design(x[:, 1:]) for x in ((q, v) if self._m else ()))
        return Trajectory(t, q[:, 0], v[:, 0], *derivatives)


def _panels(t: Array, per_step: float) -> Array:
    """Return the ends of quadrature panels, s: `per_step` panels per step, or less than one."""
    if per_step < 1:
        return np.append(t[: -1 : round(1 / per_step)], t[-1])
    share = np.arange(round(per_step)) / per_step
    return np.append((t[:-1, None] + np.outer(np.diff(t), share)).ravel(), t[-1])


def _between(
    times: Array, t: Array, step: Array, q: Array, data: tuple[Array, ...]
) -> tuple[Array, Array]:
    """Return coordinates and velocities at `times` by the quintics of steps `step`, (k, ...)."""
    h = np.diff(t)[step]
    powers = ((times - t[step]) / h)[:, None] ** np.arange(6)
    units = np.stack([np.ones_like(h), h, h, h**2, h**2])
    values, slopes = _QUINTIC @ powers.T * units, _QUINTIC_SLOPE @ powers[:, :5].T * units / h
    x, xp = q[step], np.zeros((len(times), *q.shape[1:]))
    for array, value, slope in zip(data, values, slopes, strict=True):
        taken = array[step]
        x += value[:, None, None] * taken
        xp += slope[:, None, None] * taken
    return x, xp
