"""Consistent starts: positions and velocities on their constraints, accelerations, multipliers.

Steps of a start:

1. Positions: the nearest configuration on the constraints in the norm of M,
       M (q - q_start) + Phi_q^T sigma_q = 0,   Phi(q) = 0,   M at q_start.
2. Velocities likewise: M (v - v_start) + Phi_q^T sigma_v = 0, Phi_q v = nu(q).
3. Accelerations and multipliers: M a + Phi_q^T lam = Q, Phi_q a = gamma(q, v).

A start that is declared consistent (`project_start` false) is rejected if it violates a constraint
by more than round-off can explain; 1 and 2 then only remove that round-off. The design derivatives
differentiate 1 to 3 as they stand, so they are exact for projected starts too.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple, TypeAlias, final

import numpy as np

from ancfdae.equations import MechanicalSystem, reaction
from ancfdae.equations.saddle_points import (
    acceleration_side,
    held_pull_back,
    held_q,
    held_total,
    held_totals,
    refuse_opened,
    refuse_redundant,
    solve,
    solve_transposed,
    velocity_side,
)
from ancfdae.errors.kinds import InconsistentStartError, InvalidInputError, SingularMatrix
from ancfdae.kernels import finite, norm
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint

# Relative violation of a constraint up to which a declared start counts as consistent: far
# above accumulated round-off of coordinates (1e-14), far below any intended inconsistency.
_CONSISTENT = 1e-8
_REPAIR = "Let `start` follow self.b, or set project_start=True to move it onto the constraints."
# Largest relative violation by design derivatives of a declared start: complex steps are exact.
_SAME_RATE = 1e-6
_PROJECTION_ITERATIONS = 50
# The projection ends if a correction of the positions is below _CLOSED times their norm.
_CLOSED = 1e-12
# Numbers of stages in which the gaps of the constraints are closed, tried in this order.
_STAGES = (1, 8, 64)

# q and sigma_q of step 1, and the factors of [M Phi_q^T; Phi_q 0] if they were computed.
_Closed: TypeAlias = tuple[Array, Array, Factorization | None]


class InitialState(NamedTuple):
    """A consistent state at time t (s): q, v and a, (n_q,), and multipliers lam, (n_lam,)."""

    t: float
    q: Array
    v: Array
    a: Array
    lam: Array


class InitialSensitivity(NamedTuple):
    """Design derivatives of an `InitialState`; shapes (n_q, n_b) and (n_lam, n_b)."""

    q_b: Array
    v_b: Array
    a_b: Array
    lam_b: Array


def consistent_start(
    system: MechanicalSystem, matrices: SaddlePoint, t: float
) -> tuple[InitialState, Factorization]:
    """Return the consistent start of a system and the factors of [M Phi_q^T; Phi_q 0] there.

    Raises InconsistentStartError if the declared start violates a constraint and `project_start` is
    false, or if the projection does not converge; InvalidInputError if the start, or the forces at
    it, are not finite.
    """
    q, v = system.start()
    if not (finite(q) and finite(v)):
        repair = "Check the values that `start` returns."
        raise InvalidInputError("start", "q and v must be finite", "NaN or infinity", repair)
    if not system.traits.project_start:
        _refuse_inconsistent(system, q, v, t)
    # Forces that are not finite at the start are refused here, not warned about.
    with np.errstate(all="ignore"):
        declared, (q, _, factors) = q, _project_position(system, matrices, q, t)
        # Redundancy was checked at the declared start; check again if projection moved it.
        moved = norm(q - declared, system.weights) > _CLOSED * norm(declared, system.weights)
        if moved and not system.traits.linear_constraints:
            refuse_redundant(system, matrices, system.constraint_q(t, q))
        if system.traits.rows_left_out:
            refuse_opened(system, t, q)
        if factors is None:
            factors = _factor_mass(system, matrices, q, t)
        side = velocity_side(system, t, q)
        v = 0 * v if at_rest(v, side) else solve(factors, system.mass_times(q, v), side)[0]
        Q = system.force(t, q, v)
        if not finite(Q):
            repair = "Check forces and start."
            raise InvalidInputError(
                "forces at the start", "must be finite", "NaN or infinity", repair
            )
        a, lam = solve(factors, Q, acceleration_side(system, t, q, v))
        return InitialState(t, q, v, a, lam), factors


def at_rest(v: Array, side: Array) -> bool:
    """Return whether v and `side` are zero: velocities or accelerations that drivers prescribe."""
    return not (v.any() or side.any())


def start_sensitivity(
    system: MechanicalSystem,
    matrices: SaddlePoint,
    state: InitialState,
    rows: Callable[[float, Array, Array], Array] | None = None,
) -> InitialSensitivity:
    """Return the design derivatives of `consistent_start`.

    `rows` returns (a, lam) above their design derivatives, from q and v above theirs:
    `Accelerations. rows` of a run that evaluates them anyway. By default they are solved for here.
    """
    t, q, v, a, lam = state
    moves = _Moves(system, matrices, state)
    q_b, v_b = _motion_sensitivity(system, state, moves)
    states = np.vstack([q, q_b.T]), np.vstack([v, v_b.T])
    if rows is not None:
        x_b = rows(t, *states)[1:].T
        return InitialSensitivity(q_b, v_b, x_b[: system.n_q], x_b[system.n_q :])
    force, side = held_totals(system, t, *states, np.concatenate([a, lam]))
    right = system.force_and_total(t, *states)[1:] - force
    side_b = np.zeros((len(lam), system.n_b)) if side is None else -side.T
    return InitialSensitivity(q_b, v_b, *solve(moves.factors, right.T, side_b))


def _motion_sensitivity(
    system: MechanicalSystem, state: InitialState, moves: _Moves
) -> tuple[Array, Array]:
    """Return the design derivatives of q and v of `consistent_start`, (n_q, n_b) each."""
    t, q, v, _, lam = state
    q_start, _ = system.start()
    q_sb, v_sb = system.start_b()
    held = np.zeros_like(q_sb)
    # 1. (M (q - q_start) + Phi_q^T sigma_q)_total = 0, M at q_start; sigma_q held on the right.
    right = system.mass_times(q_start, q_sb)
    right = right - held_total(system, t, q_start, moves.dq, 0 * lam, q_sb)
    right = right - held_total(system, t, q, 0 * q, moves.sigma_q, held)
    side = -system.constraint_total(t, (q,))
    q_b = solve(moves.moving, right, side)[0] if right.any() or side.any() else held
    # 2. (M (v - v_start) + Phi_q^T sigma_v)_total = 0 likewise.
    right = system.mass_times(q, v_sb) - held_total(system, t, q, moves.dv, moves.sigma_v, q_b)
    side = np.zeros((len(lam), system.n_b))
    if not system.traits.constant_constraints:
        side = -system.constraint_total(t, (q, v), (q_b, held))
    v_b = solve(moves.factors, right, side)[0] if right.any() or side.any() else held
    if type(system).start_pull_back is MechanicalSystem.start_pull_back:
        _refuse_inconsistent_derivatives(system, state, (q_sb, v_sb), (q_b, v_b))
    return q_b, v_b


def _refuse_inconsistent_derivatives(
    system: MechanicalSystem,
    state: InitialState,
    declared: tuple[Array, Array],
    projected: tuple[Array, Array],
) -> None:
    """Raise InconsistentStartError if a start satisfies its constraints at this design only.

    Its derivatives then miss Phi_q q_b + Phi_b = 0, or the same of velocities, by the change that
    projection makes: `projected` minus `declared`. The change is compared, in the norm of the
    weights, with the larger of the two and with the size of the motion per relative change of the
    variable. Scenes close their joints by construction, have derivatives of their own and are not
    checked.
    """
    if system.traits.project_start or not system.n_lam:
        return
    w, b = system.weights, np.where(system.b.real == 0, 1.0, np.abs(system.b.real))
    place = norm(state.q, w)
    speed = max(norm(state.v, w), float(np.sqrt(place * norm(state.a, w))))
    whats, sizes = ("positions", "velocities"), (place, speed)
    for what, x_b, moved, size in zip(whats, declared, projected, sizes, strict=True):
        for j, name in enumerate(system.design_names):
            gap = norm(moved[:, j] - x_b[:, j], w)
            larger = max(norm(x_b[:, j], w), norm(moved[:, j], w))
            if gap > _SAME_RATE * larger + _CONSISTENT * size / b[j]:
                raise InconsistentStartError(
                    f"start, design variable {name!r}",
                    f"the {what} must satisfy the constraints at every design",
                    f"a derivative with respect to {name!r} that misses theirs by "
                    f"{gap / larger:.1e} of itself",
                    _REPAIR,
                )


@final
class _Moves:
    """Changes dq, dv from a declared to its consistent start, with multipliers sigma_q, sigma_v."""

    def __init__(
        self, system: MechanicalSystem, matrices: SaddlePoint, state: InitialState
    ) -> None:
        self._at = system, matrices, state.q, state.t
        self._start, v_start = system.start()
        self.dq, self.dv = state.q - self._start, state.v - v_start
        self.sigma_q = _project_position(system, matrices, self._start, state.t)[1]
        self.sigma_v = np.zeros(system.n_lam)
        if self.dv.any():
            force = -system.mass_times(state.q, self.dv)
            self.sigma_v = solve(self.factors, force, self.sigma_v)[1]

    @cached_property
    def factors(self) -> Factorization:
        """Factors of the matrix of step 2."""
        return _factor_mass(*self._at)

    @cached_property
    def moving(self) -> Factorization:
        """Factors of the differentiated matrix of step 1."""
        system, matrices, q, t = self._at
        if self.sigma_q.any() or (self.dq.any() and not system.traits.constant_mass):
            return _factor_position(system, matrices, self._start, q, self.sigma_q, t)
        return self.factors


class Covectors(NamedTuple):
    """Adjoint vectors: derivatives of a number in q, v, a, lam of the start, and directly in b."""

    q: Array
    v: Array
    a: Array
    lam: Array
    b: Array

    def plus(self, other: Covectors) -> Covectors:
        """Return the sum of these adjoint vectors and `other`."""
        return Covectors(*(x + y for x, y in zip(self, other, strict=True)))


@final
class AccelerationsAdjoint:
    """Transpose of the derivatives of a and lam in q, v and b at one time.

    With g_1 = M a + Phi_q^T lam - Q, g_2 = Phi_q a - gamma, and mu and zeta from the adjoint
    vectors of a and lam by a solve with the transposed matrix,

        on_q = -((g_1)_q^T mu + (g_2)_q^T zeta)     (g_2)_q = d^2Phi_q/dt^2
        on_v = -((g_1)_v^T mu + (g_2)_v^T zeta)     (g_2)_v = 2 dPhi_q/dt
        on_b = -((g_1)_b^T mu + (g_2)_b^T zeta).
    """

    def __init__(
        self, system: MechanicalSystem, factors: Factorization, state: InitialState
    ) -> None:
        self._system, self._factors, self.state = system, factors, state
        t, q, v, a, lam = state
        self._t, self._states = np.array([t]), (q[None], v[None], a[None], lam[None])
        self._local = system.linearise(self._t, *self._states)
        self._rate = system.constraint_q(t, q, v)
        self._second_rate = system.constraint_q(t, q, v, a)

    def pull_back(self, on_a: Array, on_lam: Array) -> tuple[Array, Array, Array]:
        """Return adjoint vectors of q, v, (n_q,), and b, (n_b,), from given ones of a and lam."""
        mu, zeta = solve_transposed(self._factors, on_a, on_lam)
        system, (t, q, v, a, lam) = self._system, self.state
        on_b = -system.pull_back(self._t, self._states, (mu[None], np.zeros_like(lam[None])))
        on_b = on_b - zeta @ system.constraint_total(t, (q, v, a))
        return *self._on_states(mu, zeta), on_b

    def matrices(self) -> tuple[Array, Array]:
        """Return the Jacobians (da/dq)^T and (da/dv)^T of the accelerations, (n_q, n_q) each."""
        n_q, n_lam = self._system.n_q, self._system.n_lam
        return self._on_states(
            *solve_transposed(self._factors, np.eye(n_q), np.zeros((n_lam, n_q)))
        )

    def _on_states(self, mu: Array, zeta: Array) -> tuple[Array, Array]:
        K, B = self._system.pattern.dot_transposed, self._system.constraint_pattern.dot_transposed
        on_q = -K(self._local.f_q[0], mu) - B(self._second_rate, zeta)
        on_v = -2 * B(self._rate, zeta)
        if self._local.f_v is not None:
            on_v = on_v - K(self._local.f_v[0], mu)
        return on_q, on_v


def pull_back_start(
    system: MechanicalSystem, matrices: SaddlePoint, state: InitialState, on: Covectors
) -> Array:
    """Return the design derivative of a number through the start, shape (n_b,).

    `on` are its adjoint vectors. This is the transpose of `start_sensitivity`, in reverse order:
    one transposed solve for each of steps 3, 2 and 1, independent of the number of design
    variables.
    """
    moves = _Moves(system, matrices, state)
    if type(system).start_pull_back is MechanicalSystem.start_pull_back:
        # Checks the derivatives of the start; the transpose below costs as many complex steps.
        _motion_sensitivity(system, state, moves)
    (t, q, v, *_), none = state, np.zeros(system.n_lam)
    K, B = system.pattern.dot_transposed, system.constraint_pattern.dot_transposed
    # 3., then 2.
    on_q, on_v, on_b = on.q, on.v, on.b
    if on.a.any() or on.lam.any():
        through = AccelerationsAdjoint(system, moves.factors, state).pull_back(on.a, on.lam)
        on_q, on_v, on_b = (x + y for x, y in zip((on_q, on_v, on_b), through, strict=True))
    m, z = solve_transposed(moves.factors, on_v, none)
    on_q = on_q - K(held_q(system, t, q, moves.dv, moves.sigma_v), m)
    on_b = on_b - held_pull_back(system, t, q, moves.dv, moves.sigma_v, m)
    if not system.traits.constant_constraints:
        on_q = on_q - B(system.constraint_q(t, q, v), z)
        on_b = on_b - z @ system.constraint_total(t, (q, v))
    on_v_start, q_start = system.mass_times(q, m), system.start()[0]
    # 1.
    m, z = solve_transposed(moves.moving, on_q, none)
    on_q_start = system.mass_times(q_start, m) - K(held_q(system, t, q_start, moves.dq, none), m)
    on_b = on_b - z @ system.constraint_total(t, (q,))
    on_b = on_b - held_pull_back(system, t, q_start, moves.dq, none, m)
    on_b = on_b - held_pull_back(system, t, q, 0 * q, moves.sigma_q, m)
    gradient: Array = on_b + system.start_pull_back(on_q_start, on_v_start)
    return gradient


def _factor_position(
    system: MechanicalSystem,
    matrices: SaddlePoint,
    q_start: Array,
    q: Array,
    sigma_q: Array,
    t: float,
) -> Factorization:
    K = system.mass(q_start)
    if not system.traits.linear_constraints:
        K = K + held_q(system, t, q, np.zeros_like(q), sigma_q)
    return matrices.factor(K, system.constraint_q(t, q))


def _factor_mass(
    system: MechanicalSystem, matrices: SaddlePoint, q: Array, t: float
) -> Factorization:
    try:
        return matrices.factor(system.mass(q), system.constraint_q(t, q))
    except SingularMatrix as error:
        raise InvalidInputError(
            "mass matrix",
            "with the constraints it must determine accelerations and multipliers at the start",
            str(error),
            "Give every coordinate inertia, or remove redundant constraints.",
        ) from error


def _project_position(
    system: MechanicalSystem, matrices: SaddlePoint, q_start: Array, t: float
) -> _Closed:
    """Return q, sigma_q of step 1 by Newton's method, and factors of M with Phi_q if computed.

    Where Newton's method does not converge, the gaps are closed in stages.
    """
    gap = system.constraint(t, q_start)
    if not gap.any():
        return q_start, np.zeros(system.n_lam, dtype=q_start.dtype), None
    for stages in _STAGES:
        reached: _Closed = q_start, np.zeros(system.n_lam, dtype=q_start.dtype), None
        for stage in range(1, stages + 1):
            left = gap * (1 - stage / stages)
            moved = _close_gap(system, matrices, q_start, t, reached[:2], left)
            if moved is None:
                break
            reached = moved
        else:
            return reached
    raise InconsistentStartError(
        "start",
        "must be close enough to the constraints to be projected",
        f"no convergence in {_PROJECTION_ITERATIONS} iterations",
        "Declare positions nearer to an assembled configuration.",
    )


def _close_gap(
    system: MechanicalSystem,
    matrices: SaddlePoint,
    q_start: Array,
    t: float,
    guess: tuple[Array, Array],
    left: Array,
) -> _Closed | None:
    """Solve step 1 with Phi = left by Newton's method from `guess`; None if it does not converge.

    The last correction is applied, so the remaining error is the square of the tolerance.
    """
    q, sigma_q = guess
    scale, settled = norm(q_start, system.weights), 0
    for _ in range(_PROJECTION_ITERATIONS):
        force = system.mass_times(q_start, q_start - q) - reaction(system, t, q, sigma_q)
        try:
            factors = _factor_position(system, matrices, q_start, q, sigma_q, t)
        except SingularMatrix:
            refuse_redundant(system, matrices, system.constraint_q(t, q))
            break
        dq, change = solve(factors, force, left - system.constraint(t, q))
        q, sigma_q = q + dq, sigma_q + change
        if not finite(q):
            break
        if norm(dq, system.weights) <= _CLOSED * scale:
            # A complex perturbation lags the real part by one sweep.
            settled += 1
            if q.dtype.kind != "c" or settled == 3:
                linear = system.traits.linear_constraints and system.traits.constant_mass
                return q, sigma_q, factors if linear else None
    return None


def _refuse_inconsistent(system: MechanicalSystem, q: Array, v: Array, t: float) -> None:
    """Raise InconsistentStartError if the declared start violates a constraint beyond round-off.

    |Phi_k| / |Phi_qk| is the distance to the constraint; it is measured against |q|, and likewise
    |Phi_q v - nu| / |Phi_qk| against |v|, all in the norm of the weights. Both ratios are free of
    units. A driver that starts at rest gives speeds a size, too: sqrt(|q| |q''|) of the
    accelerations
    that it prescribes.
    """
    pattern, values = system.constraint_pattern, system.constraint_q(t, q)
    squared = values.real**2 / system.weights[pattern.columns]
    rows = np.sqrt(np.bincount(pattern.rows, squared, minlength=system.n_lam))
    rows = np.where(rows > 0, rows, 1.0)
    place, phi_rate = norm(q, system.weights), system.constraint(t, q, v)
    speed = norm(v, system.weights)
    if np.any(np.abs(phi_rate) > _CONSISTENT * speed * rows) or np.iscomplexobj(phi_rate):
        asked = np.max(np.abs(acceleration_side(system, t, q, v).real) / rows, initial=0.0)
        speed = max(speed, float(np.sqrt(place * asked)))
    # The size of a body is as good a measure of its coordinates as their distance from the
    # origin; |q| in the norm of M contains both.
    for what, phi, size in (
        ("positions", system.constraint(t, q), place),
        ("velocities", phi_rate, speed),
    ):
        ratio = np.abs(phi.real) / rows
        if system.n_lam and np.any(ratio > _CONSISTENT * size):
            worst = int(np.argmax(ratio))
            raise InconsistentStartError(
                f"start, joint {system.constraint_names[worst]!r}",
                f"the {what} must satisfy the joint",
                f"a violation of {float(np.abs(phi[worst])):.3g}",
                "Correct the start, or set project_start=True to move it onto the joints.",
            )
        derived = type(system).start_pull_back is MechanicalSystem.start_pull_back
        if not (derived and np.iscomplexobj(system.b) and np.iscomplexobj(phi)):
            continue
        # A complex step: the imaginary part is a derivative along the imaginary part of b.
        moved = np.flatnonzero(system.b.imag)
        ratio = np.abs(phi.imag) / rows
        rate = np.max(np.abs(system.b.imag / np.where(system.b.real == 0, 1.0, system.b.real)))
        if system.n_lam and np.any(ratio > _SAME_RATE * rate * size):
            names = " and ".join(repr(system.design_names[i]) for i in moved)
            raise InconsistentStartError(
                f"start, design variable {names}",
                f"the {what} must satisfy the constraints at every design",
                "a complex step that violates them",
                _REPAIR,
            )
