"""The search for an equilibrium: along a path of loads, or by pseudo-transient continuation.

A mechanism restrained by its weight alone, such as a pendulum that starts level, has no stiffness
at s = 0 and no path that begins there. Under the full load, pseudo-transient continuation
integrates M_0 q' = Q - Phi_q^T lam in implicit steps 1/mu, which grow until mu vanishes and
Newton's method at mu = 0 remains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import final

import numpy as np

from ancfdae.equations.saddle_points import solve
from ancfdae.errors.kinds import SingularMatrix
from ancfdae.errors.outcomes import Verdict
from ancfdae.errors.text import listed
from ancfdae.numerics.arrays import Array
from ancfdae.statics.balance import Balance, Balanced, Unsolved
from ancfdae.statics.controlled import Steady
from ancfdae.statics.outcome import EquilibriumOutcome, FreeMotionError, free_mechanism
from ancfdae.statics.softness import Softness, softest

# Least step of the load factor s; on a path that closes gaps of joints relative to s, and at least
# its square: a thin wire slackens within such a small part of the path.
_LEAST = 1e-6
# A step is followed by a larger one if Newton's method took at most this many iterations.
_EASY = 6
# On one smooth path the secant of a step is the mean of its tangents up to _BEND times the secant,
# and the tangents differ by at most the smaller one. Else it may have jumped to another path.
_BEND = 0.25
# The load has a limit point if |dq/ds| exceeds _FASTER times its smallest value: q moves with the
# root of the remaining load.
_FASTER = 20.0
# A loss of stability is accepted if the step is no larger than this; else the step is divided.
_SMALL = 1.0 / 128.0


@final
@dataclass(frozen=True)
class PathPoint:
    """A point of the load path with its derivatives in the load factor s.

    It is `stable` if no motion has a negative stiffness, as where K is known to be `definite`.
    """

    s: float
    q: Array
    lam: Array
    q_s: Array
    lam_s: Array
    stable: bool
    definite: bool = False


@final
class LoadPath:
    """Follows the path of equilibria from s = 0 to s = 1 in at most `max_steps` attempted steps.

    `places` are the converged points, the start first; `residual` is the norm of the last
    correction of the last failure. A `fine` path takes smaller steps near s = 0.
    """

    def __init__(
        self, balance: Balance, first: PathPoint, max_steps: int, fine: bool = False
    ) -> None:
        self._balance, self._max_steps, self._fine = balance, max_steps, fine
        self.places, self.residual = [first], 0.0
        # A solution that was rejected because it may lie on another path.
        self._beyond: tuple[PathPoint, Balanced] | None = None

    def follow(self) -> Verdict:
        """Follow the path to its end; return the reason for which it ends."""
        size, verdict = 1.0, Verdict.EQUILIBRIUM
        try:
            for _ in range(self._max_steps):
                before = self.places[-1]
                s = 1.0 if before.s + size > 1.0 - 0.1 * size else before.s + size
                attempt = self._attempt(s)
                if isinstance(attempt, Unsolved):
                    self._balance.work.rejected += 1
                    verdict, self.residual = attempt.verdict, attempt.residual
                    size = 0.5 * (s - before.s)
                    if size < _LEAST * (max(before.s, _LEAST) if self._fine else 1.0):
                        speeds = [self._balance.length(place.q_s) for place in self.places]
                        ran_away = speeds[-1] > _FASTER * min(speeds)
                        return Verdict.LIMIT_POINT if ran_away else verdict
                    continue
                self._balance.work.steps += 1
                place, iterations = attempt
                self.places.append(place)
                if s == 1.0:
                    return Verdict.EQUILIBRIUM
                size = (2.0 if iterations <= _EASY else 1.0) * (s - before.s)
        except KeyboardInterrupt:
            return Verdict.INTERRUPTED
        return Verdict.STEP_LIMIT

    def stable_to(self) -> float | None:
        """Return the load factor of the last stable point, None if that is the last point."""
        stable = [place.s for place in self.places if place.stable]
        if stable and stable[-1] == self.places[-1].s:
            return None
        return stable[-1] if stable else 0.0

    def _attempt(self, s: float) -> tuple[PathPoint, int] | Unsolved:
        """Solve at s from the extrapolated path; return the point if it lies on the same path."""
        before, balance, known = self.places[-1], self._balance, self._beyond
        if known is not None and known[0].s == s and not self._jumped(before, known[0]):
            place, point = known
        else:
            found = balance.solve(s, *self._extrapolated(s))
            if isinstance(found, Unsolved):
                return found
            # Stability is computed later, for points on the path only.
            point, place = found, PathPoint(s, found.q, found.lam, *found.path, stable=False)
            if self._jumped(before, place):
                self._beyond = place, point
                return Unsolved(Verdict.NO_CONVERGENCE, 0.0)
        if balance.folds(before.q, place.q):
            return Unsolved(Verdict.FOLDED, 0.0)
        unjudged = point.definite or not balance.judges
        soft = None if unjudged else softest(balance, s, place.q, place.lam)
        definite = point.definite or (soft is not None and soft.definite)
        stable = soft is None or soft.stable
        if stable != before.stable and s - before.s > _SMALL:
            return Unsolved(Verdict.NO_CONVERGENCE, 0.0)
        return replace(place, stable=stable, definite=definite), point.iterations

    def _jumped(self, a: PathPoint, b: PathPoint) -> bool:
        """Return whether two points do not lie on one smooth path."""
        length, secant, ds = self._balance.length, b.q - a.q, b.s - a.s
        bend = length(secant - (0.5 * ds) * (a.q_s + b.q_s))
        # A bend that is round-off of the coordinates does not count.
        if bend <= 1e-9 * self._balance.position:
            return False
        slower = min(length(a.q_s), length(b.q_s))
        return bend > _BEND * length(secant) or length(b.q_s - a.q_s) > slower

    def _extrapolated(self, s: float) -> tuple[Array, Array]:
        """Return q and lam at s by a cubic through the last two points and their tangents.

        From the start alone the tangent is used.
        """
        b = self.places[-1]
        if len(self.places) == 1:
            return b.q + (s - b.s) * b.q_s, b.lam + (s - b.s) * b.lam_s
        a = self.places[-2]
        h, x = b.s - a.s, (s - b.s) / (b.s - a.s)
        w_a, w_b = x * x * (3 + 2 * x), (1 + x) ** 2 * (1 - 2 * x)
        d_a, d_b = h * x * x * (1 + x), h * x * (1 + x) ** 2
        q = w_a * a.q + w_b * b.q + d_a * a.q_s + d_b * b.q_s
        return q, w_a * a.lam + w_b * b.lam + d_a * a.lam_s + d_b * b.lam_s


# The first step of pseudo-transient continuation moves by about _FIRST times the system's size.
_FIRST = 0.1
# The search has settled if a step moves by at most _SETTLED times the system's size and its term in
# mu balances at most _HELD times the load; it has diverged if it is _GONE times the size away.
_SETTLED, _HELD, _GONE = 1e-10, 1e-6, 100.0
# Most failures in a row; mu has grown by 4^30 then.
_FAILURES = 30


@final
class Settling:
    """Pseudo-transient continuation under the full load; q and lam are the state reached.

    Constraints that are violated at the start close in one step, or in several smaller parts if
    that step fails or folds an element; the balance may leave them open. `steps` steps have
    converged, the last one of the norm `residual`; `gone` is whether the motion grew without bound.
    """

    def __init__(self, balance: Balance, max_steps: int) -> None:
        self._balance, self._max_steps = balance, max_steps
        self.q, self.lam = balance.q_0, balance.lam_0
        self.steps, self.residual, self.gone = 0, 0.0, False

    def run(self) -> Verdict:
        """Search by pseudo-transient continuation; return how the search ended."""
        try:
            return self._run()
        except KeyboardInterrupt:
            return Verdict.INTERRUPTED

    def _run(self) -> Verdict:
        balance, mu, failures = self._balance, self._first_mu(), 0
        closes = balance.closes
        left, closed = 1.0, float(closes)
        for _ in range(self._max_steps):
            gap = max(0.0, left - closed)
            solved = balance.solve(1.0, self.q, self.lam, mu, self.q, gap)
            if isinstance(solved, Balanced) and balance.folds(self.q, solved.q):
                solved = Unsolved(Verdict.FOLDED, 0.0)
            if isinstance(solved, Unsolved):
                balance.work.rejected += 1
                self.residual, failures, mu = solved.residual, failures + 1, 4.0 * mu
                closed *= 0.25
                if failures > _FAILURES:
                    return solved.verdict
                continue
            moved, held = self._share(solved.q - self.q), self._held(mu, solved.q - self.q)
            if moved > _SETTLED and not (
                solved.definite
                or not balance.judges
                or softest(balance, 1.0, solved.q, solved.lam, mu).stable
            ):
                # K + mu M_0 is not positive definite: so long a step may increase the energy.
                balance.work.rejected += 1
                mu *= 4.0
                continue
            balance.work.steps += 1
            self.steps += 1
            self.q, self.lam, self.residual, failures = solved.q, solved.lam, moved, 0
            if self._share(self.q - balance.q_0) > _GONE:
                self.gone = True
                return Verdict.NO_CONVERGENCE
            left, closed = gap, 2.0 * closed
            if moved <= _SETTLED and held <= _HELD and not (left and closes):
                return Verdict.EQUILIBRIUM
            mu /= 8.0 if solved.iterations <= _EASY else 2.0
        return Verdict.STEP_LIMIT

    def _held(self, mu: float, dq: Array) -> float:
        """Return |mu M_0 dq| over the load: the fraction that the step leaves unbalanced."""
        b = self._balance
        return b.strength(mu * b.system.pattern.dot(b.M_0, dq)) / b.load

    def _share(self, dq: Array) -> float:
        return self._balance.length(dq) / self._balance.extent

    def _first_mu(self) -> float:
        """Return mu with which the first step moves the system by a tenth of its size."""
        b = self._balance
        force = b.held_back(b.q_0)
        try:
            a = solve(b.factor(b.M_0, b.Phi_q(b.q_0)), force, 0 * b.Phi_0)[0]
        except SingularMatrix:
            a = force / b.system.weights
        # Without acceleration any positive mu will do.
        return b.length(a) / (_FIRST * b.extent) or 1.0


# -- the search --------------------------------------------------------------------------------


# Part of a free motion in states of controllers above which it is theirs.
_MAINLY = 0.7
# Reasons for which a path ends that do not show that the load is too large.
_FAILED = (Verdict.NO_CONVERGENCE, Verdict.NOT_FINITE, Verdict.SINGULAR, Verdict.FOLDED)

# Motions with a stiffness kappa below _SOFT may be neutral. A step along one, of _STEP times the
# size of the system and with a term in mu of _PUSH times the load, moves by at least _MOVED times
# itself, and a second one by at most _STAYS times the first if restoring forces are below 1e-8 of
# the load; otherwise the system moves back by a tenth and more.
_SOFT, _STEP, _PUSH, _MOVED, _STAYS = 1e-5, 0.05, 1e-3, 0.01, 1e-5


@final
@dataclass(frozen=True)
class SearchEnd:
    """The state at which a search ends, and whether K is known to be positive definite there."""

    q: Array
    lam: Array
    outcome: EquilibriumOutcome
    definite: bool = False


def search(balance: Balance, max_steps: int) -> SearchEnd:
    """Follow the path of loads; if none begins or it fails, use pseudo-transient continuation.

    Where constraints are violated at the start, a path on which they close under the full load is
    tried in between. Raises FreeMotionError if nothing restrains a motion.
    """
    first, start = balance.begun(), None
    if not balance.judges:
        return _unjudged(balance, first, max_steps)
    if isinstance(first, Unsolved) or not first.definite:
        start = softest(balance, 0.0, balance.q_0, balance.lam_0)
        if not (start.definite or (start.stable and not start.free.shape[1])):
            settled = _settled(balance, start, max_steps)
            if settled.outcome.success or settled.outcome.verdict is Verdict.INTERRUPTED:
                return settled
            return _closed(balance, None, max_steps) or settled
    followed = _followed(balance, first, True, max_steps)
    outcome = followed.outcome
    if (outcome.stable_to is not None or not outcome.success) and balance.gyroscopic:
        followed = _nearer(balance, followed, max_steps)
    outcome = followed.outcome
    if outcome.verdict in (*_FAILED, Verdict.LIMIT_POINT) or outcome.stable_to is not None:
        closed = _closed(balance, first, max_steps)
        if closed is not None:
            return closed
    if outcome.verdict not in _FAILED:
        return followed
    settled = _settled(balance, start, max_steps)
    return settled if settled.outcome.success else followed


def _unjudged(balance: Balance, first: Balanced | Unsolved, max_steps: int) -> SearchEnd:
    """Return the end of a path of loads, or else of a descent, without regard to stability.

    Raises FreeMotionError if a motion has no stiffness at the end.
    """
    end = _followed(balance, first, True, max_steps)
    if not (end.outcome.success or end.outcome.verdict is Verdict.INTERRUPTED):
        downhill = Settling(balance, max_steps)
        verdict = downhill.run()
        outcome = EquilibriumOutcome(
            verdict,
            float(verdict is Verdict.EQUILIBRIUM),
            downhill.steps,
            downhill.residual,
            downhill=True,
        )
        end = SearchEnd(downhill.q, downhill.lam, outcome)
        end = _polished(balance, end) if outcome.success else end
    # Where the search fails, a motion that is free at its start explains it.
    at = (end.q, end.lam) if end.outcome.success else (balance.q_0, balance.lam_0)
    free = softest(balance, 1.0, *at).free
    if free.shape[1]:
        _refuse_free_states(balance, free)
        raise free_mechanism(balance.system.naming, at[0].real, free)
    return end


def _refuse_free_states(balance: Balance, free: Array) -> None:
    """Raise FreeMotionError that names controllers if mainly their states are free, (n_q, k)."""
    system = balance.system
    parts = np.sqrt(system.weights)[:, None] * free
    of_states = np.linalg.norm(parts[system.state_places]) / np.linalg.norm(parts)
    if isinstance(system, Steady) and of_states > _MAINLY:
        raise FreeMotionError(
            "equilibrium",
            "every state of a controller must have one value at rest",
            f"states of {listed(map(repr, system.base.controllers))} of which no force at rest "
            "depends, or that no rate determines",
            "Leave the state out, as of a PID without integral gain, or simulate the motion.",
        )


def _closed(
    balance: Balance, start: Balanced | Unsolved | None, max_steps: int
) -> SearchEnd | None:
    """Return the end of two paths: the loads grow, then the violated constraints close.

    A wire whose supports are too near to each other is taut under its weight at first and slackens
    as they approach; at s = 0 of one path for both it would buckle. Without a start that has
    stiffness, as of two wires in line, pseudo-transient continuation replaces the first path. None
    where no constraint is violated, or the paths lead to no stable equilibrium.
    """
    if not np.any(balance.Phi_0):
        return None
    open_gaps = replace(balance, closes=False)
    if start is None:
        downhill = Settling(open_gaps, max_steps)
        verdict = downhill.run()
        outcome = EquilibriumOutcome(verdict, 1.0, downhill.steps, downhill.residual)
        loaded = SearchEnd(downhill.q, downhill.lam, outcome)
    else:
        loaded = _path_end(open_gaps, start, True, max_steps, fine=True)
    if not loaded.outcome.success:
        return loaded if loaded.outcome.verdict is Verdict.INTERRUPTED else None
    start_of = replace(balance, q_0=loaded.q, lam_0=loaded.lam, follows=False)
    stable = loaded.outcome.stable_to is None
    end = _path_end(start_of, start_of.begun(), stable, max_steps, fine=True)
    both = end.outcome.step + loaded.outcome.step
    end = replace(end, outcome=replace(end.outcome, step=both))
    if end.outcome.success and end.outcome.stable_to is None:
        end = _polished(balance, end)
        return end if end.outcome.success else None
    return end if end.outcome.verdict is Verdict.INTERRUPTED else None


def _nearer(balance: Balance, followed: SearchEnd, max_steps: int) -> SearchEnd:
    """Return an equilibrium nearer to the start than `followed`, whose path lost its stability.

    Above a critical speed a shaft rotates about its axis of inertia. No path from rest leads there;
    one with the full centrifugal stiffness from the beginning does. Its end is not checked for
    stability: far above that speed the negative stiffness is not among the lowest.
    """
    unbound = replace(balance, follows=False)
    other = _followed(unbound, unbound.begun(), False, max_steps)
    far, near = (balance.length(end.q - balance.q_0) for end in (followed, other))
    if other.outcome.success and (near < far or not followed.outcome.success):
        return replace(other, outcome=replace(other.outcome, stable_to=0.0))
    return followed


def _followed(
    balance: Balance, start: Balanced | Unsolved, stable: bool, max_steps: int
) -> SearchEnd:
    end = _path_end(balance, start, stable, max_steps)
    return _polished(balance, end) if end.outcome.success else end


def _path_end(
    balance: Balance,
    start: Balanced | Unsolved,
    stable: bool,
    max_steps: int,
    fine: bool = False,
) -> SearchEnd:
    """Return the end of a load path, which is not refined to round-off yet."""
    if isinstance(start, Unsolved):
        outcome = EquilibriumOutcome(start.verdict, 0.0, 0, 0.0)
        return SearchEnd(balance.q_0, balance.lam_0, outcome)
    first = PathPoint(0.0, start.q, start.lam, *start.path, stable)
    path = LoadPath(balance, first, max_steps, fine)
    verdict, last = path.follow(), path.places[-1]
    outcome = EquilibriumOutcome(
        verdict, last.s, len(path.places) - 1, path.residual, path.stable_to()
    )
    return SearchEnd(last.q, last.lam, outcome, last.definite)


def _polished(balance: Balance, end: SearchEnd) -> SearchEnd:
    """Return the end refined to round-off, or the state with the reason for which that failed."""
    exact = balance.polished(end.q, end.lam)
    if isinstance(exact, Unsolved):
        outcome = replace(end.outcome, verdict=exact.verdict, residual=exact.residual)
        return replace(end, outcome=outcome)
    q, lam, correction = exact
    folded = balance.system.folded(q)
    verdict = Verdict.FOLDED if folded else end.outcome.verdict
    outcome = replace(end.outcome, verdict=verdict, residual=correction, folded=folded)
    return SearchEnd(q, lam, outcome, end.definite)


def _settled(balance: Balance, start: Softness | None, max_steps: int) -> SearchEnd:
    downhill = Settling(balance, max_steps)
    verdict = downhill.run()
    q, lam, steps, residual = downhill.q, downhill.lam, downhill.steps, downhill.residual
    if downhill.gone and start and start.free.shape[1]:
        raise free_mechanism(balance.system.naming, balance.q_0, start.free)
    if verdict is Verdict.INTERRUPTED:
        return SearchEnd(q, lam, EquilibriumOutcome(verdict, 0.0, steps, residual, downhill=True))
    end = softest(balance, 1.0, q, lam)
    free = _neutral(
        balance, SearchEnd(q, lam, EquilibriumOutcome(verdict, 1.0, steps, residual)), end
    )
    if free.shape[1]:
        raise free_mechanism(balance.system.naming, q, free)
    if verdict is not Verdict.EQUILIBRIUM:
        return SearchEnd(q, lam, EquilibriumOutcome(verdict, 0.0, steps, residual, downhill=True))
    # If the start has full stiffness, a motion without stiffness here belongs to a critical load.
    if end.free.shape[1] and start:
        raise free_mechanism(balance.system.naming, q, end.free)
    solved = balance.solve(1.0, q, lam)
    if isinstance(solved, Unsolved):
        outcome = EquilibriumOutcome(solved.verdict, 0.0, steps, solved.residual, downhill=True)
        return SearchEnd(q, lam, outcome)
    stable_to = None if end.stable else 0.0
    outcome = EquilibriumOutcome(verdict, 1.0, steps, solved.correction, stable_to, downhill=True)
    return _polished(balance, SearchEnd(solved.q, solved.lam, outcome))


def _neutral(balance: Balance, at: SearchEnd, soft: Softness) -> Array:
    """Return the softest motions along which there is a family of equilibria, shape (n_q, k).

    Such a motion, as the spin of a rod that hangs by its ends, has a stiffness of round-off, of
    either sign. A step along it with a small mu ends at another equilibrium if a second step from
    there does not move; at a critical load, or with a soft spring, it moves back.
    """
    found = []
    for kappa, motion in zip(soft.kappa, soft.motions.T, strict=True):
        if kappa > _SOFT:
            break
        step = (_STEP * balance.extent / balance.length(motion)) * motion
        inertia = balance.strength(balance.system.pattern.dot(balance.M_0, step))
        mu, q, lam = _PUSH * balance.load / inertia, at.q, at.lam
        places, anchor = [q], q + step
        for _ in range(2):
            solved = balance.solve(1.0, anchor, lam, mu, anchor)
            if isinstance(solved, Unsolved):
                break
            places, anchor, lam = [*places, solved.q], solved.q, solved.lam
        if len(places) == 3:
            far, back = (balance.length(b - a) for a, b in pairwise(places))
            if far > _MOVED * balance.length(step) and back <= _STAYS * far:
                found.append(motion)
    return np.array(found).reshape(len(found), len(at.q)).T
