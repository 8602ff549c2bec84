"""Which way a search for an equilibrium goes: along the path of loads, or downhill."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import final

import numpy as np

from ancfdae.errors.outcomes import Verdict
from ancfdae.numerics.arrays import Array
from ancfdae.statics.balance import Balance, Balanced, Unsolved
from ancfdae.statics.outcome import EquilibriumOutcome, free_mechanism
from ancfdae.statics.softness import Softness, softest
from ancfdae.statics.ways import LoadPath, PathPoint, Settling

# Endings of a path that say nothing about the load.
_FAILED = (Verdict.NO_CONVERGENCE, Verdict.NOT_FINITE, Verdict.SINGULAR, Verdict.FOLDED)

# Motions softer than this part of their diagonal may be neutral. A step of this part of the size of
# the system, held by this part of the load, gets so far and then stays to this part, if what drives
# it back is less than 1e-8 of the load; others come back by a tenth and more.
_SOFT, _STEP, _PUSH, _MOVED, _STAYS = 1e-5, 0.05, 1e-3, 0.01, 1e-5


@final
@dataclass(frozen=True)
class SearchEnd:
    """The state at which a search ends; whether K is known to be positive definite there."""

    q: Array
    lam: Array
    outcome: EquilibriumOutcome
    definite: bool = False


def search(balance: Balance, max_steps: int) -> SearchEnd:
    """Follow the path of loads; where none begins or it cannot be followed, settle.

    Where constraints are violated at the start, a path on which they close under the full load is
    tried in between. FreeMotionError if a motion is held by nothing.
    """
    first, start = balance.begun(), None
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


def _closed(
    balance: Balance, start: Balanced | Unsolved | None, max_steps: int
) -> SearchEnd | None:
    """Return where two paths lead: the loads grow, then constraints that are violated close.

    A wire whose supports are too near to each other is taut under its weight at first and slackens
    as they approach; at s = 0 of one path for both it would buckle. Without a start that has
    stiffness, as of two wires in line, it settles under the loads instead. None where no
    constraint is violated, or the paths lead to no stable equilibrium.
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
    """Return an equilibrium nearer to the start than one that has lost its stability on the way.

    Above a critical speed a shaft turns about its axis of inertia. No path from rest leads there;
    one along which the centrifugal stiffness acts in full does, and it ends without a check: far
    above that speed the negative stiffness is none of the softest.
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
    """Return the end of a path, which is no equilibrium of all digits yet."""
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
    """Return an equilibrium with all its digits, or where it has come if it is none."""
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
    # Where the start is held, a motion without stiffness is that of a critical load.
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
    """Return the softest motions along which equilibria follow each other, shape (n_q, k).

    Such a motion, as the spin of a rod that hangs by its ends, has a stiffness of round-off, of
    either sign. A step along it, held by a small mu, ends at another equilibrium if a second one
    from there stays: a critical load or a soft spring drives it back.
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
