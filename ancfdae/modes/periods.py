"""Periods of small motions, and a step suggested from them."""

from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem, Solution, reaction
from ancfdae.errors.kinds import AncfdaeError, InvalidInputError
from ancfdae.errors.outcomes import Verdict
from ancfdae.modes.analysis import solve
from ancfdae.modes.linearised import LinearisationPoint, Linearised
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.threads import in_one_thread


@final
@dataclass(frozen=True)
class StepSuggestion:
    """A suggested step and the periods that it comes from; returned by `suggest_step`.

    Attributes
    ----------
    step : float
        Suggested step, `resolved` / `per_period`; s.
    fastest, slowest : float
        Shortest and longest period, 2 pi / |s|, of motions that vibrate or grow; s.
    resolved : float
        Period of the fastest mode that the step resolves; s.
    per_period : float
        Number of steps in the period `resolved`; dimensionless.
    """

    step: float
    fastest: float
    slowest: float
    resolved: float
    per_period: float

    def __str__(self) -> str:
        return (
            f"A step of {self.step:.3g} takes {self.per_period:.6g} steps in a period of "
            f"{self.resolved:.3g}; periods range from {self.fastest:.3g} to {self.slowest:.3g}."
        )


def suggestion(
    system: MechanicalSystem, at: LinearisationPoint, per_period: float, follow: int | None
) -> StepSuggestion:
    """Return a step that follows the `follow` slowest motions, or all; see `suggest_step`."""
    small = Linearised.of(system, at, False)
    turning = _turning(small, 1 if follow is None else follow)
    slow = 2 * np.pi / _speeds(small, 1 if follow is None else follow, False, turning)
    fastest = 2 * np.pi / _speeds(small, 1, True, turning)[-1]
    resolved = fastest if follow is None else float(slow[min(follow, len(slow)) - 1])
    return StepSuggestion(
        resolved / per_period, float(fastest), float(slow[0]), float(resolved), per_period
    )


def fastest(system: MechanicalSystem, at: LinearisationPoint) -> float:
    """Return the largest |s| of small motions x e^{st}, estimated if damped; 1/s.

    With damping it is the larger |s| of s^2 + (x^T D x) s + omega^2 = 0 for the fastest undamped
    motion x.
    """
    small = Linearised.of(system, at, None)
    pairs = solve(replace(small, D=None), 1, True)
    x, speed = pairs.X[:, -1], float(np.sqrt(np.abs(pairs.z[-1])))
    if small.D is None:
        return speed
    half = abs(float(x @ system.pattern.dot(small.D, x[:, None])[:, 0])) / 2
    return half + float(np.sqrt(half**2 - speed**2)) if half > speed else speed


# Largest number of coordinates for which dense methods find all modes in a fraction of a second.
_QUICK = 120
_CURED_BY_STEP = (Verdict.NO_CONVERGENCE, Verdict.NOT_FINITE, Verdict.STEP_LIMIT)


@in_one_thread
def advice(system: MechanicalSystem, t: float, q: Array, lam: Array) -> str:
    """Return advice on the step: periods of small motions about a state; empty without any.

    The text is empty for systems of more than _QUICK coordinates, too: a message must not take
    longer than the run that ends with it.
    """
    if system.n_q > _QUICK:
        return ""
    try:
        with np.errstate(all="ignore"):
            near = suggestion(system, LinearisationPoint(q, lam, t=t), 1.0, None)
    except (AncfdaeError, scipy.linalg.LinAlgError):
        return ""
    return (
        f"Small motions there have periods from {near.fastest:.3g} to {near.slowest:.3g}; the "
        "step decides which of them are followed (`suggest_step`)."
    )


def advised(system: MechanicalSystem, run: Solution) -> Solution:
    """Return a run with periods of small motions in its outcome if another step may help."""
    outcome = run.outcome
    if outcome.verdict not in _CURED_BY_STEP or not len(run.t) or np.iscomplexobj(run.q):
        return run
    periods = advice(system, float(run.t[-1]), run.q[-1], run.lam[-1])
    if not periods or periods in outcome.advice:  # as in a run that failed in its first step
        return run
    return replace(run, outcome=replace(outcome, advice=f"{outcome.advice} {periods}".lstrip()))


def _turning(small: Linearised, follow: int) -> float:
    """Return the rotation rate of slow motions driven by unbalanced forces; 1/s.

    For an acceleration a from zero velocity the joints add a' with Phi_q a' = -Phi_qq[a, a]: a^2/l
    for a pendulum of length l, so |a'|/|a| is the square of the rate, g/l for a horizontal
    pendulum, which has no stiffness. Zero in an equilibrium and where all joints are linear.
    """
    system, at = small.system, small.at
    if small.unbalanced == 0 or not system.n_lam:
        return 0.0
    force = system.force(at.t, at.q, np.zeros(system.n_q)) - reaction(system, at.t, at.q, at.lam)
    X = solve(small, follow, False).X
    a = X @ (X.T @ force)
    size = float(small.squares(a[:, None])[0]) ** 0.5
    if size == 0:
        return 0.0
    # With a of unit length neither its size nor that of q matters.
    a = a / size
    slope = np.imag(system.constraint_q(at.t, at.q + 1j * STEP * a)) / STEP
    turned = system.constraint_pattern.dot(slope, a)
    change = small.mass_factors.solve(np.concatenate([0 * a, -turned]))[: len(a)]
    return float((size * small.squares(change[:, None])[0] ** 0.5) ** 0.5)


def _speeds(small: Linearised, count: int, highest: bool, turning: float) -> Array:
    """Return |s| of the given number of motions that are not rigid, in increasing order; 1/s.

    No value is less than `turning`, the rotation rate due to unbalanced forces.
    """
    asked = count
    while True:
        z = solve(small, asked, highest).z
        speeds = np.sqrt(np.sort(np.abs(z[z != 0])))
        if len(speeds) >= count or asked >= small.n_free:
            break
        asked = min(2 * asked + 6, small.n_free)
    if not len(speeds) and turning:
        return np.array([turning])
    if not len(speeds):
        raise InvalidInputError(
            "suggest_step",
            "needs a motion that vibrates",
            "rigid motions only",
            "Choose the step from the speed of the motion.",
        )
    return np.asarray(np.maximum(speeds, turning))
