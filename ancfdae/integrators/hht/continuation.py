"""Continuation in the step: where Newton's method stalls, the solution by way of shorter steps.

From the same state the equations of a step s h, with 0 < s <= 1, have one solution near the motion
if s is small. The branch of solutions that begins there is followed in s: guesses lie on the cubic
through the last four solutions, and count only where Newton's method contracts from its first
correction on, so that the branch is not left. The first rate of contraction is that of the distance
of the guess, which goes with the stride to the power of the number of solutions. The branch ends at
s = 1, with the solution of the full step, or turns back before: no larger step has a solution that
belongs to this motion.

Only guesses differ, not the equations; what they give has the derivatives of any other step.
"""

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.outcomes import Verdict
from ancfdae.integrators.hht.equations import Coefficients, Node, predict_increment, rescaled
from ancfdae.integrators.hht.newton import SolvedStep, Step, StepSolver
from ancfdae.integrators.step_control.contracts import Failure
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array

# What follows only serves as a guess needs few digits.
_ROUGH = 1e-8
# The shortest part of a step that is tried.
_SHORTEST = 2.0**-20
# Where the part grows by less than this of itself the branch is taken for ended.
_FINEST = 1e-4
# Iterations, in multiples of those that Newton's method may take: more than any branch took that
# reached a solution (measured: 10 to 200, with 15).
_MOST = 15
# Solutions that a guess is made of.
_POINTS = 4
# Rate of contraction that strides aim at, and how much one may differ from the last.
_AIM, _LEAST, _LONGEST = 0.2, 0.5, 3.0
# Where the branch of solutions could be followed over more than this part of a step, and then was
# lost in round-off, as many iterations as this times the usual ones are spent on the full step.
_MOST_OF_IT, _PATIENCE = 0.5, 4


def solved(
    solver: StepSolver, system: MechanicalSystem, step: Step, why: Failure
) -> Node | Failure:
    """Solve the equations of a step that Newton's method alone does not solve, for a reason."""
    node, part = continued(solver, step, why)
    if isinstance(node, Failure) and part > _MOST_OF_IT:
        node = _patient(solver, system, step)
    if not isinstance(node, Failure) or node.verdict is Verdict.NOT_FINITE:
        # No step helps where the forces themselves are not finite.
        return node
    return node._replace(remedy=_remedy(step[0].h, part))


def continued(solver: StepSolver, step: Step, why: Failure) -> tuple[Node | Failure, float]:
    """Follow the branch, beside the part of the step that was solved."""
    branch: deque[tuple[float, SolvedStep]] = deque(maxlen=_POINTS)
    reached, stride = 0.0, 1.0
    most = solver.iterations + _MOST * solver.max_iterations
    while solver.iterations < most:
        part = min(1.0, reached + stride)
        stride = part - reached
        solved = _solved(solver, step, part, branch)
        if isinstance(solved, Failure):
            why = why if solved.verdict is Verdict.SINGULAR else solved
            stride /= 2 if reached else 4
            if stride < max(_FINEST * reached, _SHORTEST):
                break
            continue
        if part == 1.0:
            return solver.accept(solved), 1.0
        branch.append((part, solved))
        reached = part
        wish = (_AIM / max(solved.rate, 1e-9)) ** (1 / len(branch))
        stride *= min(_LONGEST, max(_LEAST, wish))
    return why, reached


def _patient(solver: StepSolver, system: MechanicalSystem, step: Step) -> Node | Failure:
    """Iterate on where round-off hides the branch, unless that leads away from the motion."""
    c, last, _ = step
    node = solver.advance(step, patience=_PATIENCE)
    if isinstance(node, Failure):
        return node
    ahead, _ = predict_increment(c, last.v, last.a)
    near = norm(node.q - last.q - ahead, system.weights) <= norm(ahead, system.weights)
    return node if near else Failure(Verdict.NO_CONVERGENCE, math.inf)


def _remedy(h: float, part: float) -> str:
    """Return in words how much of a step of size h was solved; nothing if all or none."""
    if not 0 < part < 1:
        return ""
    return (
        f"The solution that belongs to the motion was found there for steps up to {part * h:.3g}."
    )


def _solved(
    solver: StepSolver, step: Step, part: float, branch: Sequence[tuple[float, SolvedStep]]
) -> SolvedStep | Failure:
    """Solve the equations of a part of the step from a guess, which must be close."""
    c, before, t = step
    now = t if part == 1.0 else before.t + part * (t - before.t)
    state, rough = rescaled(before, part), 0.0 if part == 1.0 else _ROUGH
    guess = _guess(part, branch) if branch else (state.a, state.lam)
    return solver.follow((Coefficients(part * c.h, c.alpha), state, now), guess, rough)


def _guess(part: float, branch: Sequence[tuple[float, SolvedStep]]) -> tuple[Array, Array]:
    """Return a and lam on the polynomial through solutions."""
    s = np.array([reached for reached, _ in branch])
    weights = [np.prod((part - np.delete(s, i)) / (x - np.delete(s, i))) for i, x in enumerate(s)]
    a, lam = (np.stack(x) for x in zip(*((f.node.a, f.node.lam) for _, f in branch), strict=True))
    return weights @ a, weights @ lam
