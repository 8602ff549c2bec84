"""Equations of equilibrium on the way to the full load, and Newton's method for them.

The kernel (`rest.h`) has the same method for assembled systems.

    Q(q) - Phi_q^T lam - mu M_0 (q - q_a) = (1 - s) (r_0 + P(q)),     Phi(q) = (1 - s) Phi_0

P are the follower loads; r_0 = Q - Phi_q^T lam - P and Phi_0 are the other unbalanced forces and
the violated constraints at the start of the search, so that the start solves the equations at s =
0. If the start is free of stress, s is the load factor. The term in mu is an implicit step of the
motion without inertia, M_0 q' = Q - Phi_q^T lam, from q_a.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.plans import Plan
from ancfdae.equations.saddle_points import Prepared, saddle_point, solve, velocity_side
from ancfdae.errors.kinds import InvalidInputError, SingularMatrix
from ancfdae.errors.outcomes import Verdict
from ancfdae.kernels import RULES, Rest, finite, norm
from ancfdae.numerics.arrays import Array, only
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.statics.controlled import Steady

# K is positive definite for certain if its factorisation succeeds with the diagonal reduced by this
# fraction of itself.
_CLEAR = 1e-13


class RestStart(NamedTuple):
    """Constants of a search: start, unbalanced forces there, scales, limits of Newton's method."""

    q_0: Array
    r_0: Array
    Phi_0: Array
    position: float
    load: float
    tolerance: float
    far: float
    growths: int


class RestEnd(NamedTuple):
    """End of a search in the kernel: state, reason, and for a solution the path (dq/ds, dlam/ds).

    Where corrections have stopped shrinking, `path` holds the last correction instead.
    """

    why: Rest
    q: Array
    lam: Array
    path: tuple[Array, Array]
    iterations: int
    correction: float
    definite: bool


@final
class CompiledRest:
    """Newton's method for the equilibrium of one system at one time, in the kernel.

    `follows` says whether follower loads are scaled along the path; see `Balance`.
    """

    def __init__(
        self,
        system: MechanicalSystem,
        matrices: SaddlePoint,
        t: float,
        known: RestStart,
        follows: bool,
    ) -> None:
        dtype = np.result_type(known.q_0, system.b, float)
        self._kernel = Prepared(system, matrices, np.zeros(RULES), dtype)
        self._known, instant, plan = known, np.array([t]), self._kernel.plan
        of = plan.joint_factors
        self._of_joints = np.ones(1) if of is None else np.array(of(instant, 1)[0, 0])
        self._of_loads = plan.load_factors(instant)[0]
        turning = self._of_loads * plan.turning if isinstance(plan, Plan) else np.ones(1)
        self._turning = turning * float(follows)

    def solve(
        self,
        s: float,
        q: Array,
        lam: Array,
        gaps: tuple[float, float],
        mu: float,
        anchor: Array | None,
        iterations: int,
    ) -> RestEnd:
        """Solve at s from the guess q, lam; with no iterations the state is only linearised.

        `gaps` are the fraction of Phi_0 that remains, and its decrease per unit of s.
        """
        known, acting = self._known, self._of_loads
        if isinstance(self._kernel.plan, Plan):
            acting = acting - (1.0 - s) * self._turning
        dtype = self._kernel.dtype
        state = tuple(np.array(x, dtype=dtype) for x in (q, lam, q, lam))
        rules = np.array([s, mu, *gaps, *known[3:], iterations, _CLEAR])
        given = known.q_0, anchor, known.r_0, known.Phi_0
        with np.errstate(all="ignore"):
            why, count, size, definite = self._kernel.model.rest(
                state, given, (self._of_joints, acting, self._turning), rules
            )
        if why == Rest.INDEFINITE:
            self._kernel.add_band()
            return self.solve(s, q, lam, gaps, mu, anchor, iterations)
        q, lam, *path = state
        return RestEnd(Rest(why), q, lam, (path[0], path[1]), count, size, bool(definite))


# -- equations ---------------------------------------------------------------------------------


# Estimated error after the last iteration, relative to positions and to forces: near round-off.
_TOLERANCE = 1e-13
_ITERATIONS = 25
# Most roundings in a sum of forces, with a margin.
_ROUNDINGS = 64
_EPS = float(np.finfo(float).eps)
# Convergence is measured against a load of at least _SEEN times the round-off of forces.
_SEEN = 1e7
# Number of samples of the round-off of forces, and margin over the largest of them.
_SAMPLES = 8
# Newton's method has diverged if a correction exceeds _FAR times the size of the start, or if
# corrections have grown _GROWTHS times.
_FAR, _GROWTHS = 100.0, 4


@final
@dataclass
class SearchCounts:
    """Counters of the cost of a search for an equilibrium."""

    iterations: int = 0
    factorisations: int = 0
    residuals: int = 0
    steps: int = 0
    rejected: int = 0


@final
@dataclass(frozen=True)
class Balanced:
    """An equilibrium at the load factor s, dq/ds and dlam/ds there, and the last correction.

    `definite` is True if K is known to be positive definite; if False, stability must be checked.
    """

    s: float
    q: Array
    lam: Array
    path: tuple[Array, Array]
    iterations: int = 0
    correction: float = 0.0
    definite: bool = False


@final
@dataclass(frozen=True)
class Unsolved:
    """Why Newton's method found no equilibrium, and the relative size of its last correction."""

    verdict: Verdict
    residual: float


@final
@dataclass(frozen=True)
class Balance:
    """The equations of one search, which starts at q_0 and lam_0; symbols as in the module.

    Unless it `follows`, P is zero: follower loads act in full, and the unbalanced forces at the
    start are removed as constants. Unless it `closes` them, constraints stay as violated as at the
    start: Phi = Phi_0 for all s. Where it `judges`, a search keeps to states without negative
    stiffness; with controllers the loop decides, not the stiffness.
    """

    system: MechanicalSystem
    t: float
    q_0: Array
    lam_0: Array
    work: SearchCounts = field(default_factory=SearchCounts)
    follows: bool = True
    closes: bool = True
    judges: bool = True

    @staticmethod
    def of(
        system: MechanicalSystem, t: float, q_0: Array, lam_0: Array, follows: bool = True
    ) -> Balance:
        """Return the equations of a search from q_0, lam_0, after checking the start.

        Raises InvalidInputError if start or forces are not finite, RedundantConstraintsError if
        constraints are linearly dependent.
        """
        judges = not isinstance(system, Steady)
        balance = Balance(system, t, q_0, lam_0, follows=follows, judges=judges)
        with np.errstate(all="ignore"):
            good = all(finite(x) for x in (q_0, balance.r_0, balance.Phi_0))
        if not good:
            raise InvalidInputError(
                "start of the equilibrium",
                "coordinates and forces must be finite",
                "NaN or infinity",
                "Check start and forces.",
            )
        return balance

    @cached_property
    def r_0(self) -> Array:
        """Unbalanced forces at the start without follower loads, shape (n_q,)."""
        return self.unbalanced(self.q_0, self.lam_0) - self._following(self.q_0)[0]

    @cached_property
    def Phi_0(self) -> Array:
        """Values of the constraints at the start, shape (n_lam,)."""
        return self.system.constraint(self.t, self.q_0)

    @cached_property
    def M_0(self) -> Array:
        """Entries of the mass matrix at the start on the pattern of the system, (nnz,)."""
        return self.system.mass(self.q_0)

    @cached_property
    def gyroscopic(self) -> bool:
        """Whether there are gyroscopic forces, which do no work, as in a rotating frame."""
        rest = np.zeros((1, self.system.n_q))
        states = self.q_0.real[None], rest, rest, self.lam_0.real[None]
        f_v = self.system.linearise(np.array([self.t]), *states).f_v
        if f_v is None:
            return False
        D = self.system.pattern.csr(f_v[0].real)
        return bool(abs(D - D.T).max() > _ROUNDINGS * _EPS * abs(D).max())

    @cached_property
    def matrices(self) -> SaddlePoint:
        """Saddle-point matrices of K and Phi_q, with scales from the start."""
        return saddle_point(self.system, self.t, self.q_0)

    def Phi_q(self, q: Array) -> Array:
        """Return the constraint Jacobian at q, entries on its pattern, (nnz,)."""
        return self.system.constraint_q(self.t, q)

    def reactions(self, Phi_q: Array, lam: Array) -> Array:
        """Return the reactions Phi_q^T lam from entries of Phi_q, shape (n_q,)."""
        return self.system.constraint_pattern.dot_transposed(Phi_q, lam)

    def unbalanced(self, q: Array, lam: Array, Phi_q: Array | None = None) -> Array:
        """Return the unbalanced forces Q - Phi_q^T lam at zero velocity, shape (n_q,)."""
        Q = self.system.force(self.t, q, np.zeros_like(q))
        return Q - self.reactions(self.Phi_q(q) if Phi_q is None else Phi_q, lam)

    def held_back(self, q: Array) -> Array:
        """Return the forces r_0 + P(q) that the equations at s = 0 leave out, shape (n_q,)."""
        return self.r_0 + self._following(q)[0]

    def _following(self, q: Array) -> tuple[Array, Array]:
        if self.follows:
            return self.system.following_load(self.t, q)
        return np.zeros_like(q), np.zeros(self.system.pattern.size)

    def tangent(self, s: float, q: Array, lam: Array) -> Array:
        """Return the tangent stiffness K = -dQ/dq + d(Phi_q^T lam)/dq on its pattern, (nnz,)."""
        rest = np.zeros((1, len(q)))
        K = only(self.system.linearise(np.array([self.t]), q[None], rest, rest, lam[None]).f_q)
        if s < 1.0:
            K = K + (1.0 - s) * self._following(q)[1]
        return K

    def factor(self, K: Array, Phi_q: Array) -> Factorization:
        """Return the factors of [K, Phi_q^T; Phi_q, 0]; raises SingularMatrix."""
        self.work.factorisations += 1
        return self.matrices.factor(K, Phi_q)

    @cached_property
    def _kernel(self) -> CompiledRest:
        sizes = self.position, self.load, _TOLERANCE, _FAR, _GROWTHS
        known = RestStart(self.q_0, self.r_0, self.Phi_0, *sizes)
        return CompiledRest(self.system, self.matrices, self.t, known, self.follows)

    def begun(self) -> Balanced | Unsolved:
        """Return the start as a solution at load factor 0, with the derivatives of its path."""
        return self._at(0.0, self.q_0, self.lam_0, 1.0)

    def _at(
        self,
        s: float,
        q: Array,
        lam: Array,
        gap: float,
        mu: float = 0.0,
        anchor: Array | None = None,
    ) -> Balanced | Unsolved:
        """Return a state that already solves the equations, with the derivatives of its path."""
        gaps = gap, float(self.closes)
        return self._counted(s, self._kernel.solve(s, q, lam, gaps, mu, anchor, 0))

    def solve(
        self,
        s: float,
        q: Array,
        lam: Array,
        mu: float = 0.0,
        anchor: Array | None = None,
        gap: float | None = None,
    ) -> Balanced | Unsolved:
        """Solve the equations by Newton's method from a guess q, lam; `anchor` is q_a.

        `gap` is the fraction of Phi_0 that remains, by default 1 - s, or 1 if gaps are not closed.
        Corrections that stop shrinking end at a solution if they are as small as round-off.
        """
        # The fraction of Phi_0 that remains at s.
        left = 1.0 - s if self.closes else 1.0
        left, taken = left if gap is None else gap, 0
        gaps = left, float(self.closes)
        while taken < _ITERATIONS:
            end = self._kernel.solve(s, q, lam, gaps, mu, anchor, _ITERATIONS - taken)
            solved = self._counted(s, end)
            if end.why not in (Rest.STUCK, Rest.NO_CONVERGENCE):
                return solved
            q, lam, taken = end.q, end.lam, taken + end.iterations
            before, Phi_q = q - end.path[0], self.Phi_q(q - end.path[0])
            R, _ = self._residual(s, before, lam - end.path[1], Phi_q, left, mu, anchor)
            K = self.tangent(s, before, lam - end.path[1])
            if self.is_round_off(R, K, q, lam, end.path[0]):
                found = self._at(s, q, lam, left, mu, anchor)
                if isinstance(found, Balanced):
                    return replace(found, iterations=taken, correction=end.correction)
                return found
            if end.why == Rest.NO_CONVERGENCE:
                return solved
        return Unsolved(Verdict.NO_CONVERGENCE, end.correction)

    def _counted(self, s: float, end: RestEnd) -> Balanced | Unsolved:
        self.work.iterations += end.iterations
        self.work.residuals += end.iterations
        self.work.factorisations += end.iterations + 1
        if end.why == Rest.SOLVED:
            return Balanced(s, *end[1:])
        verdicts = {Rest.NOT_FINITE: Verdict.NOT_FINITE, Rest.SINGULAR: Verdict.SINGULAR}
        return Unsolved(verdicts.get(end.why, Verdict.NO_CONVERGENCE), end.correction)

    def _residual(
        self,
        s: float,
        q: Array,
        lam: Array,
        Phi_q: Array,
        gap: float = 0.0,
        mu: float = 0.0,
        anchor: Array | None = None,
    ) -> tuple[Array, Array]:
        self.work.residuals += 1
        self.work.iterations += 1
        R = self.unbalanced(q, lam, Phi_q)
        if s < 1.0:
            R = R - (1.0 - s) * self.held_back(q)
        if anchor is not None:
            R = R - mu * self.system.pattern.dot(self.M_0, q - anchor)
        return R, self.system.constraint(self.t, q) - gap * self.Phi_0

    def polished(self, q: Array, lam: Array) -> tuple[Array, Array, float] | Unsolved:
        """Return q, lam of the full load refined to round-off, and the last correction.

        Corrections with one matrix, from a solution nearby, are added as long as they halve; the
        matrix of a thin or finely divided beam has few digits. If the remaining forces are more
        than round-off, the state is no solution.
        """
        K = self.tangent(1.0, q, lam)
        try:
            factors = self.factor(K, self.Phi_q(q))
        except SingularMatrix:
            return Unsolved(Verdict.SINGULAR, 0.0)
        sizes = np.full(2, np.inf)
        for _ in range(_ITERATIONS):
            R, Phi = self._residual(1.0, q, lam, self.Phi_q(q))
            dq, dlam = solve(factors, R, -Phi)
            # A complex step, far below the real part, is followed on its own.
            last, sizes = sizes, np.array([self.length(dq.real), self.length(dq.imag)])
            if not np.any(sizes < 0.5 * last):
                break
            q, lam = q + dq, lam + dlam
        size = float(sizes[0]) / self.extent
        if self.is_round_off(R, K, q, lam, dq):
            return q, lam, size
        return Unsolved(Verdict.NO_CONVERGENCE, size)

    def is_round_off(
        self, R: Array, K: Array, q: Array, lam: Array, dq: Array | None = None
    ) -> bool:
        """Return whether unbalanced forces R are round-off; dq is the correction for them.

        Coordinates carry eps |q|, which forces multiply by K, and their sums round; all terms by
        their magnitude. Actual round-off is a tenth of this bound (docs/measurements.md, "Modes").
        Where the bound is too small, as of a mass near the origin on a spring from afar, round-off
        is measured along parts of dq, if that is given.
        """
        system, pattern = self.system, self.system.pattern
        blur = pattern.dot(np.abs(K.real), np.abs(q.real))
        reactions = self.strength(self.reactions(self.Phi_q(q), lam))
        force = self.strength(system.force(self.t, q, np.zeros_like(q)))
        noise = max(system.traits.force_round_off, _EPS * self.strength(blur))
        left, least = self.strength(R.real), noise + _ROUNDINGS * _EPS * (force + reactions)
        if left <= least or dq is None:
            return left <= least
        # Bound for positions at the distance of the points that forces refer to, and of the size
        # of the system.
        size = np.full(len(q), self.extent / np.sqrt(np.sum(system.weights)) + system.reach)
        most = _ROUNDINGS * _EPS * self.strength(pattern.dot(np.abs(K.real), size))
        return left <= most and left <= _SAMPLES * self._irregular(
            K.real, q.real, lam.real, dq.real
        )

    def _irregular(self, K: Array, q: Array, lam: Array, dq: Array) -> float:
        """Return the size of force changes beyond K dq that random moves of the size of dq cause.

        Moves of twice the correction change the round-off of the forces; the curvature of the
        forces, which is of second order, is below it where Newton's method converges.
        """
        system, rng, sizes = self.system, np.random.default_rng(0), []
        here = self.unbalanced(q, lam)
        for _ in range(_SAMPLES):
            moved = q + 2.0 * rng.uniform(-1.0, 1.0, len(q)) * dq
            change = self.unbalanced(moved, lam) - here
            sizes.append(self.strength(change + system.pattern.dot(K, moved - q)))
        return max(sizes)

    def folds(self, before: Array, q: Array) -> bool:
        """Return whether elements are folded at q, and none was at `before`."""
        return bool(self.system.folded(q)) and not self.system.folded(before)

    def refuse_motion(self) -> None:
        """Raise InvalidInputError if a driver moves at time t: inertia forces would be missing.

        They matter if M v^2/|q|, v the velocities that the joints prescribe, is more than the
        round-off of forces.
        """
        system, q = self.system, self.q_0.real
        nu = velocity_side(system, self.t, q).real
        if not np.any(nu):
            return
        v = solve(self.factor(self.M_0.real, self.Phi_q(q)), np.zeros_like(q), nu)[0].real
        turning = self.length(v) ** 2 / self.extent
        forces = self.strength(self.unbalanced(q, nu * 0))
        if turning > max(system.traits.force_round_off, _EPS * forces):
            driven = sorted({system.constraint_names[int(i)] for i in np.flatnonzero(nu)})
            raise InvalidInputError(
                "equilibrium",
                f"driven joints must have zero velocity at t = {self.t:.6g}",
                f"a nonzero rate of {', '.join(map(repr, driven))}",
                "Start their laws at zero rate, or call simulate; declare a steady rotation in a "
                "RotatingFrame.",
            )

    # -- natural sizes -------------------------------------------------------------------------

    def length(self, dq: Array) -> float:
        """Return the norm of a change of coordinates, weighted by the coordinate weights."""
        return norm(dq, self.system.weights)

    @cached_property
    def position(self) -> float:
        """Scale of coordinates: their weighted norm about the mean, plus a term for round-off."""
        seen = 4.0 * _EPS / _TOLERANCE
        return self.length(self.system.centred(self.q_0)) + seen * self.length(self.q_0)

    @cached_property
    def extent(self) -> float:
        """Weighted norm of the coordinates about their mean; of the coordinates if that is zero."""
        size = self.length(self.system.centred(self.q_0))
        return size or self.length(self.q_0) or float(np.sqrt(np.sum(self.system.weights)))

    def strength(self, Q: Array) -> float:
        """Return the norm of generalised forces in the inverse coordinate weights."""
        return norm(Q, 1 / self.system.weights)

    @cached_property
    def load(self) -> float:
        """Norm of the load at the start; at least a multiple of the round-off of forces."""
        least = _SEEN * self.system.traits.force_round_off
        return max(self.strength(self.held_back(self.q_0)), least, float(np.finfo(float).tiny))
