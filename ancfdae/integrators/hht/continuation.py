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

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from ancfdae.errors import SingularMatrix
from ancfdae.integrators.hht.equations import Coefficients, Node, rescaled
from ancfdae.integrators.hht.newton import Found, StepSolver
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


def continued(
    solver: StepSolver, c: Coefficients, before: Node, t: float
) -> tuple[Node | None, float]:
    """Solve the equations of a step at t; None if that fails, with the part that was solved."""
    branch: deque[tuple[float, Found]] = deque(maxlen=_POINTS)
    reached, stride = 0.0, 1.0
    most = solver.iterations + _MOST * solver.max_iterations
    while solver.iterations < most:
        part = min(1.0, reached + stride)
        stride = part - reached
        found = _solved(solver, (c, before, t), part, branch)
        if found is None:
            stride /= 2 if reached else 4
            if stride < max(_FINEST * reached, _SHORTEST):
                break
            continue
        if part == 1.0:
            return solver.accept(found), 1.0
        branch.append((part, found))
        reached = part
        wish = (_AIM / max(found.rate, 1e-9)) ** (1 / len(branch))
        stride *= min(_LONGEST, max(_LEAST, wish))
    return None, reached


def remedy(h: float, part: float) -> str:
    """Return in words which step would do where only a part of h was solved; nothing if none."""
    if not 0 < part < 1:
        return ""
    fitting = h / 2.0 ** math.ceil(-math.log2(part))
    return (
        f"From there the solution that belongs to the motion was found for steps up to "
        f"{part * h:.3g}: try a step of {fitting:.3g}, or HHT(rtol=1e-3), which chooses its steps."
    )


def _solved(
    solver: StepSolver,
    step: tuple[Coefficients, Node, float],
    part: float,
    branch: Sequence[tuple[float, Found]],
) -> Found | None:
    """Solve the equations of a part of the step; None if the guess is not close."""
    c, before, t = step
    now = t if part == 1.0 else before.t + part * (t - before.t)
    state, rough = rescaled(before, part), 0.0 if part == 1.0 else _ROUGH
    try:
        guess = _guess(part, branch) if branch else (state.a, state.lam)
        return solver.follow((Coefficients(part * c.h, c.alpha), state, now), guess, rough)
    except SingularMatrix:
        return None


def _guess(part: float, branch: Sequence[tuple[float, Found]]) -> tuple[Array, Array]:
    """Return a and lam on the polynomial through solutions."""
    s = np.array([reached for reached, _ in branch])
    weights = [np.prod((part - np.delete(s, i)) / (x - np.delete(s, i))) for i, x in enumerate(s)]
    a, lam = (np.stack(x) for x in zip(*((f.node.a, f.node.lam) for _, f in branch), strict=True))
    return weights @ a, weights @ lam
